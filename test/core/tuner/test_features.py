"""The 24 features: by hand, against numpy and scipy in extended precision, and at the edges."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal, stats

from insdvl.tuner.features.handcrafted import FEATURE_NAMES, features

CONSTANT_BY_CONSTRUCTION = {"detrend_mean": 0.0, "zscore_mean": 0.0, "zscore_std": 1.0}


def named(window: np.ndarray) -> dict[str, float]:
    return dict(zip(FEATURE_NAMES, features(np.atleast_2d(window))[0].tolist(), strict=True))


def reference(window: np.ndarray) -> dict[str, float]:
    """The definition, word by word; in extended precision, so that its own rounding is no issue."""
    x = window.astype(np.longdouble)
    t = np.arange(x.size, dtype=np.longdouble)
    t -= t.mean()
    deviation = x - x.mean()
    transformed = {
        "detrend": deviation - (t @ deviation) / (t @ t) * t,
        "zscore": deviation / x.std(ddof=1),
        "absolute": np.abs(x),
    }
    values = {}
    for name, y in transformed.items():
        ordered = np.sort(y)
        m = [np.mean((y - y.mean()) ** k) for k in (2, 3, 4)]
        middle = (ordered[(y.size - 1) // 2] + ordered[y.size // 2]) / 2
        values |= {
            f"{name}_min": ordered[0],
            f"{name}_max": ordered[-1],
            f"{name}_median": middle,
            f"{name}_std": y.std(ddof=1),
            f"{name}_mean": y.mean(),
            f"{name}_kurtosis": m[2] / m[0] ** 2,
            f"{name}_skewness": m[1] / m[0] ** np.longdouble(1.5),
            f"{name}_second_largest": ordered[-2],
        }
    return {name: float(value) for name, value in values.items()}


def test_names():
    assert len(FEATURE_NAMES) == len(set(FEATURE_NAMES)) == 24
    assert set(FEATURE_NAMES) == set(reference(np.arange(5.0) ** 2))


def test_a_window_computed_by_hand():
    # 0 0 0 0 10 -> mean 2; deviations -2 -2 -2 -2 8; t = -2 .. 2; slope 20 / 10 = 2;
    # residual 2 0 -2 -4 4; its m2 = 40/5 = 8, m3 = 0, m4 = (16 + 16 + 256 + 256)/5 = 108.8.
    # Deviations: m2 = 80/5 = 16, m3 = (-32 + 512)/5 = 96, m4 = (64 + 4096)/5 = 832; std = sqrt(20).
    z = 1.0 / np.sqrt(20.0)
    expected = {
        "detrend_min": -4.0,
        "detrend_max": 4.0,
        "detrend_median": 0.0,
        "detrend_std": np.sqrt(10.0),
        "detrend_mean": 0.0,
        "detrend_kurtosis": 1.7,
        "detrend_skewness": 0.0,
        "detrend_second_largest": 2.0,
        "zscore_min": -2.0 * z,
        "zscore_max": 8.0 * z,
        "zscore_median": -2.0 * z,
        "zscore_std": 1.0,
        "zscore_mean": 0.0,
        "zscore_kurtosis": 3.25,
        "zscore_skewness": 1.5,
        "zscore_second_largest": -2.0 * z,
        "absolute_min": 0.0,
        "absolute_max": 10.0,
        "absolute_median": 0.0,
        "absolute_std": np.sqrt(20.0),
        "absolute_mean": 2.0,
        "absolute_kurtosis": 3.25,
        "absolute_skewness": 1.5,
        "absolute_second_largest": 0.0,
    }
    assert named(np.array([0.0, 0.0, 0.0, 0.0, 10.0])) == pytest.approx(expected, rel=1e-15)


def test_an_even_window_with_both_signs_computed_by_hand():
    # 3 -1 -3 1: mean 0, t = -1.5 .. 1.5, slope -4 / 5 and residual 1.8 -1.4 -2.6 2.2;
    # |x| is 3 1 3 1.
    values = named(np.array([3.0, -1.0, -3.0, 1.0]))
    assert values["detrend_median"] == pytest.approx(0.2, rel=1e-14)
    assert values["detrend_second_largest"] == pytest.approx(1.8, rel=1e-14)
    assert values["detrend_std"] == pytest.approx(np.sqrt(5.6), rel=1e-14)
    assert values["zscore_max"] == pytest.approx(3.0 / np.sqrt(20.0 / 3.0), rel=1e-15)
    assert values["absolute_median"] == 2.0
    assert values["absolute_second_largest"] == 3.0
    assert values["absolute_kurtosis"] == 1.0
    assert values["absolute_mean"] == 2.0


@pytest.mark.parametrize(
    ("size", "offset"),
    [(size, -9.8) for size in (4, 5, 7, 8, 9, 10, 63, 199, 200, 401)]
    + [(200, offset) for offset in (0.0, 0.05, 1e3)],
)
def test_agrees_with_the_definition(size, offset):
    rng = np.random.default_rng(size)
    windows = offset + 0.1 * rng.standard_normal((20, size)) + 0.01 * np.arange(size) / size
    if size > 4:
        windows[:5] = np.round(windows[:5], 1)  # ties, as a quantised sensor has
    for window, row in zip(windows, features(windows), strict=True):
        expected = reference(window)
        for name, value in zip(FEATURE_NAMES, row, strict=True):
            spread = expected[name.split("_")[0] + "_std"]
            assert abs(value - expected[name]) <= 1e-12 * max(abs(expected[name]), spread), name


def test_agrees_with_scipy():
    window = np.random.default_rng(3).gamma(2.0, size=200)
    values = named(window)
    for name, y in [
        ("detrend", signal.detrend(window)),
        ("zscore", stats.zscore(window, ddof=1)),
        ("absolute", np.abs(window)),
    ]:
        assert values[f"{name}_kurtosis"] == pytest.approx(
            stats.kurtosis(y, fisher=False), rel=1e-12
        )
        assert values[f"{name}_skewness"] == pytest.approx(stats.skew(y), rel=1e-12)
        assert values[f"{name}_std"] == pytest.approx(np.std(y, ddof=1), rel=1e-12)
        assert values[f"{name}_median"] == pytest.approx(np.median(y), rel=1e-12)


def test_order_statistics_hold_for_every_order_of_few_values():
    for window in itertools.product([-2.0, 0.0, 1.0, 5.0], repeat=4):
        row = named(np.array(window))
        ordered = np.sort(np.abs(window))
        assert row["absolute_second_largest"] == ordered[-2]
        assert row["absolute_median"] == (ordered[1] + ordered[2]) / 2


@pytest.mark.parametrize("spread", [1.0, 1e-9, 1e12])
def test_outliers_do_not_confuse_the_median(spread):
    """The bisection starts with nearly all samples in one half, many times over."""
    rng = np.random.default_rng(5)
    window = rng.uniform(1.0, 2.0, 200) * spread
    window[:3] = [1e40, -1e30, 1e20]
    values = named(window)
    assert values["absolute_median"] == np.median(np.abs(window))
    assert values["absolute_second_largest"] == 1e30


def test_constant_features_are_exactly_constant():
    rng = np.random.default_rng(4)
    windows = 9.8 + rng.standard_normal((200, 200)) * rng.uniform(1e-6, 1.0, (200, 1))
    rows = features(windows)
    for name, value in CONSTANT_BY_CONSTRUCTION.items():
        assert (rows[:, FEATURE_NAMES.index(name)] == value).all()


@pytest.mark.parametrize("value", [0.0, 1.0, -9.80665, 0.1, 1e-30, -1e69])
@pytest.mark.parametrize("size", [3, 200])
def test_a_constant_window_has_no_spread_and_no_shape(value, size):
    values = named(np.full(size, value))
    level = {"min", "max", "median", "second_largest"}
    for name in FEATURE_NAMES:
        transformation, statistic = name.split("_", 1)
        if transformation == "absolute" and statistic in level:
            assert values[name] == abs(value)
        elif name == "absolute_mean":
            assert values[name] == pytest.approx(abs(value), rel=1e-15)
        else:
            assert values[name] == 0.0, name


def test_a_straight_line_has_no_residual():
    values = named(0.3 + 0.1 * np.arange(200))
    assert all(values[name] == 0.0 for name in FEATURE_NAMES if name.startswith("detrend"))
    assert values["zscore_kurtosis"] == pytest.approx(1.8, abs=1e-3)  # of a uniform distribution


def test_signs_that_alternate_have_a_constant_magnitude():
    values = named(np.tile([2.5, -2.5], 100))
    assert (
        values["absolute_std"] == values["absolute_kurtosis"] == values["absolute_skewness"] == 0.0
    )
    assert values["absolute_median"] == 2.5
    assert values["zscore_kurtosis"] == pytest.approx(1.0, rel=1e-12)


@given(
    st.lists(st.floats(-1e70, 1e70, allow_nan=False, allow_infinity=False), min_size=3, max_size=40)
)
def test_every_window_that_is_accepted_has_finite_features(window):
    row = features(np.array([window]))[0]
    assert np.isfinite(row).all()
    assert row[FEATURE_NAMES.index("absolute_median")] == pytest.approx(
        np.median(np.abs(window)), rel=1e-15
    )


def test_a_windows_features_do_not_depend_on_the_others_or_on_the_layout():
    windows = np.random.default_rng(6).standard_normal((7, 200))
    rows = features(windows)
    np.testing.assert_array_equal(np.vstack([features(w[None]) for w in windows]), rows)
    np.testing.assert_array_equal(features(np.asfortranarray(windows)), rows)
    np.testing.assert_array_equal(features(np.repeat(windows, 2, axis=1)[:, ::2]), rows)


def test_no_windows():
    assert features(np.empty((0, 200))).shape == (0, 24)


@pytest.mark.parametrize("shape", [(200,), (6, 2), (1, 6, 200)])
def test_a_wrong_shape_is_named(shape):
    with pytest.raises(ValueError, match=r"\(M, N\).*" + str(shape).replace("(", r"\(")[:-1]):
        features(np.ones(shape))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e71, -1e300])
@pytest.mark.parametrize("position", [0, 100, 199])
def test_a_value_that_cannot_be_used_is_named_with_its_window(value, position):
    windows = np.ones((3, 200))
    windows[1, position] = value
    with pytest.raises(ValueError, match="window 1 has " + str(value).replace("+", r"\+")):
        features(windows)
