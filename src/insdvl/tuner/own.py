"""An estimator of your own: a function of another package, in place of a model.

It is named as ``PACKAGE.MODULE:FUNCTION``, and is given samples and the rate of the IMU:

    def variances(samples, rate):
        return samples[-200:].var(axis=0)

`samples` is (N, 6) in stamp order, specific force x, y, z [m/s^2] and angular rate x, y, z [rad/s]
in the axes of the IMU; N is 200 at first, and grows without a gap to 2000. `rate` [Hz] is that of
their stamps. The answer is six variances per sample of white noise, in the squares of these units,
each finite and not negative.
"""

import inspect
from collections.abc import Callable
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.files import shown
from insdvl.tuner.windows import CHANNELS

WINDOW, HISTORY = 200, 2000  # samples, the least and the largest number that it is given

_TRIAL_RATE = 100.0  # Hz
_TRIAL_SIGMA = np.repeat([0.1, 1e-3], 3)  # m/s^2, rad/s


class EstimatorError(ValueError):
    """An estimator is not there, fails, or answers what is no variance."""


class OwnEstimator:
    """A function that estimates the variances of an IMU's noise, with its answers checked.

    Attributes:
        name: ``PACKAGE.MODULE:FUNCTION``.
    """

    def __init__(self, name: str) -> None:
        """Import the function, and call it once with white noise.

        Raises:
            EstimatorError: The name has another form, there is no such module or function, or the
                function fails in the trial.
        """
        self.name = name
        self._function = _function(name)
        rng = np.random.default_rng(0)
        self(_TRIAL_SIGMA * rng.standard_normal((WINDOW, CHANNELS)), _TRIAL_RATE)

    def __call__(self, samples: Array, rate: float) -> Array:
        """Variances per sample (6,) from samples (N, 6) at a rate [Hz].

        Raises:
            EstimatorError: The function raised, or its answer is not six finite numbers >= 0.
        """
        try:
            answer = np.array(self._function(samples, rate), dtype=np.float64)
        except Exception as error:  # what others write may raise anything
            raise EstimatorError(
                f"estimator {self.name!r} failed: {type(error).__name__}: {error}"
            ) from error
        if answer.shape != (CHANNELS,):
            raise EstimatorError(
                f"estimator {self.name!r} must answer {CHANNELS} variances, got an array of shape "
                f"{answer.shape}"
            )
        if not (np.isfinite(answer) & (answer >= 0.0)).all():
            raise EstimatorError(
                f"estimator {self.name!r} must answer finite variances >= 0, got {answer.tolist()}"
            )
        return answer

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the file of the function; of its name where it has none."""
        try:
            source = Path(inspect.getfile(self._function)).read_bytes()
        except (TypeError, OSError):
            source = self.name.encode()
        return sha256(source).hexdigest()


def _function(name: str) -> Callable[[Array, float], Any]:
    module_name, _, path = name.partition(":")
    if not (all(map(str.isidentifier, module_name.split("."))) and path.isidentifier()):
        raise EstimatorError(f"estimator must be PACKAGE.MODULE:FUNCTION, got {shown(name)}")
    try:
        module = import_module(module_name)
    except Exception as error:  # so may a module that is imported
        raise EstimatorError(
            f"estimator {name!r}: cannot import {module_name}: {type(error).__name__}: {error}"
        ) from error
    function: Callable[[Array, float], Any] | None = getattr(module, path, None)
    if not callable(function):
        raise EstimatorError(f"estimator {name!r}: {module_name} has no function {path!r}")
    return function
