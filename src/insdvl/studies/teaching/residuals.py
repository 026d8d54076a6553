"""A small filter of the DVL's velocities and the IMU's increments between them.

It is the filter of a vehicle with what the likelihood of the pings needs: errors of velocity,
attitude and both biases, in the invariant coordinates of error_state.py, and the slow error of the
DVL. Position, gate and cuts of samples are left out. A step is one second or less, so that a
recording of 400 s takes a few milliseconds, hundreds of times for a fit.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.geometry.rotation import (
    cross,
    exponential,
    product,
    rotate,
    rotate_back,
)
from insdvl.studies.teaching.increments import Increments

SIZE = 15  # velocity, attitude, biases of accelerometers and gyroscopes, slow error of the DVL
_ROWS = 3


@dataclass(frozen=True, eq=False)
class Start:
    """Where a stretch begins, at rest with respect to nothing. IMU axes forward-right-down, NED.

    Attributes:
        C_n_i: (3, 3) attitude.
        v_n: (3,) velocity [m/s].
        variances: (12,) of velocity in body axes, attitude in NED, and what is left of the biases.
        g_n: (3,) gravity [m/s^2].
        w_ie_n: (3,) Earth rate [rad/s].
        radius: Of the Earth [m].
        latitude: [rad].
        walks: (6,) densities of the walks of the biases [(m/s^2)^2/s], [(rad/s)^2/s].
    """

    C_n_i: Array
    v_n: Array
    variances: Array
    g_n: Array
    w_ie_n: Array
    radius: float
    latitude: float
    walks: Array


@dataclass(frozen=True, eq=False)
class Stretch:
    """What a recording without gaps says, before anything is assumed of its noise.

    Attributes:
        start: The state at the begin of the first step.
        steps: The increments of the J steps.
        interval: Median interval between samples of the IMU [s].
        estimate: (J,) index of the features that hold during each step.
        pings: (M,) step that each ping ends.
        velocities: (M, 3) of the pings, at the IMU, in its axes [m/s].
        noise: (M, 3) nominal variances of their components [(m/s)^2].
        slow_std: (3,) nominal sigma of the slow error of the DVL, in its axes [m/s].
        time_constant: Nominal, of that error [s].
        C_d_i: (3, 3) from the axes of the DVL to those of the IMU.
    """

    start: Start
    steps: Increments
    interval: float
    estimate: NDArray[np.int64]
    pings: NDArray[np.int64]
    velocities: Array
    noise: Array
    slow_std: Array
    time_constant: float
    C_d_i: Array


class Innovations(NamedTuple):
    """Innovations (M, 3) of the pings and their covariances (M, 3, 3)."""

    nu: Array
    S: Array


def innovations(
    stretch: Stretch, q: Array, r: float, slow: float, time_constant: float
) -> Innovations:
    """The innovations of the pings.

    Args:
        stretch: Of a recording.
        q: (K, 6) variances per sample of specific force and angular rate, at the features' times.
        r: Factor on the nominal sigma of the pings.
        slow: Factor on the nominal sigma of the slow error; 0 for none.
        time_constant: Factor on its nominal time constant.
    """
    start, steps, count = stretch.start, stretch.steps, len(stretch.pings)
    found = Innovations(np.empty((count, _ROWS)), np.empty((count, _ROWS, _ROWS)))
    of_axes = (slow * stretch.slow_std) ** 2
    covariance = np.ascontiguousarray(stretch.C_d_i * of_axes @ stretch.C_d_i.T)
    P = np.zeros((SIZE, SIZE))
    P[np.arange(12), np.arange(12)] = start.variances
    P[:3, :3] = start.C_n_i @ P[:3, :3] @ start.C_n_i.T
    P[12:, 12:] = covariance
    _filter(
        start.C_n_i.copy(),
        start.v_n.copy(),
        P,
        start.g_n,
        start.w_ie_n,
        start.radius,
        start.latitude,
        start.walks,
        steps.seconds,
        steps.turn,
        steps.dv,
        q[stretch.estimate] * stretch.interval,
        stretch.pings,
        stretch.velocities,
        stretch.noise * r**2,
        covariance,
        time_constant * stretch.time_constant,
        found.nu,
        found.S,
    )
    return found


@kernel
def _filter(
    C: Array,
    v: Array,
    P: Array,
    g_n: Array,
    w_ie_n: Array,
    radius: float,
    latitude: float,
    walks: Array,
    seconds: Array,
    turn: Array,
    dv: Array,
    density: Array,
    pings: NDArray[np.int64],
    velocities: Array,
    noise: Array,
    slow: Array,
    time_constant: float,
    nu: Array,
    S: Array,
) -> None:
    """See `innovations`; C, v and P are used up.

    ``density`` (J, 6) is that of the white noise, ``slow`` (3, 3) the covariance of the slow error.
    """
    n = SIZE
    b_f, b_w, b_d = np.zeros(3), np.zeros(3), np.zeros(3)
    R, mean, C_mid = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    Phi, Q, dx = np.eye(n), np.empty((n, n)), np.empty(n)
    PHt, covariance, K, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty((n, 3)), np.empty(3)
    w_in, a, b, c = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    u, m, new_v = np.zeros(3), np.zeros(3), np.zeros(3)
    turned = np.empty((3, 3))
    ping = 0
    for j in range(seconds.size):
        t = seconds[j]
        w_in[0] = w_ie_n[0] + v[1] / radius
        w_in[1] = w_ie_n[1] - v[0] / radius
        w_in[2] = w_ie_n[2] - v[1] * np.tan(latitude) / radius
        # The turn of a step is small: half of its rotation vector from its skew part.
        x = 0.25 * (turn[j, 2, 1] - turn[j, 1, 2])
        y = 0.25 * (turn[j, 0, 2] - turn[j, 2, 0])
        z = 0.25 * (turn[j, 1, 0] - turn[j, 0, 1])
        exponential(R, mean, x, y, z)
        product(C_mid, C, R)
        # The bias turns the integrated force by half of what it turns the end of the step.
        exponential(R, mean, -0.5 * t * b_w[0], -0.5 * t * b_w[1], -0.5 * t * b_w[2])
        rotate(u, R, dv[j])
        rotate(a, C, u)
        rotate(u, C_mid, b_f)
        for i in range(3):
            a[i] -= t * u[i]
            c[i] = w_in[i] + w_ie_n[i]
        cross(b, w_in, a)
        cross(m, c, v)
        for i in range(3):
            new_v[i] = v[i] + a[i] - 0.5 * t * b[i] + t * (g_n[i] - m[i])
        exponential(R, mean, -t * b_w[0], -t * b_w[1], -t * b_w[2])
        product(mean, turn[j], R)
        product(R, C, mean)
        exponential(turned, mean, -t * w_in[0], -t * w_in[1], -t * w_in[2])
        product(C, turned, R)

        Q[:] = 0.0
        decay = np.exp(-t / time_constant)
        for i in range(3):
            Phi[12 + i, 12 + i] = decay
            b_d[i] *= decay
            for k in range(3):
                Q[12 + i, 12 + k] = slow[i, k] * (1.0 - decay * decay)
            Q[6 + i, 6 + i], Q[9 + i, 9 + i] = walks[i] * t, walks[3 + i] * t
            c[:] = C_mid[:, i]
            cross(u, v, c)
            cross(m, g_n, c)
            q_f, q_w = density[j, i], density[j, 3 + i]
            for k in range(3):
                Phi[k, 6 + i] = -t * c[k]
                Phi[k, 9 + i] = -t * u[k] - 0.5 * t * t * m[k]
                Phi[3 + k, 9 + i] = -t * c[k]
                for o in range(3):
                    Q[k, o] += q_f * t * c[k] * c[o] + q_w * (
                        t * u[k] * u[o]
                        + 0.5 * t * t * (u[k] * m[o] + m[k] * u[o])
                        + t * t * t / 3.0 * m[k] * m[o]
                    )
                    Q[3 + k, 3 + o] += q_w * t * c[k] * c[o]
                    cross_term = q_w * (t * u[k] * c[o] + 0.5 * t * t * m[k] * c[o])
                    Q[k, 3 + o] += cross_term
                    Q[3 + o, k] += cross_term
        Phi[0, 4], Phi[0, 5] = -t * g_n[2], t * g_n[1]
        Phi[1, 3], Phi[1, 5] = t * g_n[2], -t * g_n[0]
        Phi[2, 3], Phi[2, 4] = -t * g_n[1], t * g_n[0]
        # The turn of the axes makes a tilt of an error of the heading.
        Phi[3, 4], Phi[3, 5] = t * w_in[2], -t * w_in[1]
        Phi[4, 3], Phi[4, 5] = -t * w_in[2], t * w_in[0]
        Phi[5, 3], Phi[5, 4] = t * w_in[1], -t * w_in[0]
        _spread(P, Phi, Q)
        v[:] = new_v
        while ping < pings.size and pings[ping] == j:
            rotate_back(a, C, v)
            for i in range(3):
                residual[i] = velocities[ping, i] - a[i] - b_d[i]
            _gain(P, C, noise[ping], PHt, covariance, K)
            nu[ping], S[ping] = residual, covariance
            for i in range(n):
                dx[i] = 0.0
                for k in range(3):
                    dx[i] += K[i, k] * residual[k]
            for i in range(n):
                for o in range(i, n):
                    for k in range(3):
                        P[i, o] -= K[i, k] * PHt[o, k]
                    P[o, i] = P[i, o]
            exponential(R, mean, dx[3], dx[4], dx[5])
            product(C_mid, R, C)
            C[:] = C_mid
            rotate(a, R, v)
            for i in range(3):
                v[i] = a[i] + dx[i]
                b_f[i] += dx[6 + i]
                b_w[i] += dx[9 + i]
                b_d[i] += dx[12 + i]
            ping += 1


@kernel
def _gain(P: Array, C: Array, noise: Array, PHt: Array, covariance: Array, K: Array) -> None:
    """P H^T, S and the gain, with H = [C^T, 0, 0, 0, I]."""
    for i in range(SIZE):
        for k in range(3):
            PHt[i, k] = P[i, 12 + k]
            for o in range(3):
                PHt[i, k] += P[i, o] * C[o, k]
    for i in range(3):
        for k in range(3):
            covariance[i, k] = PHt[12 + i, k]
            for o in range(3):
                covariance[i, k] += C[o, i] * PHt[o, k]
        covariance[i, i] += noise[i]
    inverse = np.linalg.inv(covariance)
    for i in range(SIZE):
        for k in range(3):
            K[i, k] = 0.0
            for o in range(3):
                K[i, k] += PHt[i, o] * inverse[o, k]


@kernel
def _spread(P: Array, Phi: Array, Q: Array) -> None:
    """P = Phi P Phi^T + Q in place; Phi is the identity but for its first six rows and a decay.

    The attitude is turned row by row: what that changes is of the second order of the turn.
    """
    for side in range(2):
        for i in range(6):  # the rows below are still old
            for k in range(3, 12):
                f = Phi[i, k]
                if f != 0.0 and k != i:
                    for o in range(SIZE):
                        if side == 0:
                            P[i, o] += f * P[k, o]
                        else:
                            P[o, i] += f * P[o, k]
        for i in range(12, SIZE):
            for o in range(SIZE):
                if side == 0:
                    P[i, o] *= Phi[i, i]
                else:
                    P[o, i] *= Phi[i, i]
    P += Q
