"""The state as a fold over events, sorted by (stamp, kind, payload): it depends on stamps alone.

The state after sample k includes every event up to its stamp and is kept beside it. An event that
arrives late changes the states from its sample on; they are folded again from the one before. So
all orders of arrival within `max_delay` give the same bits.

An event between two samples cuts the sample that spans it, so it waits for that sample.
"""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from insdvl.arrays import Array, Records, Stamps
from insdvl.navigation.events import NS, Event, Imu, Origin, refusal
from insdvl.navigation.filter import Filter
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.settings import Settings
from insdvl.navigation.start import zero_velocity
from insdvl.navigation.state.fields import FOREVER, NEVER, State
from insdvl.navigation.state.layout import counters
from insdvl.timeline.entries import Entries, Entry
from insdvl.timeline.jumps import RUN_GAP_NS, Run, Suspects, TimeJump
from insdvl.timeline.output import (
    AppliedUpdate,
    Final,
    FoldResult,
    LeftTime,
    Output,
    applied,
    between,
    known_pose,
    outputs_of,
    split,
)
from insdvl.timeline.samples import Samples
from insdvl.timeline.steps import Steps

#: So many samples may be on their way to the filter (of one that is starved, in the queues of
#: sender and receiver) while what was measured with the newest of them is there already.
MAX_QUEUE = 10_000


class Fold:
    """Events in, odometry out.

    Args:
        parameters: Of the filter.
        capacity: Number of samples to make room for at first.
        every: Of so many samples the whole state of the last one is kept; above 1 only for a
            recording that is added at once.
    """

    def __init__(self, parameters: FilterParameters, capacity: int = 4096, every: int = 1) -> None:
        self.parameters = parameters
        self.filter = Filter(parameters)
        self._max_delay_ns = round(parameters.max_delay * NS)
        self._output_delay_ns = round(parameters.output_delay * NS)
        self._jump_limit_ns = round(parameters.jump_limit * NS)
        self._max_gap_ns = round(parameters.imu.max_gap * NS)
        # A measurement, or a Q, may be ahead of the samples by so much.
        self._ahead_ns = max(self._jump_limit_ns, round(MAX_QUEUE / parameters.imu.rate * NS))
        self._near_ns = max(self._max_delay_ns, self._max_gap_ns)  # samples of one time
        self._rest_ns = zero_velocity.window_ns(parameters.imu.rate)
        turn_ns = (model.turn_window_ns for model in self.filter.models.values())
        self._window_ns = max(self._rest_ns, *turn_ns)
        self._capacity, self._every = capacity, every
        self._entries = Entries(parameters)
        self._changes = 0  # of settings
        self._clear()

    def reset(self) -> bool:
        """Forget all but the settings and odom's place on the Earth; initialisation starts again.

        It counts as one of ``odom_resets``, which go on; all other counts begin at zero.

        With ``initial.mode: auto`` heading and position stay known; returns whether they do.
        """
        valid, pose = self._samples.kept.states[: self._samples.stale], None
        if len(valid) and valid[-1]["nav"]["initialised"]:
            pose = known_pose(self.filter, valid[-1])
        origins = [e.event for e in self._entries.ordered if isinstance(e.event, Origin)]
        if (known := self._origin()) is not None:
            origins.insert(0, known)
        before = int(valid[-1]["counters"]["odom_resets"]) if len(valid) else 0
        self._clear(odom_resets=self._counts["odom_resets"] + before + 1)
        for origin in origins[:1]:
            self.filter.locate(self._start, origin)
        return pose is not None and self.filter.start.keep(self._start[0], pose)

    def _clear(self, odom_resets: int = 0) -> None:
        """Nothing has happened yet, but that odom was reset before."""
        self._counts = Counter[str](odom_resets=odom_resets)  # of left times, and the fold's own
        self._left: list[LeftTime] = []  # until `take` has given what was not yet published
        #: The time jump that ``jump_action: hold`` does not follow; None when there is none.
        self.held: TimeJump | None = None
        self.recovered: list[Event] = []  # by the last `add`: what it was given, and refused before
        self._suspects = Suspects(self._near_ns, self._max_gap_ns, self._jump_limit_ns)
        self._begin(self.settings)

    def _begin(self, settings: FilterParameters) -> None:
        """An empty time."""
        self._suspects.end_run()
        self._start = self.filter.empty()
        self._samples = Samples(self.filter.C_b_i, self._capacity, self._start.dtype, self._every)
        self._entries = Entries(settings)
        self._steps = Steps(
            self.filter, self._samples, self._entries, self._jump_limit_ns, self._rest_ns
        )
        self._published_ns = NEVER
        self._resumed_ns = NEVER  # stamp of the state of another run, where this one went on

    def resume(self, record: Records, settings: FilterParameters | None = None) -> None:
        """Go on from a state of another run: it becomes that of the newest sample.

        The time up to the first sample is a gap. What is not later than the record is too late.
        Where the samples are of another time than the record the filter starts as it would without
        it, also where it holds at other time jumps. The counters begin at zero.

        Args:
            record: (1,) an initialised state of a filter of the same parameters.
            settings: The parameters with the settings that were in force there; those now if None.
        """
        self._clear()
        if settings is not None:
            self._entries.begin_with(settings)
        self._start[0] = record[0]
        for group, name in counters(self._start[0]).values():
            group[name] = 0
        stamp_ns = int(record[0]["channels"]["imu_ns"])
        self._samples.put_state(self._start, stamp_ns)
        self._published_ns = self._resumed_ns = stamp_ns

    # ---------------------------------------------------------------- input

    @property
    def settings(self) -> FilterParameters:
        """The parameters with the settings that were given last."""
        return self._entries.settings_at(FOREVER)

    def change(self, parameters: FilterParameters) -> int | None:
        """Change settings from the newest sample on, or before the first one from the start.

        Args:
            parameters: Those of the filter but for the settings (see `navigation.settings`).

        Returns:
            The stamp from which on they are in force, None for the start.
        """
        if self.newest_ns == NEVER:
            self._entries.begin_with(parameters)
            return None
        self._changes += 1
        self._insert(Settings(self.newest_ns, parameters, self._changes))
        return self.newest_ns

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
        self.recovered = []
        if (reason := refusal(event)) is not None:
            return reason
        if self._samples.count:
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
        return self._ahead_ns if event.follows_samples else self._jump_limit_ns

    def _insert(self, event: Event) -> str | None:
        if event.stamp_ns <= self._resumed_ns:
            return "too_late"
        if isinstance(event, Imu):
            if self._samples.is_full:
                self._make_room()
            return None if self._samples.insert(event) else "duplicate"
        duplicate, changed = self._entries.insert(event)
        if changed:
            if self._samples.count == 0 and not duplicate:
                self._counts["given_up"] += self._entries.bound_waiting(event.kind)
            self._samples.outdate_from(event.stamp_ns)
        return "duplicate" if duplicate else None

    def following(self, stamps_ns: Stamps) -> int:
        """How many of the first of these samples follow the newest one, each as near to the last.

        `add` would take all of them, and `add_samples` does so at once.
        """
        if not self._samples.count:
            return 0
        steps_ns = np.diff(stamps_ns, prepend=self._last_ns)
        others = np.flatnonzero((steps_ns <= 0) | (steps_ns > self._near_ns))
        return int(others[0]) if others.size else len(stamps_ns)

    def add_samples(self, stamps_ns: Stamps, f_b: Array, w_ib_b: Array) -> None:
        """Insert samples that follow the newest one, as `add` does one after the other.

        Args:
            stamps_ns: (N,) stamps, all of them `following`.
            f_b: (N, 3) specific force [m/s^2], IMU axes, forward-right-down; within the limits of
                `events.Imu`, as `w_ib_b`.
            w_ib_b: (N, 3) angular rate [rad/s], same axes.
        """
        samples, first = self._samples, 0
        while first < len(stamps_ns):
            if samples.is_full:
                self._make_room()
            part = slice(first, first + samples.stamps_ns.size - samples.count)
            samples.append(stamps_ns[part], f_b[part], w_ib_b[part])
            first = part.stop
        self._confirm_present()

    def add_recording(
        self, stamps_ns: Stamps, f_b: Array, w_ib_b: Array, events: Sequence[Event]
    ) -> dict[str, int]:
        """Insert a whole recording at once, into a fold that has no sample yet.

        Args:
            stamps_ns: (N,) stamps, strictly increasing.
            f_b: (N, 3) specific force [m/s^2], IMU axes, forward-right-down.
            w_ib_b: (N, 3) angular rate [rad/s], same axes.
            events: All other events, in any order.

        Returns:
            How many events were not used, by reason.

        Raises:
            ValueError: The arrays do not fit, are not finite, or the stamps do not increase or step
                by more than jump_limit.
        """
        far = np.flatnonzero(np.diff(stamps_ns) > self._jump_limit_ns)
        if far.size:
            at = int(far[0])
            raise ValueError(
                f"stamps_ns must not step by more than jump_limit "
                f"({self.parameters.jump_limit:g} s), got {stamps_ns[at + 1]} after "
                f"{stamps_ns[at]} at index {at + 1}"
            )
        self._samples.fill(stamps_ns, f_b, w_ib_b)
        reasons = (refusal(event) or self._insert(event) for event in events)
        return dict(Counter(reason for reason in reasons if reason is not None))

    # ---------------------------------------------------------------- another time

    def _suspect(self, event: Event, reason: str) -> str | None:
        """Keep an event of another time, and follow there when the samples have gone there."""
        newest_ns = self._last_ns
        run = self._suspects.keep(event, newest_ns)
        if run is None:
            return reason
        candidates = self._suspects.events
        # Behind the state of another run these samples are the first: what waits for them is kept.
        resumed = self._only_resumed
        reach_ns = self._jump_limit_ns if resumed else self._max_delay_ns
        if not run.is_gap:
            jump = TimeJump(newest_ns, run.first_ns)
            if self.parameters.jump_action == "hold" and not resumed:
                self.held = jump
                return reason
            # What waited for samples of the old time may belong to the new one.
            waiting = [e.event for e in self._entries.ordered if e.event.stamp_ns > newest_ns]
            self._leave(jump)
            self._counts["given_up"] += len(waiting) - len(self._insert_of(run, waiting, reach_ns))
        self._suspects.forget()
        self.recovered = self._insert_of(run, candidates, reach_ns)
        self._counts["recovered"] += len(self.recovered) - 1  # the last one was never refused
        self._confirm_present()
        return None

    def _insert_of(self, run: Run, candidates: Iterable[Event], reach_ns: int) -> list[Event]:
        """Insert those events that are of the run's time; returns those that are new.

        What is not a sample may be older than the run by ``reach_ns``.
        """
        found = []
        for event in candidates:
            is_sample = isinstance(event, Imu)
            first_ns = run.first_ns - (self._max_delay_ns if is_sample else reach_ns)
            last_ns = run.last_ns + (0 if is_sample else self._limit_ns(event))
            if first_ns <= event.stamp_ns <= last_ns and self._insert(event) is None:
                found.append(event)
        return found

    def _confirm_present(self) -> None:
        """A sample of the present time was accepted."""
        self.held = None
        self._suspects.present(self._last_ns - self._max_delay_ns)

    def _leave(self, jump: TimeJump) -> None:
        """Put the present time aside and begin an empty one; where odom lies stays known."""
        counts = self._state_counts()
        result = FoldResult(self.filter, self.states, self.track, self.updates, counts, {})
        stamps_ns = self._samples.stamps_ns[: self._samples.count]
        unpublished = self._entries.unpublished
        self._left.append(LeftTime(jump, result, stamps_ns, unpublished, self._published_ns))
        self._counts.update(result.counts)
        self._counts.update(time_jumps=1, odom_resets=1)
        origin = self._origin()
        self._begin(self.parameters if self._only_resumed else self.settings)
        if origin is not None:
            self.filter.locate(self._start, origin)

    def _origin(self) -> Origin | None:
        """Where odom lies on the Earth, None while no valid state of this run knows."""
        samples = self._samples
        nav = (samples.kept.at(samples.stale - 1) if samples.stale else self._start[0])["nav"]
        if self._only_resumed or np.isnan(nav["lat_0"]):
            return None
        place = (float(nav[name]) for name in ("lat_0", "lon_0", "h_0"))
        return Origin(int(nav["time_ns"]), *place)

    @property
    def left(self) -> list[FoldResult]:
        """The times that were left by a jump since the last `take`."""
        return [left.result for left in self._left]

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample, NEVER before the first; that of another run is none."""
        return NEVER if self._only_resumed else self._last_ns

    @property
    def _last_ns(self) -> int:
        """Stamp of the newest state, also of that of another run; NEVER before the first."""
        samples = self._samples
        return int(samples.stamps_ns[samples.count - 1]) if samples.count else NEVER

    @property
    def _only_resumed(self) -> bool:
        """Whether the only state is that of another run."""
        return self._resumed_ns != NEVER and self._last_ns == self._resumed_ns

    def _make_room(self) -> None:
        """Drop the samples and events that nothing can reach any more, or make more room.

        What is kept reaches back by max_delay, and before that by the window of a measurement.
        """
        self._steps.fold(self._start)
        samples = self._samples
        oldest_ns = self._last_ns - self._max_delay_ns
        reach_ns = min(oldest_ns, self._published_ns) - self._window_ns
        drop = max(samples.index_of(reach_ns) - 2, 0)
        if drop < max(samples.count // 2, 1):  # the buffer is too small for the delays
            samples.grow(2 * samples.stamps_ns.size)
            return
        self._start[0] = samples.kept.at(drop - 1)
        samples.drop(drop)
        self._entries.forget(int(self._start[0]["channels"]["imu_ns"]))

    # ---------------------------------------------------------------- output

    @property
    def latest(self) -> State | None:
        """State at the newest sample, None while there is none or it is not initialised."""
        states = self.states
        return states[-1] if len(states) and states[-1]["nav"]["initialised"] else None

    @property
    def states(self) -> Records:
        """(N // every,) states at the stamps of the samples that are kept."""
        self._steps.fold(self._start)
        return self._samples.kept.states[: self._samples.count // self._every]

    @property
    def track(self) -> Records:
        """(N,) records `kept.TRACK` at the stamps of the samples."""
        self._steps.fold(self._start)
        return self._samples.kept.track[: self._samples.count]

    @property
    def updates(self) -> list[AppliedUpdate]:
        """What was done with the measurements that are kept, in the order of stamps."""
        self._steps.fold(self._start)
        return applied(self._entries.ordered)

    @property
    def counts(self) -> dict[str, int]:
        """Counters since `reset`: those of the state, all times together, and those of the fold.

        ``time_jumps``; ``recovered``, the refused events that were used after all; ``given_up``,
        the events that waited for a first sample until there were too many.
        """
        own = {name: self._counts[name] for name in ("time_jumps", "recovered", "given_up")}
        return {k: self._counts[k] + n for k, n in self._state_counts().items()} | own

    def _state_counts(self) -> dict[str, int]:
        self._steps.fold(self._start)
        s = self._steps.newest(self._start)
        return {shown: int(group[name]) for shown, (group, name) in counters(s).items()}

    def take_final(self, *, end: bool = False) -> list[Final]:
        """What has become final since the last call; in place of `take`, for whole recordings.

        An event may be late by max_delay, and by `RUN_GAP_NS` more where samples recover.

        Args:
            end: Whether nothing will be added any more: then all is final.
        """
        states = self.states
        found = [left.final for left in self._left]
        self._left.clear()
        delay_ns = self._max_delay_ns + RUN_GAP_NS + 1
        done, first, last = self._publish(FOREVER if end else self._last_ns - delay_ns)
        return [*found, Final(states[first:last], applied(sorted(done)), None)]

    def take(self) -> list[Output]:
        """What became publishable since the last call, in the order of stamps.

        Odometry for every new sample that is `output_delay` old; what was taken once is not given
        again, even where a late event has changed it since. At a time jump first all that is left
        of the old time, then the jump, then what is of the new time.
        """
        states = self.states
        outputs = [output for left in self._left for output in left.outputs()]
        self._left.clear()
        done, first, last = self._publish(self._last_ns - self._output_delay_ns)
        return outputs + outputs_of(self.filter, states, first, last, done)

    def _publish(self, until_ns: int) -> tuple[list[Entry], int, int]:
        """Measurements, and samples first <= k < last, up to a stamp that were not yet published.

        The states of all samples must be valid.
        """
        stamps_ns = self._samples.stamps_ns[: self._samples.count]
        done, self._entries.unpublished = split(self._entries.unpublished, until_ns)
        first, last = between(stamps_ns, self._published_ns, until_ns)
        if last > first:
            self._published_ns = int(stamps_ns[last - 1])
        return done, first, last
