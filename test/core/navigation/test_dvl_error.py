"""The modelled errors of the DVL: what they may move, and what not."""

import numpy as np
import pytest
from told import TOLD

from insdvl.navigation.events import Event, Initial
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import DvlParameters, FilterParameters
from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

GRADE, DVL_STD = GRADES["fog"], 0.01
PITCH = float(np.radians(0.1))  # of the DVL


def fly(mission: Mission, **values: object) -> FoldResult:
    variances = tuple(map(float, GRADE.variances()))
    parameters = build(
        FilterParameters,
        TOLD
        | {
            "frame_convention": "ned",
            "dvl.noise_std": (DVL_STD,) * 3,
            "process_noise.accelerometer_variance": variances[:3],
            "process_noise.gyroscope_variance": variances[3:],
            "initial.mode": "set_odometry",
            "initial.tilt_std": 2e-4,
            "initial.heading_std": 1e-3,
            "initial.accelerometer_bias_std": GRADE.accelerometer_bias,
            "initial.gyroscope_bias_std": GRADE.gyroscope_bias,
            "origin.height": float(AUV.h_0),
            **{name.replace("__", "."): value for name, value in values.items()},
        },
    )
    truth = mission.initial
    C = truth.C_n_b[0]
    events: list[Event] = [Initial(0, C, truth.p_o[0], C.T @ truth.v_n[0], "body")]
    pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    events += [Dvl(stamp, v_d) for stamp, v_d in pings]
    return fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, events)


def mission_of(seed: int, pitch: float = 0.0, bias_std: float = 0.0) -> Mission:
    return simulate(
        AUV,
        constant(GRADE.variances()),
        seed=seed,
        imu=GRADE.imu(),
        dvl=DvlModel(
            mount=(0.0, pitch, 0.0),
            noise_std=(DVL_STD,) * 3,
            bias_std=bias_std,
            bias_time_constant=300.0,
        ),
    )


def depth_in_sigma(result: FoldResult, mission: Mission) -> tuple[float, float]:
    """Depth error at the end [m], and in sigmas."""
    nav = result.states["nav"][-1]
    error = float(mission.truth.llh[-1, 2] - nav["llh"][2])
    return error, error / float(np.sqrt(nav["P"][14, 14]))


def test_an_axis_without_a_sigma_has_no_error() -> None:
    """It stays exactly zero, and the depth does not move with it."""
    mission = mission_of(11, bias_std=0.005)
    model = {"dvl__bias_model": "gauss_markov", "dvl__bias_time_constant": 300.0}
    flat = fly(mission, **model, dvl__bias_std=(0.005, 0.005, 0.0))
    s = flat.states["nav"]
    assert not s["optional"][:, 2].any()
    assert not s["P"][:, 17, :].any() and not s["P"][:, :, 17].any()
    assert s["optional"][-1, :2].all()
    without = fly(mission)
    error, _ = depth_in_sigma(flat, mission)
    assert error == pytest.approx(depth_in_sigma(without, mission)[0], abs=0.1)


def test_one_sigma_for_all_axes_is_refused() -> None:
    expected = r"'dvl.bias_std' must be a list of floats, got 0.01 \(float\): give 3 values"
    with pytest.raises(ParameterError, match=expected):
        build(FilterParameters, TOLD | {"dvl.bias_std": 0.01})


def test_a_mount_that_is_known_has_no_states() -> None:
    assert DvlParameters().blocks() == ()
    (block,) = DvlParameters(mount_std=(0.0, 0.01, 0.0)).blocks()
    assert (block.name, block.std) == ("dvl_mount", (0.0, 0.01, 0.0))
    assert block.time_constant == np.inf


@pytest.mark.long
def test_a_pitched_dvl_carries_the_depth_away_inside_sigma_with_its_mount_as_a_state() -> None:
    """0.1 deg at 1 m/s for 330 s is 0.6 m: not modelled, the sigma does not know of it."""
    unmodelled, errors = [], []
    for seed in range(8):
        mission = mission_of(seed, PITCH)
        unmodelled.append(depth_in_sigma(fly(mission), mission)[1])
        errors.append(depth_in_sigma(fly(mission, dvl__mount_std=(PITCH,) * 3), mission)[1])
    assert np.mean(np.abs(unmodelled)) > 3.0
    assert np.abs(errors).max() < 3.0


def test_a_mount_of_the_parameters_leaves_no_drift() -> None:
    mission = mission_of(3, PITCH)
    result = fly(mission, dvl__mount=(0.0, PITCH, 0.0))
    error, sigmas = depth_in_sigma(result, mission)
    assert abs(sigmas) < 3.0 and abs(error) < 0.2
