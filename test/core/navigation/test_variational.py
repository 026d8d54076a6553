"""The predicted covariance that variational Bayes infers from an innovation."""

import numpy as np
import pytest

from insdvl.navigation.process_noise.variational import variational
from insdvl.studies.evaluation.approaches import Setting
from insdvl.studies.evaluation.metrics import rmse
from insdvl.studies.evaluation.monte_carlo import TUNING, Run, Study, track_of
from insdvl.timeline.output import FoldResult

RNG = np.random.default_rng(11)
L = np.tril(RNG.normal(size=(15, 15)))
P = L @ L.T
H = RNG.normal(size=(3, 15))
R = np.diag([0.5, 1.0, 2.0])
S = H @ P @ H.T + R


def size(scale: float) -> np.ndarray:
    """An innovation of so many sigmas in each direction."""
    return np.linalg.cholesky(S) @ np.full(3, scale)


def test_it_is_the_fixed_point() -> None:
    tau, nu = 4.0, size(2.0)
    found = variational(P, H, R, nu, tau)
    K = found @ H.T @ np.linalg.inv(H @ found @ H.T + R)
    dx = K @ nu
    again = (tau * P + np.outer(dx, dx) + (np.eye(15) - K @ H) @ found) / (tau + 1.0)
    np.testing.assert_allclose(again, found, atol=1e-6 * np.abs(P).max())


@pytest.mark.parametrize("scale", [0.0, 1.0, 30.0])
def test_it_stays_a_covariance(scale: float) -> None:
    found = variational(P, H, R, size(scale), 2.0)
    np.testing.assert_array_equal(found, found.T)
    assert np.linalg.eigvalsh(found)[0] > 0.0


def test_a_large_innovation_widens_it_and_a_small_one_narrows_it() -> None:
    wide, narrow = (variational(P, H, R, size(scale), 2.0) for scale in (5.0, 0.0))
    assert np.trace(H @ wide @ H.T) > 1.5 * np.trace(H @ P @ H.T)
    assert np.trace(H @ narrow @ H.T) < np.trace(H @ P @ H.T)


def test_a_heavy_prior_keeps_the_prediction() -> None:
    np.testing.assert_allclose(variational(P, H, R, size(2.0), 1e9), P, rtol=1e-6, atol=1e-6)


def body_rmse(fold: FoldResult, run: Run) -> float:
    return rmse(track_of(fold).v_b - run.truth.v_b)


def test_the_filter_with_a_nominal_q_that_is_too_small_gains() -> None:
    run = Run(Study("varying", seed=3), TUNING, 0)
    setting, small = Setting("calibrated"), (1e-3, 1e-5)
    constant = run.fold_received(setting.filter(small), np.empty(0, np.int64), np.empty((0, 6)))
    adaptive = run.fold_received(
        setting.filter(small, source="adaptive", adaptive_form="variational", adaptive_prior=10.0),
        np.empty(0, np.int64),
        np.empty((0, 6)),
    )
    assert body_rmse(adaptive, run) < 0.8 * body_rmse(constant, run)
    nis = [np.mean([u.report.nis for u in fold.updates]) for fold in (constant, adaptive)]
    assert nis[1] < nis[0]
