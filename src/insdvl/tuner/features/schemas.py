"""What a model is given of a window, and what its answer means: the feature schemas.

A schema turns windows into rows of features and, for each window, the variance that the answer is
relative to. A model that answers in absolute terms gives q itself; one that is relative gives
log(q / scale), so that an IMU with all its readings multiplied by c has its variance multiplied by
c^2, whatever c is.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.tuner.features.closed_form import DEGREE
from insdvl.tuner.features.detrend import checked, polynomials, residual
from insdvl.tuner.features.handcrafted import FEATURE_NAMES, MIN_SAMPLES, features
from insdvl.tuner.features.residual import (
    MIN_RESIDUAL_SAMPLES,
    RESIDUAL_FEATURE_NAMES,
    residual_features,
)


@dataclass(frozen=True)
class Schema:
    """What a model is given, and how its answer is read.

    Attributes:
        names: Names of the F features, in order; empty where they are the window's N samples.
        extract: (M, N) windows to (M, F) features and (M,) scales, the variances in the square of
            the window's unit that the answers are relative to; ones where they are absolute.
        relative: Whether the answer is log(q / scale); otherwise it is q.
        min_samples: Fewest samples of a window.
    """

    names: tuple[str, ...]
    extract: Callable[[Array], tuple[Array, Array]]
    relative: bool
    min_samples: int

    def width(self, window: int) -> int:
        """Number F of features of a window of this many samples."""
        return len(self.names) or window

    def encode(self, q: Array, scale: Array) -> Array:
        """Answers (M,) that mean the variances q (M,) > 0 in windows of these scales (M,) > 0."""
        return np.log(q / scale) if self.relative else q

    def decode(self, answers: Array, scale: Array) -> Array:
        """Variances q (M,) that the answers (M,) mean in windows of these scales (M,).

        Where answers are relative, a window of scale 0, which has no noise, has q = 0.
        """
        return scale * np.exp(answers) if self.relative else answers


def _paper(windows: Array) -> tuple[Array, Array]:
    return features(windows), np.ones(len(windows))


def _window(windows: Array) -> tuple[Array, Array]:
    return windows, np.ones(len(windows))


def _scaled_window(windows: Array) -> tuple[Array, Array]:
    """Residuals around a polynomial in units of their spread; 0 where there are none.

    Of degree 5, which follows the motion down to much smaller noise than a straight line does.
    """
    windows = checked(windows, DEGREE + 2)
    out = np.empty_like(windows)
    scale = np.empty(windows.shape[0])
    _scaled_residuals(windows, polynomials(windows.shape[1], DEGREE), out, scale)
    return out, scale


@kernel
def _scaled_residuals(windows: Array, basis: Array, out: Array, scale: Array) -> None:
    """`_scaled_window` of ``windows`` (M, N) into ``out`` (M, N) and ``scale`` (M,)."""
    M, N = windows.shape
    for m in range(M):
        scale[m] = residual(windows[m], basis, out[m]) / (N - 1 - basis.shape[0])
        if scale[m] > 0.0:
            out[m] /= np.sqrt(scale[m])


#: Feature schemas by the name that a model's card gives.
SCHEMAS: Mapping[str, Schema] = MappingProxyType(
    {
        "default": Schema(
            RESIDUAL_FEATURE_NAMES,
            residual_features,
            relative=True,
            min_samples=MIN_RESIDUAL_SAMPLES,
        ),
        "paper": Schema(FEATURE_NAMES, _paper, relative=False, min_samples=MIN_SAMPLES),
        "scaled_window": Schema((), _scaled_window, relative=True, min_samples=DEGREE + 2),
        "window": Schema((), _window, relative=False, min_samples=1),
    }
)
