"""Profiles of the IMU noise: variances per sample that change in steps.

A factory, ``factory(duration, rng) -> NoiseProfile``, draws a profile. Channels are ordered
f_b x, y, z [(m/s^2)^2], then w_ib_b x, y, z [(rad/s)^2].
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from insdvl.arrays import Array
from insdvl.files import read, shown
from insdvl.kernels import kernel

ACCELEROMETER_VARIANCE = 0.01  # (m/s^2)^2
GYROSCOPE_VARIANCE = 0.001  # (rad/s)^2

MAX_FILE_BYTES = 8 * 2**20  # a change of all variances every 0.1 s for more than an hour


@dataclass(frozen=True)
class NoiseProfile:
    """Variances of the six channels, constant from each time to the next.

    Attributes:
        times: (K,) times from which the variances apply, increasing from 0 [s].
        variances: (K, 6) not negative.
    """

    times: Array
    variances: Array

    def __post_init__(self) -> None:
        if self.variances.shape != (self.times.size, 6):
            raise ValueError(
                f"variances must be of shape ({self.times.size}, 6), got {self.variances.shape}"
            )
        if not self.times.size or self.times[0] != 0.0:
            raise ValueError(
                f"times must start at 0 and increase, got {self.times[:1].tolist()} first"
            )
        increasing = np.isfinite(self.times[1:]) & (np.diff(self.times) > 0.0)
        if not increasing.all():
            before, after = self.times[int(increasing.argmin()) :][:2]
            raise ValueError(f"times must start at 0 and increase, got {after} after {before}")
        wrong = ~(np.isfinite(self.variances) & (self.variances >= 0.0))
        if wrong.any():
            raise ValueError(f"variances must be finite and >= 0, got {self.variances[wrong][0]!r}")

    def variance_at(self, t: ArrayLike) -> Array:
        """Variances (N, 6) at times t (N,) >= 0; at the time of a change, the new ones."""
        return self.variances[np.searchsorted(self.times, t, side="right") - 1]


ProfileFactory = Callable[[float, np.random.Generator], NoiseProfile]


def constant(variances: ArrayLike) -> ProfileFactory:
    """Constant variances (6,)."""
    level = np.array(variances, dtype=float).reshape(1, -1)
    return lambda duration, rng: NoiseProfile(np.zeros(1), level)


def segments(
    low: float, high: float, shortest: float = 15.0, longest: float = 45.0
) -> ProfileFactory:
    """Each channel holds a log-uniform variance for a uniform random time, then another.

    Args:
        low: Smallest variance.
        high: Largest variance.
        shortest: Shortest segment [s].
        longest: Longest segment [s].
    """

    def draw(duration: float, rng: np.random.Generator) -> NoiseProfile:
        starts, levels = [], []
        most = int(duration / shortest) + 1
        for channel in rng.spawn(6):
            # Row by row, so that a longer profile begins as the shorter one.
            draws = channel.random((most, 2))
            ends = np.cumsum(shortest + (longest - shortest) * draws[:, 0])
            starts.append(np.concatenate([[0.0], ends[ends < duration]]))
            levels.append(np.exp(np.log(low) + np.log(high / low) * draws[:, 1]))
        times = np.unique(np.concatenate(starts))
        columns = [
            level[np.searchsorted(start, times, side="right") - 1]
            for start, level in zip(starts, levels, strict=True)
        ]
        return NoiseProfile(times, np.stack(columns, axis=1))

    return draw


def on_off(off: ArrayLike, on: ArrayLike, half_period: float) -> ProfileFactory:
    """All channels switch together between the variances ``off`` and ``on`` (6,); ``off`` is first.

    Args:
        off: Variances of the first half period.
        on: Variances of the second.
        half_period: Time between switches [s].
    """
    levels = np.array([off, on], dtype=float)

    def switch(duration: float, rng: np.random.Generator) -> NoiseProfile:
        times = half_period * np.arange(max(1, np.ceil(duration / half_period)), dtype=float)
        return NoiseProfile(times, levels[np.arange(times.size) % 2])

    return switch


def from_file(path: Path) -> ProfileFactory:
    """A profile from a CSV file: time [s], then the six variances that apply from then on.

    Empty lines and comments, which start with ``#``, are skipped.

    Raises:
        ValueError: The file cannot be read or a line is invalid; the message names it.
    """
    try:
        lines = read(path, MAX_FILE_BYTES).decode("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"cannot read the noise profile {path}: {error}") from error
    rows = []
    for number, line in enumerate(lines, start=1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        cells = text.split(",")
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            raise ValueError(f"{path}, line {number}: not seven numbers: {shown(text)}") from None
        if len(row) != 7:
            raise ValueError(f"{path}, line {number}: expected 7 values, got {len(row)}")
        rows.append(row)
    if not rows:
        raise ValueError(f"{path} has no line with a time and six variances")
    table = np.array(rows)
    try:
        profile = NoiseProfile(table[:, 0], table[:, 1:])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return lambda duration, rng: profile


def gauss_markov(std: Array, step: ArrayLike, size: int, rng: np.random.Generator) -> Array:
    """First-order Gauss-Markov processes (size, m) at equally spaced times, stationary.

    Args:
        std: (m,) sigma of each.
        step: From one time to the next, in correlation times: of each (m,), or of all.
        size: Number of times.
        rng: Of the draws; a longer process begins as the shorter one.
    """
    drive = rng.standard_normal((size, std.size))
    decay = np.exp(-np.broadcast_to(step, std.shape))
    drive[:1] *= std
    drive[1:] *= std * np.sqrt(1.0 - decay**2)
    _remember(drive, decay)
    return drive


@kernel
def _remember(x: Array, decay: Array) -> None:
    """x[k] += decay x[k - 1] of all k in their order, in place; x is (N, M), decay (M,)."""
    for k in range(1, x.shape[0]):
        for i in range(x.shape[1]):
            x[k, i] += decay[i] * x[k - 1, i]


#: The scenarios of the evaluation.
SCENARIOS: Mapping[str, ProfileFactory] = MappingProxyType(
    {
        "constant": constant([ACCELEROMETER_VARIANCE] * 3 + [GYROSCOPE_VARIANCE] * 3),
        "constant-tableI": constant([ACCELEROMETER_VARIANCE**2] * 3 + [GYROSCOPE_VARIANCE**2] * 3),
        "varying": segments(1e-3, 0.05),
        "wide": segments(1e-5, 0.05),
    }
)
#: The variances of each scenario in words.
SCENARIO_TEXTS: Mapping[str, str] = MappingProxyType(
    {
        "constant": f"{ACCELEROMETER_VARIANCE:g} and {GYROSCOPE_VARIANCE:g} throughout",
        "constant-tableI": f"{ACCELEROMETER_VARIANCE:g}^2 and {GYROSCOPE_VARIANCE:g}^2 throughout",
        "varying": "each channel in [0.001, 0.05], a new value every 15 to 45 s",
        "wide": "each channel in [1e-5, 0.05], a new value every 15 to 45 s",
    }
)
