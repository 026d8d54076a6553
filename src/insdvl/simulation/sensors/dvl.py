"""The simulated DVL: velocity over ground at its position, in its axes, and its errors."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray

from insdvl.arrays import Array
from insdvl.navigation.geometry.frames import Convention, rotation_from_rpy
from insdvl.parameters.declaration import ParameterError, lever_arm, mount, parameter
from insdvl.simulation.motion import Trajectory, Truth
from insdvl.simulation.noise import gauss_markov

_NODES = 7  # per ping: 1e-7 of a vibration of one period per ping


@dataclass(frozen=True)
class DvlModel:
    """The simulated DVL."""

    rate: float = parameter(1.0, "Pings per second.", unit="Hz", low=0.01, high=100.0)
    mount: tuple[float, ...] = mount("DVL")
    lever_arm: tuple[float, ...] = lever_arm("DVL")
    noise_std: tuple[float, ...] = parameter(
        (0.1, 0.1, 0.1),
        "White noise of each velocity component, one sigma.",
        unit="m/s",
        low=0.0,
        length=3,
    )
    bias_std: float = parameter(
        0.0, "Stationary sigma of a first-order Gauss-Markov error.", unit="m/s", low=0.0
    )
    bias_time_constant: float = parameter(
        10.0, "Correlation time of the first-order Gauss-Markov error.", unit="s", above=0.0
    )
    ping: float = parameter(
        0.0,
        "Time, centred on the stamp, over which a ping takes the mean of the velocity.",
        unit="s",
        low=0.0,
        high=1.0,
    )
    outages: tuple[float, ...] = parameter(
        (0.0, 0.0),
        "Intervals without pings, from the start of the mission: start, end, start, end and so on.",
        unit="s",
        low=0.0,
    )
    outlier_probability: float = parameter(
        0.0, "Probability that a ping is an outlier.", low=0.0, high=1.0
    )
    outlier_size: float = parameter(
        3.0,
        "Length of the vector, of random direction, that is added to an outlier.",
        unit="m/s",
        low=0.0,
    )

    def __post_init__(self) -> None:
        ordered = all(a <= b for a, b in zip(self.outages, self.outages[1:], strict=False))
        if len(self.outages) % 2 or not ordered:
            raise ParameterError(
                "parameter 'dvl.outages' must be pairs of start and end in rising order, "
                f"got {list(self.outages)!r}"
            )

    def in_frd(self, convention: Convention) -> "DvlModel":
        """This DVL with mount and lever arm in forward-right-down.

        Args:
            convention: Axes of the mount and of the lever arm.
        """
        # The change of axes flips signs only, so the angles change as the components of a vector.
        return replace(
            self,
            mount=tuple(convention.body @ self.mount),
            lever_arm=tuple(convention.body @ self.lever_arm),
        )

    def errors(
        self, t: Array, rng: np.random.Generator, factors: ArrayLike = 1.0
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Errors of all pings at equally spaced times t (N,).

        Each kind of error has a random stream of its own: a setting changes its own error only,
        and the number of pings changes none.

        Args:
            t: [s].
            rng: Generator of the draws.
            factors: (N,) on the sigma of the white noise of each ping, or one for all.

        Returns:
            The errors (N, 3) [m/s], and which pings are outliers (N,).
        """
        white, markov, chance, directions = rng.spawn(4)
        errors = np.array(self.noise_std) * white.standard_normal((t.size, 3))
        errors *= np.reshape(factors, (-1, 1))
        step = 1.0 / (self.rate * self.bias_time_constant)
        errors += gauss_markov(np.full(3, self.bias_std), step, t.size, markov)
        is_outlier = chance.random(t.size) < self.outlier_probability
        direction = directions.standard_normal((t.size, 3))
        direction *= self.outlier_size / np.linalg.norm(direction, axis=1, keepdims=True)
        errors[is_outlier] += direction[is_outlier]
        return errors, is_outlier

    def available(self, t: Array) -> NDArray[np.bool_]:
        """Which of the times (N,) lie outside the outages, start <= t < end."""
        seen = np.ones(t.size, dtype=bool)
        for start, end in zip(self.outages[::2], self.outages[1::2], strict=True):
            seen &= (t < start) | (t >= end)
        return seen


def ideal_pings(trajectory: Trajectory, t: Array, model: DvlModel, *, earth_rate: bool) -> Array:
    """Readings (N, 3) of a perfect DVL, each the mean over the ping [m/s].

    Args:
        trajectory: The motion.
        t: (N,) middles of the pings [s]; what of a ping is outside of the motion is not seen.
        model: With mount and lever arm in forward-right-down.
        earth_rate: See `Trajectory.truth`.
    """
    x, w = legendre.leggauss(_NODES if model.ping > 0.0 else 1)
    total = np.zeros((t.size, 3))
    for node, weight in zip(x, w / w.sum(), strict=True):
        at = np.clip(t + 0.5 * model.ping * node, 0.0, trajectory.duration)
        total += weight * ideal_velocity(trajectory.truth(at, earth_rate=earth_rate), model)
    return total


def ideal_velocity(truth: Truth, model: DvlModel) -> Array:
    """Readings (N, 3) of a perfect DVL: C_d_b (C_b_n v_n + w_nb_b x l_b_dvl) [m/s].

    Args:
        truth: At the times of the pings.
        model: With mount and lever arm in forward-right-down.
    """
    C_b_d = rotation_from_rpy(np.array(model.mount))
    v_b = np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n)
    v_b += np.cross(truth.w_nb_b, np.array(model.lever_arm))
    return v_b @ C_b_d
