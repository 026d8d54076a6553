"""The command `insdvl export`: an odometry, or a sensor, of a recording as a text file."""

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from insdvl.files import check_writable, write
from insdvl.messages.convert import IMU, ODOMETRY, TWIST, TWIST_WITH_COVARIANCE
from insdvl.messages.convert import stamp_ns as stamp_of
from insdvl.messages.topics import ODOMETRY as ESTIMATE
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import rotation_from_quaternion, rpy_from_rotation
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import BagError
from insdvl.studies.document import check_place, tell

_XYZ = "xyz"


def run(arguments: argparse.Namespace) -> int:
    """Export. The exit code is 2 if the input is refused; then nothing is written."""
    try:
        output: Path = arguments.output
        check_writable(output, "--output")
        check_place(arguments.json)
        document = _export(arguments)
        tell(arguments.json, document, f"{output}: {document['rows']} rows of {document['topic']}")
    except (ValueError, OSError) as error:
        print(f"insdvl export: {error}", file=sys.stderr)
        return 2
    return 0


def _export(arguments: argparse.Namespace) -> dict[str, Any]:
    """Write the file; what it holds."""
    bag_path: Path = arguments.bag
    output: Path = arguments.output
    if output.suffix not in (".csv", ".tum"):
        raise ValueError(f"--output {output}: the name must end in .csv or .tum")
    with BagReader(bag_path, arguments.begin, arguments.end) as bag:
        topic = _topic(bag, arguments.topic)
        kind = bag.topics[topic].type
        if output.suffix == ".tum" and kind != ODOMETRY:
            raise BagError(f"{topic} of {bag_path} has type {kind}, TUM needs {ODOMETRY}")
        form = _tum if output.suffix == ".tum" else _FORMS[kind]
        lines = [] if output.suffix == ".tum" else [",".join(["stamp", *_NAMES[kind]])]
        header = len(lines)
        separator = " " if output.suffix == ".tum" else ","
        for recorded in bag.messages([topic]):
            seconds, rest = divmod(stamp_of(recorded.message.header), NS)
            values = (f"{value:.12g}" for value in form(recorded.message))
            lines.append(separator.join([f"{seconds}.{rest:09d}", *values]))
    write(output, ("\n".join(lines) + "\n").encode())
    return {
        "bag": str(bag_path),
        "topic": topic,
        "type": kind,
        "file": str(output),
        "rows": len(lines) - header,
    }


def _topic(bag: BagReader, asked: str | None) -> str:
    """The topic that is exported: the one that was asked for, else the filter's odometry."""
    if asked is not None:
        bag.require(asked, *_FORMS)
        return asked
    named = [name for name in bag.topics if name.endswith(f"/{ESTIMATE}")]
    found = named or [name for name, topic in bag.topics.items() if topic.type == ODOMETRY]
    if len(found) != 1:
        what = f"several: {', '.join(sorted(found))}" if found else "none"
        raise BagError(f"{bag.path} must have one odometry topic, has {what}; name it by --topic")
    return found[0]


def _vector(field: Any) -> list[float]:
    return [field.x, field.y, field.z]


def _sigmas(covariance: Any, rows: int, size: int) -> list[float]:
    """The first sigmas of a flat covariance (size, size); 0 for unknown."""
    variances = np.asarray(covariance, dtype=float)[:: size + 1][:rows]
    return [math.sqrt(v) if v > 0.0 else 0.0 for v in variances.tolist()]


def _tum(message: Any) -> Iterator[float]:
    q = message.pose.pose.orientation
    yield from _vector(message.pose.pose.position)
    yield from (q.x, q.y, q.z, q.w)


def _odometry(message: Any) -> Iterator[float]:
    yield from _tum(message)
    q = message.pose.pose.orientation
    C = rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))
    yield from np.degrees(rpy_from_rotation(C)).tolist()
    yield from _vector(message.twist.twist.linear)
    yield from _sigmas(message.pose.covariance, 3, 6)
    yield from np.degrees(_sigmas(message.pose.covariance, 6, 6)[3:]).tolist()
    yield from _sigmas(message.twist.covariance, 3, 6)


def _imu(message: Any) -> Iterator[float]:
    yield from _vector(message.linear_acceleration)
    yield from _vector(message.angular_velocity)


def _twist(message: Any) -> Iterator[float]:
    yield from _vector(message.twist.linear)


def _twist_with_covariance(message: Any) -> Iterator[float]:
    yield from _vector(message.twist.twist.linear)
    yield from _sigmas(message.twist.covariance, 3, 6)


def _names(*names: str) -> list[str]:
    return [f"{name}_{letter}" for name in names for letter in _XYZ]


#: The numbers of a message in a row, and the names of their columns, by message type.
_FORMS: Mapping[str, Callable[[Any], Iterator[float]]] = MappingProxyType(
    {
        ODOMETRY: _odometry,
        IMU: _imu,
        TWIST: _twist,
        TWIST_WITH_COVARIANCE: _twist_with_covariance,
    }
)
_NAMES: Mapping[str, list[str]] = MappingProxyType(
    {
        ODOMETRY: [
            *_names("position"),
            *(f"orientation_{letter}" for letter in "xyzw"),
            *("roll_deg", "pitch_deg", "yaw_deg"),
            *_names("velocity", "position_sigma"),
            *("roll_sigma_deg", "pitch_sigma_deg", "yaw_sigma_deg"),
            *_names("velocity_sigma"),
        ],
        IMU: _names("specific_force", "angular_rate"),
        TWIST: _names("velocity"),
        TWIST_WITH_COVARIANCE: _names("velocity", "velocity_sigma"),
    }
)
