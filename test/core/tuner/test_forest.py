"""Trees as flat arrays: equal to scikit-learn to the last bit, and refused where they are none."""

import io

import numpy as np
import pytest
from sklearn.ensemble import (
    BaggingRegressor,
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.neighbors import KNeighborsRegressor
from sklearn.tree import DecisionTreeRegressor

from insdvl.studies.training.ensemble import to_forest
from insdvl.tuner.forest import Forest, ForestError


def fitted(seed: int = 0, trees: int = 30, leaf: int = 2, n: int = 600) -> BaggingRegressor:
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n, 5)) * [1.0, 1e-6, 1e6, 1.0, 1.0]
    X[:, 3] = np.round(X[:, 3], 1)
    X[:, 4] = 9.8 + 1e-6 * X[:, 4]  # neighbouring values of a float32
    y = np.sin(3.0 * X[:, 0]) + 1e6 * X[:, 1] + X[:, 3] + rng.standard_normal(n) / 3.0
    return BaggingRegressor(
        DecisionTreeRegressor(min_samples_leaf=leaf), n_estimators=trees, random_state=seed
    ).fit(X, y)


@pytest.fixture(scope="module")
def ensemble() -> BaggingRegressor:
    return fitted()


@pytest.fixture(scope="module")
def forest(ensemble) -> Forest:
    return to_forest(ensemble)


def bits(values: np.ndarray) -> list[str]:
    return [float(value).hex() for value in values]


def test_equals_scikit_learn_on_random_rows(ensemble, forest):
    X = np.random.default_rng(1).standard_normal((2000, 5)) * [1.0, 1e-6, 1e6, 1.0, 1e-6]
    X[:, 4] += 9.8
    expected = ensemble.predict(X)
    assert len(set(expected)) > 1000
    assert bits(forest.predict(X)) == bits(expected)


def test_equals_scikit_learn_at_and_beside_every_threshold(ensemble, forest):
    """Rows of thresholds: as they are, rounded to float32 both ways, and the next doubles."""
    rows = []
    rng = np.random.default_rng(2)
    for estimator, columns in zip(ensemble.estimators_, ensemble.estimators_features_, strict=True):
        tree = estimator.tree_
        for node in np.flatnonzero(tree.children_left >= 0):
            at = tree.threshold[node]
            near = np.float32(at)
            for value in (
                at,
                np.nextafter(at, -np.inf),
                np.nextafter(at, np.inf),
                near,
                np.nextafter(near, np.float32(-np.inf)),
                np.nextafter(near, np.float32(np.inf)),
            ):
                row = rng.standard_normal(5)
                row[columns[tree.feature[node]]] = value
                rows.append(row)
    X = np.array(rows)
    assert bits(forest.predict(X)) == bits(ensemble.predict(X))


@pytest.mark.parametrize(
    "value", [0.0, -0.0, 5e-324, -5e-324, 1e-46, -1e-46, 1e-38, 3.4028234e38, -3.4028234e38]
)
def test_equals_scikit_learn_at_the_ends_of_float32(ensemble, forest, value):
    X = np.full((1, 5), value)
    assert bits(forest.predict(X)) == bits(ensemble.predict(X))


@pytest.mark.parametrize("threshold", [1e-46, -1e-46, 0.1, -0.1, 1.0, 3.4e38, -3.4e38])
def test_a_threshold_is_rounded_down(threshold):
    """As to nearest, 1e-46 would be 0 and 0.1 too large: a float32 beside it would go astray."""
    X, y = np.array([[0.0], [2.0]] * 10), np.array([1.0, 8.0] * 10)
    ensemble = BaggingRegressor(DecisionTreeRegressor(), n_estimators=1, random_state=0).fit(X, y)
    ensemble.estimators_[0].tree_.threshold[0] = threshold
    near = np.float32(threshold)
    down, up = (np.nextafter(near, np.float32(side)) for side in (-np.inf, np.inf))
    rows = np.array([[down], [near], [up], [0.0]], dtype=np.float64)
    expected = ensemble.predict(rows)
    assert bits(expected) == bits([1.0 if row[0] <= threshold else 8.0 for row in rows])
    assert bits(to_forest(ensemble).predict(rows)) == bits(expected)


@pytest.mark.parametrize("trees", [1, 2, 7, 31])
def test_equals_scikit_learn_for_any_number_of_trees(trees):
    ensemble = fitted(seed=trees, trees=trees, leaf=8)
    X = np.random.default_rng(trees).standard_normal((200, 5))
    assert bits(to_forest(ensemble).predict(X)) == bits(ensemble.predict(X))


def test_equals_scikit_learn_where_trees_see_some_of_the_columns_only():
    rng = np.random.default_rng(8)
    X, y = rng.standard_normal((300, 5)), rng.standard_normal(300)
    ensemble = BaggingRegressor(
        DecisionTreeRegressor(min_samples_leaf=4), n_estimators=9, max_features=3, random_state=1
    ).fit(X, y)
    assert bits(to_forest(ensemble).predict(X)) == bits(ensemble.predict(X))


@pytest.mark.parametrize("kind", [RandomForestRegressor, ExtraTreesRegressor])
def test_equals_scikit_learn_for_its_other_ensembles_of_trees(kind):
    rng = np.random.default_rng(9)
    X, y = rng.standard_normal((300, 5)), rng.standard_normal(300)
    ensemble = kind(n_estimators=13, min_samples_leaf=3, max_features=2, random_state=1).fit(X, y)
    X = rng.standard_normal((500, 5))
    assert bits(to_forest(ensemble).predict(X)) == bits(ensemble.predict(X))


def test_what_is_no_mean_of_regression_trees_is_refused():
    rng = np.random.default_rng(10)
    X, y = rng.standard_normal((50, 3)), rng.standard_normal((50, 2))
    for ensemble, message in (
        (BaggingRegressor(KNeighborsRegressor()).fit(X, y[:, 0]), "got KNeighborsRegressor"),
        (RandomForestRegressor(3).fit(X, y), "must have one output, got 2"),
        (GradientBoostingRegressor(n_estimators=3).fit(X, y[:, 0]), "must be a mean of trees"),
        (DecisionTreeRegressor().fit(X, y[:, 0]), "must be a mean of trees"),
    ):
        with pytest.raises(ForestError, match=message):
            to_forest(ensemble)


def test_a_tree_without_a_split():
    X, y = np.zeros((10, 3)), np.full(10, 0.1)
    ensemble = BaggingRegressor(DecisionTreeRegressor(), n_estimators=3, random_state=0).fit(X, y)
    forest = to_forest(ensemble)
    assert forest.arrays["threshold"].size == 0
    assert bits(forest.predict(np.ones((2, 3)))) == bits(ensemble.predict(np.ones((2, 3))))


def test_a_row_does_not_feel_the_others(forest):
    X = np.random.default_rng(3).standard_normal((50, 5))
    assert bits(forest.predict(X)) == bits([forest.predict(row[None])[0] for row in X])
    assert forest.predict(X[:0]).shape == (0,)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e39, -1e39])
def test_a_value_beyond_float32_is_refused_with_its_row(forest, value):
    X = np.zeros((4, 5))
    X[2, 3] = value
    with pytest.raises(ValueError, match=r"finite in float32.* in row 2"):
        forest.predict(X)


@pytest.mark.parametrize("shape", [(5,), (2, 4), (2, 6), (1, 2, 5)])
def test_a_wrong_shape_is_refused(forest, shape):
    with pytest.raises(ValueError, match=r"X must be \(M, 5\)"):
        forest.predict(np.zeros(shape))


def saved(arrays: dict[str, np.ndarray]) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def test_a_file_gives_the_same_forest(forest):
    X = np.random.default_rng(4).standard_normal((50, 5))
    loaded = Forest.load(forest.save())
    assert loaded.save() == forest.save()
    assert loaded.n_trees == 30 and loaded.n_features == 5
    assert bits(loaded.predict(X)) == bits(forest.predict(X))


#: One tree: a split with a leaf on its left and, on its right, a split with two leaves.
TREE = {
    "feature": np.array([0, -1, 1, -1, -1], np.int16),
    "threshold": np.array([0.5, 1.5], np.float32),
    "value": np.array([1.0, 2.0, 3.0]),
    "roots": np.array([0], np.int32),
    "n_features": np.array(2, np.int32),
}


def test_a_tree_written_by_hand():
    X = np.array([[0.0, 9.0], [0.5, 9.0], [0.6, 1.0], [0.6, 1.5], [0.6, 1.6]])
    assert Forest(TREE).predict(X).tolist() == [1.0, 1.0, 2.0, 2.0, 3.0]


def test_two_trees_written_by_hand():
    two = {
        name: np.tile(array, 2) if array.ndim and name != "roots" else array
        for name, array in TREE.items()
    }
    two["roots"] = np.array([0, 5], np.int32)
    two["value"] = np.array([1.0, 2.0, 3.0, 10.0, 20.0, 40.0])
    X = np.array([[0.5, 9.0], [0.6, 1.5], [0.6, 1.6]])
    assert Forest(two).predict(X).tolist() == [5.5, 11.0, 21.5]
    two["roots"] = np.array([0, 4], np.int32)
    with pytest.raises(ForestError, match="not the 2 trees"):
        Forest(two)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"feature": None}, "'feature' is missing"),
        ({"n_features": None}, "'n_features' is missing"),
        ({"extra": np.zeros(1)}, "unknown array 'extra'"),
        ({"feature": TREE["feature"].astype(np.int64)}, "feature must be int16"),
        ({"value": TREE["value"].astype(np.float32)}, "value must be float64"),
        ({"threshold": TREE["threshold"][None]}, "threshold must be float32 with 1 dimensions"),
        ({"feature": np.array([0, -1, 2, -1, -1], np.int16)}, r"feature has 2.*\[-1, 2\)"),
        ({"feature": np.array([0, -1, -2, -1, -1], np.int16)}, "feature has -2"),
        ({"n_features": np.array(1, np.int32)}, "feature has 1"),
        ({"threshold": np.zeros(3, np.float32)}, "threshold has 3 elements, the nodes need 2"),
        ({"value": np.zeros(2)}, "value has 2 elements, the nodes need 3"),
        ({"threshold": np.array([0.5, np.nan], np.float32)}, "threshold is not finite"),
        ({"value": np.array([1.0, np.inf, 3.0])}, "value is not finite"),
        ({"roots": np.array([], np.int32)}, "roots must begin with 0"),
        ({"roots": np.array([1], np.int32)}, "roots must begin with 0"),
        ({"roots": np.array([0, 1], np.int32)}, "not the 2 trees"),
        ({"roots": np.array([0, 5], np.int32)}, "not the 2 trees"),
        # A split whose right side is missing; leaves left over; a leaf that is a tree too many.
        ({"feature": np.array([0, 0, -1, -1], np.int16), "value": np.zeros(2)}, "not the 1 trees"),
        ({"feature": np.array([0, -1, 1, -1], np.int16), "value": np.zeros(2)}, "not the 1 trees"),
        (
            {"feature": np.array([0, -1, 1, -1, -1, -1], np.int16), "value": np.zeros(4)},
            "not the 1 trees",
        ),
    ],
)
def test_arrays_that_are_no_trees_are_refused(change, message):
    arrays = {**TREE, **change}
    arrays = {name: array for name, array in arrays.items() if array is not None}
    with pytest.raises(ForestError, match=message):
        Forest(arrays)
    with pytest.raises(ForestError, match=message):
        Forest.load(saved(arrays))


class Explosive:
    """What runs code when it is unpickled."""

    def __reduce__(self):
        return pytest.fail, ("a pickle was loaded",)


def test_a_pickle_in_the_file_is_refused():
    objects = np.array([Explosive()], dtype=object)
    with pytest.raises(ForestError, match="not a valid .npz archive"):
        Forest.load(saved({**TREE, "value": objects}))


def test_a_damaged_file_is_refused(forest):
    data = saved(forest.arrays)
    for damaged in (b"", b"no archive", data[:-40], data[: len(data) // 2]):
        with pytest.raises(ForestError, match="not a valid .npz archive"):
            Forest.load(damaged)
    flipped = bytearray(data)
    flipped[len(flipped) // 2] ^= 0xFF
    with pytest.raises(ForestError):
        Forest.load(bytes(flipped))
