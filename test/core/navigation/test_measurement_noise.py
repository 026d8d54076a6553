"""The estimate of a DVL's noise: its levels, its window and its guard, without a filter."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from insdvl.navigation.events import NS
from insdvl.navigation.measurement_noise import guard, levels, window
from insdvl.navigation.measurement_noise.guard import Correlation
from insdvl.navigation.measurement_noise.levels import LEVELS, PRIOR, learned, moved, whitened
from insdvl.navigation.state.fields import NEVER

R_0 = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, -1.0], [0.0, -1.0, 1.0]]) * 1e-4
M = np.array([[2.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 3.0]]) * 1e-4
LOW = levels.SMALLEST


# ------------------------------------------------------------------ the levels


def test_the_probabilities_are_those_of_bayes_rule() -> None:
    nu = np.array([0.03, -0.02, 0.01])
    found, _ = learned(PRIOR, whitened(nu, M, R_0), LOW)
    likelihoods = [multivariate_normal(np.zeros(3), level * R_0 + M).pdf(nu) for level in LEVELS]
    expected = PRIOR * likelihoods / np.sum(PRIOR * likelihoods)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def mixture(p: np.ndarray, known: np.ndarray, nu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean gain (3,) of an error with the variances ``known``, and its variance (3,) behind it."""
    k = known / (known + LEVELS[:, None])
    mean = p @ k
    of_levels = known * LEVELS[:, None] / (known + LEVELS[:, None])
    return mean, p @ (of_levels + (k - mean) ** 2 * nu**2)


@pytest.mark.parametrize("known", [1e-6, 0.02, 1.0, 50.0])
def test_one_correction_has_the_mean_and_the_covariance_of_the_mixture(known: float) -> None:
    """With the factor of the gain, and that of Joseph's form beside it."""
    nu, d = np.array([1.5, -0.5, 0.8]), np.full(3, known)
    p, factors = learned(PRIOR, whitened(nu, np.diag(d), np.eye(3)), LOW)
    mean, variance = mixture(p, d, nu)
    k = d / (d + factors.gain)
    np.testing.assert_allclose(k, mean, rtol=1e-9)
    joseph = (1.0 - k) ** 2 * d + k**2 * factors.covariance
    assert joseph.mean() == pytest.approx(variance.mean(), rel=1e-9)


def test_where_the_factor_is_known_both_are_it() -> None:
    """600 pings of the same noise, of which nothing is forgotten."""
    rng, p = np.random.default_rng(1), PRIOR
    for nu in rng.multivariate_normal(np.zeros(3), 0.3 * R_0 + M, 600):
        p, factors = learned(p, whitened(nu, M, R_0), LOW)
    assert factors.gain == pytest.approx(0.3, rel=0.25)
    assert factors.covariance == pytest.approx(factors.gain, rel=0.1)


def test_an_innovation_of_the_filter_s_own_error_teaches_nothing() -> None:
    nu = np.array([500.0, -300.0, 400.0]) * 1e-2
    found, _ = learned(PRIOR, whitened(nu, 1e6 * np.eye(3), R_0), LOW)
    np.testing.assert_allclose(found, PRIOR, rtol=1e-3)


def test_a_ping_that_does_not_fit_makes_its_own_gain_small() -> None:
    """Ten sigma behind a minute of quiet: the first one already is taken for noise."""
    p, quiet = PRIOR, whitened(np.full(3, 0.1), 0.01 * np.eye(3), np.eye(3))
    for _ in range(300):
        p, before = learned(moved(p, 0.2), quiet, LOW)
    loud = whitened(np.array([1.0, -1.0, 1.0]), 0.01 * np.eye(3), np.eye(3))
    _, after = learned(moved(p, 0.2), loud, LOW)
    assert before.gain < 0.05
    assert after.gain > 10.0 * before.gain


def test_what_was_learned_is_forgotten_with_time() -> None:
    one = np.zeros(LEVELS.size)
    one[10] = 1.0
    kept = 1.0 - np.exp(-1.0)
    assert moved(one, levels.STAY).sum() == pytest.approx(1.0, rel=1e-12)
    assert np.abs(moved(one, levels.STAY) - PRIOR)[:5].max() < np.exp(-1.0)
    assert moved(one, levels.STAY)[-1] == pytest.approx(kept * PRIOR[-1], rel=1e-6)
    np.testing.assert_allclose(moved(one, 1e4), PRIOR, atol=1e-12)


def test_without_noise_the_factor_goes_to_the_floor() -> None:
    p, nothing = PRIOR, whitened(np.zeros(3), 1e-12 * np.eye(3), R_0)
    for _ in range(200):
        p, factors = learned(moved(p, 0.2), nothing, 0.01)
    assert 0.01 <= factors.gain < 0.0102


def test_a_constant_noise_is_found() -> None:
    """A factor of 0.5 among 300 jumps that did not happen: its mean to 5 %, its spread 20 %."""
    rng, p, found = np.random.default_rng(2), PRIOR, []
    L = np.linalg.cholesky(0.5 * R_0 + 0.01 * M)
    for _ in range(3000):
        nu = L @ rng.standard_normal(3)
        p, factors = learned(moved(p, 0.2), whitened(nu, 0.01 * M, R_0), LOW)
        found.append(factors.gain)
    assert np.mean(np.log(found[300:])) == pytest.approx(np.log(0.5), abs=0.05)
    assert np.std(np.log(found[300:])) < 0.2


@pytest.mark.parametrize(("before", "after"), [(0.005, 0.1), (0.1, 0.005)])
def test_a_step_from_5_to_100_mm_s_is_followed_within_three_pings(
    before: float, after: float
) -> None:
    """Up and down alike, with 50 mm/s nominal, to 2.5 times in sigma or less."""
    rng, late, known = np.random.default_rng(3), 0, 1e-6 * np.eye(3)
    for _ in range(20):
        p = PRIOR
        for sigma in [before] * 50 + [after] * 3:
            nu = whitened(rng.normal(0.0, sigma, 3), known, 0.05**2 * np.eye(3))
            p, factors = learned(moved(p, 0.2), nu, LOW)
        late += not 1.0 / 2.5 < 0.05 * np.sqrt(factors.gain) / after < 2.5
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
    squares = np.arange(1.0, 16.0)
    assert window.mean_factor(squares[:4]) is None
    assert window.mean_factor(squares[:5]) == 3.0
    assert window.mean_factor(squares) == 8.0


def test_a_difference_tells_something_for_a_minute() -> None:
    """All those of the slowest pings that are compared; none of a ring that is not yet full."""
    squares = np.arange(float(window.SIZE))
    slowest = np.arange(window.SIZE) * round(window.LONGEST / window.PAST * NS)
    last = int(slowest[-1])
    assert np.array_equal(window.recent(squares, slowest, last), squares)
    assert np.array_equal(window.recent(squares, slowest, 61 * NS), squares[1:])
    assert not len(window.recent(squares, slowest, last + 61 * NS))
    assert not len(window.recent(squares, np.full(window.SIZE, NEVER), 0))


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


@pytest.mark.parametrize("known", [1e-40, 1e-9, 1.0, 1e9, 1e12, 1e20, 1e40, 1e200])
@pytest.mark.parametrize("size", [0.0, 1.0, 1e20])
def test_whatever_is_known_the_factors_are_within_the_levels(known: float, size: float) -> None:
    """A message may tell a covariance that is next to nothing."""
    nu = size * np.array([1.5, -0.5, 0.8])
    p = PRIOR
    for _ in range(5):
        p, factors = learned(moved(p, 0.0), whitened(nu, known * M, R_0), LOW)
        assert p.sum() == pytest.approx(1.0) and (p >= 0.0).all()
        assert LEVELS[0] * (1 - 1e-9) <= factors.gain <= LEVELS[-1] * (1 + 1e-9)
        assert np.isfinite(factors.covariance) and factors.covariance >= factors.gain


def test_a_ratio_that_no_number_holds_teaches_nothing() -> None:
    assert whitened(np.ones(3), M, 1e-308 * np.eye(3)) is None
    assert whitened(np.full(3, 1e200), M, R_0) is None


def test_what_was_thought_impossible_begins_anew() -> None:
    sure = np.zeros(LEVELS.size)
    sure[0] = 1.0
    p, factors = learned(sure, whitened(np.full(3, 1e4), M, R_0), LOW)
    assert np.isfinite(p).all() and p.sum() == pytest.approx(1.0) and factors.gain > 0.0
