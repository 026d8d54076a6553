"""The tuner of the DVL's noise: from the pings and the IMU between them, without a filter.

The window is that of `navigation.measurement_noise.window`. Three pings are carried to each new one
by the specific force, turned by the gyroscopes, and the third difference of the four is free of
velocity, gravity, tilt and biases. No state is needed for it, and no gate stands before it: the
factor is that of the median of the last differences, which a few wild pings do not carry away.

The estimate depends on the stamps alone, as long as pings come in their order: a ping waits for the
samples of its time. Two tuners that have both seen the last 70 s, or 18 pings without a gap, and
their samples give the same bits. Nothing is told without five differences of the last minute.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS, Imu, refusal
from insdvl.navigation.geometry.frames import CONVENTIONS, rotation_from_rpy, rotation_from_vector
from insdvl.navigation.measurement_noise import window
from insdvl.navigation.measurement_noise.source import LARGEST, smallest_factor
from insdvl.navigation.measurements import noise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.timeline.samples import rate_at
from insdvl.tuner.parameters import TunerParameters

#: The turn rate for the arm is that of a line through the samples of this time.
_TURN_NS = NS // 4
_LONGEST_NS = round(window.LONGEST * NS)
#: A ping may be so far ahead of the samples, which come in queues of their own.
_AHEAD_NS = 10 * NS
#: Counts of pings that tell nothing, see `DvlTuner`.
UNUSED = (
    "pings_incomplete",
    "pings_without_lock",
    "pings_out_of_order",
    "pings_far_ahead",
    "pings_without_samples",
)
#: Pings that wait for their samples, at most.
_MOST_WAITING = 100


@dataclass(frozen=True)
class TunedSensorNoise:
    """The DVL's white noise, from a stamp on.

    Attributes:
        stamp_ns: Stamp of the newest ping.
        R: (3, 3) its covariance [(m/s)^2], in DVL axes, forward-right-down.
    """

    stamp_ns: int
    R: Array


@dataclass(frozen=True)
class _Ping:
    """A ping as the velocity of the IMU, in the axes and at the time that it was carried to.

    Attributes:
        stamp_ns: Its own.
        v_b: (3,) velocity [m/s].
        R_b: (3, 3) nominal covariance of its noise.
    """

    stamp_ns: int
    v_b: Array
    R_b: Array

    def carried(self, C: Array, u: Array) -> "_Ping":
        """The same after a turn C (3, 3), with u (3,) the integral of the specific force."""
        return _Ping(self.stamp_ns, C.T @ (self.v_b + u), C.T @ self.R_b @ C)


class DvlTuner:
    """Estimates the noise of a DVL.

    Attributes:
        counts: Pings that were used (``pings``) and that were not: with a component that was not
            measured (``pings_incomplete``), exact zeros or a repetition (``pings_without_lock``),
            late ones (``pings_out_of_order``), those far ahead of the samples
            (``pings_far_ahead``), and those without samples (``pings_without_samples``).
    """

    def __init__(self, parameters: TunerParameters) -> None:
        axes, imu, dvl = CONVENTIONS[parameters.frame_convention], parameters.imu, parameters.dvl
        self._C_b_i = axes.body_rotation(rotation_from_rpy(np.array(imu.mount)))
        self._C_b_d = axes.body_rotation(rotation_from_rpy(np.array(dvl.mount)))
        self._l_b = axes.body @ (np.array(dvl.lever_arm) - np.array(imu.lever_arm))
        self._imu_offset_ns = round(imu.time_offset * NS)
        self._dvl_offset_ns = round(dvl.time_offset * NS)
        self._dvl = dvl
        self._R = np.diag(np.square(dvl.noise_std))
        self._max_gap_ns = round(parameters.max_gap * NS)
        # Samples: end of the interval, specific force and angular rate (3,), base_link axes
        self._samples: deque[tuple[int, Array, Array]] = deque()
        self._waiting: deque[Dvl] = deque(maxlen=_MOST_WAITING)
        self._pings: list[_Ping] = []
        # Stamp of the newest ping and square of the last differences
        self._squares: deque[tuple[int, float]] = deque(maxlen=window.SIZE)
        self._last: Dvl | None = None
        self.counts = dict.fromkeys(("pings", *UNUSED), 0)
        self._rate(np.arange(3) * NS, np.zeros((3, 3)), 2 * NS)  # compiles it

    def add_sample(self, sample: Imu) -> list[TunedSensorNoise]:
        """Add a sample, in IMU axes; the estimates of the pings that have waited for it.

        A sample that is not finite, repeats a stamp or is late is left out. One behind a gap, or
        from before by more than a gap, starts anew.
        """
        stamp_ns = sample.stamp_ns + self._imu_offset_ns
        if refusal(sample):
            return []
        if self._samples:
            step_ns = stamp_ns - self._samples[-1][0]
            if -self._max_gap_ns <= step_ns <= 0:
                return []
            if not 0 < step_ns <= self._max_gap_ns:
                self._samples.clear()
            if step_ns < 0:  # a restart
                self._waiting.clear()
                self._pings.clear()
                self._squares.clear()
                self._last = None
        if not self._samples:
            self._leave_far_ahead(stamp_ns)
        C = self._C_b_i
        self._samples.append((stamp_ns, C @ sample.f_b, C @ sample.w_ib_b))
        while stamp_ns - self._samples[0][0] > _LONGEST_NS + _TURN_NS:
            self._samples.popleft()
        return list(self._tune())

    def add_ping(self, ping: Dvl) -> list[TunedSensorNoise]:
        """Add a ping; its estimate, where the samples of its time are here."""
        ping = Dvl(ping.stamp_ns + self._dvl_offset_ns, ping.v_d, ping.R, ping.measured)
        if not all(ping.measured):
            self.counts["pings_incomplete"] += 1
            return []
        if refusal(ping) or not ping.v_d.any():
            self.counts["pings_without_lock"] += 1
            return []
        newest = self._waiting[-1] if self._waiting else self._last
        if newest is not None and ping.stamp_ns <= newest.stamp_ns:
            self.counts["pings_out_of_order"] += 1
            return []
        if newest is not None and np.array_equal(ping.v_d, newest.v_d):
            self.counts["pings_without_lock"] += 1
            return []
        if self._samples and _is_far_ahead(ping, self._samples[-1][0]):
            self.counts["pings_far_ahead"] += 1
            return []
        self._waiting.append(ping)
        return list(self._tune())

    def _leave_far_ahead(self, stamp_ns: int) -> None:
        """Of the pings that have waited for a first sample, leave out those far ahead of it."""
        near = [ping for ping in self._waiting if not _is_far_ahead(ping, stamp_ns)]
        self.counts["pings_far_ahead"] += len(self._waiting) - len(near)
        self._waiting = deque(near, maxlen=_MOST_WAITING)

    def _tune(self) -> Iterator[TunedSensorNoise]:
        """The estimates of the pings that have their samples."""
        while self._waiting and self._samples and self._waiting[0].stamp_ns <= self._samples[-1][0]:
            ping = self._waiting.popleft()
            self._last = ping
            if ping.stamp_ns <= self._samples[0][0]:
                self.counts["pings_without_samples"] += 1
                self._pings.clear()
                continue
            self.counts["pings"] += 1
            R_0 = noise.chosen(ping.R, self._R, self._dvl.noise_floor, self._dvl.covariance)
            self._compare(ping, R_0)
            factor = window.median_factor(self._recent(ping.stamp_ns))
            if factor is not None:
                low = smallest_factor(R_0, self._dvl.noise_floor)
                R = min(max(factor, low), LARGEST) * R_0
                yield TunedSensorNoise(ping.stamp_ns - self._dvl_offset_ns, R)

    def _compare(self, ping: Dvl, R_0: Array) -> None:
        """The ping joins the last ones, carried to it, and their third difference the window."""
        stamps, f_b, w_ib_b = (np.array(column) for column in zip(*self._samples, strict=True))
        at_ns = ping.stamp_ns
        if self._pings:
            since_ns = self._pings[-1].stamp_ns
            if since_ns < stamps[0]:  # the samples have a gap
                self._pings.clear()
            else:
                leg = _leg(stamps, f_b, w_ib_b, since_ns, at_ns)
                self._pings = [one.carried(*leg) for one in self._pings]
        v_b = self._C_b_d @ ping.v_d
        if self._l_b.any():
            v_b = v_b - np.cross(self._rate(stamps, w_ib_b, at_ns), self._l_b)
        self._pings.append(_Ping(at_ns, v_b, self._C_b_d @ R_0 @ self._C_b_d.T))
        if len(self._pings) > window.PAST:
            four = self._pings
            self._pings = four[1:]
            if at_ns - four[0].stamp_ns <= _LONGEST_NS:
                square = window.difference_square(
                    np.array([one.stamp_ns for one in four]),
                    np.array([one.v_b for one in four]),
                    np.array([one.R_b for one in four]),
                )
                if np.isfinite(square):
                    self._squares.append((at_ns, square))
        while len(self._samples) > 1 and self._samples[1][0] <= at_ns - _TURN_NS:
            self._samples.popleft()

    def _recent(self, at_ns: int) -> Array:
        """The squares (n,) of the window that tell something at a stamp."""
        stamps_ns = np.array([stamp_ns for stamp_ns, _ in self._squares], np.int64)
        squares = np.array([square for _, square in self._squares])
        return window.recent(squares, stamps_ns, at_ns)

    @staticmethod
    def _rate(stamps: Stamps, w_ib_b: Array, at_ns: int) -> Array:
        """Turn rate (3,) at a stamp within the samples (N,), (N, 3)."""
        k, rate = int(np.searchsorted(stamps, at_ns)), np.empty(3)
        seen = np.ones(len(stamps), np.bool_)
        rate_at(stamps, w_ib_b, seen, k, at_ns, _TURN_NS, np.zeros(3), rate, np.empty(3))
        return rate


def _is_far_ahead(ping: Dvl, stamp_ns: int) -> bool:
    """Whether a ping has a wrong stamp: it would make all pings until there late."""
    return ping.stamp_ns - stamp_ns > _AHEAD_NS


def _leg(
    stamps: Array, f_b: Array, w_ib_b: Array, since_ns: int, to_ns: int
) -> tuple[Array, Array]:
    """Turn and integral of the specific force between two stamps, within the samples (N,), (N, 3).

    Each sample is the mean over the interval that ends at its stamp.

    Returns:
        C (3, 3), from the axes at the end to those at the beginning, and u (3,) [m/s] in the axes
        at the beginning.
    """
    first = int(np.searchsorted(stamps, since_ns, side="right"))
    last = int(np.searchsorted(stamps, to_ns, side="left")) + 1
    ends = np.minimum(stamps[first:last], to_ns)
    begins = np.maximum(stamps[first - 1 : last - 1], since_ns)
    dt = ((ends - begins) / NS)[:, None]
    angles = w_ib_b[first:last] * dt
    # The specific force of an interval is taken in the axes at its middle.
    middles, turns = rotation_from_vector(angles / 2.0), rotation_from_vector(angles)
    steps = np.einsum("kij,kj->ki", middles, f_b[first:last] * dt)
    C, u = np.eye(3), np.zeros(3)
    for step, turn in zip(steps, turns, strict=True):
        u = u + C @ step
        C = C @ turn
    return C, u
