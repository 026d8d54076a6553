"""Weights of a vehicle: a linear model of each channel's features, one for each group of channels.

A file holds one array ``weights`` (2, F + 1) float64: of the accelerometers and of the gyroscopes,
each with the constant first.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.files import archive
from insdvl.files import arrays as arrays_of
from insdvl.tuner.windows import CHANNELS

MAX_BYTES = 2**16
_TRIAD = CHANNELS // 2


class WeightsError(ValueError):
    """The array is not a set of weights."""


class Weights:
    """A linear model for each group of channels.

    Attributes:
        weights: (2, F + 1) constants and weights of accelerometers and gyroscopes.
        n_features: F.
    """

    def __init__(self, weights: Array) -> None:
        """Check the array.

        Raises:
            WeightsError: It has another type or shape, or is not finite.
        """
        if weights.dtype != np.float64 or weights.ndim != 2 or len(weights) != 2:
            raise WeightsError(
                f"weights must be float64 (2, F + 1), got {weights.dtype} {weights.shape}"
            )
        if weights.shape[1] < 2 or not np.isfinite(weights).all():
            raise WeightsError("weights must be finite, with a constant and at least one weight")
        self.weights = weights
        self.n_features = weights.shape[1] - 1

    @classmethod
    def load(cls, data: bytes) -> "Weights":
        """From the bytes of an ``.npz`` file.

        Raises:
            WeightsError: They are not such an archive, or `Weights` rejects the array.
        """
        try:
            arrays = arrays_of(data, MAX_BYTES)
        except ValueError as error:
            raise WeightsError(str(error)) from error
        if set(arrays) != {"weights"}:
            raise WeightsError(f"the arrays must be ['weights'], got {sorted(arrays)}")
        return cls(arrays["weights"])

    def save(self) -> bytes:
        """The bytes of an ``.npz`` file; equal weights give equal bytes."""
        return archive({"weights": self.weights})

    def predict(self, X: Array) -> Array:
        """Outputs (M,) for rows (M, F), six by six: the channels of one time in their order.

        Raises:
            ValueError: The rows have another length, or are not of whole times.
        """
        if X.ndim != 2 or X.shape[1] != self.n_features or len(X) % CHANNELS:
            raise ValueError(
                f"rows must be (M, {self.n_features}) with M a multiple of {CHANNELS}, "
                f"got {X.shape}"
            )
        constants, weights = self.weights[:, 0], self.weights[:, 1:]
        group = (np.arange(len(X)) // _TRIAD) % 2
        return np.asarray(constants[group] + np.sum(X * weights[group], axis=1))
