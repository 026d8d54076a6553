"""Gyrocompassing: attitude of a vehicle at rest from gravity and the rotation of the Earth.

The mean specific force over a minute gives roll and pitch, as levelling does in a second. The mean
angular rate, turned level, is then that of the Earth: its horizontal part points north. The method
needs a vehicle that does not move at all and a gyroscope whose bias is small against 15 deg/h, so
both are judged here, with the noise and the biases that the filter is told.

Derivation: docs/explanation/gyrocompassing.md.
"""

from dataclasses import dataclass, replace

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.navigation.geometry.earth import earth_rate_n, gravity
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.state.fields import NEVER, State
from insdvl.navigation.state.scratch import Constants

# What has become of it, as it stands in the record. All but the first two: the heading is as told.
UNDECIDED, FOUND, INACCURATE, MOVES, GAP, NOT_THE_EARTH = range(6)

#: Probability that a vehicle at rest is taken for a moving one, by each test.
FALSE_ALARM = 1e-6
#: Of the means, one sigma: what is left to judge by where no noise is told [m/s^2, rad/s].
ROUNDING = 1e-12


@dataclass(frozen=True)
class Noise:
    """What the filter is told of its IMU, in base_link axes.

    Attributes:
        f: (3, 3) variance of one sample of the specific force [(m/s^2)^2].
        w: (3, 3) of the angular rate [(rad/s)^2].
        walk_f: Density of the walk of the accelerometer bias [(m/s^2)^2/s].
        walk_w: Of the gyroscope bias [(rad/s)^2/s].
        bias_f: One sigma of each axis of the accelerometer bias [m/s^2].
        bias_w: Of the gyroscope bias [rad/s].
        rate: Samples per second [Hz].
        of_samples: Whether single samples have it. A received Q is that which a filter integrates,
            and its sender may know it to a factor only.
    """

    f: Array
    w: Array
    walk_f: float
    walk_w: float
    bias_f: float
    bias_w: float
    rate: float
    of_samples: bool = True

    def of_mean(self, count: float, seconds: float) -> Array:
        """Covariance (6, 6) of a mean of samples, f then w, against the bias at its end.

        A bias that walks to its value at the end was on average another one, by a third of the
        variance of the walk.
        """
        R = np.eye(6) * ROUNDING**2
        R[:3, :3] += self.f / count + np.eye(3) * (self.walk_f * seconds / 3.0)
        R[3:, 3:] += self.w / count + np.eye(3) * (self.walk_w * seconds / 3.0)
        return R

    def of_biases(self) -> Array:
        """Covariance (6, 6) of the biases, as far as they are told."""
        return np.diag(np.repeat(np.square([self.bias_f, self.bias_w]), 3))


def noise_of(s: State, c: Constants, bias_f: float, bias_w: float) -> Noise:
    """What is told of the IMU now, with one sigma of each axis of both biases."""
    per_sample = c["density"] * c["rate"]
    return Noise(
        f=s["noise"]["Q_f"] * per_sample,
        w=s["noise"]["Q_w"] * per_sample,
        walk_f=float(c["eps_f"]),
        walk_w=float(c["eps_w"]),
        bias_f=bias_f,
        bias_w=bias_w,
        rate=float(c["rate"]),
        of_samples=bool(s["noise"]["q_ns"] == NEVER),
    )


@dataclass(frozen=True)
class Plan:
    """What is wanted.

    Attributes:
        duration: Time at rest [s].
        heading_std: The sigma that is told of the heading [rad]: worse is not used.
    """

    duration: float
    heading_std: float


@dataclass(frozen=True)
class Rest:
    """What a time at rest tells.

    Attributes:
        mean: (6,) means of specific force [m/s^2] and angular rate [rad/s], base_link axes.
        P: (6, 6) covariance of their errors, noise and biases.
        C_n_b: (3, 3) attitude.
        P_psi: (3, 3) covariance of its error [rad^2].
        P_psi_b: (3, 6) covariance of that error and the biases.
    """

    mean: Array
    P: Array
    C_n_b: Array
    P_psi: Array
    P_psi_b: Array

    def covariance(self, noise: Noise) -> Array:
        """Covariance (9, 9) of the errors of attitude and biases."""
        P = np.zeros((9, 9))
        P[:3, :3], P[:3, 3:], P[3:, :3] = self.P_psi, self.P_psi_b, self.P_psi_b.T
        P[3:, 3:] = noise.of_biases()
        return P


def level(f_b: Array) -> tuple[float, float]:
    """Roll and pitch [rad] of a vehicle at rest, from its mean specific force (3,)."""
    return (
        float(np.arctan2(-f_b[1], -f_b[2])),
        float(np.arctan2(f_b[0], np.hypot(f_b[1], f_b[2]))),
    )


def attitude(f_b: Array, w_ib_b: Array) -> Array:
    """C_n_b (3, 3) of a vehicle at rest, from its mean specific force and angular rate."""
    roll, pitch = level(f_b)
    w = rotation_from_rpy(np.array([roll, pitch, 0.0])) @ w_ib_b
    return rotation_from_rpy(np.array([roll, pitch, np.arctan2(-w[1], w[0])]))


def jacobian(C_n_b: Array, lat: float, h: float) -> Array:
    """d psi / d (e_f, e_w) (3, 6): what errors of the two means make of the attitude.

        psi_N = (C e_f)_E / g,  psi_E = -(C e_f)_N / g,
        psi_D = (C e_w)_E / (W cos lat) - tan lat psi_N

    Args:
        C_n_b: (3, 3) attitude.
        lat: Latitude [rad].
        h: Height [m].
    """
    w_ie_n, g = np.empty(3), gravity(lat, h)
    earth_rate_n(lat, w_ie_n)
    J = np.zeros((3, 6))
    J[0, :3], J[1, :3] = C_n_b[1] / g, -C_n_b[0] / g
    J[2, :3] = w_ie_n[2] / w_ie_n[0] * J[0, :3]
    J[2, 3:] = C_n_b[1] / w_ie_n[0]
    return J


def heading_sigma(noise: Noise, count: float, seconds: float, lat: float, h: float) -> float:
    """What the method will reach [rad], whatever the heading is: along the noisiest axis."""
    variances = np.diag(noise.of_mean(count, seconds) + noise.of_biases())
    J = jacobian(np.eye(3), lat, h)[2]
    return float(np.sqrt(J[1] ** 2 * variances[:3].max() + J[4] ** 2 * variances[3:].max()))


def earth_misfit(C_n_b: Array, w_ib_b: Array, P: Array, lat: float, h: float) -> float:
    """Squared misfit of the mean angular rate to that of the Earth, 2 degrees of freedom.

    East, the heading is such that the rate fits. North and down it can differ: a slow turn, a bias
    larger than told, another latitude.

    Args:
        C_n_b: (3, 3) attitude that was found.
        w_ib_b: (3,) mean angular rate [rad/s].
        P: (6, 6) covariance of the errors of both means.
        lat: Latitude [rad].
        h: Height [m].
    """
    w_ie_n = np.empty(3)
    earth_rate_n(lat, w_ie_n)
    misfit = (C_n_b @ w_ib_b - w_ie_n)[[0, 2]]
    # C w - w_ie = C e_w - psi x w_ie
    H = cross_matrix(w_ie_n) @ jacobian(C_n_b, lat, h)
    H[:, 3:] += C_n_b
    H = H[[0, 2]]
    return float(misfit @ np.linalg.solve(H @ P @ H.T, misfit))


def see_block(s: State, mean: Array, count: int, noise: Noise, plan: Plan, stamp_ns: int) -> None:
    """Add the next block of samples to the time at rest, and judge what becomes of it.

    At rest the mean of a block is that of all before it, but for the noise of both. The squared
    misfits of the blocks, 6 degrees of freedom each, are then independent. One alone tells a
    motion at once, their sum a small one. Whether the heading will be accurate enough is judged by
    the first block, and by all of them together in the end: one that is disturbed tells neither.
    `state.start.compass` gets the outcome, and ``compass_number`` its number: the sigma of the
    heading [rad], or how many times larger than chance a misfit is.

    Args:
        s: State record.
        mean: (6,) means of the block: specific force [m/s^2], then angular rate [rad/s].
        count: Its samples.
        noise: Of the IMU.
        plan: What is wanted.
        stamp_ns: End of the block.
    """
    start, nav = s["start"], s["nav"]
    lat, h = nav["lat_0"], nav["h_0"]
    before = int(start["rest_count"])
    if before == 0:
        sigma = heading_sigma(noise, plan.duration * noise.rate, plan.duration, lat, h)
        if not sigma < plan.heading_std:
            start["compass"], start["compass_number"] = INACCURATE, sigma
            return
        start["rest_ns"] = start["level_ns"]
    else:
        seconds = (start["level_ns"] - start["rest_ns"]) * 1e-9
        R = noise.of_mean(count, 0.0) + _of_rest(s, noise).of_mean(before, seconds)
        misfit = mean - start["rest_sum"] / before
        nis = float(misfit @ np.linalg.solve(R, misfit))
        start["rest_nis"] += nis
        start["rest_blocks"] += 1
        of_all = start["rest_nis"] / exceeded(6 * int(start["rest_blocks"]), FALSE_ALARM)
        times = max(nis / exceeded(6, FALSE_ALARM), of_all)
        if not times <= 1.0:
            start["compass"], start["compass_number"] = MOVES, times
            return
    start["rest_sum"] += mean * count
    start["rest_count"] += count
    start["rest_noise"] += count * np.array([noise.f, noise.w])
    if stamp_ns - start["rest_ns"] < plan.duration * NS:
        return
    rest = at_rest(s, noise)
    sigma = float(np.sqrt(rest.P_psi[2, 2]))
    if not sigma < plan.heading_std:
        start["compass"], start["compass_number"] = INACCURATE, sigma
        return
    misfit = earth_misfit(rest.C_n_b, rest.mean[3:], rest.P, lat, h)
    times = misfit / exceeded(2, FALSE_ALARM)
    if not times <= 1.0:
        start["compass"], start["compass_number"] = NOT_THE_EARTH, times
        return
    start["compass"], start["compass_number"] = FOUND, sigma


def at_rest(s: State, noise: Noise) -> Rest:
    """What the blocks so far tell together."""
    start, nav = s["start"], s["nav"]
    count = int(start["rest_count"])
    mean = start["rest_sum"] / count
    C = attitude(mean[:3], mean[3:])
    J = jacobian(C, nav["lat_0"], nav["h_0"])
    P_b = noise.of_biases()
    P = _of_rest(s, noise).of_mean(count, count / noise.rate) + P_b
    return Rest(mean, P, C, J @ P @ J.T, J @ P_b)


def _of_rest(s: State, noise: Noise) -> Noise:
    """The mean noise of the blocks so far; that of now may be of another vibration."""
    f, w = s["start"]["rest_noise"] / int(s["start"]["rest_count"])
    return replace(noise, f=f, w=w)
