"""The tuner: estimates the variance of the IMU noise at the tuning rate.

The schedule follows from the stamps alone. Time is divided into periods of 1 / rate from stamp 0
on; the first sample of a period closes a window, which has that sample and those before it: the
N - 1 of the model's window, or as many as there are without a gap up to the model's history. Some
models count means of samples, see windows.py. A stamp at the start of a period belongs to the
period, so estimates lie on multiples of 1 / rate where samples do; with jitter or other phases an
estimate has the stamp of the first sample after. The time at which the tuner started, and the
speed at which samples arrive, do not matter: two tuners that have both seen the samples of the
history give the same bits.

A period in which there are fewer than N samples since the last gap has no estimate.
"""

from collections import deque
from dataclasses import dataclass
from fractions import Fraction
from statistics import median
from time import perf_counter

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS
from insdvl.parameters.declaration import ParameterError
from insdvl.tuner.features.differences import bounded
from insdvl.tuner.models import UnknownModelError, load_model
from insdvl.tuner.own import HISTORY, WINDOW, EstimatorError, OwnEstimator
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.windows import CHANNELS, MOST, Estimator, Window, period, pool_of, pooled

#: Calls whose time is kept.
CALLS = 5


@dataclass(frozen=True)
class TunedNoise:
    """Variance per sample of each channel, from a stamp on.

    Attributes:
        stamp_ns: Stamp of the sample that closed the window.
        variances: (6,) of specific force x, y, z [(m/s^2)^2] and angular rate x, y, z [(rad/s)^2].
    """

    stamp_ns: int
    variances: Array


class Tuner:
    """Estimates the process noise of an IMU from its last samples.

    Attributes:
        enabled: While False there are no estimates; the window is still filled.
        kind: ``model``, or ``estimator`` where one of your own is in its place.
        name: Of it.
        window: Least number of samples of an estimate, or of means of samples.
        failure: Of the estimator in use, the last one; empty while there was none.
    """

    def __init__(self, parameters: TunerParameters) -> None:
        """Load the model and compile its functions, or import the estimator and try it.

        Raises:
            ModelError: The model cannot be used, see `load_model`.
            ParameterError: There is no such model, the estimator cannot be used, or the window is
                too short for the differences.
        """
        self.enabled = parameters.enabled
        self.kind = "estimator" if parameters.estimator else "model"
        self._seconds: deque[float] = deque(maxlen=CALLS)  # that the last calls took
        self._estimate, self.window, self._history, self._pooling = self._chosen(parameters)
        if parameters.difference_order >= self.window:
            raise ParameterError(
                f"parameter 'difference_order' must be less than the {self.window} samples "
                f"of the window, got {parameters.difference_order}"
            )
        self._difference_order = parameters.difference_order
        self._rate = Fraction(parameters.rate) / NS  # periods in a nanosecond, exactly
        size = self._history * (MOST if self._pooling else 1)
        self._window = Window(size, round(parameters.max_gap * NS))
        self._made = {"windows": 0, "too_large": 0, "failed": 0}
        self.failure = ""

    def _chosen(self, parameters: TunerParameters) -> tuple[Estimator, int, int, bool]:
        """What estimates, its least and its largest number of samples, and whether it pools."""
        if parameters.estimator:
            try:
                own = OwnEstimator(parameters.estimator)
            except EstimatorError as error:
                raise ParameterError(f"parameter 'estimator': {error}") from error
            self.name = own.name
            return self._own(own), WINDOW, HISTORY, False
        try:
            model = load_model(parameters.model)
        except UnknownModelError as error:
            raise ParameterError(f"parameter 'model': {error}") from error
        model.variances(np.zeros((CHANNELS, model.window)))
        self.name = model.card["name"]
        return model.variances, model.window, model.history, model.schema.pooling

    def _own(self, own: OwnEstimator) -> Estimator:
        return lambda windows: own(windows.T, self._window.rate(windows.shape[1]))

    @property
    def seconds_per_call(self) -> float | None:
        """Median time of the last estimates [s], None before the first; no number depends on it."""
        return median(self._seconds) if self._seconds else None

    @property
    def counts(self) -> dict[str, int]:
        """Samples used and dropped, see `Window`; windows used, too large, and failed."""
        return self._window.counts | self._made

    def add(self, stamp_ns: int, sample: Array) -> TunedNoise | None:
        """Add a sample; returns the new estimate where it closes a window.

        Never raises on data: unusable data is counted, see `counts`.

        Args:
            stamp_ns: Stamp of the sample.
            sample: (6,) specific force [m/s^2] and angular rate [rad/s], in any fixed axes.
        """
        stamp_ns = int(stamp_ns)
        previous = self._window.stamp_ns
        if not self._window.add(stamp_ns, sample):
            return None
        if previous is None or period(stamp_ns, self._rate) == period(previous, self._rate):
            return None
        if self._window.filled < self.window or not self.enabled:
            return None
        k = pool_of(self._window.rate(self.window)) if self._pooling else 1
        if self._window.filled < k * self.window:
            return None
        estimate = bounded(pooled(self._estimate, k), self._difference_order, self.window)
        begun = perf_counter()
        try:
            variances = estimate(self._window.samples()[:, -k * self._history :])
        except EstimatorError as error:
            self._made["failed"] += 1
            self.failure = str(error)
            return None
        except ValueError:  # the samples are finite, their features are not
            self._made["too_large"] += 1
            return None
        finally:
            self._seconds.append(perf_counter() - begun)
        self._made["windows"] += 1
        return TunedNoise(stamp_ns, variances)
