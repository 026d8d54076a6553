"""What the measurements of a DVL show: speeds, noise, and velocities that are none."""

from collections import Counter
from dataclasses import dataclass
from math import comb

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.watch.alignment.causes import UNITS
from insdvl.watch.alignment.outliers import MEDIAN, OUTLIER

ORDER = 3  # of the differences that the noise is taken from
FEWEST = 10  # of them
#: Speeds that a vehicle with a DVL has [m/s], to guess the unit from.
USUAL = (0.05, 5.0)


@dataclass(frozen=True)
class DvlFacts:
    """What the measurements show, in the axes of the stream.

    Attributes:
        count: Number of measurements that could be read.
        refused: Number of messages that could not, by reason.
        zeros: Number of velocities that are exactly zero.
        too_fast: Number of those beyond dvl.max_speed.
        repeats: Number of those that equal the one before, zeros aside.
        partial: Number of those with a component that was not measured.
        speed: Median and largest size of what was measured [m/s]; None without any that is not
            zero.
        mean: (3,) mean velocity [m/s].
        scatter: (3,) one sigma of the noise, by differences [m/s], nan for a component that was
            not measured; None with too few.
        told: One sigma that the messages tell, the median [m/s]; None where they tell none.
        first: Sizes of what the first three measured [m/s].
    """

    count: int
    refused: Counter[str]
    zeros: int
    too_fast: int
    repeats: int
    partial: int
    speed: tuple[float, float] | None
    mean: Array
    scatter: Array | None
    told: float | None
    first: tuple[float, ...]

    @property
    def unit(self) -> str:
        """The unit in which the speeds would be usual where most are too fast; empty for none."""
        if self.speed is None or self.too_fast <= self.count / 2:
            return ""
        fits = [u for u in ("cm/s", "mm/s") if USUAL[0] <= self.speed[0] * UNITS[u] <= USUAL[1]]
        return " or ".join(fits)


class DvlLog:
    """Collects the measurements.

    Args:
        max_speed: Of the parameters [m/s].
        axes: (3, 3) from forward-right-down to the axes of the stream.
    """

    def __init__(self, max_speed: float, axes: Array) -> None:
        self._max_speed, self._axes = max_speed, axes
        self._stamps: list[int] = []
        self._v: list[Array] = []  # nan where not measured
        self._told: list[float] = []
        self.refused: Counter[str] = Counter()

    def add(self, event: Dvl) -> None:
        """Take a measurement."""
        self._stamps.append(event.stamp_ns)
        # The axes differ in signs only.
        self._v.append(np.where(event.measured, self._axes @ event.v_d, np.nan))
        if all(event.measured) and event.R is not None and event.R.any():
            self._told.append(float(np.sqrt(np.diag(event.R).max())))

    def facts(self) -> DvlFacts:
        """What they show."""
        every = np.array(self._v).reshape(-1, 3)
        v = every[np.isfinite(every).all(axis=1)]
        speeds, sizes = np.linalg.norm(v, axis=1), np.sqrt(np.nansum(every**2, axis=1))
        moving = sizes[sizes > 0.0]
        equal = (np.diff(v, axis=0) == 0.0).all(axis=1) & (speeds[1:] > 0.0)
        return DvlFacts(
            count=len(every),
            refused=self.refused,
            zeros=int((speeds == 0.0).sum()),
            too_fast=int((sizes > self._max_speed).sum()),
            repeats=int(equal.sum()),
            partial=len(every) - len(v),
            speed=(float(np.median(moving)), float(moving.max())) if moving.size else None,
            mean=v.mean(axis=0) if len(v) else np.zeros(3),
            scatter=_scatter(np.array(self._stamps), every),
            told=float(np.median(self._told)) if self._told else None,
            first=tuple(float(size) for size in sizes[:3]),
        )


def _scatter(stamps_ns: Array, v: Array) -> Array | None:
    """One sigma (3,) of white noise; each component of v (N, 3) is nan in pings without it.

    A component that too few pings have is nan as well; None if all are.
    """
    measured = np.isfinite(v)
    sigma = np.array([_noise(stamps_ns[m], x[m]) for m, x in zip(measured.T, v.T, strict=True)])
    return sigma if np.isfinite(sigma).any() else None


def _noise(stamps_ns: Array, x: Array) -> float:
    """One sigma of white noise, by the median size of third differences of regular pings.

    The median leaves turns and changes of speed out, which are rare. An outlier is in four
    differences, which would move it: those of more than `OUTLIER` sigmas are left out. It is nan
    for too few.
    """
    if len(x) <= ORDER:
        return np.nan
    steps = np.diff(stamps_ns)
    usual = np.abs(steps - np.median(steps)) < 0.2 * np.median(steps)
    sizes = np.abs(np.diff(x, n=ORDER))[usual[2:] & usual[1:-1] & usual[:-2]]
    if len(sizes) < FEWEST:
        return np.nan
    sizes = sizes[sizes <= OUTLIER * np.median(sizes) / MEDIAN]
    return float(np.median(sizes) / MEDIAN / np.sqrt(comb(2 * ORDER, ORDER)))
