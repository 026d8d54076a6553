"""What an update did with a measurement."""

from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array


@dataclass(frozen=True)
class UpdateReport:
    """What an update did with a measurement of m rows.

    Attributes:
        measurement: Name of its kind.
        innovation: (m,) measured minus predicted, in the coordinates of the measurement.
        S: (m, m) covariance of the innovation; the variance of a component that was not measured is
            infinite, its innovation 0.
        nis: Normalised innovation squared, chi-square with `rows` degrees of freedom when all is
            well; of the filter's own prediction also where the update adapts it.
        accepted: Whether the state was corrected.
        reason: Empty, or why not: ``gate``; ``bad_covariance`` (S is not positive definite);
            ``not_finite`` (the NIS is beyond all numbers). ``restarted`` where the state was set
            from the measurement. With ``not_initialised``, or a reason of the sensor's own,
            nothing was predicted: innovation, S and NIS are nan.
    """

    measurement: str
    innovation: Array
    S: Array
    nis: float
    accepted: bool
    reason: str

    @property
    def corrected(self) -> bool:
        """Whether the innovation corrected the state; a restart only sets part of it."""
        return self.accepted and not self.reason

    @property
    def rows(self) -> int:
        """Number of components that were measured."""
        return int(np.count_nonzero(np.isfinite(np.diagonal(self.S))))

    @property
    def judged(self) -> bool:
        """Whether it was compared with a prediction, so that its NIS is a number."""
        return bool(np.isfinite(self.nis))
