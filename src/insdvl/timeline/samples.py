"""The samples of the IMU in the order of their stamps, and the state behind each of them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records, Stamps
from insdvl.kernels import kernel
from insdvl.navigation.channels import GOOD
from insdvl.navigation.events import Imu
from insdvl.navigation.geometry.rotation import copy_vector, rotate
from insdvl.navigation.prediction.kept import Kept

#: How fast a vehicle's turn rate changes, one sigma [rad/s^2]: rolling by 6 deg in 5 s has 0.12.
TURN_ACCELERATION = 0.1


@kernel
def rate_at(
    stamps_ns: Stamps,
    w_ib_b: Array,
    seen: NDArray[np.bool_],
    k: int,
    at_ns: int,
    window_ns: int,
    variance: Array,
    rate: Array,
    share: Array,
) -> None:
    """Angular rate at a stamp: that of a line through the samples of a window that ends there.

    A mean over the window would lag by half of it, the end of a line has four times its noise. So
    the slope has a prior, zero +- `TURN_ACCELERATION`: the samples of a good gyroscope overrule it,
    and the line is that of least squares; with very noisy ones it is near the mean. Each sample
    stands for the middle of its interval and is weighted by the share of the window that it has.
    With the weights g, the times t from the stamp and m samples of variance q the rate is the sum
    of c w,

        c = g (S_2 - S_1 t) / (S_0 S_2 - S_1^2),  S_n = sum of g t^n,  S_2 with q / sigma^2 S_0 / m.

    Args:
        stamps_ns: (N,) ends of the samples' intervals.
        w_ib_b: (N, 3) samples.
        seen: (N,) whether a sample is believed; others are left out.
        k: Index of the sample whose interval holds the stamp.
        at_ns: The stamp.
        window_ns: Length of the window; with 0, or with one sample in it, the rate is sample k.
        variance: (3,) of one sample [(rad/s)^2].
        rate: (3,) result.
        share: (3,) variance of its error in units of q: of the noise, the sum of c^2, and of the
            slope that is missed, (sum of c t)^2 sigma^2 / q.
    """
    start_ns = at_ns - window_ns
    first, count = k + 1, 0
    s_0, s_1, s_2 = 0.0, 0.0, 0.0
    while first > 1 and stamps_ns[first - 1] > start_ns:
        first -= 1
        if not seen[first]:
            continue
        count += 1
        g, t = _share_and_time(stamps_ns, first, start_ns, at_ns)
        s_0 += g
        s_1 += g * t
        s_2 += g * t * t
    if count < 2 or s_0 == 0.0:
        copy_vector(rate, w_ib_b[k])
        share[:] = 1.0
        return
    of_sample = s_0 / count
    for i in range(3):
        prior = of_sample * variance[i] / TURN_ACCELERATION**2
        s_2i = s_2 + prior
        determinant = s_0 * s_2i - s_1 * s_1
        rate[i], share[i] = 0.0, of_sample * prior * (s_1 / determinant) ** 2
        for j in range(first, k + 1):
            if not seen[j]:
                continue
            g, t = _share_and_time(stamps_ns, j, start_ns, at_ns)
            c = g * (s_2i - s_1 * t) / determinant
            rate[i] += c * w_ib_b[j, i]
            share[i] += c * c


@kernel
def _believed_rate_at(
    state: Records,
    constants: Records,
    stamps_ns: Stamps,
    w_ib_b: Array,
    verdicts: NDArray[np.int8],
    k: int,
    at_ns: int,
    window_ns: int,
    rate: Array,
    share: Array,
) -> None:
    """`rate_at` of the samples that are believed; the state (1,) has the verdicts on sample k."""
    first, variance, c = k, np.empty(3), constants[0]
    for i in range(3):
        variance[i] = state[0].noise.Q_w[i, i] * (c.density * c.rate)
    while first > 0 and stamps_ns[first] > at_ns - window_ns:
        first -= 1
    seen = np.empty(k + 1 - first, np.bool_)
    for j in range(first, k + 1):
        seen[j - first] = True
        for i in range(3, 6):
            verdict = state[0].channels.verdict[i] if j == k else verdicts[j, i]
            if verdict != GOOD:
                seen[j - first] = False
    stamps_ns, w_ib_b = stamps_ns[first : k + 1], w_ib_b[first : k + 1]
    rate_at(stamps_ns, w_ib_b, seen, k - first, at_ns, window_ns, variance, rate, share)


@kernel
def _share_and_time(stamps_ns: Stamps, j: int, start_ns: int, end_ns: int) -> tuple[float, float]:
    """Share of a window that sample j has, and the middle of its interval from its end [s]."""
    share = min(stamps_ns[j], end_ns) - max(stamps_ns[j - 1], start_ns)
    middle = 0.5 * ((stamps_ns[j] - end_ns) + (stamps_ns[j - 1] - end_ns))
    return share * 1e-9, middle * 1e-9


@kernel
def rotate_samples(out: Array, C: Array, samples: Array) -> None:
    """out[k] = C samples[k], for (N, 3) arrays; the same bits for any N."""
    for k in range(samples.shape[0]):
        rotate(out[k], C, samples[k])


@kernel
def _rotate_reading(f_b: Array, w_ib_b: Array, C: Array, reading: Array, k: int) -> None:
    """Sample k (N, 3) of both triads, from the reading (6,)."""
    rotate(f_b[k], C, reading[:3])
    rotate(w_ib_b[k], C, reading[3:])


class Samples:
    """Samples in base_link axes, as they were read, and the states at their stamps.

    The arrays have room for more than the ``count`` samples that they hold.

    Args:
        C_b_i: (3, 3) rotation from IMU to base_link axes.
        capacity: Number of samples to make room for at first.
        dtype: Of a state record.
        every: Of so many samples the whole state of the last one is kept.

    Attributes:
        count: Number of samples N.
        stale: Index of the first sample whose state is not valid.
        stamps_ns: (N,) stamps, rising.
        f_b: (N, 3) specific force [m/s^2], base_link axes.
        w_ib_b: (N, 3) angular rate [rad/s], base_link axes.
        readings: (N, 6) the same in the axes of the IMU, f, then w.
        kept: What is kept of the states at their stamps.
    """

    def __init__(
        self, C_b_i: Array, capacity: int, dtype: np.dtype[np.void], every: int = 1
    ) -> None:
        self._C_b_i = C_b_i
        self.count = 0
        self.stale = 0
        self.stamps_ns: Stamps = np.empty(capacity, dtype=np.int64)
        self.f_b: Array = np.empty((capacity, 3))
        self.w_ib_b: Array = np.empty((capacity, 3))
        self.readings: Array = np.empty((capacity, 6))
        self.kept = Kept(capacity, dtype, every)

    @property
    def is_full(self) -> bool:
        """Whether there is no room for another one."""
        return self.count == self.stamps_ns.size

    def index_of(self, stamp_ns: int) -> int:
        """Index of the first sample that is not before a stamp."""
        return int(self.stamps_ns[: self.count].searchsorted(stamp_ns))

    def turn_rate(
        self, state: Records, constants: Records, k: int, at_ns: int, window_ns: int
    ) -> tuple[Array, Array]:
        """Angular rate (3,) at a stamp, base_link axes, and share (3,) of its error, see `rate_at`.

        Args:
            state: (1,) record at the stamp.
            constants: (1,) record of the filter.
            k: Index of the sample whose interval holds the stamp.
            at_ns: The stamp.
            window_ns: Length of the window that ends there.
        """
        rate, share = np.empty(3), np.empty(3)
        samples = self.stamps_ns, self.w_ib_b, self.kept.verdicts
        _believed_rate_at(state, constants, *samples, k, at_ns, window_ns, rate, share)
        return rate, share

    def outdate(self, k: int) -> None:
        """The states from sample k on are not valid any more."""
        self.stale = min(self.stale, k)

    def outdate_from(self, stamp_ns: int) -> None:
        """The states from a stamp on are not valid any more."""
        if self.stale and self.stamps_ns[self.stale - 1] >= stamp_ns:
            self.outdate(self.index_of(stamp_ns))

    def window(self, state: Records, k: int, at_ns: int, length_ns: int) -> Array:
        """Samples (N, 6) that are believed of a time that ends at a stamp, see `turn_rate`.

        Specific force [m/s^2], then angular rate [rad/s], base_link axes.
        """
        part = slice(self.index_of(at_ns - length_ns), k + 1)
        believed = (self._verdicts(state, part) == GOOD).all(axis=1)
        return np.hstack([self.f_b[part], self.w_ib_b[part]])[believed]

    def _verdicts(self, state: Records, part: slice) -> NDArray[np.int64]:
        """(N, 6) on the channels of samples; the state inside the last interval has the last."""
        verdicts = self.kept.verdicts[part].astype(np.int64)
        verdicts[-1] = state[0]["channels"]["verdict"]
        return verdicts

    def insert(self, sample: Imu) -> bool:
        """Insert a sample in the order of the stamps; there must be room.

        Of two samples with one stamp the smaller one counts, whichever comes first.

        Returns:
            Whether it is new; not where there is one with its stamp.
        """
        reading = np.concatenate([sample.f_b, sample.w_ib_b])
        n, stamp_ns = self.count, sample.stamp_ns
        k = n
        if n and stamp_ns <= self.stamps_ns[n - 1]:
            k = self.index_of(stamp_ns)
            if self.stamps_ns[k] == stamp_ns:
                rotated = np.empty((2, 3))
                rotate_samples(rotated, self._C_b_i, reading.reshape(2, 3))
                kept = self.f_b[k].tobytes() + self.w_ib_b[k].tobytes()
                if rotated.tobytes() < kept:
                    self.f_b[k], self.w_ib_b[k], self.readings[k] = *rotated, reading
                    self.outdate(k)
                return False
            for array in (self.stamps_ns, self.f_b, self.w_ib_b, self.readings):
                array[k + 1 : n + 1] = array[k:n]
        self.stamps_ns[k], self.readings[k] = stamp_ns, reading
        _rotate_reading(self.f_b, self.w_ib_b, self._C_b_i, reading, k)
        self.count = n + 1
        self.outdate(k)
        return True

    def append(self, stamps_ns: Stamps, f_b: Array, w_ib_b: Array) -> None:
        """Append samples that follow the newest one; there must be room.

        Args:
            stamps_ns: (N,) stamps, strictly increasing.
            f_b: (N, 3) specific force [m/s^2], IMU axes, forward-right-down.
            w_ib_b: (N, 3) angular rate [rad/s], same axes.
        """
        part = slice(self.count, self.count + len(stamps_ns))
        self.stamps_ns[part] = stamps_ns
        rotate_samples(self.f_b[part], self._C_b_i, f_b)
        rotate_samples(self.w_ib_b[part], self._C_b_i, w_ib_b)
        self.readings[part, :3], self.readings[part, 3:] = f_b, w_ib_b
        self.count = part.stop

    def fill(self, stamps_ns: Stamps, f_b: Array, w_ib_b: Array) -> None:
        """Take all samples of a recording; there are none yet.

        Args:
            stamps_ns: (N,) stamps, strictly increasing.
            f_b: (N, 3) specific force [m/s^2], IMU axes, forward-right-down.
            w_ib_b: (N, 3) angular rate [rad/s], same axes.

        Raises:
            ValueError: There are samples already, the arrays do not fit, are not finite, or the
                stamps do not increase.
        """
        n = len(stamps_ns)
        if self.count:
            raise ValueError(f"the fold must be empty, it has {self.count} samples")
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
        if n > self.stamps_ns.size:
            self.grow(n)
        self.append(stamps_ns, f_b, w_ib_b)

    def put_state(self, state: Records, stamp_ns: int) -> None:
        """Begin with the state of another run in the place of a first sample.

        Args:
            state: (1,) record.
            stamp_ns: Of its last sample.
        """
        self.stamps_ns[0], self.f_b[0], self.w_ib_b[0] = stamp_ns, 0.0, 0.0
        self.readings[0] = state[0]["channels"]["reading"]
        self.kept.put(state, 0)
        self.count = self.stale = 1

    def drop(self, count: int) -> None:
        """Forget the first samples; all states are valid."""
        keep = self.count - count
        for array in (self.stamps_ns, self.f_b, self.w_ib_b, self.readings):
            array[:keep] = array[count : self.count].copy()
        self.kept.drop(count, self.count)
        self.count = self.stale = keep

    def grow(self, size: int) -> None:
        """Make room for so many samples."""
        self.stamps_ns = _grown(self.stamps_ns, size)
        self.f_b = _grown(self.f_b, size)
        self.w_ib_b = _grown(self.w_ib_b, size)
        self.readings = _grown(self.readings, size)
        self.kept.grow(size)


def _grown(array: NDArray[Any], size: int) -> NDArray[Any]:
    larger = np.empty((size, *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger
