"""The map of an import: which column of a text file is what, in which unit and along which axis."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.commands import nearest
from insdvl.yaml_files import YamlError, load


class MapError(ValueError):
    """The map, or a file that it is for, cannot be used; the message names the place."""


#: Units of each quantity, by what one of them is in SI.
_G = 9.80665
UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "specific_force": {"m/s^2": 1.0, "g": _G, "mg": 1e-3 * _G},
        "velocity_increment": {"m/s": 1.0, "mm/s": 1e-3, "g*s": _G},
        "angular_rate": {
            "rad/s": 1.0,
            "deg/s": math.radians(1.0),
            "deg/h": math.radians(1.0) / 3600.0,
        },
        "angle_increment": {
            "rad": 1.0,
            "deg": math.radians(1.0),
            "arcsec": math.radians(1.0) / 3600.0,
        },
        "velocity": {
            "m/s": 1.0,
            "cm/s": 1e-2,
            "mm/s": 1e-3,
            "km/h": 1.0 / 3.6,
            "kn": 1852.0 / 3600.0,
        },
        "position": {"m": 1.0, "km": 1e3},
        "rpy": {"rad": 1.0, "deg": math.radians(1.0)},
        "quaternion": {"1": 1.0},
    }
)
STAMP_UNITS: Mapping[str, int] = MappingProxyType({"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1})
_AXIS = re.compile(r"([+-]?)([xyz])")
IDENTITY = ("x", "y", "z")


@dataclass(frozen=True)
class Quantity:
    """Columns of one quantity.

    Attributes:
        columns: Their names, or their numbers from 1.
        factor: SI in the unit of the file.
    """

    columns: tuple[str | int, ...]
    factor: float


@dataclass(frozen=True)
class SourceMap:
    """The map of one file.

    Attributes:
        source: ``imu``, ``dvl`` or ``truth``.
        stamp: Column of the stamp.
        stamp_unit: One of `STAMP_UNITS`.
        arrival: Whether the stamps are times of arrival, to be evened out.
        quantities: By their names.
        axes: (3, 3) from the axes of the file to forward, left, up.
        navigation_axes: (3, 3) from those of the truth's positions to east, north, up.
        velocity_in: Axes of the truth's velocity, ``body`` or ``navigation``.
        separator: Of columns; None to find it out.
        skip: Lines before the names of the columns.
    """

    source: str
    stamp: str | int
    stamp_unit: str
    arrival: bool
    quantities: Mapping[str, Quantity]
    axes: Array
    navigation_axes: Array = field(default_factory=lambda: np.eye(3))
    velocity_in: str = "body"
    separator: str | None = None
    skip: int = 0

    @property
    def columns(self) -> list[str | int]:
        """All columns that are read, the stamp first."""
        return [self.stamp, *(c for q in self.quantities.values() for c in q.columns)]


@dataclass(frozen=True)
class ImportMap:
    """The map of an import.

    Attributes:
        sources: By ``imu``, ``dvl`` and ``truth``.
        stamp_offset_ns: Added to all stamps [ns].
    """

    sources: Mapping[str, SourceMap]
    stamp_offset_ns: int


#: Keys of each source, and the quantities of which it needs one of each group.
_COMMON = ("stamp", "stamp_unit", "axes", "separator", "skip")
_QUANTITIES: Mapping[str, tuple[tuple[str, ...], ...]] = MappingProxyType(
    {
        "imu": (("specific_force", "velocity_increment"), ("angular_rate", "angle_increment")),
        "dvl": (("velocity", "speed"),),
        "truth": (("position",), ("quaternion", "rpy")),
    }
)
_OPTIONAL: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "imu": ("arrival",),
        "dvl": ("arrival", "sigma"),
        "truth": ("velocity", "velocity_in", "navigation_axes"),
    }
)
_SIZES: Mapping[str, int] = MappingProxyType({"speed": 1, "quaternion": 4})
#: Quantities with the units of another.
_LIKE: Mapping[str, str] = MappingProxyType({"speed": "velocity", "sigma": "velocity"})
#: The unit without one in the map.
_DEFAULT_UNITS = {name: next(iter(units)) for name, units in UNITS.items()}


def read_map(path: Path) -> ImportMap:
    """Read a map.

    Raises:
        MapError: It cannot be read, or an entry is wrong; the message has a line for each.
    """
    try:
        document = load(path)
    except OSError as error:
        raise MapError(f"cannot read {path}: {error.strerror or error}") from error
    except YamlError as error:
        raise MapError(f"{path} is not valid YAML: {error}") from error
    if not isinstance(document, dict):
        raise MapError(f"{path} must have the keys imu and dvl")
    faults: list[str] = []
    offset = _number(document.pop("stamp_offset", 0.0))
    if not math.isfinite(offset):
        faults.append("stamp_offset must be a number of seconds")
    _check_keys(document, (*_QUANTITIES, "stamp_offset"), "", faults)
    sources = {}
    for name in _QUANTITIES:
        if name not in document:
            continue
        try:
            sources[name] = _source(name, document[name])
        except MapError as error:
            faults += str(error).splitlines()
    faults += [f"{name} is missing" for name in ("imu", "dvl") if name not in document]
    if faults:
        raise MapError("\n".join(f"{path}: {fault}" for fault in faults))
    return ImportMap(sources, round(offset * 1e9))


def _source(name: str, section: Any) -> SourceMap:
    if not isinstance(section, dict):
        raise MapError(f"{name} must be a section, got {section!r}")
    faults: list[str] = []
    groups = _QUANTITIES[name]
    known = {q for group in groups for q in group} | ({"velocity", "sigma"} & set(_OPTIONAL[name]))
    units = {f"{q}_unit" for q in known}
    _check_keys(section, (*_COMMON, *_OPTIONAL[name], *known, *units), f"{name}.", faults)
    for group in groups:
        there = [q for q in group if q in section]
        if len(there) != 1:
            what = " or ".join(f"{name}.{q}" for q in group)
            faults.append(f"{what} is missing" if not there else f"only one of {what} is possible")
    quantities = {}
    for quantity in sorted(known & section.keys()):
        try:
            quantities[quantity] = _quantity(name, quantity, section)
        except MapError as error:
            faults.append(str(error))
    stamp = section.get("stamp")
    if not _is_column(stamp):
        faults.append(f"{name}.stamp must be the name or the number of a column, got {stamp!r}")
    one_of = {
        "stamp_unit": (section.get("stamp_unit", "s"), STAMP_UNITS),
        "velocity_in": (section.get("velocity_in", "body"), ("body", "navigation")),
    }
    for key, (value, allowed) in one_of.items():
        if value not in allowed:
            faults.append(f"{name}.{key} must be one of {', '.join(allowed)}, got {value!r}")
    skip, separator = section.get("skip", 0), section.get("separator")
    if not isinstance(skip, int) or isinstance(skip, bool) or skip < 0:
        faults.append(f"{name}.skip must be a number of lines, got {skip!r}")
    if separator is not None and (not isinstance(separator, str) or len(separator) != 1):
        faults.append(f"{name}.separator must be one character, got {separator!r}")
    if not isinstance(section.get("arrival", False), bool):
        faults.append(f"{name}.arrival must be true or false, got {section['arrival']!r}")
    rotations = []
    for key in ("axes", "navigation_axes"):
        try:
            rotations.append(_rotation(section.get(key, IDENTITY)))
        except MapError as error:
            faults.append(f"{name}.{key} {error}")
    if faults:
        raise MapError("\n".join(faults))
    return SourceMap(
        source=name,
        stamp=stamp,  # type: ignore[arg-type]
        stamp_unit=section.get("stamp_unit", "s"),
        arrival=section.get("arrival", False),
        quantities=quantities,
        axes=rotations[0],
        navigation_axes=rotations[1],
        velocity_in=section.get("velocity_in", "body"),
        separator=separator,
        skip=skip,
    )


def _quantity(source: str, name: str, section: Mapping[str, Any]) -> Quantity:
    value, size = section[name], _SIZES.get(name, 3)
    columns = tuple(value) if isinstance(value, list) else (value,)
    if name == "sigma" and len(columns) == 1:
        columns = columns * (1 if "speed" in section else 3)
    elif name == "sigma" and "speed" in section:
        size = 1
    if len(columns) not in ({1, size} if name == "sigma" else {size}) or not all(
        map(_is_column, columns)
    ):
        what = "a column" if size == 1 else f"{size} columns"
        raise MapError(f"{source}.{name} must be {what}, names or numbers, got {value!r}")
    like = _LIKE.get(name, name)
    unit = section.get(f"{name}_unit", _DEFAULT_UNITS[like])
    if str(unit) not in UNITS[like]:
        raise MapError(
            f"{source}.{name}_unit must be one of {', '.join(UNITS[like])}, got {unit!r}"
        )
    return Quantity(columns, UNITS[like][str(unit)])


def _rotation(value: Any) -> Array:
    """(3, 3) from axes such as ``[x, -y, -z]``: each row is an axis of the file."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise MapError(f"must be three axes such as [x, -y, -z], got {value!r}")
    C = np.zeros((3, 3))
    for row, text in enumerate(value):
        match = _AXIS.fullmatch(str(text))
        if match is None:
            raise MapError(f"must be three axes such as [x, -y, -z], got {text!r} among them")
        C[row, "xyz".index(match[2])] = -1.0 if match[1] == "-" else 1.0
    if round(float(np.linalg.det(C))) != 1:
        raise MapError(
            f"must be a right-handed turn of x, y, z, got {list(value)}: a sign is wrong, or an "
            "axis is there twice"
        )
    return C


def _check_keys(
    section: Mapping[str, Any], known: Collection[str], prefix: str, faults: list[str]
) -> None:
    for key in section:
        if key not in known:
            faults.append(f"unknown key {prefix}{key}{nearest(str(key), known)}")


def _is_column(value: Any) -> bool:
    if isinstance(value, bool):
        return False
    return (isinstance(value, str) and bool(value)) or (isinstance(value, int) and value >= 1)


def _number(value: Any) -> float:
    """A number, which YAML takes for a text in forms such as 3e9; nan where it is none."""
    try:
        return float("nan") if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        return float("nan")
