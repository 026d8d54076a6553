"""Prediction with shaping states: strapdown and error dynamics are the core's, the noise is not.

The error of a channel of the IMU is its bias, white noise, and the sum of sigma_j u_j over its
shaping states u_j. They are independent first-order processes of unit variance,

    u_j <- a_j u_j + sqrt(1 - a_j^2) w,    a_j = exp(-dt / tau_j),

from sample to sample, as the simulator makes them. Within a sample they are constant, and so act
like a bias does: their columns of the transition are those of the bias of their channel, times
sigma_j, which is known and changes with the vehicle's noise.

The shaping states are the last ones of the optional states of a record (navigation/state/).
"""

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records, Stamps
from insdvl.kernels import kernel
from insdvl.navigation import error_state
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, POSITION
from insdvl.navigation.prediction import strapdown
from insdvl.navigation.prediction.kept import keep
from insdvl.navigation.state.fields import CORE, State
from insdvl.navigation.state.scratch import Constants, Workspace

# First elements of blocks, for the kernels.
_BIAS, _P = ACCELEROMETER_BIAS.start, POSITION.start


@kernel
def predict(
    state: Records,
    workspace: Records,
    constants: Records,
    stamps_ns: Stamps,
    readings: Array,
    white: Array,
    sigma: Array,
    channels: NDArray[np.intp],
    decay: Array,
    k: int,
    to_ns: int,
    every: int,
    states: Records,
    numbers: Array,
    integers: Stamps,
    verdicts: NDArray[np.int8],
) -> int:
    """Advance a record from within sample k, or its beginning, to a stamp; keep what `Kept` keeps.

    Args:
        state: (1,) record, initialised.
        workspace: (1,) of the same size.
        constants: (1,) of the same size.
        stamps_ns: (N,) stamps of the samples.
        readings: (N, 6) f [m/s^2], then w [rad/s], base_link axes.
        white: (N, 6) variances of their white noise [unit^2].
        sigma: (N, M) of the shaping states in each sample [unit].
        channels: (M,) the channel of each shaping state.
        decay: (M,) a_j, from one sample to the next.
        k: The first sample that is not used up.
        to_ns: The stamp.
        every: See `Kept`, and so the rest.

    Returns:
        The first sample that is not used up then.
    """
    s, w, c = state[0], workspace[0], constants[0]
    while k < len(stamps_ns) and s.nav.time_ns < to_ns:
        until_ns = min(stamps_ns[k], to_ns)
        before = max(k - 1, 0)
        interval = (stamps_ns[k] - stamps_ns[before]) * 1e-9  # 0 for the first: it has no coning
        _advance(
            s, w, c, readings[before], readings[k], interval, white[k], sigma[k], channels, until_ns
        )
        if until_ns == stamps_ns[k]:
            _next_sample(s, c, decay)
            keep(s, k, every, states, numbers, integers, verdicts)
            k += 1
    return k


@kernel
def _advance(
    s: State,
    w: Workspace,
    c: Constants,
    before: Array,
    reading: Array,
    interval: float,
    white: Array,
    sigma: Array,
    channels: NDArray[np.intp],
    to_ns: int,
) -> None:
    """Advance with (a part of) a sample, as `navigation.prediction.predict` does."""
    nav, dt, first = s.nav, (to_ns - s.nav.time_ns) * 1e-9, c.n - len(channels)
    error = np.empty(6)
    for i in range(3):
        error[i], error[3 + i] = nav.b_f[i], nav.b_w[i]
    for j in range(len(channels)):
        error[channels[j]] += sigma[j] * nav.optional[first - CORE + j]
    for i in range(3):
        w.f_hat[i] = reading[i] - error[i]
        w.w_hat[i] = reading[3 + i] - error[3 + i]
        w.w_before[i] = before[3 + i] - error[3 + i]
    strapdown.coning(w.coning, w.w_before, w.w_hat, interval)
    strapdown.mechanise(s, w, c, w.f_hat, w.w_hat, dt)

    for i in range(3):
        w.S_f[i, i], w.S_w[i, i] = c.density * white[i], c.density * white[3 + i]
    error_state.transition(s, w, c, dt)
    error_state.input_noise(s, w, c, w.S_f, w.S_w, dt)
    propagate(nav.P, w, c.n, channels, sigma)
    if c.invariant:
        error_state.bend(s, w, dt)
    nav.time_ns = to_ns


@kernel
def _next_sample(s: State, c: Constants, decay: Array) -> None:
    """The shaping states become those of the next sample."""
    P, first = s.nav.P, c.n - len(decay)
    for j in range(len(decay)):
        at, a = first + j, decay[j]
        s.nav.optional[at - CORE] *= a
        for i in range(c.n):
            P[at, i] *= a
        for i in range(c.n):
            P[i, at] *= a
        P[at, at] += 1.0 - a * a


@kernel
def propagate(P: Array, w: Workspace, n: int, channels: NDArray[np.intp], sigma: Array) -> None:
    """P <- T (P + Q_d / 2) T^T + Q_d / 2, in place, as `error_state.propagate`.

    T is the transition ``w.Phi`` of the core, with the columns of the shaping states. A column is
    that of a bias times sigma_j, so the rows of bias and shaping states of a channel are added up
    first.

    Args:
        P: (N, N) covariance, of which the first n states are in use.
        w: Has Phi and Q_d of the core and of the optional states.
        n: Number of error states.
        channels: (M,) of the shaping states, which are the last ones.
        sigma: (M,) of them [unit].
    """
    A, B, Phi, Q_d, first = w.A, w.B, w.Phi, w.Q_d, n - len(channels)
    for i in range(n):
        for j in range(n):
            B[i, j] = P[i, j]
    for i in range(CORE):
        for j in range(CORE):
            B[i, j] += 0.5 * Q_d[i, j]
    for i in range(CORE, n):
        B[i, i] += 0.5 * Q_d[i, i]

    errors = B[_BIAS:_P, :n].copy()  # of the channels
    for j in range(len(channels)):
        for m in range(n):
            errors[channels[j], m] += sigma[j] * B[first + j, m]
    for i in range(CORE):
        if _BIAS <= i < _P:
            continue
        for m in range(n):
            A[i, m] = B[i, m] if i >= _P else 0.0
        for k in range(_BIAS):
            for m in range(n):
                A[i, m] += Phi[i, k] * B[k, m]
        for k in range(6):
            for m in range(n):
                A[i, m] += Phi[i, _BIAS + k] * errors[k, m]

    for i in range(_BIAS, _P):
        for j in range(_BIAS, _P):
            P[i, j] = B[i, j] + 0.5 * Q_d[i, j]
        for j in range(CORE, n):
            _set_symmetric(P, i, j, B[i, j] * Phi[j, j])
    for i in range(CORE, n):
        for j in range(CORE, n):
            P[i, j] = B[i, j] * Phi[i, i] * Phi[j, j]
        P[i, i] += 0.5 * Q_d[i, i]
    row = np.empty(6)
    for i in range(CORE):
        if _BIAS <= i < _P:
            continue
        for j in range(_BIAS, _P):
            row[j - _BIAS] = A[i, j]
            _set_symmetric(P, i, j, A[i, j] + 0.5 * Q_d[i, j])
        for j in range(CORE, n):
            _set_symmetric(P, i, j, A[i, j] * Phi[j, j])
        for j in range(len(channels)):
            row[channels[j]] += sigma[j] * A[i, first + j]
        for j in range(i + 1):
            if _BIAS <= j < _P:
                continue
            total = 0.5 * Q_d[i, j]
            if j >= _P:
                total += A[i, j]
            for k in range(_BIAS):
                total += A[i, k] * Phi[j, k]
            for k in range(6):
                total += row[k] * Phi[j, _BIAS + k]
            _set_symmetric(P, i, j, total)


@kernel
def _set_symmetric(P: Array, i: int, j: int, value: float) -> None:
    P[i, j] = value
    P[j, i] = value
