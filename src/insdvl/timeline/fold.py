"""The state as a fold over events, sorted by (stamp, kind, payload): it depends on stamps alone.

IMU samples are kept in arrays in the order of their stamps, the other events in a sorted list. The
state after sample k includes every event up to its stamp and is kept beside it. An event that
arrives late changes the states from its sample on; they are folded again from the one before. So
all orders of arrival within `max_delay` give the same bits.

An event between two samples cuts the sample that spans it, so it waits for that sample.

What is of another time (a clock that was set, a recording that begins again) is refused but kept a
while as a suspect. When the samples of that time come one after the other, and none of the present
time in between, the fold begins again with them, or holds (see docs/filter.md, Time).
"""

import bisect
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.kernels import kernel
from insdvl.navigation.events import (
    NS,
    Dvl,
    Event,
    Imu,
    Initial,
    Kind,
    Origin,
    ProcessNoise,
    refusal,
)
from insdvl.navigation.filter import Filter, UpdateReport
from insdvl.navigation.geometry.rotation import rotate
from insdvl.navigation.odometry import Odometry, odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state import COUNTERS, NEVER, State

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Records = NDArray[np.void]


#: So many samples of another time in a row are a time jump.
JUMP_SAMPLES = 10
#: So many samples behind a gap longer than max_delay are believed; one alone may be a wrong stamp.
GAP_SAMPLES = 2
#: Samples of one run are no farther apart than this, or imu.max_gap where that is longer.
RUN_GAP_NS = NS
#: So many samples may be on their way to the filter (of one that is starved, in the queues of
#: sender and receiver) while what was measured with the newest of them is there already.
MAX_QUEUE = 10_000
#: Most events that are kept as suspects, and of each kind before the first sample.
MAX_SUSPECTS = 1000
MAX_WAITING = 1000


@dataclass(frozen=True, slots=True)
class AppliedUpdate:
    """A DVL measurement and what the filter did with it."""

    stamp_ns: int
    report: UpdateReport


@dataclass(frozen=True, slots=True)
class TimeJump:
    """The samples went over to another time.

    Attributes:
        from_ns: Newest stamp of the old time.
        to_ns: First stamp of the new time.
    """

    from_ns: int
    to_ns: int


@dataclass(slots=True)
class _Run:
    """Samples of another time that came one after the other."""

    first_ns: int
    last_ns: int
    count: int = 1


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
        self._jump_limit_ns = round(parameters.jump_limit * NS)
        max_gap_ns = round(parameters.imu.max_gap * NS)
        # A measurement, or a Q, may be ahead of the samples by so much.
        self._ahead_ns = max(self._jump_limit_ns, round(MAX_QUEUE / parameters.imu.rate * NS))
        self._near_ns = max(self._max_delay_ns, max_gap_ns)  # samples as near are of one time
        self._run_gap_ns = max(RUN_GAP_NS, max_gap_ns)
        self._capacity = capacity
        self._clear()

    def reset(self) -> None:
        """Forget everything but where odom lies on the Earth; initialisation starts again."""
        origins = [entry.event for entry in self._entries if isinstance(entry.event, Origin)]
        if (known := self._origin()) is not None:
            origins.insert(0, known)
        self._clear()
        for origin in origins[:1]:
            self.filter.locate(self._start, origin)

    def _clear(self) -> None:
        """Nothing has happened yet."""
        self._counts = Counter[str]()  # of times that were left, and of the fold itself
        self._left: list[_Left] = []  # until `take` has given what was not yet published
        #: The time jump that ``jump_action: hold`` does not follow; None when there is none.
        self.held: TimeJump | None = None
        # What is of another time, each with the newest stamp when it came.
        self._suspects: deque[tuple[int, Event]] = deque(maxlen=MAX_SUSPECTS)
        self._begin()

    def _begin(self) -> None:
        """An empty time."""
        self._run: _Run | None = None  # that the last suspects made
        self._start = self.filter.start()
        self._state = self._start.copy()
        self._count = 0
        self._stamps = np.empty(self._capacity, dtype=np.int64)
        self._f_b = np.empty((self._capacity, 3))
        self._w_ib_b = np.empty((self._capacity, 3))
        self._readings = np.empty((self._capacity, 6))  # the same, in the axes of the IMU
        self._states = np.empty(self._capacity, dtype=self._start.dtype)
        self._entries: list[_Entry] = []
        self._unpublished: list[_Entry] = []  # DVL measurements, until `take` has given them
        self._stale = 0  # index of the first sample whose state is not valid
        self._published_ns = NEVER
        self._resumed_ns = NEVER  # stamp of the state of another run, where this one went on

    def resume(self, record: Records) -> None:
        """Go on from a state of another run: it becomes that of the newest sample.

        The time up to the first sample is a gap. What is not later than the record is too late.
        Where the samples are of another time than the record the filter starts as it would without
        it, also where it holds at other time jumps. The counters begin at zero.

        Args:
            record: (1,) an initialised state of a filter of the same parameters.
        """
        self._clear()
        self._start[0] = record[0]
        for name in COUNTERS:
            self._start[name] = 0
        stamp_ns = int(record[0]["imu_ns"])
        self._stamps[0], self._f_b[0], self._w_ib_b[0] = stamp_ns, 0.0, 0.0
        self._readings[0] = record[0]["reading"]
        self._states[0] = self._start[0]
        self._count = self._stale = 1
        self._published_ns = self._resumed_ns = stamp_ns

    # ---------------------------------------------------------------- input

    def add(self, event: Event) -> str | None:
        """Insert an event.

        Returns:
            None, or why it was not used: ``not_finite``, ``out_of_range`` (beyond all that is
            physical, see `events.refusal`), ``too_late`` (older than the newest sample by more than
            max_delay), ``far_ahead`` (of it by more than jump_limit, a measurement or a Q by more
            than that and than `MAX_QUEUE` samples take, and a sample behind a gap longer than
            max_delay until the next one confirms it), ``duplicate`` (of one stamp and kind, the
            event with the smallest payload counts, whichever comes first). What was too late or far
            ahead may be used after all: then it is counted as ``recovered``.
        """
        reason = refusal(event)
        if reason is not None:
            return reason
        if self._count:
            ahead_ns = event.stamp_ns - self._last_ns
            if ahead_ns < -self._max_delay_ns:
                return self._suspect(event, "too_late")
            if ahead_ns > self._limit_ns(event):
                return self._suspect(event, "far_ahead")
        reason = self._insert(event)
        if isinstance(event, Imu) and reason is None:
            self._confirm_present()
        return reason

    def _limit_ns(self, event: Event) -> int:
        """How far ahead of the samples an event may be."""
        if isinstance(event, Imu):
            return self._near_ns
        return self._ahead_ns if isinstance(event, (Dvl, ProcessNoise)) else self._jump_limit_ns

    def _insert(self, event: Event) -> str | None:
        if event.stamp_ns <= self._resumed_ns:
            return "too_late"
        return self._add_imu(event) if isinstance(event, Imu) else self._add_entry(event)

    # ---------------------------------------------------------------- another time

    def _suspect(self, event: Event, reason: str) -> str | None:
        """Keep an event of another time, and follow there when the samples have gone there."""
        newest_ns, stamp_ns = self._last_ns, event.stamp_ns
        self._suspects.append((newest_ns, event))
        if not isinstance(event, Imu) or abs(stamp_ns - newest_ns) <= self._near_ns:
            return reason
        run = self._run
        if run is None or abs(stamp_ns - run.last_ns) > self._run_gap_ns:
            self._run = run = _Run(stamp_ns, stamp_ns)
        elif stamp_ns > run.last_ns:
            run.last_ns, run.count = stamp_ns, run.count + 1
        is_gap = 0 < stamp_ns - newest_ns <= self._jump_limit_ns
        if run.count < (GAP_SAMPLES if is_gap else JUMP_SAMPLES):
            return reason
        candidates = [suspect for _, suspect in self._suspects]
        # Behind the state of another run these samples are the first: what waits for them is kept.
        resumed = self._only_resumed
        reach_ns = self._jump_limit_ns if resumed else self._max_delay_ns
        if not is_gap:
            jump = TimeJump(newest_ns, run.first_ns)
            if self.parameters.jump_action == "hold" and not resumed:
                self.held = jump
                return reason
            # What waited for samples of the old time may belong to the new one.
            waiting = [e.event for e in self._entries if e.event.stamp_ns > newest_ns]
            self._leave(jump)
            self._counts["given_up"] += len(waiting) - self._insert_of(run, waiting, reach_ns)
        self._suspects.clear()
        # The sample that completes the run has not been refused.
        self._counts["recovered"] += self._insert_of(run, candidates, reach_ns) - 1
        self._confirm_present()
        return None

    def _insert_of(self, run: _Run, candidates: Iterable[Event], reach_ns: int) -> int:
        """Insert those events that are of the run's time; returns how many are new.

        What is no sample may be older than the run by ``reach_ns``.
        """
        count = 0
        for event in candidates:
            is_sample = isinstance(event, Imu)
            first_ns = run.first_ns - (self._max_delay_ns if is_sample else reach_ns)
            last_ns = run.last_ns + (0 if is_sample else self._limit_ns(event))
            if first_ns <= event.stamp_ns <= last_ns:
                count += self._insert(event) is None
        return count

    def _confirm_present(self) -> None:
        """A sample of the present time was accepted: no run of suspects is one."""
        self._run = self.held = None
        # Suspects stay while stamps that arrive in another order could still make them needed.
        oldest_ns = self._last_ns - self._max_delay_ns
        while self._suspects and self._suspects[0][0] < oldest_ns:
            self._suspects.popleft()

    def _leave(self, jump: TimeJump) -> None:
        """Put the present time aside and begin an empty one; where odom lies stays known."""
        result = FoldResult(self.filter, self.states, self.updates, self._state_counts(), {})
        stamps_ns = self._stamps[: self._count]
        self._left.append(_Left(jump, result, stamps_ns, self._unpublished, self._published_ns))
        self._counts.update(result.counts)
        self._counts["time_jumps"] += 1
        origin = self._origin()
        self._begin()
        if origin is not None:
            self.filter.locate(self._start, origin)

    def _origin(self) -> Origin | None:
        """Where odom lies on the Earth, None while no valid state of this run knows."""
        s = self._states[self._stale - 1] if self._stale else self._start[0]
        if self._only_resumed or np.isnan(s["lat_0"]):
            return None
        return Origin(int(s["time_ns"]), float(s["lat_0"]), float(s["lon_0"]), float(s["h_0"]))

    @property
    def left(self) -> "list[FoldResult]":
        """The times that were left by a jump since the last `take`."""
        return [left.result for left in self._left]

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample, NEVER before the first; that of another run is none."""
        return NEVER if self._only_resumed else self._last_ns

    @property
    def _last_ns(self) -> int:
        """Stamp of the newest state, also of that of another run; NEVER before the first."""
        return int(self._stamps[self._count - 1]) if self._count else NEVER

    @property
    def _only_resumed(self) -> bool:
        """Whether there is but the state of another run."""
        return self._resumed_ns != NEVER and self._last_ns == self._resumed_ns

    def _add_imu(self, sample: Imu) -> str | None:
        rotated = np.empty((2, 3))
        rotate_samples(rotated, self.filter.C_b_i, np.array([sample.f_b, sample.w_ib_b]))
        f_b, w_ib_b = rotated
        reading = np.concatenate([sample.f_b, sample.w_ib_b])
        n, stamp_ns = self._count, sample.stamp_ns
        if n and stamp_ns <= self._stamps[n - 1]:
            k = int(np.searchsorted(self._stamps[:n], stamp_ns))
            if self._stamps[k] == stamp_ns:
                kept = self._f_b[k].tobytes() + self._w_ib_b[k].tobytes()
                if f_b.tobytes() + w_ib_b.tobytes() < kept:
                    self._f_b[k], self._w_ib_b[k], self._readings[k] = f_b, w_ib_b, reading
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
            (self._readings, reading),
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
            ValueError: The arrays do not fit, are not finite, or the stamps do not increase or step
                by more than jump_limit.
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
        far = np.flatnonzero(np.diff(stamps_ns) > self._jump_limit_ns)
        if far.size:
            at = int(far[0])
            raise ValueError(
                f"stamps_ns must not step by more than jump_limit "
                f"({self.parameters.jump_limit:g} s), got {stamps_ns[at + 1]} after "
                f"{stamps_ns[at]} at index {at + 1}"
            )
        if n > self._stamps.size:
            self._grow(n)
        self._stamps[:n] = stamps_ns
        rotate_samples(self._f_b, self.filter.C_b_i, f_b)
        rotate_samples(self._w_ib_b, self.filter.C_b_i, w_ib_b)
        self._readings[:n, :3], self._readings[:n, 3:] = f_b, w_ib_b
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
            if self._count == 0:
                self._bound_waiting(event.kind)
        k = int(np.searchsorted(self._stamps[: self._count], event.stamp_ns))
        self._stale = min(self._stale, k)
        return "duplicate" if duplicate else None

    def _bound_waiting(self, kind: Kind) -> None:
        """Give up an event of a kind of which too many wait for the first sample.

        The oldest has the least to say, but of origins the first counts.
        """
        same = [entry for entry in self._entries if entry.event.kind == kind]
        if len(same) > MAX_WAITING:
            given_up = same[-1] if kind == Kind.ORIGIN else same[0]
            self._entries.remove(given_up)
            self._unpublished = [e for e in self._unpublished if e is not given_up]
            self._counts["given_up"] += 1

    def _make_room(self) -> int:
        """Drop the samples and events that nothing can reach any more; returns how many samples.

        What is kept reaches back by max_delay, and before that by the averaging of the turn rate.
        """
        self._fold()
        oldest_ns = self._last_ns - self._max_delay_ns
        reach_ns = min(oldest_ns, self._published_ns) - self._gyro_average_ns
        drop = max(int(np.searchsorted(self._stamps[: self._count], reach_ns)) - 2, 0)
        if drop < max(self._count // 2, 1):  # the buffer is too small for the delays: double it
            self._grow(2 * self._stamps.size)
            return 0
        self._start[0] = self._states[drop - 1]
        keep = self._count - drop
        for array in (self._stamps, self._f_b, self._w_ib_b, self._readings, self._states):
            array[:keep] = array[drop : self._count].copy()
        self._count = self._stale = keep
        start_ns = int(self._start[0]["imu_ns"])
        self._entries = [e for e in self._entries if e.event.stamp_ns > start_ns]
        return drop

    def _grow(self, size: int) -> None:
        self._stamps = _grown(self._stamps, size)
        self._f_b = _grown(self._f_b, size)
        self._w_ib_b = _grown(self._w_ib_b, size)
        self._readings = _grown(self._readings, size)
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
                    self._predict(state, k, run_end)
                    k = run_end
                    continue
            e = self._fold_sample(state, k, e)
            self._states[k] = state[0]
            k += 1
        self._stale = n

    def _predict(self, state: Records, first: int, last: int) -> None:
        """Advance over the samples first <= k < last."""
        arrays = self._stamps, self._f_b, self._w_ib_b, self._readings
        self.filter.predict_samples(state, *arrays, first, last, self._states)

    def _fold_sample(self, state: Records, k: int, e: int) -> int:
        """Advance over sample k and the events in its interval; returns the next event's index."""
        entries = self._entries
        stamp_ns, reading = int(self._stamps[k]), self._readings[k]
        f_b, w_ib_b = self._f_b[k], self._w_ib_b[k]
        while e < len(entries) and entries[e].event.stamp_ns < stamp_ns:
            event = entries[e].event
            if state[0]["initialised"] and not (isinstance(event, Initial) and event.once):
                self.filter.predict_part(state, stamp_ns, f_b, w_ib_b, reading, event.stamp_ns)
            self._apply(state, e, k)
            e += 1
        if state[0]["initialised"]:
            self._predict(state, k, k + 1)
        else:
            self.filter.await_start(state, Imu(stamp_ns, f_b, w_ib_b), reading)
        while e < len(entries) and entries[e].event.stamp_ns == stamp_ns:
            self._apply(state, e, k)
            e += 1
        return e

    def _apply(self, state: Records, e: int, k: int) -> None:
        """Apply event e at the time of the state, inside or at the end of sample k's interval."""
        entry = self._entries[e]
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
            stamp_ns, waited = int(self._stamps[k]), state[0]["imu_ns"] == NEVER
            if waited and stamp_ns - event.stamp_ns > self._jump_limit_ns:
                state["too_old"] += 1  # nobody knows where the vehicle has gone since
            elif waited and event.once and self._is_once_told_again(e, stamp_ns):
                pass  # of those that waited for the first sample the newest has missed the least
            elif not (event.once and state[0]["initialised"]):
                self.filter.initialise(state, event, event.stamp_ns, self._w_ib_b[k])
        elif isinstance(event, Origin):
            self.filter.locate(state, event)

    def _is_once_told_again(self, e: int, until_ns: int) -> bool:
        """Whether up to a stamp another initial state that applies once follows event e."""
        for i in range(e + 1, len(self._entries)):
            event = self._entries[i].event
            if event.stamp_ns > until_ns:
                break
            if isinstance(event, Initial) and event.once:
                return True
        return False

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
        """Counters since `reset`: those of the state, all times together, and those of the fold.

        ``time_jumps``; ``recovered``, the refused events that were used after all; ``given_up``,
        the events that waited for a first sample until there were too many.
        """
        own = {name: self._counts[name] for name in ("time_jumps", "recovered", "given_up")}
        return {k: self._counts[k] + n for k, n in self._state_counts().items()} | own

    def _state_counts(self) -> dict[str, int]:
        self._fold()
        s = self._states[self._count - 1] if self._count else self._start[0]
        return {name: int(s[name]) for name in COUNTERS}

    def take(self) -> list[Odometry | AppliedUpdate | TimeJump]:
        """What became publishable since the last call, in the order of stamps.

        Odometry for every new sample that is `output_delay` old; what was taken once is not given
        again, even where a late event has changed it since. At a time jump first all that is left
        of the old time, then the jump, then what is of the new time.
        """
        self._fold()
        outputs: list[Odometry | AppliedUpdate | TimeJump] = []
        for left in self._left:
            outputs += left.outputs()
            outputs.append(left.jump)
        self._left.clear()
        if self._count:
            until_ns = self._last_ns - self._output_delay_ns
            stamps_ns = self._stamps[: self._count]
            done, self._unpublished = _split(self._unpublished, until_ns)
            first, last = _between(stamps_ns, self._published_ns, until_ns)
            outputs += _outputs(self.filter, self._states, first, last, done)
            if last > first:
                self._published_ns = int(stamps_ns[last - 1])
        return outputs


def _split(entries: list[_Entry], until_ns: int) -> tuple[list[_Entry], list[_Entry]]:
    """Those that were applied and are not after a stamp, and the others."""
    done = [e for e in entries if e.report is not None and e.event.stamp_ns <= until_ns]
    return done, [e for e in entries if e.report is None or e.event.stamp_ns > until_ns]


def _between(stamps_ns: Stamps, after_ns: int, until_ns: int) -> tuple[int, int]:
    """Indices first <= k < last of the stamps after one time and up to another."""
    first, last = (int(np.searchsorted(stamps_ns, t, side="right")) for t in (after_ns, until_ns))
    return first, max(first, last)


def _outputs(
    filter_: Filter, states: Records, first: int, last: int, entries: list[_Entry]
) -> list[Odometry | AppliedUpdate]:
    """Odometry of the states first <= k < last, and the updates, in the order of stamps."""
    outputs: list[Odometry | AppliedUpdate] = [
        AppliedUpdate(entry.event.stamp_ns, entry.report)
        for entry in entries
        if entry.report is not None
    ]
    for k in range(first, last):
        if states[k]["initialised"]:
            outputs.append(odometry(filter_, states, k))
    outputs.sort(key=lambda output: output.stamp_ns)
    return outputs


def _grown(array: NDArray[Any], size: int) -> NDArray[Any]:
    larger = np.empty((size, *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


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


@dataclass(frozen=True, slots=True)
class _Left:
    """A time that was left, and what of it is not yet published."""

    jump: TimeJump
    result: FoldResult
    stamps_ns: Stamps
    unpublished: list[_Entry]
    published_ns: int

    def outputs(self) -> list[Odometry | AppliedUpdate]:
        """All that is left to publish: nothing can come late any more."""
        done, _ = _split(self.unpublished, self.jump.from_ns)
        first, last = _between(self.stamps_ns, self.published_ns, self.jump.from_ns)
        return _outputs(self.result.filter, self.result.states, first, last, done)


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
        ValueError: The arrays do not fit, are not finite, or the stamps do not increase or step by
            more than jump_limit.
    """
    fold = Fold(parameters, capacity=max(len(stamps_ns), 1))
    fold.add_samples(stamps_ns, f_b, w_ib_b)
    reasons = (refusal(event) or fold._insert(event) for event in events)
    refused = Counter(reason for reason in reasons if reason is not None)
    return FoldResult(
        filter=fold.filter,
        states=fold.states,
        updates=fold.updates,
        counts=fold.counts,
        refused=dict(refused),
    )
