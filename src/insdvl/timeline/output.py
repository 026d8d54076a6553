"""What a fold makes publishable: odometry, updates, time jumps; and the result of a recording."""

from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Records, Stamps
from insdvl.navigation.events import Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import rotation_from_quaternion
from insdvl.navigation.measurements.report import UpdateReport
from insdvl.navigation.odometry import Odometry, odometry
from insdvl.navigation.state.fields import State
from insdvl.timeline.entries import Entry
from insdvl.timeline.jumps import TimeJump


@dataclass(frozen=True, slots=True)
class AppliedUpdate:
    """A measurement and what the filter did with it."""

    stamp_ns: int
    report: UpdateReport


Output = Odometry | AppliedUpdate | TimeJump


@dataclass(frozen=True)
class FoldResult:
    """A recording, folded.

    Attributes:
        filter: The filter, for `odometry.odometry(filter, states, k)`.
        states: (N,) state records at the samples' stamps, after the updates; where a recording is
            folded with ``every`` above 1, those of every so many samples.
        track: (N,) records `kept.TRACK` at the samples' stamps.
        updates: What was done with each measurement, in the order of stamps.
        counts: Counters at the end.
        refused: Events that were not used, by reason.
    """

    filter: Filter
    states: Records
    track: Records
    updates: list[AppliedUpdate]
    counts: dict[str, int]
    refused: dict[str, int]


@dataclass(frozen=True, slots=True)
class Final:
    """What no later event can change any more.

    Attributes:
        states: (N,) state records at the samples' stamps, in the memory of the fold: they are valid
            until the next event is added.
        updates: What was done with the measurements up to the last of them, in the order of stamps.
        jump: With which their time was left behind them; None while it goes on.
    """

    states: Records
    updates: list[AppliedUpdate]
    jump: TimeJump | None


@dataclass(frozen=True, slots=True)
class LeftTime:
    """A time that was left, and what of it is not yet published.

    Attributes:
        jump: With which it was left.
        result: What it came to.
        stamps_ns: (N,) stamps of its samples.
        unpublished: Measurements.
        published_ns: Newest stamp that was published.
    """

    jump: TimeJump
    result: FoldResult
    stamps_ns: Stamps
    unpublished: list[Entry]
    published_ns: int

    def outputs(self) -> list[Output]:
        """All that is left to publish, then the jump: nothing can come late any more."""
        done, _ = split(self.unpublished, self.jump.from_ns)
        first, last = between(self.stamps_ns, self.published_ns, self.jump.from_ns)
        outputs = outputs_of(self.result.filter, self.result.states, first, last, done)
        return [*outputs, self.jump]

    @property
    def final(self) -> Final:
        """The same as records: nothing can come late any more."""
        done, _ = split(self.unpublished, self.jump.from_ns)
        first, last = between(self.stamps_ns, self.published_ns, self.jump.from_ns)
        return Final(self.result.states[first:last], applied(sorted(done)), self.jump)


def known_pose(filter_: Filter, state: State) -> Initial:
    """What the output of an initialised state says, as an initial state."""
    records = np.empty(1, state.dtype)
    records[0] = state
    o, axes = odometry(filter_, records, 0), filter_.vehicle.axes
    covariance = o.pose_covariance
    return Initial(
        stamp_ns=o.stamp_ns,
        C_o_b=axes.attitude(rotation_from_quaternion(o.quaternion_xyzw)),
        p_o=axes.nav @ o.position,
        v=axes.body @ o.twist_linear,
        velocity_frame="body",
        P_v=axes.body @ o.twist_covariance[:3, :3] @ axes.body,
        P_psi=axes.nav @ covariance[3:, 3:] @ axes.nav.T,
        P_p=axes.nav @ covariance[:3, :3] @ axes.nav.T,
    )


def applied(entries: list[Entry]) -> list[AppliedUpdate]:
    """The measurements among events, with what was done with them."""
    return [
        AppliedUpdate(entry.event.stamp_ns, entry.report)
        for entry in entries
        if entry.report is not None
    ]


def split(entries: list[Entry], until_ns: int) -> tuple[list[Entry], list[Entry]]:
    """Those that were applied and are not after a stamp, and the others."""
    done = [e for e in entries if e.report is not None and e.event.stamp_ns <= until_ns]
    if not done:
        return done, entries
    return done, [e for e in entries if e.report is None or e.event.stamp_ns > until_ns]


def between(stamps_ns: Stamps, after_ns: int, until_ns: int) -> tuple[int, int]:
    """Indices first <= k < last of the stamps after one time and up to another."""
    first, last = (int(stamps_ns.searchsorted(t, side="right")) for t in (after_ns, until_ns))
    return first, max(first, last)


def outputs_of(
    filter_: Filter, states: Records, first: int, last: int, entries: list[Entry]
) -> list[Output]:
    """Odometry of the states first <= k < last, and the updates, in the order of stamps."""
    outputs: list[Odometry | AppliedUpdate] = [*applied(entries)]
    for k in range(first, last):
        if states[k]["nav"]["initialised"]:
            outputs.append(odometry(filter_, states, k))
    outputs.sort(key=lambda output: output.stamp_ns)
    return [*outputs]
