"""A factor on the covariance of a measurement's noise, by the probabilities of its levels.

The noise n of a measurement has the covariance lambda R_0. The innovation is nu = n + e, where e
has the covariance M = H P H^T and what else is known. lambda stays for a time and then jumps, as
above another bottom: a hidden Markov chain over a grid of levels, whose filter is exact. Each
innovation multiplies the probabilities by its likelihoods.

The state is corrected once, with the mean of the gains that the levels would give, and with the
covariance of the mixture of their posteriors (generalised pseudo-Bayesian of the first order;
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
section 11.6).
"""

from math import log
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel

#: The levels of lambda: from `SMALLEST` to `LARGEST`, six in a decade.
SMALLEST, LARGEST = 1e-4, 100.0
LEVELS = np.geomspace(SMALLEST, LARGEST, 37)
#: Mean time between jumps [s].
STAY = 30.0
#: Spread of log lambda behind a jump: the nominal sigma is right to a factor of 1.6.
SPREAD = 1.0
#: Between jumps log lambda drifts by so much in a second.
DRIFT = 0.1
#: Beliefs about a jump, and before anything was learned.
PRIOR = np.exp(-0.5 * (np.log(LEVELS) / SPREAD) ** 2)
PRIOR /= PRIOR.sum()
#: Variance of e, in units of R_0, below which nothing can be told from its gain.
_LEAST_KNOWN = 1e-9
_STEP = log(LEVELS[1] / LEVELS[0])


class Whitened(NamedTuple):
    """An innovation in the axes in which R_0 is the identity and M is diagonal.

    Attributes:
        squares: (m,) of the innovation's components.
        known: (m,) variances of e.
    """

    squares: Array
    known: Array


class Factors(NamedTuple):
    """Of one measurement, on R_0.

    Attributes:
        gain: The covariance with which its gain is the mean of those of the levels.
        covariance: That with which the corrected covariance is that of the mixture; not smaller.
    """

    gain: float
    covariance: float


def whitened(innovation: Array, M: Array, R_0: Array) -> Whitened | None:
    """An innovation (m,) of noise R_0 (m, m) and other error M (m, m).

    None where R_0 is not positive definite, or so small that no number holds their ratio.
    """
    try:
        L_inv = np.linalg.inv(np.linalg.cholesky(R_0))
    except np.linalg.LinAlgError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        of_noise, nu = L_inv @ M @ L_inv.T, L_inv @ innovation
        is_finite = np.isfinite(of_noise).all() and np.isfinite(nu @ nu)
    if not is_finite:
        return None
    known, axes = np.linalg.eigh(of_noise)
    return Whitened(np.square(axes.T @ nu), np.maximum(known, _LEAST_KNOWN))


@kernel
def moved(probabilities: Array, seconds: float) -> Array:
    """The probabilities (37,) after a time [s]."""
    jump = 1.0 - np.exp(-seconds / STAY)
    drift = min(0.5 * seconds * (DRIFT / _STEP) ** 2, 1.0 / 3.0)
    n = len(probabilities)
    after = np.empty(n)
    for i in range(n):
        here = probabilities[i]
        change = probabilities[max(i - 1, 0)] + probabilities[min(i + 1, n - 1)] - 2.0 * here
        after[i] = (1.0 - jump) * (here + drift * change) + jump * PRIOR[i]
    return after


def learned(probabilities: Array, innovation: Whitened, low: float) -> tuple[Array, Factors]:
    """The probabilities (37,) after an innovation, and the factors for its measurement.

    Args:
        probabilities: Before it.
        innovation: The innovation.
        low: Smallest factor; a level below it counts as it.
    """
    after, levels = np.empty(LEVELS.size), np.maximum(LEVELS, low)
    return after, Factors(*_learn(after, probabilities, levels, *innovation))


@kernel
def _learn(
    after: Array, before: Array, levels: Array, squares: Array, known: Array
) -> tuple[float, float]:
    """Bayes' rule, and the factors of gain and covariance.

    In an axis with the known variance d a level has the gain k_i = d / (d + lambda_i). The mean
    gain k is that of the factor d (1 - k) / k, of which the axes have a mean with the weights k.
    A correction with the gain k has, as the covariance of the mixture, that of Joseph's form with
    sum_i p_i (lambda_i + ((k_i - k) / k)^2 (nu^2 - d - lambda_i)).
    """
    n, m = len(levels), len(squares)
    largest = -np.inf
    for i in range(n):
        after[i] = 0.0
        for j in range(m):
            variance = levels[i] + known[j]
            after[i] -= 0.5 * (np.log(variance) + squares[j] / variance)
        largest = max(largest, after[i])
    total = 0.0
    for i in range(n):
        after[i] = before[i] * np.exp(after[i] - largest)
        total += after[i]
    for i in range(n):
        # All that was believed may be so improbable now that nothing is left of it.
        after[i] = after[i] / total if total > 0.0 else PRIOR[i]
    numerator, gains = 0.0, 0.0
    for j in range(m):
        for i in range(n):
            k = known[j] / (known[j] + levels[i])
            gains += after[i] * k
            numerator += after[i] * k * levels[i]  # d (1 - k_i), without the difference
    factor, spread = numerator / gains, 0.0
    for j in range(m):
        k = known[j] / (known[j] + factor)
        for i in range(n):
            off = known[j] / (known[j] + levels[i]) / k - 1.0
            spread += after[i] * (levels[i] + off * off * (squares[j] - known[j] - levels[i]))
    return factor, max(spread / m, factor)
