"""The noise of IMU and DVL: as the recording shows it, as it is told, and as it is learned."""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.state.fields import NEVER
from insdvl.studies.replay.consumer import Consumer, initialised
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


class NoiseInForce(Consumer):
    """Follows the noise of the DVL in force, where it is learned: its size, and where it is from.

    It looks from one measurement that has taught to the next.

    After a time jump it begins anew.
    """

    def __init__(self) -> None:
        self._last_ns = NEVER  # stamp of the last measurement seen
        self._ended = True
        self._factors: dict[int, float] = {}  # by the stamp of the measurement
        self._origins: Counter[str] = Counter()

    def take(self, filter_: Filter, states: Records) -> None:
        """See `Consumer`."""
        if self._ended:
            self._factors, self._origins, self._ended = {}, Counter(), False
        for known in initialised(states):
            taught_ns = known[f"{Dvl.name}_noise"]["learned_ns"]
            for k in np.flatnonzero(np.diff(taught_ns, prepend=self._last_ns)).tolist():
                self._see(filter_, known[k], int(taught_ns[k]))
            self._last_ns = int(taught_ns[-1])

    def _see(self, filter_: Filter, state: Any, stamp_ns: int) -> None:
        noise = filter_.noise_in_force(state, Dvl.name)
        if noise is None or stamp_ns == NEVER:  # it is that at a start
            return
        self._factors[stamp_ns] = noise.factor
        self._origins.update(noise.origins)

    def end(self) -> None:
        """See `Consumer`."""
        self._last_ns, self._ended = NEVER, True

    def numbers(self, filter_: Filter, taken: Taken) -> dict[str, Any] | None:
        """Factor on the nominal R and sigma [m/s], each with mean, min and max; and the origins.

        Args:
            filter_: The filter.
            taken: What was folded, whose measurements tell the nominal noise.

        Returns:
            None where the noise is nominal, or nothing has taught.
        """
        if not self._factors:
            return None
        model, variances = filter_.models[Dvl.name], []
        for event in taken.events:
            if isinstance(event, Dvl) and all(event.measured):
                factor = self._factors.get(event.stamp_ns)
                if factor is not None:
                    variances.append(factor * float(np.trace(model.noise(event))) / 3.0)
        count = len(self._factors)
        return {
            "measurements": count,
            "factor": _told(np.array(list(self._factors.values()))),
            "sigma": _told(np.sqrt(variances)) if variances else None,
            "origins": {name: share / count for name, share in self._origins.most_common()},
        }


def _told(values: Array) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "min": float(values.min()),
        "max": float(values.max()),
    }
