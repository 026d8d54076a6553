"""The numbers of a replay as a table for the terminal."""

from typing import Any


def table_of(document: dict[str, Any]) -> str:
    """The table of the command's JSON document."""
    rows = (
        ("velocity RMSE, navigation axes", "velocity_rmse", "m/s"),
        ("velocity RMSE, body axes", "body_velocity_rmse", "m/s"),
        ("body velocity inside 3 sigma", "body_velocity_inside_3_sigma", ""),
        ("position RMSE, horizontal", "position_rmse_horizontal", "m"),
        ("depth error at the end", "depth_error_end", "m"),
        ("its sigma", "depth_sigma_end", "m"),
        ("heading RMSE", "heading_rmse_deg", "deg"),
        ("tilt RMSE", "tilt_rmse_deg", "deg"),
        ("reference stamps", "reference_stamps", ""),
        ("mean NIS (3 dof)", "nis_mean", ""),
        ("mean NIS, accepted only", "nis_mean_accepted", ""),
        ("DVL accepted", "dvl_accepted", ""),
        ("DVL rejected", "dvl_rejected", ""),
        ("process noise", "process_noise", ""),
    )
    lines = []
    for text, name, unit in rows:
        value = document[name]
        shown = "no reference" if value is None else value
        if isinstance(value, float):
            shown = f"{value:.4g}"
        lines.append(f"{text:32} {shown} {unit}".rstrip())
    if jumps := document["counts"]["time_jumps"]:
        lines.append(f"{'time jumps':32} {jumps}; errors are those after the last one")
    if document["start"]:
        lines.append(f"start: {document['start']}")
    lines += [f"finding: {finding}" for finding in document["findings"]]
    lines += [f"{'not used: ' + key:32} {count}" for key, count in document["rejected"].items()]
    lines += [f"frames: {finding}" for finding in document["frames"]]
    return "\n".join(lines)
