"""Prediction: a state record advances with samples of the IMU.

What a sample goes through, in order: a received Q that is too old ends; the channels are judged,
and what is not believed of them is replaced; the mechanisation moves the state, the error dynamics
and the input noise its covariance.
"""

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records, Stamps
from insdvl.kernels import kernel
from insdvl.navigation import channels, error_state
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, POSITION
from insdvl.navigation.geometry.rotation import copy_matrix, rotate
from insdvl.navigation.prediction import strapdown
from insdvl.navigation.prediction.kept import keep
from insdvl.navigation.state.fields import CORE, NEVER, State
from insdvl.navigation.state.scratch import Constants, Workspace

# First elements of blocks, for the kernel.
_BIASES, _POSITION = ACCELEROMETER_BIAS.start, POSITION.start


@kernel
def _is_driven(i: int) -> bool:
    """Whether the noise of the samples drives an error state: not the biases and optional ones."""
    return i < _BIASES or _POSITION <= i < CORE


@kernel
def _advance(
    s: State,
    w: Workspace,
    c: Constants,
    sample_ns: int,
    f_b: Array,
    w_ib_b: Array,
    reading: Array,
    to_ns: int,
) -> None:
    """Advance an initialised state with (a part of) the sample that ends at ``sample_ns``."""
    nav, noise, imu_ns = s.nav, s.noise, s.channels.imu_ns
    if to_ns <= nav.time_ns:
        return
    dt = (to_ns - nav.time_ns) * 1e-9
    if noise.q_ns != NEVER and nav.time_ns - noise.q_ns > c.q_timeout_ns:
        copy_matrix(noise.Q_f, c.Q_f_nominal)
        copy_matrix(noise.Q_w, c.Q_w_nominal)
        noise.q_ns = NEVER
        s.counters.q_timeouts += 1

    for i in range(3):
        w.f_hat[i] = f_b[i] - nav.b_f[i]
        w.w_hat[i] = w_ib_b[i] - nav.b_w[i]
    channels.judge(s, c, sample_ns, reading)
    channels.make_amends(s, w, c)
    in_doubt = channels.doubt(s, w, c, reading, to_ns, s.channels.told_ns)
    if in_doubt:
        channels.replace_frozen(s, w, c)
    _set_coning(s, w, c, sample_ns, in_doubt)
    strapdown.mechanise(s, w, c, w.f_hat, w.w_hat, dt)

    # Densities of the input noise; in a gap, of the motion that was not seen as well: a constant
    # error of one sigma over the gap T grows to (sigma T)^2, as a density sigma^2 T does.
    adaptive = 0 < c.window <= noise.innovation_count
    scale = 0.0 if adaptive and c.literal else c.density
    gap = 0.0
    if imu_ns != NEVER and sample_ns - imu_ns > c.gap_ns:
        gap = (sample_ns - imu_ns) * 1e-9
    for i in range(3):
        for j in range(3):
            w.S_f[i, j] = scale * noise.Q_f[i, j]
            w.S_w[i, j] = scale * noise.Q_w[i, j]
        w.S_f[i, i] += c.gap_f * c.gap_f * gap
        w.S_w[i, i] += c.gap_w * c.gap_w * gap
    if in_doubt:
        channels.add_unseen(s, w, c)

    error_state.transition(s, w, c, dt)
    if c.window > 0:
        w.Q_d[:] = 0.0  # the adapted density fills elements that input_noise leaves alone
    error_state.input_noise(s, w, c, w.S_f, w.S_w, dt)
    if adaptive:
        for i in range(c.n):
            for j in range(c.n):
                # In place of the nominal Q, but not of the motion that was not seen.
                if c.literal and not (_is_driven(i) and _is_driven(j)):
                    w.Q_d[i, j] = 0.0
                total = 0.0
                for a in range(3):
                    total += noise.root[i, a] * noise.root[j, a]
                w.Q_d[i, j] += dt * total
    error_state.propagate(nav.P, w, c.n)
    if c.invariant:
        error_state.bend(s, w, dt)
    nav.time_ns = to_ns


@kernel
def _set_coning(s: State, w: Workspace, c: Constants, sample_ns: int, in_doubt: bool) -> None:
    """Coning of the sample with the one before, where there is one and both show the motion."""
    channels, interval_ns = s.channels, sample_ns - s.channels.imu_ns
    w.coning[:] = 0.0
    if in_doubt or channels.equal[3] == 0 or interval_ns > c.gap_ns:
        return
    rotate(w.w_before, c.C_b_i, channels.believed[3:])
    for i in range(3):
        w.w_before[i] -= s.nav.b_w[i]
    strapdown.coning(w.coning, w.w_before, w.w_hat, interval_ns * 1e-9)


@kernel
def _complete(s: State, c: Constants, sample_ns: int, reading: Array) -> None:
    """The sample is used up."""
    imu = s.channels
    if imu.imu_ns != NEVER and sample_ns - imu.imu_ns > c.gap_ns:
        s.counters.gaps += 1
        imu.gap_ns = sample_ns
    channels.watch(s, c, sample_ns, reading)
    imu.imu_ns = sample_ns


@kernel
def predict_part(
    state: Records,
    workspace: Records,
    constants: Records,
    sample_ns: int,
    f_b: Array,
    w_ib_b: Array,
    reading: Array,
    to_ns: int,
) -> None:
    """Advance a record to a stamp inside the interval of a sample, see `filter.Filter`."""
    _advance(state[0], workspace[0], constants[0], sample_ns, f_b, w_ib_b, reading, to_ns)


@kernel
def predict_samples(
    state: Records,
    workspace: Records,
    constants: Records,
    stamps_ns: Stamps,
    f_b: Array,
    w_ib_b: Array,
    readings: Array,
    first: int,
    last: int,
    every: int,
    states: Records,
    numbers: Array,
    integers: Stamps,
    verdicts: NDArray[np.int8],
) -> int:
    """Advance a record over samples and keep what `Kept` keeps, see `filter.Filter`."""
    s, w, c = state[0], workspace[0], constants[0]
    for k in range(first, last):
        _advance(s, w, c, stamps_ns[k], f_b[k], w_ib_b[k], readings[k], stamps_ns[k])
        _complete(s, c, stamps_ns[k], readings[k])
        if not keep(s, k, every, states, numbers, integers, verdicts):
            return k
    return last
