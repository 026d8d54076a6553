"""Feature schemas: the inputs of a model, and the meaning of its output.

A schema maps windows to rows of features and to scales. The output of an absolute model is q
itself; that of a relative model is log(q / scale), so q is multiplied by c^2 when all readings are
multiplied by any c.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.tuner.features.band_features import (
    BAND_FEATURE_NAMES,
    band_bounds,
    band_features,
)
from insdvl.tuner.features.band_groups import (
    GROUP_FEATURE_NAMES,
    group_features,
)
from insdvl.tuner.features.bands import HISTORY
from insdvl.tuner.features.bands import WINDOW as BANDS_WINDOW
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
    """Inputs of a model, and the meaning of its output.

    Attributes:
        names: Names of the F features, in order; empty where they are the window's N samples.
        extract: Maps windows (M, N) to features (M, F) and scales (M,), which are variances in the
            square of the window's unit, or ones where the output is absolute. Some schemas need
            the six channels of an IMU in each six rows.
        relative: Whether the output is log(q / scale); otherwise it is q.
        min_samples: Smallest number of samples of a window.
        history: Largest number of samples that an estimate uses, where it is not the window.
        pooling: Whether fast IMUs are seen by means of their samples, see windows.py.
        bounds: Maps features (M, F) to the lowest and the highest output (M,); None for none.
    """

    names: tuple[str, ...]
    extract: Callable[[Array], tuple[Array, Array]]
    relative: bool
    min_samples: int
    history: int | None = None
    pooling: bool = False
    bounds: Callable[[Array], tuple[Array, Array]] | None = None

    def width(self, window: int) -> int:
        """Number F of features of a window with this many samples."""
        return len(self.names) or window

    def encode(self, q: Array, scale: Array) -> Array:
        """Targets (M,) for variances q (M,) > 0 in windows of scales (M,) > 0."""
        return np.log(q / scale) if self.relative else q

    def bounded(self, X: Array, outputs: Array) -> Array:
        """Outputs (M,) for features (M, F) within their bounds."""
        return outputs if self.bounds is None else np.clip(outputs, *self.bounds(X))

    def decode(self, outputs: Array, scale: Array) -> Array:
        """Variances q (M,) from outputs (M,) for windows of scales (M,).

        With relative outputs, a window of scale 0, which has no noise, has q = 0.
        """
        return scale * np.exp(outputs) if self.relative else outputs


def _paper(windows: Array) -> tuple[Array, Array]:
    return features(windows), np.ones(len(windows))


def _window(windows: Array) -> tuple[Array, Array]:
    return windows, np.ones(len(windows))


def _scaled_window(windows: Array) -> tuple[Array, Array]:
    """Residuals around a polynomial of degree 5, divided by their spread; 0 for zero residuals.

    The polynomial follows the motion at much smaller noise than a straight line does.
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


#: Feature schemas by their names on cards.
SCHEMAS: Mapping[str, Schema] = MappingProxyType(
    {
        "bands": Schema(
            BAND_FEATURE_NAMES,
            band_features,
            relative=True,
            min_samples=BANDS_WINDOW,
            history=HISTORY,
            pooling=True,
            bounds=band_bounds,
        ),
        "default": Schema(
            RESIDUAL_FEATURE_NAMES,
            residual_features,
            relative=True,
            min_samples=MIN_RESIDUAL_SAMPLES,
        ),
        "paper": Schema(FEATURE_NAMES, _paper, relative=False, min_samples=MIN_SAMPLES),
        "scaled_window": Schema((), _scaled_window, relative=True, min_samples=DEGREE + 2),
        "taught": Schema(
            GROUP_FEATURE_NAMES,
            group_features,
            relative=True,
            min_samples=BANDS_WINDOW,
            history=HISTORY,
            pooling=True,
        ),
        "window": Schema((), _window, relative=False, min_samples=1),
    }
)
