"""A wrong heading turns the whole solution, and nothing else, whatever its size.

Without the Earth's rotation nothing has a direction in the horizontal plane but the heading itself.
Two filters whose headings differ by an angle, and which are given the same samples and the same
measurements of velocity and depth, stay apart by a rotation R about the vertical through the start:

    C -> R C,  v -> R v,  x -> R x,  P -> T P T^T  (R in the blocks of velocity, attitude, position)

and all else is equal: biases, optional states, innovations. P itself is the same in the axes of the
heading. A start with another heading does so in any coordinates where nothing is told in navigation
axes. A heading that is corrected underway does so with `invariant` only.

Tolerances. The Earth is round, so a rotation about the start is one only nearly. On the equator,
within 60 m of it, gravity changes by 0.05 (60 m / R)^2 = 5e-12 m/s^2. A step is metres by a radius,
which differs north and east by 0.7 % and grows with the height, by 1 m at most: 60 m * 0.007 / R =
7e-8 m. That is 1e-9 of the path, and so of P. A correction underway moves the vehicle by up to
120 m at its own height, and the path was measured at that between start and vehicle, 0.5 m off:
1e-5 m and 2e-7 of P, by which corrections of up to 5 m/s differ by 1e-6 m/s.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.navigation import coordinates
from insdvl.navigation.coordinates import from_reference
from insdvl.navigation.error_state import ATTITUDE, POSITION, VELOCITY
from insdvl.navigation.events import Imu, Initial
from insdvl.navigation.measurements.depth import Depth, DepthParameters
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.measurements.report import UpdateReport
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    ImuParameters,
    OriginParameters,
)
from insdvl.simulation.grades import GRADES
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.motion import Channel, Ramp, Trajectory, Wave
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.studies.consistency.flights import process_noise_of
from insdvl.timeline.fold import Fold
from insdvl.timeline.recorded import fold_arrays

SEED = 94_000
MEMS = GRADES["mems"]
#: Motion in every axis, and 20 s without a DVL: the correction behind it is large.
TRAJECTORY = Trajectory(
    duration=60.0,
    speed=Channel(1.0, waves=(Wave(0.3, 9.0),)),
    heading=Channel(0.5, slope=0.05, ramps=(Ramp(8.0, 12.0, 1.5),)),
    pitch=Channel(waves=(Wave(0.05, 7.0),)),
    roll=Channel(-0.1, waves=(Wave(0.15, 5.0),)),
    lat_0=0.0,
    lon_0=0.0,
    h_0=-30.0,
)
OUTAGE = (20.0, 40.0)
UNDERWAY = 3000  # sample, in the outage
IMU_MOUNT, IMU_ARM = (0.1, -0.4, 2.0), (0.4, -0.1, 0.2)
DVL_MOUNT, DVL_ARM = (0.05, 0.1, -0.8), (-0.9, 0.3, 0.6)
DEPTH_ARM = (-0.5, 0.2, 0.3)


def parameters(model: str) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        error_state=model,
        earth_rate=False,
        imu=ImuParameters(mount=IMU_MOUNT, lever_arm=IMU_ARM),
        dvl=DvlParameters(
            mount=DVL_MOUNT,
            lever_arm=DVL_ARM,
            bias_model="gauss_markov",
            bias_std=(0.03, 0.04, 0.05),
            mount_std=(0.01, 0.02, 0.03),
        ),
        depth=DepthParameters(topic="depth", lever_arm=DEPTH_ARM),
        process_noise=process_noise_of(MEMS),
        initial=replace(
            P_0,
            mode="set_odometry",
            heading_std=1.0,
            accelerometer_bias_std=MEMS.accelerometer_bias,
            gyroscope_bias_std=MEMS.gyroscope_bias,
        ),
        origin=OriginParameters(latitude_deg=0.0, longitude_deg=0.0, height=-30.0),
    )


def about_down(angle: float) -> np.ndarray:
    return Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()


@cache
def mission() -> Mission:
    return simulate(
        TRAJECTORY,
        constant(MEMS.variances()),
        seed=SEED,
        imu=MEMS.imu(),
        dvl=DvlModel(mount=DVL_MOUNT, lever_arm=DVL_ARM, outages=OUTAGE),
        earth_rate=False,
    )


@dataclass(frozen=True)
class Solution:
    """States behind `UNDERWAY` (N,), their covariances (N, n, n), and the updates."""

    nav: np.ndarray
    P: np.ndarray
    reports: list[UpdateReport]


@cache
def solution(model: str, at_start: float = 0.0, underway: float = 0.0) -> Solution:
    """The filter with a heading that differs from the start on, and by a correction underway."""
    flown = mission()
    truth, C_b_i = flown.initial, Rotation.from_euler("xyz", IMU_MOUNT).as_matrix()
    initial = Initial(
        stamp_ns=0,
        C_o_b=about_down(at_start) @ truth.C_o_b[0],
        p_o=np.zeros(3),
        v=truth.C_n_b[0].T @ truth.v_n[0],
        velocity_frame="body",
    )
    f_i, w_i = flown.f_b @ C_b_i, flown.w_ib_b @ C_b_i
    seconds = slice(49, None, 100)
    depths = 30.0 + flown.truth.p_o[seconds, 2] + flown.truth.C_n_b[seconds, 2] @ DEPTH_ARM
    depths += np.random.default_rng(SEED).normal(0.0, 0.02, len(depths))
    measured = [
        *(Dvl(int(at), v) for at, v in zip(flown.dvl_stamps_ns, flown.v_d, strict=True)),
        *(Depth(int(at), d) for at, d in zip(flown.stamps_ns[seconds], depths, strict=True)),
    ]
    split_ns = int(flown.stamps_ns[UNDERWAY - 1])
    before = [event for event in measured if event.stamp_ns <= split_ns]
    first = fold_arrays(
        parameters(model),
        flown.stamps_ns[:UNDERWAY],
        f_i[:UNDERWAY],
        w_i[:UNDERWAY],
        [initial, *before],
    )
    record, filter_ = first.states[-1:].copy(), first.filter
    correction = np.zeros(filter_.n)
    correction[ATTITUDE.stop - 1] = underway
    coordinates.inject(record[0], filter_.constants[0], correction)

    fold = Fold(parameters(model), capacity=len(flown.stamps_ns))
    fold.resume(record)
    for event in measured:
        if event.stamp_ns > split_ns:
            assert fold.add(event) is None
    for k in range(UNDERWAY, len(flown.stamps_ns)):
        assert fold.add(Imu(int(flown.stamps_ns[k]), f_i[k], w_i[k])) is None
    states = fold.states
    return Solution(
        states["nav"],
        filter_.covariance(states),
        [update.report for update in [*first.updates, *fold.updates]],
    )


def turned(P: np.ndarray, R: np.ndarray) -> np.ndarray:
    """P (N, n, n) with the errors that are told in navigation axes turned."""
    T = np.eye(P.shape[-1])
    for block in (VELOCITY, ATTITUDE, POSITION):
        T[block, block] = R
    return np.asarray(T @ P @ T.T)


def assert_turned(
    one: Solution, other: Solution, angle: float, tolerance: float, metres: float
) -> None:
    R = about_down(angle)
    a, b = one.nav, other.nav
    np.testing.assert_allclose(b["C_n_b"], R @ a["C_n_b"], rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(b["v_n"], a["v_n"] @ R.T, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(from_reference(b), from_reference(a) @ R.T, rtol=0.0, atol=metres)
    np.testing.assert_allclose(b["bend_n"], a["bend_n"] @ R[:2, :2].T, rtol=0.0, atol=tolerance)
    for name in ("b_f", "b_w", "optional", "w_nb_b"):
        np.testing.assert_allclose(b[name], a[name], rtol=0.0, atol=tolerance, err_msg=name)
    P = turned(one.P, R)
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    assert (abs(other.P - P) / (sigma[:, :, None] * sigma[:, None, :])).max() < tolerance
    for before, after in zip(one.reports, other.reports, strict=True):
        assert after.reason == before.reason
        np.testing.assert_allclose(after.innovation, before.innovation, rtol=0.0, atol=tolerance)
        np.testing.assert_allclose(after.S, before.S, rtol=0.0, atol=tolerance * np.trace(before.S))


@pytest.mark.parametrize("angle", [0.3, 2.0, -3.0])
def test_another_heading_at_the_start_turns_the_solution(angle: float) -> None:
    assert_turned(solution("invariant"), solution("invariant", at_start=angle), angle, 1e-9, 1e-7)


@pytest.mark.parametrize("angle", [0.3, 2.0, -3.0])
def test_a_correction_of_the_heading_underway_turns_the_solution(angle: float) -> None:
    """Of the path behind it as well: it is as if the start had been told with that heading."""
    assert_turned(solution("invariant"), solution("invariant", underway=angle), angle, 1e-6, 1e-5)


def test_with_ned_a_correction_of_the_heading_is_an_error_of_the_velocity() -> None:
    """What the other coordinates lose, so that the two tests above can fail."""
    one, other = solution("ned"), solution("ned", underway=2.0)
    assert np.linalg.norm(other.nav["v_n"][0] - about_down(2.0) @ one.nav["v_n"][0]) > 1.0
    assert abs(other.nav["b_f"] - one.nav["b_f"]).max() > 1e-3
