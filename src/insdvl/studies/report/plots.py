"""Plots of navigation results, written as PNG files without a display."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from insdvl.arrays import Array
from insdvl.extras import extra
from insdvl.files import write
from insdvl.studies.evaluation.metrics import Track

with extra("plot"):
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

# Colours that colour-blind readers tell apart (Okabe and Ito).
_TRUTH = "#222222"
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7")
_MOST_POINTS = 4000


@dataclass(frozen=True)
class Result:
    """Result of a filter at the N stamps of the truth, in ENU and FLU.

    Attributes:
        label: Name of the filter.
        track: (N,) states.
        velocity_sigma: (N, 3) sigma of the body velocity [m/s].
    """

    label: str
    track: Track
    velocity_sigma: Array


@dataclass(frozen=True)
class Noise:
    """Variances that apply from each stamp on, true or learned.

    Attributes:
        label: Name of the variances.
        t: (K,) [s].
        variances: (K, 6) of f_b [(m/s^2)^2], then w_ib_b [(rad/s)^2].
    """

    label: str
    t: Array
    variances: Array


def draw_mission(
    path: Path, title: str, t: Array, truth: Track, results: list[Result], noises: list[Noise]
) -> None:
    """Draw the track, the body velocity errors with 3 sigma, and the process noise.

    Args:
        path: The PNG file.
        title: Title of the plot.
        t: (N,) time from the start [s].
        truth: (N,) the truth.
        results: Up to four filters.
        noises: At most two: the true process noise, and the learned one.
    """
    figure = Figure(figsize=(15, 9.5), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=14)
    grid = figure.add_gridspec(1, 2, width_ratios=[1.0, 1.35])
    left, right = grid[0], grid[1]
    two = left.subgridspec(2, 1, height_ratios=[2.2, 1.0])
    five = right.subgridspec(5, 1)
    thin = slice(None, None, max(1, len(t) // _MOST_POINTS))

    _draw_track(figure.add_subplot(two[0]), truth, results, thin)
    _draw_position_error(figure.add_subplot(two[1]), t, truth, results, thin)
    rows = [figure.add_subplot(five[k]) for k in range(3)]
    for axis, (axes, name) in enumerate(zip(rows, ("forward", "left", "up"), strict=True)):
        _draw_velocity_error(axes, axis, t, truth, results, thin)
        axes.set_ylabel(f"{name} [m/s]")
        axes.tick_params(labelbottom=False)
    rows[0].set_title("body velocity error, and 3 sigma (dashed)", fontsize=10, loc="left")
    _legend_above(rows[0])
    force, rate = figure.add_subplot(five[3]), figure.add_subplot(five[4])
    _draw_noise(force, noises, slice(0, 3), "sigma of f [m/s$^2$]")
    _draw_noise(rate, noises, slice(3, 6), "sigma of w [rad/s]")
    force.set_title("noise per IMU sample", fontsize=10, loc="left")
    _legend_above(force)
    force.tick_params(labelbottom=False)
    for axes in (*rows, force, rate):
        axes.set_xlim(t[0], t[-1])
    rate.set_xlabel("time [s]")
    for axes in figure.axes:
        axes.grid(True, linewidth=0.4, alpha=0.6)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    _save(path, figure, dpi=110)


def _save(path: Path, figure: Figure, dpi: int) -> None:
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=dpi)
    write(path, image.getvalue())


def _legend_above(axes: Axes) -> None:
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=6, fontsize=8, frameon=False)


def _draw_track(axes: Axes, truth: Track, results: list[Result], thin: slice) -> None:
    axes.plot(*truth.p_o[thin, :2].T, color=_TRUTH, linewidth=1.5, label="truth")
    axes.plot(*truth.p_o[0, :2], "o", color=_TRUTH, label="start")
    for result, colour in zip(results, _COLOURS, strict=False):
        axes.plot(*result.track.p_o[thin, :2].T, color=colour, linewidth=1.2, label=result.label)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.set_title("track", fontsize=10, loc="left")
    axes.legend(loc="best", fontsize=9)


def _draw_position_error(
    axes: Axes, t: Array, truth: Track, results: list[Result], thin: slice
) -> None:
    for result, colour in zip(results, _COLOURS, strict=False):
        error = np.linalg.norm((result.track.p_o - truth.p_o)[thin, :2], axis=1)
        axes.plot(t[thin], error, color=colour, linewidth=1.2, label=result.label)
    axes.set_xlim(t[0], t[-1])
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("[m]")
    axes.set_title("horizontal position error", fontsize=10, loc="left")


def _draw_velocity_error(
    axes: Axes, axis: int, t: Array, truth: Track, results: list[Result], thin: slice
) -> None:
    for result, colour in zip(results, _COLOURS, strict=False):
        error = result.track.v_b[thin, axis] - truth.v_b[thin, axis]
        bound = 3.0 * result.velocity_sigma[thin, axis]
        axes.plot(t[thin], error, color=colour, linewidth=0.7, label=result.label)
        for sign in (-1.0, 1.0):
            axes.plot(t[thin], sign * bound, "--", color=colour, linewidth=0.7, alpha=0.8)


def _draw_noise(axes: Axes, noises: list[Noise], channels: slice, label: str) -> None:
    for noise, width in zip(noises, (0.8, 1.8), strict=False):
        sigma = np.sqrt(noise.variances[:, channels])
        for name, column, colour in zip("xyz", sigma.T, _COLOURS, strict=False):
            axes.step(
                noise.t,
                column,
                where="post",
                color=colour,
                linewidth=width,
                alpha=0.9,
                label=f"{name} {noise.label}",
            )
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel(label)


def draw_errors_over_time(path: Path, title: str, series: Mapping[str, Array]) -> None:
    """Draw the errors of body velocity and heading over time, and those that the filters expect.

    Args:
        path: The PNG file.
        title: Title of the plot.
        series: (R, K, 4) of each row, over R runs and K seconds: squared error and expected
            variance of the body velocity [(m/s)^2], then of the heading [deg^2]. The first four
            rows are drawn.
    """
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13)
    panels = figure.subplots(2, 1, sharex=True)
    for (name, values), colour in zip(series.items(), _COLOURS, strict=False):
        rms = np.sqrt(np.nanmean(values, axis=0))
        t = np.arange(1, len(rms) + 1)
        for axes, error, expected in zip(panels, rms.T[::2], rms.T[1::2], strict=True):
            axes.plot(t, error, color=colour, linewidth=1.2, label=name)
            axes.plot(t, expected, "--", color=colour, linewidth=0.9)
    panels[0].set_ylabel("body velocity [m/s]")
    panels[1].set_ylabel("heading [deg]")
    panels[1].set_xlabel("time [s]")
    panels[0].set_title(
        "RMS over the runs; dashed: what the filter expects", fontsize=10, loc="left"
    )
    _legend_above(panels[0])
    for axes in panels:
        axes.set_ylim(bottom=0.0)
        axes.grid(True, linewidth=0.4, alpha=0.6)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    _save(path, figure, dpi=100)
