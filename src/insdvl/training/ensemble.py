"""The ensemble of regression trees: fit with scikit-learn, turned into flat arrays, with its card.

30 bagged trees. "Minimum of 8 leaves" is read as a minimum leaf size of 8. The model is trained on
the random 80 % of the data set, as published. Beside the error on the other 20 % stands the one
without leakage: each trajectory once is left out of the training of a model of its own.
"""

import platform
from collections.abc import Callable, Mapping
from typing import Any

import joblib
import numpy as np
import scipy
import sklearn
from numpy.typing import NDArray
from sklearn.ensemble import BaggingRegressor
from sklearn.tree import DecisionTreeRegressor

from insdvl.simulation.trajectories import BASELINE
from insdvl.training import dataset
from insdvl.training.dataset import DataSet, Indices
from insdvl.tuner.forest import LEAF, Forest
from insdvl.tuner.schemas import SCHEMAS
from insdvl.tuner.windows import CHANNELS

Array = NDArray[np.float64]

TREES = 30
MIN_SAMPLES_LEAF = 8


def fit(X: Array, q: Array, seed: int, jobs: int) -> BaggingRegressor:
    """The ensemble, the same for any number of jobs.

    Args:
        X: (M, F) features.
        q: (M,) answers.
        seed: In [0, 2^32).
        jobs: Number of processes.
    """
    ensemble = BaggingRegressor(
        DecisionTreeRegressor(min_samples_leaf=MIN_SAMPLES_LEAF),
        n_estimators=TREES,
        random_state=seed,
        n_jobs=jobs,
    )
    return ensemble.fit(X, q)


def to_forest(ensemble: BaggingRegressor) -> Forest:
    """The same trees as flat arrays."""
    features, thresholds, values, roots = [], [], [], []
    n_nodes = 0
    for estimator, columns in zip(ensemble.estimators_, ensemble.estimators_features_, strict=True):
        tree = estimator.tree_
        order = _preorder(tree.children_left, tree.children_right)
        leaf = tree.children_left[order] == LEAF
        feature = np.full(order.size, LEAF)
        # A tree may see the columns in an order of its own.
        feature[~leaf] = np.asarray(columns)[tree.feature[order][~leaf]]
        features.append(feature)
        thresholds.append(_rounded_down(tree.threshold[order][~leaf]))
        values.append(tree.value[order, 0, 0][leaf])
        roots.append(n_nodes)
        n_nodes += order.size
    return Forest(
        {
            "feature": np.concatenate(features).astype(np.int16),
            "threshold": np.concatenate(thresholds),
            "value": np.concatenate(values),
            "roots": np.array(roots, np.int32),
            "n_features": np.array(ensemble.n_features_in_, np.int32),
        }
    )


def _preorder(left: Indices, right: Indices) -> Indices:
    """Nodes of a tree, each split before its left side, and that before its right side."""
    order, waiting = [], [0]
    while waiting:
        node = waiting.pop()
        order.append(node)
        if left[node] != LEAF:
            waiting += [right[node], left[node]]
    return np.array(order)


def _rounded_down(threshold: Array) -> NDArray[np.float32]:
    """The largest float32 that is at most the threshold: it splits float32 values the same way."""
    rounded = threshold.astype(np.float32)
    above = rounded.astype(np.float64) > threshold
    rounded[above] = np.nextafter(rounded[above], np.float32(-np.inf))
    return rounded


def errors(forest: Forest, data: DataSet, examples: Indices) -> dict[str, float]:
    """RMSE, in the unit of q, and RMSE of the relative error, on some of the examples."""
    q = data.q[examples]
    error = forest.predict(data.X[examples]) - q
    return {
        "rmse": _rounded(np.sqrt(np.mean(error**2))),
        "relative_rmse": _rounded(np.sqrt(np.mean((error / q) ** 2))),
    }


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")


def train(
    name: str, seed: int, jobs: int, say: Callable[[str], None], n_windows: int = dataset.WINDOWS
) -> tuple[Forest, dict[str, Any]]:
    """A model of the feature schema `name`, and its card without the hash.

    Args:
        name: Of the feature schema, and of the model.
        seed: In [0, 2^32); of the data set, of the split, and of the ensemble.
        jobs: Number of processes; the result does not depend on it.
        say: Is told what is being done.
        n_windows: Windows of each channel of a recording.
    """
    data = dataset.build(name, seed, jobs, n_windows)
    say(f"data set: {data.q.size} examples, {data.X.shape[1]} features")

    training, test = dataset.random_split(data, seed)
    forest = to_forest(fit(data.X[training], data.q[training], seed, jobs))
    published = {
        "training": training.size,
        "test": test.size,
        **errors(forest, data, test),
    }
    say(f"random split: {_in_words(published)}")

    by_trajectory: dict[str, Any] = {}
    for unseen, trajectory in enumerate(BASELINE):
        others, left_out = dataset.trajectory_split(data, unseen)
        other = to_forest(fit(data.X[others], data.q[others], seed, jobs))
        by_trajectory[trajectory] = {
            "training": others.size,
            "test": left_out.size,
            **errors(other, data, left_out),
        }
        say(f"{trajectory} unseen: {_in_words(by_trajectory[trajectory])}")
    # All four test sets have the same size, so the mean square over all is the mean of theirs.
    overall = {
        measure: _rounded(np.sqrt(np.mean([m[measure] ** 2 for m in by_trajectory.values()])))
        for measure in ("rmse", "relative_rmse")
    }
    say(f"all four: {_in_words(overall)}")

    card = {
        "name": name,
        "kind": "forest",
        "feature_schema": name,
        "features": list(SCHEMAS[name].names),
        "target": "variance per sample of a channel's white noise, in the square of its unit",
        "window": dataset.WINDOW,
        "data_set": {
            "trajectories": list(BASELINE),
            "rate_hz": dataset.RATE,
            "channels": CHANNELS,
            "windows_per_channel": n_windows,
            "variances": [_rounded(q) for q in dataset.VARIANCES],
            "examples": data.q.size,
            "seed": seed,
        },
        "ensemble": {
            "trees": TREES,
            "min_samples_leaf": MIN_SAMPLES_LEAF,
            "seed": seed,
            "trained_on": "random_split",
        },
        "metrics": {
            "random_split": published,
            "trajectory_split": {**overall, "unseen": by_trajectory},
        },
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "scikit-learn": sklearn.__version__,
            "joblib": joblib.__version__,
        },
    }
    return forest, card


def _in_words(metrics: Mapping[str, Any]) -> str:
    return f"RMSE {metrics['rmse']:.4g}, relative {100.0 * metrics['relative_rmse']:.3g} %"
