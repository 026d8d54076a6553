"""A DVL that is silent for two minutes: what the first measurements behind it leave.

An IMU of the MEMS grade drifts by tens of metres per second meanwhile, so the first measurement
corrects velocity, tilt and heading far beyond where h is linear.
"""

import gc

import numpy as np

from insdvl.navigation.measurements.dvl import Dvl
from insdvl.simulation.dvl import DvlModel
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import constant
from insdvl.studies.consistency.errors import Errors, errors
from insdvl.studies.consistency.flights import RATE, Case, initial_state, parameters
from insdvl.timeline.recorded import fold_arrays

#: Silence of the DVL, and how long the errors are followed behind it [s].
BEGIN, END, AFTER = 240.0, 360.0, 60.0

_INITIAL = 1  # stream of the initial error, beside those of the mission


def fly_through_outage(case: Case, seed: int) -> Errors:
    """Errors right behind the first measurement after the outage and at each second from there on.

    Args:
        case: What is flown; its duration is that of `END` and `AFTER`.
        seed: Of all that is random.
    """
    mission = simulate(
        case.trajectory,
        constant(case.grade.variances(RATE)),
        seed=seed,
        duration=END + AFTER,
        imu=case.grade.imu(RATE),
        dvl=DvlModel(rate=case.dvl_rate, noise_std=(case.dvl_std,) * 3, outages=(BEGIN, END)),
        earth_rate=case.earth_rate,
    )
    initial = initial_state(case, mission.initial, np.random.default_rng([seed, _INITIAL]))
    pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    result = fold_arrays(
        parameters(case),
        mission.stamps_ns,
        mission.f_b,
        mission.w_ib_b,
        [initial, *(Dvl(stamp_ns, v_d) for stamp_ns, v_d in pings)],
    )
    first, second = round(END * RATE) - 1, round(RATE)
    rows = np.arange(first, len(mission.stamps_ns), second)
    found = errors(result.filter, result.states[rows].copy(), mission, rows)
    del result
    gc.collect()  # a fold refers to itself, and its records take 0.4 GB
    return found
