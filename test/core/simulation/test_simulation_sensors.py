"""Errors of the sensors: their statistics, and formulas written in another way."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.stats import chi2, kstest, norm

from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.simulation.sensors.dvl import DvlModel, ideal_velocity
from insdvl.simulation.sensors.imu import biases, ideal_imu, white_noise
from insdvl.simulation.trajectories import AUV, BASELINE, LOOP


def allan_variance(x, m):
    """Overlapping Allan variance of the columns of x at m samples."""
    cumulative = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
    means = (cumulative[m:] - cumulative[:-m]) / m
    return 0.5 * np.mean((means[m:] - means[:-m]) ** 2, axis=0)


@pytest.mark.parametrize("dt", [0.01, 0.1])
@pytest.mark.parametrize("earth_rate", [True, False])
def test_ideal_imu_is_the_mean_over_the_interval_that_ends_at_the_stamp(dt, earth_rate):
    stamps = np.array([60.3, 101.0, 145.2, 250.7])
    f_b, w_ib_b = ideal_imu(AUV, stamps, dt, earth_rate=earth_rate)
    for k, stamp in enumerate(stamps):
        for field, reading in (("f_b", f_b), ("w_ib_b", w_ib_b)):
            integral, _ = quad_vec(
                lambda t, field=field: getattr(AUV.truth([t], earth_rate=earth_rate), field)[0],
                stamp - dt,
                stamp,
                epsabs=1e-14,
            )
            np.testing.assert_allclose(reading[k], integral / dt, rtol=1e-12, atol=1e-12)
    assert f_b.flags.c_contiguous
    assert f_b.dtype == np.float64


def test_ideal_imu_sums_to_the_integral_without_a_gap():
    """Halving dt splits each interval in two: the means of pairs are the means of the whole."""
    coarse = ideal_imu(LOOP, np.arange(1, 101) * 0.02, 0.02)
    fine = ideal_imu(LOOP, np.arange(1, 201) * 0.01, 0.01)
    for whole, halves in zip(coarse, fine, strict=True):
        np.testing.assert_allclose(whole, halves.reshape(-1, 2, 3).mean(axis=1), atol=1e-13)


def test_white_noise_has_the_variance_per_sample_of_each_channel():
    variances = np.tile([0.01, 0.02, 0.005, 1e-3, 2e-3, 1e-6], (200_000, 1))
    variances[100_000:] *= 9.0
    noise = white_noise(variances, np.random.default_rng(5))
    for half in (slice(0, 100_000), slice(100_000, None)):
        ratio = noise[half].var(axis=0) / variances[half][0]
        assert np.abs(ratio - 1.0).max() < 5.0 * np.sqrt(2.0 / 100_000)
    assert kstest((noise / np.sqrt(variances)).ravel(), norm.cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(noise.T) - np.eye(6)).max() < 0.015


def test_allan_deviation_returns_the_noise_and_the_bias_walk():
    """White noise of variance q per sample: q / m. A walk of density w: w m dt / 3."""
    n, dt = 500_000, 0.01
    q = np.array([0.01, 0.01, 0.01, 1e-3, 1e-3, 1e-3])
    walk = np.array([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6])
    rng = np.random.default_rng(8)
    bias = biases(n, dt, np.zeros(6), walk, rng)
    reading = bias + white_noise(np.broadcast_to(q, (n, 6)), rng)
    short, long = 10, 2_500
    np.testing.assert_allclose(
        allan_variance(reading, short), q / short + walk * short * dt / 3.0, rtol=0.02
    )
    # Some 200 independent clusters are left at 25 s: 5 sigma of their variance.
    np.testing.assert_allclose(
        allan_variance(bias, long), walk * long * dt / 3.0 * (1.0 + 0.5 / long**2), rtol=0.5
    )
    np.testing.assert_allclose(
        allan_variance(bias, long).reshape(2, 3).mean(axis=1) / (walk[[0, 3]] * long * dt / 3.0),
        1.0,
        rtol=0.25,
    )


def test_turn_on_bias_and_walk_over_many_sensors():
    std = np.array([1e-3, 2e-3, 3e-3, 1e-5, 2e-5, 3e-5])
    walk = np.array([1e-6, 1e-6, 1e-6, 1e-10, 1e-10, 4e-10])
    runs = np.array(
        [biases(101, 0.1, std, walk, np.random.default_rng(seed)) for seed in range(4000)]
    )
    low, high = chi2.ppf([1e-5, 1.0 - 1e-5], 4000) / 4000
    first = (runs[:, 0] ** 2).mean(axis=0) / std**2
    grown = ((runs[:, -1] - runs[:, 0]) ** 2).mean(axis=0) / (walk * 10.0)
    assert low < first.min()
    assert first.max() < high
    assert low < grown.min()
    assert grown.max() < high


def test_dvl_measures_its_own_point_in_its_own_axes():
    """Against the velocity of the vehicle and the derivative of the arm, rotated by the mount."""
    mount, lever = (0.1, -0.2, 2.3), (1.2, -0.4, 0.5)
    t, h = np.linspace(40.0, 320.0, 57), 1e-3

    def arm(times):
        return AUV.truth(times).C_n_b @ lever

    near, far = (arm(t + k * h) - arm(t - k * h) for k in (1, 2))
    truth = AUV.truth(t)
    v_n = truth.v_n + (8.0 * near - far) / (12.0 * h)
    C_n_d = truth.C_n_b @ rotation_from_rpy(np.array(mount))
    expected = np.einsum("kji,kj->ki", C_n_d, v_n)
    model = DvlModel(mount=mount, lever_arm=lever)
    np.testing.assert_allclose(ideal_velocity(truth, model), expected, atol=1e-9)
    without = ideal_velocity(truth, DvlModel(mount=mount))
    assert np.abs(without - expected).max() > 0.1


def test_dvl_white_noise():
    model = DvlModel(noise_std=(0.1, 0.2, 0.05))
    errors, outliers = model.errors(np.arange(20_000.0), np.random.default_rng(3))
    np.testing.assert_allclose(errors.std(axis=0), model.noise_std, rtol=0.03)
    assert (
        np.abs(np.mean(errors[1:] * errors[:-1], axis=0) / np.square(model.noise_std)).max() < 0.04
    )
    assert not outliers.any()


@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_dvl_gauss_markov_error_has_its_sigma_and_correlation_time(rate):
    model = DvlModel(rate=rate, noise_std=(0.0,) * 3, bias_std=0.02, bias_time_constant=10.0)
    t = np.arange(200_000) / rate
    errors, _ = model.errors(t, np.random.default_rng(4))
    np.testing.assert_allclose(errors.std(axis=0), 0.02, rtol=0.06)
    lag = round(10.0 * rate)
    correlation = np.mean(errors[lag:] * errors[:-lag], axis=0) / errors.var(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-1.0), atol=0.06)
    first = np.array(
        [model.errors(t[:1], np.random.default_rng(seed))[0][0] for seed in range(3000)]
    )
    np.testing.assert_allclose(first.std(axis=0), 0.02, rtol=0.06)  # stationary from the start


def test_dvl_outliers_have_their_probability_and_size():
    model = DvlModel(noise_std=(0.0,) * 3, outlier_probability=0.2, outlier_size=4.0)
    errors, outliers = model.errors(np.arange(20_000.0), np.random.default_rng(6))
    assert outliers.mean() == pytest.approx(0.2, abs=0.015)
    np.testing.assert_allclose(np.linalg.norm(errors[outliers], axis=1), 4.0)
    assert not errors[~outliers].any()
    assert np.abs(errors[outliers].mean(axis=0)).max() < 0.2  # in all directions


def test_outages_are_half_open():
    model = DvlModel(outages=(5.0, 8.0, 20.0, 20.0))
    t = np.arange(1.0, 31.0)
    np.testing.assert_array_equal(t[~model.available(t)], [5.0, 6.0, 7.0])


def test_baselines_stay_quiet_within_a_window_of_two_seconds():
    """What the vehicle does must not look like noise of the smallest trained variance (1e-3)."""
    window, dt = 200, 0.01
    x = np.linspace(-1.0, 1.0, window)
    basis = np.linalg.qr(np.stack([np.ones(window), x], axis=1))[0]
    for trajectory in BASELINE.values():
        stamps = np.arange(1, 40_001) * dt
        reading = np.concatenate(ideal_imu(trajectory, stamps, dt), axis=1)
        windows = reading.reshape(-1, window, 6).transpose(0, 2, 1)
        residual = windows - windows @ basis @ basis.T
        assert residual.var(axis=2).max() < 1e-4
