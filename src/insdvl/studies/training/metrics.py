"""The splits for training and test of every model, and the errors on its card.

A model is trained on a random 80 % of the data set, as published, and tested on the other 20 %. The
error without leakage comes from four further models: each leaves one trajectory out of its training
and is tested on it.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.training import dataset
from insdvl.studies.training.dataset import DataSet, Indices, Recipe
from insdvl.tuner.windows import CHANNELS

Splits = Mapping[str, tuple[Indices, Indices]]

#: The split of the model that is kept; the other splits have the name of the unseen trajectory.
RANDOM = "random_split"
TRAJECTORY = "trajectory_split"

#: Target of a model in the words of its card, by `Schema.relative`.
TARGETS = {
    False: "variance per sample of a channel's white noise, in the square of its unit",
    True: "logarithm of that variance over the scale that the feature schema gives",
}


def splits_of(data: DataSet, seed: int) -> Splits:
    """Training and test examples of the published split, and of the four without a trajectory."""
    unseen = {name: dataset.trajectory_split(data, i) for i, name in enumerate(BASELINE)}
    return {RANDOM: dataset.random_split(data.q.size, seed), **unseen}


def described(recipe: Recipe, data: DataSet) -> dict[str, Any]:
    """The data set as described on a card."""
    return {
        "trajectories": list(BASELINE),
        "rate_hz": dataset.RATE,
        "channels": CHANNELS,
        "windows_per_channel": recipe.windows_per_channel,
        "variances": [_rounded(q) for q in dataset.VARIANCES],
        "examples": data.q.size,
        "seed": recipe.seed,
    }


def errors(estimates: Array, q: Array) -> dict[str, float]:
    """RMSE, in the unit of q, and RMSE of the relative error, of the estimates (M,) of q (M,)."""
    error = estimates - q
    return {
        "rmse": _rounded(np.sqrt(np.mean(error**2))),
        "relative_rmse": _rounded(np.sqrt(np.mean((error / q) ** 2))),
    }


def metrics_of(
    data: DataSet,
    splits: Splits,
    predict: Callable[[str, Indices], Array],
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Errors of the models of all splits on unseen examples, as on a card.

    Args:
        data: All examples.
        splits: See `splits_of`.
        predict: Variances (K,) from the model of a split for examples (K,).
        say: Called with messages of progress.
    """
    measured: dict[str, dict[str, Any]] = {}
    for name, (training, test) in splits.items():
        measured[name] = {
            "training": training.size,
            "test": test.size,
            **errors(predict(name, test), data.q[test]),
        }
        say(f"{_TITLES.get(name, f'{name} unseen')}: {_in_words(measured[name])}")
    published = measured.pop(RANDOM)
    # All test sets have the same size, so the mean square over all is the mean of theirs.
    overall = {
        measure: _rounded(np.sqrt(np.mean([m[measure] ** 2 for m in measured.values()])))
        for measure in ("rmse", "relative_rmse")
    }
    say(f"all four: {_in_words(overall)}")
    return {RANDOM: published, TRAJECTORY: {**overall, "unseen": measured}}


_TITLES = {RANDOM: "random split"}


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")


def _in_words(metrics: Mapping[str, Any]) -> str:
    return f"RMSE {metrics['rmse']:.4g}, relative {100.0 * metrics['relative_rmse']:.3g} %"
