"""A sensor that goes wrong smoothly, beside others that are right, does not turn the filter."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from insdvl.navigation import coordinates
from insdvl.navigation.error_state import POSITION
from insdvl.navigation.events import NS, Event
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.measurements.heading import Heading
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.simulation.grades import GRADES
from insdvl.simulation.initial_errors import drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.motion import Channel, Ramp, Trajectory
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.timeline.recorded import fold_arrays

SEED = 44_120  # chosen before the first run
DVL_STD, DEPTH_STD, COMPASS_STD = 0.01, 0.01, math.radians(1.0)
#: 1.5 m/s, from 60 to 100 s down at 35 degrees, with a turn before and behind.
DIVE = Trajectory(
    duration=150.0,
    speed=Channel(1.5),
    heading=Channel(0.3, ramps=(Ramp(20.0, 30.0, 1.0), Ramp(115.0, 125.0, 1.0))),
    pitch=Channel(ramps=(Ramp(60.0, 63.0, -0.61), Ramp(100.0, 103.0, 0.61))),
    h_0=-5.0,
)
LEARNED = {
    "process_noise.adaptive_factor": True,
    "dvl.noise_source": "adaptive",
    "dvl.noise_floor": 0.005,
}
OTHERS = [pytest.param(grade, marks=pytest.mark.long) for grade in ("fog", "mems")]
GRADE = pytest.mark.parametrize("grade", ["tactical", *OTHERS])
SOURCE = pytest.mark.parametrize("learned", [{}, LEARNED], ids=["told", "learned"])


@cache
def mission(grade: str) -> Mission:
    of = GRADES[grade]
    dvl = DvlModel(noise_std=(DVL_STD,) * 3, rate=5.0)
    return simulate(DIVE, constant(of.variances()), seed=SEED, imu=of.imu(), dvl=dvl)


def pings(m: Mission, error: np.ndarray | float = 0.0) -> list[Event]:
    v_d = m.v_d + error
    return [Dvl(stamp_ns, v) for stamp_ns, v in zip(m.dvl_stamps_ns.tolist(), v_d, strict=True)]


def true_depth(m: Mission) -> np.ndarray:
    return m.truth.p_o[:, 2] - DIVE.h_0


def depths(m: Mission, readings: np.ndarray) -> list[Event]:
    """10 Hz of readings (N,) at the stamps of the IMU, with noise."""
    rows = slice(9, None, 10)
    noise = DEPTH_STD * np.random.default_rng([SEED, 2]).standard_normal(len(readings[rows]))
    pairs = zip(m.stamps_ns[rows].tolist(), (readings[rows] + noise).tolist(), strict=True)
    return [Depth(stamp_ns, depth) for stamp_ns, depth in pairs]


def headings(m: Mission, deviation: np.ndarray) -> list[Event]:
    """2 Hz of a compass that deviates by (N,) at the stamps of the IMU."""
    rows = slice(49, None, 50)
    turn = np.zeros((len(deviation[rows]), 3))
    noise = np.random.default_rng([SEED, 3]).standard_normal(len(turn))
    turn[:, 2] = deviation[rows] + COMPASS_STD * noise
    attitudes = Rotation.from_rotvec(turn).as_matrix() @ m.truth.C_n_b[rows]
    return [Heading(at, C) for at, C in zip(m.stamps_ns[rows].tolist(), attitudes, strict=True)]


class Flown(NamedTuple):
    """Errors against the truth; `refused` counts pings of the DVL."""

    velocity: np.ndarray  # (N, 3), body axes [m/s]
    tilt: np.ndarray  # (N,) [deg]
    down: np.ndarray  # (N,) [m]
    sigma_down: np.ndarray  # (N,) [m]
    refused: int


def fly(m: Mission, grade: str, events: Sequence[Event], **values: Any) -> Flown:
    of = GRADES[grade]
    q = of.variances()
    settings = build(
        FilterParameters,
        {
            "frame_convention": "ned",
            "origin.height": DIVE.h_0,
            "dvl.noise_std": (DVL_STD,) * 3,
            "depth.topic": "depth",
            "depth.noise_std": DEPTH_STD,
            "heading.topic": "heading",
            "heading.noise_std": COMPASS_STD,
            "process_noise.accelerometer_variance": tuple(q[:3].tolist()),
            "process_noise.gyroscope_variance": tuple(q[3:].tolist()),
            "initial.mode": "set_odometry",
            "initial.position_std": 0.1,
            "initial.velocity_std": 0.1,
            "initial.tilt_std": math.radians(0.5),
            "initial.heading_std": math.radians(1.0),
            "initial.accelerometer_bias_std": of.accelerometer_bias,
            "initial.gyroscope_bias_std": of.gyroscope_bias,
        }
        | values,
    )
    start = drawn_initial(m.initial, settings.initial, np.random.default_rng([SEED, 1]))
    found = fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start, *events])
    nav, truth = found.states["nav"], m.truth
    v_b = [
        np.einsum("kji,kj->ki", C, v)
        for C, v in ((truth.C_n_b, truth.v_n), (nav["C_n_b"], nav["v_n"]))
    ]
    psi = coordinates.attitude_error(nav, truth.C_n_b, invariant=True)
    down = POSITION.start + 2
    used = [u.report for u in found.updates if u.report.measurement == Dvl.name]
    return Flown(
        v_b[0] - v_b[1],
        np.degrees(np.linalg.norm(psi[:, :2], axis=1)),
        nav["llh"][:, 2] - truth.llh[:, 2],
        np.sqrt(nav["P"][:, down, down]),
        sum(not report.accepted for report in used),
    )


def stays(flown: Flown, *, velocity: float = 0.1, tilt: float = 0.5) -> None:
    """From 20 s on the filter is where the right sensors have it; these are all used."""
    assert flown.refused == 0
    assert np.abs(flown.velocity[2000:]).max() < velocity
    assert flown.tilt[2000:].max() < tilt


@GRADE
@SOURCE
@pytest.mark.parametrize(
    ("angle", "width"),
    [
        (30.0, 8.0),
        *(pytest.param(*one, marks=pytest.mark.long) for one in ((20.0, 5.0), (60.0, 8.0))),
    ],
)
def test_a_compass_that_passes_steel_does_not_tilt_the_vehicle(
    grade: str, learned: dict[str, Any], angle: float, width: float
) -> None:
    """Its heading turns away by an angle and comes back, as slowly as a vehicle turns."""
    m = mission(grade)
    away = np.radians(angle) * np.exp(-0.5 * ((m.stamps_ns / NS - 80.0) / width) ** 2)
    stays(fly(m, grade, [*pings(m), *headings(m, away)], **learned))


@GRADE
@SOURCE
@pytest.mark.parametrize(
    "fault",
    [
        *("low-pass of 1 s", "drift"),
        *(
            pytest.param(one, marks=pytest.mark.long)
            for one in ("0.5 s late", "water of 1053 kg/m3")
        ),
    ],
)
def test_a_depth_that_lags_or_drifts_does_not_turn_the_velocity(
    grade: str, learned: dict[str, Any], fault: str
) -> None:
    """The DVL tells the velocity; what the depth says of it is not believed against that."""
    m = mission(grade)
    true, t = true_depth(m), m.stamps_ns / NS
    a = np.exp(-0.01)
    readings = {
        "low-pass of 1 s": lfilter([1.0 - a], [1.0, -a], true - true[0]) + true[0],
        "0.5 s late": np.interp(t - 0.5, t, true),
        "drift": true + 0.1 * np.maximum(t - 60.0, 0.0),
        "water of 1053 kg/m3": 1.027 * true,
    }[fault]
    stays(fly(m, grade, [*pings(m), *depths(m, readings)], **learned), velocity=0.15)


@GRADE
@SOURCE
def test_a_noisy_vertical_velocity_does_not_tilt_the_vehicle(
    grade: str, learned: dict[str, Any]
) -> None:
    """Thirty times the told sigma in one component for 40 s.

    The filter gives in to single pings. For moments the other components are then as wrong as that
    one, 3 sigma of its noise at most; in the mean square they are a third of a sigma.
    """
    m = mission(grade)
    t = m.dvl_stamps_ns / NS
    error = np.zeros_like(m.v_d)
    noise = np.random.default_rng([SEED, 4]).standard_normal(len(t))
    error[:, 2] = 0.3 * noise * ((t > 50.0) & (t < 90.0))
    flown = fly(m, grade, [*pings(m, error), *depths(m, true_depth(m))], **learned)
    assert flown.tilt[2000:].max() < 0.5
    assert np.abs(flown.velocity[2000:, :2]).max() < 0.9
    assert np.sqrt(np.mean(flown.velocity[5000:9000, :2] ** 2)) < 0.1
    assert np.abs(flown.velocity[12_000:]).max() < 0.1


@pytest.mark.parametrize("grade", ["tactical", OTHERS[0]])
@SOURCE
def test_a_dvl_that_drifts_away_and_returns_is_believed_again(
    grade: str, learned: dict[str, Any]
) -> None:
    """1 m/s in 5 s, and back: the filter that has followed it is not sure of itself any more."""
    m = mission(grade)
    t = m.dvl_stamps_ns / NS
    error = np.zeros_like(m.v_d)
    error[:, 1] = 0.2 * np.clip(np.minimum(t - 60.0, 80.0 - t), 0.0, 5.0)
    flown = fly(m, grade, [*pings(m, error), *depths(m, true_depth(m))], **learned)
    assert np.abs(flown.velocity).max() < 3.0
    assert np.abs(flown.velocity[11_000:]).max() < 0.1  # half a minute behind its return


@GRADE
@pytest.mark.parametrize(
    "off", [5.0, *(pytest.param(one, marks=pytest.mark.long) for one in (-5.0, 1.0))]
)
def test_a_first_depth_that_is_wrong_is_forgotten(grade: str, off: float) -> None:
    """The surface is unknown and was taken from it; the height was known before, to 0.1 m."""
    m = mission(grade)
    first, *others = depths(m, true_depth(m))
    assert isinstance(first, Depth)
    wrong = Depth(first.stamp_ns, first.depth + off)
    flown = fly(m, grade, [*pings(m), wrong, *others])
    assert np.abs(flown.down[100:] / flown.sigma_down[100:]).max() < 4.0
    assert np.abs(flown.down[100:]).max() < 0.5


def test_a_first_depth_that_is_wrong_moves_a_height_of_a_known_surface_no_farther() -> None:
    """A surface that is known to 0.2 m: what it does not explain is doubted of the height."""
    m = mission("tactical")
    known = {"depth.surface_std": 0.2}
    first, *others = depths(m, true_depth(m))
    assert isinstance(first, Depth)
    wrong = Depth(first.stamp_ns, first.depth + 5.0)
    flown = fly(m, "tactical", [*pings(m), wrong, *others], **known)
    assert np.abs(flown.down[1000:] / flown.sigma_down[1000:]).max() < 4.0


@GRADE
@pytest.mark.parametrize("rate", [5.0, 1.0])
def test_a_glitch_of_the_imu_leaves_no_wrong_height(grade: str, rate: float) -> None:
    """Three samples of 80 m/s^2, 2.4 m/s for up to a second.

    The ping behind them tells the velocity, and with it to a tenth how far it has moved the height.
    """
    m = mission(grade)
    events = pings(m)[:: round(5.0 / rate)]
    f_b = m.f_b.copy()
    f_b[5022:5025, 2] += 80.0
    flown = fly(replace(m, f_b=f_b), grade, [*events, *depths(m, true_depth(m))])
    clean = fly(m, grade, [*events, *depths(m, true_depth(m))])
    assert flown.refused == clean.refused == 0
    assert np.abs(flown.down[5200:] - clean.down[5200:]).max() < 0.25
    assert np.abs(flown.velocity[5200:]).max() < 0.2
