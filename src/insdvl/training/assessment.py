"""On what a model is trained, and how its errors are told: both splits of the data set.

The model that ships is trained on the random 80 %, as published. Beside its error on the other
20 % stands the one without leakage: each trajectory once is left out of the training of a model of
its own, and this one is tested on it.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from insdvl.simulation.trajectories import BASELINE
from insdvl.training import dataset
from insdvl.training.dataset import DataSet, Indices
from insdvl.tuner.models import Regressor
from insdvl.tuner.schemas import Schema
from insdvl.tuner.windows import CHANNELS

PUBLISHED = "random_split"


def splits(data: DataSet, seed: int) -> dict[str, tuple[Indices, Indices]]:
    """Training and test examples of the model that ships, then of those without a trajectory."""
    return {PUBLISHED: dataset.random_split(data, seed)} | {
        name: dataset.trajectory_split(data, unseen) for unseen, name in enumerate(BASELINE)
    }


def metrics(
    regressors: Mapping[str, Regressor],
    data: DataSet,
    schema: Schema,
    seed: int,
    say: Callable[[str], None],
) -> dict[str, Any]:
    """The errors of a model, as its card has them.

    Args:
        regressors: One for each of `splits`, trained on its training examples.
        data: All examples.
        schema: What the regressors' answers mean.
        seed: Of the random split.
        say: Is told each error.
    """
    measured: dict[str, Any] = {}
    for name, (training, test) in splits(data, seed).items():
        sizes = {"training": training.size, "test": test.size}
        measured[name] = sizes | errors(regressors[name], data, test, schema)
    published = measured.pop(PUBLISHED)
    say(f"random split: {_in_words(published)}")
    for name, unseen in measured.items():
        say(f"{name} unseen: {_in_words(unseen)}")
    # All four test sets have the same size, so the mean square over all is the mean of theirs.
    overall = {
        measure: _rounded(np.sqrt(np.mean([m[measure] ** 2 for m in measured.values()])))
        for measure in ("rmse", "relative_rmse")
    }
    say(f"all four: {_in_words(overall)}")
    return {PUBLISHED: published, "trajectory_split": {**overall, "unseen": measured}}


def errors(
    regressor: Regressor, data: DataSet, examples: Indices, schema: Schema
) -> dict[str, float]:
    """RMSE, in the unit of q, and RMSE of the relative error, on some of the examples."""
    q = data.q[examples]
    error = schema.decode(regressor.predict(data.X[examples]), data.scale[examples]) - q
    return {
        "rmse": _rounded(np.sqrt(np.mean(error**2))),
        "relative_rmse": _rounded(np.sqrt(np.mean((error / q) ** 2))),
    }


def described(data: DataSet, seed: int, n_windows: int) -> dict[str, Any]:
    """The data set, as a card has it."""
    return {
        "trajectories": list(BASELINE),
        "rate_hz": dataset.RATE,
        "channels": CHANNELS,
        "windows_per_channel": n_windows,
        "variances": [_rounded(q) for q in dataset.VARIANCES],
        "examples": data.q.size,
        "seed": seed,
    }


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")


def _in_words(measured: Mapping[str, Any]) -> str:
    return f"RMSE {measured['rmse']:.4g}, relative {100.0 * measured['relative_rmse']:.3g} %"
