"""The ensemble of regression trees: fitted with scikit-learn, converted to flat arrays.

30 bagged trees. "Minimum of 8 leaves" is read as a minimum leaf size of 8 in the preset `paper`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.extras import extra
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.jobs.tasks import Result
from insdvl.studies.training import dataset, procedure
from insdvl.studies.training.dataset import Indices, Recipe
from insdvl.studies.training.procedure import Method
from insdvl.tuner.forest import LEAF, Forest, ForestError

with extra("train"):
    import joblib
    import sklearn
    from sklearn.ensemble import BaggingRegressor, ExtraTreesRegressor, RandomForestRegressor
    from sklearn.tree import DecisionTreeRegressor

TREES = 30

#: Trees that are fitted together: many such parts keep all workers busy to the end.
PARTS = tuple(range(first, first + 5) for first in range(0, TREES, 5))

#: Smallest number of examples in a leaf by preset; a preset and its feature schema share the name.
PRESETS = {"paper": 8, "default": 200}


def fit(
    X: Array,
    y: Array,
    min_samples_leaf: int,
    seed: int,
    *,
    trees: range = range(TREES),
    share: float = 1.0,
) -> BaggingRegressor:
    """Fit the ensemble, or some of its trees, which are the same alone and in the ensemble.

    Args:
        X: (M, F) features.
        y: (M,) targets.
        min_samples_leaf: Smallest number of examples in a leaf.
        seed: Random seed in [0, 2^32).
        trees: Consecutive numbers of the trees.
        share: Number of examples that are drawn for each tree, over M.
    """
    ensemble = BaggingRegressor(
        DecisionTreeRegressor(min_samples_leaf=min_samples_leaf),
        n_estimators=trees.stop,
        max_samples=share,
        random_state=seed,
        n_jobs=1,
        warm_start=True,
    )
    # A warm start skips the seeds of the trees that the ensemble has, and fits the others.
    ensemble.estimators_ = [None] * trees.start
    ensemble.estimators_features_ = [None] * trees.start
    ensemble.fit(X, y)
    del ensemble.estimators_[: trees.start], ensemble.estimators_features_[: trees.start]
    return ensemble


def to_forest(
    ensemble: BaggingRegressor | RandomForestRegressor | ExtraTreesRegressor,
) -> Forest:
    """The trees of a fitted ensemble as flat arrays; predictions are equal to the bit.

    Args:
        ensemble: A BaggingRegressor of DecisionTreeRegressors, a RandomForestRegressor or an
            ExtraTreesRegressor, with one output.

    Raises:
        ForestError: It has other members than regression trees, or several outputs.
    """
    if not isinstance(ensemble, BaggingRegressor | RandomForestRegressor | ExtraTreesRegressor):
        raise ForestError(f"the ensemble must be a mean of trees, got {ensemble!r}")
    trees = ensemble.estimators_
    everything = np.arange(ensemble.n_features_in_)
    subsets = getattr(ensemble, "estimators_features_", [everything] * len(trees))
    nodes = []
    for estimator, columns in zip(trees, subsets, strict=True):
        if not isinstance(estimator, DecisionTreeRegressor):
            raise ForestError(f"the ensemble must consist of regression trees, got {estimator!r}")
        tree = estimator.tree_
        if tree.n_outputs != 1:
            raise ForestError(f"the trees must have one output, got {tree.n_outputs}")
        nodes.append(
            Nodes(
                left=tree.children_left,
                right=tree.children_right,
                # Each tree may have its own order of the columns. A leaf has none.
                feature=np.asarray(columns)[np.maximum(tree.feature, 0)],
                threshold=tree.threshold,
                value=tree.value[:, 0, 0],
            )
        )
    return forest_of(nodes, ensemble.n_features_in_)


class Nodes(NamedTuple):
    """A tree of n nodes: each has its values at the same place of all arrays (n,).

    Attributes:
        left: Node where the feature is at most the threshold; `LEAF` for a leaf.
        right: The other node.
        feature: Column of a row.
        threshold: Of the feature.
        value: Output of a leaf.
    """

    left: Indices
    right: Indices
    feature: Indices
    threshold: Array
    value: Array


def forest_of(trees: Sequence[Nodes], n_features: int) -> Forest:
    """The mean of trees, for rows of this length."""
    features, thresholds, values, roots = [], [], [], []
    n_nodes = 0
    for tree in trees:
        order = _preorder(tree.left, tree.right)
        leaf = tree.left[order] == LEAF
        features.append(np.where(leaf, LEAF, tree.feature[order]))
        thresholds.append(_rounded_down(tree.threshold[order][~leaf]))
        values.append(tree.value[order][leaf])
        roots.append(n_nodes)
        n_nodes += order.size
    return Forest(
        {
            "feature": np.concatenate(features).astype(np.int16),
            "threshold": np.concatenate(thresholds),
            "value": np.concatenate(values),
            "roots": np.array(roots, np.int32),
            "n_features": np.array(n_features, np.int32),
        }
    )


def joined(parts: Sequence[Result]) -> Result:
    """The arrays of one `Forest` that has the trees of several."""
    sizes = np.cumsum([0, *(part["feature"].size for part in parts)])
    roots = [part["roots"] + size for part, size in zip(parts, sizes[:-1], strict=True)]
    whole = {
        name: np.concatenate([part[name] for part in parts])
        for name in ("feature", "threshold", "value")
    }
    return {
        **whole,
        "roots": np.concatenate(roots).astype(np.int32),
        "n_features": parts[0]["n_features"],
    }


def _preorder(left: Indices, right: Indices) -> Indices:
    """Nodes of a tree in preorder: a split, its left side, its right side."""
    order, waiting = [], [0]
    while waiting:
        node = waiting.pop()
        order.append(node)
        if left[node] != LEAF:
            waiting += [right[node], left[node]]
    return np.array(order)


def _rounded_down(threshold: Array) -> NDArray[np.float32]:
    """The largest float32 up to the threshold, which splits float32 values in the same way."""
    rounded = threshold.astype(np.float32)
    above = rounded.astype(np.float64) > threshold
    rounded[above] = np.nextafter(rounded[above], np.float32(-np.inf))
    return rounded


def train(
    preset: str,
    window: int,
    seed: int,
    pool: Pool,
    store: Store | None,
    say: Callable[[str], None],
    n_windows: int = dataset.WINDOWS,
) -> tuple[bytes, dict[str, Any]]:
    """Train a model.

    Args:
        preset: Key of PRESETS, and name of the feature schema.
        window: Number of samples of a window.
        seed: Random seed in [0, 2^32) of the data set, the split and the ensemble.
        pool: Does the work; the result does not depend on it.
        store: Keeps finished parts.
        say: Called with messages of progress.
        n_windows: See `Recipe`.

    Returns:
        The file of the model, and its card without name and hash.
    """
    method = Method(
        kind="forest",
        fit=_fit,
        settings=(PRESETS[preset], seed),
        regressor=Forest,
        described_as=("ensemble", {"trees": TREES, "min_samples_leaf": PRESETS[preset]}),
        versions={
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "scikit-learn": sklearn.__version__,
            "joblib": joblib.__version__,
        },
        parts=PARTS,
        join=joined,
    )
    fitted, card = procedure.train_method(
        method, Recipe(preset, seed, window, n_windows), pool, store, say
    )
    return Forest(fitted).save(), card


def _fit(shared: tuple[Array, Array, int, int], task: tuple[Indices, range]) -> Result:
    X, y, min_samples_leaf, seed = shared
    training, trees = task
    return to_forest(fit(X[training], y[training], min_samples_leaf, seed, trees=trees)).arrays
