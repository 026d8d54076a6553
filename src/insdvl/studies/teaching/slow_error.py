"""The slow error of the DVL: sigma and time constant that recordings tell, or that they do not.

A slow error of a few seconds looks like noise of a ping, one of minutes like process noise or like
a constant. So it is found with both (fit.py), and told only where recordings that were left out are
predicted better with it than without, and where they say more of its numbers than the prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.studies.teaching.fit import DVL_SPREAD, Bands, dvl_factors, fit, log_likelihood
from insdvl.studies.teaching.teach import BANDS, Fits, divided

#: Gain in log likelihood of the recordings that were left out: they are 20 times as probable.
LEAST_GAIN = float(np.log(20.0))
#: Largest standard error of a logarithm: the recordings say as much of it as the prior does.
LARGEST_SIGMA = DVL_SPREAD / np.sqrt(2.0)

_NAMES = "sigma", "time constant"


@dataclass(frozen=True, eq=False)
class SlowError:
    """What is learned of the slow error of a DVL.

    Attributes:
        bias_std: (3,) stationary sigma in DVL axes [m/s], as ``dvl.bias_std``.
        time_constant: [s], as ``dvl.bias_time_constant``.
        sigma: (2,) standard errors of the logarithms of both.
        noise: Factor on the configured sigma of a ping, and the standard error of its logarithm.
        gain: By stretch of the voyage that was left out, log likelihood with a slow error less that
            without.
        refused: Why nothing is told; empty where it is.
    """

    bias_std: Array
    time_constant: float
    sigma: Array
    noise: tuple[float, float]
    gain: Array
    refused: str

    @property
    def card(self) -> dict[str, Any]:
        """Of the model."""
        gain = {"left_out_gain": self.gain.tolist()}
        if self.refused:
            return {"refused": self.refused, **gain}
        return {
            "bias_model": "gauss_markov",
            "bias_std": self.bias_std.tolist(),
            "bias_time_constant": self.time_constant,
            "standard_error_of_log": dict(zip(_NAMES, self.sigma.tolist(), strict=True)),
            **gain,
        }

    @property
    def lines(self) -> tuple[str, ...]:
        """The same for people; the last ones are the parameters of the filter in YAML."""
        if self.refused:
            return (f"slow error of the DVL: nothing is told. {self.refused}",)
        factor, sigma = self.noise
        of_std, of_time = np.exp(self.sigma)
        return (
            f"slow error of the DVL: {self.gain.sum():+.1f} in log likelihood of the recordings "
            f"left out, better on {int(np.sum(self.gain > 0.0))} of {len(self.gain)}. Beside it, "
            f"the white noise of a ping is {factor:.2f} times the configured one (standard error: "
            f"a factor {np.exp(sigma):.2f})",
            "/**/insdvl_filter:",
            "  ros__parameters:",
            "    dvl:",
            "      bias_model: gauss_markov",
            f"      bias_std: [{', '.join(f'{std:.5f}' for std in self.bias_std)}]"
            f"  # m/s, DVL axes; standard error: a factor {of_std:.2f}",
            f"      bias_time_constant: {self.time_constant:.1f}"
            f"  # s; standard error: a factor {of_time:.2f}",
        )


def slow_error_of(fits: Fits) -> SlowError:
    """Sigma and time constant of the slow error of a DVL.

    All axes have one factor on the nominal sigma: that of the configuration, or a share of the
    sigma of a ping, in the mean of the recordings. The process noise is that of the bands, which
    need not be good enough for a model.
    """
    found = fits.found
    noise, factor, time_factor = dvl_factors(fits.family, found.numbers)
    variances = [np.square(lesson.stretch.slow_std) for lesson in fits.lessons]
    weights = [lesson.count for lesson in fits.lessons]
    bias_std = factor * np.sqrt(np.average(variances, axis=0, weights=weights))
    of_noise, *of_slow = found.sigma[-3:].tolist()
    gain = fits.held[BANDS] - _without(fits)
    return SlowError(
        bias_std,
        time_factor * fits.lessons[0].stretch.time_constant,
        np.array(of_slow),
        (noise, of_noise),
        gain,
        _refusal(float(gain.sum()), of_slow),
    )


def _without(fits: Fits) -> Array:
    """Log likelihood of the recordings of each stretch, by fits without a slow error."""
    held = []
    for others, test in divided(fits.lessons, fits.part):
        family = Bands(others, slow=False)
        numbers = fit(family, others, fits.found.numbers[: len(family.mean)]).numbers
        held.append(log_likelihood(family, test, numbers))
    return np.array(held)


def _refusal(gain: float, sigma: Sequence[float]) -> str:
    if gain < LEAST_GAIN:
        return (
            "With one, the recordings that were left out are predicted no better than without: "
            f"{gain:+.1f} in log likelihood, at least {LEAST_GAIN:+.1f} is needed"
        )
    unknown = [
        f"its {name} (standard error of the logarithm {value:.2f}, before: {DVL_SPREAD:.2f})"
        for name, value in zip(_NAMES, sigma, strict=True)
        if value > LARGEST_SIGMA
    ]
    if not unknown:
        return ""
    return (
        f"There is one, {gain:+.1f} in log likelihood of the recordings left out, but they do not "
        f"say enough of {' and '.join(unknown)}; {LARGEST_SIGMA:.2f} is needed. Recordings that "
        "are long against the time constant say more"
    )
