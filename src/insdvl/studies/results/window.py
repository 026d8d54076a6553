"""Length of the tuner's window and its rate: a study on simulations.

A long window estimates a constant variance better; a short one sees a change sooner, and so does a
high rate, since a variance applies until the next one is published.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.studies.evaluation import statistics
from insdvl.studies.evaluation.approaches import Setting
from insdvl.studies.evaluation.metrics import rmse
from insdvl.studies.evaluation.missions import CHANGES, TEST, Study
from insdvl.studies.evaluation.monte_carlo import Run, numbered, track_of
from insdvl.studies.report.markdown import interval, number, table
from insdvl.studies.training import ensemble
from insdvl.timeline.output import FoldResult
from insdvl.tuner.forest import Forest
from insdvl.tuner.models import Model, load_model

WINDOWS = (50, 100, 200, 400)  # samples
RATES = (0.5, 1.0, 2.0, 5.0)  # Hz
_BOOTSTRAP = 2004  # key of the random stream
_SETTING = Setting("calibrated")


def window_run(shared: tuple[Study, Mapping[int, Model]], number: int) -> dict[str, Array]:
    """A run with every window and rate.

    Returns:
        ``body_rmse`` (windows, rates) and ``oracle`` (): RMSE of the body velocity [m/s];
        ``q_error`` (windows, rates): RMS over time and channels of log(q received / q true).
    """
    study, models = shared
    run = Run(study, TEST, number)
    shape = len(models), len(RATES)
    errors, q_errors = np.empty(shape), np.empty(shape)
    learned, oracle = _SETTING.filter(source="external"), _SETTING.filter(source="oracle")
    for i, (window, model) in enumerate(models.items()):
        for j, rate in enumerate(RATES):
            q = run.learned(model.variances, window, window, rate)
            errors[i, j] = _body_rmse(run.fold_received(learned, *q), run)
            q_errors[i, j] = _q_error(run, *q)
    best = run.fold_received(oracle, *run.mission.process_noise())
    return {
        "body_rmse": errors,
        "q_error": q_errors,
        "oracle": np.array(_body_rmse(best, run)),
    }


def _body_rmse(fold: FoldResult, run: Run) -> float:
    return rmse(track_of(fold).v_b - run.truth.v_b)


def _q_error(run: Run, stamps_ns: Stamps, variances: Array) -> float:
    latest = np.searchsorted(stamps_ns, run.mission.stamps_ns, side="left") - 1
    known = latest >= 0
    return float(np.sqrt(np.mean(np.log(variances[latest[known]] / run.mission.q[known]) ** 2)))


def trained(window: int, pool: Pool, store: Store | None) -> Model:
    """The shipped model `default`, or one trained alike for another window."""
    shipped = load_model("default")
    if window == shipped.window:
        return shipped
    data, card = ensemble.train(
        shipped.card["feature_schema"],
        window,
        shipped.card["data_set"]["seed"],
        pool,
        store,
        say=lambda text: None,
    )
    return replace(shipped, card=card, window=window, regressor=Forest.load(data))


def study_windows(
    runs: int, seed: int, pool: Pool, store: Store | None = None, windows: Sequence[int] = WINDOWS
) -> dict[str, Any]:
    """The numbers of the study.

    Args:
        runs: Number of runs of each profile.
        seed: Random seed of the runs.
        pool: Computes the runs.
        store: Keeps finished runs.
        windows: Numbers of samples.
    """
    models = {window: trained(window, pool, store) for window in windows}
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_BOOTSTRAP,)))
    draws = statistics.resamples(np.arange(runs), rng)
    document: dict[str, Any] = {
        "windows": list(models),
        "rates": list(RATES),
        "runs": runs,
        "seed": seed,
        "profiles": {},
    }
    for profile in CHANGES:
        results = pool.compute(
            window_run,
            numbered(runs),
            shared=(Study(profile, seed), models),
            store=store,
            label=f"window and rate: {profile}",
        )
        errors = np.array([result["body_rmse"] for result in results])
        oracle = np.array([result["oracle"] for result in results])
        q_error = np.mean([result["q_error"] ** 2 for result in results], axis=0) ** 0.5
        document["profiles"][profile] = {
            "oracle": float(np.mean(oracle)),
            "ratio_to_oracle": [
                [
                    list(statistics.ratio_of_means(errors[:, i, j], oracle, draws))
                    for j in range(len(RATES))
                ]
                for i in range(len(models))
            ],
            "q_error": q_error.tolist(),
        }
    return document


def window_tables(document: Mapping[str, Any]) -> str:
    """The tables of the study."""
    parts = [f"{document['runs']} runs of each profile, seed {document['seed']}.\n"]
    for profile, numbers in document["profiles"].items():
        parts.append(
            f"`{profile}`: each channel changes every {CHANGES[profile][0]:g} to "
            f"{CHANGES[profile][1]:g} s. Body velocity RMSE divided by that of the oracle, with "
            "its 95 % interval in brackets; then the RMS error of log q.\n"
        )
        body = [
            [
                f"N = {window}",
                *(
                    f"{interval(ratio)}; {number(q_error, 2)}"
                    for ratio, q_error in zip(
                        numbers["ratio_to_oracle"][i], numbers["q_error"][i], strict=True
                    )
                ),
            ]
            for i, window in enumerate(document["windows"])
        ]
        parts.append(table(["window", *(f"{rate:g} Hz" for rate in document["rates"])], body))
    return "\n".join(parts)
