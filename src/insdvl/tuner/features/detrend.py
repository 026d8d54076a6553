"""Residual of a window around its least-squares polynomial.

The motion of the vehicle is smooth over a window, and the polynomial follows it. The sum of squares
of the residual of white noise is q times a chi-square variable with N - degree - 1 degrees of
freedom, with q the variance of the noise.
"""

from functools import lru_cache

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel

#: A std up to this fraction of the window's largest |x| is rounding: 50 times that of one sample.
ROUNDING = 1e-14
#: A smaller std counts as zero, and larger values are rejected: fourth powers stay in range.
TINY, HUGE = 1e-70, 1e70


@lru_cache(maxsize=32)
def polynomials(n: int, degree: int) -> Array:
    """Orthonormal polynomials (degree, n) of degrees 1 to `degree` on n equally spaced samples.

    Each is also orthogonal to a constant. They come from the three-term recurrence of the discrete
    Legendre polynomials, whose middle term is zero for symmetric samples.
    """
    t = np.linspace(-1.0, 1.0, n)
    rows = [np.full(n, 1.0 / np.sqrt(n))]
    for _ in range(degree):
        p = t * rows[-1]
        for _ in range(2):  # the second pass removes the rounding of the first
            for row in rows:
                p -= np.sum(p * row) * row
        rows.append(p / np.sqrt(np.sum(p * p)))
    basis = np.array(rows[1:]).reshape(degree, n)
    basis.setflags(write=False)
    return basis


def residual_variances(windows: Array, degree: int) -> Array:
    """Unbiased variance of white noise in each window, around a polynomial.

    Args:
        windows: (M, N), N > degree + 1.
        degree: Degree of the polynomial.

    Returns:
        (M,); 0 where the residual is at the rounding of the samples.

    Raises:
        ValueError: `windows` has another shape, or a value is not within 1e70 of zero.
    """
    windows = checked(windows, degree + 2)
    out = np.empty(windows.shape[0])
    _residual_variances(windows, polynomials(windows.shape[1], degree), out)
    return out


def checked(windows: Array, at_least: int) -> Array:
    """Windows (M, N) as contiguous float64.

    Raises:
        ValueError: They are not (M, N) with N >= `at_least`, or a value is not within 1e70 of zero.
    """
    windows = np.ascontiguousarray(windows, dtype=np.float64)
    if windows.ndim != 2 or windows.shape[1] < at_least:
        raise ValueError(f"windows must be (M, N) with N >= {at_least}, got {windows.shape}")
    usable = np.abs(windows) <= HUGE
    if not usable.all():
        m = int(np.argmin(usable.all(axis=1)))
        wrong = windows[m][~usable[m]][0]
        raise ValueError(f"window {m} has {wrong}: values must be within {HUGE:g} of zero")
    return windows


@kernel
def residual(x: Array, basis: Array, out: Array) -> float:
    """Residual of a window ``x`` (N,) around its polynomial, into ``out`` (N,).

    Args:
        x: Samples, finite.
        basis: (degree, N), see `polynomials`.
        out: The residual; all zeros where it is at the rounding of the samples.

    Returns:
        Its sum of squares.
    """
    N = x.size
    largest = 0.0
    total = 0.0
    for i in range(N):
        largest = max(largest, abs(x[i]))
        total += x[i]
    mean = total / N
    total = 0.0
    for i in range(N):
        out[i] = x[i] - mean
        total += out[i]
    mean = total / N  # the rounding error of the first sum, which is of large numbers
    for i in range(N):
        out[i] -= mean
    for k in range(basis.shape[0]):
        part = 0.0
        for i in range(N):
            part += basis[k, i] * out[i]
        for i in range(N):
            out[i] -= part * basis[k, i]
    squares = 0.0
    for i in range(N):
        squares += out[i] * out[i]
    if np.sqrt(squares / (N - 1)) <= max(ROUNDING * largest, TINY):
        out[:] = 0.0
        return 0.0
    return squares


@kernel
def _residual_variances(windows: Array, basis: Array, out: Array) -> None:
    """`residual_variances` of ``windows`` (M, N) into ``out`` (M,)."""
    M, N = windows.shape
    scratch = np.empty(N)
    for m in range(M):
        out[m] = residual(windows[m], basis, scratch) / (N - 1 - basis.shape[0])
