"""Closed forms: unbiased where their model holds, with the degrees of freedom that they state."""

import numpy as np
import pytest
from numpy.polynomial import legendre

from insdvl.studies.training.dataset import VARIANCES
from insdvl.tuner.features.closed_form import (
    bayes_rmse,
    degree_5,
    first_differences,
    linear,
    posterior_mean,
)
from insdvl.tuner.features.detrend import polynomials, residual_variances

M, N = 20_000, 200
FORMS = {linear: N - 2, first_differences: 2.0 * N / 3.0, degree_5: N - 6}


@pytest.fixture(scope="module")
def white() -> np.ndarray:
    return np.random.default_rng(0).standard_normal((M, N))


@pytest.mark.parametrize("form", FORMS)
def test_unbiased_with_the_degrees_of_freedom_that_are_stated(form, white):
    sigma = np.sqrt(2.0 / FORMS[form])
    relative = form(0.3 * white) / 0.09 - 1.0
    assert abs(relative.mean()) < 5.0 * sigma / np.sqrt(M)
    assert relative.std() == pytest.approx(sigma, rel=0.03)  # six sigmas of a std


@pytest.mark.parametrize(("form", "degree"), [(linear, 1), (degree_5, 5)])
def test_blind_to_the_motion_that_is_modelled(form, degree, white):
    windows = white[:50]
    motion = legendre.legval(np.linspace(-1.0, 1.0, N), np.arange(1.0, degree + 2.0))
    np.testing.assert_allclose(form(windows + motion), form(windows), rtol=1e-11)
    beyond = 100.0 * np.linspace(-1.0, 1.0, N) ** (degree + 1)
    assert (form(windows + beyond) > 2.0 * form(windows)).all()


@pytest.mark.parametrize("form", FORMS)
def test_whatever_the_unit_and_the_offset(form, white):
    windows = white[:50]
    np.testing.assert_array_equal(form(2.0**-30 * windows), 2.0**-60 * form(windows))
    np.testing.assert_allclose(form(windows + 1e3), form(windows), rtol=1e-9)
    assert form(np.full((2, N), -9.80665)).tolist() == [0.0, 0.0]


def test_the_residual_is_that_of_least_squares(white):
    for degree in (0, 1, 3, 5):
        basis = legendre.legvander(np.linspace(-1.0, 1.0, N), degree)
        fitted = basis @ np.linalg.lstsq(basis, white[:9].T, rcond=None)[0]
        expected = ((white[:9].T - fitted) ** 2).sum(axis=0) / (N - 1 - degree)
        np.testing.assert_allclose(residual_variances(white[:9], degree), expected, rtol=1e-11)


@pytest.mark.parametrize("n", [8, 199, 2000])
def test_polynomials_are_orthonormal(n):
    basis = np.vstack([np.full(n, n**-0.5), polynomials(n, 5)])
    np.testing.assert_allclose(basis @ basis.T, np.eye(6), atol=1e-13)


def test_the_posterior_mean_is_at_the_bayes_limit():
    """A Monte Carlo over examples against the sum over quantiles; neither is below the other."""
    rng = np.random.default_rng(5)
    q = np.repeat(VARIANCES, 1000)
    windows = np.sqrt(q)[:, None] * rng.standard_normal((q.size, N))
    error = posterior_mean(windows, VARIANCES) - q
    assert np.sqrt(np.mean(error**2)) == pytest.approx(bayes_rmse(VARIANCES, N - 6), rel=0.04)
    assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean((degree_5(windows) - q) ** 2))


def test_the_posterior_mean_stays_within_the_grid():
    rng = np.random.default_rng(6)
    for sigma, expected in (1e-4, VARIANCES[0]), (100.0, VARIANCES[-1]):
        answers = posterior_mean(sigma * rng.standard_normal((5, N)), VARIANCES)
        np.testing.assert_allclose(answers, expected, rtol=1e-9)
    assert posterior_mean(np.zeros((1, N)), VARIANCES)[0] == pytest.approx(VARIANCES[0])


def test_the_limit_falls_with_the_degrees_of_freedom_and_to_zero_where_q_is_certain():
    assert bayes_rmse(VARIANCES, 200) < bayes_rmse(VARIANCES, 194) < bayes_rmse(VARIANCES, 50)
    assert bayes_rmse(VARIANCES[:1], 194) == pytest.approx(0.0, abs=1e-15)
    # Far apart, a few values are told apart without error.
    assert bayes_rmse(np.array([0.001, 1.0]), 194) < 1e-12


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e71])
@pytest.mark.parametrize("form", FORMS)
def test_a_value_that_cannot_be_used_is_refused(form, value):
    windows = np.ones((3, N))
    windows[2, 5] = value
    with pytest.raises(ValueError, match="window 2 has"):
        form(windows)


def test_a_window_that_the_polynomial_passes_through_is_refused():
    with pytest.raises(ValueError, match="N >= 7, got "):
        degree_5(np.zeros((1, 6)))
