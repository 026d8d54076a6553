"""After a long outage one measurement moves the state far: it must leave what its sigma says."""

from itertools import pairwise

import numpy as np
import pytest
from records import P15
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl.navigation import coordinates, kalman
from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.error_state import ATTITUDE, VELOCITY
from insdvl.navigation.events import Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.base import Linearised, Turn
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import DvlParameters, FilterParameters, GateParameters

DVL_STD = 0.1  # m/s
#: Nothing is refused, however large the correction is.
WITHOUT_GATE = FilterParameters(
    dvl=DvlParameters(max_speed=1000.0), gate=GateParameters(enabled=False)
)
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
    filter_ = Filter(WITHOUT_GATE)
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


# ------------------------------------------------------------------ psi x dv


def corrected(filter_: Filter, P: np.ndarray, v_b: np.ndarray) -> np.void:
    state = drifted(filter_, P)
    w = state[0]["nav"]["b_w"].copy()
    assert filter_.update(state, Dvl(1, v_b), w, 1 / 25).accepted
    return state[0].copy()


def distance(a: np.void, b: np.void) -> float:
    """The larger of the steps of body velocity, in sigmas of R, and of attitude, in its own."""
    a, b = a["nav"], b["nav"]
    v = np.linalg.norm(b["C_n_b"].T @ b["v_n"] - a["C_n_b"].T @ a["v_n"]) / DVL_STD
    psi = Rotation.from_matrix(b["C_n_b"] @ a["C_n_b"].T).as_rotvec()
    return float(max(v, np.sqrt(psi @ np.linalg.solve(a["P"][ATTITUDE, ATTITUDE], psi))))


@pytest.mark.parametrize("direction", range(3))
@pytest.mark.parametrize("tilt", [0.05, 0.3])
def test_the_state_is_continuous_in_the_measurement(tilt: float, direction: int) -> None:
    """The largest step of a sweep vanishes as the sweep is refined there; a jump would stay."""
    filter_ = Filter(WITHOUT_GATE)
    P = prior(filter_, tilt, seconds=6.0)
    along = np.random.default_rng(direction).standard_normal(3)
    along /= np.linalg.norm(along)
    low, high, largest = 0.0, 12.0, np.inf  # m/s
    for points in (200, 11, 11, 11):
        sizes = np.linspace(low, high, points)
        states = [corrected(filter_, P, np.array([1.5, 0.0, 0.0]) + s * along) for s in sizes]
        steps = [distance(*pair) for pair in pairwise(states)]
        k = int(np.argmax(steps))
        largest, low, high = steps[k], sizes[k], sizes[k + 1]
    assert largest < 0.005


def test_where_the_product_is_small_the_update_is_linear() -> None:
    """Bit by bit."""
    filter_ = Filter(WITHOUT_GATE)
    state = drifted(filter_, prior(filter_, 0.001, seconds=6.0))
    once = state.copy()
    event, turn = Dvl(1, np.array([1.6, 0.1, -0.1])), Turn(np.zeros(3), np.zeros((3, 3)))
    for s, iterate in ((state, True), (once, False)):

        def relinearise(s: np.ndarray = s) -> Linearised:
            return filter_.models["dvl"].linearise(s, event, turn)

        at = relinearise()
        now = kalman.innovate(s[0]["nav"]["P"], at.z_minus_h, at.H, at.R)
        kalman.correct(
            s, filter_.constants, now, relinearise, filter_.vehicle.workspace, iterate=iterate
        )
    assert state.tobytes() == once.tobytes()


def test_the_moments_of_the_product_are_those_of_samples() -> None:
    rng = np.random.default_rng(3)
    A, samples = rng.standard_normal((15, 15)), 400_000
    P = A @ A.T
    mean, covariance = np.empty(3), np.empty((3, 3))
    kalman._product_moments(P, mean, covariance)
    x = rng.standard_normal((samples, 15)) @ A.T
    w = np.cross(x[:, ATTITUDE] * [1.0, 1.0, 0.0], x[:, VELOCITY])
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(w.mean(axis=0) / scale, mean / scale, atol=5.0 / np.sqrt(samples))
    relative = np.outer(scale, scale)
    np.testing.assert_allclose(np.cov(w.T) / relative, covariance / relative, atol=0.03)


def test_the_body_velocity_is_linear_in_what_is_corrected() -> None:
    """A large error of all states, with dv = R_t dv': the prediction moves by H dv'."""
    filter_ = Filter(FilterParameters())
    state, rng = drifted(filter_, np.eye(filter_.n)), np.random.default_rng(4)
    event, turn = Dvl(1, np.array([1.6, 0.1, -0.1])), Turn(np.zeros(3), np.zeros((3, 3)))
    model = filter_.models["dvl"]
    before = model.linearise(state, event, turn)
    dx = rng.standard_normal(filter_.n) * 0.5
    dv = 20.0 * rng.standard_normal(3)
    dx[VELOCITY] = Rotation.from_rotvec(dx[ATTITUDE] * [1.0, 1.0, 0.0]).as_matrix() @ dv
    coordinates.inject(state[0], filter_.constants[0], dx)
    moved = before.z_minus_h - model.linearise(state, event, turn).z_minus_h
    np.testing.assert_allclose(moved, before.H[:, VELOCITY] @ dv, atol=1e-9)


def test_gain_and_innovation_left_agree_after_a_large_correction() -> None:
    """Nothing is left to iterate: what is left of 40 m/s is what a linear h leaves, little."""
    filter_ = Filter(WITHOUT_GATE)
    P = prior(filter_, 0.3, seconds=6.0)
    s = corrected(filter_, P, np.array([25.0, 30.0, -5.0]))
    v_b = s["nav"]["C_n_b"].T @ s["nav"]["v_n"]
    np.testing.assert_allclose(v_b, [25.0, 30.0, -5.0], atol=DVL_STD)
    J = body_velocity_jacobian(s["nav"]["C_n_b"], s["nav"]["v_n"], invariant=True, n=filter_.n)
    assert np.linalg.eigvalsh(J @ P15(s) @ J.T)[-1] < 1.01 * DVL_STD**2
