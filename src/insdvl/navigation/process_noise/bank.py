"""A bank of small filters that differ in the level of the process noise.

Each has twelve error states, those of the published filter in the invariant coordinates of
error-state.md, and is relative to the filter: its estimate is the difference from the filter's, and
what the filter has beside them, mounts and slow errors of the sensor, is noise of the ping.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.algebra import gain
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, GYROSCOPE_BIAS
from insdvl.navigation.geometry.rotation import product, product_transposed, skew
from insdvl.navigation.process_noise.between_pings import add_noise, set_transition

#: Velocity [m/s] and attitude [rad], NED, and biases of accelerometers [m/s^2] and gyroscopes
#: [rad/s], base_link axes.
SIZE = 12
#: Elements of a covariance in the state record: its lower triangle, row by row.
PACKED = SIZE * (SIZE + 1) // 2
#: The levels of the factor on Q.
LEVELS = 2.0 ** np.arange(-4.0, 5.0)
#: Spread of the logarithm of the factor before anything is learned: within a factor of two of the
#: told Q in two cases of three.
SPREAD = 0.7
#: Time [s] in which what was learned loses its weight to 1 / e.
MEMORY = 600.0
_PRIOR = -0.5 * (np.log(LEVELS) / SPREAD) ** 2
_STEP = np.log(LEVELS[1] / LEVELS[0])

# First elements of the blocks, for the kernels.
_F, _W = ACCELEROMETER_BIAS.start, GYROSCOPE_BIAS.start


def learned(sums: Array, likelihoods: Array, seconds: float) -> Array:
    """Sums of log likelihoods (L,), the largest 0, after a time [s] and an innovation of (L,)."""
    after = sums * np.exp(-seconds / MEMORY) + likelihoods
    return after - after.max()


def mean_factor(sums: Array) -> float:
    """The factor with the mean standard deviation, by sums of log likelihoods (L,).

    Of a factor that is too small a filter suffers more than of one that is too large, so where many
    are possible it is above the most probable one. The logarithm of the probability is a parabola
    over that of the factor, near its maximum; it is taken through the best level and its
    neighbours, at the ends through the last three. The result is within the levels.
    """
    logarithm = sums + _PRIOR
    best = int(np.argmax(logarithm))
    middle = min(max(best, 1), LEVELS.size - 2)
    below, at, above = logarithm[middle - 1 : middle + 2]
    curvature = below - 2.0 * at + above
    if not curvature < 0.0:
        return float(LEVELS[best])
    steps = 0.5 * (below - above) / curvature - _STEP / curvature / 4.0
    if middle + steps <= 0.0:
        return float(LEVELS[0])
    if middle + steps >= LEVELS.size - 1.0:
        return float(LEVELS[-1])
    return float(LEVELS[middle] * np.exp(_STEP * steps))


@kernel
def advance(
    errors: Array,
    P: Array,
    C_n_b: Array,
    v_n: Array,
    g: float,
    S_f: Array,
    S_w: Array,
    walk_f: float,
    walk_w: float,
    seconds: float,
) -> None:
    """Advance the filters from ping to ping, in place.

    Args:
        errors: (L, 12) estimates relative to the filter's.
        P: (L, 78) covariances, packed.
        C_n_b: (3, 3) attitude.
        v_n: (3,) velocity [m/s].
        g: Gravity [m/s^2].
        S_f: (3, 3) density of the specific force that is told, base_link axes.
        S_w: (3, 3) of the angular rate.
        walk_f: Density of the walk of the accelerometer bias.
        walk_w: Density of the walk of the gyroscope bias.
        seconds: Since the ping before.
    """
    Phi, Q = np.eye(SIZE), np.zeros((SIZE, SIZE))
    v_x, g_x, M = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    of_f, of_w = np.empty((3, 3)), np.empty((3, 3))
    g_x[0, 1], g_x[1, 0] = -g, g
    skew(v_x, v_n)
    set_transition(Phi, C_n_b, v_x, g_x, seconds)
    product(M, C_n_b, S_f)
    product_transposed(of_f, M, C_n_b)
    product(M, C_n_b, S_w)
    product_transposed(of_w, M, C_n_b)
    add_noise(Q, of_f, of_w, v_x, g_x, seconds)
    full = np.empty((SIZE, SIZE))
    for level in range(LEVELS.size):
        unpack(full, P[level])
        _to_next(errors[level], full, Phi)
        for i in range(_F):
            for j in range(_F):
                full[i, j] += LEVELS[level] * Q[i, j]
        for i in range(3):
            full[_F + i, _F + i] += seconds * walk_f
            full[_W + i, _W + i] += seconds * walk_w
        pack(P[level], full)


@kernel
def unpack(full: Array, packed: Array) -> None:
    """full (12, 12) = the covariance whose lower triangle is packed (78,)."""
    k = 0
    for i in range(SIZE):
        for j in range(i + 1):
            full[i, j] = full[j, i] = packed[k]
            k += 1


@kernel
def pack(packed: Array, full: Array) -> None:
    """packed (78,) = the lower triangle of a covariance (12, 12)."""
    k = 0
    for i in range(SIZE):
        for j in range(i + 1):
            packed[k] = full[i, j]
            k += 1


@kernel
def _to_next(error: Array, P: Array, Phi: Array) -> None:
    """error (12,) <- Phi error and P (12, 12) <- Phi P Phi^T, in place.

    Phi is the identity but for the rows of velocity and attitude, which depend on later ones only.
    """
    for i in range(_F):
        for k in range(i + 1, SIZE):
            error[i] += Phi[i, k] * error[k]
            for j in range(SIZE):
                P[i, j] += Phi[i, k] * P[k, j]
    for i in range(_F):
        for k in range(i + 1, SIZE):
            for j in range(SIZE):
                P[j, i] += Phi[i, k] * P[j, k]


@kernel
def correct(
    errors: Array,
    P: Array,
    factor: float,
    H: Array,
    innovation: Array,
    S: Array,
    M: Array,
    likelihoods: Array,
) -> bool:
    """Correct the filters with a ping, in place; False where no covariance of it is usable.

    Args:
        errors: (L, 12) estimates relative to the filter's.
        P: (L, 78) covariances, packed.
        factor: In effect in the filter.
        H: (m, 12) Jacobian of the ping.
        innovation: (m,) of the filter.
        S: (m, m) its covariance.
        M: (m, m) the part of S that is the filter's own error.
        likelihoods: (L,) logarithms; result.
    """
    m, levels = len(innovation), LEVELS.size
    at = np.log(factor / LEVELS[0]) / np.log(LEVELS[1] / LEVELS[0])
    low = min(max(int(at), 0), levels - 2)
    # What the filter has beside the twelve states is noise of the ping, and never less than none.
    full, above, beside = np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE)), np.empty((m, m))
    unpack(full, P[low])
    unpack(above, P[low + 1])
    for i in range(SIZE):
        for j in range(SIZE):
            full[i, j] += (at - low) * (above[i, j] - full[i, j])
    for a in range(m):
        for b in range(m):
            beside[a, b] = M[a, b] - _of_error(full, H, a, b)
    values, axes = np.linalg.eigh(beside)
    R, S_i, K, nu = np.empty((m, m)), np.empty((m, m)), np.empty((SIZE, m)), np.empty(m)
    for a in range(m):
        for b in range(m):
            R[a, b] = S[a, b] - M[a, b]
            for k in range(m):
                R[a, b] += axes[a, k] * max(values[k], 0.0) * axes[b, k]
    for level in range(levels):
        for a in range(m):
            nu[a] = innovation[a]
            for i in range(SIZE):
                nu[a] -= H[a, i] * errors[level, i]
        unpack(full, P[level])
        nis = gain(full, H, R, nu, S_i, K)
        if not np.isfinite(nis):
            return False
        likelihoods[level] = -0.5 * (nis + np.log(np.linalg.det(S_i)))
        for i in range(SIZE):
            for a in range(m):
                errors[level, i] += K[i, a] * nu[a]
            for j in range(i + 1):
                for a in range(m):
                    for b in range(m):
                        full[i, j] -= K[i, a] * S_i[a, b] * K[j, b]
        pack(P[level], full)
    return True


@kernel
def _of_error(P: Array, H: Array, a: int, b: int) -> float:
    """Element of H P H^T."""
    total = 0.0
    for i in range(SIZE):
        for j in range(SIZE):
            total += H[a, i] * P[i, j] * H[b, j]
    return total
