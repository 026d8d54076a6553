"""Faults of the depth sensor."""

from insdvl.messages.topics import DEPTH
from insdvl.studies.faults import changes
from insdvl.studies.faults.changes import pressure
from insdvl.studies.faults.checks import (
    covered,
    height_covered,
    nothing_refused,
    refused,
    rejoins,
    update_reason,
)
from insdvl.studies.faults.rows.base import BEGIN, END, FlightRow
from insdvl.studies.faults.stream import Sensors

SENSORS = Sensors(imu="good", depth_rate=5.0)
_AIR = 101_325.0  # Pa
_METRE = 1e4  # Pa of a metre of water, nearly
_HONEST = covered(), height_covered(), rejoins(DEPTH)

ROWS = (
    FlightRow(
        "depth",
        "outage of 30 s",
        changes.dropped(DEPTH, BEGIN, END),
        (nothing_refused(), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "depth",
        "out of the water for 30 s: the pressure of air",
        changes.edited(DEPTH, BEGIN, END, pressure(lambda p: _AIR)),
        (refused("in_air", DEPTH), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "depth",
        "hPa in place of Pa for 30 s",
        changes.edited(DEPTH, BEGIN, END, pressure(lambda p: p / 100.0)),
        (refused("in_air", DEPTH), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "depth",
        "zeros for 30 s",
        changes.edited(DEPTH, BEGIN, END, pressure(lambda p: 0.0)),
        (refused("no_data", DEPTH), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "depth",
        "NaN for 30 s",
        changes.edited(DEPTH, BEGIN, END, pressure(lambda p: float("nan"))),
        (refused("not_finite", DEPTH), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "depth",
        "one number for 30 s",
        changes.edited(DEPTH, BEGIN, END, pressure(lambda p: _AIR + 8.0 * _METRE)),
        (update_reason("frozen", 0.8, topic=DEPTH), *_HONEST),
        sensors=SENSORS,
    ),
    FlightRow(
        "depth",
        "one outlier of 5 m",
        changes.edited(DEPTH, BEGIN, BEGIN + 0.15, pressure(lambda p: p + 5.0 * _METRE)),
        (update_reason("gate", topic=DEPTH), *_HONEST),
        end=BEGIN + 0.15,
        sensors=SENSORS,
    ),
)
