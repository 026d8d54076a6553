"""A log that measures the velocity along one axis: the others are known by the IMU alone."""

import math
from dataclasses import replace

import numpy as np
import pytest

from insdvl.arrays import Records
from insdvl.navigation import kalman
from insdvl.navigation.coordinates import attitude_error, body_velocity_jacobian
from insdvl.navigation.error_state import ATTITUDE, CORE, VELOCITY
from insdvl.navigation.filter import Filter
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.navigation.measurements.base import Turn
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import BASELINE
from insdvl.timeline.recorded import fold_arrays

#: Noise per sample of a phone's IMU at 100 Hz, of specific force and angular rate.
ACCELEROMETER, GYROSCOPE = 0.02, 0.002
SPEED_STD = 0.05
GRAVITY = 9.8


def driven(trajectory: str, seconds: float, gyroscope_bias: float, seed: int) -> Mission:
    """On the way from the first sample on, with biases that are drawn from their sigmas."""
    return simulate(
        BASELINE[trajectory],
        constant(np.repeat([ACCELEROMETER, GYROSCOPE], 3) ** 2),
        seed=seed,
        duration=seconds,
        imu=ImuModel(accelerometer_bias_std=0.05, gyroscope_bias_std=gyroscope_bias),
        dvl=DvlModel(rate=10.0, noise_std=(SPEED_STD,) * 3),
    )


def navigated(mission: Mission, gyroscope_bias: float) -> Records:
    """The states of a filter that is told all of it, and the speed along x only."""
    default = FilterParameters()
    parameters = replace(
        default,
        frame_convention="ned",
        initial=replace(
            default.initial, accelerometer_bias_std=0.05, gyroscope_bias_std=gyroscope_bias
        ),
        process_noise=replace(
            default.process_noise,
            source="constant",
            accelerometer_variance=(ACCELEROMETER**2,) * 3,
            gyroscope_variance=(GYROSCOPE**2,) * 3,
        ),
        dvl=replace(default.dvl, noise_std=(SPEED_STD,) * 3),
    )
    pings = [
        Dvl(int(stamp_ns), v_d * [1.0, 0.0, 0.0], measured=(True, False, False))
        for stamp_ns, v_d in zip(mission.dvl_stamps_ns, mission.v_d, strict=True)
    ]
    return fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, pings).states


@pytest.mark.parametrize("measured", [(True, False, False), (False, True, True)])
def test_no_direction_becomes_less_known_by_a_measurement(measured: tuple[bool, ...]) -> None:
    """Also where tilt and velocity are so uncertain that their product counts."""
    filter_, rng = Filter(FilterParameters()), np.random.default_rng(1)
    model, turn = filter_.models["dvl"], Turn(np.zeros(3), np.zeros((3, 3)))
    for _ in range(20):
        state = filter_.empty()
        nav = state[0]["nav"]
        nav["lat_0"], nav["lon_0"], nav["h_0"] = 0.5, 0.0, 0.0
        nav["C_n_b"], nav["v_n"], nav["initialised"] = np.eye(3), [10.0, 0.0, 0.0], 1
        A = rng.standard_normal((CORE, CORE))
        sigma = np.ones(CORE)
        sigma[VELOCITY], sigma[ATTITUDE] = 100.0, 0.3
        before = sigma[:, None] * (A @ A.T / CORE) * sigma
        nav["P"][:CORE, :CORE] = before
        event = Dvl(1, np.where(measured, [10.0, 0.0, 0.0], 0.0), measured=measured)
        now = kalman.innovate(nav["P"], *model.linearise(state, event, turn))
        kalman.correct(
            state,
            filter_.constants,
            now,
            lambda state=state, event=event: model.linearise(state, event, turn),
            filter_.vehicle.workspace,
            iterate=True,
        )
        # The axes turn with the estimate, which moves no eigenvalue.
        for block in VELOCITY, ATTITUDE:
            less = np.linalg.eigvalsh(before[block, block])
            left = np.linalg.eigvalsh(nav["P"][block, block])
            assert (left <= less * (1.0 + 1e-9)).all()
        J = body_velocity_jacobian(nav["C_n_b"], nav["v_n"], invariant=True, n=CORE)
        known = np.diagonal(J @ nav["P"][:CORE, :CORE] @ J.T)[list(measured)]
        assert (known <= 0.1**2).all()  # dvl.noise_std


def test_a_mems_is_as_good_as_it_says() -> None:
    """Started under way: what tells the tilt are the accelerations along one axis."""
    runs, bias = 6, 5e-4
    seconds = np.arange(20, 81, 20)
    of_velocity = np.zeros(len(seconds))
    for seed in range(runs):
        mission = driven("lawn_mower", float(seconds[-1]), bias, seed)
        states = navigated(mission, bias)
        for i, k in enumerate(100 * seconds - 1):
            s, C_true = states[k], mission.truth.C_n_b[k]
            C, P = s["nav"]["C_n_b"], s["nav"]["P"][:CORE, :CORE]
            J = body_velocity_jacobian(C, s["nav"]["v_n"], invariant=True, n=CORE)
            error = C_true.T @ mission.truth.v_n[k] - C.T @ s["nav"]["v_n"]
            of_velocity[i] += error @ np.linalg.solve(J @ P @ J.T, error)
    assert (of_velocity < exceeded(3 * runs, 1e-3)).all()


@pytest.mark.parametrize("trajectory", ["straight", "lawn_mower"])
def test_a_roll_that_nothing_holds_is_uncertain(trajectory: str) -> None:
    """With the gyroscope of a phone the vehicle may lie on its side: sigmas, no infinity."""
    bias, seconds = 0.005, 200.0
    mission = driven(trajectory, seconds, bias, 1)
    states = navigated(mission, 2.0 * bias)
    nav = states["nav"]
    for name in ("P", "C_n_b", "v_n", "llh", "b_f", "b_w"):
        assert np.isfinite(nav[name][nav["initialised"] == 1]).all()
    last, P = nav[-1], nav[-1]["P"]
    tilt = np.sqrt(np.linalg.eigvalsh(P[ATTITUDE, ATTITUDE][:2, :2])[-1])
    error = attitude_error(last, mission.truth.C_n_b[-1], invariant=True)[:2]
    assert tilt > 0.2 and np.linalg.norm(error) < 6.0 * tilt
    # No more than what the bias that is told makes of gravity, if nothing tells it.
    falls = GRAVITY * 2.0 * bias * seconds**2 / 2.0
    assert math.sqrt(np.linalg.eigvalsh(P[VELOCITY, VELOCITY])[-1]) < 3.0 * falls
