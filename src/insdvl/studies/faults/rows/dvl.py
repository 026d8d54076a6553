"""Faults of the DVL."""

import numpy as np

from insdvl.messages.topics import DVL, DVL_WITH_COVARIANCE
from insdvl.navigation.events import NS
from insdvl.studies.faults import changes
from insdvl.studies.faults.changes import axis, velocity
from insdvl.studies.faults.checks import (
    covered,
    nothing_refused,
    recovers,
    refused,
    rejoins,
    same_bits,
    update_reason,
    used,
)
from insdvl.studies.faults.rows.base import BEGIN, END, ONE_SEED, FlightRow
from insdvl.studies.faults.stream import Sensors


def _rows() -> list[FlightRow]:
    rows = []
    for outage in (10.0, 60.0, 120.0):
        rows.append(
            FlightRow(
                "DVL",
                f"outage of {outage:g} s",
                changes.dropped(DVL, 60.0, 60.0 + outage),
                (nothing_refused(), covered(), recovers(10.0), rejoins()),
                begin=60.0,
                end=60.0 + outage,
            )
        )
    rows += [
        FlightRow(
            "DVL",
            "one outlier of 3 m/s",
            changes.outliers(BEGIN, BEGIN + 0.5, 3.0),
            (update_reason("gate"), covered(), recovers(10.0), rejoins()),
            end=BEGIN + 0.5,
        ),
        FlightRow(
            "DVL",
            "ten outliers of 3 m/s in a row",
            changes.outliers(BEGIN, BEGIN + 10.0, 3.0),
            (update_reason("gate"), covered(), recovers(10.0), rejoins()),
            end=BEGIN + 10.0,
            sensors=Sensors(imu="good"),
        ),
        FlightRow(
            "DVL",
            "bias of 1 m/s for 30 s",
            changes.edited(DVL, BEGIN, END, velocity(lambda v: v + np.array([1.0, 0.0, 0.0]))),
            (update_reason("gate"), covered(), recovers(10.0), rejoins()),
            sensors=Sensors(imu="good"),
        ),
        FlightRow(
            "DVL",
            "bottom lock lost for 30 s: zeros",
            changes.edited(DVL, BEGIN, END, velocity(np.zeros_like)),
            (update_reason("no_lock"), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "bottom lock lost for 30 s: the last velocity again and again",
            changes.held(DVL, BEGIN, END),
            (update_reason("repeated"), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "bottom lock lost for 30 s: NaN",
            changes.edited(DVL, BEGIN, END, velocity(lambda v: v * np.nan)),
            (refused("not_finite", DVL), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "infinity in an axis for 30 s",
            changes.edited(DVL, BEGIN, END, velocity(axis(1, -np.inf))),
            (refused("not_finite", DVL), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "copies without a stamp (zero)",
            changes.added(DVL, BEGIN, END, changes.stamped(0, 0)),
            (refused("no_stamp", DVL), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "DVL",
            "copies with negative seconds",
            changes.added(DVL, BEGIN, END, changes.stamped(-1000, 0)),
            (refused("bad_stamp", DVL), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "DVL",
            "out of order beyond max_delay, every second measurement",
            changes.invalid_when_late(DVL, BEGIN, END, 3.0, 0.5),
            (refused("too_late", DVL), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "a second publisher, same stamps, with a covariance",
            changes.second_publisher(BEGIN, END, 0.0, DVL_WITH_COVARIANCE),
            (refused("duplicate", DVL_WITH_COVARIANCE), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "DVL",
            "a second publisher, stamps 1 ms later",
            changes.second_publisher(BEGIN, END, 0.001, DVL),
            (update_reason("repeated"), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "a second publisher, stamps 1 ms later, rounded to 1 mm/s",
            changes.second_publisher(BEGIN, END, 0.001, DVL, decimals=3),
            # Two measurements share one noise: sigma is too small, at most by sqrt(2).
            (nothing_refused(), used(54), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "another frame_id",
            changes.edited(DVL, BEGIN, END, changes.framed("camera")),
            (refused("wrong_frame", DVL), covered(), recovers(10.0), rejoins()),
            parameters={"dvl.frame_id": "dvl_link"},
        ),
        FlightRow(
            "DVL",
            "one copy with a stamp 10^6 s ahead",
            changes.added(DVL, BEGIN, BEGIN + 0.5, changes.shifted(10**6 * NS)),
            (refused("far_ahead", DVL), same_bits()),
            seeds=ONE_SEED,
        ),
    ]
    wrong = np.eye(6).ravel()
    wrong[0] = -0.01
    for words, covariance in (
        ("a covariance of 9 numbers", np.eye(3).ravel()),
        ("a covariance of 35 numbers", np.ones(35)),
        ("an empty covariance", np.zeros(0)),
        ("a covariance of NaN", np.full(36, np.nan)),
        ("a negative variance", wrong),
    ):
        rows.append(
            FlightRow(
                "DVL",
                f"copies with {words}",
                changes.added(
                    DVL, BEGIN, END, changes.with_covariance(covariance), onto=DVL_WITH_COVARIANCE
                ),
                (refused("bad_covariance", DVL_WITH_COVARIANCE), same_bits()),
                seeds=ONE_SEED,
            )
        )
    return rows


ROWS = tuple(_rows())
