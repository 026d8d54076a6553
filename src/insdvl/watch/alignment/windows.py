"""A window of motion: the IMU integrated from ping to ping, and what errors of it would change.

All vectors are in body axes; R turns them to the axes at the window's start.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.kernels import kernel
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.rotation import copy_matrix, exponential, product, rotate, skew

#: Columns of what `_integrate` gives at each ping, see `Window`.
_R, _F, _PHI, _PSI, _XI, _OMEGA = (
    slice(a, b) for a, b in zip((0, 9, 12, 21, 30, 33), (9, 12, 21, 30, 33, 36), strict=True)
)
_COLUMNS = 36

SLOW = range(3, 7)  # degrees of the polynomials that hold the slow part of a residual


@kernel
def _integrate(t: Array, f: Array, w: Array, pings: Array, state: Array, out: Array) -> None:
    """Integrate the IMU from the window's start, and keep the state at each ping.

    Args:
        t: (N,) ends of the samples' intervals from the start of the window [s], rising; the first
            begins at 0.
        f: (N, 3) specific force [m/s^2].
        w: (N, 3) angular rate [rad/s].
        pings: (K,) times of the pings [s], rising, none after the last sample.
        state: (36,) at the start; advanced.
        out: (K, 36) state at each ping.
    """
    turn, mean_turn, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    force_x, change = np.empty((3, 3)), np.empty((3, 3))
    force, f_start, w_start = np.empty(3), np.empty(3), np.empty(3)
    R, F = state[0:9].reshape(3, 3), state[9:12]
    Phi, Psi = state[12:21].reshape(3, 3), state[21:30].reshape(3, 3)
    xi, omega = state[30:33], state[33:36]
    now, k = 0.0, 0
    for i in range(t.size):
        while now < t[i] or (k < pings.size and pings[k] <= t[i]):
            to = t[i]
            if k < pings.size and pings[k] < to:
                to = pings[k]
            dt = to - now
            exponential(turn, mean_turn, w[i, 0] * dt, w[i, 1] * dt, w[i, 2] * dt)
            rotate(f_start, mean_turn, f[i])
            rotate(force, R, f_start)
            rotate(w_start, R, w[i])  # a turn leaves its own axis
            product(turned, R, mean_turn)
            skew(force_x, force)
            for a in range(3):
                F[a] += force[a] * dt
                for b in range(3):
                    change[a, b] = Phi[a, b] + 0.5 * dt * turned[a, b]
                    Phi[a, b] += dt * turned[a, b]
            for a in range(3):
                for b in range(3):
                    Psi[a, b] -= dt * (
                        force_x[a, 0] * change[0, b]
                        + force_x[a, 1] * change[1, b]
                        + force_x[a, 2] * change[2, b]
                    )
                    omega[a] -= dt * force_x[a, b] * (xi[b] + 0.5 * dt * w_start[b])
            for a in range(3):
                xi[a] += dt * w_start[a]
            product(turned, R, turn)
            copy_matrix(R, turned)
            now = to
            if k < pings.size and pings[k] <= now:
                out[k] = state
                k += 1


@dataclass(frozen=True)
class Window:
    """K pings and the IMU between them.

    Attributes:
        t: (K,) time from the window's start [s].
        v_d: (K, 3) DVL readings, in DVL axes.
        R: (K, 3, 3) to the axes of the start.
        F: (K, 3) integral of R f [m/s].
        Phi: (K, 3, 3) integral of R: turn by a gyroscope bias, velocity by an accelerometer bias.
        Psi: (K, 3, 3) - integral of [R f x] Phi: change of F by a gyroscope bias.
        xi: (K, 3) integral of R w: turn by a scale error of the gyroscope.
        Xi: (K, 3) - integral of [R f x] xi: change of F by it.
        w: (K, 3) angular rate around the ping [rad/s].
        f: (K, 3) specific force around it [m/s^2].
    """

    t: Array
    v_d: Array
    R: Array
    F: Array
    Phi: Array
    Psi: Array
    xi: Array
    Xi: Array
    w: Array
    f: Array


def integrated(
    stamps: Stamps, f: Array, w: Array, pings: Stamps, v_d: Array, average: float
) -> Window:
    """The window from the first ping to the last.

    Args:
        stamps: (N,) of the samples, rising; the first interval contains the first ping, and the
            last sample is not before the last ping [ns].
        f: (N, 3) specific force in body axes [m/s^2].
        w: (N, 3) angular rate in body axes [rad/s].
        pings: (K,) stamps, rising [ns].
        v_d: (K, 3) DVL readings, in DVL axes.
        average: Time over which rate and force around a ping are averaged [s].
    """
    t, at = (stamps - pings[0]) / NS, (pings - pings[0]) / NS
    state, out = np.zeros(_COLUMNS), np.empty((len(pings), _COLUMNS))
    state[_R] = np.eye(3).ravel()
    _integrate(t, f, w, at, state, out)
    # Copies, since kernels are compiled for contiguous arrays.
    R, F, Phi, Psi, xi, Xi = (out[:, part].copy() for part in (_R, _F, _PHI, _PSI, _XI, _OMEGA))
    return Window(
        t=at,
        v_d=v_d,
        R=R.reshape(-1, 3, 3),
        F=F,
        Phi=Phi.reshape(-1, 3, 3),
        Psi=Psi.reshape(-1, 3, 3),
        xi=xi,
        Xi=Xi,
        w=_means(t, w, at, average),
        f=_means(t, f, at, average),
    )


def _means(t: Array, values: Array, at: Array, length: float) -> Array:
    """Means (K, 3) of samples (N, 3) over intervals around the times `at`, within the samples."""
    begin = np.clip(at - length / 2.0, 0.0, max(t[-1] - length, 0.0))
    end = np.maximum(np.minimum(begin + length, t[-1]), begin + 1e-9)
    knots, dt = np.append(0.0, t), np.diff(t, prepend=0.0)
    total = np.vstack([np.zeros(3), np.cumsum(values * dt[:, None], axis=0)])
    change = [np.interp(end, knots, c) - np.interp(begin, knots, c) for c in total.T]
    return np.stack(change, axis=1) / (end - begin)[:, None]


def joined(windows: Sequence[Window]) -> Window:
    """The pings of many windows, one after the other."""
    names = [field.name for field in fields(Window)]
    return Window(**{n: np.concatenate([getattr(w, n) for w in windows]) for n in names})


@dataclass(frozen=True)
class Bases:
    """Orthonormal polynomials of a window's times.

    Attributes:
        parabola: (K, 3) degrees 0 to 2.
        slow: (K, 4) degrees 3 to 6.
    """

    parabola: Array
    slow: Array

    @classmethod
    def of(cls, t: Array) -> "Bases":
        """The bases of times (K,), K at least 8."""
        x = 2.0 * t / t[-1] - 1.0
        q, _ = np.linalg.qr(np.polynomial.legendre.legvander(x, SLOW[-1]))
        return cls(q[:, : SLOW[0]], q[:, SLOW[0] :])

    def of_noise(self, t: Array) -> tuple[Array, Array]:
        """Variances (5,) of a random walk and of its integral, both of density one.

        They are those in each slow degree, and in the others on average.
        """
        a, b = np.minimum(t, t[:, None]), np.maximum(t, t[:, None])
        walk, integral = a, a**2 * (3.0 * b - a) / 6.0
        return self._powers(walk), self._powers(integral)

    def of_lasting(self, t: Array, time_constant: float) -> Array:
        """Variances (4,) in each slow degree of an error of variance one that lasts.

        Args:
            t: (K,) times [s].
            time_constant: Of a first-order Gauss-Markov process [s].
        """
        return self._powers(np.exp(-np.abs(t - t[:, None]) / time_constant))[:-1]

    def _powers(self, covariance: Array) -> Array:
        """Variances (5,) of a noise (K,) with a covariance (K, K)."""
        slow = np.einsum("kd,kl,ld->d", self.slow, covariance, self.slow)
        parabola = np.einsum("kd,kl,ld->", self.parabola, covariance, self.parabola)
        rest = np.trace(covariance) - parabola - slow.sum()
        return np.append(slow, rest / max(len(covariance) - len(slow) - SLOW[0], 1))


@dataclass(frozen=True)
class Noise:
    """Noise of the residuals of W windows.

    Attributes:
        dof: (W,) number of residuals.
        slow: (W, 4) variance of those of each slow degree.
        rest: (W,) variance of the others.
    """

    dof: Array
    slow: Array
    rest: Array

    @property
    def variance(self) -> Array:
        """(W,) mean variance of a residual."""
        few = 3.0 * len(SLOW)
        return (3.0 * self.slow.sum(axis=1) + (self.dof - few) * self.rest) / self.dof

    @property
    def excess(self) -> float:
        """Number of residuals that count as one, since their noise is not white.

        The number of equal ones would be (sum P)^2 / sum P^2 of the powers P.
        """
        few, dof = 3.0 * len(SLOW), float(self.dof.mean())
        slow = (self.slow / self.variance[:, None]).mean(axis=0)
        rest = float((self.rest / self.variance).mean())
        return max(1.0, (3.0 * float(slow @ slow) + (dof - few) * rest**2) / dof)

    @property
    def weights(self) -> Array:
        """(W,) of the products."""
        return 1.0 / (self.variance * self.excess)

    def at_least(self, imu: Array, share: float, lasting: Array) -> "Noise":
        """With what is in it in any case, whether or not it shows.

        Args:
            imu: (W, 5) variances in the slow degrees and in the others by the noise of the IMU.
            share: Of the IMU's noise that is in the residuals.
            lasting: (W, 4) variances in the slow degrees by errors of a DVL that last.
        """
        rest = self.rest + (1.0 - share**2) * imu[:, -1]
        slow = np.maximum(self.slow, imu[:, :-1] + lasting + rest[:, None])
        return Noise(self.dof, slow, rest)
