"""The tuner: IMU samples in, the variance of their noise out, at the tuning rate.

The schedule follows from the stamps alone. Time is cut into periods of 1 / rate from stamp 0 on;
the first sample of a period closes a window, which reaches back N samples and includes it. A stamp
that falls on the beginning of a period belongs to it, so where samples lie on multiples of 1 / rate
so do the estimates; with jitter or other phases an estimate has the stamp of the first sample
after. When the tuner was started, or how fast the samples arrive, changes none of this: two tuners
that have both seen the last N samples give the same bits.

A period whose window has a gap or is not yet full has no estimate.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS
from insdvl.parameters.declaration import ParameterError
from insdvl.tuner.features.differences import bounded
from insdvl.tuner.models import load_model
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.windows import CHANNELS, Window, period


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
    """Learns the process noise of an IMU from its last samples.

    Attributes:
        enabled: While False no estimate is made; the window goes on filling.
        model: The model in use.
    """

    def __init__(self, parameters: TunerParameters) -> None:
        """Load the model and compile what `add` needs.

        Raises:
            ModelError: The model cannot be used, see `load_model`.
            ParameterError: Its window is too short for the differences.
        """
        self.enabled = parameters.enabled
        self.model = load_model(parameters.model)
        if parameters.difference_order >= self.model.window:
            raise ParameterError(
                f"parameter 'difference_order' must be less than the {self.model.window} samples "
                f"of the model's window, got {parameters.difference_order}"
            )
        self._estimate = bounded(self.model.variances, parameters.difference_order)
        self._rate = Fraction(parameters.rate) / NS  # periods in a nanosecond, exactly
        self._window = Window(self.model.window, round(parameters.max_gap * NS))
        self._made = {"windows": 0, "too_large": 0}
        self._estimate(np.zeros((CHANNELS, self.model.window)))

    @property
    def counts(self) -> dict[str, int]:
        """Samples taken and dropped, see `Window`; windows used, and refused as too large."""
        return self._window.counts | self._made

    def add(self, stamp_ns: int, sample: Array) -> TunedNoise | None:
        """Take a sample; the new estimate where it closes a window.

        Never raises on data: what cannot be used is counted, see `counts`.

        Args:
            stamp_ns: The sample's stamp.
            sample: (6,) specific force [m/s^2] and angular rate [rad/s], in any fixed axes.
        """
        stamp_ns = int(stamp_ns)
        previous = self._window.stamp_ns
        if not self._window.add(stamp_ns, sample):
            return None
        if previous is None or period(stamp_ns, self._rate) == period(previous, self._rate):
            return None
        if not self._window.full or not self.enabled:
            return None
        try:
            variances = self._estimate(self._window.samples())
        except ValueError:  # finite samples whose features are not
            self._made["too_large"] += 1
            return None
        self._made["windows"] += 1
        return TunedNoise(stamp_ns, variances)
