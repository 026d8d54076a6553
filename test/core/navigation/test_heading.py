"""The heading sensor: its Jacobian, its wrap, its start, its refusals, and the heading with it."""

from typing import Any

import numpy as np
import pytest
from places import moved, put
from scipy.spatial.transform import Rotation
from told import TOLD

from insdvl.navigation import coordinates
from insdvl.navigation.error_state import ATTITUDE, GYROSCOPE_BIAS, POSITION, VELOCITY
from insdvl.navigation.events import NS, refusal
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.base import Turn
from insdvl.navigation.measurements.heading import Heading, wrapped
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.timeline.state_file import decode, encode

NO_TURN = Turn(np.zeros(3), np.zeros((3, 3)))
HEADING = ATTITUDE.stop - 1
ATTITUDE_OF_TEST = Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix()


def parameters(**changes: Any) -> FilterParameters:
    values: dict[str, Any] = {
        "frame_convention": "ned",
        "heading.topic": "heading",
        "heading.interval": 0.0,
    }
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    return build(FilterParameters, TOLD | values | changes)


def about_down(angle: float) -> np.ndarray:
    return Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()


def state_at(filter_: Filter, x: np.ndarray, C: np.ndarray = ATTITUDE_OF_TEST) -> Any:
    """A record whose error against a nominal state is x, by the definitions of the error state."""
    state, invariant = filter_.empty(), filter_.vehicle.invariant
    nav, v_n = state[0]["nav"], np.array([1.0, -0.4, 0.2])
    heading = about_down(x[HEADING])
    tilt = Rotation.from_rotvec([*x[ATTITUDE][:2], 0.0]).as_matrix()
    turn = heading @ tilt if invariant else Rotation.from_rotvec(x[ATTITUDE]).as_matrix()
    nav["C_n_b"] = turn @ C
    nav["v_n"] = heading @ (tilt @ v_n + x[VELOCITY]) if invariant else v_n + x[VELOCITY]
    put(nav, [50.0, -20.0, 12.0], [49.2, -20.7, 11.0])
    x_n = coordinates.from_reference(nav)
    moves = heading @ (tilt @ x_n + x[POSITION]) - x_n if invariant else x[POSITION]
    nav["llh"] = moved(nav["llh"], moves)
    nav["optional"][: len(x) - 15] = 0.02 + x[15:]
    nav["P"][: filter_.n, : filter_.n] = np.eye(filter_.n) * 1e-4
    nav["time_ns"], nav["initialised"] = NS, 1
    return state


# ------------------------------------------------------------------ the model


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
@pytest.mark.parametrize("roll_pitch", [False, True])
@pytest.mark.parametrize("error_std", [0.0, 0.02])
@pytest.mark.parametrize("rpy", [(0.1, -0.2, 3.1), (-1.2, 1.3, 0.4)])
def test_the_jacobian_is_the_derivative_of_h(
    error_state: str, roll_pitch: bool, error_std: float, rpy: tuple[float, ...]
) -> None:
    """Where z is what is predicted: at a large turn that of roll and pitch is not the identity."""
    settings = parameters(
        error_state=error_state, heading__roll_pitch=roll_pitch, heading__error_std=error_std
    )
    filter_, C = Filter(settings), rotation_from_rpy(np.array(rpy))
    model = filter_.models["heading"]
    assert filter_.n == (15 if error_std == 0.0 else 16)
    event = Heading(NS, about_down(0.02 if error_std else 0.0) @ C)

    def linearised(x: np.ndarray) -> Any:
        return model.linearise(state_at(filter_, x, C), event, NO_TURN)

    zero = np.zeros(filter_.n)
    nominal = linearised(zero)
    assert nominal.H.shape == (model.rows, filter_.n)
    np.testing.assert_allclose(nominal.z_minus_h, 0.0, atol=1e-12)
    measured = np.empty((model.rows, filter_.n))
    for i in range(filter_.n):
        x = zero.copy()
        x[i] = 1e-5
        measured[:, i] = (linearised(-x).z_minus_h - linearised(x).z_minus_h) / 2e-5
    np.testing.assert_allclose(nominal.H, measured, atol=1e-8)


def test_a_heading_error_of_any_size_is_linear() -> None:
    """With `invariant`, the innovation is the heading error, and a correction by it leaves none."""
    filter_ = Filter(parameters(heading__error_std=0.0))
    for angle in (0.01, 1.0, -2.5, 3.1):
        state = state_at(filter_, np.zeros(15))
        told = Heading(NS, about_down(angle) @ ATTITUDE_OF_TEST)
        model = filter_.models["heading"]
        found = model.linearise(state, told, NO_TURN)
        assert found.z_minus_h[0] == pytest.approx(angle, abs=1e-12)
        correction = np.zeros(15)
        correction[HEADING] = found.z_minus_h[0]
        coordinates.inject(state[0], filter_.constants[0], correction)
        assert abs(model.linearise(state, told, NO_TURN).z_minus_h[0]) < 1e-12


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(np.pi, np.pi), (-np.pi, np.pi), (3.2, 3.2 - 2 * np.pi), (-6.2, 2 * np.pi - 6.2), (0.5, 0.5)],
)
def test_an_innovation_is_within_half_a_turn(angle: float, expected: float) -> None:
    assert wrapped(angle) == pytest.approx(expected, abs=1e-12)
    assert -np.pi < wrapped(angle) <= np.pi


def test_an_unknown_covariance_takes_the_sigma_of_the_parameters() -> None:
    told = np.diag([0.03, 0.04, 0.05]) ** 2
    for whose, P_psi, expected in (
        ("message", None, 0.02),
        ("message", told, 0.05),
        ("message", np.diag([1e-4, 1e-4, 0.0]), 0.02),
        ("largest", told, 0.05),
        ("largest", told * 1e-6, 0.01),
        ("parameters", told, 0.02),
    ):
        settings = parameters(
            heading__covariance=whose, heading__noise_std=0.02, heading__noise_floor=0.01
        )
        model = Filter(settings).models["heading"]
        level = state_at(Filter(settings), np.zeros(16), np.eye(3))
        R = model.linearise(level, Heading(NS, np.eye(3), P_psi), NO_TURN).R
        assert np.sqrt(R[0, 0]) == pytest.approx(expected), whose


def test_a_pitched_vehicle_has_the_sensors_tilt_in_its_yaw() -> None:
    """sigma^2 = sigma_yaw^2 + tan^2(pitch) sigma_tilt^2, and no limit at the vertical."""
    settings = parameters(heading__noise_std=0.02, heading__roll_pitch_std=0.01)
    filter_ = Filter(settings)
    for pitch in (0.0, 0.5, -1.2, np.pi / 2):
        C = rotation_from_rpy(np.array([0.3, pitch, 1.0]))
        found = filter_.models["heading"].linearise(
            state_at(filter_, np.zeros(16), C), Heading(NS, C), NO_TURN
        )
        assert np.isfinite(found.R).all() and np.isfinite(found.H).all()
        if abs(pitch) < 1.5:
            expected = 0.02**2 + np.tan(pitch) ** 2 * 0.01**2
            assert found.R[0, 0] == pytest.approx(expected)
        else:
            assert found.R[0, 0] > 1e4  # it tells nothing


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
@pytest.mark.parametrize("roll_pitch", [False, True])
def test_a_restart_takes_the_heading_from_the_measurement_alone(
    error_state: str, roll_pitch: bool
) -> None:
    """Body velocity and position stay, and the error of the sensor is now one of the heading."""
    settings = parameters(error_state=error_state, heading__roll_pitch=roll_pitch)
    filter_ = Filter(settings)
    model, state = filter_.models["heading"], state_at(filter_, np.zeros(16))
    s, nav = state[0], state[0]["nav"]
    v_b, place = nav["C_n_b"].T @ nav["v_n"], nav["llh"].copy()
    body = coordinates.body_velocity_jacobian(
        nav["C_n_b"], nav["v_n"], invariant=filter_.vehicle.invariant, n=16
    )
    before = body @ nav["P"][:16, :16] @ body.T
    innovation = np.array([0.1, -0.2, 2.0])[3 - model.rows :]
    R = np.eye(model.rows) * 0.01**2
    model.restart(s, innovation, R)
    P = nav["P"][:16, :16]
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0.0
    np.testing.assert_allclose(nav["C_n_b"].T @ nav["v_n"], v_b, atol=1e-12)
    np.testing.assert_array_equal(nav["llh"], place)
    turn = attitude(nav["C_n_b"], ATTITUDE_OF_TEST, error_state)
    np.testing.assert_allclose(turn[3 - model.rows :], innovation, atol=1e-12)
    assert P[HEADING, HEADING] == pytest.approx(2.0**2 + 0.01**2 + 1e-4)
    assert P[HEADING, 15] == pytest.approx(-1e-4)
    body = coordinates.body_velocity_jacobian(
        nav["C_n_b"], nav["v_n"], invariant=filter_.vehicle.invariant, n=16
    )
    np.testing.assert_allclose(body @ P @ body.T, before, atol=1e-9)


def attitude(C: np.ndarray, before: np.ndarray, error_state: str) -> np.ndarray:
    nav = {"C_n_b": before}
    return coordinates.attitude_error(nav, C, invariant=error_state == "invariant")


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_a_doubt_leaves_body_velocity_and_position(error_state: str) -> None:
    filter_ = Filter(parameters(error_state=error_state, initial__gyroscope_bias_std=0.013))
    model, state = filter_.models["heading"], state_at(filter_, np.zeros(16))
    s, nav, invariant = state[0], state[0]["nav"], filter_.vehicle.invariant
    J = np.zeros((6, 16))
    J[:3] = coordinates.body_velocity_jacobian(nav["C_n_b"], nav["v_n"], invariant=invariant, n=16)
    J[3:, POSITION] = np.eye(3)
    J[3:, ATTITUDE] = -coordinates.turns_position(s, invariant=invariant)
    # No more than what makes the bias as uncertain as at the start.
    for seconds, of_bias in ((100.0, 0.004), (10.0, 0.012)):
        nav["P"][GYROSCOPE_BIAS, GYROSCOPE_BIAS] = 0.005**2 * np.eye(3)
        before = nav["P"][:16, :16].copy()
        model.inflate(s, np.array([0.4]), seconds)
        grown = nav["P"][:16, :16] - before
        assert grown[HEADING, HEADING] == pytest.approx(0.16)
        assert np.trace(grown[GYROSCOPE_BIAS, GYROSCOPE_BIAS]) == pytest.approx(of_bias**2)
        np.testing.assert_allclose(J @ grown @ J.T, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("event", "reason"),
    [
        (Heading(0, np.full((3, 3), np.nan)), "not_finite"),
        (Heading(0, np.eye(3) * 1.1), "out_of_range"),
        (Heading(0, np.eye(3), np.full((3, 3), np.inf)), "not_finite"),
        (Heading(0, np.eye(3), np.eye(3)), None),
    ],
)
def test_numbers_that_cannot_be_used(event: Heading, reason: str | None) -> None:
    assert refusal(event) == reason


def test_a_state_file_keeps_the_error_of_the_sensor() -> None:
    settings = parameters()
    filter_ = Filter(settings)
    state = state_at(filter_, np.zeros(16), rotation_from_rpy(np.array([0.1, 0.2, 0.3])))
    nav = state[0]["nav"]
    nav["start_ns"], nav["lat_0"], nav["lon_0"], nav["h_0"] = 0, 0.5, 0.5, 0.0
    state[0]["channels"]["imu_ns"] = NS
    record = decode(encode(state[0], settings), Filter(settings))
    assert record[0]["nav"]["optional"][0] == 0.02
    assert record.tobytes() == state.tobytes()
