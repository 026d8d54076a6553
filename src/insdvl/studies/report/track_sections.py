"""The sections of the report on the track: where, how fast, and how far from the reference."""

import numpy as np

from insdvl.arrays import Array
from insdvl.studies.report import figures as f
from insdvl.studies.report.parts import Part, table
from insdvl.studies.report.results import Result

ELLIPSES = 25


def _is_enu(result: Result) -> bool:
    return bool(result.numbers["parameters"]["insdvl_filter"]["frame_convention"] == "enu")


def _east_north(result: Result, values: Array) -> Array:
    """(N, 2) east and north of values (N, >=2) along x and y of odom."""
    return values[:, :2] if _is_enu(result) else values[:, 1::-1]


def where(result: Result) -> Part:
    """The track on a map, and the depth over time."""
    track, t = result.track, result.track["stamp"] - result.start
    place = _east_north(result, result.vector("position"))
    sigma = _east_north(result, result.vector("position_sigma"))
    cross = track["position_covariance_xy"]
    rings: list[Array] = []
    for k in np.linspace(0, len(t) - 1, ELLIPSES).astype(int).tolist():
        P = np.array([[sigma[k, 0] ** 2, cross[k]], [cross[k], sigma[k, 1] ** 2]])
        rings += [f.ellipse(*place[k], P), np.full((1, 2), np.nan)]
    outline = np.concatenate(rings)
    at = f.thinned(len(t))
    traces = [
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
    z = track["position_z"] * (1.0 if _is_enu(result) else -1.0)
    depth = f.with_sigma(
        t, -z[:, None], track["position_sigma_z"][:, None], ["filter"], "depth [m]"
    )
    if result.reference is not None:
        true = _east_north(result, result.of_reference("position"))
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
        true_z = result.reference["position_z"] * (1.0 if _is_enu(result) else -1.0)
        when = result.reference["stamp"] - result.start
        dash = {"dash": "dot", "width": 1.2}
        depth["data"].append(f.line(when, -true_z, "reference", f.GREY, line=dash))
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
    names = ["forward", "left", "up"] if _is_enu(result) else ["forward", "right", "down"]
    velocity = f.with_sigma(
        t, result.vector("velocity"), result.vector("velocity_sigma"), names, "velocity [m/s]"
    )
    yaw = np.degrees(np.unwrap(np.radians(track["yaw_deg"])))
    heading = 90.0 - yaw if _is_enu(result) else yaw
    heading -= 360.0 * np.floor(heading[0] / 360.0)
    course = f.with_sigma(
        t, heading[:, None], track["yaw_sigma_deg"][:, None], ["heading"], "heading [deg]"
    )
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
    axes = ["east", "north", "up"] if _is_enu(result) else ["north", "east", "down"]
    body = ["forward", "left", "up"] if _is_enu(result) else ["forward", "right", "down"]
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
            body,
            "velocity error [m/s]",
        ),
        f.over_time(
            [f.line(t, psi[:, k], axis, f.AXES[k]) for k, axis in enumerate(axes)],
            "attitude error [deg]",
        ),
    ]
    text = "<p>Reference less filter. Bands are 2 sigma.</p>"
    return Part(table(rows) + text, errors)
