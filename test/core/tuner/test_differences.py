"""Variance from differences of a high order: right in white noise, blind to motion, a bound."""

import numpy as np
import pytest

from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.tuner.features.closed_form import degree_5
from insdvl.tuner.features.differences import (
    HIGHER,
    LOWER,
    SIGMAS,
    bounded,
    difference_variances,
    integrated_variances,
    is_low_passed,
    low_pass_factor,
    relative_error,
)
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner

N = 200


@pytest.mark.parametrize("order", [1, 3, 10])
def test_white_noise_has_the_promised_mean_and_error(order: int) -> None:
    q = 2.5e-3
    windows = np.sqrt(q) * np.random.default_rng(1).standard_normal((4000, N))
    found = difference_variances(windows, order) / q
    error = relative_error(N, order)
    assert found.mean() == pytest.approx(1.0, abs=4.0 * error / np.sqrt(4000))
    assert found.std() == pytest.approx(error, rel=0.06)


def test_first_order_is_half_the_variance_of_first_differences() -> None:
    windows = np.random.default_rng(2).standard_normal((3, 50))
    expected = 0.5 * np.mean(np.diff(windows, axis=1) ** 2, axis=1)
    np.testing.assert_allclose(difference_variances(windows, 1), expected, rtol=1e-14)


def test_a_polynomial_below_the_order_has_no_variance() -> None:
    t = np.linspace(-1.0, 1.0, N)
    motion = np.polynomial.Polynomial([9.8, 3.0, -2.0, 1.0])(t)
    assert difference_variances(motion[None], 4)[0] < 1e-20


@pytest.mark.parametrize("period", [10, 20, 40])  # samples
def test_a_sinusoid_falls_with_the_order(period: int) -> None:
    motion = np.sin(2.0 * np.pi * np.arange(N) / period)[None]
    gain = 2.0 * np.sin(np.pi / period)
    first, fifth = (difference_variances(motion, order)[0] for order in (1, 5))
    # C(2, 1) / C(10, 5) is 2 / 252.
    assert fifth / first == pytest.approx(gain**8 * 2.0 / 252.0, rel=0.1)


def test_the_bound_hardly_acts_on_noise_and_takes_over_in_motion() -> None:
    rng = np.random.default_rng(3)
    noise = 0.01 * rng.standard_normal((2000, N))
    estimate = bounded(degree_5, 10, 200)
    lowered = estimate(noise) < degree_5(noise)
    assert lowered.mean() < 0.01
    swaying = noise + np.sin(2.0 * np.pi * np.arange(N) / 25.0)
    assert degree_5(swaying).min() > 0.1
    margin = 1.0 + SIGMAS * relative_error(N, 10)
    np.testing.assert_allclose(estimate(swaying), margin * difference_variances(swaying, 10))
    assert np.median(estimate(swaying)) == pytest.approx(1e-4 * margin, rel=0.1)


def test_order_zero_is_no_bound() -> None:
    assert bounded(degree_5, 0, 200) is degree_5


def test_the_tuner_uses_it() -> None:
    stamps = np.arange(N + 1) * 10_000_000
    sway = np.sin(2.0 * np.pi * np.arange(N + 1) / 25.0)
    told = {}
    for order in (0, 10):
        tuner = Tuner(TunerParameters(difference_order=order))
        found = [tuner.add(int(t), np.full(6, x)) for t, x in zip(stamps, sway, strict=True)]
        (told[order],) = [noise.variances for noise in found if noise is not None]
    assert (told[10] < 1e-6 * told[0]).all()


def test_an_order_out_of_range_is_refused() -> None:
    with pytest.raises(ParameterError, match="'difference_order' must be .*<= 20, got 21"):
        build(TunerParameters, {"difference_order": 21})


# A low-pass


@pytest.mark.parametrize("corner", [0.1, 0.2, 0.3])
def test_noise_behind_a_low_pass_has_its_density_at_low_frequencies(corner):
    """At 100 Hz, in windows of 20 s."""
    imu = ImuModel(bandwidth=100.0 * corner)
    samples = imu.filtered(np.random.default_rng(2).standard_normal((20_000, 6)))
    found = []
    for window in samples.reshape(-1, 2000, 6):
        assert is_low_passed(*(difference_variances(window.T, k) for k in (LOWER, HIGHER)))
        found.append(low_pass_factor(window) * difference_variances(window.T, 1).mean())
    assert 0.7 < np.mean(found) < 1.3


def test_white_noise_motion_and_vibration_are_no_low_pass():
    rng, t = np.random.default_rng(2), np.arange(2000) / 100.0
    white = rng.standard_normal((2000, 6))
    turning = white + np.outer(300.0 * np.sin(2.0 * np.pi * 0.8 * t), [0, 0, 0, 1, 1, 1])
    shaken = white + np.outer(5.0 * np.sin(2.0 * np.pi * 31.0 * t), np.ones(6))
    for samples in (white, turning, shaken):
        assert low_pass_factor(samples) == pytest.approx(1.0, abs=0.2)


def test_a_few_samples_tell_no_low_pass():
    samples = ImuModel(bandwidth=5.0).filtered(np.random.default_rng(2).standard_normal((199, 6)))
    assert low_pass_factor(samples) == 1.0


def test_waves_are_no_noise_behind_a_low_pass():
    """Ten times the noise, one sigma."""
    t = np.arange(2000) / 100.0
    noise = 0.01 * np.random.default_rng(2).standard_normal((2000, 6))
    waves = np.sin(2.0 * np.pi * 0.45 * t)[:, None] + np.sin(2.0 * np.pi * 0.6 * t + 1.0)[:, None]
    samples = ImuModel(bandwidth=10.0).filtered(noise + 0.1 * waves)
    shown = low_pass_factor(samples) * difference_variances(samples[:, :3].T, 1).mean()
    assert 0.4 < shown / 1e-4 < 2.0


@pytest.mark.parametrize("rate", [62.5, 100.0, 200.0, 1000.0])
def test_neither_motion_nor_vibration_nor_a_low_pass_is_integrated_noise(rate):
    """In windows of 20 s; the vibration has up to 400 times the variance of the noise."""
    n = round(20 * rate)
    rng, t = np.random.default_rng(2), np.arange(n) / rate
    white = rng.standard_normal((n, 6))
    turning = white + np.outer(30.0 * np.sin(2.0 * np.pi * 0.2 * t), [0, 0, 0, 1, 1, 1])
    lines = np.sin(2.0 * np.pi * 18.0 * t) + np.sin(2.0 * np.pi * 27.0 * t + 1.0)
    shaken = white + np.outer(20.0 * lines, np.ones(6))
    behind = ImuModel(rate=rate, bandwidth=0.15 * rate).filtered(shaken)
    for samples in (white, turning, shaken, behind):
        for variance in integrated_variances(samples, rate):
            assert 0.6 < variance < 1.4


def test_a_few_samples_show_the_noise_of_their_differences():
    samples = np.random.default_rng(2).standard_normal((199, 6))
    shown = difference_variances(samples.T, 1).reshape(2, 3).mean(axis=1)
    assert integrated_variances(samples, 100.0) == pytest.approx(shown)
