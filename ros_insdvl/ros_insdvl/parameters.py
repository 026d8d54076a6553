"""A parameter group of the core as the declared parameters of a ROS 2 node."""

from array import array
from collections.abc import Collection, Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from insdvl.parameters.declaration import (
    Declaration,
    ParameterError,
    changed,
    declarations,
    flatten,
)
from insdvl.parameters.files import ARGUMENT, ParameterFile, effective, matches
from insdvl.parameters.sections import Loaded, is_ros_name, load, warnings

_Group = TypeVar("_Group")


_TYPES = {
    "bool": Parameter.Type.BOOL,
    "int": Parameter.Type.INTEGER,
    "float": Parameter.Type.DOUBLE,
    "string": Parameter.Type.STRING,
    "list of floats": Parameter.Type.DOUBLE_ARRAY,
    "list of strings": Parameter.Type.STRING_ARRAY,
}

#: Values of the qos_overrides that `ros_insdvl.qos` offers; rclpy does not name a wrong one.
_QOS_VALUES = {
    "history": ("keep_last", "keep_all", "system_default"),
    "reliability": ("reliable", "best_effort", "best_available", "system_default"),
    "durability": ("volatile", "transient_local", "best_available", "system_default"),
}


def declare(
    node: Node,
    group: type[_Group],
    files: Sequence[ParameterFile],
    others: Collection[type[Any]] = (),
) -> _Group:
    """Declare every parameter of a group on a node, and return the group with the node's values.

    Unknown parameters in a section for nodes of any name are ignored; the log says so, and of which
    files and arguments nothing has reached the node.

    Args:
        node: The node, before it has publishers.
        group: A dataclass of parameters (see `insdvl.parameters`).
        files: The parameter files and arguments that the node was given.
        others: Groups of the other nodes in the process.

    Raises:
        ParameterError: Overrides have unknown names, wrong types or are out of range, or the values
            contradict each other; a line for each fault.
    """
    name = node.get_fully_qualified_name()
    overrides, faults = {}, []
    # rclpy ignores undeclared overrides, and no public attribute holds them.
    for override in node._parameter_overrides.values():
        if override.name.startswith("qos_overrides."):
            faults += _fault_of_qos(override.name, override.value)
        elif not is_ros_name(override.name):
            # An empty list has no type in ROS.
            is_set = override.type_ != Parameter.Type.NOT_SET
            overrides[override.name] = plain(override.value) if is_set else []
    try:
        theirs = {declaration.name for other in others for declaration in declarations(other)}
        loaded = load(files, name, group, overrides, theirs)
    except ParameterError as error:
        faults.append(str(error))
    if faults:
        raise ParameterError("\n".join(faults))
    _tell(node, files, loaded, alone=not others)
    values = flatten(loaded.parameters)
    for declaration in declarations(group):
        # Converted already: an integer for a float is an override of the wrong type to rclpy.
        node.declare_parameter(
            declaration.name,
            plain(values[declaration.name]),
            descriptor(declaration),
            ignore_override=True,
        )
    return loaded.parameters


def plain(value: Any) -> Any:
    """A value as rclpy takes it and as a message shows it: tuples and arrays as lists."""
    return list(value) if isinstance(value, tuple | array) else value


def _tell(node: Node, files: Sequence[ParameterFile], loaded: Loaded[Any], *, alone: bool) -> None:
    """Warn of files and arguments that have no effect; an argument may be for another node here."""
    name, log = node.get_fully_qualified_name(), node.get_logger()
    arguments = [given for file in files for given in file.given if given.is_argument]
    of_yaml = [file for file in files if file.path != ARGUMENT]
    for line in warnings(of_yaml, [name], loaded.ignored):
        log.warning(line)
    values = effective(files, name)
    for given in arguments:
        if not matches(given.section, name):
            if alone or given.section.rpartition("/")[2] == node.get_name():
                log.warning(
                    f"-p {given.section}:{given.name} has no effect: this node is {name}; use "
                    f"-p {given.name}:=VALUE"
                )
            continue
        taken = values.get(given.name, given)
        if not taken.is_argument and taken.value != given.value:
            log.warning(
                f"-p {given.name} has no effect: {taken.place} has {taken.value!r}. To ROS a -p "
                "belongs to section '/**', and sections count in the order in which they appear "
                f"first; use -p {node.get_name()}:{given.name}:=VALUE"
            )


def changes(group: _Group, parameters: Sequence[Parameter]) -> tuple[_Group, list[Parameter]]:
    """What becomes of a group when parameters are set, and the parameters in the declared types.

    Raises:
        ParameterError: Values are refused.
    """
    after = changed(group, {p.name: plain(p.value) for p in parameters})
    values = flatten(after)
    return after, [Parameter(p.name, value=plain(values[p.name])) for p in parameters]


def _fault_of_qos(name: str, value: Any) -> list[str]:
    policy = name.rsplit(".", 1)[-1]
    if policy == "depth":
        right, allowed = type(value) is int and value > 0, "an int > 0"
    elif policy in _QOS_VALUES:
        right, allowed = value in _QOS_VALUES[policy], "one of " + ", ".join(_QOS_VALUES[policy])
    else:
        right, allowed = False, "removed: policies are depth, " + ", ".join(_QOS_VALUES)
    return [] if right else [f"parameter '{name}' must be {allowed}, got {value!r}"]


def descriptor(declaration: Declaration) -> ParameterDescriptor:
    """Meaning, unit and range of a parameter, as `ros2 param describe` shows them."""
    unit = f" [{declaration.unit}]" if declaration.unit else ""
    result = ParameterDescriptor(
        description=declaration.meaning + unit,
        additional_constraints=declaration.range_text,
        read_only=not declaration.changeable,
        type=_TYPES[declaration.type_name].value,
        dynamic_typing="float" in declaration.type_name,  # an integer serves as well
    )
    # ROS ranges are closed on both sides; any other range is in the text, and `build` checks it.
    if declaration.low is not None and declaration.high is not None:
        if declaration.type_name == "float":
            result.floating_point_range = [
                FloatingPointRange(
                    from_value=float(declaration.low), to_value=float(declaration.high)
                )
            ]
        elif declaration.type_name == "int":
            result.integer_range = [
                IntegerRange(from_value=int(declaration.low), to_value=int(declaration.high))
            ]
    return result
