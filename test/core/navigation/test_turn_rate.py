"""The turn rate at the lever arm: a line through the window, without lag, and how well known it is.

The lever arm moves with the turn rate at the stamp. Where that changes, a mean over the window lags
by half of it.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.events import Initial
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    OriginParameters,
)
from insdvl.simulation.grades import GRADES
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import Channel, Ramp, Trajectory
from insdvl.studies.consistency.flights import process_noise_of
from insdvl.timeline.recorded import fold_arrays

ARM, DVL_STD = (1.5, 0.0, 0.0), 0.02
TURN = (60.0, 68.0)  # s, half a circle
TRAJECTORY = Trajectory(
    duration=75.0,
    speed=Channel(1.5),
    heading=Channel(0.3, ramps=(Ramp(*TURN, np.pi, 0.3),)),
    bank=0.35,
    pivot=0.5,
)
FIRST_SEED = 2_718


def parameters_of(grade):
    return FilterParameters(
        frame_convention="ned",
        dvl=DvlParameters(noise_std=(DVL_STD,) * 3, lever_arm=ARM),
        process_noise=process_noise_of(grade),
        initial=replace(
            P_0,
            mode="set_odometry",
            accelerometer_bias_std=grade.accelerometer_bias,
            gyroscope_bias_std=grade.gyroscope_bias,
        ),
        origin=OriginParameters(height=float(TRAJECTORY.h_0)),
    )


def velocity_nees(name, dvl_rate, runs):
    """NEES (runs, K) per degree of freedom of the body velocity, four times a second."""
    grade = GRADES[name]
    parameters, imu = parameters_of(grade), grade.imu()
    sigma = parameters.initial
    at = np.arange(round((TURN[0] - 2.0) * imu.rate), round((TURN[1] + 2.0) * imu.rate), 25) - 1
    nees = []
    for run in range(runs):
        mission = simulate(
            TRAJECTORY,
            constant(grade.variances()),
            seed=FIRST_SEED + run,
            imu=imu,
            dvl=DvlModel(dvl_rate, lever_arm=ARM, noise_std=(DVL_STD,) * 3),
        )
        rng = np.random.default_rng([FIRST_SEED, run])
        C, v_n = mission.initial.C_n_b[0], mission.initial.v_n[0]
        psi = rng.standard_normal(3) * sigma.attitude_std
        initial = Initial(
            stamp_ns=0,
            C_o_b=Rotation.from_rotvec(-psi).as_matrix() @ C,
            p_o=mission.initial.p_o[0] + sigma.position_std * rng.standard_normal(3),
            v=C.T @ v_n + sigma.velocity_std * rng.standard_normal(3),
            velocity_frame="body",
        )
        pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
        events = [initial, *(Dvl(stamp, v) for stamp, v in pings)]
        result = fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, events)
        nav, truth = result.states["nav"][at], mission.truth
        v_b = np.einsum("kji,kj->ki", nav["C_n_b"], nav["v_n"])
        error = np.einsum("kji,kj->ki", truth.C_n_b[at], truth.v_n[at]) - v_b
        J = body_velocity_jacobian(nav["C_n_b"], nav["v_n"], invariant=True, n=15)
        P = J @ nav["P"][:, :15, :15] @ np.swapaxes(J, 1, 2)
        nees.append(np.einsum("ki,ki->k", error, np.linalg.solve(P, error[..., None])[..., 0]) / 3)
    return np.array(nees)


@pytest.mark.parametrize("dvl_rate", [1.0, 8.0])
@pytest.mark.parametrize("grade", sorted(GRADES))
@pytest.mark.long
def test_the_velocity_in_a_turn_is_as_good_as_its_covariance(grade, dvl_rate):
    """Mean over the turn: with a mean turn rate it is 2.7 to 3.2 at 8 Hz, 10 at the worst time."""
    assert 0.5 < velocity_nees(grade, dvl_rate, 100).mean() < 1.3


@pytest.mark.parametrize(
    "grade", ["mems", *(pytest.param(g, marks=pytest.mark.long) for g in ("fog", "tactical"))]
)
def test_the_velocity_in_a_turn_in_short(grade):
    nees = velocity_nees(grade, 8.0, 12)
    assert 0.5 < nees.mean() < 1.5
    assert nees.mean(axis=0).max() < 3.0
