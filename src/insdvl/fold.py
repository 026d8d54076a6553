"""The state as a fold over events, sorted by (stamp, kind, payload): it depends on stamps alone.

IMU samples are kept in arrays in the order of their stamps, the other events in a sorted list. The
state after sample k includes every event up to its stamp and is kept beside it. An event that
arrives late changes the states from its sample on; they are folded again from the one before. So
all orders of arrival within `max_delay` give the same bits.

An event between two samples cuts the sample that spans it, so it waits for that sample.
"""

import bisect
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.events import NS, Dvl, Event, Imu, Initial, Origin, ProcessNoise
from insdvl.filter import Filter, UpdateReport
from insdvl.kernels import kernel
from insdvl.odometry import Odometry, odometry
from insdvl.parameters import FilterParameters
from insdvl.rotation import rotate
from insdvl.state import COUNTERS, NEVER, State

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Records = NDArray[np.void]


@dataclass(frozen=True, slots=True)
class AppliedUpdate:
    """A DVL measurement and what the filter did with it."""

    stamp_ns: int
    report: UpdateReport


@dataclass(order=True, slots=True)
class _Entry:
    """An event in the sorted list. Only the key takes part in comparisons."""

    key: tuple[int, int, bytes]
    event: Event = field(compare=False)
    report: UpdateReport | None = field(default=None, compare=False)


@kernel
def mean_rate(
    stamps_ns: Stamps, w_ib_b: Array, k: int, end_ns: int, length_ns: int, mean: Array
) -> int:
    """Mean of the samples over an interval, each weighted by its share of it.

    Args:
        stamps_ns: (N,) ends of the samples' intervals.
        w_ib_b: (N, 3) samples.
        k: Index of the sample whose interval holds the end.
        end_ns: End of the interval.
        length_ns: Its length; with 0 the mean is sample k.
        mean: (3,) result.

    Returns:
        The number of samples that took part.
    """
    start_ns = end_ns - length_ns
    total = 0.0
    count = 0
    mean[:] = 0.0
    j = k
    while j > 0 and stamps_ns[j] > start_ns:
        share = float(min(stamps_ns[j], end_ns) - max(stamps_ns[j - 1], start_ns))
        if share > 0.0:
            for i in range(3):
                mean[i] += share * w_ib_b[j, i]
            total += share
            count += 1
        j -= 1
    if count == 0:
        mean[:] = w_ib_b[k]
        return 1
    for i in range(3):
        mean[i] /= total
    return count


@kernel
def rotate_samples(out: Array, C: Array, samples: Array) -> None:
    """out[k] = C samples[k], for (N, 3) arrays; the same bits for any N."""
    for k in range(samples.shape[0]):
        rotate(out[k], C, samples[k])


class Fold:
    """Events in, odometry out.

    Args:
        parameters: Of the filter.
        capacity: Number of samples to make room for at first.
    """

    def __init__(self, parameters: FilterParameters, capacity: int = 4096) -> None:
        self.parameters = parameters
        self.filter = Filter(parameters)
        self._max_delay_ns = round(parameters.max_delay * NS)
        self._output_delay_ns = round(parameters.output_delay * NS)
        self._gyro_average_ns = round(parameters.dvl.gyro_average * NS)
        self._capacity = capacity
        self.reset()

    def reset(self) -> None:
        """Forget everything; initialisation starts again."""
        self._start = self.filter.start()
        self._state = self._start.copy()
        self._count = 0
        self._stamps = np.empty(self._capacity, dtype=np.int64)
        self._f_b = np.empty((self._capacity, 3))
        self._w_ib_b = np.empty((self._capacity, 3))
        self._states = np.empty(self._capacity, dtype=self._start.dtype)
        self._entries: list[_Entry] = []
        self._unpublished: list[_Entry] = []  # DVL measurements, until `take` has given them
        self._stale = 0  # index of the first sample whose state is not valid
        self._published_ns = NEVER

    # ---------------------------------------------------------------- input

    def add(self, event: Event) -> str | None:
        """Insert an event.

        Returns:
            None, or why it was not used: ``not_finite``, ``too_late`` (older than the newest sample
            by more than max_delay), ``duplicate`` (of one stamp and kind, the event with the
            smallest payload counts, whichever comes first).
        """
        if not _finite(event):
            return "not_finite"
        if self._count and event.stamp_ns < self.newest_ns - self._max_delay_ns:
            return "too_late"
        return self._add_imu(event) if isinstance(event, Imu) else self._add_entry(event)

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample, NEVER before the first."""
        return int(self._stamps[self._count - 1]) if self._count else NEVER

    def _add_imu(self, sample: Imu) -> str | None:
        rotated = np.empty((2, 3))
        rotate_samples(rotated, self.filter.C_b_i, np.array([sample.f_b, sample.w_ib_b]))
        f_b, w_ib_b = rotated
        n, stamp_ns = self._count, sample.stamp_ns
        if n and stamp_ns <= self._stamps[n - 1]:
            k = int(np.searchsorted(self._stamps[:n], stamp_ns))
            if self._stamps[k] == stamp_ns:
                kept = self._f_b[k].tobytes() + self._w_ib_b[k].tobytes()
                if f_b.tobytes() + w_ib_b.tobytes() < kept:
                    self._f_b[k], self._w_ib_b[k] = f_b, w_ib_b
                    self._stale = min(self._stale, k)
                return "duplicate"
        else:
            k = n
        if n == self._stamps.size:
            k -= self._make_room()
            n = self._count
        for array, value in (
            (self._stamps, stamp_ns),
            (self._f_b, f_b),
            (self._w_ib_b, w_ib_b),
        ):
            array[k + 1 : n + 1] = array[k:n]
            array[k] = value
        self._count = n + 1
        self._stale = min(self._stale, k)
        return None

    def add_samples(self, stamps_ns: Stamps, f_b: Array, w_ib_b: Array) -> None:
        """Insert all samples of a recording at once, into a fold that has none yet.

        Args:
            stamps_ns: (N,) stamps, strictly increasing.
            f_b: (N, 3) specific force [m/s^2], IMU axes, forward-right-down.
            w_ib_b: (N, 3) angular rate [rad/s], same axes.

        Raises:
            ValueError: The arrays do not fit, are not finite, or the stamps do not increase.
        """
        n = len(stamps_ns)
        if self._count:
            raise ValueError(f"the fold must be empty, it has {self._count} samples")
        if f_b.shape != (n, 3) or w_ib_b.shape != (n, 3):
            raise ValueError(
                f"f_b and w_ib_b must have shape ({n}, 3), got {f_b.shape} and {w_ib_b.shape}"
            )
        if not (np.isfinite(f_b).all() and np.isfinite(w_ib_b).all()):
            raise ValueError("f_b and w_ib_b must be finite")
        late = np.flatnonzero(np.diff(stamps_ns) <= 0)
        if late.size:
            at = int(late[0])
            raise ValueError(
                f"stamps_ns must increase, got {stamps_ns[at + 1]} after {stamps_ns[at]} at "
                f"index {at + 1}"
            )
        if n > self._stamps.size:
            self._grow(n)
        self._stamps[:n] = stamps_ns
        rotate_samples(self._f_b, self.filter.C_b_i, f_b)
        rotate_samples(self._w_ib_b, self.filter.C_b_i, w_ib_b)
        self._count, self._stale = n, 0

    def _add_entry(self, event: Event) -> str | None:
        entry = _Entry((event.stamp_ns, int(event.kind), event.payload()), event)
        at = bisect.bisect_left(self._entries, (*entry.key[:2], b""), key=lambda e: e.key)
        duplicate = at < len(self._entries) and self._entries[at].key[:2] == entry.key[:2]
        if duplicate:
            kept = self._entries[at]
            if entry.key >= kept.key:
                return "duplicate"
            kept.key, kept.event = entry.key, event
        else:
            self._entries.insert(at, entry)
            if isinstance(event, Dvl):
                self._unpublished.append(entry)
        k = int(np.searchsorted(self._stamps[: self._count], event.stamp_ns))
        self._stale = min(self._stale, k)
        return "duplicate" if duplicate else None

    def _make_room(self) -> int:
        """Drop the samples and events that nothing can reach any more; returns how many samples.

        What is kept reaches back by max_delay, and before that by the averaging of the turn rate.
        """
        self._fold()
        oldest_ns = self.newest_ns - self._max_delay_ns
        reach_ns = min(oldest_ns, self._published_ns) - self._gyro_average_ns
        drop = max(int(np.searchsorted(self._stamps[: self._count], reach_ns)) - 2, 0)
        if drop < max(self._count // 2, 1):  # the buffer is too small for the delays: double it
            self._grow(2 * self._stamps.size)
            return 0
        self._start[0] = self._states[drop - 1]
        keep = self._count - drop
        for array in (self._stamps, self._f_b, self._w_ib_b, self._states):
            array[:keep] = array[drop : self._count].copy()
        self._count = self._stale = keep
        start_ns = int(self._start[0]["imu_ns"])
        self._entries = [e for e in self._entries if e.event.stamp_ns > start_ns]
        return drop

    def _grow(self, size: int) -> None:
        self._stamps = _grown(self._stamps, size)
        self._f_b = _grown(self._f_b, size)
        self._w_ib_b = _grown(self._w_ib_b, size)
        self._states = _grown(self._states, size)

    # ---------------------------------------------------------------- fold

    def _fold(self) -> None:
        """Make the states of all samples valid."""
        n = self._count
        if self._stale >= n:
            return
        k = self._stale
        state = self._state
        state[0] = self._states[k - 1] if k else self._start[0]
        entries = self._entries
        e = bisect.bisect_right(entries, int(state[0]["imu_ns"]), key=lambda x: x.event.stamp_ns)
        while k < n:
            if state[0]["initialised"]:
                next_ns = entries[e].event.stamp_ns if e < len(entries) else None
                run_end = n if next_ns is None else int(np.searchsorted(self._stamps[:n], next_ns))
                if run_end > k:
                    self.filter.predict_samples(
                        state, self._stamps, self._f_b, self._w_ib_b, k, run_end, self._states
                    )
                    k = run_end
                    continue
            e = self._fold_sample(state, k, e)
            self._states[k] = state[0]
            k += 1
        self._stale = n

    def _fold_sample(self, state: Records, k: int, e: int) -> int:
        """Advance over sample k and the events in its interval; returns the next event's index."""
        entries = self._entries
        stamp_ns, f_b, w_ib_b = int(self._stamps[k]), self._f_b[k], self._w_ib_b[k]
        while e < len(entries) and entries[e].event.stamp_ns < stamp_ns:
            event = entries[e].event
            if state[0]["initialised"] and not (isinstance(event, Initial) and event.once):
                self.filter.predict_part(state, stamp_ns, f_b, w_ib_b, event.stamp_ns)
            self._apply(state, entries[e], k)
            e += 1
        if state[0]["initialised"]:
            self.filter.predict_samples(
                state, self._stamps, self._f_b, self._w_ib_b, k, k + 1, self._states
            )
        else:
            self.filter.await_start(state, Imu(stamp_ns, f_b, w_ib_b))
        while e < len(entries) and entries[e].event.stamp_ns == stamp_ns:
            self._apply(state, entries[e], k)
            e += 1
        return e

    def _apply(self, state: Records, entry: _Entry, k: int) -> None:
        """Apply an event at the time of the state, inside or at the end of sample k's interval."""
        event = entry.event
        if isinstance(event, Dvl):
            mean = np.empty(3)
            samples = mean_rate(
                self._stamps, self._w_ib_b, k, event.stamp_ns, self._gyro_average_ns, mean
            )
            entry.report = self.filter.update(state, event, mean, samples)
        elif isinstance(event, ProcessNoise):
            self.filter.tell_process_noise(state, event)
        elif isinstance(event, Initial):
            if not (event.once and state[0]["initialised"]):
                self.filter.initialise(state, event, event.stamp_ns, self._w_ib_b[k])
        elif isinstance(event, Origin):
            self.filter.locate(state, event)

    # ---------------------------------------------------------------- output

    @property
    def latest(self) -> State | None:
        """State at the newest sample, None while there is none or it is not initialised."""
        self._fold()
        if self._count == 0 or not self._states[self._count - 1]["initialised"]:
            return None
        return self._states[self._count - 1]

    @property
    def states(self) -> Records:
        """(N,) states at the stamps of the samples that are kept."""
        self._fold()
        return self._states[: self._count]

    @property
    def updates(self) -> list[AppliedUpdate]:
        """What was done with the DVL measurements that are kept, in the order of stamps."""
        self._fold()
        return [
            AppliedUpdate(entry.event.stamp_ns, entry.report)
            for entry in self._entries
            if entry.report is not None
        ]

    @property
    def counts(self) -> dict[str, int]:
        """Counters of the newest state: gaps, time-outs of Q, floors, recoveries of the gate."""
        self._fold()
        s = self._states[self._count - 1] if self._count else self._start[0]
        return {name: int(s[name]) for name in COUNTERS}

    def take(self) -> list[Odometry | AppliedUpdate]:
        """What became publishable since the last call, in the order of stamps.

        Odometry for every new sample that is `output_delay` old; what was taken once is not given
        again, even where a late event has changed it since.
        """
        self._fold()
        if self._count == 0:
            return []
        until_ns = self.newest_ns - self._output_delay_ns
        outputs: list[Odometry | AppliedUpdate] = []
        waiting = []
        for entry in self._unpublished:
            if entry.report is None or entry.event.stamp_ns > until_ns:
                waiting.append(entry)
            else:
                outputs.append(AppliedUpdate(entry.event.stamp_ns, entry.report))
        self._unpublished = waiting
        stamps = self._stamps[: self._count]
        first = int(np.searchsorted(stamps, self._published_ns, side="right"))
        last = int(np.searchsorted(stamps, until_ns, side="right"))
        for k in range(first, last):
            if self._states[k]["initialised"]:
                outputs.append(odometry(self.filter, self._states, k))
        if last > first:
            self._published_ns = int(stamps[last - 1])
        outputs.sort(key=lambda output: output.stamp_ns)
        return outputs


def _grown(array: NDArray[Any], size: int) -> NDArray[Any]:
    larger = np.empty((size, *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


def _finite(event: Event) -> bool:
    if isinstance(event, Imu):
        values: Sequence[Array | None] = (event.f_b, event.w_ib_b)
    elif isinstance(event, Dvl):
        values = (event.v_d, event.R)
    elif isinstance(event, ProcessNoise):
        values = (event.Q_f, event.Q_w)
    elif isinstance(event, Initial):
        values = (event.C_n_b, event.p_n, event.v, event.P_v, event.P_psi, event.P_p)
    else:
        values = (np.array([event.lat, event.lon, event.h]),)
    # On so few numbers this is several times as fast as numpy's own check.
    return all(value is None or all(map(isfinite, value.ravel().tolist())) for value in values)


@dataclass(frozen=True)
class FoldResult:
    """A recording, folded.

    Attributes:
        filter: The filter, for `odometry.odometry(filter, states, k)`.
        states: (N,) state records at the samples' stamps, after the updates.
        updates: What was done with each DVL measurement, in the order of stamps.
        counts: Counters at the end.
        refused: Events that were not used, by reason.
    """

    filter: Filter
    states: Records
    updates: list[AppliedUpdate]
    counts: dict[str, int]
    refused: dict[str, int]


def run(
    parameters: FilterParameters,
    stamps_ns: Stamps,
    f_b: Array,
    w_ib_b: Array,
    events: Sequence[Event],
) -> FoldResult:
    """Fold a whole recording: the states that `Fold` reaches when everything has arrived.

    Args:
        parameters: Of the filter.
        stamps_ns: (N,) stamps of the samples, strictly increasing.
        f_b: (N, 3) specific force [m/s^2], IMU axes, forward-right-down.
        w_ib_b: (N, 3) angular rate [rad/s], same axes.
        events: All other events, in any order.

    Raises:
        ValueError: The arrays do not fit, are not finite, or the stamps do not increase.
    """
    fold = Fold(parameters, capacity=max(len(stamps_ns), 1))
    refused = Counter(reason for event in events if (reason := fold.add(event)) is not None)
    fold.add_samples(stamps_ns, f_b, w_ib_b)
    return FoldResult(
        filter=fold.filter,
        states=fold.states,
        updates=fold.updates,
        counts=fold.counts,
        refused=dict(refused),
    )
