"""Whether the axes of IMU and DVL agree with the parameters.

A wrong sign is rarely noticed at once: a filter with a reversed gyroscope axis drifts, and its gate
rejects the DVL. Two checks find it while the vehicle moves.

Gravity: the specific force of an upright vehicle points up, most of the time.

Motion: within a window the velocity in the axes of the window's start, R(t) v(t), changes
by the specific force and gravity: v(t) = v_0 + integral(R f) + g t, with R from the gyroscope. v_0
and g are unknown, and a constant rotation rate of g, from a gyroscope bias or the Earth, adds a
term in t^2. If the axes are right, the residual of R v_dvl - integral(R f) after the fit of such a
parabola is noise. With a reversed axis of the gyroscope or the DVL it is much larger as soon as the
vehicle turns or pitches. So the window is also computed with every reversal, and the mean squares
of many windows are compared. The noise need not be known, and a motion without information accuses
no axis.
"""

from bisect import insort
from collections import deque
from dataclasses import dataclass
from itertools import product

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.events import NS, Event, Imu
from insdvl.navigation.geometry.frames import CONVENTIONS, rotation_from_rpy
from insdvl.navigation.geometry.rotation import exponential, rotate
from insdvl.navigation.geometry.rotation import product as matrix_product
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters

GRAVITY = 9.81  # m/s^2, accurate enough for a sign
BLOCK_NS = 10 * NS  # length of a block with a mean specific force
BLOCKS = 6  # number of blocks that must agree: no manoeuvre lasts as long
FEWEST_BLOCKS = 2
UPSIDE_DOWN = -0.5  # share of the specific force that points up
ASIDE = 0.94  # share of it along another axis: 20 deg
WRONG_SIZE = 0.3  # relative difference from gravity

WINDOW_NS = 20 * NS  # long enough for a turn, short enough for a noisy gyroscope
WINDOWS = 60  # number of windows that are kept: 20 minutes
FEWEST_WINDOWS = 5
PINGS = 8  # DVL measurements that a window must have; the parabola takes 3
SPACING_NS = WINDOW_NS // 100  # smallest time between two that are used
PAUSE_NS = 5 * NS  # a longer time without any ends the window
SMALLEST = 1e-3  # m/s, smallest RMS residual that accuses an axis: no DVL is better
RATIO = 2.0  # of two mean squares, from which the larger one is refuted


_SAMPLES = 4096  # IMU samples that wait for a late DVL: 4 s at 1 kHz
_WAITING = 64  # DVL measurements that wait for the IMU

#: Reversals (8, 3) of the axes of a sensor; the first is none.
SIGNS = np.array(list(product((1.0, -1.0), repeat=3)))


@kernel
def _integrate(
    signs: Array, dt: Array, f: Array, w: Array, R: Array, F: Array, scratch: Array
) -> None:
    """Advance the rotation and the integral of the specific force, for every reversal.

    Args:
        signs: (8, 3) reversals.
        dt: (N,) lengths of the samples' intervals [s].
        f: (N, 3) specific force [m/s^2].
        w: (N, 3) angular rate [rad/s].
        R: (8, 3, 3) to the axes of the window's start; advanced.
        F: (8, 3) integral of R f; advanced [m/s].
        scratch: (4, 3, 3).
    """
    turn, mean_turn, turned, force = scratch[0], scratch[1], scratch[2], scratch[3, 0]
    for i in range(dt.size):
        for h in range(signs.shape[0]):
            x = signs[h, 0] * w[i, 0] * dt[i]
            y = signs[h, 1] * w[i, 1] * dt[i]
            z = signs[h, 2] * w[i, 2] * dt[i]
            exponential(turn, mean_turn, x, y, z)
            rotate(force, mean_turn, f[i])
            for a in range(3):
                for b in range(3):
                    F[h, a] += R[h, a, b] * force[b] * dt[i]
            matrix_product(turned, R[h], turn)
            R[h] = turned


@dataclass(frozen=True)
class _Hypothesis:
    """Reversed axes of the gyroscope or of the DVL."""

    sensor: str
    signs: Array

    @property
    def text(self) -> str:
        axes = [axis for axis, sign in zip("xyz", self.signs, strict=True) if sign < 0.0]
        return f"{self.sensor} {' and '.join(axes)}"


_HYPOTHESES = [_Hypothesis("gyroscope", signs) for signs in SIGNS]
_HYPOTHESES += [_Hypothesis("DVL", signs) for signs in SIGNS[1:]]


def _is_part_of(g: int, h: int) -> bool:
    """Whether hypothesis g reverses fewer axes than h, and none that h does not."""
    a, b = _HYPOTHESES[g], _HYPOTHESES[h]
    return g != h and a.sensor == b.sensor and bool((a.signs >= b.signs).all())


class FrameCheck:
    """Watches the events of the filter; memory and work per event are bounded.

    Events may arrive late and in any order; one that is too late for its window is not used.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        self._convention = parameters.frame_convention
        axes = CONVENTIONS[parameters.frame_convention]
        self._axes = axes.body
        self._C_b_i = axes.body_rotation(rotation_from_rpy(np.array(parameters.imu.mount)))
        C_b_d = axes.body_rotation(rotation_from_rpy(np.array(parameters.dvl.mount)))
        self._C_i_d = self._C_b_i.T @ C_b_d
        lever_arm = np.array(parameters.dvl.lever_arm) - np.array(parameters.imu.lever_arm)
        self._l_i_dvl = self._C_b_i.T @ axes.body @ lever_arm
        self._average_ns = round(parameters.dvl.gyro_average * NS)
        self._max_gap_ns = round(parameters.imu.max_gap * NS)

        self._block = np.zeros(3)
        self._block_size = 0
        self._block_end_ns: int | None = None
        self._forces: deque[Array] = deque(maxlen=BLOCKS)

        self._stamps = np.empty(_SAMPLES, np.int64)
        self._f = np.empty((_SAMPLES, 3))
        self._w = np.empty((_SAMPLES, 3))
        self._size = 0
        self._newest_ns: int | None = None
        self._done_ns: int | None = None  # samples up to here are in the window
        self._waiting: list[tuple[int, bytes]] = []

        self._R = np.empty((len(SIGNS), 3, 3))
        self._F = np.empty((len(SIGNS), 3))
        self._scratch = np.empty((4, 3, 3))
        self._turn = np.zeros(3)  # rad/s, mean of the last samples in the window
        self._start_ns: int | None = None
        self._pings: list[tuple[int, Array]] = []
        self._residuals: deque[Array] = deque(maxlen=WINDOWS)

    def add(self, event: Event) -> None:
        """Take an event; one without axes is ignored."""
        if isinstance(event, Imu):
            self._add_sample(event)
        elif isinstance(event, Dvl) and event.v_d.any():
            insort(self._waiting, (event.stamp_ns, event.v_d.tobytes()))
            del self._waiting[_WAITING:]  # the earliest is the next to be used
        self._take_pings()

    def _add_sample(self, sample: Imu) -> None:
        stamp_ns = sample.stamp_ns
        if self._newest_ns is not None and stamp_ns <= self._newest_ns:
            return
        if self._newest_ns is not None and stamp_ns - self._newest_ns > self._max_gap_ns:
            self._restart()
        self._newest_ns = stamp_ns
        if self._size == _SAMPLES:
            self._advance(int(self._stamps[_SAMPLES // 2]))
        self._stamps[self._size] = stamp_ns
        self._f[self._size] = sample.f_b
        self._w[self._size] = sample.w_ib_b
        self._size += 1

        if self._block_end_ns is None:
            self._block_end_ns = stamp_ns + BLOCK_NS
        self._block += sample.f_b
        self._block_size += 1
        if stamp_ns >= self._block_end_ns:
            self._forces.append(self._C_b_i @ self._block / self._block_size)
            self._block[:] = 0.0
            self._block_size, self._block_end_ns = 0, stamp_ns + BLOCK_NS

    def _restart(self) -> None:
        """Drop the window and the samples before a gap."""
        self._size = 0
        self._done_ns = self._newest_ns
        self._start_ns = None

    def _advance(self, to_ns: int) -> None:
        """Bring the samples up to a stamp into the window."""
        n = int(np.searchsorted(self._stamps[: self._size], to_ns, side="right"))
        if not n:
            return
        before_ns = self._stamps[0] if self._done_ns is None else self._done_ns
        if self._start_ns is not None:
            dt = np.diff(self._stamps[:n], prepend=before_ns) / NS
            _integrate(SIGNS, dt, self._f[:n], self._w[:n], self._R, self._F, self._scratch)
        first = int(np.searchsorted(self._stamps[:n], to_ns - self._average_ns, side="right"))
        self._turn = self._w[min(first, n - 1) : n].mean(axis=0)
        self._done_ns = int(self._stamps[n - 1])
        left = self._size - n
        for array in self._stamps, self._f, self._w:
            array[:left] = array[n : self._size].copy()
        self._size = left

    def _take_pings(self) -> None:
        """Use the DVL measurements up to the newest IMU sample."""
        while self._waiting and self._newest_ns is not None:
            stamp_ns, data = self._waiting[0]
            if stamp_ns > self._newest_ns:
                return
            del self._waiting[0]
            if self._done_ns is None or stamp_ns > self._done_ns:
                self._advance(stamp_ns)
                self._take_ping(stamp_ns, np.frombuffer(data))

    def _take_ping(self, stamp_ns: int, v_d: Array) -> None:
        if self._start_ns is not None:
            since_ns = stamp_ns - self._pings[-1][0]
            if since_ns > PAUSE_NS:
                self._start_ns = None
            elif since_ns < SPACING_NS:
                return
        if self._start_ns is not None:
            self._pings.append((stamp_ns, self._without_force(v_d)))
            if stamp_ns - self._start_ns < WINDOW_NS:
                return
            self._close()
        self._start_ns = stamp_ns
        self._R[:] = np.eye(3)
        self._F[:] = 0.0
        self._pings = [(stamp_ns, self._without_force(v_d))]

    def _without_force(self, v_d: Array) -> Array:
        """R v - integral(R f) of each hypothesis (15, 3), v being the velocity of the IMU."""
        of_dvl = np.cross(SIGNS * self._turn, self._l_i_dvl)
        v = self._C_i_d @ v_d - of_dvl  # (8, 3)
        with_gyroscope = np.einsum("hij,hj->hi", self._R, v) - self._F
        v = (SIGNS[1:] * v_d) @ self._C_i_d.T - of_dvl[0]
        return np.concatenate([with_gyroscope, v @ self._R[0].T - self._F[0]])

    def _close(self) -> None:
        """Keep the mean squared residual of each hypothesis after the fit of a parabola."""
        if len(self._pings) < PINGS:
            return
        t = np.array([stamp_ns - self._pings[0][0] for stamp_ns, _ in self._pings]) / WINDOW_NS
        basis, _ = np.linalg.qr(np.stack([np.ones_like(t), t, t * t], axis=1))
        values = np.array([value for _, value in self._pings]).reshape(len(t), -1)
        residual = values - basis @ (basis.T @ values)
        self._residuals.append((residual**2).mean(axis=0).reshape(-1, 3).sum(axis=1))

    def findings(self) -> list[str]:
        """The contradictions that were found, one sentence each."""
        return self._gravity() or self._motion()

    def _gravity(self) -> list[str]:
        if len(self._forces) < FEWEST_BLOCKS:
            return []
        forces = np.array(self._forces)
        sizes = np.linalg.norm(forces, axis=1)
        mean = self._axes @ forces.mean(axis=0)
        seconds = len(forces) * BLOCK_NS // NS
        if (np.abs(sizes / GRAVITY - 1.0) > WRONG_SIZE).all():
            return [
                f"the mean specific force has been {sizes.mean():.2f} m/s^2 for {seconds} s, but "
                f"gravity alone is {GRAVITY}: wrong unit, or gravity was removed"
            ]
        up = self._axes[2, 2] * GRAVITY * -1.0  # along z of base_link, in the stream's axes
        if (-forces[:, 2] / sizes < UPSIDE_DOWN).all():
            other = next(name for name in CONVENTIONS if name != self._convention)
            return [
                f"gravity has the wrong sign along z: the specific force of base_link has been "
                f"{mean[2]:+.2f} m/s^2 for {seconds} s, but must be {up:+.2f} when upright with "
                f"frame_convention {self._convention!r}; frame_convention {other!r} would fit, or "
                "an imu.mount rotated by pi"
            ]
        for axis in range(2):
            if (np.abs(forces[:, axis]) / sizes > ASIDE).all():
                return [
                    f"gravity is along {'xy'[axis]} of base_link, not along z: the specific force "
                    f"along it has been {mean[axis]:+.2f} m/s^2 for {seconds} s; imu.mount is "
                    "wrong, or the vehicle is not upright"
                ]
        return []

    def _motion(self) -> list[str]:
        if len(self._residuals) < FEWEST_WINDOWS:
            return []
        mean = np.mean(self._residuals, axis=0)
        if mean[0] < max(RATIO * mean.min(), SMALLEST**2):
            return []
        # Those that the best one does not refute. An axis without motion fits with either sign: it
        # is accused only if no hypothesis without it fits.
        fitting = [h for h in np.argsort(mean) if mean[h] < RATIO * mean.min()]
        accused = [h for h in fitting if not any(_is_part_of(g, h) for g in fitting)]
        names = " or ".join(_HYPOTHESES[h].text for h in accused)
        return [
            f"{names} has the wrong sign: turns and velocities contradict each other, "
            f"{mean[0] / mean.min():.1f} times less with it reversed "
            f"({len(self._residuals)} windows of {WINDOW_NS // NS} s)"
        ]
