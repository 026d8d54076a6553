"""The tables of a result: track.csv, track.tum, updates.csv and reference.csv.

They are for people and for other programs, and the report is made from them. Their columns are in
docs/reference/replay.md.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import rpy_from_rotation
from insdvl.studies.evaluation.metrics import attitude_error
from insdvl.studies.replay.reference import AtReference
from insdvl.studies.replay.track import TrackColumns
from insdvl.timeline.output import AppliedUpdate

_XYZ = "xyz"
#: How the columns are written whose names end so, without components: a length to 0.1 mm, what
#: tells how large errors are to 5 digits. All others have 9 digits.
_FORMS = {
    "sigma": "%.5g",
    "sigma_deg": "%.5g",
    "noise": "%.5g",
    "position_covariance": "%.5g",
    "bias": "%.6g",
    "position": "%.4f",
    "height": "%.4f",
    "latitude_deg": "%.9f",
    "longitude_deg": "%.9f",
    "orientation": "%.7f",
    "roll_deg": "%.5f",
    "pitch_deg": "%.5f",
    "yaw_deg": "%.5f",
    "velocity": "%.5f",
    "rate": "%.7f",
}
_COMPONENTS = re.compile(r"_(xy|[xyzw])$")


def _named(name: str, values: Array, letters: str = _XYZ) -> dict[str, Array]:
    """Columns of the components of vectors (N, m)."""
    return {f"{name}_{letter}": values[:, k] for k, letter in enumerate(letters)}


def _sigmas(covariances: Array) -> Array:
    """(N, m) of covariances (N, m, m)."""
    return np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))


def track_columns(track: TrackColumns) -> dict[str, Array]:
    """The columns of track.csv behind the stamp."""
    pose, twist = track.pose_covariance, track.twist_covariance
    sigma = _sigmas(pose)
    return {
        "part": track.part.astype(float),
        **_named("position", track.position),
        **_named("orientation", track.quaternion_xyzw, "xyzw"),
        "roll_deg": np.degrees(track.rpy[:, 0]),
        "pitch_deg": np.degrees(track.rpy[:, 1]),
        "yaw_deg": np.degrees(track.rpy[:, 2]),
        **_named("velocity", track.linear),
        **_named("rate", track.angular),
        "latitude_deg": np.degrees(track.place[:, 0]),
        "longitude_deg": np.degrees(track.place[:, 1]),
        "height": track.place[:, 2],
        **_named("position_sigma", sigma[:, :3]),
        "position_covariance_xy": pose[:, 0, 1],
        "roll_sigma_deg": np.degrees(sigma[:, 3]),
        "pitch_sigma_deg": np.degrees(sigma[:, 4]),
        "yaw_sigma_deg": np.degrees(sigma[:, 5]),
        **_named("velocity_sigma", _sigmas(twist)[:, :3]),
        **_named("accelerometer_bias", track.accelerometer_bias),
        **_named("accelerometer_bias_sigma", _sigmas(track.accelerometer_bias_covariance)),
        **_named("gyroscope_bias", track.gyroscope_bias),
        **_named("gyroscope_bias_sigma", _sigmas(track.gyroscope_bias_covariance)),
        **_named("accelerometer_noise", track.accelerometer_noise),
        **_named("gyroscope_noise", track.gyroscope_noise),
    }


def reference_columns(at: AtReference) -> dict[str, Array] | None:
    """Columns of reference.csv; None without a reference at two states.

    Errors are the reference less the filter; of the attitude the rotation vector about odom's axes.
    """
    if len(at) < 2:
        return None
    truth, track, sigma = at.truth, at.track, at.sigma
    yaw = rpy_from_rotation(truth.C_n_b)[:, 2]
    psi = np.degrees(attitude_error(track.C_n_b, truth.C_n_b))
    return {
        **_named("position", truth.p_o),
        "yaw_deg": np.degrees(yaw),
        **_named("velocity", truth.v_b),
        **_named("position_error", truth.p_o - track.p_o),
        **_named("velocity_error", truth.v_b - track.v_b),
        **_named("attitude_error_deg", psi),
        **_named("velocity_sigma", sigma[:, :3]),
        **_named("position_sigma", sigma[:, 3:]),
    }


def csv_text(stamps_ns: Stamps, columns: Mapping[str, Array], *, names: bool = True) -> str:
    """A table; the first column is the stamp [s], the first line, where it is wanted, the names."""
    values = np.stack(list(columns.values()), axis=1)
    form = ",".join(map(_form, columns))
    lines = [",".join(["stamp", *columns])] if names else []
    for stamp_ns, row in zip(stamps_ns.tolist(), values.tolist(), strict=True):
        lines.append(f"{_seconds(stamp_ns)},{form % tuple(row)}")
    return "\n".join(lines) + "\n"


def _form(name: str) -> str:
    """How a column is written."""
    stem = _COMPONENTS.sub("", name)
    fitting = [end for end in _FORMS if stem == end or stem.endswith(f"_{end}")]
    return _FORMS[max(fitting, key=len)] if fitting else "%.9g"


def tum_text(track: TrackColumns) -> str:
    """The track as TUM has it: stamp, position, quaternion x, y, z, w."""
    rows = np.concatenate([track.position, track.quaternion_xyzw], axis=1).tolist()
    form = " ".join([_FORMS["position"]] * 3 + [_FORMS["orientation"]] * 4)
    lines = [
        f"{_seconds(stamp_ns)} {form % tuple(row)}"
        for stamp_ns, row in zip(track.stamps_ns.tolist(), rows, strict=True)
    ]
    return "\n".join(lines) + "\n"


def updates_text(updates: Sequence[AppliedUpdate]) -> str:
    """The table of all measurements: what the filter did with each, and its innovation.

    The rows of an innovation are in the axes of the measurement; empty where there are none.
    """
    rows = max((len(u.report.innovation) for u in updates), default=3)
    names = [f"{name}_{k}" for name in ("innovation", "sigma") for k in range(rows)]
    lines = [",".join(["stamp", "measurement", "accepted", "reason", "nis", "rows", *names])]
    for update in updates:
        r = update.report
        empty = [""] * (rows - len(r.innovation))
        numbers = [*r.innovation.tolist(), *empty, *np.sqrt(np.diagonal(r.S)).tolist(), *empty]
        texts = ["" if n == "" else f"{n:.9g}" for n in [r.nis, *numbers]]
        lines.append(
            ",".join(
                [
                    _seconds(update.stamp_ns),
                    r.measurement,
                    str(int(r.accepted)),
                    r.reason,
                    texts[0],
                    str(r.rows if r.judged else 0),
                    *texts[1:],
                ]
            )
        )
    return "\n".join(lines) + "\n"


def _seconds(stamp_ns: int) -> str:
    seconds, rest = divmod(stamp_ns, NS)
    return f"{seconds}.{rest:09d}"
