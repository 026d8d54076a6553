"""What is kept of every sample: a short record of where the vehicle is, and now and then all.

A state record has several kilobytes. A recording of hours cannot keep one per sample; most who use
its result need the track at every sample and the covariance a few times a second.

All that is published, saved or scored is kept here first. So here is seen whether a state has
diverged: then it is given up (`Filter.give_up`) before anybody sees it.
"""

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records, Stamps
from insdvl.kernels import kernel
from insdvl.navigation.state.fields import State

#: What is kept of every state; the fields are those of its group ``nav``.
TRACK = np.dtype(
    [
        ("time_ns", "i8"),
        ("initialised", "i8"),
        ("lat_0", "f8"),
        ("lon_0", "f8"),
        ("h_0", "f8"),
        ("C_n_b", "f8", (3, 3)),
        ("v_n", "f8", (3,)),
        ("llh", "f8", (3,)),
    ],
    align=True,
)


# First columns of the fields of `TRACK`, each of eight bytes, for the kernel.
_C_N_B, _V_N, _LLH = 5, 14, 17
_COLUMNS = TRACK.itemsize // 8

#: A state has diverged if its numbers, or their variances, add up to more [SI]. No vehicle comes
#: near. What a step or an output makes of less is finite, also in the single precision of a
#: recording.
LARGEST, LARGEST_VARIANCE = 1e8, 1e22


@kernel
def has_diverged(s: State) -> bool:
    """Whether a state is not finite, or on its way there.

    Covariances are not looked at: they are no larger than the variances.
    """
    nav, noise = s.nav, s.noise
    numbers, angles, variances = 0.0, 0.0, 0.0
    for i in range(3):
        numbers += abs(nav.v_n[i]) + abs(nav.llh[i]) + abs(nav.llh_r[i])
        numbers += abs(nav.b_f[i]) + abs(nav.b_w[i]) + abs(nav.w_nb_b[i])
        variances += abs(noise.Q_f[i, i]) + abs(noise.Q_w[i, i])
        for j in range(3):
            angles += abs(nav.C_n_b[i, j])
    for i in range(nav.P.shape[0]):
        variances += abs(nav.P[i, i]) + abs(noise.excess[i, i])
    is_sound = numbers + angles <= LARGEST and variances <= LARGEST_VARIANCE  # nan is not
    return not is_sound


@kernel
def keep(
    s: State,
    k: int,
    every: int,
    states: Records,
    numbers: Array,
    integers: Stamps,
    verdicts: NDArray[np.int8],
) -> bool:
    """Keep the state at sample k, see `Kept`; whether it may be: it has not diverged."""
    nav = s.nav
    integers[k, 0], integers[k, 1] = nav.time_ns, nav.initialised
    numbers[k, 2], numbers[k, 3], numbers[k, 4] = nav.lat_0, nav.lon_0, nav.h_0
    for i in range(3):
        numbers[k, _V_N + i], numbers[k, _LLH + i] = nav.v_n[i], nav.llh[i]
        for j in range(3):
            numbers[k, _C_N_B + 3 * i + j] = nav.C_n_b[i, j]
    for i in range(6):
        verdicts[k, i] = s.channels.verdict[i]
    if (k + 1) % every == 0:
        states[k // every] = s
    return not has_diverged(s)


@kernel
def _keep(
    state: Records,
    k: int,
    every: int,
    states: Records,
    numbers: Array,
    integers: Stamps,
    verdicts: NDArray[np.int8],
) -> bool:
    return keep(state[0], k, every, states, numbers, integers, verdicts)


class Kept:
    """What is kept of the states at N samples.

    Args:
        size: Number of samples to make room for.
        dtype: Of a state record.
        every: Of so many samples the whole state of the last one is kept.

    Attributes:
        states: (N // every,) state records; the one of sample k is at ``k // every``.
        track: (N,) records of `TRACK`.
        numbers: (N, 20) the same as floats, for kernels: a call with one more record costs them
            more than what they do with it.
        integers: (N, 20) the same as integers.
        verdicts: (N, 6) on the channels of the samples, see channels.py.
    """

    def __init__(self, size: int, dtype: "np.dtype[np.void]", every: int = 1) -> None:
        self.every = every
        self._reserve(size, dtype)

    def _reserve(self, size: int, dtype: "np.dtype[np.void]") -> None:
        self.states: Records = np.empty(size // self.every, dtype)
        self.track: Records = np.empty(size, TRACK)
        self.numbers: Array = self.track.view(np.float64).reshape(size, _COLUMNS)
        self.integers: Stamps = self.track.view(np.int64).reshape(size, _COLUMNS)
        self.verdicts: NDArray[np.int8] = np.empty((size, 6), np.int8)
        self._bytes = self.states.view(np.uint8).reshape(-1, dtype.itemsize)

    def put(self, state: Records, k: int) -> bool:
        """Keep the state (1,) at sample k; False for one that has diverged and must not stay."""
        arrays = self.states, self.numbers, self.integers, self.verdicts
        return bool(_keep(state, k, self.every, *arrays))

    def before(self, k: int) -> int:
        """The last sample before k behind which the state is kept, and -1 for none."""
        return k - k % self.every - 1

    def at(self, k: int) -> State:
        """The state that is kept at sample k."""
        return self.states[k // self.every]

    def restore(self, state: Records, k: int) -> None:
        """Make a state (1,) the one that is kept at sample k; its bytes copy faster than fields."""
        state.view(np.uint8)[:] = self._bytes[k // self.every]

    def drop(self, count: int, size: int) -> None:
        """Forget the first samples of so many; `count` is a multiple of `every`."""
        for array, first, last in (
            (self.track, count, size),
            (self.verdicts, count, size),
            (self._bytes, count // self.every, size // self.every),  # faster than by fields
        ):
            array[: last - first] = array[first:last].copy()

    def grow(self, size: int) -> None:
        """Make room for so many samples."""
        before = self.states, self.track, self.verdicts
        self._reserve(size, self.states.dtype)
        for larger, smaller in zip((self.states, self.track, self.verdicts), before, strict=True):
            larger[: len(smaller)] = smaller
