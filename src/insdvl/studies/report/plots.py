"""Plots of navigation results, written without a display, in the format of the file's suffix."""

import io
import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from insdvl.arrays import Array
from insdvl.extras import extra
from insdvl.files import write
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.studies.evaluation.metrics import Track
from insdvl.studies.report import figures
from insdvl.studies.report.results import Result as StoredResult
from insdvl.studies.report.results import Updates

with extra("plot"):
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

# Colours that colour-blind readers tell apart (Okabe and Ito).
_TRUTH = "#222222"
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7")  # of filters
_AXES = ("#e69f00", "#56b4e9", "#777777")  # of x, y, z where filters are in the same figure
_MOST_POINTS = 4000
_ELLIPSES = 15
_DVL = "dvl"
FORMATS = ("png", "pdf", "svg")


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

    Colours are of filters, but for the axes of the noise, which have others.

    Args:
        path: The file; its suffix is png, pdf or svg.
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
    rows[0].set_title("body velocity error, and 3 sigma (band)", fontsize=10, loc="left")
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


def format_of(path: Path) -> str:
    """The format that the suffix of a file names.

    Raises:
        ValueError: It names none that is written.
    """
    name = path.suffix.removeprefix(".").lower()
    if name not in FORMATS:
        raise ValueError(f"{path}: the suffix must be one of {', '.join(FORMATS)}")
    return name


def _save(path: Path, figure: Figure, dpi: int) -> None:
    image = io.BytesIO()
    figure.savefig(image, format=format_of(path), dpi=dpi)
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
        axes.fill_between(t[thin], -bound, bound, color=colour, alpha=0.18, linewidth=0.0)
        axes.plot(t[thin], error, color=colour, linewidth=0.7, label=result.label)


def _draw_noise(axes: Axes, noises: list[Noise], channels: slice, label: str) -> None:
    for noise, width in zip(noises, (0.8, 1.8), strict=False):
        sigma = np.sqrt(noise.variances[:, channels])
        for name, column, colour in zip("xyz", sigma.T, _AXES, strict=True):
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
    figure.suptitle(title, fontsize=12)
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


def draw_result(path: Path, result: StoredResult) -> None:
    """Draw a result on one page.

    Args:
        path: The file; its suffix is png, pdf or svg.
        result: What is drawn.

    Raises:
        ValueError: The suffix is another one.
    """
    format_of(path)
    figure = Figure(figsize=(11.7, 16.5), layout="constrained")
    FigureCanvasAgg(figure)
    judgement = str(result.numbers["verdict"]["judgement"])
    figure.suptitle(
        f"{result.title}\n" + "\n".join(textwrap.wrap(judgement, 110)),
        fontsize=11,
        x=0.02,
        ha="left",
    )
    grid = figure.add_gridspec(6, 2, height_ratios=[2.4, 1.0, 1.0, 1.0, 1.0, 1.0])
    t = result.track["stamp"] - result.start
    _map(figure.add_subplot(grid[0, :]), result)

    axes = figure.add_subplot(grid[1, 0])
    depth = result.depth(result.track["position_z"])[:, None]
    sigma = result.track["position_sigma_z"][:, None]
    _with_sigma(axes, t, depth, sigma, ["depth"], "depth [m]")
    axes.invert_yaxis()
    heading = result.heading_deg[:, None]
    sigma = result.track["yaw_sigma_deg"][:, None]
    axes = figure.add_subplot(grid[1, 1])
    _with_sigma(axes, t, heading, sigma, ["heading"], "heading [deg]")
    velocity, sigma = result.vector("velocity"), result.vector("velocity_sigma")
    axes = figure.add_subplot(grid[2, :])
    _with_sigma(axes, t, velocity, sigma, result.body_axes, "velocity [m/s]")
    if (updates := result.updates.get(_DVL)) is not None:
        _innovations(figure.add_subplot(grid[3, :]), result, updates)
        _nis(figure.add_subplot(grid[4, :]), result, updates)
    for column, (sensor, unit, scale) in enumerate(
        (("accelerometer", "mm/s²", 1e3), ("gyroscope", "deg/h", math.degrees(3600.0)))
    ):
        values = scale * result.vector(f"{sensor}_bias")
        sigma = scale * result.vector(f"{sensor}_bias_sigma")
        axes = figure.add_subplot(grid[5, column])
        _with_sigma(axes, t, values, sigma, list("xyz"), f"{sensor} bias [{unit}]")
    for axes in figure.axes[1:]:
        axes.set_xlim(0.0, result.duration)
        axes.set_xlabel("time [s]", fontsize=9)
    for axes in figure.axes:
        axes.grid(True, linewidth=0.4, alpha=0.6)
        axes.tick_params(labelsize=9)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    _save(path, figure, dpi=120)


def _map(axes: Axes, result: StoredResult) -> None:
    place, P = result.east_north(result.vector("position")), result.horizontal_covariance
    for k in np.linspace(0, len(place) - 1, _ELLIPSES).astype(int).tolist():
        axes.plot(*figures.ellipse(place[k], P[k]).T, color=figures.BLUE, linewidth=0.5, alpha=0.6)
    axes.plot(*place.T, color=figures.BLUE, linewidth=1.5, label="filter; ellipses 2 sigma")
    if result.reference is not None:
        true = result.east_north(result.of_reference("position"))
        axes.plot(*true.T, ":", color=figures.GREY, linewidth=1.2, label="reference")
    axes.plot(*place[0], "o", color=figures.GREEN, label="start")
    axes.plot(*place[-1], "s", color=figures.RED, label="end")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.legend(fontsize=9, frameon=False)


def _with_sigma(
    axes: Axes, t: Array, values: Array, sigma: Array, names: list[str], label: str
) -> None:
    for k, name in enumerate(names):
        low, high = values[:, k] - 2.0 * sigma[:, k], values[:, k] + 2.0 * sigma[:, k]
        axes.fill_between(t, low, high, color=figures.AXES[k], alpha=0.18, linewidth=0.0)
        axes.plot(t, values[:, k], color=figures.AXES[k], linewidth=1.0, label=name)
    margin = max(0.08 * float(np.ptp(values)), 3.0 * float(np.median(sigma)))
    axes.set_ylim(float(values.min()) - margin, float(values.max()) + margin)
    axes.set_ylabel(label, fontsize=9)
    if len(names) > 1:
        axes.legend(loc="upper right", ncols=3, fontsize=8, frameon=False)


def _innovations(axes: Axes, result: StoredResult, updates: Updates) -> None:
    t, sigmas = updates.stamp - result.start, updates.innovation / updates.sigma
    judged = np.isfinite(updates.nis)
    axes.axhspan(-2.0, 2.0, color=figures.BLUE, alpha=0.12, linewidth=0.0)
    for k, (axis, colour) in enumerate(zip("xyz", figures.AXES, strict=True)):
        axes.plot(t[judged], sigmas[judged, k], ".", color=colour, markersize=3, label=axis)
    axes.set_ylim(-6.0, 6.0)
    axes.set_ylabel("DVL innovation [sigma]", fontsize=9)
    axes.legend(loc="upper right", ncols=3, fontsize=8, frameon=False)


def _nis(axes: Axes, result: StoredResult, updates: Updates) -> None:
    t, rows = updates.stamp - result.start, updates.innovation.shape[1]
    for used, label, colour in ((True, "used", figures.BLUE), (False, "refused", figures.RED)):
        some = np.isfinite(updates.nis) & (updates.accepted == used)
        axes.plot(
            t[some],
            np.maximum(updates.nis[some], 1e-3),
            ".",
            color=colour,
            markersize=3,
            label=label,
        )
    axes.axhline(rows, color=figures.GREEN, linewidth=1.0, linestyle="--")
    axes.axhline(exceeded(rows, 0.001), color=figures.RED, linewidth=1.0, ls="--")
    axes.set_yscale("log")
    axes.set_ylabel("DVL NIS", fontsize=9)
    axes.legend(loc="upper right", ncols=2, fontsize=8, frameon=False)
