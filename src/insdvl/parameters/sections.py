"""Parameter files of ROS 2, with one section per node."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from insdvl import yaml_files
from insdvl.files import beginning, shown
from insdvl.parameters.declaration import ParameterError, build

_Group = TypeVar("_Group")

#: Names of our nodes, and so of their sections in a parameter file.
NODES = (
    "insdvl_filter",
    "insdvl_tuner",
    "insdvl_replay",
    "insdvl_simulator",
    "insdvl_relay",
    "insdvl_monitor",
)

#: Parameters that rclpy gives to every node.
ROS_NAMES = ("qos_overrides", "use_sim_time", "start_type_description_service")


def is_ros_name(name: str) -> bool:
    """Whether a parameter belongs to rclpy."""
    return name.split(".")[0] in ROS_NAMES


def load_section(path: Path, node: str, group: type[_Group], *, required: bool = False) -> _Group:
    """A group of parameters from the sections of a ROS 2 parameter file that end in a node's name.

    Args:
        path: The file.
        node: Name of the node.
        group: Dataclass of its parameters.
        required: Whether the section must exist; if not, a missing section means all defaults.

    Raises:
        ParameterError: The file cannot be read or is not a parameter file, a required section is
            missing, or `build` refuses the values.
    """
    try:
        document = yaml_files.load(path)
    except OSError as error:
        reason = error.strerror or error
        raise ParameterError(f"cannot read the parameter file {path}: {reason}") from error
    except yaml_files.YamlError as error:
        raise ParameterError(f"cannot read the parameter file {path}: {error}") from error
    if not isinstance(document, dict):
        raise ParameterError(f"{path} is not a ROS 2 parameter file: it has no sections")
    values: dict[str, Any] = {}
    names = {section: str(section).rsplit("/", 1)[-1] for section in document}
    if required and node not in names.values():
        raise ParameterError(
            f"{path} has no section '/**/{node}'; it has {beginning(', '.join(map(str, document)))}"
        )
    for name in names.values():
        # A node may have been renamed, for example to insdvl_filter_2.
        if name.startswith("insdvl_") and not f"{name}_".startswith(tuple(f"{n}_" for n in NODES)):
            raise ParameterError(
                f"{path}: unknown node {shown(name)}; known are {', '.join(NODES)}"
            )
    for section, body in document.items():
        if names[section] != node:
            continue
        given = body.get("ros__parameters") if isinstance(body, dict) else None
        if not isinstance(given, dict) or len(body) > 1:
            raise ParameterError(f"{path}: section {section!r} must contain 'ros__parameters' only")
        for name, value in _full_names(given):
            if name in values and values[name] != value:
                raise ParameterError(
                    f"{path}, section {section!r}: parameter '{name}' is {shown(value)}, but "
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
