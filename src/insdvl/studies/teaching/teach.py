"""From lessons to a model: fit, test on what was left out, and refusal.

Of three answers that are fitted without a recording, the one that predicts its pings best is
taught: weights of the bands; a constant; or neither, where the simulated vehicles alone do as well.
"""

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.studies.results.recordings import stretches
from insdvl.studies.teaching.fit import (
    Bands,
    Constant,
    Family,
    Fit,
    Fixed,
    dvl_factors,
    fit,
    log_likelihood,
)
from insdvl.studies.teaching.lesson import Lesson
from insdvl.tuner.features.band_groups import GROUP_FEATURE_NAMES
from insdvl.tuner.features.bands import WINDOW
from insdvl.tuner.weights import Weights
from insdvl.tuner.windows import pool_of

#: Answers, as in the card.
BANDS, CONSTANT = "bands", "constant"
#: What they are compared with: the mean of the prior, and the variances of the configuration.
SIMULATED, CONFIGURED = "simulated vehicles", "configuration"
#: Names of the groups of channels.
GROUPS = ("accelerometers", "gyroscopes")
#: Largest standard error of log q that still is an answer: a factor e, which costs about 3 % of
#: the RMSE of the velocity.
LARGEST_SIGMA = 1.0
#: Fewer pings that count are too few for any answer.
FEWEST = 100


class TeachingError(ValueError):
    """The recordings do not say enough."""


@dataclass(frozen=True, eq=False)
class Taught:
    """What was learned.

    Attributes:
        answer: `BANDS` or `CONSTANT`.
        regressor: The weights of the model.
        card: Of the model, without name and hash.
        lines: The same for people.
    """

    answer: str
    regressor: Weights
    card: dict[str, Any]
    lines: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Fits:
    """Fits to the recordings of a vehicle, not judged yet.

    Attributes:
        lessons: The recordings.
        part: (number of lessons,) which stretch of the voyage each is of.
        family: Of the bands.
        found: Their fit to all lessons.
        held: By answer, log likelihood of the recordings of each stretch, fitted without them.
    """

    lessons: Sequence[Lesson]
    part: NDArray[np.int64]
    family: Bands
    found: Fit
    held: dict[str, Array]


def fits_of(lessons: Sequence[Lesson], say: Callable[[str], None] = lambda _: None) -> Fits:
    """Fit all answers, to all recordings and to all but each.

    Args:
        lessons: Recordings of a vehicle.
        say: Called with messages of progress.

    Raises:
        TeachingError: There are too few; the message tells what is missing.
    """
    count = sum(lesson.count for lesson in lessons)
    if count < FEWEST:
        raise TeachingError(
            f"the {len(lessons)} recordings have {count} measurements of the DVL that count; "
            f"at least {FEWEST} are needed"
        )
    part = stretches(lessons)
    if len(np.unique(part)) < 2:
        raise TeachingError(
            "recordings of two different stretches are needed, one to teach and one to test; got "
            f"{len(lessons)} of one"
        )
    family = Bands(lessons)
    found = fit(family, lessons)
    say(f"weights fitted to {count} measurements of the DVL")
    held = _held_out(lessons, part, found)
    for answer, values in held.items():
        say(f"left out, {answer}: log likelihood {values.sum():.1f}")
    return Fits(lessons, part, family, found, held)


def teach(fits: Fits) -> Taught:
    """The weights of a vehicle.

    Raises:
        TeachingError: The recordings do not say enough; the message tells what is missing.
    """
    lessons, family, found, held = fits.lessons, fits.family, fits.found, fits.held
    spreads = _spreads(family, lessons, found)
    if min(after for _, after in spreads) > LARGEST_SIGMA:
        told = ", ".join(
            f"{group} {after:.2f} (before: {before:.2f})"
            for group, (before, after) in zip(GROUPS, spreads, strict=True)
        )
        raise TeachingError(
            f"the recordings do not say enough: the standard error of log q is {told}; below "
            f"{LARGEST_SIGMA:g} of one group is needed. Longer recordings or a better DVL say more"
        )
    total = {answer: float(values.sum()) for answer, values in held.items()}
    answer = max((BANDS, CONSTANT), key=lambda name: total[name])
    if total[answer] <= total[SIMULATED]:
        raise TeachingError(
            "the recordings do not say enough: those that were left out are predicted no better "
            f"than by the weights of simulated vehicles (log likelihood {total[answer]:.1f} "
            f"against {total[SIMULATED]:.1f})"
        )
    regressor = _of_bands(family, lessons, found) if answer == BANDS else constant_of(lessons)
    card = {
        "kind": "weights",
        "feature_schema": "taught",
        "features": list(GROUP_FEATURE_NAMES),
        "target": "logarithm of the effective variance per sample over the least band of `near`",
        "window": WINDOW,
        "teacher": {
            "recordings": {lesson.name: lesson.count for lesson in lessons},
            "answer": answer,
            "left_out_log_likelihood": {
                name: dict(zip(_parts(fits), values.tolist(), strict=True))
                for name, values in held.items()
            },
            "weights": {
                group: {
                    name: {"prior": [mean, spread], "posterior": [number, sigma]}
                    for name, mean, spread, number, sigma in _table(family, found, k)
                }
                for k, group in enumerate(GROUPS)
            },
            "sigma_of_log_q": {
                group: {"before": before, "after": after}
                for group, (before, after) in zip(GROUPS, spreads, strict=True)
            },
            "factor_on_dvl_sigma": dvl_factors(family, found.numbers)[0],
        },
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
        },
    }
    return Taught(answer, regressor, card, tuple(_lines(family, found, spreads, held, answer)))


def constant_of(lessons: Sequence[Lesson]) -> Weights:
    """The best constant: the level alone, with the weight that cancels the scale.

    A model sees means of k samples, and the tuner takes k times its variance for that of a sample.

    Raises:
        TeachingError: The IMUs have different rates: a variance per sample is not one number then.
    """
    rates = [1.0 / lesson.stretch.interval for lesson in lessons]
    pools = {pool_of(rate) for rate in rates}
    if len(pools) > 1:
        raise TeachingError(
            f"a constant for IMUs of {min(rates):.4g} to {max(rates):.4g} Hz is not one variance "
            "per sample: teach from recordings of one rate"
        )
    weights = np.zeros((len(GROUPS), len(GROUP_FEATURE_NAMES) + 1))
    weights[:, 0] = fit(Constant(lessons), lessons).numbers[: len(GROUPS)] - np.log(pools.pop())
    weights[:, -1] = -1.0
    return _limited(weights, lessons)


def _spreads(family: Bands, lessons: Sequence[Lesson], found: Fit) -> list[tuple[float, float]]:
    """Standard error of log q of each group at the mean features, of prior and posterior."""
    A = np.concatenate([family.features(lesson.X) for lesson in lessons])
    x = A.reshape(len(A), len(GROUPS), -1, A.shape[-1]).mean(axis=(0, 2))
    spreads = []
    for k, of_group in enumerate(x):
        own = slice(k * family.size, (k + 1) * family.size)
        before, after = (
            float(np.sqrt(of_group @ covariance[own, own] @ of_group))
            for covariance in (family.covariance, found.covariance)
        )
        spreads.append((before, after))
    return spreads


def divided(
    lessons: Sequence[Lesson], part: NDArray[np.int64]
) -> Iterator[tuple[list[Lesson], list[Lesson]]]:
    """For each stretch, the lessons of all others, and its own."""
    for own in np.unique(part):
        others = [lesson for lesson, k in zip(lessons, part, strict=True) if k != own]
        yield others, [lesson for lesson, k in zip(lessons, part, strict=True) if k == own]


def _held_out(lessons: Sequence[Lesson], part: NDArray[np.int64], found: Fit) -> dict[str, Array]:
    """Log likelihood of the recordings of each stretch, by answers fitted without them."""
    held: dict[str, list[float]] = {BANDS: [], CONSTANT: [], SIMULATED: [], CONFIGURED: []}
    for others, test in divided(lessons, part):
        bands = Bands(others)
        families: dict[str, tuple[Family, Array | None]] = {
            BANDS: (bands, found.numbers),
            CONSTANT: (Constant(others), None),
            SIMULATED: (Fixed(partial(bands.variances, numbers=bands.mean)), None),
            CONFIGURED: (Fixed(lambda x: np.tile(x.nominal, (len(x.scale), 1))), None),
        }
        for answer, (family, start) in families.items():
            numbers = fit(family, others, start).numbers
            held[answer].append(log_likelihood(family, test, numbers))
    return {answer: np.array(values) for answer, values in held.items()}


def _parts(fits: Fits) -> list[str]:
    """Names of the recordings of each stretch."""
    return [
        "+".join(lesson.name for lesson, k in zip(fits.lessons, fits.part, strict=True) if k == own)
        for own in np.unique(fits.part)
    ]


def _of_bands(family: Bands, lessons: Sequence[Lesson], found: Fit) -> Weights:
    """The model of weights of the bands."""
    weights = family.of_groups(found.numbers).copy()
    weights[:, 0] -= weights[:, -1] * family.levels
    return _limited(weights, lessons)


def _limited(weights: Array, lessons: Sequence[Lesson]) -> Weights:
    """A model whose outputs stay within those of the lessons."""
    X = np.concatenate([lesson.X for lesson in lessons])
    X = X.reshape(len(X), len(GROUPS), -1, X.shape[-1])
    outputs = weights[:, :1, None] + np.einsum("kgcf,gf->gkc", X, weights[:, 1:])
    outputs = outputs.reshape(len(GROUPS), -1)
    return Weights(weights, np.stack([outputs.min(axis=1), outputs.max(axis=1)], axis=1))


def _table(family: Bands, found: Fit, group: int) -> list[tuple[str, float, float, float, float]]:
    """Name, mean and sigma of the prior, and of the posterior, of the weights of a group."""
    own = slice(group * family.size, (group + 1) * family.size)
    prior_sigma = np.sqrt(np.diagonal(family.covariance))
    columns = (family.mean, prior_sigma, found.numbers, found.sigma)
    rows = zip(*(column[own].tolist() for column in columns), strict=True)
    names = ("constant", *GROUP_FEATURE_NAMES)
    return [(name, *row) for name, row in zip(names, rows, strict=True)]


def _lines(
    family: Bands,
    found: Fit,
    spreads: list[tuple[float, float]],
    held: dict[str, Array],
    answer: str,
) -> list[str]:
    lines = []
    for k, group in enumerate(GROUPS):
        lines.append(f"{group + ', weight':32} {'simulated vehicles':>20} {'taught':>18}")
        lines += [
            f"  {name:30} {mean:11.2f} +- {spread:5.2f} {number:9.2f} +- {sigma:5.2f}"
            for name, mean, spread, number, sigma in _table(family, found, k)
        ]
        before, after = spreads[k]
        enough = "" if after <= LARGEST_SIGMA else ": the simulated vehicles say most of it"
        lines.append(f"  {'standard error of log q':30} {before:20.2f} {after:18.2f}{enough}")
    for name in (SIMULATED, CONFIGURED, CONSTANT):
        gain = held[BANDS] - held[name]
        error = float(np.sqrt(len(gain) * np.var(gain, ddof=1)))
        lines.append(
            f"left out, bands over {name}: {gain.sum():+.1f} +- {error:.1f} in log likelihood, "
            f"better on {int(np.sum(gain > 0.0))} of {len(gain)}"
        )
    if not found.converged:
        lines.append("The fit of the bands has not come to its end: its numbers are preliminary.")
    if answer == CONSTANT:
        lines.append(
            "The bands do not predict a recording that was left out better than a constant: the "
            "constant is taught."
        )
    return lines
