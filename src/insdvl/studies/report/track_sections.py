"""The sections of the report on the track: where, how fast, and how far from the reference."""

import numpy as np

from insdvl.arrays import Array
from insdvl.studies.report import figures as f
from insdvl.studies.report.parts import Part, table
from insdvl.studies.report.results import Result

ELLIPSES = 25


def where(result: Result) -> Part:
    """The track on a map, and the depth over time."""
    track, t = result.track, result.track["stamp"] - result.start
    place, P = result.east_north(result.vector("position")), result.horizontal_covariance
    rings: list[Array] = []
    for k in np.linspace(0, len(t) - 1, ELLIPSES).astype(int).tolist():
        rings += [f.ellipse(place[k], P[k]), np.full((1, 2), np.nan)]
    outline = np.concatenate(rings)
    at = f.thinned(len(t))
    traces: list[f.Trace] = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": "2 sigma",
            "x": f.numbers(outline[:, 0]),
            "y": f.numbers(outline[:, 1]),
            "line": {"color": f.BLUE, "width": 0.7},
            "opacity": 0.6,
            "hoverinfo": "skip",
        },
        {
            "type": "scatter",
            "mode": "lines",
            "name": "filter",
            "x": f.numbers(place[at, 0]),
            "y": f.numbers(place[at, 1]),
            "customdata": f.numbers(t[at]),
            "hovertemplate": "east %{x:.2f} m, north %{y:.2f} m, %{customdata:.1f} s",
            "line": {"color": f.BLUE, "width": 2},
        },
        *(
            {
                "type": "scatter",
                "mode": "markers",
                "name": name,
                "x": [float(place[k, 0])],
                "y": [float(place[k, 1])],
                "marker": {"color": colour, "size": 10, "symbol": symbol},
            }
            for name, k, colour, symbol in (
                ("start", 0, f.GREEN, "circle"),
                ("end", -1, f.RED, "square"),
            )
        ),
    ]
    below = result.depth(track["position_z"])[:, None]
    depth = f.with_sigma(t, below, track["position_sigma_z"][:, None], ["filter"], "depth [m]")
    if result.reference is not None:
        true = result.east_north(result.of_reference("position"))
        some = f.thinned(len(true))
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": "reference",
                "x": f.numbers(true[some, 0]),
                "y": f.numbers(true[some, 1]),
                "line": {"color": f.GREY, "width": 1.2, "dash": "dot"},
            }
        )
        true_depth = result.depth(result.reference["position_z"])
        when = result.reference["stamp"] - result.start
        dash = {"dash": "dot", "width": 1.2}
        depth["data"].append(f.line(when, true_depth, "reference", f.GREY, line=dash))
    depth["layout"]["yaxis"]["range"].reverse()  # deeper is lower
    text = "<p>North is up, both axes have one scale; depth is below the origin.</p>"
    chart = f.other(
        traces,
        "east [m]",
        "north [m]",
        height=560,
        yaxis={"scaleanchor": "x", "scaleratio": 1},
    )
    return Part(text, [chart, depth])


# ---------------------------------------------------------------- how fast


def motion(result: Result) -> Part:
    """Velocity in body axes, heading, and roll and pitch."""
    track, t = result.track, result.track["stamp"] - result.start
    values, sigma = result.vector("velocity"), result.vector("velocity_sigma")
    velocity = f.with_sigma(t, values, sigma, result.body_axes, "velocity [m/s]")
    heading, sigma = result.heading_deg[:, None], track["yaw_sigma_deg"][:, None]
    course = f.with_sigma(t, heading, sigma, ["heading"], "heading [deg]")
    tilt = f.with_sigma(
        t,
        np.stack([track["roll_deg"], track["pitch_deg"]], axis=1),
        np.stack([track["roll_sigma_deg"], track["pitch_sigma_deg"]], axis=1),
        ["roll", "pitch"],
        "tilt [deg]",
    )
    text = "<p>Bands are 2 sigma. The heading is from north through east and goes on past 360.</p>"
    return Part(text, [velocity, course, tilt])


def reference(result: Result) -> Part | None:
    """Errors against the reference with what the filter says of them."""
    if result.reference is None:
        return None
    t = result.reference["stamp"] - result.start
    axes = ["east", "north", "up"] if result.is_enu else ["north", "east", "down"]
    psi = result.of_reference("attitude_error_deg")
    document = result.numbers
    rows = [
        (text, f"{document[name]:.4g} {unit}")
        for text, name, unit in (
            ("velocity RMSE, body axes", "body_velocity_rmse", "m/s"),
            ("velocity RMSE, navigation axes", "velocity_rmse", "m/s"),
            ("horizontal position RMSE", "position_rmse_horizontal", "m"),
            ("heading RMSE", "heading_rmse_deg", "deg"),
            ("tilt RMSE", "tilt_rmse_deg", "deg"),
        )
        if document.get(name) is not None
    ]
    errors = [
        f.errors_within(
            t,
            result.of_reference("position_error"),
            result.of_reference("position_sigma"),
            axes,
            "position error [m]",
        ),
        f.errors_within(
            t,
            result.of_reference("velocity_error"),
            result.of_reference("velocity_sigma"),
            result.body_axes,
            "velocity error [m/s]",
        ),
        f.over_time(
            [f.line(t, psi[:, k], axis, f.AXES[k]) for k, axis in enumerate(axes)],
            "attitude error [deg]",
        ),
    ]
    text = "<p>Reference less filter. Bands are 2 sigma.</p>"
    return Part(table(rows) + text, errors)
