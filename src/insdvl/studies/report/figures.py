"""The figures of the report, as plotly.js takes them: traces and a layout, without plotly.

No trace has more points than a screen shows. Numbers are single precision in base64, which
plotly.js reads.
"""

import base64
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array

#: Points of a trace: one for each pixel of a figure; and of the edge of a band.
MOST_POINTS = 1400
BAND_POINTS = 500

# Colours that colour-blind readers tell apart (Okabe and Ito).
BLUE, ORANGE, GREEN, RED, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#555555"
AXES = (BLUE, RED, GREEN)

Trace = dict[str, Any]
Figure = dict[str, Any]


def numbers(values: Array) -> dict[str, str]:
    """An array as plotly.js takes it."""
    data = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(data).decode()}


def thinned(count: int) -> NDArray[np.intp]:
    """Indices of at most `MOST_POINTS` of so many smooth values, the last one included."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).round().astype(np.intp))


def extremes(values: Array) -> NDArray[np.intp]:
    """Indices of at most `MOST_POINTS` of noisy values: the extremes of equal parts."""
    count = len(values)
    if count <= MOST_POINTS:
        return np.arange(count)
    parts = np.array_split(np.arange(count), MOST_POINTS // 2)
    filled = np.where(np.isfinite(values), values, 0.0)
    found = [part[[filled[part].argmin(), filled[part].argmax()]] for part in parts]
    return np.unique(np.concatenate(found))


def line(t: Array, values: Array, name: str, colour: str, **more: Any) -> Trace:
    """A smooth line over time."""
    at = thinned(len(t))
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": numbers(t[at]),
        "y": numbers(values[at]),
        "line": {"color": colour, "width": 1.6} | more.pop("line", {}),
        **more,
    }


def band(t: Array, low: Array, high: Array, name: str, colour: str, **more: Any) -> list[Trace]:
    """A filled band over time; the two edges are traces, the second one fills to the first.

    Each point of an edge is the extreme of its part: sigma has teeth, one for each measurement.
    """
    at = np.unique(np.linspace(0, len(t) - 1, BAND_POINTS).round().astype(np.intp))
    low, high = np.minimum.reduceat(low, at), np.maximum.reduceat(high, at)
    edge = {
        "type": "scatter",
        "mode": "lines",
        "line": {"width": 0},
        "hoverinfo": "skip",
        "x": numbers(t[at]),
        **more,
    }
    return [
        edge | {"y": numbers(low), "showlegend": False},
        edge
        | {
            "y": numbers(high),
            "name": name,
            "fill": "tonexty",
            "fillcolor": _faint(colour),
        },
    ]


def dots(t: Array, values: Array, name: str, colour: str, **more: Any) -> Trace:
    """Noisy values over time."""
    at = extremes(values)
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": numbers(t[at]),
        "y": numbers(values[at]),
        "marker": {"color": colour, "size": 4, "opacity": 0.75} | more.pop("marker", {}),
        **more,
    }


def level(value: float, name: str, colour: str = GREY, at: str = "end") -> Trace:
    """A horizontal line for the layout's shapes."""
    return {
        "type": "line",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "y0": value,
        "y1": value,
        "line": {"color": colour, "width": 1.2, "dash": "dash"},
        "label": {"text": name, "textposition": at, "font": {"size": 11, "color": colour}},
    }


def over_time(traces: Sequence[Trace], y: str, *, height: int = 260, **layout: Any) -> Figure:
    """A figure whose abscissa is the time; all of these move together."""
    return {
        "data": list(traces),
        "layout": {
            "height": height,
            "xaxis": {"title": {"text": "time [s]"}, "showgrid": True},
            "yaxis": {"title": {"text": y, "standoff": 8}, "zeroline": False, "automargin": True}
            | layout.pop("yaxis", {}),
            "hovermode": "x",
            **layout,
        },
        "time": True,
    }


def other(traces: Sequence[Trace], x: str, y: str, *, height: int = 300, **layout: Any) -> Figure:
    """A figure over something else than time."""
    return {
        "data": list(traces),
        "layout": {
            "height": height,
            "xaxis": {"title": {"text": x}} | layout.pop("xaxis", {}),
            "yaxis": {"title": {"text": y}} | layout.pop("yaxis", {}),
            **layout,
        },
        "time": False,
    }


def window(values: Array, sigma: Array | float = 0.0) -> list[float]:
    """Range of an ordinate that shows values, and a band of so many sigma where it is usual.

    A band that is wider for a while, such as in an outage, is cut off; a double click shows it.
    """
    seen = values[np.isfinite(values)]
    if not seen.size:
        return [-1.0, 1.0]
    low, high = float(seen.min()), float(seen.max())
    usual = float(np.nanmedian(sigma))
    margin = max(0.08 * (high - low), 3.0 * usual, 1e-9)
    return [low - margin, high + margin]


def log_window(values: Array, *levels: float) -> list[float]:
    """Range of a logarithmic ordinate that shows values and levels, half a decade at least."""
    seen = np.append(values[np.isfinite(values) & (values > 0.0)], levels)
    low, high = math.log10(float(seen.min())), math.log10(float(seen.max()))
    return [low - 0.25, high + 0.25]


def with_sigma(
    t: Array, values: Array, sigma: Array, names: Sequence[str], y: str, **layout: Any
) -> Figure:
    """Components (N, m) over time, each with its band of two sigma."""
    traces: list[Trace] = []
    for k, name in enumerate(names):
        colour = AXES[k]
        low, high = values[:, k] - 2.0 * sigma[:, k], values[:, k] + 2.0 * sigma[:, k]
        traces += band(t, low, high, f"{name}, 2 sigma", colour, showlegend=False)
        traces.append(line(t, values[:, k], name, colour))
    ordinate = {"range": window(values, sigma)} | layout.pop("yaxis", {})
    return over_time(traces, y, yaxis=ordinate, **layout)


def errors_within(t: Array, errors: Array, sigma: Array, names: Sequence[str], y: str) -> Figure:
    """Errors (N, m) over time, and the band of two sigma about zero."""
    traces: list[Trace] = []
    for k, name in enumerate(names):
        colour = AXES[k]
        bound = 2.0 * sigma[:, k]
        traces += band(t, -bound, bound, f"{name}, 2 sigma", colour, showlegend=False)
        traces.append(line(t, errors[:, k], name, colour))
    return over_time(traces, y, yaxis={"range": window(errors, sigma)})


def ellipse(place: Array, covariance: Array, sigmas: float = 2.0) -> Array:
    """Points (33, 2) of the ellipse of a covariance (2, 2) about a place (2,)."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * math.pi, 33)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    axes = sigmas * np.sqrt(np.maximum(values, 0.0))
    return place + (circle * axes) @ vectors.T


def _faint(colour: str) -> str:
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"
