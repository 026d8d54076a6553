"""Process noise that the IMU itself shows, beyond what the filter is told.

Neighbouring samples of white noise differ by twice its variance (channels.py). Where that is more
than the filter is told, its P is too small, and a right measurement would look like a fault. The
verdict on a measurement therefore takes the covariance of the error that the untold noise makes,
with the gains that the filter really has. P itself stays as the filter is told.

It is that of velocity, attitude and biases in the filter's coordinates, and of the position in
metres. Of a measurement that tells a position, such as a depth, the gain of the position counts;
what it does to the others is left out. In the filter's coordinates a position is the difference of
numbers that grow with the way travelled, and what corrections change of these would count.

Derivation: docs/explanation/filter.md.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.algebra import tells
from insdvl.navigation.channels import FEWEST_CHANGES
from insdvl.navigation.error_state import ATTITUDE, POSITION
from insdvl.navigation.geometry.earth import displacement, gravity
from insdvl.navigation.geometry.rotation import cross_matrix, product, skew
from insdvl.navigation.measurements.base import Vehicle
from insdvl.navigation.process_noise.between_pings import (
    add_noise,
    add_noise_of_position,
    set_transition,
    set_transition_of_position,
)
from insdvl.navigation.state.fields import NEVER, State
from insdvl.navigation.state.scratch import Constants

#: The mean of the last changes is known to 15 %: what is shown counts from so much of the told on.
CLEARLY_MORE = 1.5
_A, _P, _N = ATTITUDE.start, POSITION.start, POSITION.stop


def gravity_matrix(nav: State) -> Array:
    """[g x] (3, 3) at the place of a state: what a turn makes of the acceleration [m/s^2]."""
    lat, _, h = nav["llh"]
    return cross_matrix(np.array([0.0, 0.0, gravity(lat, h)]))


@kernel
def _untold_density(
    S: Array, C_n_b: Array, C_b_i: Array, Q: Array, change: Array, density: float, rate: float
) -> bool:
    """Density (3, 3) of the noise of a triad that is not told, NED; whether there is any.

    Args:
        S: Result.
        C_n_b: (3, 3) attitude.
        C_b_i: (3, 3) rotation from IMU to base_link axes.
        Q: (3, 3) variance per sample that is told, base_link axes.
        change: (3,) mean square of the change between neighbours, IMU axes.
        density: Density per variance that is told [s].
        rate: Of the IMU [Hz].
    """
    C_n_i, any_untold = np.empty((3, 3)), False
    product(C_n_i, C_n_b, C_b_i)
    S[:] = 0.0
    for k in range(3):
        told = 0.0
        for a in range(3):
            for b in range(3):
                told += C_b_i[a, k] * Q[a, b] * C_b_i[b, k]
        told *= density
        shown = change[k] / (2.0 * rate)
        if shown > CLEARLY_MORE * told:
            any_untold = True
            for i in range(3):
                for j in range(3):
                    S[i, j] += C_n_i[i, k] * (shown - told) * C_n_i[j, k]
    return any_untold


@kernel
def has_excess(excess: Array) -> bool:
    """Whether there is any untold noise in ``noise.excess`` (15, 15)."""
    count = 0
    for i in range(_N):
        count += excess[i, i] != 0.0
    return count > 0


@kernel
def _transform(E: Array, B: Array) -> None:
    """E <- B E B^T, in place, for (15, 15)."""
    A = np.empty((_N, _N))
    for i in range(_N):
        for j in range(_N):
            total = 0.0
            for k in range(_N):
                total += B[i, k] * E[k, j]
            A[i, j] = total
    for i in range(_N):
        for j in range(i + 1):
            total = 0.0
            for k in range(_N):
                total += A[i, k] * B[j, k]
            E[i, j] = E[j, i] = total


@kernel
def advance(s: State, c: Constants, stamp_ns: int) -> None:
    """Add to ``noise.excess`` what the untold noise has made since it was last advanced."""
    noise, nav, channels, since_ns = s.noise, s.nav, s.channels, s.noise.excess_ns
    noise.excess_ns = stamp_ns
    if since_ns == NEVER or stamp_ns <= since_ns:
        return
    S_f, S_w, any_untold = np.zeros((3, 3)), np.zeros((3, 3)), False
    if channels.changes >= FEWEST_CHANGES:
        C, C_b_i, change = nav.C_n_b, c.C_b_i, channels.change
        of_f = _untold_density(S_f, C, C_b_i, noise.Q_f, change[:3], c.density, c.rate)
        of_w = _untold_density(S_w, C, C_b_i, noise.Q_w, change[3:], c.density, c.rate)
        any_untold = of_f or of_w
    if not (any_untold or has_excess(noise.excess)):
        return
    t = (stamp_ns - since_ns) * 1e-9
    g_n, g_x, v_x = np.zeros(3), np.empty((3, 3)), np.zeros((3, 3))
    g_n[2] = gravity(nav.llh[0], nav.llh[2])
    skew(g_x, g_n)
    if c.invariant:
        skew(v_x, nav.v_n)
    Phi = np.eye(_N)
    set_transition(Phi, nav.C_n_b, v_x, g_x, t)
    set_transition_of_position(Phi, nav.C_n_b, v_x, g_x, t)
    _transform(noise.excess, Phi)
    add_noise(noise.excess, S_f, S_w, v_x, g_x, t)
    add_noise_of_position(noise.excess, S_f, S_w, v_x, g_x, t)


@kernel
def corrected(s: State, c: Constants, K: Array, H: Array) -> None:
    """A measurement has corrected the state with the gain K (n, m) and the Jacobian H (m, n)."""
    if not has_excess(s.noise.excess):
        return
    B, gains = np.eye(_N), _in_metres(s, c, K)
    of_position = tells(H, _P, _N)
    for i in range(_P if of_position else 0, _N):
        for j in range(_P if of_position else 0, _N):
            for a in range(H.shape[0]):
                B[i, j] -= gains[i, a] * H[a, j]
    _transform(s.noise.excess, B)


@kernel
def _in_metres(s: State, c: Constants, K: Array) -> Array:
    """The gain (15, m) with that of the position in metres, dp = dp_model - [x x] psi."""
    gains, x_n, x_x = K[:_N].copy(), np.empty(3), np.empty((3, 3))
    if c.invariant:
        displacement(x_n, s.nav.llh_r, s.nav.llh)
        skew(x_x, x_n)
        for i in range(3):
            for a in range(K.shape[1]):
                for j in range(3):
                    gains[_P + i, a] -= x_x[i, j] * K[_A + j, a]
    return gains


@kernel
def with_excess(P: Array, excess: Array, H: Array) -> Array:
    """P (n, n) with the covariance of the untold noise, as a measurement sees it.

    One that tells a position sees that of the position alone: the rest of its Jacobian H (m, n)
    takes the filter's coordinates to metres.
    """
    n = H.shape[1]
    of_both = P[:n, :n].copy()
    first, last = (_P, _N) if tells(H, _P, _N) else (0, _P)
    for i in range(first, last):
        for j in range(first, last):
            of_both[i, j] += excess[i, j]
    return of_both


def covariance(s: State, H: Array) -> Array:
    """Covariance (n, n) of the error state, with that of the untold noise, see `with_excess`."""
    return with_excess(s["nav"]["P"], s["noise"]["excess"], H)


def drift(s: State, vehicle: Vehicle, seconds: float) -> Array:
    """Covariance (3, 3) of what the untold noise adds to a drift of the velocity, NED."""
    c, noise, channels = vehicle.constants[0], s["noise"], s["channels"]
    S_f, S_w = np.empty((3, 3)), np.empty((3, 3))
    change = channels["change"] if channels["changes"] >= FEWEST_CHANGES else np.zeros(6)
    of, at = (s["nav"]["C_n_b"], c["C_b_i"]), (c["density"], c["rate"])
    _untold_density(S_f, *of, noise["Q_f"], change[:3], *at)
    _untold_density(S_w, *of, noise["Q_w"], change[3:], *at)
    g_x = gravity_matrix(s["nav"])
    tilt = noise["excess"][ATTITUDE, ATTITUDE] * seconds**2 + S_w * seconds**3 / 3.0
    return np.asarray(S_f * seconds + g_x @ tilt @ g_x.T)


def restart(s: State) -> None:
    """The state is a new one."""
    s["noise"]["excess"], s["noise"]["excess_ns"] = 0.0, s["nav"]["time_ns"]
