"""The reset Jacobian that the filter does not apply; docs/explanation/error-state.md, 9."""

import numpy as np
import pytest
from support.steps import step_by_step

from insdvl.navigation import kalman
from insdvl.navigation.error_state import ATTITUDE, VELOCITY
from insdvl.navigation.geometry.rotation import cross_matrix


def reset_jacobian(dx: np.ndarray, *, invariant: bool) -> np.ndarray:
    """Partial of the error after the injection of dx (n,), with respect to the error before.

    exp(psi+) = exp(psi) exp(-dpsi) gives I + [dpsi x] / 2 for the attitude, and
    v_true - exp(psi+) v = dv - exp(psi+) ddv gives [ddv x] for the velocity of `invariant`.
    """
    G = np.eye(len(dx))
    G[ATTITUDE, ATTITUDE] += cross_matrix(dx[ATTITUDE]) / 2
    if invariant:
        G[VELOCITY, ATTITUDE] = cross_matrix(dx[VELOCITY])
    return G


def apply_it_after_every_update(monkeypatch: pytest.MonkeyPatch) -> None:
    """From here on every filter of this test applies the reset Jacobian."""
    correct = kalman.correct_linearly

    def with_reset(state, constants, H, K, R, innovation, workspace):  # type: ignore[no-untyped-def]
        correct(state, constants, H, K, R, innovation, workspace)
        n = len(K)
        G = reset_jacobian(K @ innovation, invariant=bool(constants[0]["invariant"]))
        P = state[0]["nav"]["P"]
        P[:n, :n] = G @ P[:n, :n] @ G.T

    step_by_step(monkeypatch)
    monkeypatch.setattr(kalman, "correct_linearly", with_reset)
    # Every update is the linear one.
    monkeypatch.setattr(kalman, "correct_body_velocity", with_reset)
