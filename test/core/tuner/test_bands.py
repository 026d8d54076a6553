"""Band powers: their scale, what they separate, and the closed forms and features made of them."""

import numpy as np
import pytest

from insdvl.tuner.features.band_features import (
    BAND_FEATURE_NAMES,
    TOLD,
    band_bounds,
    band_features,
)
from insdvl.tuner.features.band_forms import degrees, least_band, median_of_spectrum, single_band
from insdvl.tuner.features.bands import UNFILTERED, band_powers
from insdvl.tuner.models import load_model

LENGTHS = (200, 400, 600, 2000)
FORMS = (single_band, least_band, median_of_spectrum)


def white(rows: int, n: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((rows, n))


def assert_mean_is_one(values: np.ndarray) -> None:
    """Within 5 standard errors."""
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    assert (np.abs(values.mean(axis=0) - 1.0) < 5.0 * error).all(), values.mean(axis=0)


@pytest.mark.parametrize("n", LENGTHS)
def test_white_noise_has_its_variance_in_every_band(n):
    bands = band_powers(2.0 * white(400, n) + 9.8)
    for powers in (bands.now, bands.near, bands.slow, bands.variance):
        assert_mean_is_one(powers / 4.0)


@pytest.mark.parametrize("n", [200, 600])
def test_degrees_of_freedom_are_those_of_white_noise(n):
    powers = band_powers(white(2000, n)).near
    expected = 2.0 / degrees(n).bands  # relative variance
    np.testing.assert_allclose(powers.var(axis=0), expected, rtol=0.25)


def test_smooth_motion_is_in_no_band():
    t = np.linspace(-1.0, 1.0, 600)
    noise = white(6, 600)
    motion = 5.0 - 3.0 * t + 2.0 * t**3 - t**5
    for still, moving in zip(band_powers(noise), band_powers(noise + motion), strict=True):
        np.testing.assert_allclose(moving, still, rtol=1e-9)


@pytest.mark.parametrize(("frequency", "band"), [(4.5, 2), (8.0, 3), (22.0, 5), (40.0, 6)])
def test_a_line_of_vibration_is_in_its_band_alone(frequency, band):
    t = np.arange(2000) / 100.0
    bands = band_powers(np.sin(2.0 * np.pi * frequency * t + 0.3)[None])
    far = np.abs(np.arange(7) - band) > 1  # the window leaks into the neighbours
    assert bands.near[0, band] > 0.5  # the variance of the line, which is in part of the samples
    assert bands.near[0, far].max() < 1e-3 * bands.near[0, band]
    assert bands.slow.max() < 1e-4 * bands.near[0, band]


def test_a_slow_wave_is_in_the_history():
    t = np.arange(2000) / 100.0
    slow = band_powers(np.sin(2.0 * np.pi * 0.25 * t)[None]).slow[0]
    assert slow.argmax() == 1 and slow[1] > 100.0  # 0.2 to 0.4 Hz


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("n", [200, 400, 600])
def test_closed_forms_are_unbiased_for_white_noise(form, n):
    estimates = form(3.0 * white(2000, n)) / 9.0
    # The factors take the powers for independent; without them the least band has 0.6 to 0.75.
    assert estimates.mean() == pytest.approx(1.0, abs=0.1)


def test_features_do_not_depend_on_the_unit_and_the_scale_does():
    x = white(6, 1400) + np.sin(np.arange(1400) / 30.0)
    X, scale = band_features(x)
    X_8, scale_8 = band_features(8.0 * x)
    np.testing.assert_array_equal(X_8, X)
    np.testing.assert_array_equal(scale_8, 64.0 * scale)
    assert X.shape == (6, len(BAND_FEATURE_NAMES))
    assert (X[:, -1] == 7.0).all()


def test_imus_do_not_depend_on_each_other():
    x = white(18, 2000)
    X, scale = band_features(x)
    for m in (0, 6, 12):
        alone, of_it = band_features(x[m : m + 6])
        np.testing.assert_array_equal(alone, X[m : m + 6])
        np.testing.assert_array_equal(of_it, scale[m : m + 6])


def test_a_channel_has_the_mean_spectra_of_the_others():
    x = np.exp(np.arange(6.0))[:, None] * white(6, 900)
    X, scale = band_features(x)
    told = len(TOLD)
    triad, other = (BAND_FEATURE_NAMES.index(f"{of}_near_0") for of in ("triad", "other"))
    for m in range(6):
        first = m // 3 * 3
        siblings = [k for k in range(first, first + 3) if k != m]
        others = range(3 - first, 6 - first)
        for at, rows in ((triad, siblings), (other, others)):
            expected = np.mean([X[k, :told] for k in rows], axis=0)
            np.testing.assert_allclose(X[m, at : at + told], expected, rtol=1e-12)
        level = np.mean([np.log(scale[m] / scale[k]) for k in siblings])
        assert X[m, BAND_FEATURE_NAMES.index("above_triad")] == pytest.approx(level)
    assert X[:, BAND_FEATURE_NAMES.index("gyroscope")].tolist() == [0.0] * 3 + [1.0] * 3


def test_a_frozen_channel_tells_the_others_nothing():
    x = white(6, 600)
    x[[1, 2]] = 0.0
    X, scale = band_features(x)
    assert scale[1] == scale[2] == 0.0 and np.isfinite(X).all()
    triad = BAND_FEATURE_NAMES.index("triad_near_0")
    np.testing.assert_array_equal(X[0, triad : triad + len(TOLD)], X[0, : len(TOLD)])
    assert X[0, BAND_FEATURE_NAMES.index("above_triad")] == 0.0
    other = BAND_FEATURE_NAMES.index("other_near_0")
    np.testing.assert_array_equal(X[5, other : other + len(TOLD)], X[0, : len(TOLD)])


def test_only_the_last_2000_samples_count():
    x = white(6, 2500)
    np.testing.assert_array_equal(band_features(x)[0], band_features(x[:, 500:])[0])


@pytest.mark.parametrize("value", [0.0, 9.80665, -1e9])
def test_a_constant_window_has_no_noise(value):
    X, scale = band_features(np.full((6, 2000), value))
    assert np.isfinite(X).all() and scale[0] == 0.0


def test_the_scale_is_the_least_unfiltered_band():
    x = white(6, 2000)
    np.testing.assert_array_equal(
        band_features(x)[1], band_powers(x).near[:, :UNFILTERED].min(axis=1)
    )


def test_bounds_are_the_least_and_the_greatest_band():
    x = white(6, 2000)
    X, scale = band_features(x)
    bands = band_powers(x)
    low, high = band_bounds(X)
    least = np.hstack([bands.near, bands.slow, bands.now]).min(axis=1)
    np.testing.assert_allclose(scale * np.exp(low), least)
    greatest = np.hstack([bands.near, bands.slow]).max(axis=1)
    np.testing.assert_allclose(scale * np.exp(high), greatest)


@pytest.mark.parametrize("wrong", [np.zeros((1, 199)), np.zeros(200), np.full((1, 200), np.nan)])
def test_unusable_windows_are_rejected(wrong):
    with pytest.raises(ValueError, match=r"windows must be|values must be within"):
        band_powers(wrong)


def test_windows_that_are_no_whole_imu_are_rejected():
    with pytest.raises(ValueError, match="whole IMUs, 6 rows each, got 7 rows"):
        band_features(white(7, 400))


def test_the_shipped_model_takes_vibration_and_waves_for_motion() -> None:
    model, q = load_model("bands"), np.repeat([1e-3, 1e-8], 3)
    t = np.arange(2000) / 100.0
    still = model.variances(np.sqrt(q)[:, None] * white(6, t.size))
    for frequency, sigma in ((0.3, 30.0), (17.0, 10.0)):  # of the noise
        motion = np.sqrt(2.0) * sigma * np.sin(2.0 * np.pi * frequency * t)
        moving = model.variances(np.sqrt(q)[:, None] * (white(6, t.size) + motion))
        assert (np.abs(np.log(moving / still)) < np.log(4.0)).all(), frequency
    assert (np.abs(np.log(still / q)) < np.log(4.0)).all()


def test_a_triad_times_a_factor_has_its_square_as_variance() -> None:
    model, windows = load_model("bands"), white(6, 2000)
    factors = np.repeat([8.0, 0.25], 3)
    np.testing.assert_allclose(
        model.variances(factors[:, None] * windows), factors**2 * model.variances(windows)
    )
