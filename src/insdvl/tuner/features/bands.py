"""Band powers of the last samples of a channel.

A filter needs the density of the noise at the lowest frequencies, where the motion of the vehicle
is too. The variance of the samples is the mean of the density over all frequencies. Band powers
tell the frequencies apart; see docs/explanation/learned-bands.md.

The last n samples of one channel are used, n being the largest multiple of 200 up to 2000 that
there are. Three spectra are formed of them, each of a stretch at the end:

* ``now``: the last 200 samples;
* ``near``: the mean of the spectra of 200 samples each, half overlapped, in the last 600;
* ``slow``: all n samples, low-passed and decimated by 10.

Of each stretch the polynomial of degree 5 is removed and a Hann window applied. A
power is that of white noise of the same density, so white noise has the variance of its samples
in all bands, whatever polynomial, window and low-pass do. Frequencies are in units of the sample
rate; those in the names of the bands are at 100 Hz.

A short history cannot tell the slowest bands. Each of them then has the power of the next faster
one.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.tuner.features.detrend import checked, polynomials, residual

WINDOW = 200  # samples of ``now``, and the least history
HISTORY = 2000  # samples, the longest history that is used
NEAR = 600  # samples of ``near``
DECIMATION, TAPS = 10, 60  # of ``slow``; the low-pass is a Blackman window, -58 dB from 5 Hz on
DEGREE = 5

#: Edges of the bands in units of the sample rate.
FAST_EDGES = (0.01, 0.0175, 0.0325, 0.0575, 0.1025, 0.1775, 0.2975, 0.5)
SLOW_EDGES = (0.001, 0.002, 0.004, 0.008, 0.016)
#: Numbers of bands.
FAST, SLOW = len(FAST_EDGES) - 1, len(SLOW_EDGES) - 1
#: Number of the lowest bands of ``now`` and ``near`` that no IMU filters: up to a tenth of the
#: sample rate. Many IMUs have a low-pass below half of it. Above its corner they show less than
#: their noise at the frequencies that count.
UNFILTERED = 4
#: Of powers, so that the logarithm of an empty band is finite.
SMALLEST_RATIO = 1e-12


class Bands(NamedTuple):
    """What is measured of M windows; variances per sample of white noise of the same density.

    Attributes:
        now: (M, 7) of the last window.
        near: (M, 7) of its surroundings.
        slow: (M, 4) of the history.
        spectrum: (M, B) of all frequencies of ``near``.
        variance: (M, 2) around the polynomial of degree 5, of the last window and the mean of those
            of ``near``.
    """

    now: Array
    near: Array
    slow: Array
    spectrum: Array
    variance: Array


@dataclass(frozen=True, eq=False)
class Transform:
    """Projections of a stretch on sines and cosines of whole periods.

    Attributes:
        rows: (D, 2 B) cosines, then sines, with window and without polynomial.
        norms: (B,) power of white noise of unit variance per sample.
        basis: The polynomials (degree, D).
        band: (B,) band of each frequency.
        bands: Number of bands.
        low_pass: (T,) weights; empty where the stretch is used as it is.
    """

    rows: Array
    norms: Array
    basis: Array
    band: NDArray[np.int64]
    bands: int
    low_pass: Array


@lru_cache(maxsize=16)
def transform(
    n: int, edges: tuple[float, ...] = FAST_EDGES, low_pass: tuple[float, ...] = ()
) -> Transform:
    """The transform of n samples, which are low-passed and decimated where there is a low-pass.

    Frequencies of less than two periods have too little left of them by the polynomial.
    """
    step = DECIMATION if low_pass else 1
    size = (n - len(low_pass)) // step + 1 if low_pass else n
    periods = np.arange(2, size // 2)
    frequencies = periods / (size * step)
    used = (frequencies >= edges[0] - 1e-9) & (frequencies < edges[-1] - 1e-9)
    periods, frequencies = periods[used], frequencies[used]
    phase = 2.0 * np.pi * np.outer(np.arange(size) + 0.5, periods) / size
    hann = np.sin(np.pi * (np.arange(size) + 0.5) / size)[:, None] ** 2
    rows = np.hstack([np.cos(phase), np.sin(phase)])
    basis = polynomials(size, DEGREE)
    # Orthogonal to the polynomials with the window as weight: so the rows still end at zero, and
    # vibration does not leak into the slow bands.
    removed: list[Array] = []
    for polynomial in (np.full(size, 1.0 / np.sqrt(size)), *basis):
        p = polynomial[:, None].copy()
        for q in removed:
            p -= np.sum(hann * q * p) * q
        removed.append(p / np.sqrt(np.sum(hann * p * p)))
    for p in removed:
        rows -= p * np.sum(hann * p * rows, axis=0)
    rows *= hann
    samples = rows
    if low_pass:
        samples = np.zeros((n, rows.shape[1]))
        for i in range(size):
            samples[i * step : i * step + len(low_pass)] += np.outer(low_pass, rows[i])
    norms = np.sum(samples**2, axis=0)
    count = periods.size
    return Transform(
        np.ascontiguousarray(rows),
        norms[:count] + norms[count:],
        basis,
        np.searchsorted(edges, frequencies + 1e-9, side="right").astype(np.int64) - 1,
        len(edges) - 1,
        np.array(low_pass),
    )


def _low_pass() -> tuple[float, ...]:
    weights = np.blackman(TAPS + 2)[1:-1]
    return tuple((weights / weights.sum()).tolist())


_LOW_PASS = _low_pass()


def band_powers(windows: Array) -> Bands:
    """The band powers of windows (M, N), N >= 200, of one channel each, in stamp order.

    Raises:
        ValueError: `windows` has another shape, or a value is not within 1e70 of zero.
    """
    windows = checked(windows, WINDOW)
    used = min(windows.shape[1] // WINDOW * WINDOW, HISTORY)
    fast = transform(WINDOW)
    slow = transform(used, SLOW_EDGES, _LOW_PASS)
    M = windows.shape[0]
    bands = Bands(
        now=np.empty((M, fast.bands)),
        near=np.empty((M, fast.bands)),
        slow=np.empty((M, slow.bands)),
        spectrum=np.empty((M, fast.norms.size)),
        variance=np.empty((M, 2)),
    )
    _band_powers(
        windows,
        used,
        fast.rows,
        fast.norms,
        fast.basis,
        fast.band,
        slow.rows,
        slow.norms,
        slow.basis,
        slow.band,
        slow.low_pass,
        *bands,
    )
    return bands


@kernel
def _powers(x: Array, rows: Array, projected: Array) -> None:
    """Projections (2 B,) of a residual ``x`` (D,) on ``rows`` (D, 2 B)."""
    projected[:] = 0.0
    for i in range(x.size):
        for k in range(projected.size):
            projected[k] += x[i] * rows[i, k]


@kernel
def _in_bands(power: Array, norms: Array, band: NDArray[np.int64], out: Array) -> None:
    """Powers of bands ``out`` from those of frequencies; 0 for a band without any frequency."""
    white = np.zeros(out.size)
    out[:] = 0.0
    for k in range(power.size):
        out[band[k]] += power[k]
        white[band[k]] += norms[k]
    for b in range(out.size):
        if white[b] > 0.0:
            out[b] /= white[b]


@kernel
def _band_powers(
    windows: Array,
    used: int,
    fast: Array,
    fast_norms: Array,
    fast_basis: Array,
    fast_band: NDArray[np.int64],
    slow: Array,
    slow_norms: Array,
    slow_basis: Array,
    slow_band: NDArray[np.int64],
    low_pass: Array,
    now: Array,
    near: Array,
    slow_out: Array,
    spectrum: Array,
    variance: Array,
) -> None:
    """`band_powers` of the last ``used`` samples of ``windows`` (M, N) into the last five."""
    N = windows.shape[1]
    W = fast.shape[0]
    B = fast_norms.size
    D = slow.shape[0]
    r = np.empty(W)
    projected = np.empty(2 * B)
    power = np.empty(B)
    y = np.empty(D)
    slow_r = np.empty(D)
    slow_projected = np.empty(2 * slow_norms.size)
    slow_power = np.empty(slow_norms.size)
    parts = (min(used, NEAR) - W) // (W // 2) + 1
    for m in range(windows.shape[0]):
        x = windows[m]
        spectrum[m] = 0.0
        variance[m] = 0.0
        for s in range(parts):  # from the last one back
            end = N - s * (W // 2)
            squares = residual(x[end - W : end], fast_basis, r) / (W - 1 - fast_basis.shape[0])
            _powers(r, fast, projected)
            for k in range(B):
                power[k] = projected[k] * projected[k] + projected[B + k] * projected[B + k]
            if s == 0:
                _in_bands(power, fast_norms, fast_band, now[m])
                variance[m, 0] = squares
            variance[m, 1] += squares / parts
            for k in range(B):
                spectrum[m, k] += power[k] / parts
        _in_bands(spectrum[m], fast_norms, fast_band, near[m])
        for k in range(B):
            spectrum[m, k] /= fast_norms[k]

        first = N - used
        for i in range(D):
            y[i] = 0.0
            for j in range(low_pass.size):
                y[i] += low_pass[j] * x[first + i * DECIMATION + j]
        residual(y, slow_basis, slow_r)
        _powers(slow_r, slow, slow_projected)
        half = slow_norms.size
        for k in range(half):
            slow_power[k] = (
                slow_projected[k] * slow_projected[k]
                + slow_projected[half + k] * slow_projected[half + k]
            )
        _in_bands(slow_power, slow_norms, slow_band, slow_out[m])
        missing = near[m, 0]
        for b in range(slow_out.shape[1] - 1, -1, -1):
            if slow_out[m, b] == 0.0:
                slow_out[m, b] = missing
            missing = slow_out[m, b]
