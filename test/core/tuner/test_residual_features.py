"""Features of the residual: by their definition, whatever the unit, the level and the motion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import legendre

from insdvl.tuner.features.residual import RESIDUAL_FEATURE_NAMES, residual_features
from insdvl.tuner.features.schemas import SCHEMAS


def reference(window: np.ndarray) -> tuple[dict[str, float], float]:
    """The definition, word by word, with numpy's least squares."""
    n = window.size
    basis = legendre.legvander(np.linspace(-1.0, 1.0, n), 5)
    r = window - basis @ np.linalg.lstsq(basis, window, rcond=None)[0]
    scale = r @ r / (n - 6)
    values: dict[str, float] = {}
    for name, y in ("residual", r / r.std(ddof=1)), ("absolute", np.abs(r) / r.std(ddof=1)):
        ordered = np.sort(y)
        m = [np.mean((y - y.mean()) ** k) for k in (2, 3, 4)]
        values |= {
            f"{name}_min": ordered[0],
            f"{name}_max": ordered[-1],
            f"{name}_median": np.median(y),
            f"{name}_std": y.std(ddof=1),
            f"{name}_mean": y.mean(),
            f"{name}_kurtosis": m[2] / m[0] ** 2,
            f"{name}_skewness": m[1] / m[0] ** 1.5,
            f"{name}_second_largest": ordered[-2],
        }
    for k, (name, gain) in enumerate([("first", 2.0), ("second", 6.0), ("third", 20.0)], start=1):
        values[f"log_{name}_differences"] = np.log(np.mean(np.diff(r, k) ** 2) / gain / scale)
    return {name: float(values[name]) for name in RESIDUAL_FEATURE_NAMES}, float(scale)


@pytest.mark.parametrize("size", [8, 9, 50, 200, 401])
@pytest.mark.parametrize("offset", [0.0, -9.8, 1e3])
def test_agrees_with_the_definition(size, offset):
    rng = np.random.default_rng(size)
    t = np.linspace(0.0, 1.0, size)
    windows = offset + 0.1 * rng.standard_normal((20, size)) + np.sin(3.0 * t)
    X, scale = residual_features(windows)
    for window, row, s2 in zip(windows, X, scale, strict=True):
        values, expected = reference(window)
        assert s2 == pytest.approx(expected, rel=1e-9)
        np.testing.assert_allclose(row, list(values.values()), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("factor", [2.0**-100, 2.0**-1, 2.0**100])
def test_a_factor_changes_the_scale_alone(factor):
    windows = np.random.default_rng(1).normal(9.8, 0.1, (30, 200))
    X, scale = residual_features(windows)
    other, other_scale = residual_features(factor * windows)
    np.testing.assert_array_equal(other, X)
    np.testing.assert_array_equal(other_scale, factor**2 * scale)
    np.testing.assert_allclose(residual_features(0.3 * windows)[0], X, atol=1e-10)


def test_a_polynomial_of_degree_5_changes_nothing():
    rng = np.random.default_rng(2)
    windows = rng.standard_normal((30, 200))
    motion = legendre.legval(np.linspace(-1.0, 1.0, 200), rng.normal(0.0, 10.0, (6, 30)))
    X, scale = residual_features(windows)
    moved, moved_scale = residual_features(windows + motion)
    np.testing.assert_allclose(moved, X, atol=1e-10)
    np.testing.assert_allclose(moved_scale, scale, rtol=1e-12)


@pytest.mark.parametrize("power", range(6))
@pytest.mark.parametrize("value", [1.0, -9.80665, 1e-30, 1e69, 0.0])
def test_a_window_without_noise_has_features_and_scale_zero(power, value):
    X, scale = residual_features(value * np.linspace(0.0, 1.0, 200)[None] ** power)
    assert (X == 0.0).all() and scale.tolist() == [0.0]


def test_the_scale_is_the_unbiased_variance_and_the_logs_agree_with_it():
    windows = np.random.default_rng(3).normal(0.0, 0.2, (20_000, 200))
    X, scale = residual_features(windows)
    assert scale.mean() == pytest.approx(0.04, rel=5.0 * np.sqrt(2.0 / 194.0 / 20_000))
    assert scale.std() / 0.04 == pytest.approx(np.sqrt(2.0 / 194.0), rel=0.03)
    # Differences weigh high frequencies more; on the whole they say the same variance.
    assert np.abs(X[:, -3:].mean(axis=0)).max() < 0.03


@given(
    st.lists(st.floats(-1e70, 1e70, allow_nan=False, allow_infinity=False), min_size=8, max_size=40)
)
def test_every_window_that_is_accepted_has_finite_features(window):
    X, scale = residual_features(np.array([window]))
    assert np.isfinite(X.astype(np.float32)).all()
    assert np.isfinite(scale).all() and (scale >= 0.0).all()


def test_a_window_does_not_feel_the_others():
    windows = np.random.default_rng(4).standard_normal((7, 200))
    X, scale = residual_features(windows)
    for k, window in enumerate(windows):
        row, s2 = residual_features(window[None])
        np.testing.assert_array_equal(row[0], X[k])
        assert s2[0] == scale[k]


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e71])
def test_a_value_that_cannot_be_used_is_named_with_its_window(value):
    windows = np.ones((3, 200))
    windows[1, 7] = value
    with pytest.raises(ValueError, match="window 1 has " + str(value).replace("+", r"\+")):
        residual_features(windows)


def test_too_few_samples_are_refused():
    with pytest.raises(ValueError, match=r"\(M, N\) with N >= 8, got \(2, 7\)"):
        residual_features(np.ones((2, 7)))


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_an_answer_is_decoded_into_the_variance_that_was_encoded(name):
    schema = SCHEMAS[name]
    q, scale = np.array([1e-12, 0.01, 1e6]), np.array([2e-12, 0.009, 3e5])
    np.testing.assert_allclose(schema.decode(schema.encode(q, scale), scale), q, rtol=1e-14)
