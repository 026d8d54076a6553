"""An ensemble of regression trees as flat arrays: file, checks, prediction.

A file holds five arrays for T trees with S splits and L leaves in total, tree after tree, the nodes
of a tree in preorder (a split, its whole left side, its whole right side):

* ``feature`` (S + L,) int16: the feature that a split compares, or -1 for a leaf;
* ``threshold`` (S,) float32: a row goes left where its feature is at most this;
* ``value`` (L,) float64: the output of a leaf;
* ``roots`` (T,) int32: the first node of each tree;
* ``n_features`` () int32: the length of a row.

Preorder needs no child indices: the left child is the next node, and the right child follows from
the sizes. A file therefore cannot hold a cycle or an index out of range, only a sequence that is
not a set of T trees, which is rejected.

The prediction equals scikit-learn's ``BaggingRegressor.predict`` with one job to the last bit.
scikit-learn rounds a row to float32 and compares it with thresholds in float64; a float32 is at
most such a threshold exactly when it is at most the threshold rounded down to float32, which is
stored. It adds the outputs of the trees in their order and divides by their number.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.files import archive
from insdvl.files import arrays as arrays_of
from insdvl.kernels import kernel

#: dtype and number of dimensions of the arrays of a file.
ARRAYS = {
    "feature": (np.dtype(np.int16), 1),
    "threshold": (np.dtype(np.float32), 1),
    "value": (np.dtype(np.float64), 1),
    "roots": (np.dtype(np.int32), 1),
    "n_features": (np.dtype(np.int32), 0),
}

LEAF = -1

MAX_BYTES = 64 * 2**20  # of the arrays; those of the largest shipped model have a fiftieth


class ForestError(ValueError):
    """The arrays are not an ensemble of trees."""


class Forest:
    """T regression trees; the output is their mean.

    Attributes:
        arrays: The arrays of the file, see the module.
        n_features: Length of a row.
        n_trees: T.
    """

    def __init__(self, arrays: Mapping[str, NDArray]) -> None:
        """Check the arrays and lay them out for prediction.

        Raises:
            ForestError: An array is missing, unknown, of the wrong type or shape, not finite or out
                of range, or the nodes are not T trees.
        """
        self.arrays = {name: _checked(arrays, name) for name in ARRAYS}
        unknown = sorted(set(arrays) - set(ARRAYS))
        if unknown:
            raise ForestError(f"unknown array {unknown[0]!r}")
        feature, roots = self.arrays["feature"], self.arrays["roots"]
        threshold, value = self.arrays["threshold"], self.arrays["value"]
        self.n_features = int(self.arrays["n_features"])
        self.n_trees = roots.size
        if self.n_features < 1:
            raise ForestError(f"n_features must be >= 1, got {self.n_features}")

        outside = (feature < LEAF) | (feature >= self.n_features)
        if outside.any():
            raise ForestError(
                f"feature has {feature[outside][0]}, which is not in [-1, {self.n_features})"
            )
        leaf = feature == LEAF
        for name, size in ("threshold", (~leaf).sum()), ("value", leaf.sum()):
            if self.arrays[name].size != size:
                raise ForestError(
                    f"{name} has {self.arrays[name].size} elements, the nodes need {size}"
                )
            if not np.isfinite(self.arrays[name]).all():
                raise ForestError(f"{name} is not finite")
        if not roots.size or roots[0] != 0:
            raise ForestError("roots must begin with 0")

        right = np.zeros(feature.size, np.int32)
        found = np.zeros(roots.size, np.int32)
        n_found = _right_children(feature, right, found)
        if n_found != roots.size or not np.array_equal(found, roots):
            raise ForestError(f"the nodes are not the {roots.size} trees that roots names")
        self._roots = roots
        # One record per node, so that a step touches one line of memory. A leaf leads to itself.
        index = np.arange(feature.size, dtype=np.int32)
        self._nodes = np.zeros(
            feature.size, [("threshold", "f4"), ("feature", "i4"), ("left", "i4"), ("right", "i4")]
        )
        self._nodes["threshold"][~leaf] = threshold
        self._nodes["feature"] = np.where(leaf, 0, feature)
        self._nodes["left"] = np.where(leaf, index, index + 1)
        self._nodes["right"] = np.where(leaf, index, right)
        self._values = np.zeros(feature.size)
        self._values[leaf] = value

    @classmethod
    def load(cls, data: bytes) -> "Forest":
        """A forest from the bytes of an ``.npz`` file.

        Raises:
            ForestError: They are not such an archive, or `Forest` rejects the arrays.
        """
        try:
            return cls(arrays_of(data, MAX_BYTES))
        except ForestError:
            raise
        except ValueError as error:
            raise ForestError(str(error)) from error

    def save(self) -> bytes:
        """The bytes of an ``.npz`` file; equal forests give equal bytes."""
        return archive(self.arrays)

    def predict(self, X: Array) -> Array:
        """Mean output of the trees for each row.

        Args:
            X: (M, n_features).

        Returns:
            (M,).

        Raises:
            ValueError: `X` has another shape, or is not finite in float32.
        """
        X = np.ascontiguousarray(X, dtype=np.float64)
        if X.ndim != 2 or X.shape[1] != self.n_features:
            raise ValueError(f"X must be (M, {self.n_features}), got {X.shape}")
        out = np.empty(X.shape[0])
        refused = _predict(self._nodes, self._values, self._roots, X, out)
        if refused >= 0:
            raise ValueError(
                f"X must be finite in float32, got {X[refused].tolist()} in row {refused}"
            )
        return out


def _checked(arrays: Mapping[str, NDArray], name: str) -> NDArray:
    dtype, ndim = ARRAYS[name]
    if name not in arrays:
        raise ForestError(f"array {name!r} is missing")
    array = np.asarray(arrays[name])
    if array.dtype != dtype or array.ndim != ndim:
        raise ForestError(
            f"{name} must be {dtype} with {ndim} dimensions, got {array.dtype} with {array.ndim}"
        )
    return array


@kernel
def _right_children(
    feature: NDArray[np.int16], right: NDArray[np.int32], roots: NDArray[np.int32]
) -> int:
    """Right child of each split into ``right``, first nodes of trees into ``roots``.

    Returns:
        The number of trees; -1 where they are incomplete or more than ``roots`` can hold.
    """
    waiting = np.empty(feature.size + 1, np.int32)  # splits whose right side has not started
    n_waiting = 0
    n_trees = 0
    begins = True
    for i in range(feature.size):
        if begins:
            if n_trees == roots.size:
                return -1
            roots[n_trees] = i
            n_trees += 1
            begins = False
        if feature[i] >= 0:
            waiting[n_waiting] = i
            n_waiting += 1
        elif n_waiting == 0:
            begins = True
        else:
            n_waiting -= 1
            right[waiting[n_waiting]] = i + 1
    return n_trees if begins else -1


@kernel
def _predict(
    nodes: NDArray[np.void],
    values: Array,
    roots: NDArray[np.int32],
    X: Array,
    out: Array,
) -> int:
    """Mean over the trees of the leaf that each row of ``X`` (M, F) reaches, into ``out`` (M,).

    A row takes one step down all trees at a time: the processor then waits for the memory of many
    nodes at once, and not for one after another.

    Returns:
        The first row that is not finite in float32, at which the prediction stops; else -1.
    """
    at = np.empty(roots.size, np.int64)
    row = np.empty(X.shape[1], np.float32)
    for m in range(X.shape[0]):
        for f in range(row.size):
            row[f] = X[m, f]
            if not np.isfinite(row[f]):
                return m
        at[:] = roots
        moving = True
        while moving:
            moving = False
            for t in range(roots.size):
                node = nodes[at[t]]
                child = node.left if row[node.feature] <= node.threshold else node.right
                moving |= child != at[t]
                at[t] = child
        total = 0.0
        for t in range(roots.size):
            total += values[at[t]]
        out[m] = total / roots.size
    return -1
