"""Whether the axes, units and mounts of IMU and DVL agree with the parameters.

A wrong sign is rarely noticed at once: a filter with a reversed gyroscope axis drifts, and its gate
rejects the DVL. Two checks find it while the vehicle moves.

Gravity: the specific force of an upright vehicle points up, most of the time (`GravityCheck`).

Motion: within a window of 20 s the velocity R(t) v(t) in the axes of the window's start changes by
the specific force and gravity only. With the wrong mount, scale, lever arm or stamps of the DVL it
does not, and the difference tells which of them, and by how much. The derivation, and the
probability by which one cause is preferred to another, are in docs/explanation/alignment.md. What
the motion does not tell accuses nobody.
"""

from bisect import insort
from collections import deque
from collections.abc import Generator, Iterable
from dataclasses import replace

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.kernels import kernel
from insdvl.navigation.events import NS, Event, Imu
from insdvl.navigation.geometry.frames import vector_from_rotation
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state.fields import FOREVER, NEVER
from insdvl.tuner.features.differences import integrated_variances
from insdvl.watch.alignment.causes import Miswired, miswired
from insdvl.watch.alignment.gravity import GravityCheck
from insdvl.watch.alignment.rows import SIZE, Mounted, rows
from insdvl.watch.alignment.search import FEWEST_PINGS, Explanation, Motion, Samples, Search
from insdvl.watch.alignment.sentences import Alignment, Remedy, Terms
from insdvl.watch.alignment.windows import integrated

WINDOW_NS = 20 * NS  # long enough for a turn, short enough for a noisy gyroscope
WINDOWS = 30  # number of windows that are kept: 10 minutes
FEWEST_WINDOWS = 5
SPACING_NS = WINDOW_NS // 100  # smallest time between two that are used
PAUSE_NS = 5 * NS  # a longer time without any ends the window
EVERY = 3  # windows after which an explanation is made again
STEP_NS = 16_000_000  # shortest interval of the IMU that is kept; samples are averaged over it
THINK = 12  # intervals of the IMU between two steps of an explanation: 5 in a second

_STEPS = 4 * WINDOW_NS // STEP_NS // 3  # intervals that are kept: of a window and a late DVL
_WAITING = 64  # DVL measurements that wait for the IMU


# What `_average` counts: stamp of the newest sample, where the interval begins, number of intervals
# that are kept, and of all that there were.
_NEWEST, _BEGIN, _SIZE, _STEPS_DONE = range(4)


@kernel
def _average(
    stamps_ns: Stamps,
    f: Array,
    w: Array,
    first: int,
    max_gap_ns: int,
    ping_ns: int,
    think: int,
    clock: Stamps,
    sums: Array,
    ends: Stamps,
    mean_f: Array,
    mean_w: Array,
) -> tuple[int, bool, bool]:
    """Average samples over intervals, until something is to be done.

    Args:
        stamps_ns: (N,) stamps, rising, all behind the newest one.
        f: (N, 3) specific forces.
        w: (N, 3) angular rates.
        first: Index of the first sample to take.
        max_gap_ns: After a longer time between two samples the intervals begin anew.
        ping_ns: It ends with an interval that reaches this stamp.
        think: And behind so many intervals; 0 for never.
        clock: (4,) counts.
        sums: (2, 3) of the interval that is not complete, times its time.
        ends: (M,) ends of the intervals that are kept.
        mean_f: (M, 3) their means.
        mean_w: (M, 3) their means.

    Returns:
        Index behind the last sample that was taken, whether earlier intervals were dropped, and
        whether an interval is complete that something is to be done with.
    """
    for k in range(first, len(stamps_ns)):
        stamp_ns, newest_ns = stamps_ns[k], clock[_NEWEST]
        clock[_NEWEST] = stamp_ns
        if stamp_ns - newest_ns > max_gap_ns:
            clock[_SIZE], clock[_BEGIN] = 0, stamp_ns
            sums[:] = 0.0
            return k + 1, True, False
        dt = (stamp_ns - newest_ns) / NS
        for i in range(3):
            sums[0, i] += dt * f[k, i]
            sums[1, i] += dt * w[k, i]
        if stamp_ns - clock[_BEGIN] < STEP_NS:
            continue
        is_full = clock[_SIZE] == len(ends)
        if is_full:
            drop = len(ends) // 4
            clock[_SIZE] -= drop
            for m in range(clock[_SIZE]):
                ends[m] = ends[m + drop]
                for i in range(3):
                    mean_f[m, i], mean_w[m, i] = mean_f[m + drop, i], mean_w[m + drop, i]
        m, seconds = clock[_SIZE], (stamp_ns - clock[_BEGIN]) / NS
        ends[m] = stamp_ns
        for i in range(3):
            mean_f[m, i], mean_w[m, i] = sums[0, i] / seconds, sums[1, i] / seconds
        clock[_SIZE] += 1
        clock[_STEPS_DONE] += 1
        sums[:] = 0.0
        clock[_BEGIN] = stamp_ns
        is_due = think > 0 and clock[_STEPS_DONE] % think == 0
        if is_full or is_due or stamp_ns >= ping_ns:
            return k + 1, is_full, True
    return len(stamps_ns), False, False


class AlignmentCheck:
    """Watches the events of the filter; memory and work per event are bounded.

    Events may arrive late and in any order; one that is too late for its window is not used.

    Args:
        parameters: Of the filter.
        thinks: Whether it explains the windows as they come. Of a recording `finish` explains them
            at the end, which is all that is told of it: what a window is worth is computed once,
            not again with each of the 30 windows behind it.
    """

    def __init__(self, parameters: FilterParameters, *, thinks: bool = True) -> None:
        self._thinks = thinks
        self._terms = Terms(parameters)
        self._gravity = GravityCheck(parameters.frame_convention, self._terms.C_b_i)
        self._average = parameters.dvl.gyro_average
        self._max_gap_ns = round(parameters.imu.max_gap * NS)
        self._search = Search(
            self._terms.known,
            miswired(self._terms.C_b_i),
            parameters.initial.accelerometer_bias_std,
            parameters.initial.gyroscope_bias_std,
            parameters.dvl.noise_floor,
            parameters.dvl.bias_time_constant,
        )

        self._stamps = np.empty(_STEPS, np.int64)  # ends of intervals
        self._f = np.empty((_STEPS, 3))
        self._w = np.empty((_STEPS, 3))
        self._sums = np.zeros((2, 3))  # of the interval that is not complete, times its time
        self._clock = np.array([NEVER, NEVER, 0, 0])
        self._waiting: list[tuple[int, bytes]] = []
        self._pings: list[tuple[int, Array]] = []  # of the window, the first being its start

        self._motions: deque[Motion] = deque(maxlen=WINDOWS)
        self._suspected = False
        self._closed = self._explained = 0  # windows, and those of them that were explained
        self._thought: Generator[None, None, list[Explanation]] | None = None
        self._explanations: list[Explanation] = []

    def add_events(self, events: Iterable[Event]) -> None:
        """Take events as `add` does, samples that follow one another at once."""
        run: list[Imu] = []
        for event in events:
            is_sample = isinstance(event, Imu)
            if run and not (is_sample and event.stamp_ns > run[-1].stamp_ns):
                self._add_run(run)
                run = []
            if isinstance(event, Imu):
                run.append(event)
            else:
                self.add(event)
        if run:
            self._add_run(run)

    def _add_run(self, run: list[Imu]) -> None:
        stamps_ns = np.array([sample.stamp_ns for sample in run])
        f_b = np.array([sample.f_b for sample in run])
        w_ib_b = np.array([sample.w_ib_b for sample in run])
        self.add_samples(stamps_ns, f_b, w_ib_b)

    def add(self, event: Event) -> None:
        """Take an event; one without axes is ignored."""
        if isinstance(event, Imu):
            stamps_ns = np.array([event.stamp_ns])
            self.add_samples(stamps_ns, event.f_b[None], event.w_ib_b[None])
            return
        if isinstance(event, Dvl) and event.v_d.any() and all(event.measured):
            insort(self._waiting, (event.stamp_ns, event.v_d.tobytes()))
            del self._waiting[_WAITING:]  # the earliest is the next to be used
        self._take_pings()

    def add_samples(self, stamps_ns: Stamps, f_b: Array, w_ib_b: Array) -> None:
        """Take samples, stamps (N,) that rise, specific forces and angular rates (N, 3)."""
        first = int(np.searchsorted(stamps_ns, self._clock[_NEWEST], side="right"))
        if self._clock[_NEWEST] == NEVER and first < len(stamps_ns):
            self._clock[_NEWEST] = self._clock[_BEGIN] = stamps_ns[first]
            first += 1
        self._gravity.add(stamps_ns[first:], f_b[first:])
        while first < len(stamps_ns):
            ping_ns = self._waiting[0][0] if self._waiting else FOREVER
            think = THINK if self._suspected or self._thought is not None else 0
            arrays = self._sums, self._stamps, self._f, self._w
            first, is_broken, is_complete = _average(
                stamps_ns,
                f_b,
                w_ib_b,
                first,
                self._max_gap_ns,
                ping_ns,
                think,
                self._clock,
                *arrays,
            )
            if is_broken:  # a gap, or the window has no late DVL to wait for any more
                self._pings = []
            if think and is_complete and self._clock[_STEPS_DONE] % THINK == 0:
                self._think()
            self._take_pings()

    @property
    def _size(self) -> int:
        """Number of intervals that are kept."""
        return int(self._clock[_SIZE])

    def _drop(self, n: int) -> None:
        """Forget the first n intervals."""
        left = self._size - n
        for array in self._stamps, self._f, self._w:
            array[:left] = array[n : self._size].copy()
        self._clock[_SIZE] = left

    def _take_pings(self) -> None:
        """Use the DVL measurements up to the last interval of the IMU."""
        while self._waiting and self._size and self._waiting[0][0] <= self._stamps[self._size - 1]:
            stamp_ns, data = self._waiting.pop(0)
            self._take_ping(stamp_ns, np.frombuffer(data))

    def _take_ping(self, stamp_ns: int, v_d: Array) -> None:
        if self._pings:
            since_ns = stamp_ns - self._pings[-1][0]
            if since_ns > PAUSE_NS:
                self._pings = []
            elif since_ns < SPACING_NS:
                return
        if not self._pings and stamp_ns < self._stamps[0]:
            return  # its interval is not complete
        self._pings.append((stamp_ns, v_d))
        start_ns = self._pings[0][0]
        if stamp_ns - start_ns >= WINDOW_NS:
            self._close()
            self._pings = self._pings[-1:]
        first = int(np.searchsorted(self._stamps[: self._size], self._pings[0][0], side="right"))
        if first > _STEPS // 8 or len(self._pings) == 1:
            self._drop(max(first - 1, 0))

    def _close(self) -> None:
        """Keep the window."""
        if len(self._pings) < FEWEST_PINGS:
            return
        stamps = np.array([stamp_ns for stamp_ns, _ in self._pings])
        ends = self._stamps[: self._size]
        first = int(np.searchsorted(ends, stamps[0], side="right"))
        last = int(np.searchsorted(ends, stamps[-1], side="left")) + 1
        C_b_i = self._terms.C_b_i
        samples = Samples(
            ends[first:last].copy(),
            self._f[first:last] @ C_b_i.T,
            self._w[first:last] @ C_b_i.T,
            stamps,
            np.array([v_d for _, v_d in self._pings]),
            self._average,
        )
        self._motions.append(Motion(samples))
        self._closed += 1
        if not self._thinks:
            return
        self._suspected = self._search.suspects(self._motions)
        if not self._suspected:
            self._explanations = []

    def _think(self) -> None:
        """Explain the windows if they contradict the parameters: one step of some 20 ms.

        What a window means to all causes takes 80 ms, once.
        """
        due = EVERY if self._explanations else 1
        if self._thought is not None:
            try:
                next(self._thought)
            except StopIteration as end:
                self._thought, self._explanations = None, end.value
        elif self._suspected and self._closed - self._explained >= due:
            missing = [motion for motion in self._motions if not motion.tried]
            if missing:
                missing[-1].compute(self._search.causes, self._search.known)
                return
            self._explained = self._closed
            if len(self._motions) >= FEWEST_WINDOWS:
                self._thought = self._search.explain(list(self._motions))

    def take_off(self, gyroscope_bias: Array, std: float) -> None:
        """Correct the windows for a bias that the recording shows, before `finish`.

        The turn by a large bias is no small error within a window: it looks like a wrong scale.

        Args:
            gyroscope_bias: (3,) in IMU axes [rad/s].
            std: One sigma of what is left of it [rad/s].
        """
        b = self._terms.C_b_i @ gyroscope_bias
        for k, motion in enumerate(self._motions):
            samples = motion.samples
            self._motions[k] = Motion(replace(samples, w=samples.w - b))
        self._search.gyroscope_bias = std

    def finish(self) -> None:
        """Explain all windows at once, at the end of a recording: some seconds where any is odd."""
        if len(self._motions) < FEWEST_WINDOWS:
            return
        if not self._thinks:
            self._suspected = self._search.suspects(self._motions)
        if not self._suspected:
            return
        for motion in self._motions:
            if not motion.tried:
                motion.compute(self._search.causes, self._search.known)
        self._thought, thought = None, self._search.explain(list(self._motions))
        while True:
            try:
                next(thought)
            except StopIteration as end:
                self._explained, self._explanations = self._closed, end.value
                return

    @property
    def windows(self) -> int:
        """Number of windows of motion that are kept."""
        return len(self._motions)

    @property
    def gravity(self) -> list[str]:
        """What contradicts gravity."""
        return self._gravity.findings()

    @property
    def remedies(self) -> list[Remedy]:
        """What the motion contradicts, the most probable cause first; gravity aside."""
        force = self._gravity.mean
        if not self._explanations or force is None:
            return []
        v_d = np.mean([m.window.v_d.mean(axis=0) for m in self._motions], axis=0)
        return [self._terms.remedy(e, force, v_d) for e in self._explanations]

    def findings(self) -> list[str]:
        """The contradictions that were found, one sentence each."""
        if found := self.gravity:
            return found
        if not (remedies := self.remedies):
            return []
        texts = "; or ".join(remedy.text for remedy in remedies)
        return [f"{texts} ({len(self._motions)} windows of {WINDOW_NS // NS} s)"]

    def alignment(self) -> Alignment | None:
        """Mount, scale, arm and time offset that the windows tell.

        None before there are enough of them, or while the axes of a sensor are wrong. All of them
        are free. A sigma near that of the prior tells that the motion does not show it.
        """
        best = self._explanations[0] if self._explanations else None
        if len(self._motions) < FEWEST_WINDOWS or (best and isinstance(best.cause, Miswired)):
            return None
        return self._terms.alignment(self._search.free(list(self._motions), best))

    def ping_noise(self) -> tuple[float, float] | None:
        """Noise of the DVL from ping to ping, one sigma of a component [m/s], and its own sigma.

        None before there are enough windows. It is what is left of the windows beside their slow
        parts, less what the IMU's own noise, as its samples show it, adds. Filter and gate have no
        part in it.
        """
        if len(self._motions) < FEWEST_WINDOWS:
            return None
        return self._search.ping_noise(list(self._motions))


def compile_check(parameters: FilterParameters) -> None:
    """Run a check for a moment, so that no message ever waits for a compilation."""
    check = AlignmentCheck(parameters)
    step_ns = round(NS / parameters.imu.rate)
    for k in range(1, 5):
        check.add(Imu(k * step_ns, np.array([0.0, 0.0, -9.8]), np.zeros(3)))
    for k in range(2, 4):
        check.add(Dvl(k * step_ns + step_ns // 2, np.full(3, 0.01 * k)))
    check.add(Dvl(4 * step_ns, np.full(3, 0.01)))
    stamps, zeros = step_ns * np.arange(1, 4), np.zeros((3, 3))
    window = integrated(stamps, zeros, zeros, stamps, zeros, 0.0)  # as after a window
    rows(window, Mounted(np.eye(3), np.zeros(3)), np.zeros(SIZE))
    samples = np.zeros((round(WINDOW_NS / step_ns), 6))
    integrated_variances(samples, parameters.imu.rate)  # as the noise of a window
    vector_from_rotation(np.eye(3))  # as an explanation does
