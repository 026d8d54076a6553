"""What a DVL and an IMU can and cannot know: heading and horizontal accelerometer biases.

Without the Earth rate nothing tells the heading, and a constant tilt looks like a bias of the
accelerometer. A filter that becomes surer of either invents information. With the Earth rate a good
gyroscope finds the heading; how fast is computed here a second time, by batch least squares.
"""

from dataclasses import replace

import numpy as np
import pytest
from records import P15
from reset import apply_it_after_every_update, reset_jacobian
from scipy.linalg import block_diag, expm, solveh_banded
from scipy.spatial.transform import Rotation

from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.events import Initial
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    ImuParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import Channel, Ramp, Trajectory, Wave
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 14_142
PERFECT = ImuModel(
    accelerometer_bias_std=0.0,
    gyroscope_bias_std=0.0,
    accelerometer_bias_walk=0.0,
    gyroscope_bias_walk=0.0,
)
STRAIGHT = Trajectory(
    duration=120.0,
    speed=Channel(1.0, ramps=(Ramp(20.0, 25.0, 1.5), Ramp(60.0, 64.0, -1.2))),
    heading=Channel(np.radians(60.0)),
    pitch=Channel(waves=(Wave(np.radians(2.0), 21.0),)),
    roll=Channel(waves=(Wave(np.radians(3.0), 17.0),)),
)


def fly(
    m: Mission, trajectory: Trajectory, *, error_state: str = "invariant", **groups: object
) -> FoldResult:
    """From the truth at the start, without a gate."""
    settings = FilterParameters(
        frame_convention="ned",
        error_state=error_state,
        imu=ImuParameters(frozen_samples=0),  # perfect readings may be equal
        gate=GateParameters(enabled=False),
        origin=OriginParameters(height=float(trajectory.h_0)),
        **groups,
    )
    C = m.initial.C_n_b[0]
    start = Initial(0, C, m.initial.p_o[0], C.T @ m.initial.v_n[0], "body")
    pings = [Dvl(t, v) for t, v in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)]
    return fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start, *pings])


def heading_variance(result: FoldResult) -> np.ndarray:
    return result.states["nav"]["P"][:, 5, 5]


# ------------------------------------------------------------------ the reset


ARM = np.array([0.5, -0.3, 0.2])


def noisy_straight_run(earth_rate: bool) -> Mission:
    return simulate(
        STRAIGHT,
        constant([0.01] * 3 + [0.001] * 3),
        seed=SEED,
        dvl=DvlModel(lever_arm=tuple(ARM)),
        earth_rate=earth_rate,
    )


def noisy_fly(m: Mission, error_state: str, earth_rate: bool) -> FoldResult:
    return fly(
        m,
        STRAIGHT,
        error_state=error_state,
        earth_rate=earth_rate,
        dvl=DvlParameters(lever_arm=tuple(ARM.tolist())),
        initial=replace(P_0, mode="set_odometry", heading_std=np.radians(10.0), velocity_std=0.2),
    )


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_the_covariance_after_an_update_is_josephs_form_and_nothing_else(error_state: str) -> None:
    invariant = error_state == "invariant"
    m = noisy_straight_run(earth_rate=True)
    result = noisy_fly(m, error_state, earth_rate=True)
    k = int(np.searchsorted(m.stamps_ns, m.dvl_stamps_ns[0]))
    last = slice(0, k + 1)
    C = m.initial.C_n_b[0]
    before = fold_arrays(
        result.filter.parameters,
        m.stamps_ns[last],
        m.f_b[last],
        m.w_ib_b[last],
        [Initial(0, C, m.initial.p_o[0], C.T @ m.initial.v_n[0], "body")],
    ).states[k]
    after, report = result.states[k], result.updates[0].report

    C_b_n, v_n, lat = before["nav"]["C_n_b"].T, before["nav"]["v_n"], np.radians(32.0)
    w_ie = 7.292115e-5 * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    R_e = 6.378e6
    w_en = np.array([v_n[1], -v_n[0], -v_n[1] * np.tan(lat)]) / R_e
    l_x = cross_matrix(ARM)
    H = np.zeros((3, 15))
    H[:, VELOCITY] = C_b_n
    H[:, ATTITUDE] = l_x @ C_b_n @ cross_matrix(w_ie + w_en)
    if not invariant:
        H[:, ATTITUDE] += C_b_n @ cross_matrix(v_n)
    H[:, GYROSCOPE_BIAS] = l_x
    # The end of a line through 25 samples, whose slope is 0 +- 0.1 rad/s^2 before.
    line = np.vander(0.01 * (np.arange(25) - 24.5), 2)
    variance = np.linalg.inv(line.T @ line / 0.001 + np.diag([1.0 / 0.1**2, 0.0]))[1, 1]
    R = 0.01 * np.eye(3) + l_x @ l_x.T * variance
    P = P15(before)
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    dx = K @ report.innovation
    joseph = (np.eye(15) - K @ H) @ P @ (np.eye(15) - K @ H).T + K @ R @ K.T

    if invariant:  # told in the axes of the heading, which the update turns
        turn = np.eye(15)
        for block in (VELOCITY, ATTITUDE, POSITION):
            turn[block, block] = Rotation.from_rotvec([0.0, 0.0, dx[5]]).as_matrix()
        joseph = turn @ joseph @ turn.T

    scale = np.sqrt(np.outer(np.diag(joseph), np.diag(joseph)))
    np.testing.assert_allclose(report.S, S, rtol=1e-6, atol=1e-9)
    assert np.abs((P15(after) - joseph) / scale).max() < 1e-7
    G = reset_jacobian(dx, invariant=invariant)
    assert np.abs((G @ joseph @ G.T - joseph) / scale).max() > 1e-4  # it could have been seen


def test_without_earth_rate_a_straight_run_never_tells_the_heading() -> None:
    m = noisy_straight_run(earth_rate=False)
    variance = heading_variance(noisy_fly(m, "invariant", earth_rate=False))
    assert variance.min() >= np.radians(10.0) ** 2 * (1.0 - 1e-9)


def test_a_reset_jacobian_would_tell_it_wrongly(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same run with the Jacobian that is left out: the covariance of the heading shrinks."""
    apply_it_after_every_update(monkeypatch)
    m = noisy_straight_run(earth_rate=False)
    variance = heading_variance(noisy_fly(m, "invariant", earth_rate=False))
    assert variance.min() < np.radians(10.0) ** 2 * 0.99


# ------------------------------------------------------------------ gyrocompassing


CRUISE = Trajectory(duration=600.0, speed=Channel(2.0), heading=Channel(np.radians(30.0)))
# A navigation-grade unit: 0.002 deg/sqrt(h), 0.005 deg/h, 5 ug/sqrt(Hz), 10 ug.
DENSITY_F, DENSITY_W, WALK_F, WALK_W = 2.5e-9, 3.4e-13, 1e-13, 1e-20
STD_V, STD_TILT, STD_HEADING, STD_F, STD_W = 0.05, 1e-3, np.radians(2.0), 1e-4, 2.4e-8
STD_DVL = 0.01


def navigation_grade(earth_rate: bool, error_state: str) -> FoldResult:
    """Perfect readings, so that the covariance is that on the true trajectory."""
    m = simulate(
        CRUISE,
        constant([0.0] * 6),
        seed=SEED,
        imu=PERFECT,
        dvl=DvlModel(noise_std=np.zeros(3)),
        earth_rate=earth_rate,
    )
    return fly(
        m,
        CRUISE,
        error_state=error_state,
        earth_rate=earth_rate,
        dvl=DvlParameters(noise_std=(STD_DVL,) * 3, lock_check=False),  # all readings are equal
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=(100.0 * DENSITY_F,) * 3,
            gyroscope_variance=(100.0 * DENSITY_W,) * 3,
            accelerometer_bias_walk=WALK_F,
            gyroscope_bias_walk=WALK_W,
        ),
        initial=replace(
            P_0,
            mode="set_odometry",
            velocity_std=STD_V,
            tilt_std=STD_TILT,
            heading_std=float(STD_HEADING),
            accelerometer_bias_std=STD_F,
            gyroscope_bias_std=STD_W,
        ),
    )


def batch_heading_variance(pings: int) -> float:
    """Variance of the heading at the last of the pings, from all unknowns at once.

    Least squares over the errors (dv_ned, psi, db_f, db_w) at the start and at each ping, of the
    prior, the dynamics between pings and the pings themselves. The normal matrix is banded; the
    last block of its inverse is the covariance.
    """
    truth = CRUISE.truth(np.zeros(1))
    C, v, f_n = truth.C_n_b[0], truth.v_n[0], truth.C_n_b[0] @ truth.f_b[0]
    lat, R_e, R_n = CRUISE.lat_0, 6.384e6, 6.353e6
    w_ie = 7.292115e-5 * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    W_v = np.array([[0, 1 / R_e, 0], [-1 / R_n, 0, 0], [0, -np.tan(lat) / R_e, 0]])
    w_en = W_v @ v
    X, one, nil = cross_matrix, np.eye(3), np.zeros((3, 3))
    A = np.block(
        [
            [X(v) @ W_v - X(2 * w_ie + w_en), -X(f_n), -C, nil],
            [-W_v, -X(w_ie + w_en), nil, -C],
            [nil, nil, nil, nil],
            [nil, nil, nil, nil],
        ]
    )
    q = np.repeat([DENSITY_F, DENSITY_W, WALK_F, WALK_W], 3)
    # Van Loan (1978): transition and process noise over one second.
    M = expm(np.block([[-A, np.diag(q)], [np.zeros((12, 12)), A.T]]))
    Phi = M[12:, 12:].T
    Q = Phi @ M[:12, 12:]
    H = np.hstack([C.T, C.T @ X(v), nil, nil])
    # The body velocity is declared: dv = C dv_b - [v x] psi.
    T = np.block([[C, -X(v)], [nil, one]])
    P_tilted = np.diag([STD_V**2] * 3 + [STD_TILT**2] * 2 + [STD_HEADING**2])
    P_0 = block_diag(T @ P_tilted @ T.T, STD_F**2 * one, STD_W**2 * one)

    unit = np.repeat([STD_V, STD_TILT, STD_F, STD_W], 3)  # scales the unknowns to order one
    Phi, Q, P_0 = Phi * unit / unit[:, None], Q / np.outer(unit, unit), P_0 / np.outer(unit, unit)
    H = H * unit
    Q_inv, n = np.linalg.inv((Q + Q.T) / 2), 12
    size = n * (pings + 1)
    bands = np.zeros((2 * n, size))  # lower form: bands[d, j] = normal[j + d, j]

    def add(row: int, column: int, block: np.ndarray) -> None:
        for i in range(n):
            for j in range(n):
                if row + i >= column + j:
                    bands[row + i - column - j, column + j] += block[i, j]

    add(0, 0, np.linalg.inv(P_0))
    for k in range(pings):
        a, b = n * k, n * (k + 1)
        add(a, a, Phi.T @ Q_inv @ Phi)
        add(b, a, -Q_inv @ Phi)
        add(b, b, Q_inv + H.T @ H / STD_DVL**2)
    heading = np.zeros(size)
    heading[size - n + 5] = 1.0
    return float(solveh_banded(bands, heading, lower=True)[size - n + 5] * unit[5] ** 2)


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_gyrocompassing_is_as_good_as_batch_least_squares(error_state: str) -> None:
    variance = heading_variance(navigation_grade(True, error_state))
    seconds = [100, 300, 600]
    expected = np.array([batch_heading_variance(pings) for pings in seconds])
    np.testing.assert_allclose(variance[[100 * t - 1 for t in seconds]], expected, rtol=0.01)
    # It does shrink, by far; and not below what the east gyroscope's bias leaves.
    limit = (STD_W / (7.292115e-5 * np.cos(CRUISE.lat_0))) ** 2
    assert limit < variance[-1] < 0.01 * STD_HEADING**2


def test_the_same_gyroscope_finds_no_heading_without_the_earth_rate() -> None:
    variance = heading_variance(navigation_grade(False, "invariant"))
    assert variance.min() >= STD_HEADING**2 * (1.0 - 1e-9)


# ------------------------------------------------------------------ tilt and accelerometer bias


LEVEL = Trajectory(
    duration=200.0,
    speed=Channel(1.0, ramps=(Ramp(40.0, 45.0, 1.0), Ramp(100.0, 104.0, -0.7))),
    heading=Channel(np.radians(-40.0)),
)


@pytest.mark.parametrize("error_state", ["invariant", "ned"])
def test_on_a_level_straight_run_tilt_and_accelerometer_bias_stay_one(error_state: str) -> None:
    """What is observed is their sum g tilt + bias; the share of the bias in it is the prior's."""
    std_f, std_tilt, g = 5e-3, 5e-4, 9.795
    m = simulate(
        LEVEL,
        constant([0.0] * 6),
        seed=SEED,
        imu=PERFECT,
        dvl=DvlModel(noise_std=np.zeros(3)),
        earth_rate=False,
    )
    result = fly(
        m,
        LEVEL,
        error_state=error_state,
        earth_rate=False,
        dvl=DvlParameters(lock_check=False),  # readings are equal
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=(1e-6,) * 3,
            gyroscope_variance=(1e-12,) * 3,
            accelerometer_bias_walk=0.0,
            gyroscope_bias_walk=0.0,
        ),
        initial=replace(
            P_0,
            mode="set_odometry",
            tilt_std=std_tilt,
            accelerometer_bias_std=std_f,
            gyroscope_bias_std=1e-8,
        ),
    )
    P = result.states["nav"]["P"][:, ACCELEROMETER_BIAS, ACCELEROMETER_BIAS]
    floor = 1.0 / (1.0 / std_f**2 + 1.0 / (g * std_tilt) ** 2)
    horizontal = P[:, [0, 1], [0, 1]]
    assert horizontal.min() >= floor * (1.0 - 2e-3)
    np.testing.assert_allclose(horizontal[-1], floor, rtol=0.02)
    assert P[-1, 2, 2] < 0.1 * std_f**2  # the vertical one is told from gravity
