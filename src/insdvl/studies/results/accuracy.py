"""How well each estimator knows the variance of white noise in a window, and its limits.

On the published grid of variances an estimator is tested on the 20 % of examples that no model was
trained on; the error on trajectories that were left out of training comes from the cards of learned
estimators. On the AUV trajectory, which no model was trained on, variances are log-uniform, a new
one for each window and channel, in the range of the training and in two others.

A closed form that is applied to the motion of a window without noise gives the variance that it
takes for noise: where this is large, motion hides noise.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.simulation.motion import Trajectory
from insdvl.simulation.sensors.imu import ideal_imu
from insdvl.simulation.trajectories import AUV, BASELINE
from insdvl.studies.evaluation.approaches import LEARNED, estimator, unavailable
from insdvl.studies.report.markdown import number, table
from insdvl.studies.training import dataset
from insdvl.studies.training.dataset import RATE, VARIANCES, WINDOW, Recipe
from insdvl.studies.training.metrics import RANDOM, TRAJECTORY
from insdvl.tuner.features.closed_form import (
    DEGREE,
    bayes_rmse,
    degree_5,
    first_differences,
    linear,
    posterior_mean,
)
from insdvl.tuner.models import load_model
from insdvl.tuner.windows import CHANNELS

POSTERIOR_MEAN = "degree-5 detrend, posterior mean"
CLOSED_FORMS: Mapping[str, Callable[[Array], Array]] = {
    "variance after linear detrend": linear,
    "half the variance of first differences": first_differences,
    "degree-5 detrend": degree_5,
    POSTERIOR_MEAN: partial(posterior_mean, grid=VARIANCES),
}

#: Factors of the noise variances on the AUV trajectory to those of the training.
FACTORS = {"in range": 1.0, "1/1000": 1e-3, "x 10": 10.0}
#: Channels of each group.
GROUPS = {
    "all": slice(None),
    "accelerometers": slice(0, 3),
    "gyroscopes": slice(3, 6),
}
CHANNEL_NAMES = ("f_x", "f_y", "f_z", "w_x", "w_y", "w_z")

#: Motion hides noise where it looks like more than this share of the noise variance.
HIDING = 0.1

REPETITIONS = 20  # flights of the AUV trajectory, for each range
_SEED = 0  # of the data set whose split the shipped models have
_STREAM = 2005  # first key of the random streams


def study_accuracy(seed: int, pool: Pool, store: Store | None = None) -> dict[str, Any]:
    """The numbers of the study.

    Args:
        seed: Random seed of the noise on the AUV trajectory.
        pool: Computes the tasks.
        store: Keeps finished tasks.

    Returns:
        ``rows``: for each estimator the RMSE on the published grid, and RMSE and mean of the
        relative error on the AUV trajectory for each range and group of channels; ``limits``;
        ``motion``: see `motion`; ``omitted``: reason of each learned estimator that cannot be used.
    """
    omitted = unavailable(tuple(LEARNED))
    rows = [*(row for row in LEARNED if row not in omitted), *CLOSED_FORMS]
    published = _published(rows, pool, store)
    unseen = _unseen(rows, seed, pool, store)
    return {
        "window": WINDOW,
        "seed": seed,
        "windows_per_range": REPETITIONS * CHANNELS * _n_windows(AUV),
        "rows": [
            {"estimator": row, "published": published[row], "auv": unseen[row]} for row in rows
        ],
        "limits": {
            "bayes": bayes_rmse(VARIANCES, WINDOW),
            "bayes_degree_5": bayes_rmse(VARIANCES, WINDOW - DEGREE - 1),
            "relative": float(np.sqrt(2.0 / (WINDOW - DEGREE - 1))),
        },
        "motion": motion(AUV),
        "omitted": omitted,
    }


def _estimates(rows: list[str], windows: Array) -> Array:
    """Estimates (rows, M) of each estimator for windows (M, N)."""
    return np.array(
        [
            CLOSED_FORMS[row](windows) if row in CLOSED_FORMS else estimator(row)[0](windows)
            for row in rows
        ]
    )


# ---------------------------------------------------------------- published grid


def _published(
    rows: list[str], pool: Pool, store: Store | None
) -> dict[str, dict[str, float | None]]:
    recipe = Recipe("paper", _SEED)
    recordings = [(i, j) for i in range(len(BASELINE)) for j in range(VARIANCES.size)]
    results = pool.compute(
        published_recording,
        {f"{i}-{j:02}": (i, j) for i, j in recordings},
        shared=(rows, recipe),
        store=store,
        label="accuracy on the published grid",
    )
    errors = np.concatenate([result["errors"] for result in results], axis=1)
    _, test = dataset.random_split(errors.shape[1], recipe.seed)
    numbers: dict[str, dict[str, float | None]] = {}
    for row, error in zip(rows, errors, strict=True):
        if row in LEARNED:
            without_leakage = load_model(LEARNED[row]).card["metrics"][TRAJECTORY]["rmse"]
        else:
            without_leakage = _rms(error)
        numbers[row] = {RANDOM: _rms(error[test]), TRAJECTORY: without_leakage}
    return numbers


def published_recording(
    shared: tuple[list[str], Recipe], recording: tuple[int, int]
) -> dict[str, Array]:
    """``errors`` (rows, windows) of a recording of the data set, in the order of its windows."""
    rows, recipe = shared
    windows = dataset.noisy_windows(recipe, *recording)
    return {"errors": _estimates(rows, windows) - VARIANCES[recording[1]]}


# ---------------------------------------------------------------- unseen trajectory


def _unseen(
    rows: list[str], seed: int, pool: Pool, store: Store | None
) -> dict[str, dict[str, dict[str, dict[str, float]]]]:
    tasks = {f"{k}-{r:02}": (k, r) for k in range(len(FACTORS)) for r in range(REPETITIONS)}
    results = pool.compute(
        unseen_flight, tasks, shared=(rows, seed), store=store, label="accuracy on the AUV"
    )
    numbers: dict[str, dict[str, dict[str, dict[str, float]]]] = {row: {} for row in rows}
    for k, name in enumerate(FACTORS):
        flights = results[k * REPETITIONS : (k + 1) * REPETITIONS]
        errors = np.concatenate([flight["relative_errors"] for flight in flights], axis=2)
        for row, error in zip(rows, errors, strict=True):
            numbers[row][name] = {
                group: {
                    "relative_rmse": _rms(error[channels]),
                    "relative_bias": float(np.mean(error[channels])),
                }
                for group, channels in GROUPS.items()
            }
    return numbers


def unseen_flight(shared: tuple[list[str], int], task: tuple[int, int]) -> dict[str, Array]:
    """``relative_errors`` (rows, 6, windows) of one repetition in one range."""
    rows, seed = shared
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, *task)))
    windows = ideal_windows(AUV)
    factor = list(FACTORS.values())[task[0]]
    low, high = np.log(VARIANCES[[0, -1]])
    q = factor * np.exp(rng.uniform(low, high, windows.shape[:2]))
    windows += np.sqrt(q)[:, :, None] * rng.standard_normal(windows.shape)
    estimates = _estimates(rows, windows.reshape(-1, WINDOW)).reshape(-1, *q.shape)
    return {"relative_errors": estimates / q - 1.0}


def _n_windows(trajectory: Trajectory) -> int:
    return int(trajectory.duration * RATE) // WINDOW


def ideal_windows(trajectory: Trajectory) -> Array:
    """All K consecutive windows (6, K, WINDOW) of a perfect IMU."""
    n = _n_windows(trajectory)
    stamps_s = np.arange(1, n * WINDOW + 1) / RATE
    readings = np.hstack(ideal_imu(trajectory, stamps_s, 1.0 / RATE))
    return np.ascontiguousarray(readings.T).reshape(CHANNELS, n, WINDOW)


def motion(trajectory: Trajectory) -> dict[str, dict[str, dict[str, float]]]:
    """The variance that closed forms take for noise where there is none.

    Returns:
        For each form that is unbiased for white noise, and each channel: the largest variance of
        motion, the time at which its window ends [s], and the share of windows in which it exceeds
        HIDING times the smallest variance of each range.
    """
    windows = ideal_windows(trajectory)
    numbers: dict[str, dict[str, dict[str, float]]] = {}
    for form, function in CLOSED_FORMS.items():
        if form == POSTERIOR_MEAN:
            continue
        variances = function(windows.reshape(-1, WINDOW)).reshape(windows.shape[:2])
        numbers[form] = {
            channel: {
                "largest": float(of_channel.max()),
                "at_s": float((of_channel.argmax() + 1) * WINDOW / RATE),
                **{
                    f"hidden {name}": float(np.mean(of_channel > HIDING * factor * VARIANCES[0]))
                    for name, factor in FACTORS.items()
                },
            }
            for channel, of_channel in zip(CHANNEL_NAMES, variances, strict=True)
        }
    return numbers


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


# ---------------------------------------------------------------- tables


def accuracy_tables(document: Mapping[str, Any]) -> str:
    """The tables of the study."""
    return "\n".join(
        [_accuracy_table(document), _groups_table(document), _motion_table(document)]
        + [f"Left out: `{row}` ({reason}).\n" for row, reason in document["omitted"].items()]
    )


def _accuracy_table(document: Mapping[str, Any]) -> str:
    head = [
        "estimator",
        "RMSE on the grid, unseen 20 %",
        "RMSE on the grid, unseen trajectories",
        *(f"AUV, {name}" for name in FACTORS),
    ]
    body = [
        [
            row["estimator"],
            *(f"{row['published'][split]:.3e}" for split in (RANDOM, TRAJECTORY)),
            *(_percent(row["auv"][name]["all"]) for name in FACTORS),
        ]
        for row in document["rows"]
    ]
    limits = document["limits"]
    relative = number(100.0 * limits["relative"], 1)
    body += [
        ["limit: grid and motion known", f"{limits['bayes']:.3e}", "", "", "", ""],
        ["limit: grid known, degree 5", f"{limits['bayes_degree_5']:.3e}", "", "", "", ""],
        ["limit: no range known, degree 5", "", "", relative, relative, relative],
    ]
    return (
        "On the AUV trajectory: relative RMSE, and in brackets the mean relative error, in %, over "
        f"{document['windows_per_range']} windows per range.\n\n{table(head, body)}"
    )


def _percent(errors: Mapping[str, float]) -> str:
    rmse, bias = 100.0 * errors["relative_rmse"], 100.0 * errors["relative_bias"]
    return f"{number(rmse, 1)} ({bias:+.1f})"


def _groups_table(document: Mapping[str, Any]) -> str:
    groups = [group for group in GROUPS if group != "all"]
    head = ["estimator", *(f"{group}, {name}" for name in FACTORS for group in groups)]
    body = [
        [
            row["estimator"],
            *(_percent(row["auv"][name][group]) for name in FACTORS for group in groups),
        ]
        for row in document["rows"]
    ]
    return f"The same by groups of channels.\n\n{table(head, body)}"


def _motion_table(document: Mapping[str, Any]) -> str:
    head = ["AUV, channel"]
    forms = document["motion"]
    for form in forms:
        head += [f"{form}: largest", "at [s]", "hides q = 0.001 in", "q = 1e-6 in"]
    body = []
    for channel in CHANNEL_NAMES:
        cells = [f"`{channel}`"]
        for form in forms.values():
            numbers = form[channel]
            cells += [
                f"{numbers['largest']:.1e}",
                number(numbers["at_s"], 0),
                *(f"{100.0 * numbers[f'hidden {name}']:.0f} %" for name in ("in range", "1/1000")),
            ]
        body.append(cells)
    return (
        "Where motion hides noise: the variance that motion alone leaves in a window, its largest "
        "value and the end of that window, and the share of windows in which it exceeds "
        f"{100.0 * HIDING:.0f} % of q.\n\n{table(head, body)}"
    )
