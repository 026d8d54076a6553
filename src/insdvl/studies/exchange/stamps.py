"""Stamps of arrival evened out: a sensor samples regularly, and its messages are only ever late."""

from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array, Stamps

#: An interval of so many of the median, and of so many seconds, is a gap in the stream.
GAP_INTERVALS, GAP_SECONDS = 5.0, 1.0
#: Rows without a gap from which on a line through their stamps is of use.
FEWEST = 10
#: Largest delay in a stream whose samples are all there [s]: one that lost samples drifts away.
MAX_DELAY = 1.0


class EvenedOut(NamedTuple):
    """Stamps on the line of a regular clock.

    Attributes:
        stamps_ns: (N,) [ns].
        rate: Of the stream [Hz].
        delays: (N,) of the arrivals against them [s].
    """

    stamps_ns: Stamps
    rate: float
    delays: Array


def even_out(arrivals_ns: Stamps) -> EvenedOut:
    """The stamps that a regular clock gives to messages that arrived with delays.

    Between gaps the samples lie on a line over their number. Of the lines that no sample arrives
    before, the one with the smallest sum of delays is taken for the clock (Moon, Skelly and
    Towsley, INFOCOM 1999). What all delays have in common cannot be told from the arrivals and
    stays in the stamps (a ``time_offset``).

    Args:
        arrivals_ns: (N,) in the order of the samples.

    Raises:
        ValueError: There are too few rows, or they do not lie on a line: samples are missing.
    """
    t = (arrivals_ns - arrivals_ns[0]) * 1e-9
    steps = np.diff(t)
    if len(t) < FEWEST:
        raise ValueError(f"{len(t)} rows are too few to even out stamps, {FEWEST} are needed")
    interval = (t[-1] - t[0]) / (len(t) - 1)
    gaps = np.flatnonzero(steps > max(GAP_INTERVALS * interval, GAP_SECONDS)) + 1
    stamps, rates, counts = [], [], []
    for run in np.split(t, gaps):
        if len(run) < FEWEST:
            stamps.append(run)
            continue
        start, slope = _clock(run)
        line = start + slope * np.arange(len(run))
        worst = float((run - line).max())
        if not slope > 0.0 or worst > MAX_DELAY:
            raise ValueError(
                f"the stamps lie up to {worst:.2g} s off a line, at most {MAX_DELAY:g} s is "
                "taken for delay: samples are missing, or the rate changes; import without "
                "`arrival`"
            )
        stamps.append(line)
        rates.append(1.0 / slope)
        counts.append(len(run))
    if not rates:
        raise ValueError(f"no {FEWEST} rows are without a gap of {GAP_SECONDS:g} s")
    evened = np.concatenate(stamps)
    return EvenedOut(
        arrivals_ns[0] + np.round(evened * 1e9).astype(np.int64),
        float(np.average(rates, weights=counts)),
        t - evened,
    )


def _clock(arrivals: Array) -> tuple[float, float]:
    """Time of sample 0 and interval of the line below all arrivals (N,) that is closest to them.

    It is the edge of their lower convex hull at the mean of the numbers.
    """
    t: list[float] = arrivals.tolist()
    hull: list[int] = []
    for k in range(len(t)):
        while len(hull) > 1:
            i, j = hull[-2:]
            if (t[j] - t[i]) * (k - i) < (t[k] - t[i]) * (j - i):
                break
            hull.pop()
        hull.append(k)
    after = next(n for n, k in enumerate(hull) if k > (len(t) - 1) / 2)
    i, j = hull[after - 1], hull[after]
    slope = (t[j] - t[i]) / (j - i)
    return t[i] - slope * i, slope
