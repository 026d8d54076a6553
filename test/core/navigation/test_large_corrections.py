"""After a long outage one measurement moves the state far: it must leave what its sigma says."""

import numpy as np
import pytest
from records import P15
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl.navigation.error_state import ATTITUDE, VELOCITY, body_velocity_jacobian
from insdvl.navigation.events import Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters, GateParameters

DVL_STD = 0.1  # m/s
RUNS = 200


def drifted(filter_: Filter, P: np.ndarray) -> np.ndarray:
    """A state that has had no DVL for long; its tilt has turned gravity into velocity."""
    state = filter_.empty()
    initial = Initial(
        0, rotation_from_rpy(np.array([0.1, -0.2, 2.0])), np.zeros(3), np.array([1.5, 0, 0]), "body"
    )
    filter_.initialise(state, initial, 0, np.zeros(3))
    state[0]["nav"]["P"][:15, :15] = P
    return state


def prior(filter_: Filter, tilt: float, seconds: float) -> np.ndarray:
    """P of a tilt that has accelerated the velocity for so long, along with other errors."""
    n = filter_.n
    P = np.eye(n) * 1e-8
    P[ATTITUDE, ATTITUDE] = np.eye(3) * tilt**2
    grown = np.zeros((3, 3))
    grown[0, 1], grown[1, 0] = -9.8 * seconds, 9.8 * seconds
    P[VELOCITY, ATTITUDE] = grown * tilt**2
    P[ATTITUDE, VELOCITY] = P[VELOCITY, ATTITUDE].T
    P[VELOCITY, VELOCITY] = grown @ grown.T * tilt**2 + np.eye(3) * 0.3**2
    return P


@pytest.mark.parametrize("tilt", [0.01, 0.3])
def test_the_body_velocity_is_as_good_as_its_covariance(tilt: float) -> None:
    filter_ = Filter(FilterParameters(gate=GateParameters(enabled=False)))
    P = prior(filter_, tilt, seconds=6.0)
    L = np.linalg.cholesky(P)
    rng = np.random.default_rng(11)
    total, again = 0.0, 0.0
    for _ in range(RUNS):
        state = drifted(filter_, P)
        s = state[0]
        error = L @ rng.standard_normal(filter_.n)
        turn = Rotation.from_rotvec(error[ATTITUDE]).as_matrix()
        C = turn @ s["nav"]["C_n_b"]
        v_n = turn @ s["nav"]["v_n"] + error[VELOCITY]
        v_b = C.T @ v_n
        w = s["nav"]["b_w"].copy()
        report = filter_.update(state, Dvl(1, v_b + DVL_STD * rng.standard_normal(3)), w, 1 / 25)
        assert report.accepted
        J = body_velocity_jacobian(s["nav"]["C_n_b"], s["nav"]["v_n"], invariant=True, n=filter_.n)
        e = v_b - s["nav"]["C_n_b"].T @ s["nav"]["v_n"]
        total += e @ np.linalg.solve(J @ P15(s) @ J.T, e)
        # The next one, of the same velocity, is expected.
        again += filter_.update(
            state, Dvl(2, v_b + DVL_STD * rng.standard_normal(3)), w, 1 / 25
        ).nis
    low, high = chi2.ppf([0.0005, 0.9995], 3 * RUNS)
    assert low < total < high
    assert again < chi2.ppf(0.9995, 3 * RUNS)
