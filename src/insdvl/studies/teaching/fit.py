"""The likelihood of the pings as a function of a few numbers, and its maximum.

A family says how the process noise follows from the numbers: `Bands` from the features, `Constant`
not at all. Both have numbers of the DVL behind these: of the sigma of a ping, and of sigma and time
constant of its slow error. The posterior is maximised by Fisher scoring: the information of
innovations nu with covariances S is

    I_ab = sum d_a nu^T S^-1 d_b nu + tr(S^-1 d_a S S^-1 d_b S) / 2

and needs first derivatives alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from insdvl.arrays import Array
from insdvl.studies.teaching.lesson import Lesson
from insdvl.studies.teaching.prior import prior
from insdvl.studies.teaching.residuals import innovations
from insdvl.tuner.windows import CHANNELS

#: Of the DVL, each the logarithm of a factor on what is nominal.
DVL_NUMBERS = (
    "log sigma of the DVL",
    "log sigma of its slow error",
    "log time constant of its slow error",
)
#: One sigma of each, in the prior.
DVL_SPREAD = 1.0
#: Of log q of a constant about the mean of the least band: any value is as good as another.
CONSTANT_SPREAD = 5.0

_TRIAD = CHANNELS // 2
_DIFFERENCE = 1e-4  # of the numerical derivatives
_TOLERANCE = 0.02  # of the logarithm of the posterior
_MOST_STEPS = 30
_LONGEST_STEP = 4.0  # of each number


class Family(Protocol):
    """How the process noise follows from numbers (d,); the last ones are those of the DVL.

    Attributes:
        mean: (d,) of the prior.
        covariance: (d, d) of the prior.
        slow: Whether the DVL has a slow error: all `DVL_NUMBERS`, or the first alone.
    """

    mean: Array
    covariance: Array
    slow: bool

    def variances(self, lesson: Lesson, numbers: Array) -> Array:
        """Variances per sample (K, 6) at the windows of a lesson."""


class Bands:
    """Weights of the bands, see band_groups.py: constant and weights of both groups of channels.

    Args:
        lessons: Their mean level is that of the vehicle.
        slow: See `Family`.
    """

    def __init__(self, lessons: Sequence[Lesson], *, slow: bool = True) -> None:
        self.slow = slow
        levels = np.concatenate([lesson.X[:, :, -1] for lesson in lessons])
        self.levels = levels.reshape(len(levels), 2, _TRIAD).mean(axis=(0, 2))
        mean, covariance = prior()
        self.size = mean.shape[1]
        of_dvl, spread = _of_dvl(slow)
        self.mean = np.concatenate([*mean, of_dvl])
        self.covariance = _blocks([*covariance, spread])

    def variances(self, lesson: Lesson, numbers: Array) -> Array:
        """See `Family`."""
        weights = np.repeat(self.of_groups(numbers), _TRIAD, axis=0)
        return np.asarray(
            lesson.scale * np.exp(np.einsum("kcd,cd->kc", self.features(lesson.X), weights))
        )

    def features(self, X: Array) -> Array:
        """Ones and features (K, 6, D); the level is that over the vehicle's."""
        A = np.concatenate([np.ones((*X.shape[:-1], 1)), X], axis=-1)
        A[:, :, -1] -= np.repeat(self.levels, _TRIAD)
        return A

    def of_groups(self, numbers: Array) -> Array:
        """(2, D) constant and weights of the accelerometers and of the gyroscopes."""
        return numbers[: 2 * self.size].reshape(2, self.size)


class Constant:
    """A variance of the accelerometers and one of the gyroscopes.

    Args:
        lessons: Their mean level is the middle of the prior.
        slow: See `Family`.
    """

    def __init__(self, lessons: Sequence[Lesson], *, slow: bool = True) -> None:
        self.slow = slow
        of_dvl, spread = _of_dvl(slow)
        self.mean = np.concatenate([Bands(lessons).levels, of_dvl])
        self.covariance = _blocks([CONSTANT_SPREAD**2 * np.eye(2), spread])

    def variances(self, lesson: Lesson, numbers: Array) -> Array:
        """See `Family`."""
        return np.tile(np.exp(np.repeat(numbers[:2], _TRIAD)), (len(lesson.scale), 1))


class Fixed:
    """A process noise that is known; only the numbers of the DVL are found.

    Args:
        variances: Variances per sample (K, 6) at the windows of a lesson.
    """

    def __init__(self, variances: Callable[[Lesson], Array]) -> None:
        self._variances = variances
        self.slow = True
        self.mean, self.covariance = _of_dvl(self.slow)

    def variances(self, lesson: Lesson, numbers: Array) -> Array:
        """See `Family`."""
        return self._variances(lesson)


@dataclass(frozen=True, eq=False)
class Fit:
    """The maximum of a posterior.

    Attributes:
        numbers: (d,) where it is.
        covariance: (d, d) of the posterior: prior and expected information there.
        converged: Whether the maximum was reached.
    """

    numbers: Array
    covariance: Array
    converged: bool

    @property
    def sigma(self) -> Array:
        """(d,) standard errors."""
        return np.sqrt(np.diagonal(self.covariance))


def dvl_factors(family: Family, numbers: Array) -> tuple[float, float, float]:
    """Factors on the nominal sigma of the DVL, sigma and time constant of its slow error."""
    if not family.slow:
        return float(np.exp(numbers[-1])), 0.0, 1.0
    r, slow, time_constant = np.exp(numbers[-len(DVL_NUMBERS) :])
    return float(r), float(slow), float(time_constant)


def log_likelihoods(family: Family, lesson: Lesson, numbers: Array) -> Array:
    """(m,) of the pings that count."""
    nu, S = _scored(family, lesson, numbers)
    solved = np.linalg.solve(S, nu[:, :, None])[:, :, 0]
    log_det = np.linalg.slogdet(2.0 * np.pi * S)[1]
    return np.asarray(-0.5 * (np.sum(nu * solved, axis=1) + log_det))


def log_likelihood(family: Family, lessons: Sequence[Lesson], numbers: Array) -> float:
    """Of all pings that count."""
    return float(sum(log_likelihoods(family, lesson, numbers).sum() for lesson in lessons))


def fit(family: Family, lessons: Sequence[Lesson], start: Array | None = None) -> Fit:
    """Maximise the posterior.

    Args:
        family: With the prior.
        lessons: The recordings.
        start: (d,) numbers to start from; the mean of the prior by default.
    """
    precision = np.linalg.inv(family.covariance)
    numbers = np.array(family.mean if start is None else start)

    def posterior(at: Array) -> float:
        off = at - family.mean
        return log_likelihood(family, lessons, at) - 0.5 * float(off @ precision @ off)

    value, converged = posterior(numbers), False
    information = precision
    for _ in range(_MOST_STEPS):
        gradient, information = slope(family, lessons, numbers)
        gradient = gradient - precision @ (numbers - family.mean)
        information = information + precision
        step = np.linalg.solve(information, gradient)
        if 0.5 * float(gradient @ step) < _TOLERANCE:
            converged = True
            break
        step *= min(1.0, _LONGEST_STEP / float(np.abs(step).max()))
        for _ in range(8):
            reached = posterior(numbers + step)
            if reached > value:
                break
            step /= 2.0
        else:  # the slope has no better point: at a bound
            converged = True
            break
        gained = reached - value
        numbers, value = numbers + step, reached
        if gained < _TOLERANCE:
            converged = True
            break
    return Fit(numbers, np.linalg.inv(information), converged)


def _scored(family: Family, lesson: Lesson, numbers: Array) -> tuple[Array, Array]:
    q = family.variances(lesson, numbers)
    found = innovations(lesson.stretch, q, *dvl_factors(family, numbers))
    return found.nu[lesson.scored], found.S[lesson.scored]


def slope(family: Family, lessons: Sequence[Lesson], numbers: Array) -> tuple[Array, Array]:
    """Gradient (d,) of the log likelihood and its expected information (d, d).

    The derivatives of nu and S are differences of runs of the small filter.
    """
    d = len(numbers)
    gradient, information = np.zeros(d), np.zeros((d, d))
    for lesson in lessons:
        nu, S = _scored(family, lesson, numbers)
        inverse = np.linalg.inv(S)
        lower = np.linalg.cholesky(inverse)  # S^-1 = L L^T
        d_nu, d_S = np.empty((d, *nu.shape)), np.empty((d, *S.shape))
        for k in range(d):
            moved = numbers.copy()
            moved[k] += _DIFFERENCE
            nu_k, S_k = _scored(family, lesson, moved)
            d_nu[k], d_S[k] = (nu_k - nu) / _DIFFERENCE, (S_k - S) / _DIFFERENCE
        # In units of one sigma.
        of_nu = np.einsum("mji,amj->ami", lower, d_nu)
        of_S = np.einsum("mji,amjk,mkl->amil", lower, d_S, lower)
        white = np.einsum("mji,mj->mi", lower, nu)
        gradient -= np.einsum("ami,mi->a", of_nu, white)
        gradient -= 0.5 * np.einsum("amii->a", of_S)
        gradient += 0.5 * np.einsum("mi,amij,mj->a", white, of_S, white)
        information += np.einsum("ami,bmi->ab", of_nu, of_nu)
        information += 0.5 * np.einsum("amij,bmij->ab", of_S, of_S)
    return gradient, information


def _of_dvl(slow: bool) -> tuple[Array, Array]:
    """Mean and covariance of the prior of the numbers of the DVL."""
    size = len(DVL_NUMBERS) if slow else 1
    return np.zeros(size), DVL_SPREAD**2 * np.eye(size)


def _blocks(matrices: Sequence[Array]) -> Array:
    size = sum(len(matrix) for matrix in matrices)
    out, at = np.zeros((size, size)), 0
    for matrix in matrices:
        out[at : at + len(matrix), at : at + len(matrix)] = matrix
        at += len(matrix)
    return out
