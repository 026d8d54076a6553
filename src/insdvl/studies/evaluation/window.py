"""How long the tuner's window should be, and how often it should tell: a study on simulations.

A long window knows a constant variance better; a short one notices a change sooner, and so does a
high rate, since a variance holds until the next one is told.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.jobs.parallel import Pool, Store
from insdvl.studies.evaluation import statistics
from insdvl.studies.evaluation.approaches import Setting
from insdvl.studies.evaluation.metrics import rmse
from insdvl.studies.evaluation.monte_carlo import TEST, Run, Study, numbered, track_of
from insdvl.studies.evaluation.tables import interval, number, table
from insdvl.studies.training.ensemble import train
from insdvl.timeline.output import FoldResult
from insdvl.tuner.forest import Forest
from insdvl.tuner.models import Model, load_model

Array = NDArray[np.float64]

WINDOWS = (50, 100, 200, 400)  # samples
RATES = (0.5, 1.0, 2.0, 5.0)  # Hz
#: Noise profiles, and how often each channel changes in them.
PROFILES = {
    "fast": "every 2 to 6 s",
    "varying": "every 15 to 45 s",
    "slow": "every 60 to 180 s",
}
_BOOTSTRAP = 2004  # key of the random stream
_SETTING = Setting("calibrated")


def window_run(shared: tuple[Study, Mapping[int, Model]], number: int) -> dict[str, Array]:
    """A run with every window and rate.

    Returns:
        ``body_rmse`` (windows, rates) and ``oracle`` (): RMSE of the body velocity [m/s];
        ``q_error`` (windows, rates): RMS over time and channels of log(q told / q true).
    """
    study, models = shared
    run = Run(study, TEST, number)
    shape = len(models), len(RATES)
    errors, q_errors = np.empty(shape), np.empty(shape)
    learned, oracle = _SETTING.filter(source="external"), _SETTING.filter(source="oracle")
    for i, (window, model) in enumerate(models.items()):
        for j, rate in enumerate(RATES):
            told = run.learned(model.variances, window, rate)
            errors[i, j] = _body_rmse(run.fold_told(learned, *told), run)
            q_errors[i, j] = _q_error(run, *told)
    best = run.fold_told(oracle, *run.mission.process_noise())
    return {
        "body_rmse": errors,
        "q_error": q_errors,
        "oracle": np.array(_body_rmse(best, run)),
    }


def _body_rmse(fold: FoldResult, run: Run) -> float:
    return rmse(track_of(fold.states).v_b - run.truth.v_b)


def _q_error(run: Run, stamps_ns: NDArray[np.int64], variances: Array) -> float:
    told = np.searchsorted(stamps_ns, run.mission.stamps_ns, side="left") - 1
    known = told >= 0
    return float(np.sqrt(np.mean(np.log(variances[told[known]] / run.mission.q[known]) ** 2)))


def trained(window: int, pool: Pool, store: Store | None) -> Model:
    """The shipped model `default`, or the same trained for another window."""
    shipped = load_model("default")
    if window == shipped.window:
        return shipped
    data, card = train(
        shipped.card["feature_schema"],
        window,
        shipped.card["data_set"]["seed"],
        pool,
        store,
        say=lambda text: None,
    )
    return replace(shipped, card=card, window=window, regressor=Forest.load(data))


def study(
    runs: int, seed: int, pool: Pool, store: Store | None = None, windows: Sequence[int] = WINDOWS
) -> dict[str, Any]:
    """The study's numbers.

    Args:
        runs: Number of runs of each profile.
        seed: Of the runs.
        pool: Where they are computed.
        store: Keeps what is finished.
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
    for profile in PROFILES:
        results = pool.run(
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


def markdown(document: Mapping[str, Any]) -> str:
    """The study's tables."""
    parts = [f"{document['runs']} runs of each profile, seed {document['seed']}.\n"]
    for profile, numbers in document["profiles"].items():
        parts.append(
            f"`{profile}`: each channel changes {PROFILES[profile]}. Body velocity RMSE over that "
            "of the oracle, and in brackets its 95 % interval; then the RMS error of log q.\n"
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
