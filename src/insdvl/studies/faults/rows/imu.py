"""Faults of the IMU."""

from collections.abc import Callable
from typing import Any

import numpy as np

from insdvl.messages.topics import IMU
from insdvl.navigation.events import NS
from insdvl.studies.faults import changes
from insdvl.studies.faults.changes import FORCE, RATE, Change, axis, triad
from insdvl.studies.faults.checks import (
    counter,
    covered,
    error_below,
    nothing_refused,
    recovers,
    refused,
    rejoins,
    same_bits,
)
from insdvl.studies.faults.rows.base import BEGIN, END, ONE_SEED, FlightRow
from insdvl.studies.faults.stream import Sensors


def _once(edit: Callable[[Any], Any], topic: str = IMU) -> Change:
    """One changed copy of a message beside it, at BEGIN."""
    return changes.added(topic, BEGIN, BEGIN + 0.005, edit)


def _rows() -> list[FlightRow]:
    rows = [
        FlightRow(
            "IMU",
            "NaN in a channel, 1 % of the samples",
            changes.edited(IMU, BEGIN, END, triad(FORCE, axis(0, np.nan)), share=0.01),
            (refused("not_finite", IMU), covered(), recovers(10.0)),
        ),
        FlightRow(
            "IMU",
            "infinity in a channel, half a second",
            changes.edited(IMU, BEGIN, BEGIN + 0.5, triad(RATE, axis(2, np.inf))),
            (refused("not_finite", IMU), counter("gaps", 1), covered(), recovers(10.0)),
            end=BEGIN + 0.5,
        ),
        FlightRow(
            "IMU",
            "1e300 in a channel, one sample",
            changes.edited(IMU, BEGIN, BEGIN + 0.005, triad(FORCE, axis(1, 1e300))),
            (refused("out_of_range", IMU), covered(), recovers(10.0)),
            end=BEGIN + 0.01,
        ),
        FlightRow(
            "IMU",
            "another frame_id, every tenth message",
            changes.edited(IMU, BEGIN, END, changes.framed("camera"), share=0.1),
            (refused("wrong_frame", IMU), covered(), recovers(10.0)),
            parameters={"imu.frame_id": "imu_link"},
        ),
        FlightRow(
            "IMU",
            "copies without a stamp (zero)",
            changes.added(IMU, BEGIN, END, changes.stamped(0, 0), share=0.1),
            (refused("no_stamp", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "IMU",
            "copies with negative seconds",
            changes.added(IMU, BEGIN, END, changes.stamped(-1000, 0), share=0.1),
            (refused("bad_stamp", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "IMU",
            "copies with 2e9 nanoseconds",
            changes.added(IMU, BEGIN, END, changes.stamped(1080, 2 * NS), share=0.1),
            (refused("bad_stamp", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "IMU",
            "one copy with a stamp 10^6 s ahead",
            _once(changes.shifted(10**6 * NS)),
            (refused("far_ahead", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "IMU",
            "one copy with a stamp 500 s old",
            _once(changes.shifted(-500 * NS)),
            (refused("too_late", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "IMU",
            "every sample twice",
            changes.added(IMU, BEGIN, END, lambda message: message),
            (refused("duplicate", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "IMU",
            "every sample twice, the second rounded",
            changes.added(IMU, BEGIN, END, triad(FORCE, lambda f: f.round(2))),
            (refused("duplicate", IMU), covered(), recovers(10.0)),
        ),
        FlightRow(
            "IMU",
            "out of order within max_delay, all topics",
            changes.network(jitter=1.0),
            (nothing_refused(), same_bits()),
            parameters={"output_delay": 2.0},
            seeds=ONE_SEED,
        ),
        FlightRow(
            "IMU",
            "out of order beyond max_delay, every tenth sample",
            changes.invalid_when_late(IMU, BEGIN, END, 3.0, 0.1),
            (refused("too_late", IMU), covered(), recovers(10.0)),
        ),
    ]
    for gap, counted in ((0.01, 0), (0.1, 1), (1.0, 1), (10.0, 1)):
        rows.append(
            FlightRow(
                "IMU",
                f"gap of {gap:g} s in a turn",
                changes.dropped(IMU, 47.0, 47.0 + gap),
                (nothing_refused(), counter("gaps", counted), covered(), recovers(20.0), rejoins()),
                begin=47.0,
                end=47.0 + gap,
            )
        )
    rows += [
        FlightRow(
            "IMU",
            "accelerometer x stuck at its range for 10 s; range declared",
            changes.clipped(FORCE, 0, 20.0, BEGIN, BEGIN + 10.0, push=50.0),
            (nothing_refused(), counter("saturated", 1000), covered(), recovers(20.0), rejoins()),
            end=BEGIN + 10.0,
            parameters={"imu.acceleration_range": 20.0},
        ),
        FlightRow(
            "IMU",
            "gyroscope z at its range in a turn of 30 s; range declared",
            changes.clipped(RATE, 2, 0.1, 130.0, 160.0, push=0.0),
            (nothing_refused(), counter("saturated", 500, 3000), covered(), recovers(20.0)),
            begin=130.0,
            end=160.0,
            parameters={"imu.rate_range": 0.1},
        ),
        FlightRow(
            "IMU",
            "gyroscope z stuck at its range for 10 s; range declared",
            changes.clipped(RATE, 2, 2.0, BEGIN, BEGIN + 10.0, push=5.0),
            (nothing_refused(), counter("saturated", 1000), covered(), recovers(20.0), rejoins()),
            end=BEGIN + 10.0,
            parameters={"imu.rate_range": 2.0},
        ),
    ]
    rows += [
        FlightRow(
            "IMU",
            "accelerometer x stuck at its range for 10 s; no range declared",
            changes.clipped(FORCE, 0, 20.0, BEGIN, BEGIN + 10.0, push=50.0),
            # The readings are used until they count as frozen; then the covariance covers their
            # effect, and the gate accepts at once.
            (
                nothing_refused(),
                counter("saturated", 0),
                counter("frozen", 901, 1000),
                recovers(40.0),
                rejoins(),
            ),
            end=BEGIN + 10.0,
        ),
        FlightRow(
            "IMU",
            "gyroscope z at its range in a turn of 30 s; no range declared",
            changes.clipped(RATE, 2, 0.1, 130.0, 160.0, push=0.0),
            # The filter cannot know: the missed turn is a heading error that no sigma covers, and
            # only the DVL brings the velocity back.
            (nothing_refused(), counter("saturated", 0), recovers(40.0), rejoins()),
            begin=130.0,
            end=160.0,
        ),
    ]
    for name, channel, words in (
        (FORCE, 0, "accelerometer x"),
        (FORCE, 2, "accelerometer z"),
        (RATE, 2, "gyroscope z"),
    ):
        # In a turn with a change of pitch.
        rows.append(
            FlightRow(
                "IMU",
                f"{words} frozen for 30 s",
                changes.frozen(name, channel, 110.0, 140.0),
                (
                    nothing_refused(),
                    counter("frozen", 2901, 3000),
                    covered(),
                    recovers(20.0),
                    rejoins(),
                ),
                begin=110.0,
                end=140.0,
            )
        )
    rows += _glitches()
    for rate in (50.0, 200.0, 1000.0):
        rows.append(
            FlightRow(
                "IMU",
                f"IMU at {rate:g} Hz",
                changes.unchanged,
                (nothing_refused(), covered(), rejoins()),
                begin=40.0 if rate > 500.0 else BEGIN,
                end=50.0 if rate > 500.0 else END,
                sensors=Sensors(rate=rate),
            )
        )
    return rows


def _glitches() -> list[FlightRow]:
    """Samples that say nothing, or something else than their neighbours."""
    zeros = changes.both(triad(FORCE, np.zeros_like), triad(RATE, np.zeros_like))
    no_force = triad(FORCE, np.zeros_like)
    one, agree = (counter("glitches", 1), covered()), (error_below(2.0),)
    rows = []
    for words, edit, count, checks in (
        ("one sample of zeros", zeros, 1, (counter("no_data", 1), covered())),
        ("three samples of zeros", zeros, 3, (counter("no_data", 3), covered())),
        ("20 samples of zeros", zeros, 20, (counter("no_data", 20), covered())),
        ("a specific force of zero for 2 s", no_force, 200, (counter("no_data", 200), covered())),
        ("one sample of 60 m/s^2 in z", triad(FORCE, axis(2, 60.0)), 1, one),
        ("one sample of -1000 m/s^2 in x", triad(FORCE, axis(0, -1000.0)), 1, one),
        ("one sample of 10 rad/s about z", triad(RATE, axis(2, 10.0)), 1, one),
        # They agree with each other, so they are believed until the next DVL measurement.
        ("five samples of 3 m/s^2 in y", triad(FORCE, axis(1, 3.0)), 5, agree),
        ("two samples of 10 rad/s about z", triad(RATE, axis(2, 10.0)), 2, agree),
        ("four samples of 2 rad/s about x", triad(RATE, axis(0, 2.0)), 4, agree),
    ):
        end = BEGIN + count / 100.0 - 0.005
        rows.append(
            FlightRow(
                "IMU",
                words,
                changes.edited(IMU, BEGIN - 0.005, end, edit),
                (nothing_refused(), *checks, recovers(10.0), rejoins()),
                end=end,
                sensors=Sensors(imu="good", dvl_noise=0.02),
                parameters={"dvl.noise_std": (0.02,) * 3},
            )
        )
    return rows


ROWS = tuple(_rows())
