"""Parameters of nodes and commands, each declared once.

A group of parameters is a frozen dataclass whose fields are made by `parameter`, with unit, range
and meaning. The ROS declarations and descriptors, the checks of YAML files, the tables in
docs/reference/parameters.md and the example files are all made from it. Groups nest; the full name
of a nested field is joined by dots (``dvl.lever_arm``).

Types are strict, but for one thing: an integer, or a list of integers, serves as floats. An error
names the parameter, the value and the allowed range, and all faults are told at once.
"""

import dataclasses
import difflib
import math
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

from insdvl.files import shown

_Group = TypeVar("_Group")


class ParameterError(ValueError):
    """Parameters have unknown names, wrong types or values out of range; a line for each fault."""


#: Largest magnitude of a value by its unit, for parameters without bounds of their own. It exceeds
#: any vehicle, sensor or mission; squares and products of such values stay finite.
WIDEST = MappingProxyType(
    {
        "s": 1e9,
        "m": 1e7,
        "m/s": 1e3,
        "m/s^2": 1e4,
        "rad": 2 * math.pi,
        "rad/s": 1e3,
        "(m/s^2)^2": 1e8,
        "(rad/s)^2": 1e6,
        "(m/s^2)^2/s": 1e8,
        "(rad/s)^2/s": 1e6,
    }
)


def parameter(
    default: Any,
    meaning: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
    choices: tuple[str, ...] = (),
    length: int | None = None,
    one_for_all: bool = False,
    changeable: bool = False,
) -> Any:
    """A dataclass field that is a parameter.

    Args:
        default: The default value; its type is the type of the parameter. A non-empty tuple of
            floats or strings is a list.
        meaning: One sentence.
        unit: SI unit of the value, empty if it has none.
        low: Smallest allowed value, or element of a list; by default from WIDEST.
        high: Largest allowed value, or element of a list; by default from WIDEST.
        above: The value must be greater than this.
        choices: The allowed strings; empty for any.
        length: Number of elements of a list.
        one_for_all: Whether a single value stands for all elements of a list.
        changeable: Whether it may change while the node runs, see `changed`.
    """
    if unit in WIDEST:
        high = WIDEST[unit] if high is None else high
        low = -WIDEST[unit] if low is None and above is None else low
    metadata = {
        "meaning": meaning,
        "unit": unit,
        "low": low,
        "high": high,
        "above": above,
        "choices": choices,
        "length": length,
        "one_for_all": one_for_all,
        "changeable": changeable,
    }
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Declaration:
    """One parameter of a group, as ROS and the documentation need it."""

    name: str
    default: Any
    meaning: str
    unit: str
    low: float | None
    high: float | None
    above: float | None
    choices: tuple[str, ...]
    length: int | None
    one_for_all: bool
    changeable: bool

    @property
    def type_name(self) -> str:
        """``bool``, ``int``, ``float``, ``string``, ``list of floats`` or ``list of strings``."""
        names = {bool: "bool", int: "int", float: "float", str: "string"}
        if type(self.default) is tuple:
            return f"list of {names[type(self.default[0])]}s"
        return names[type(self.default)]

    @property
    def range_text(self) -> str:
        """The allowed values in words; empty if all are allowed."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        bounds = []
        if self.above is not None:
            bounds.append(f"> {_limit(self.above, 1)}")
        if self.low is not None:
            bounds.append(f">= {_limit(self.low, 1)}")
        if self.high is not None:
            bounds.append(f"<= {_limit(self.high, -1)}")
        text = " and ".join(bounds)
        if self.length is not None:
            text = f"{self.length} values" + (f", each {text}" if text else "")
        return text

    def check(self, value: Any) -> Any:
        """The value as the dataclass stores it (lists become tuples).

        Raises:
            ParameterError: It has the wrong type or is out of range.
        """
        if type(self.default) is tuple:
            if self.one_for_all and self.length and type(value) in (int, float):
                value = [value] * self.length
            if isinstance(value, str) or not hasattr(value, "__iter__"):
                raise self._wrong_type(value)
            elements = tuple(value)
            if not elements:  # it has no type in ROS
                raise ParameterError(
                    f"parameter '{self.name}' must be {self.range_text or 'not empty'}, got an "
                    f"empty list, not a {self.type_name}"
                )
            if type(self.default[0]) is float and all(type(element) is int for element in elements):
                elements = tuple(self._as_float(element) for element in elements)
            if any(type(element) is not type(self.default[0]) for element in elements):
                raise self._wrong_type(value)
            if self.length is not None and len(elements) != self.length:
                raise self._out_of_range(value)
            for element in elements:
                if type(element) is float and not self._allows(element):
                    raise self._out_of_range(value)
            return elements
        if type(self.default) is float and type(value) is int:
            value = self._as_float(value)
        if type(value) is not type(self.default):
            raise self._wrong_type(value)
        if self.choices and value not in self.choices:
            raise self._out_of_range(value)
        if type(value) is str and "\0" in value:
            raise ParameterError(
                f"parameter '{self.name}' must not contain NUL, got {shown(value)}"
            )
        if type(value) is int and not -(2**63) <= value < 2**63:
            raise ParameterError(f"parameter '{self.name}' must fit in 64 bits, got {shown(value)}")
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if number and not self._allows(value):
            raise self._out_of_range(value)
        return value

    def _as_float(self, value: int) -> float:
        try:
            return float(value)
        except OverflowError:
            raise self._out_of_range(value) from None

    def _allows(self, value: float) -> bool:
        return (
            math.isfinite(value)
            and (self.low is None or value >= self.low)
            and (self.high is None or value <= self.high)
            and (self.above is None or value > self.above)
        )

    def _wrong_type(self, value: Any) -> ParameterError:
        article = "an" if self.type_name == "int" else "a"
        hint = ""
        if self.length is not None and type(value) is type(self.default[0]):
            example = [value] * self.length
            hint = f": give {self.length} values, such as {shown(example)}"
        return ParameterError(
            f"parameter '{self.name}' must be {article} {self.type_name}, got {shown(value)} "
            f"({type(value).__name__}){hint}"
        )

    def _out_of_range(self, value: Any) -> ParameterError:
        return ParameterError(
            f"parameter '{self.name}' must be {self.range_text or 'finite'}, got {shown(value)}"
        )


def _limit(value: float, side: int) -> str:
    """A limit in as few digits, at least 6, as do not tell a value that is refused.

    Args:
        value: The limit.
        side: To which side of it a value is allowed, 1 or -1.
    """
    texts = (f"{value:.{digits}g}" for digits in range(6, 18))  # 17 digits tell any float
    return next(text for text in texts if side * (float(text) - value) >= 0.0)


def check_all(*checks: Callable[[], None]) -> None:
    """Make checks of which each may refuse.

    Raises:
        ParameterError: Some do; a line for each.
    """
    found = []
    for check in checks:
        try:
            check()
        except ParameterError as error:
            found.append(str(error))
    if found:
        raise ParameterError("\n".join(found))


def check_frames(odom: str, base: str) -> None:
    """Refuse frames of an odometry that are empty or equal."""
    for name, frame in (("odom_frame", odom), ("base_frame", base)):
        if not frame:
            raise ParameterError(f"parameter '{name}' must not be empty")
    if odom == base:
        raise ParameterError(
            f"parameter 'base_frame' must differ from odom_frame, got {shown(base)}"
        )


def check_map(map_: str, odom: str, base: str) -> None:
    """Refuse a frame of map that is empty, or another one."""
    if not map_:
        raise ParameterError("parameter 'map_frame' must not be empty")
    for name, frame in (("odom_frame", odom), ("base_frame", base)):
        if map_ == frame:
            raise ParameterError(
                f"parameter 'map_frame' must differ from {name} where an input tells heading or "
                f"position, got {shown(map_)}"
            )


def declarations(group: type[Any], prefix: str = "") -> Iterator[Declaration]:
    """The parameters of a group and its nested groups, in the order of their definition."""
    types = typing.get_type_hints(group)
    for item in dataclasses.fields(group):
        name = prefix + item.name
        if dataclasses.is_dataclass(types[item.name]):
            yield from declarations(types[item.name], name + ".")
        else:
            yield Declaration(name=name, default=item.default, **item.metadata)


def build(group: type[_Group], values: Mapping[str, Any], prefix: str = "") -> _Group:
    """A group from full names and values; all others take their defaults.

    Raises:
        ParameterError: Names are unknown, types are wrong or values out of range; if none is,
            values contradict each other.
    """
    found = faults(group, values, prefix)
    if found:
        raise ParameterError("\n".join(found.values()))
    known = {declaration.name: declaration for declaration in declarations(group, prefix)}
    checked = {name: known[name].check(value) for name, value in values.items() if name in known}
    return _build(group, checked, prefix)


def faults(group: type[Any], values: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """What is wrong with single values, by their full names; contradictions are not among it."""
    known = {declaration.name: declaration for declaration in declarations(group, prefix)}
    found = {}
    for name, value in values.items():
        if name in known:
            try:
                known[name].check(value)
            except ParameterError as error:
                found[name] = str(error)
        elif name.startswith(prefix):
            near = difflib.get_close_matches(name, known, n=3, cutoff=0.0)
            found[name] = f"unknown parameter {shown(name)}; the nearest are {', '.join(near)}"
    return found


def _build(group: type[_Group], values: Mapping[str, Any], prefix: str) -> _Group:
    """As `build`, from checked values."""
    types = typing.get_type_hints(group)
    arguments, contradictions = {}, []
    for item in dataclasses.fields(group):  # type: ignore[arg-type]
        name = prefix + item.name
        if dataclasses.is_dataclass(types[item.name]):
            try:
                arguments[item.name] = _build(types[item.name], values, name + ".")
            except ParameterError as error:
                contradictions.append(str(error))
        elif name in values:
            arguments[item.name] = values[name]
    if contradictions:
        raise ParameterError("\n".join(contradictions))
    return group(**arguments)


def changed(group: _Group, values: Mapping[str, Any]) -> _Group:
    """A group with other values of parameters that may change while a node runs.

    Raises:
        ParameterError: `build` refuses the values, or a parameter may not change.
    """
    fixed = {d.name for d in declarations(type(group)) if not d.changeable}
    found = [f"parameter '{name}' is read-only" for name in values if name in fixed]
    if found:
        raise ParameterError("\n".join(found))
    return build(type(group), flatten(group) | dict(values))


def flatten(group: Any, prefix: str = "") -> dict[str, Any]:
    """Full names and values of a group; the inverse of `build`."""
    values: dict[str, Any] = {}
    for item in dataclasses.fields(group):
        value = getattr(group, item.name)
        if dataclasses.is_dataclass(value):
            values.update(flatten(value, prefix + item.name + "."))
        else:
            values[prefix + item.name] = value
    return values


def mount(sensor: str) -> Any:
    """Parameter for the mounting rotation of a sensor."""
    return parameter(
        (0.0, 0.0, 0.0),
        f"Rotation from {sensor} axes to base_link axes, as roll, pitch, yaw of the {sensor} in "
        "base_link.",
        unit="rad",
        low=-2 * math.pi,
        high=2 * math.pi,
        length=3,
    )


def lever_arm(sensor: str) -> Any:
    """Parameter for the position of a sensor on the vehicle."""
    return parameter(
        (0.0, 0.0, 0.0),
        f"Position of the {sensor} in base_link.",
        unit="m",
        low=-1000.0,
        high=1000.0,
        length=3,
    )


def time_offset(sensor: str) -> Any:
    """Parameter for what the stamps of a sensor are wrong by."""
    return parameter(
        0.0,
        f"Added to the stamps of the {sensor}: negative where they are late, the time of validity "
        "being before them.",
        unit="s",
        low=-10.0,
        high=10.0,
    )
