"""How a measurement of m rows corrects a state; the matrices are in algebra.py.

What a measurement is, where it comes from and whether it is believed is decided elsewhere
(measurements/, gate/); here are only the equations, the same for every sensor.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records, copied, copy_records
from insdvl.kernels import kernel
from insdvl.navigation import coordinates
from insdvl.navigation.algebra import gain, is_measured, joseph, remainder, rows_of, tells
from insdvl.navigation.error_state import ATTITUDE, POSITION, VELOCITY
from insdvl.navigation.geometry.rotation import (
    copy_matrix,
    exponential,
    product,
    product_transposed,
    rotate,
)
from insdvl.navigation.measurements.base import Linearised

#: An update is iterated where h bends by the mean sigma of R, and by a part from half of it on.
_BEND = 1.0  # (sigma)^2
#: The iteration ends where what is left of that is negligible, in (sigma)^2, but not never.
_SETTLED = 1e-6
_STEPS = 10
#: The product of tilt and velocity error counts from this part of R on.
_PRODUCT = 1e-3
# First elements of blocks, for the kernel.
_V, _A, _DOWN = VELOCITY.start, ATTITUDE.start, 2


class Innovated(NamedTuple):
    """A measurement against the filter's prediction of it.

    Attributes:
        innovation: (m,) measured minus predicted.
        H: (m, n) Jacobian of the prediction.
        R: (m, m) covariance of the measurement noise.
        S: (m, m) covariance of the innovation, H P H^T + R.
        K: (n, m) gain P H^T S^-1.
        nis: Normalised innovation squared, nu^T S^-1 nu; nan where S is not positive definite.
        rows: Number of components that were measured: the degrees of freedom of the NIS.
    """

    innovation: Array
    H: Array
    R: Array
    S: Array
    K: Array
    nis: float
    rows: int

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(m,) which components were measured; those that were not have a row of zeros in H."""
        return np.asarray(self.H.any(axis=1))


def innovate(P: Array, z_minus_h: Array, H: Array, R: Array) -> Innovated:
    """Compare a measurement with its prediction.

    Args:
        P: (N, N) covariance of the error state, of which the first n are in use.
        z_minus_h: (m,) innovation.
        H: (m, n) Jacobian.
        R: (m, m) covariance of the measurement noise.
    """
    m, n = H.shape
    S, K = np.empty((m, m)), np.empty((n, m))
    nis = gain(P, H, R, z_minus_h, S, K)
    return Innovated(z_minus_h, H, R, S, K, nis, rows_of(H))


@kernel
def _inject(state: Records, constants: Records, dx: Array) -> None:
    coordinates.inject(state[0], constants[0], dx)


@kernel
def _correct(
    state: Records,
    constants: Records,
    H: Array,
    K: Array,
    R: Array,
    innovation: Array,
    mean: Array,
    primed: bool,
    workspace: Records,
) -> None:
    """Joseph form, then the injection of K nu.

    With ``primed`` the velocity error of P, H and K is dv' of `correct_body_velocity`, and
    ``mean`` that of t x dv.
    """
    n, m = K.shape
    dx = np.empty(n)
    for i in range(n):
        total = 0.0
        for a in range(m):
            total += K[i, a] * innovation[a]
        dx[i] = total
    P = state[0].nav.P
    joseph(P, P, remainder(K, H), K, R, workspace)
    if primed:
        turn, scratch, dv = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
        exponential(turn, scratch, dx[_A], dx[_A + 1], 0.0)
        for i in range(3):
            dv[i] = dx[_V + i] - mean[i]
        rotate(dx[_V : _V + 3], turn, dv)
        coordinates.turn_block(P, _V, turn, n)
    _inject(state, constants, dx)


@kernel
def correct_linearly(
    state: Records,
    constants: Records,
    H: Array,
    K: Array,
    R: Array,
    innovation: Array,
    workspace: Records,
) -> None:
    """Joseph form, then the injection of K nu; arguments as of `correct_body_velocity`."""
    _correct(state, constants, H, K, R, innovation, np.zeros(3), False, workspace)


@dataclass(frozen=True)
class _Step:
    """A correction of the prior.

    Attributes:
        dx: (n,) error of the prior state that it removes.
        P: (n, n) covariance behind it, with h as it is there.
        K: (n, m) gain.
        left: (m,) innovation that is left.
        bend: Square of what is left beside what a linear h leaves, in mean variances of R.
    """

    dx: Array
    P: Array
    K: Array
    left: Array
    bend: float


class _Iteration:
    """Gauss-Newton steps of one update with a position, all from the same prior.

    Args:
        state: (1,) record, at the prior; each step leaves it corrected, but for P.
        constants: (1,) of the filter.
        prior: The measurement at the predicted state.
        relinearise: Linearises the measurement again at the state as it is then.
        workspace: (1,) of the filter.
    """

    def __init__(
        self,
        state: Records,
        constants: Records,
        prior: Innovated,
        relinearise: Callable[[], Linearised],
        workspace: Records,
    ) -> None:
        self._state, self._constants, self._relinearise = state, constants, relinearise
        self._workspace = workspace
        self._before, self._next = copied(state), prior

    def go_back(self) -> None:
        """The state is the prior again."""
        copy_records(self._state, self._before)

    @property
    def can_go_on(self) -> bool:
        """Whether S of the next step is positive definite, and its innovation finite."""
        return bool(np.isfinite(self._next.nis))

    def step(self) -> _Step:
        """The next correction."""
        now, state = self._next, self._state
        R, P_0 = now.R, self._before["nav"]["P"][0]
        self.go_back()
        dx = now.K @ now.innovation
        of_now = now.H, now.K, R, now.innovation
        correct_linearly(state, self._constants, *of_now, self._workspace)
        again, T = self._relinearise(), coordinates.remaining(dx)
        bend = again.z_minus_h - (now.innovation - now.H @ dx)
        H = again.H @ T
        self._next = innovate(P_0, again.z_minus_h + H @ dx, H, R)
        there = self._next if self.can_go_on else now
        # Joseph form with T inside, where large numbers cancel before they are squared.
        P = np.empty(T.shape)
        A = T @ remainder(there.K, there.H)
        joseph(P, P_0, A, T @ there.K, R, self._workspace)
        mean_variance = np.trace(R) / len(R)
        return _Step(dx, P, now.K, again.z_minus_h, float(bend @ bend) / mean_variance)


@kernel
def _product_moments(P: Array, mean: Array, covariance: Array) -> None:
    """Mean (3,) and covariance (3, 3) of t x dv, for errors that are normal with P.

    The tilt t has no down component. Of normal a, b, c, d:
    Cov(a b, c d) = Cov(a, c) Cov(b, d) + Cov(a, d) Cov(b, c).
    """
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        mean[i] = 0.0
        if j != _DOWN:
            mean[i] += P[_A + j, _V + k]
        if k != _DOWN:
            mean[i] -= P[_A + k, _V + j]
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            covariance[i, r] = (
                _of_products(P, j, k, s, t)
                - _of_products(P, j, k, t, s)
                - _of_products(P, k, j, s, t)
                + _of_products(P, k, j, t, s)
            )


@kernel
def _of_products(P: Array, j: int, k: int, m: int, n: int) -> float:
    """Covariance of t_j dv_k and t_m dv_n."""
    if j == _DOWN or m == _DOWN:
        return 0.0
    of_equal = P[_A + j, _A + m] * P[_V + k, _V + n]
    return of_equal + P[_A + j, _V + n] * P[_A + m, _V + k]


@kernel
def _product_counts(
    state: Records, H: Array, R: Array, least: float, mean: Array, covariance: Array
) -> bool:
    """Whether t x dv counts from a part of R on; its moments, see `_product_moments`."""
    _product_moments(state[0].nav.P, mean, covariance)
    of_product, of_noise = 0.0, 0.0
    for a in range(H.shape[0]):
        of_noise += R[a, a] if is_measured(H, a) else 0.0
        for i in range(3):
            for j in range(3):
                of_product += H[a, _V + i] * covariance[i, j] * H[a, _V + j]
    return of_product > least * of_noise


@kernel
def _keep_measured(H: Array, mean: Array, covariance: Array) -> None:
    """Leave of the moments of t x dv what is along the components that were measured.

    An update does not correct the others: their error stays dv, and what dv' has beside it would
    add up from measurement to measurement.

    Args:
        H: (m, n) Jacobian; its rows of the velocity are orthonormal, or zero.
        mean: (3,) of t x dv, in place.
        covariance: (3, 3) of t x dv, in place.
    """
    M, A = np.zeros((3, 3)), np.empty((3, 3))
    for a in range(H.shape[0]):
        for i in range(3):
            for j in range(3):
                M[i, j] += H[a, _V + i] * H[a, _V + j]
    product(A, M, covariance)
    product_transposed(covariance, A, M)
    rotate(mean, M, mean.copy())


@kernel
def correct_body_velocity(
    state: Records,
    constants: Records,
    H: Array,
    K: Array,
    R: Array,
    innovation: Array,
    workspace: Records,
) -> None:
    """Correct with a measurement of the body velocity, see `correct`.

    With dv = R_t dv' the measurement tells dv' whatever tilt and heading are, and
    dv' = dv - t x dv to second order: its covariance is that of dv and of the product. Components
    that were not measured are not corrected, and keep dv.

    Args:
        state: (1,) record.
        constants: (1,) of the filter.
        H: (m, n) Jacobian at the prediction.
        K: (n, m) gain there; becomes that of the correction.
        R: (m, m) covariance of the measurement noise.
        innovation: (m,) of the measurement.
        workspace: (1,) of the filter.
    """
    m, P = len(innovation), state[0].nav.P
    mean, covariance, before = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    nu, primed = innovation.copy(), False
    if _product_counts(state, H, R, _PRODUCT, mean, covariance):
        if rows_of(H) < m:
            _keep_measured(H, mean, covariance)
        for i in range(3):
            for j in range(3):
                before[i, j] = P[_V + i, _V + j]
                P[_V + i, _V + j] += covariance[i, j]
        for a in range(m):
            for i in range(3):
                nu[a] += H[a, _V + i] * mean[i]
        gained = np.empty_like(K)
        primed = np.isfinite(gain(P, H, R, nu, np.empty((m, m)), gained))
        if primed:
            copy_matrix(K, gained)
        else:
            for a in range(m):
                nu[a] = innovation[a]
            for i in range(3):
                for j in range(3):
                    P[_V + i, _V + j] = before[i, j]
    _correct(state, constants, H, K, R, nu, mean, primed, workspace)


def correct(
    state: Records,
    constants: Records,
    prior: Innovated,
    relinearise: Callable[[], Linearised],
    workspace: Records,
    *,
    iterate: bool,
) -> tuple[Array, Array]:
    """Correct a state with a measurement, in place.

    After a long outage the correction can be so large that h is not linear over it.

    A body velocity tells R_t^T dv, of which H has dv. So it corrects that product, whose covariance
    is taken to second order: no iteration is needed, and the state is continuous in the
    measurement.

    A measurement of the position tells it in metres, whatever the heading is: its covariance is
    that with H at the corrected state. Where what is left of the innovation is not what a linear h
    leaves, the update is iterated from the same prior with h at the corrected state (Gauss-Newton;
    Bell and Cathey, IEEE Transactions on Automatic Control 38(2), 1993). The iteration fades in, so
    that here, too, the state is continuous.

    Args:
        state: (1,) record.
        constants: (1,) of the filter.
        prior: The measurement at the predicted state.
        relinearise: Linearises the measurement again at the state as it is then.
        workspace: (1,) of the filter.
        iterate: Whether to do so; the published filter corrects once, linearly.

    Returns:
        The gain (n, m) at the prediction, and the innovation (m,) that is left.
    """
    if not iterate:
        of_prior = prior.H, prior.K, prior.R, prior.innovation
        correct_linearly(state, constants, *of_prior, workspace)
        return prior.K, relinearise().z_minus_h
    if not tells(prior.H, POSITION.start, POSITION.stop):
        K = prior.K.copy()
        correct_body_velocity(state, constants, prior.H, K, prior.R, prior.innovation, workspace)
        return K, relinearise().z_minus_h
    n = len(prior.K)
    iteration = _Iteration(state, constants, prior, relinearise, workspace)
    first = best = iteration.step()
    share = 2.0 * math.sqrt(first.bend / _BEND) - 1.0
    if not share > 0.0 or not math.isfinite(share):
        state["nav"]["P"][0][:n, :n] = first.P
        return first.K, first.left
    share, steps = min(share, 1.0), 1
    while steps < _STEPS and best.bend > _SETTLED and iteration.can_go_on:
        now, steps = iteration.step(), steps + 1
        if now.bend < best.bend:  # should the iteration lead away, the best correction stands
            best = now
    iteration.go_back()
    _inject(state, constants, first.dx + share * (best.dx - first.dx))
    state["nav"]["P"][0][:n, :n] = first.P + share * (best.P - first.P)
    return best.K, relinearise().z_minus_h
