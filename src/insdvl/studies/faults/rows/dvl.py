"""Faults of the DVL."""

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.topics import DVL, DVL_WITH_COVARIANCE
from insdvl.navigation.events import NS
from insdvl.studies.faults import changes
from insdvl.studies.faults.changes import axis, velocity
from insdvl.studies.faults.checks import (
    covered,
    error_below,
    none_refused,
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

#: What DVLs without bottom lock report in place of a velocity [m/s]: the smallest 16-bit number.
FILL = -32.768


#: What a DVL reads more of the water than of the bottom, in a current [m/s].
WATER = np.array([0.3, 0.4, 0.0])


def _noise(v: Array) -> Array:
    """Nothing but noise (3,) [m/s], another one for each velocity."""
    seed = np.frombuffer(v.tobytes(), np.uint32)
    return 0.02 * np.random.default_rng(seed).standard_normal(3)


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
            "the last two velocities in turn for 30 s",
            changes.held(DVL, BEGIN, END, 2),
            (update_reason("repeated"), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "in whole mm/s",
            changes.edited(DVL, 0.0, END, velocity(lambda v: v.round(3)), valid=True),
            (none_refused(), covered(), recovers(10.0), rejoins()),
        ),
        FlightRow(
            "DVL",
            "bottom lock lost for 120 s: z is -32.768 m/s",
            changes.edited(DVL, 60.0, 180.0, velocity(axis(2, FILL))),
            (update_reason("too_fast"), covered(), recovers(10.0), rejoins()),
            begin=60.0,
            end=180.0,
        ),
        FlightRow(
            "DVL",
            "bottom lock lost for 120 s: -32.768 m/s and zeros in turn",
            changes.alternating(
                DVL, 60.0, 180.0, velocity(lambda v: 0.0 * v + FILL), velocity(np.zeros_like)
            ),
            (update_reason("too_fast or no_lock"), covered(), recovers(10.0), rejoins()),
            begin=60.0,
            end=180.0,
        ),
        FlightRow(
            "DVL",
            "bottom lock lost for 120 s: -32.768 m/s, off by the rounding of the velocity",
            changes.edited(DVL, 60.0, 180.0, velocity(lambda v: FILL + v.round(3) - v)),
            (update_reason("too_fast"), covered(), recovers(10.0), rejoins()),
            begin=60.0,
            end=180.0,
        ),
        FlightRow(
            "DVL",
            "bottom lock lost for 60 s: zeros with a noise of 2 cm/s",
            changes.edited(DVL, BEGIN, BEGIN + 60.0, velocity(_noise)),
            (covered(), recovers(10.0), rejoins()),
            end=BEGIN + 60.0,
            sensors=Sensors(imu="good", dvl_rate=5.0, dvl_noise=0.02),
            parameters={"dvl.noise_std": (0.02,) * 3},
        ),
        FlightRow(
            "DVL",
            "bottom and water in turn for 60 s, off by 0.5 m/s",
            changes.alternating(
                DVL, BEGIN, BEGIN + 60.0, velocity(lambda v: v), velocity(lambda v: v + WATER)
            ),
            # No rule tells which of the two is right; without the gate it is up to 0.4 m/s.
            (error_below(0.6), recovers(40.0), rejoins()),
            end=BEGIN + 60.0,
            sensors=Sensors(imu="good", dvl_noise=0.02),
            parameters={"dvl.noise_std": (0.02,) * 3},
        ),
        FlightRow(
            "DVL",
            "in cm/s for 30 s",
            changes.edited(DVL, BEGIN, END, velocity(lambda v: 100.0 * v)),
            (update_reason("too_fast"), covered(), recovers(10.0), rejoins()),
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
    nothing = np.zeros((3, 3))
    skewed, unknown, blind = 0.01 * np.eye(3), nothing.copy(), 0.01 * np.eye(3)
    skewed[0, 1] = 1.9e-10
    unknown[0, 0] = -1.0
    blind[1, 1] = np.inf
    for words, told in (
        ("a variance of 2.4e-8 (m/s)^2 with every velocity, true 1e-4", 2.4e-8 * np.eye(3)),
        ("a variance of 4e-6 (m/s)^2 with every velocity, true 1e-4", 4e-6 * np.eye(3)),
        ("a variance of 2.5e-5 (m/s)^2 with every velocity, true 1e-4", 2.5e-5 * np.eye(3)),
    ):
        rows.append(
            FlightRow(
                "DVL",
                words,
                changes.told(0.0, END, told),
                (nothing_refused(), none_refused(), covered(), rejoins()),
                parameters={"dvl.noise_std": (0.01,) * 3},
                sensors=Sensors(imu="good", dvl_rate=5.0, dvl_noise=0.01),
            )
        )
    for words, told in (
        ("an asymmetry of 1.9e-8 of the largest element", skewed),
        ("-1 for the first variance", unknown),
        ("an infinite variance of y", blind),
    ):
        rows.append(
            FlightRow(
                "DVL",
                f"{words}, for 30 s",
                changes.told(BEGIN, END, told),
                (nothing_refused(), none_refused(), covered(), recovers(10.0), rejoins()),
            )
        )
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
