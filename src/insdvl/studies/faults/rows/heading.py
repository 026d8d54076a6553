"""Faults of the heading sensor."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array
from insdvl.messages.topics import HEADING
from insdvl.studies.faults import changes
from insdvl.studies.faults.changes import Edit, orientation
from insdvl.studies.faults.checks import (
    covered,
    heading_covered,
    nothing_refused,
    refused,
    rejoins,
    update_reason,
)
from insdvl.studies.faults.rows.base import BEGIN, END, FlightRow
from insdvl.studies.faults.stream import Sensors

SENSORS = Sensors(imu="good", heading_rate=5.0)
_HONEST = covered(), heading_covered(), rejoins(HEADING)
_WEST = np.array([0.0, 0.0, 1.0, 0.0])


def _turned(angle_deg: float) -> Edit:
    """The heading is off by an angle."""
    turn = Rotation.from_rotvec([0.0, 0.0, math.radians(angle_deg)])

    def change(q_xyzw: Array) -> Array:
        return np.asarray((turn * Rotation.from_quat(q_xyzw)).as_quat())

    return orientation(change)


ROWS = (
    FlightRow(
        "heading",
        "outage of 30 s",
        changes.dropped(HEADING, BEGIN, END),
        (nothing_refused(), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "heading",
        "one heading off by 90 deg",
        changes.edited(HEADING, BEGIN, BEGIN + 0.15, _turned(90.0)),
        (update_reason("gate", topic=HEADING), *_HONEST),
        end=BEGIN + 0.15,
        sensors=SENSORS,
    ),
    FlightRow(
        "heading",
        "near steel for 30 s: off by 40 deg",
        changes.edited(HEADING, BEGIN, END, _turned(40.0)),
        (update_reason("gate", topic=HEADING), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "heading",
        "one attitude for 30 s",
        changes.edited(HEADING, BEGIN, END, orientation(lambda q: _WEST)),
        (update_reason("gate or frozen", topic=HEADING), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "heading",
        "a quaternion of zeros for 30 s",
        changes.edited(HEADING, BEGIN, END, orientation(lambda q: 0.0 * q)),
        (refused("bad_quaternion", HEADING), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "heading",
        "NaN for 30 s",
        changes.edited(HEADING, BEGIN, END, orientation(lambda q: np.nan * q)),
        (refused("not_finite", HEADING), *_HONEST),
        sensors=SENSORS,
    ),
)
