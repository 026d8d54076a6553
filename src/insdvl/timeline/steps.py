"""The fold itself: from sample to sample, with the events in between at their stamps."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from insdvl.arrays import Records
from insdvl.navigation.events import (
    Imu,
    Initial,
    Measurement,
    Orientation,
    Origin,
    ProcessNoise,
    SensorNoise,
)
from insdvl.navigation.filter import Filter
from insdvl.navigation.settings import Settings
from insdvl.navigation.state.fields import NEVER, State
from insdvl.timeline.entries import Entries
from insdvl.timeline.samples import Samples


class Steps:
    """Makes the states of samples valid.

    Args:
        filter_: That advances and corrects a state.
        samples: The samples and their states.
        entries: All other events.
        jump_limit_ns: An initial state that is older than the first sample by more is not used.
        rest_ns: Time before a measurement in which the samples may show a vehicle at rest.
    """

    def __init__(
        self, filter_: Filter, samples: Samples, entries: Entries, jump_limit_ns: int, rest_ns: int
    ) -> None:
        self._filter = filter_
        self._samples = samples
        self._entries = entries
        self._jump_limit_ns = jump_limit_ns
        self._state = filter_.empty()
        self._rest_ns = rest_ns
        self._hear: dict[int, Callable[[Records, Any], None]] = {
            Origin.kind: filter_.locate,
            ProcessNoise.kind: filter_.receive_process_noise,
            Orientation.kind: filter_.hear_orientation,
            SensorNoise.kind: filter_.receive_sensor_noise,
        }

    def fold(self, start: Records) -> None:
        """Make the states of all samples valid.

        Args:
            start: (1,) the state before the first sample.
        """
        samples, entries = self._samples, self._entries.ordered
        n, k = samples.count, samples.stale
        if k >= n:
            return
        state, last = self._state, samples.kept.before(k)
        if last >= 0:
            samples.kept.restore(state, last)
        else:
            state[0] = start[0]
        k = last + 1
        stamp_ns = int(state[0]["channels"]["imu_ns"])
        e = self._entries.first_after(stamp_ns)
        settings = self._entries.settings_at(stamp_ns)
        if settings is not self._filter.parameters:
            self._filter.configure(settings)
        while k < n:
            if state[0]["nav"]["initialised"]:
                next_ns = entries[e].event.stamp_ns if e < len(entries) else None
                run_end = n if next_ns is None else samples.index_of(next_ns)
                if run_end > k:
                    k = self._predict(state, k, run_end)
                    continue
            e = self._fold_sample(state, k, e)
            if not samples.kept.put(state, k):
                self._give_up(state, k)
            k += 1
        samples.stale = n

    def newest(self, start: Records) -> State:
        """The state of the newest sample, all being valid; `start` (1,) where there is none."""
        samples = self._samples
        if not samples.count:
            return start[0]
        last = samples.count - 1
        is_kept = samples.kept.before(samples.count) == last
        return samples.kept.at(last) if is_kept else self._state[0]

    def _predict(self, state: Records, first: int, last: int) -> int:
        """Advance over the samples first <= k < last; returns the index behind the last of them.

        Where the state diverges it is given up, and that sample is the last.
        """
        samples = self._samples
        arrays = samples.stamps_ns, samples.f_b, samples.w_ib_b, samples.readings
        diverged = self._filter.predict_samples(state, *arrays, first, last, samples.kept)
        if diverged == last:
            return last
        self._give_up(state, diverged)
        return diverged + 1

    def _give_up(self, state: Records, k: int) -> None:
        """The state at sample k has diverged."""
        self._filter.give_up(state)
        self._samples.kept.put(state, k)

    def _fold_sample(self, state: Records, k: int, e: int) -> int:
        """Advance over sample k and the events in its interval; returns the next event's index."""
        samples, entries = self._samples, self._entries.ordered
        stamp_ns, reading = int(samples.stamps_ns[k]), samples.readings[k]
        f_b, w_ib_b = samples.f_b[k], samples.w_ib_b[k]
        while e < len(entries) and entries[e].event.stamp_ns < stamp_ns:
            event = entries[e].event
            if state[0]["nav"]["initialised"] and not event.starts_only:
                self._filter.predict_part(state, stamp_ns, f_b, w_ib_b, reading, event.stamp_ns)
            self._apply(state, e, k)
            e += 1
        if state[0]["nav"]["initialised"]:
            self._predict(state, k, k + 1)
        else:
            self._filter.await_start(state, Imu(stamp_ns, f_b, w_ib_b), reading)
        while e < len(entries) and entries[e].event.stamp_ns == stamp_ns:
            self._apply(state, e, k)
            e += 1
        return e

    def _apply(self, state: Records, e: int, k: int) -> None:
        """Apply event e at the time of the state, inside or at the end of sample k's interval."""
        event = self._entries.ordered[e].event
        if event.kind in self._hear:
            self._hear[event.kind](state, event)
        elif isinstance(event, Settings):
            self._filter.configure(event.parameters)
        elif isinstance(event, Initial):
            self._apply_initial(state, event, e, k)
        else:
            assert isinstance(event, Measurement)
            self._apply_measurement(state, event, e, k)

    def _apply_measurement(self, state: Records, event: Measurement, e: int, k: int) -> None:
        entry, samples, stamp_ns = self._entries.ordered[e], self._samples, event.stamp_ns
        turn_ns, constants = self._filter.turn_window_ns(event), self._filter.constants
        turn = samples.turn_rate(state, constants, k, stamp_ns, turn_ns)
        before = partial(samples.window, state, k, stamp_ns, self._rest_ns)
        try:
            entry.report = self._filter.update(state, event, *turn, before)
        except np.linalg.LinAlgError:
            # Every matrix of a sound state has an inverse: each event from here on would fail.
            self._filter.give_up(state)

    def _apply_initial(self, state: Records, event: Initial, e: int, k: int) -> None:
        stamp_ns = int(self._samples.stamps_ns[k])
        waited = state[0]["channels"]["imu_ns"] == NEVER
        if waited and stamp_ns - event.stamp_ns > self._jump_limit_ns:
            # Where the vehicle has gone since is unknown.
            state[0]["counters"]["too_old"] += 1
        elif waited and event.once and self._entries.another_start(e, stamp_ns):
            pass  # of several that waited for the first sample the newest is the best
        elif not (event.once and state[0]["nav"]["initialised"]):
            self._filter.initialise(state, event, event.stamp_ns, self._samples.w_ib_b[k])
