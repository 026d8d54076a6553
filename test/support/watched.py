"""Events of a simulated mission whose sensors are mounted or read in another way than declared."""

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS, Event, Imu
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.simulation.mission import Mission

SAME = np.eye(3)


def events(
    mission: Mission, f: Array = SAME, w: Array = SAME, d: Array = SAME, late: float = 0.0
) -> list[Event]:
    """The mission's events in the order of their stamps.

    Args:
        mission: The mission.
        f: (3, 3) by which the readings of the accelerometer are multiplied.
        w: (3, 3) those of the gyroscope.
        d: (3, 3) those of the DVL.
        late: Delay of the DVL's stamps [s].
    """
    found: list[Event] = [
        Imu(stamp, f_b, w_b)
        for stamp, f_b, w_b in zip(
            mission.stamps_ns.tolist(), mission.f_b @ f.T, mission.w_ib_b @ w.T, strict=True
        )
    ]
    stamps = (mission.dvl_stamps_ns + round(late * NS)).tolist()
    found += [Dvl(stamp, v) for stamp, v in zip(stamps, mission.v_d @ d.T, strict=True)]
    return sorted(found, key=lambda event: (event.stamp_ns, event.kind))
