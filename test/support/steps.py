"""The steps that measurements make in the position, and the sigmas that the filter told of them."""

from typing import Any

import numpy as np
import pytest

from insdvl.arrays import Array
from insdvl.navigation import kalman
from insdvl.navigation.coordinates import turns_position
from insdvl.navigation.error_state import ATTITUDE, POSITION
from insdvl.navigation.geometry.earth import displacements
from insdvl.navigation.measurements.dvl import DvlModel


def step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on an ordinary DVL measurement is used as all others, without its own kernel."""
    monkeypatch.setattr(DvlModel, "take_in", lambda *arguments: None)


def watch_steps(monkeypatch: pytest.MonkeyPatch, *, invariant: bool = True) -> list[Array]:
    """From now on, collect (3,) of each accepted update: |step of the position| / its sigma.

    The step is K nu in the coordinates of the model, so its covariance is K S K^T; in metres it is
    J K S K^T J^T with J = [.., -[x x] (attitude), .., I (position)]. An axis that the measurement
    does not move at all has 0.
    """
    step_by_step(monkeypatch)
    correct, ratios = kalman.correct, []

    def watched(state: Any, constants: Any, prior: Any, *rest: Any, **named: Any) -> Any:
        before = state[0]["nav"]["llh"].copy()
        J = np.zeros((3, prior.K.shape[0]))
        J[:, POSITION] = np.eye(3)
        J[:, ATTITUDE] = -turns_position(state[0], invariant=invariant)
        JK = J @ prior.K
        sigma = np.sqrt(np.einsum("ia,ab,ib->i", JK, prior.S, JK))
        result = correct(state, constants, prior, *rest, **named)
        step = np.abs(displacements(before, state[0]["nav"]["llh"]))
        ratios.append(np.divide(step, sigma, out=np.zeros(3), where=step > 0.0))
        return result

    monkeypatch.setattr(kalman, "correct", watched)
    return ratios
