"""The section of the report on the innovations: does the filter fit its measurements?"""

import math

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.studies.report import figures as f
from insdvl.studies.report.figures import Figure
from insdvl.studies.report.parts import Part
from insdvl.studies.report.results import Result, Updates

AUTOCORRELATION_LAGS = 20
MOST_SIGMAS = 4.0  # of an innovation in the autocorrelation
DVL = "dvl"


def fit(result: Result) -> Part | None:
    """The innovations of every measurement, their NIS, autocorrelation and distribution."""
    if not result.updates:
        return None
    names = sorted(result.updates, key=lambda name: (name != DVL, name))
    text = (
        "<p>What was measured less what was predicted. It should stay within the band in 95 of 100 "
        "cases, without a pattern; NIS should be as large on average as the rows of the "
        "measurement.</p>"
    )
    found = [figure for name in names for figure in _fit_of(result, name, result.updates[name])]
    return Part(text, found)


def _fit_of(result: Result, name: str, updates: Updates) -> list[Figure]:
    t = updates.stamp - result.start
    judged = np.isfinite(updates.nis)
    rows = updates.innovation.shape[1]
    found = []
    for k in range(rows):
        here = judged & np.isfinite(updates.sigma[:, k])
        if not here.any():
            continue
        bound = 2.0 * updates.sigma[here, k]
        traces = f.band(t[here], -bound, bound, "2 sigma", f.BLUE)
        for used, label, colour in ((True, "used", f.BLUE), (False, "refused", f.RED)):
            some = here & (updates.accepted == used)
            if some.any():
                traces.append(f.dots(t[some], updates.innovation[some, k], label, colour))
        axis = f" {'xyz'[k]}" if rows == 3 else ""
        unit = " [m/s]" if name == DVL else ""
        usual = np.quantile(np.abs(updates.innovation[here, k]), 0.99)
        most = 1.3 * max(float(usual), 1.5 * float(np.median(bound)))
        found.append(
            f.over_time(
                traces,
                f"{name}{axis}{unit}",
                height=210,
                yaxis={"range": [-most, most], "zeroline": True},
            )
        )
    if judged.sum() < 2:
        return found
    return [*found, _nis(t[judged], updates, judged, name), *_whiteness(updates, judged, name)]


def _nis(t: Array, updates: Updates, judged: NDArray[np.bool_], name: str) -> Figure:
    rows = updates.innovation.shape[1]
    nis = updates.nis[judged] * rows / np.maximum(updates.rows[judged], 1.0)
    count = max(len(nis) // 30, 10)
    kernel = np.ones(count)
    running = np.convolve(nis, kernel, "same") / np.convolve(np.ones(len(nis)), kernel, "same")
    bound = exceeded(rows, 0.001)
    traces = [
        f.dots(t, np.maximum(nis, 1e-3), "NIS", f.GREY, marker={"opacity": 0.45}),
        f.line(t, running, f"mean of {count}", f.BLUE, line={"width": 2.5}),
    ]
    return f.over_time(
        traces,
        f"{name} NIS",
        yaxis={"type": "log", "range": f.log_window(np.maximum(nis, 1e-3), rows, bound)},
        shapes=[
            f.level(float(rows), f"expected {rows}", f.GREEN, at="start"),
            f.level(bound, "1 in 1000 is beyond", f.RED),
        ],
    )


def _whiteness(updates: Updates, judged: NDArray[np.bool_], name: str) -> list[Figure]:
    sigma = updates.sigma[judged]
    z = np.where(np.isfinite(sigma), updates.innovation[judged] / sigma, 0.0)
    limited = np.clip(z, -MOST_SIGMAS, MOST_SIGMAS)  # a single outlier decides nothing
    lags = min(AUTOCORRELATION_LAGS, len(z) - 1)
    power = max(float(np.sum(limited**2)), 1e-30)
    rho = np.array([np.sum(limited[:-lag] * limited[lag:]) / power for lag in range(1, lags + 1)])
    bound = 3.29 / math.sqrt(z.size)
    bars = {
        "type": "bar",
        "x": list(range(1, lags + 1)),
        "y": f.numbers(rho),
        "marker": {"color": f.BLUE},
        "name": "autocorrelation",
        "showlegend": False,
    }
    white = f.other(
        [bars],
        "lag [measurements]",
        f"{name} autocorrelation",
        shapes=[f.level(bound, "white noise", f.GREEN), f.level(-bound, "", f.GREEN)],
        yaxis={"range": [min(-0.3, float(rho.min())), max(0.3, float(rho.max()))]},
    )
    edges = np.linspace(-5.0, 5.0, 41)
    density, _ = np.histogram(np.clip(z, -5.0, 5.0), edges, density=True)
    middle = (edges[1:] + edges[:-1]) / 2.0
    histogram = f.other(
        [
            {
                "type": "bar",
                "x": f.numbers(middle),
                "y": f.numbers(density),
                "marker": {"color": f.BLUE},
                "name": "innovations",
            },
            {
                "type": "scatter",
                "mode": "lines",
                "x": f.numbers(middle),
                "y": f.numbers(np.exp(-(middle**2) / 2.0) / math.sqrt(2.0 * math.pi)),
                "line": {"color": f.GREEN, "width": 2},
                "name": "as it should be",
            },
        ],
        f"{name} innovation / sigma",
        "density",
        bargap=0.05,
    )
    return [white, histogram]
