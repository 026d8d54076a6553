"""In waves the steps of the position at the measurements are as large as the filter says.

Where h lags behind the motion, the innovations are larger than S, and waves move the position.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from steps import watch_steps

from insdvl.arrays import Array
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
from insdvl.simulation.motion import Channel, Ramp, Trajectory, Wave
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.studies.consistency.flights import process_noise_of
from insdvl.timeline.recorded import fold_arrays

#: Near the surface, in waves of 5 to 7 s, with turns.
WAVES = Trajectory(
    duration=400.0,
    speed=Channel(1.8, waves=(Wave(0.1, 5.7),)),
    heading=Channel(
        0.5,
        ramps=(Ramp(80.0, 95.0, 2.0), Ramp(200.0, 215.0, -1.5), Ramp(300.0, 320.0, math.pi)),
        waves=(Wave(math.radians(2.0), 6.6),),
    ),
    pitch=Channel(waves=(Wave(math.radians(3.0), 5.3, 0.4), Wave(math.radians(1.5), 6.9))),
    roll=Channel(waves=(Wave(math.radians(6.0), 5.9, 1.0),)),
    bank=0.3,
    pivot=0.4,
    h_0=-3.0,
)
GRADE = GRADES["fog"]
ARM, WHITE, SLOW, TIME_CONSTANT = (1.5, 0.2, 0.4), 0.004, 0.007, 300.0
SEEDS = range(3)


def ratios(monkeypatch: pytest.MonkeyPatch, seed: int, late: float = 0.0) -> Array:
    """Steps (K, 3) over their sigmas of one flight, whose DVL has stamps that are late [s]."""
    dvl = DvlModel(
        lever_arm=ARM, noise_std=(WHITE,) * 3, bias_std=SLOW, bias_time_constant=TIME_CONSTANT
    )
    mission = simulate(WAVES, constant(GRADE.variances()), seed=seed, imu=GRADE.imu(), dvl=dvl)
    parameters = FilterParameters(
        frame_convention="ned",
        dvl=DvlParameters(
            lever_arm=ARM,
            noise_std=(WHITE,) * 3,
            bias_model="gauss_markov",
            bias_std=(SLOW,) * 3,
            bias_time_constant=TIME_CONSTANT,
        ),
        process_noise=process_noise_of(GRADE),
        initial=replace(
            P_0,
            mode="set_odometry",
            accelerometer_bias_std=GRADE.accelerometer_bias,
            gyroscope_bias_std=GRADE.gyroscope_bias,
        ),
        origin=OriginParameters(height=float(WAVES.h_0)),
    )
    truth = mission.initial
    C = truth.C_n_b[0]
    initial = Initial(0, C, truth.p_o[0], C.T @ truth.v_n[0], "body")
    pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    events = [initial, *(Dvl(stamp + round(late * 1e9), v_d) for stamp, v_d in pings)]
    if late:
        events = [e for e in events if e.stamp_ns <= mission.stamps_ns[-1]]
    with monkeypatch.context() as patch:
        steps = watch_steps(patch)
        fold = fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, events)
    corrected = [update.report.corrected for update in fold.updates]
    assert len(steps) == sum(corrected) > 200
    return np.array(steps)


def test_the_steps_of_the_position_are_within_their_sigmas(monkeypatch: pytest.MonkeyPatch) -> None:
    found = np.concatenate([ratios(monkeypatch, seed) for seed in SEEDS])
    assert (found > 3.0).mean() <= 0.01
    assert not (found > 5.0).any()
    assert found.max() > 2.0  # they are compared with the sigmas of these steps


def test_stamps_that_are_late_show_in_the_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.1 s; a mean of the turn rate over 0.25 s lags by as much."""
    found = ratios(monkeypatch, SEEDS[0], late=0.1)
    assert (found > 3.0).mean() > 0.01
