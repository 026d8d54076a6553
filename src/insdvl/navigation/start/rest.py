"""Whether the IMU shows a vehicle at rest, and what a rest tells of the gyroscope's bias.

At rest the samples are white noise of the variance that the filter is told, about a specific force
of the size of gravity and a rate that is the Earth's and the gyroscope's bias. A steady cruise
looks the same. A Q that is received tells no variance of samples: they show it themselves.
Derivation: docs/explanation/start.md.
"""

from dataclasses import dataclass, replace

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.navigation.geometry.earth import EARTH_RATE, earth_rate_n
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.start.gyrocompass import Noise
from insdvl.navigation.state.fields import State

#: Probability that a vehicle at rest is taken for a moving one, by each of the four tests.
FALSE_ALARM = 1e-3
#: One sigma of a steady motion that none of the tests shows: acceleration [m/s^2], rate [rad/s].
UNSEEN_ACCELERATION, UNSEEN_RATE = 0.05, 2e-4
_TRIADS = slice(0, 3), slice(3, 6)
#: Least number of samples in each half of a window.
LEAST_SAMPLES = 5


@dataclass(frozen=True)
class Window:
    """Sums over the samples of a time, specific force [m/s^2] then angular rate [rad/s].

    Attributes:
        counts: Numbers of samples in the earlier and the later half.
        sums: (2, 6) of the two halves.
        products: (6, 6) sum of x x^T over both.
    """

    counts: tuple[int, int]
    sums: Array
    products: Array

    @property
    def count(self) -> int:
        """Number of samples."""
        return sum(self.counts)

    @property
    def mean(self) -> Array:
        """(6,) of all samples."""
        return np.asarray(self.sums.sum(axis=0) / self.count)


def window_of(samples: Array) -> Window:
    """The window of samples (N, 6)."""
    half = len(samples) // 2
    sums = np.array([samples[:half].sum(axis=0), samples[half:].sum(axis=0)])
    return Window((half, len(samples) - half), sums, samples.T @ samples)


def window_of_block(s: State) -> Window:
    """The window of the block that is complete."""
    start = s["start"]
    total = np.concatenate([start["level_f"], start["level_w"]])
    early = int(start["level_half_count"])
    sums = np.array([start["level_half"], total - start["level_half"]])
    return Window((early, int(start["level_count"]) - early), sums, start["level_products"].copy())


def noise_at_rest(window: Window, told: Noise) -> Noise:
    """The noise of the samples of a window, if they are of a vehicle at rest.

    It is as told, or where that is not of samples at least as large as they spread.
    """
    if told.of_samples:
        return told
    f, w = (
        R * max(1.0, of) for R, of in zip((told.f, told.w), _spreads(window, told), strict=True)
    )
    return replace(told, f=f, w=w, of_samples=True)


def _spreads(window: Window, noise: Noise) -> list[float]:
    """Variance of the samples of each triad about their mean, in units of that of the noise."""
    n, mean = window.count, window.mean
    S = window.products - n * np.outer(mean, mean)
    R, freedom = noise.of_mean(1.0, 0.0), 3 * max(n - 1, 1)
    # The two triads are independent in R.
    return [float(np.trace(np.linalg.solve(R[at, at], S[at, at]))) / freedom for at in _TRIADS]


@dataclass(frozen=True)
class Misfit:
    """How many times larger than chance the misfits to a vehicle at rest are; at most 1 at rest.

    Attributes:
        spread: Of the samples about their mean: larger than 1 where the vehicle vibrates more than
            the told noise says.
        motion: The worst of three that show a motion, beside such a vibration.
    """

    spread: float
    motion: float

    @property
    def worst(self) -> float:
        """Of both."""
        return max(self.spread, self.motion)


def misfit_to_rest(window: Window, bias: Array, noise: Noise, g: float) -> Misfit:
    """Four chi-square tests of a window of samples.

    The spread of the samples; the step between the halves of the window, the mean rate, and the
    size of the mean specific force. For the last three the noise of each triad is as large as its
    samples spread, at least as told.

    Args:
        window: The samples.
        bias: (6,) of the accelerometers [m/s^2] and the gyroscopes [rad/s].
        noise: Of the IMU, and the sigmas of these biases.
        g: Gravity [m/s^2].
    """
    if min(window.counts) < LEAST_SAMPLES:
        return Misfit(np.inf, np.inf)
    noise = noise_at_rest(window, noise)
    n, mean = window.count, window.mean
    early, late = window.counts
    R, spreads = noise.of_mean(1.0, 0.0), _spreads(window, noise)
    for at, spread in zip(_TRIADS, spreads, strict=True):
        R[at, at] *= max(1.0, spread)
    step = window.sums[1] / late - window.sums[0] / early
    of_mean = R / n + noise.of_biases()
    rate = mean[3:] - bias[3:]
    of_rate = of_mean[3:, 3:] + np.eye(3) * EARTH_RATE**2
    force = mean[:3] - bias[:3]
    size = float(np.hypot.reduce(force))  # cannot overflow
    along = force / size if size else np.zeros(3)
    of_size = float(along @ of_mean[:3, :3] @ along)
    motions = (
        _square(step, R * (1.0 / early + 1.0 / late)) / exceeded(6, FALSE_ALARM),
        _square(rate, of_rate) / exceeded(3, FALSE_ALARM),
        (size - g) ** 2 / of_size / exceeded(1, FALSE_ALARM) if of_size else np.inf,
    )
    spread = 3 * (n - 1) * sum(spreads) / exceeded(6 * (n - 1), FALSE_ALARM)
    return Misfit(spread, max(motions))


def _square(x: Array, P: Array) -> float:
    return float(x @ np.linalg.solve(P, x))


@dataclass(frozen=True)
class Attitude:
    """Attitude and biases that a start has found.

    Attributes:
        C_n_b: (3, 3) attitude.
        b_w: (3,) gyroscope bias [rad/s].
        P: (9, 9) covariance of the errors of attitude, accelerometer and gyroscope bias.
    """

    C_n_b: Array
    b_w: Array
    P: Array

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return all(bool(np.isfinite(x).all()) for x in (self.C_n_b, self.b_w, self.P))


def with_gyroscope_bias(
    found: Attitude, w_ib_b: Array, count: float, noise: Noise, lat: float
) -> Attitude:
    """What the mean rate of a rest tells of the gyroscope's bias, one linear update.

        w = C^T w_ie + b_w + n,  H = [ C^T [w_ie x] | 0 | I ]

    With an unknown heading the horizontal part of the Earth's rate is noise.

    Args:
        found: Attitude, and the bias as it was told.
        w_ib_b: (3,) mean rate [rad/s], with its bias.
        count: Samples in the mean.
        noise: Of the IMU.
        lat: Latitude [rad].
    """
    C, w_ie_n = found.C_n_b, np.empty(3)
    earth_rate_n(lat, w_ie_n)
    R = noise.w / count + np.eye(3) * UNSEEN_RATE**2
    if found.P[2, 2] > 1.0:  # beyond the line that H is
        R += C.T @ np.diag([w_ie_n[0] ** 2 / 2.0] * 2 + [0.0]) @ C
        w_ie_n[0] = 0.0
    H = np.hstack([C.T @ cross_matrix(w_ie_n), np.zeros((3, 3)), np.eye(3)])
    K = np.linalg.solve(H @ found.P @ H.T + R, H @ found.P).T
    K[:6] = 0.0  # the bias only: attitude and accelerometers are told better by what they are from
    nu = w_ib_b - C.T @ w_ie_n - found.b_w
    A = np.eye(9) - K @ H
    P = A @ found.P @ A.T + K @ R @ K.T
    return replace(found, b_w=found.b_w + K[6:] @ nu, P=(P + P.T) / 2.0)
