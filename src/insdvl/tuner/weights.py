"""Weights of a vehicle: a linear model of each channel's features, one for each group of channels.

A file holds two arrays of float64, each with a row of the accelerometers and one of the gyroscopes:
``weights`` (2, F + 1), the constant first, and ``limits`` (2, 2), the lowest and the highest output
that were seen in the training. A linear model extrapolates without end; the limits do not let it.
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
        limits: (2, 2) lowest and highest output of each.
        n_features: F.
    """

    def __init__(self, weights: Array, limits: Array) -> None:
        """Check the arrays.

        Raises:
            WeightsError: One has another type or shape, or is not finite, or limits cross.
        """
        for name, array in (("weights", weights), ("limits", limits)):
            if array.dtype != np.float64 or array.ndim != 2 or len(array) != 2:
                raise WeightsError(
                    f"{name} must be float64 with two rows, got {array.dtype} {array.shape}"
                )
            if array.shape[1] < 2 or not np.isfinite(array).all():
                raise WeightsError(f"{name} must have two finite columns or more")
        if limits.shape[1] != 2 or (limits[:, 0] > limits[:, 1]).any():
            raise WeightsError(f"limits must be (lowest, highest), got {limits.tolist()}")
        self.weights, self.limits = weights, limits
        self.n_features = weights.shape[1] - 1

    @classmethod
    def load(cls, data: bytes) -> "Weights":
        """From the bytes of an ``.npz`` file.

        Raises:
            WeightsError: They are not such an archive, or `Weights` rejects the arrays.
        """
        try:
            arrays = arrays_of(data, MAX_BYTES)
        except ValueError as error:
            raise WeightsError(str(error)) from error
        if set(arrays) != {"weights", "limits"}:
            raise WeightsError(f"the arrays must be weights and limits, got {sorted(arrays)}")
        return cls(arrays["weights"], arrays["limits"])

    def save(self) -> bytes:
        """The bytes of an ``.npz`` file; equal weights give equal bytes."""
        return archive({"weights": self.weights, "limits": self.limits})

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
        group = (np.arange(len(X)) // _TRIAD) % 2
        outputs = self.weights[group, 0] + np.sum(X * self.weights[group, 1:], axis=1)
        return np.asarray(np.clip(outputs, *self.limits[group].T))
