"""The effective density: against integrals, Riccati equations and a simulated scalar filter."""

import numpy as np
import pytest
from scipy.integrate import quad, trapezoid
from scipy.linalg import solve_discrete_are

from insdvl.simulation.drawn.effective import (
    Dvl,
    gains,
    horizontal,
    measured,
    memory_rate,
    vertical,
)
from insdvl.simulation.drawn.spectrum import Spectrum, energy, flicker

DVL = Dvl(variance=0.01, interval=1.0)
SLOW = Spectrum(white=1e-6, first_order=((1e-5, 3.0),))
ALL = Spectrum(
    white=2e-5, first_order=((1e-4, 0.3), (2e-5, 20.0)), lines=((1e-3, 0.2),), bounded=1e-6
)
LOOP = (1.0, 0.3, 0.02)


def response(numerator, denominator):
    return lambda f: (
        abs(np.polyval(numerator, 2j * np.pi * f) / np.polyval(denominator, 2j * np.pi * f)) ** 2
    )


def over_frequencies(function):
    return 2.0 * (quad(function, 0.0, 1.0, limit=500)[0] + quad(function, 1.0, np.inf)[0])


def first_order_density(spectrum, f):
    return sum(2.0 * v * tau / (1.0 + (2.0 * np.pi * f * tau) ** 2) for v, tau in spectrum)


@pytest.mark.parametrize(
    ("numerator", "denominator"),
    [
        ((1.0,), (2.0, 0.3)),
        ((1.0, 0.0), LOOP),
        ((1.0, 0.3), LOOP),
        ((0.2, 1.0, 0.4), (1.5, 2.3, 0.8, 0.05)),
    ],
)
def test_energy_is_the_integral_over_all_frequencies(numerator, denominator):
    expected = over_frequencies(response(numerator, denominator))
    assert energy(numerator, denominator) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(
    ("numerator", "denominator"), [((1.0,), (1.0, 0.3)), ((1.0, 0.0), LOOP), ((1.0, 0.3), LOOP)]
)
def test_variance_behind_a_filter_is_that_of_the_spectrum(numerator, denominator):
    gain = response(numerator, denominator)
    expected = over_frequencies(
        lambda f: gain(f) * (ALL.white + first_order_density(ALL.first_order, f))
    )
    high = 1e4  # Hz, where |s H(s)| has reached its limit
    expected += ALL.bounded * (2.0 * np.pi * high) ** 2 * gain(high)
    expected += sum(variance * gain(f) for variance, f in ALL.lines)
    assert ALL.variance_behind(numerator, denominator) == pytest.approx(expected, rel=1e-6)


def test_mean_density_is_that_of_the_integral_over_a_time():
    duration = 5.0

    def window(f):
        return duration * np.sinc(f * duration) ** 2

    slow = Spectrum(first_order=ALL.first_order)
    f = np.linspace(0.0, 50.0, 2_000_001)
    expected = 2.0 * trapezoid(window(f) * first_order_density(slow.first_order, f), f)
    assert slow.mean_density(duration) == pytest.approx(expected, rel=1e-4)
    assert Spectrum(white=3.0).mean_density(duration) == 3.0
    assert Spectrum(lines=((2.0, 0.2),)).mean_density(duration) == pytest.approx(0.0, abs=1e-12)
    assert Spectrum(lines=((2.0, 0.3),)).mean_density(duration) == pytest.approx(2.0 * window(0.3))
    assert Spectrum(bounded=1.0).mean_density(duration) == pytest.approx(2.0 / duration)


def test_flicker_has_its_density():
    f = np.geomspace(1e-3, 0.2, 50)
    np.testing.assert_allclose(
        first_order_density(flicker(7.0, 0.1, 1000.0), f) * f / 7.0, 1.0, atol=0.06
    )


@pytest.mark.parametrize("density", [1e-7, 1e-5, 1e-3, 1.0])
def test_memory_rate_is_that_of_the_steady_scalar_gain(density):
    variance = 1.0
    for _ in range(10_000):
        predicted = variance + density * DVL.interval
        gain = predicted / (predicted + DVL.variance)
        variance = (1.0 - gain) * predicted
    assert memory_rate(density, DVL) == pytest.approx(-np.log1p(-gain) / DVL.interval, rel=1e-6)


@pytest.mark.parametrize("variance", [4e-4, 0.01])
@pytest.mark.parametrize(("q_f", "q_w"), [(1e-6, 1e-11), (1e-4, 1e-9), (5e-4, 5e-9)])
def test_gains_are_those_of_the_filter_with_tilt(q_f, q_w, variance):
    dvl, g = Dvl(variance, 1.0), 9.8
    F = np.array([[1.0, g], [0.0, 1.0]])
    Q = np.array([[q_f + g**2 * q_w / 3.0, g * q_w / 2.0], [g * q_w / 2.0, q_w]])
    H = np.array([[1.0, 0.0]])
    P = solve_discrete_are(F.T, H.T, Q, np.array([[variance]]))
    K = P @ H.T / (H @ P @ H.T + variance)
    # The poles after each ping, as rates.
    exact = np.sort_complex(np.log(np.linalg.eigvals((np.eye(2) - K @ H) @ F).astype(complex)))
    k_1, k_2 = gains(q_f, q_w, dvl)
    ours = np.sort_complex(np.roots([1.0, k_1, g * k_2]).astype(complex))
    np.testing.assert_allclose(np.abs(ours), np.abs(exact), rtol=0.1)


def test_white_noise_is_its_own_effective_density():
    white = Spectrum(white=3e-5)
    assert vertical(white, DVL) == pytest.approx(3e-5, rel=1e-9)
    q_f, q_w = horizontal(white, Spectrum(white=2e-10), DVL)
    assert (q_f, q_w) == (pytest.approx(3e-5, rel=1e-9), pytest.approx(2e-10, rel=1e-9))


@pytest.mark.parametrize("spectrum", [SLOW, Spectrum(first_order=ALL.first_order)])
def test_it_is_the_spectrum_averaged_over_the_memory_of_its_own_gain(spectrum):
    found = vertical(spectrum, DVL)
    f_k = memory_rate(found, DVL) / (2.0 * np.pi)

    def weight(f):
        return 1.0 / (1.0 + (f / f_k) ** 2)

    slow = over_frequencies(lambda f: weight(f) * first_order_density(spectrum.first_order, f))
    expected = spectrum.white + slow / over_frequencies(weight)
    assert found == pytest.approx(expected, rel=1e-6)


def test_a_step_towards_the_fixed_point_halves_the_error():
    """So there is one fixed point, whatever the spectrum."""
    for spectrum in (SLOW, ALL, Spectrum(lines=((1e-3, 0.2),)), Spectrum(bounded=1e-4)):
        told = np.geomspace(1e-9, 10.0, 400)
        caused = []
        for density in told:
            filtered = (1.0,), (1.0, memory_rate(density, DVL))
            caused.append(spectrum.variance_behind(*filtered) / energy(*filtered))
        slope = np.diff(np.log(caused)) / np.diff(np.log(told))
        assert np.abs(slope).max() <= 0.5 + 1e-6
        assert np.interp(vertical(spectrum, DVL), told, caused) == pytest.approx(
            vertical(spectrum, DVL), rel=1e-3
        )


def test_slow_noise_dominates_in_a_tilted_filter_too():
    gyroscope = Spectrum(white=1e-11, first_order=((1e-10, 3.0),))
    q_f, q_w = horizontal(SLOW, gyroscope, DVL)
    assert SLOW.mean_density(1.0) < q_f < SLOW.white + 2.0 * 3.0 * 1e-5
    assert gyroscope.mean_density(1.0) < q_w < gyroscope.white + 2.0 * 3.0 * 1e-10


def test_noise_is_needed():
    with pytest.raises(ValueError, match="needs noise"):
        vertical(Spectrum(), DVL)


def scalar_filter(tau, told, dvl, runs=1000, pings=400, steps=20):
    """NEES and RMSE [m/s] of a velocity whose acceleration has first-order noise of variance 1e-4.

    The NEES is the mean of that before and that after the pings, the RMSE that after.
    """
    rng, variance = np.random.default_rng(7), 1e-4
    dt = dvl.interval / steps
    decay = np.exp(-dt / tau)
    noise = np.sqrt(variance) * rng.standard_normal(runs)
    error, P, squares, spread = np.zeros(runs), 0.0, [], []
    for k in range(pings):
        for _ in range(steps):
            new = decay * noise + np.sqrt(variance * (1.0 - decay**2)) * rng.standard_normal(runs)
            error += 0.5 * dt * (noise + new)
            noise = new
        P += told * dvl.interval
        before = np.mean(error**2), P
        K = P / (P + dvl.variance)
        error += K * (np.sqrt(dvl.variance) * rng.standard_normal(runs) - error)
        P *= 1.0 - K
        if k >= pings // 2:
            squares += [before[0] / before[1], np.mean(error**2) / P]
            spread.append(np.mean(error**2))
    return np.mean(squares), np.sqrt(np.mean(spread))


@pytest.mark.parametrize("sigma", [0.02, 0.1])
@pytest.mark.parametrize("tau", [0.3, 1.0, 3.0])
def test_told_the_effective_density_a_scalar_filter_is_consistent(tau, sigma):
    """1000 runs of ten memories and more: the standard error of the NEES is below 2 %."""
    dvl = Dvl(sigma**2, 1.0)
    spectrum = Spectrum(first_order=((1e-4, tau),))
    nees, _ = scalar_filter(tau, vertical(spectrum, dvl), dvl)
    assert 0.95 < nees < 1.08


def test_told_the_density_over_the_dvl_interval_it_is_not():
    """With noise of 3 s and pings at 5 Hz, of which the memory holds many."""
    dvl, tau = Dvl(0.01, 0.2), 3.0
    spectrum = Spectrum(first_order=((1e-4, tau),))
    effective = scalar_filter(tau, vertical(spectrum, dvl), dvl, pings=1000, steps=4)
    interval = scalar_filter(tau, spectrum.mean_density(0.2), dvl, pings=1000, steps=4)
    assert 0.95 < effective[0] < 1.08
    assert interval[0] > 2.0
    assert interval[1] > 1.1 * effective[1]


def test_pings_with_a_slow_error_count_as_a_larger_variance():
    """Against the variance of the sum of pings that a steady gain makes."""
    k_1, interval, tau = 0.3, 1.0, 10.0
    a, rho = np.exp(-k_1 * interval), np.exp(-interval / tau)
    age = np.arange(400)
    weights = a**age
    covariance = rho ** np.abs(age[:, None] - age)
    expected = 4e-4 + 9e-4 * (weights @ covariance @ weights) / (weights @ weights)
    found = measured(np.array([4e-4]), 9e-4, tau, k_1, interval)
    np.testing.assert_allclose(found, [expected], rtol=1e-9)


def matched_variance(tau, dvl, variance=1e-4):
    """Variance after a ping of the filter which has the first-order error as a state."""
    steps = 200
    dt = dvl.interval / steps
    a = np.exp(-dt / tau)
    F, Q = np.eye(2), np.zeros((2, 2))
    step = np.array([[1.0, tau * (1.0 - a)], [0.0, a]])
    for _ in range(steps):
        F = step @ F
        Q = step @ Q @ step.T + np.diag([0.0, variance * (1.0 - a**2)])
    H = np.array([[1.0, 0.0]])
    P = solve_discrete_are(F.T, H.T, Q, np.array([[dvl.variance]]))
    return float((P - P @ H.T @ H @ P / (P[0, 0] + dvl.variance))[0, 0])


@pytest.mark.parametrize("sigma", [0.02, 0.1])
@pytest.mark.parametrize("tau", [0.3, 1.0, 3.0])
def test_a_filter_with_the_true_states_is_the_lower_bound_and_not_far(tau, sigma):
    """Of the error after a ping, of which a filter with the effective density is told."""
    for interval in (1.0, 0.2):
        dvl = Dvl(sigma**2, interval)
        k = memory_rate(vertical(Spectrum(first_order=((1e-4, tau),)), dvl), dvl)
        told = dvl.variance * (1.0 - np.exp(-k * interval))
        ratio = np.sqrt(told / matched_variance(tau, dvl))
        assert 0.999 < ratio < 1.1
