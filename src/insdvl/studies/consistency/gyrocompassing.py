"""A vehicle that finds its heading at rest and then leaves, or that is rocked meanwhile."""

import gc
import math
from dataclasses import dataclass, replace

import numpy as np

from insdvl.navigation.measurements.dvl import Dvl
from insdvl.simulation.dvl import DvlModel
from insdvl.simulation.mission import simulate
from insdvl.simulation.motion import Channel, Ramp, Trajectory, Wave
from insdvl.simulation.noise import constant
from insdvl.studies.consistency.errors import Errors, errors
from insdvl.studies.consistency.flights import RATE, TRANSIT, Case, parameters
from insdvl.timeline.recorded import fold_arrays

#: At rest for 150 s, then out with turns, 600 s in all.
DEPARTURE = Trajectory(
    duration=600.0,
    speed=Channel(ramps=(Ramp(150.0, 170.0, 1.8),)),
    heading=Channel(
        math.radians(20.0),
        ramps=(
            Ramp(200.0, 215.0, math.radians(50.0)),
            Ramp(280.0, 295.0, math.radians(-80.0)),
            Ramp(360.0, 375.0, math.radians(100.0)),
            Ramp(440.0, 470.0, math.radians(120.0)),
            Ramp(530.0, 545.0, math.radians(-50.0)),
        ),
    ),
    pitch=Channel(math.radians(2.0)),
    roll=Channel(math.radians(-1.0)),
    bank=0.4,
    pivot=0.4,
    h_0=TRANSIT.h_0,
)

_INITIAL = 1  # stream of what is told, beside those of the mission


def rocked(amplitude_deg: float, period: float) -> Trajectory:
    """The same departure, of a vehicle that is rocked, less in pitch than in roll."""
    amplitude = math.radians(amplitude_deg)
    return replace(
        DEPARTURE,
        roll=Channel(math.radians(-1.0), waves=(Wave(amplitude, period),)),
        pitch=Channel(math.radians(2.0), waves=(Wave(0.3 * amplitude, 1.3 * period, 0.5),)),
    )


@dataclass(frozen=True)
class Departure:
    """One run.

    Attributes:
        start: Stamp of the first state [s].
        compass: What became of gyrocompassing, see `insdvl.navigation.start.gyrocompass`.
        number: The number that led to it.
        errors: At the start and each second behind it.
    """

    start: float
    compass: int
    number: float
    errors: Errors


def depart(case: Case, seed: int) -> Departure:
    """One run; ``case.trajectory`` is at rest or rocked at first, and begins with no speed.

    The filter is told a heading that is wrong by what the case says, and finds its own.

    Args:
        case: What is flown.
        seed: Of all that is random.
    """
    mission = simulate(
        case.trajectory,
        constant(case.grade.variances(RATE)),
        seed=seed,
        duration=case.duration,
        imu=case.grade.imu(RATE),
        dvl=DvlModel(rate=case.dvl_rate, noise_std=(case.dvl_std,) * 3),
    )
    rng = np.random.default_rng([seed, _INITIAL])
    error = math.radians(case.heading_std_deg) * rng.standard_normal()
    if case.uniform_heading:
        error = rng.uniform(-math.pi, math.pi)
    C = mission.initial.C_n_b[0]
    heading = math.atan2(C[1, 0], C[0, 0]) - error
    told = parameters(case)
    position = case.position_std * rng.standard_normal(3)
    initial = replace(
        told.initial,
        mode="gyrocompassing",
        rpy=(0.0, 0.0, math.remainder(heading, 2.0 * math.pi)),
        position=tuple(position.tolist()),
        velocity=tuple((told.initial.velocity_std * rng.standard_normal(3)).tolist()),
    )
    pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    result = fold_arrays(
        replace(told, initial=initial),
        mission.stamps_ns,
        mission.f_b,
        mission.w_ib_b,
        [Dvl(stamp_ns, v_d) for stamp_ns, v_d in pings],
    )
    states = result.states
    first = int(np.argmax(states["nav"]["initialised"]))
    rows = np.arange(first, len(states), round(RATE))
    found = errors(result.filter, states[rows].copy(), mission, rows)
    start = states[first]["start"]
    departure = Departure(
        float(mission.stamps_ns[first]) * 1e-9,
        int(start["compass"]),
        float(start["compass_number"]),
        found,
    )
    del result, states
    gc.collect()  # a fold refers to itself, and its records take 0.4 GB
    return departure
