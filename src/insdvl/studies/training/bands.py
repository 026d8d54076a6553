"""The training of the model `bands`: which part of the spectrum is noise, learned from vehicles.

Two ensembles of trees are fitted to the vehicles of the training. The one with the least deviance
on the vehicles of the validation is kept, and its errors on the vehicles of the test are on its
card, beside those of the closed forms.

Where several variances q are possible, the mean of log q leaves a filter overconfident, and the
mean of q is several times too large for most vehicles (docs/explanation/learned-bands.md). The
boosted trees learn what lies between: the mean of the standard deviation.
"""

import platform
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.extras import extra
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.jobs.tasks import Result
from insdvl.studies.training import vehicles
from insdvl.studies.training.ensemble import Nodes, fit, forest_of, to_forest
from insdvl.studies.training.vehicles import KINDS, PARTS, Recipe
from insdvl.tuner.features.band_features import BAND_FEATURE_NAMES
from insdvl.tuner.features.band_forms import SINGLE, mean_of_least, median_of_white
from insdvl.tuner.features.bands import NEAR, WINDOW
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.forest import LEAF, Forest

with extra("train"):
    import joblib
    import sklearn
    from sklearn.ensemble import HistGradientBoostingRegressor
    from threadpoolctl import threadpool_limits

SCHEMA = "bands"
VEHICLES = 100  # of each kind
DURATION = 200.0  # s
LOW_PASSED = 1.0 / 3.0  # share of the IMUs with a low-pass

#: The candidates.
BAGGED, BOOSTED = "bagged trees", "boosted trees"
_LEAF = 8  # examples of a bagged tree, as published
#: Examples drawn for a tree. Those of a channel overlap by 17 of 20 s: a fifth says nearly as much.
_SHARE = 0.2
_BOOSTING: dict[str, Any] = {
    "max_iter": 400,
    "learning_rate": 0.03,
    "max_leaf_nodes": 31,
    "min_samples_leaf": 200,
    "max_features": 0.4,
}


def train(
    preset: str,
    window: int,
    seed: int,
    pool: Pool,
    store: Store | None,
    say: Callable[[str], None],
    of_each_kind: int = VEHICLES,
) -> tuple[bytes, dict[str, Any]]:
    """Train the model.

    Args:
        preset: `SCHEMA`.
        window: `WINDOW`, the least number of samples of the feature schema.
        seed: Random seed in [0, 2^32) of the vehicles and of the ensembles.
        pool: Does the work; the result does not depend on it.
        store: Keeps finished parts.
        say: Called with messages of progress.
        of_each_kind: Number of vehicles.

    Returns:
        The file of the model, and its card without name and hash.
    """
    recipe = Recipe(preset, seed, of_each_kind, DURATION, LOW_PASSED)
    data = vehicles.build(recipe, pool, store)
    say(f"data set: {data.q.size} examples of {recipe.vehicles * len(KINDS)} vehicles")
    usable = data.scale > 0.0
    y = np.zeros(data.q.size)
    y[usable] = SCHEMAS[preset].encode(data.q[usable], data.scale[usable])
    parts = {part: np.intersect1d(data.part(part), np.flatnonzero(usable)) for part in PARTS}
    training = parts["training"]
    fits = pool.compute(
        _fit,
        {name: name for name in (BAGGED, BOOSTED)},
        shared=(data.X[training], y[training], seed),
        store=store,
        label="fits",
    )
    forests = {name: Forest(arrays) for name, arrays in zip((BAGGED, BOOSTED), fits, strict=True)}

    def errors(name: str, part: str) -> Array:
        X = data.X[parts[part]]
        return SCHEMAS[preset].bounded(X, forests[name].predict(X)) - y[parts[part]]

    validation = {name: deviance(errors(name, "validation")) for name in forests}
    for name, lost in validation.items():
        say(f"{name}: deviance of q {lost:.3f} on the validation")
    best = min(validation, key=lambda name: validation[name])
    test = parts["test"]
    tested = {"learned": errors(best, "test")}
    for form, outputs in _closed_forms(data.X[test]).items():
        tested[form] = outputs - y[test]
    metrics = {
        name: {row: _by_kind(error, data.kind[test], measure) for row, error in tested.items()}
        for name, measure in (("test_deviance", deviance), ("test_rms_log_q", _rms))
    }
    for row, by_kind in metrics["test_deviance"].items():
        say(f"{row}: " + ", ".join(f"{kind} {lost:.2f}" for kind, lost in by_kind.items()))
    card = {
        "kind": "forest",
        "feature_schema": preset,
        "features": list(BAND_FEATURE_NAMES),
        "target": "log of the effective variance per sample over the least unfiltered band",
        "window": window,
        "data_set": {
            "kinds": list(KINDS),
            "vehicles_per_kind": recipe.vehicles,
            "parts_of_ten": PARTS,
            "duration_s": recipe.duration,
            "low_passed": _rounded(recipe.low_passed),
            "rate_hz": 100,
            "examples": data.q.size,
            "seed": seed,
        },
        "ensemble": {
            "chosen": best,
            "trees": forests[best].n_trees,
            "seed": seed,
            "trained_on": "training",
            "validation_deviance": {name: _rounded(lost) for name, lost in validation.items()},
        },
        "metrics": metrics,
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "scikit-learn": sklearn.__version__,
            "joblib": joblib.__version__,
        },
    }
    return forests[best].save(), card


def of_boosted(ensemble: HistGradientBoostingRegressor) -> Forest:
    """Boosted trees of gamma deviance, whose outputs are means, as a mean of trees of log(mean^2).

    The logarithm of their output is a start plus the sum of T trees. That is the mean of trees with
    the values start + T value; its double is the logarithm of the square.
    """
    start, trees = float(ensemble._baseline_prediction.item()), ensemble._predictors
    nodes = [
        Nodes(
            left=np.where(tree["is_leaf"], LEAF, tree["left"].astype(np.intp)),
            right=tree["right"].astype(np.intp),
            feature=tree["feature_idx"],
            threshold=tree["num_threshold"],
            value=2.0 * (start + len(trees) * tree["value"]),
        )
        for tree in (predictor.nodes for (predictor,) in trees)
    ]
    return forest_of(nodes, ensemble.n_features_in_)


def _fit(shared: tuple[Array, Array, int], candidate: str) -> Result:
    """The arrays of a candidate."""
    X, y, seed = shared
    if candidate == BAGGED:
        return dict(to_forest(fit(X, y, _LEAF, seed, share=_SHARE)).arrays)
    ensemble = HistGradientBoostingRegressor(
        loss="gamma", early_stopping=False, random_state=seed, **_BOOSTING
    )
    with threadpool_limits(1):  # sums of several threads differ in the last bits
        # A forest compares in single precision.
        ensemble.fit(X.astype(np.float32), np.exp(0.5 * y))
    return dict(of_boosted(ensemble).arrays)


def _closed_forms(X: Array) -> dict[str, Array]:
    """Outputs (M,) of the closed forms for features (M, F): logarithms over the least band."""
    column = {name: X[:, k] for k, name in enumerate(BAND_FEATURE_NAMES)}
    samples = np.minimum(column["history"] * WINDOW, NEAR).astype(int)
    lengths, which = np.unique(samples, return_inverse=True)
    least = np.log([mean_of_least(n) for n in lengths.tolist()])[which]
    median = np.log([median_of_white(n) for n in lengths.tolist()])[which]
    return {
        "variance": column["variance_now"],
        "single band": column[f"near_{SINGLE}"],
        "least band": -least,
        "median of spectrum": column["quantile_50"] - median,
    }


def _by_kind(
    errors: Array, kind: NDArray[np.int64], measure: Callable[[Array], float]
) -> dict[str, float]:
    """A measure of the errors (M,) of each kind of vehicle, and of all."""
    of = {name: _rounded(measure(errors[kind == k])) for k, name in enumerate(KINDS)}
    return {**of, "all": _rounded(measure(errors))}


def deviance(errors: Array) -> float:
    """Mean gamma deviance of estimates m of variances q, 2 (q / m - log(q / m) - 1), 0 at best.

    It is four times the Kullback-Leibler divergence of a Gaussian of variance m from one of
    variance q.

    Args:
        errors: (M,) of log(m / q).
    """
    return float(np.mean(2.0 * (np.exp(-errors) + errors - 1.0)))


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
