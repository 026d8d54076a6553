"""The noise of IMU and DVL as the recording itself shows it, beside what the filter was told."""

import math
from dataclasses import dataclass

import numpy as np

from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.studies.replay.taken import Taken
from insdvl.tuner.features.differences import low_pass_factor

#: Median of the square of a normal number, in its variance.
_MEDIAN_SQUARE = 0.4549364231195728


@dataclass(frozen=True)
class DvlNoise:
    """Noise of a velocity component of the DVL from ping to ping [m/s].

    Attributes:
        shown: One sigma, as the recording shows it.
        shown_std: How well that is known.
        told: One sigma, as the filter is told: the root of the mean variance.
        by_messages: Whether the messages tell it, for most of them.
    """

    shown: float
    shown_std: float
    told: float
    by_messages: bool

    @property
    def z(self) -> float:
        """How many sigmas what is shown is away from what is told."""
        return abs(self.shown - self.told) / self.shown_std


def dvl_noise(taken: Taken, filter_: Filter, shown: tuple[float, float] | None) -> DvlNoise | None:
    """The noise of the DVL, shown and told.

    Args:
        taken: What was folded.
        filter_: The filter.
        shown: See `AlignmentCheck.ping_noise`; None where the recording does not show it.
    """
    events = [e for e in taken.events if isinstance(e, Dvl) and all(e.measured)]
    if shown is None or not events:
        return None
    model = filter_.models[Dvl.name]
    variances = [float(np.trace(model.noise(event))) / 3.0 for event in events]
    told = filter_.parameters.dvl.covariance != "parameters"
    from_messages = [told and e.R is not None and bool(np.diagonal(e.R).all()) for e in events]
    return DvlNoise(
        shown=shown[0],
        shown_std=max(shown[1], 1e-9),
        told=math.sqrt(float(np.mean(variances))),
        by_messages=bool(np.mean(from_messages) > 0.5),
    )


def imu_variances(taken: Taken) -> tuple[float, float]:
    """Variance per sample of specific force and angular rate, by differences of samples.

    Slow motion has none in the differences, but vibration has: it is a bound from above. What a
    low-pass in the IMU takes from them is given back. The median leaves out single bad samples; the
    mean is over the axes.
    """
    _, readings = taken.samples
    if len(readings) < 2:
        return math.nan, math.nan
    squares = np.median(np.diff(readings, axis=0) ** 2, axis=0) / (2.0 * _MEDIAN_SQUARE)
    squares *= low_pass_factor(readings)
    return float(squares[:3].mean()), float(squares[3:].mean())
