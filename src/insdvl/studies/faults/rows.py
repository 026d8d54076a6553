"""The rows of the fault matrix that are of messages and time: the fault, and what is expected."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from insdvl.navigation.events import NS
from insdvl.studies.faults import changes
from insdvl.studies.faults.changes import FORCE, RATE, Change, axis, triad, velocity
from insdvl.studies.faults.checks import (
    AFTER,
    SETTLE,
    Check,
    counter,
    covered,
    error_below,
    nothing_refused,
    recovers,
    refused,
    rejoins,
    same_bits,
    stops,
    update_reason,
    used,
)
from insdvl.studies.faults.stream import DVL, DVL_COVARIANCE, IMU, Q, Sensors

#: When most faults begin and end, from the start of the mission [s].
BEGIN, END = 80.0, 110.0
SEEDS = (1, 2, 3)
ONE_SEED = (1,)  # of what does not depend on the noise

NOISY = Sensors()
NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Row:
    """A fault and what is expected.

    Attributes:
        group: Part of the page.
        name: What happens, in words.
        change: The fault.
        checks: What is expected, beside what always is.
        begin: Of the fault, from the start of the mission [s].
        end: Of the fault [s].
        parameters: Of the filter, on top of those that fit the mission.
        sensors: What navigates.
        calm: What the flight without the fault has, where it is not the same.
        seeds: One flight each.
    """

    group: str
    name: str
    change: Change
    checks: tuple[Check, ...]
    begin: float = BEGIN
    end: float = END
    parameters: Mapping[str, Any] = field(default_factory=lambda: NOTHING)
    sensors: Sensors = NOISY
    calm: Sensors | None = None
    seeds: tuple[int, ...] = SEEDS

    @property
    def duration(self) -> float:
        """Of the mission [s], until all is looked at; most have the same, to share calm flights."""
        end = self.end if self.sensors.rate > 500.0 else max(self.end, END)
        return end + SETTLE + AFTER + 1.0

    def with_seeds(self, seeds: tuple[int, ...]) -> "Row":
        """The same, of other seeds."""
        return replace(self, seeds=seeds)


#: Start of a mission of the usual length whose last sample is 10 ms before 2^31 s.
LAST_START_NS = 2**31 * NS - round((END + SETTLE + AFTER + 1.01) * NS)

#: How a filter starts under way that does not know when its time jumps: it finds roll and pitch
#: from a second of specific force, and the velocity from the DVL.
LEVELLING: Mapping[str, Any] = MappingProxyType(
    {
        "initial.mode": "levelling",
        "initial.velocity_std": 1.5,
        "initial.tilt_std": 0.05,
        "initial.heading_std": 1.5,
    }
)


def _once(edit: Callable[[Any], Any], topic: str = IMU) -> Change:
    """One changed copy of a message beside it, at BEGIN."""
    return changes.added(topic, BEGIN, BEGIN + 0.005, edit)


def _imu_rows() -> list[Row]:
    rows = [
        Row(
            "IMU",
            "NaN in a channel, 1 % of the samples",
            changes.edited(IMU, BEGIN, END, triad(FORCE, axis(0, np.nan)), share=0.01),
            (refused("not_finite", IMU), covered(), recovers(10.0)),
        ),
        Row(
            "IMU",
            "infinity in a channel, half a second",
            changes.edited(IMU, BEGIN, BEGIN + 0.5, triad(RATE, axis(2, np.inf))),
            (refused("not_finite", IMU), counter("gaps", 1), covered(), recovers(10.0)),
            end=BEGIN + 0.5,
        ),
        Row(
            "IMU",
            "1e300 in a channel, one sample",
            changes.edited(IMU, BEGIN, BEGIN + 0.005, triad(FORCE, axis(1, 1e300))),
            (refused("out_of_range", IMU), covered(), recovers(10.0)),
            end=BEGIN + 0.01,
        ),
        Row(
            "IMU",
            "another frame_id, every tenth message",
            changes.edited(IMU, BEGIN, END, changes.framed("camera"), share=0.1),
            (refused("wrong_frame", IMU), covered(), recovers(10.0)),
            parameters={"imu.frame_id": "imu_link"},
        ),
        Row(
            "IMU",
            "copies without a stamp (zero)",
            changes.added(IMU, BEGIN, END, changes.stamped(0, 0), share=0.1),
            (refused("no_stamp", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "IMU",
            "copies with negative seconds",
            changes.added(IMU, BEGIN, END, changes.stamped(-1000, 0), share=0.1),
            (refused("bad_stamp", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "IMU",
            "copies with 2e9 nanoseconds",
            changes.added(IMU, BEGIN, END, changes.stamped(1080, 2 * NS), share=0.1),
            (refused("bad_stamp", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "IMU",
            "one copy with a stamp 10^6 s ahead",
            _once(changes.shifted(10**6 * NS)),
            (refused("far_ahead", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "IMU",
            "one copy with a stamp 500 s old",
            _once(changes.shifted(-500 * NS)),
            (refused("too_late", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "IMU",
            "every sample twice",
            changes.added(IMU, BEGIN, END, lambda message: message),
            (refused("duplicate", IMU), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "IMU",
            "every sample twice, the second rounded",
            changes.added(IMU, BEGIN, END, triad(FORCE, lambda f: f.round(2))),
            (refused("duplicate", IMU), covered(), recovers(10.0)),
        ),
        Row(
            "IMU",
            "out of order within max_delay, all topics",
            changes.network(jitter=1.0),
            (nothing_refused(), same_bits()),
            parameters={"output_delay": 2.0},
            seeds=ONE_SEED,
        ),
        Row(
            "IMU",
            "out of order beyond max_delay, every tenth sample",
            changes.invalid_when_late(IMU, BEGIN, END, 3.0, 0.1),
            (refused("too_late", IMU), covered(), recovers(10.0)),
        ),
    ]
    for gap, counted in ((0.01, 0), (0.1, 1), (1.0, 1), (10.0, 1)):
        rows.append(
            Row(
                "IMU",
                f"gap of {gap:g} s in a turn",
                changes.dropped(IMU, 47.0, 47.0 + gap),
                (nothing_refused(), counter("gaps", counted), covered(), recovers(20.0), rejoins()),
                begin=47.0,
                end=47.0 + gap,
            )
        )
    rows += [
        Row(
            "IMU",
            "accelerometer x stuck at its range for 10 s; range declared",
            changes.clipped(FORCE, 0, 20.0, BEGIN, BEGIN + 10.0, push=50.0),
            (nothing_refused(), counter("saturated", 1000), covered(), recovers(20.0), rejoins()),
            end=BEGIN + 10.0,
            parameters={"imu.acceleration_range": 20.0},
        ),
        Row(
            "IMU",
            "gyroscope z at its range in a turn of 30 s; range declared",
            changes.clipped(RATE, 2, 0.1, 130.0, 160.0, push=0.0),
            (nothing_refused(), counter("saturated", 500, 3000), covered(), recovers(20.0)),
            begin=130.0,
            end=160.0,
            parameters={"imu.rate_range": 0.1},
        ),
        Row(
            "IMU",
            "gyroscope z stuck at its range for 10 s; range declared",
            changes.clipped(RATE, 2, 2.0, BEGIN, BEGIN + 10.0, push=5.0),
            (nothing_refused(), counter("saturated", 1000), covered(), recovers(20.0), rejoins()),
            end=BEGIN + 10.0,
            parameters={"imu.rate_range": 2.0},
        ),
    ]
    rows += [
        Row(
            "IMU",
            "accelerometer x stuck at its range for 10 s; no range declared",
            changes.clipped(FORCE, 0, 20.0, BEGIN, BEGIN + 10.0, push=50.0),
            # The readings are taken as they are until they count as frozen: then the gate has no
            # patience, and the covariance covers what they have done.
            (
                nothing_refused(),
                counter("saturated", 0),
                counter("frozen", 901, 1000),
                recovers(40.0),
                rejoins(),
            ),
            end=BEGIN + 10.0,
        ),
        Row(
            "IMU",
            "gyroscope z at its range in a turn of 30 s; no range declared",
            changes.clipped(RATE, 2, 0.1, 130.0, 160.0, push=0.0),
            # Nobody knows: the turn that is missed is an error of heading that no sigma tells, and
            # the DVL alone brings the velocity back.
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
            Row(
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
    for rate in (50.0, 200.0, 1000.0):
        rows.append(
            Row(
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


def _dvl_rows() -> list[Row]:
    rows = []
    for outage in (10.0, 60.0, 120.0):
        rows.append(
            Row(
                "DVL",
                f"outage of {outage:g} s",
                changes.dropped(DVL, 60.0, 60.0 + outage),
                (nothing_refused(), covered(), recovers(10.0), rejoins()),
                begin=60.0,
                end=60.0 + outage,
            )
        )
    rows += [
        Row(
            "DVL",
            "one outlier of 3 m/s",
            changes.outliers(BEGIN, BEGIN + 0.5, 3.0),
            (update_reason("gate"), covered(), recovers(10.0), rejoins()),
            end=BEGIN + 0.5,
        ),
        Row(
            "DVL",
            "ten outliers of 3 m/s in a row",
            changes.outliers(BEGIN, BEGIN + 10.0, 3.0),
            (update_reason("gate"), covered(), recovers(10.0), rejoins()),
            end=BEGIN + 10.0,
            sensors=Sensors(imu="good"),
        ),
        Row(
            "DVL",
            "bias of 1 m/s for 30 s",
            changes.edited(DVL, BEGIN, END, velocity(lambda v: v + np.array([1.0, 0.0, 0.0]))),
            (update_reason("gate"), covered(), recovers(10.0), rejoins()),
            sensors=Sensors(imu="good"),
        ),
        Row(
            "DVL",
            "bottom lock lost for 30 s: zeros",
            changes.edited(DVL, BEGIN, END, velocity(np.zeros_like)),
            (update_reason("no_lock"), covered(), recovers(10.0), rejoins()),
        ),
        Row(
            "DVL",
            "bottom lock lost for 30 s: the last velocity again and again",
            changes.held(DVL, BEGIN, END),
            (update_reason("repeated"), covered(), recovers(10.0), rejoins()),
        ),
        Row(
            "DVL",
            "bottom lock lost for 30 s: NaN",
            changes.edited(DVL, BEGIN, END, velocity(lambda v: v * np.nan)),
            (refused("not_finite", DVL), covered(), recovers(10.0), rejoins()),
        ),
        Row(
            "DVL",
            "infinity in an axis for 30 s",
            changes.edited(DVL, BEGIN, END, velocity(axis(1, -np.inf))),
            (refused("not_finite", DVL), covered(), recovers(10.0), rejoins()),
        ),
        Row(
            "DVL",
            "copies without a stamp (zero)",
            changes.added(DVL, BEGIN, END, changes.stamped(0, 0)),
            (refused("no_stamp", DVL), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "DVL",
            "copies with negative seconds",
            changes.added(DVL, BEGIN, END, changes.stamped(-1000, 0)),
            (refused("bad_stamp", DVL), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "DVL",
            "out of order beyond max_delay, every second measurement",
            changes.invalid_when_late(DVL, BEGIN, END, 3.0, 0.5),
            (refused("too_late", DVL), covered(), recovers(10.0), rejoins()),
        ),
        Row(
            "DVL",
            "a second publisher, same stamps, with a covariance",
            changes.second_publisher(BEGIN, END, 0.0, DVL_COVARIANCE),
            (refused("duplicate", DVL_COVARIANCE), same_bits()),
            seeds=ONE_SEED,
        ),
        Row(
            "DVL",
            "a second publisher, stamps 1 ms later",
            changes.second_publisher(BEGIN, END, 0.001, DVL),
            (update_reason("repeated"), covered(), recovers(10.0), rejoins()),
        ),
        Row(
            "DVL",
            "a second publisher, stamps 1 ms later, rounded to 1 mm/s",
            changes.second_publisher(BEGIN, END, 0.001, DVL, decimals=3),
            # Two measurements with one noise: sigma is too small, by no more than sqrt(2).
            (nothing_refused(), used(54), covered(), recovers(10.0), rejoins()),
        ),
        Row(
            "DVL",
            "another frame_id",
            changes.edited(DVL, BEGIN, END, changes.framed("camera")),
            (refused("wrong_frame", DVL), covered(), recovers(10.0), rejoins()),
            parameters={"dvl.frame_id": "dvl_link"},
        ),
        Row(
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
            Row(
                "DVL",
                f"copies with {words}",
                changes.added(
                    DVL, BEGIN, END, changes.with_covariance(covariance), onto=DVL_COVARIANCE
                ),
                (refused("bad_covariance", DVL_COVARIANCE), same_bits()),
                seeds=ONE_SEED,
            )
        )
    return rows


def _process_noise_rows() -> list[Row]:
    external = {"process_noise.source": "external"}
    learned = Sensors(learned=True)

    def told(change: Callable[[Any], Any]) -> Change:
        return changes.edited(Q, BEGIN, END, change)

    return [
        Row(
            "Process noise",
            "not told for 30 s",
            changes.dropped(Q, BEGIN, END),
            (nothing_refused(), counter("q_timeouts", 1), covered(), recovers(10.0)),
            parameters=external,
        ),
        Row(
            "Process noise",
            "NaN for 30 s",
            told(changes.covariance(np.full((3, 3), np.nan))),
            (refused("bad_covariance", Q), counter("q_timeouts", 1), covered(), recovers(10.0)),
            parameters=external,
        ),
        Row(
            "Process noise",
            "zeros (unknown) for 30 s",
            told(changes.covariance(np.zeros((3, 3)))),
            (nothing_refused(), covered(), recovers(10.0)),
            parameters=external,
        ),
        Row(
            "Process noise",
            "far too small for 30 s: the floor",
            told(changes.covariance(1e-30 * np.eye(3))),
            # The sigma is wrong with its Q: what is asked for is that no good measurement is lost.
            (nothing_refused(), counter("floors", 30), error_below(1.0), rejoins()),
            parameters=external,
        ),
        Row(
            "Process noise",
            "far too large for 30 s: the ceiling",
            told(changes.covariance(1e5 * np.eye(3))),
            (nothing_refused(), counter("ceilings", 30), covered(), recovers(20.0), rejoins()),
            parameters=external,
        ),
        Row(
            "Process noise",
            "learned: NaN in a channel of the IMU, 1 % of the samples",
            changes.edited(IMU, BEGIN, END, triad(FORCE, axis(0, np.nan)), share=0.01),
            (refused("not_finite", IMU), covered(), recovers(10.0)),
            parameters=external,
            sensors=learned,
        ),
        Row(
            "Process noise",
            "learned: gap of 1 s in a turn",
            changes.dropped(IMU, 47.0, 48.0),
            (nothing_refused(), counter("gaps", 1), covered(), recovers(20.0), rejoins()),
            begin=47.0,
            end=48.0,
            parameters=external,
            sensors=learned,
        ),
        Row(
            "Process noise",
            "learned: 10 % of all messages lost",
            changes.network(loss=0.1),
            (nothing_refused(), covered(), rejoins(), error_below(1.0)),
            parameters=external,
            sensors=learned,
        ),
        Row(
            "Process noise",
            "learned: one sample of 100 m/s^2 in an axis of the IMU",
            changes.edited(IMU, BEGIN, BEGIN + 0.005, triad(FORCE, axis(0, 100.0))),
            # It is a velocity of 1 m/s, and what the tuner learns from it lasts for its window.
            (nothing_refused(), error_below(2.0), recovers(20.0), rejoins()),
            end=BEGIN + 0.005,
            parameters=external,
            sensors=learned,
        ),
    ]


def _way(step: float) -> str:
    return "ahead" if step > 0.0 else "back"


def _time_rows() -> list[Row]:
    rows = []
    for step in (1000.0, 40.0, -5.0, -500.0):
        rows.append(
            Row(
                "Time",
                f"clock set {_way(step)} by {abs(step):g} s; jump_action reset",
                changes.clock_step(BEGIN, step),
                (nothing_refused(), counter("time_jumps", 1), covered(), recovers(30.0), rejoins()),
                end=BEGIN,
                parameters=LEVELLING,
            )
        )
    for step in (1000.0, -500.0):
        rows.append(
            Row(
                "Time",
                f"clock set {_way(step)} by {abs(step):g} s; jump_action hold",
                changes.all_of(
                    changes.clock_step(BEGIN, step),
                    changes.unpublished(BEGIN, np.inf, (IMU, DVL)),
                ),
                (counter("time_jumps", 0), stops()),
                end=BEGIN,
                parameters={"jump_action": "hold"},
                seeds=ONE_SEED,
            )
        )
    rows += [
        Row(
            "Time",
            "clock set ahead by 1000 s and back after 5 s; jump_action hold",
            changes.all_of(
                changes.clock_step(BEGIN, 1000.0),
                changes.clock_step(BEGIN + 5.0, -1000.0),
                changes.unpublished(BEGIN, BEGIN + 5.0, (IMU, DVL)),
            ),
            # Two samples tell that the time in between was a gap; the first had been refused.
            (
                counter("time_jumps", 0),
                counter("gaps", 1),
                counter("recovered", 1),
                covered(),
                recovers(20.0),
                rejoins(),
            ),
            end=BEGIN + 5.0,
            parameters={"jump_action": "hold"},
        ),
        Row(
            "Time",
            "clock set back by 1 s, onto stamps that were there",
            changes.all_of(
                changes.clock_step(BEGIN, -1.0),
                changes.unpublished(BEGIN, BEGIN + 1.0, (IMU, DVL)),
            ),
            (refused("duplicate", IMU, DVL), covered(), recovers(20.0), rejoins()),
            end=BEGIN + 1.0,
        ),
        Row(
            "Time",
            "clock set back by 1.003 s, in between the stamps that were there",
            changes.all_of(
                changes.clock_step(BEGIN, -1.003),
                changes.unpublished(BEGIN, BEGIN + 1.003, (IMU,)),
            ),
            (nothing_refused(), covered(), recovers(20.0), rejoins()),
            end=BEGIN + 1.003,
        ),
        Row(
            "Time",
            "clock set ahead by 5 s, less than jump_limit",
            changes.clock_step(BEGIN, 5.0),
            (nothing_refused(), counter("gaps", 1), covered(), recovers(20.0), rejoins()),
            end=BEGIN,
        ),
        Row(
            "Time",
            "a recording that is played again from its beginning",
            changes.played_again(100.0),
            (
                nothing_refused(),
                counter("time_jumps", 1),
                covered(),
                error_below(3.0),
                rejoins(),
            ),
            begin=100.0,
            end=100.0,
            parameters=LEVELLING,
        ),
        Row(
            "Time",
            "stamps from 0",
            changes.unchanged,
            (nothing_refused(), same_bits()),
            sensors=Sensors(start_ns=0),
            calm=Sensors(),
            seeds=ONE_SEED,
        ),
        Row(
            "Time",
            "stamps up to 2^31 s",
            changes.unchanged,
            (nothing_refused(), same_bits()),
            sensors=Sensors(start_ns=LAST_START_NS),
            calm=Sensors(),
            seeds=ONE_SEED,
        ),
    ]
    return rows


def _network_rows() -> list[Row]:
    return [
        Row(
            "Network",
            f"{100.0 * loss:g} % of all messages lost",
            changes.network(loss=loss),
            (nothing_refused(), covered(), rejoins(), error_below(1.0)),
        )
        for loss in (0.001, 0.01, 0.1)
    ] + [
        Row(
            "Network",
            "20 % of all messages twice, all delayed by 0.2 to 1.2 s and reordered",
            changes.network(duplication=0.2, delay=0.2, jitter=1.0),
            (refused("duplicate", IMU, DVL), same_bits()),
            parameters={"output_delay": 2.0},
            seeds=ONE_SEED,
        ),
    ]


ROWS: tuple[Row, ...] = (
    *_imu_rows(),
    *_dvl_rows(),
    *_process_noise_rows(),
    *_time_rows(),
    *_network_rows(),
)
