"""Parameter files of ROS 2: sections by node, and in each the parameters of that node."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from insdvl import yaml_files
from insdvl.files import beginning, shown
from insdvl.parameters.declaration import ParameterError, build

_Group = TypeVar("_Group")

#: Our nodes, by the names of their sections in a parameter file.
NODES = (
    "insdvl_filter",
    "insdvl_tuner",
    "insdvl_replay",
    "insdvl_simulator",
    "insdvl_relay",
    "insdvl_monitor",
)

#: Names that rclpy gives to every node; they are no parameters of ours.
ROS_NAMES = ("qos_overrides", "use_sim_time", "start_type_description_service")


def is_ros_name(name: str) -> bool:
    """Whether a parameter belongs to rclpy and not to us."""
    return name.split(".")[0] in ROS_NAMES


def load_section(path: Path, node: str, group: type[_Group], *, required: bool = False) -> _Group:
    """A group from the sections of a ROS 2 parameter file that end in a node's name.

    Args:
        path: The file.
        node: Name of the node.
        group: Its parameters.
        required: Whether there must be such a section; otherwise all defaults hold without one.

    Raises:
        ParameterError: The file cannot be read or is no parameter file, the section is missing, or
            `build` refuses it.
    """
    try:
        document = yaml_files.load(path)
    except (OSError, yaml_files.YamlError) as error:
        raise ParameterError(f"cannot read the parameter file {path}: {error}") from error
    if not isinstance(document, dict):
        raise ParameterError(f"{path} is no ROS 2 parameter file: it has no sections")
    values: dict[str, Any] = {}
    names = {section: str(section).rsplit("/", 1)[-1] for section in document}
    if required and node not in names.values():
        raise ParameterError(
            f"{path} has no section '/**/{node}'; it has {beginning(', '.join(map(str, document)))}"
        )
    for name in names.values():
        # A node may have been renamed, to insdvl_filter_2 for one.
        if name.startswith("insdvl_") and not f"{name}_".startswith(tuple(f"{n}_" for n in NODES)):
            raise ParameterError(f"{path}: no node is named {shown(name)}: {', '.join(NODES)}")
    for section, body in document.items():
        if names[section] != node:
            continue
        given = body.get("ros__parameters") if isinstance(body, dict) else None
        if not isinstance(given, dict) or len(body) > 1:
            raise ParameterError(
                f"{path}: section {section!r} must have 'ros__parameters' and nothing else"
            )
        for name, value in _full_names(given):
            if name in values and values[name] != value:
                raise ParameterError(
                    f"{path}, section {section!r}: parameter '{name}' is {shown(value)} here, and "
                    f"{shown(values[name])} above"
                )
            values[name] = value
    try:
        return build(group, {n: v for n, v in values.items() if not is_ros_name(n)})
    except ParameterError as error:
        raise ParameterError(f"{path}, section {node}: {error}") from error


def _full_names(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _full_names(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
