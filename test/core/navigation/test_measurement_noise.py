"""The estimate of a DVL's noise: its recursion, its window and its guard, without a filter."""

import numpy as np
import pytest

from insdvl.navigation.events import NS
from insdvl.navigation.measurement_noise import guard, recursion, window
from insdvl.navigation.measurement_noise.guard import Correlation
from insdvl.navigation.measurement_noise.recursion import Belief, evidence, forgotten, whitened

R_0 = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, -1.0], [0.0, -1.0, 1.0]]) * 1e-4
M = np.array([[2.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 3.0]]) * 1e-4
ALL = (1e-6, 1e6)


# ------------------------------------------------------------------ the recursion


def test_the_evidence_is_the_expected_square_of_the_noise() -> None:
    """E[n^T R_0^-1 n | nu], with n and nu jointly normal."""
    nu, factor = np.array([0.03, -0.02, 0.01]), 2.5
    gain = factor * R_0 @ np.linalg.inv(factor * R_0 + M)
    mean, covariance = gain @ nu, factor * R_0 - gain @ (factor * R_0)
    expected = np.trace(np.linalg.solve(R_0, np.outer(mean, mean) + covariance))
    assert evidence(whitened(nu, M, R_0), factor) == pytest.approx(expected, rel=1e-12)


def test_the_true_factor_is_the_fixed_point_of_the_mean() -> None:
    """E[evidence] = m lambda: 2000 innovations, with a sigma of the mean of 0.9 %."""
    rng, factor = np.random.default_rng(1), 0.3
    nu = rng.multivariate_normal(np.zeros(3), factor * R_0 + M, 2000)
    told = [evidence(whitened(one, M, R_0), factor) for one in nu]
    sigma = np.std(told) / np.sqrt(len(told))
    assert abs(np.mean(told) - 3.0 * factor) < 4.0 * sigma < 0.04 * 3.0 * factor


def test_an_innovation_of_the_filter_s_own_error_teaches_nothing() -> None:
    nu = np.array([5.0, -3.0, 4.0])
    assert evidence(whitened(nu, 1e6 * np.eye(3), R_0), 0.7) == pytest.approx(2.1, rel=1e-6)


def test_without_noise_the_factor_goes_to_the_floor() -> None:
    belief, nothing = Belief(2.0, 2.0), whitened(np.zeros(3), 1e-12 * np.eye(3), R_0)
    for _ in range(200):
        belief = recursion.learned(forgotten(belief, 0.2, 6.0, 8.0), nothing, 0.01, 100.0)
    assert belief.factor == pytest.approx(0.01)


def test_a_constant_noise_is_found_with_the_spread_of_the_memory() -> None:
    """sigma of the mean of squares with weights rho^k: sqrt(2/3 (1 - rho)/(1 + rho)), 10.5 %."""
    rng, belief, found = np.random.default_rng(2), Belief(2.0, 2.0), []
    L = np.linalg.cholesky(0.5 * R_0 + 0.01 * M)
    for _ in range(3000):
        belief = forgotten(belief, 0.2, 6.0, 8.0)
        nu = L @ rng.standard_normal(3)
        belief = recursion.learned(belief, whitened(nu, 0.01 * M, R_0), *ALL)
        found.append(belief.factor)
    rho = np.exp(-0.2 / 6.0)
    spread = np.sqrt(2.0 / 3.0 * (1.0 - rho) / (1.0 + rho))
    assert np.mean(found[300:]) == pytest.approx(0.5, rel=4.0 * spread * np.sqrt(60.0 / 2700.0))
    assert np.std(found[300:]) == pytest.approx(0.5 * spread, rel=0.3)


@pytest.mark.parametrize(("before", "after"), [(0.005, 0.1), (0.1, 0.005)])
def test_the_quick_belief_follows_a_step_from_5_to_100_mm_s(before: float, after: float) -> None:
    """At 5 Hz up within 3 pings, down within 6 s, to 2.5 times in sigma or less."""
    rng, late = np.random.default_rng(3), 0
    for _ in range(20):
        belief = Belief(3.0, 3.0 * before**2)
        for _ in range(3 if after > before else 30):
            nu = whitened(rng.normal(0.0, after, 3), 1e-8 * np.eye(3), np.eye(3))
            belief = recursion.learned(forgotten(belief, 0.2, 1.0, 2.0), nu, *ALL)
        late += not 1.0 / 6.25 < belief.factor / after**2 < 6.25
    assert late <= 1


def test_a_singular_nominal_noise_teaches_nothing() -> None:
    assert whitened(np.ones(3), M, np.diag([1.0, 1.0, 0.0])) is None


# ------------------------------------------------------------------ the window


def test_equal_intervals_have_the_weights_of_the_third_difference() -> None:
    w = window.weights(np.arange(4) * NS // 5)
    np.testing.assert_allclose(np.abs(w), np.array([1.0, 3.0, 3.0, 1.0]) / np.sqrt(20.0))
    assert (np.sign(w[1:]) == -np.sign(w[:-1])).all()


def test_what_is_a_parabola_in_time_is_not_in_the_difference() -> None:
    stamps = np.array([0, 2, 3, 7]) * NS // 10
    t = stamps / NS
    for power in range(3):
        assert abs(window.weights(stamps) @ t**power) < 1e-14
    assert abs(window.weights(stamps) @ t**3) > 1e-3


def squares(rng: np.random.Generator, q: float, n: int = 30_000) -> np.ndarray:
    """Of pings with the noise R_0, and of an IMU whose velocity is a random walk of density q."""
    T, white = 0.2, rng.multivariate_normal(np.zeros(3), R_0, n)
    walk = np.cumsum(rng.normal(0.0, np.sqrt(q * T), (n, 3)), axis=0)
    w = window.weights(np.arange(4) * NS // 5)
    d = sum(w[i] * (white - walk)[i : n - 3 + i] for i in range(4))
    return np.einsum("ki,ij,kj->k", d, np.linalg.inv(R_0), d) / 3.0


def test_the_mean_square_is_the_factor_and_three_tenths_of_the_walk() -> None:
    """E = 1 + 0.3 q T tr(R_0^-1)/3, and its spread in a window of 15 is 31 %."""
    rng = np.random.default_rng(4)
    alone = squares(rng, 0.0)
    assert alone.mean() == pytest.approx(1.0, abs=0.03)
    means = alone[: 15 * 1900].reshape(-1, 15).mean(axis=1)
    # Neighbours are correlated by -15/20, 6/20 and -1/20.
    rho = np.array([0.75, 0.3, 0.05])
    spread = np.sqrt(
        2.0 / 3.0 / 15.0 * (1.0 + 2.0 * np.sum((1.0 - np.arange(1, 4) / 15.0) * rho**2))
    )
    assert spread == pytest.approx(0.31, abs=0.01)
    # R_0 is not diagonal, which changes nothing: the difference is whitened by it.
    assert means.std() == pytest.approx(spread, rel=0.1)
    q = 1e-3
    expected = 1.0 + 0.3 * q * 0.2 * np.trace(np.linalg.inv(R_0)) / 3.0
    assert squares(rng, q).mean() == pytest.approx(expected, abs=0.03)


def test_the_square_of_four_pings_is_in_units_of_their_own_noise() -> None:
    rng = np.random.default_rng(5)
    stamps = np.array([0, 10, 11, 30]) * NS // 10
    covariances = np.array([1.0, 4.0, 0.25, 9.0])[:, None, None] * R_0
    found = [
        window.difference_square(
            stamps, [rng.multivariate_normal(np.zeros(3), R) for R in covariances], covariances
        )
        for _ in range(500)
    ]
    assert np.mean(found) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 3.0 / 500.0))


def test_a_window_tells_nothing_before_five_differences() -> None:
    ring = np.arange(1.0, 16.0)
    assert window.mean_factor(ring, 4) is None
    assert window.mean_factor(ring, 5) == 3.0
    assert window.mean_factor(ring, 100) == 8.0


# ------------------------------------------------------------------ the guard


def doubts(alike: float, seed: int) -> np.ndarray:
    """Doubt about 150 innovations whose neighbours have a correlation, of 40 sequences."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(40):
        told, z = Correlation(0.0, 0.0, 0), rng.standard_normal(3)
        for _ in range(150):
            before, z = z, alike * z + np.sqrt(1.0 - alike**2) * rng.standard_normal(3)
            told = guard.followed(told, before, z)
        found.append(guard.doubt(told, 3))
    return np.array(found)


def test_a_filter_with_the_right_gain_is_hardly_doubted() -> None:
    """Some doubt in 8.9 % (beyond 1.7 sigma): 3.6 of 40 with a sigma of 1.8; sure in 0.07 %."""
    found = doubts(0.0, 6)
    assert np.count_nonzero(found > 0.0) <= 10
    assert np.count_nonzero(found == 1.0) <= 1


@pytest.mark.parametrize("alike", [0.4, -0.4])
def test_a_correlation_of_0_4_is_surely_seen(alike: float) -> None:
    """Its sigma is 1 / sqrt(3 99) = 0.058: 0.4 is 6.9 sigma, 3.5 above the limit."""
    assert np.count_nonzero(doubts(alike, 7) == 1.0) >= 39


def test_nothing_is_doubted_before_anything_is_told() -> None:
    assert guard.doubt(Correlation(0.0, 0.0, 0), 3) == 0.0


def test_the_doubt_moves_from_one_estimate_to_the_other() -> None:
    assert guard.between(4.0, 1.0, 0.0) == pytest.approx(4.0)
    assert guard.between(4.0, 1.0, 0.5) == pytest.approx(2.0)
    assert guard.between(4.0, 1.0, 1.0) == pytest.approx(1.0)
