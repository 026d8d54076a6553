"""A parameter group of the core as the declared parameters of a ROS 2 node."""

from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from insdvl.parameters.declaration import Declaration, ParameterError, build, declarations, flatten
from insdvl.parameters.sections import is_ros_name

_Group = TypeVar("_Group")


#: Values of the qos_overrides that `ros_insdvl.qos` offers; rclpy does not name a wrong one.
_QOS_VALUES = {
    "history": ("keep_last", "keep_all", "system_default"),
    "reliability": ("reliable", "best_effort", "best_available", "system_default"),
    "durability": ("volatile", "transient_local", "best_available", "system_default"),
}


def declare(node: Node, group: type[_Group]) -> _Group:
    """Declare every parameter of a group on a node, and return the group with the node's values.

    The parameters are read-only: a node is built from them once.

    Args:
        node: The node, before it has publishers.
        group: A dataclass of parameters (see `insdvl.parameters`).

    Raises:
        ParameterError: An override has an unknown name, a wrong type or is out of range, or the
            values contradict each other.
    """
    overrides = {}
    # rclpy ignores undeclared overrides, and no public attribute holds them.
    for name, override in node._parameter_overrides.items():
        if name.startswith("qos_overrides."):
            _check_qos(name, override.value)
        elif not is_ros_name(name):
            overrides[name] = override.value
    instance = build(group, overrides)
    values = flatten(instance)
    for declaration in declarations(group):
        value = values[declaration.name]
        node.declare_parameter(
            declaration.name,
            list(value) if isinstance(value, tuple) else value,
            descriptor(declaration),
        )
    return instance


def _check_qos(name: str, value: Any) -> None:
    policy = name.rsplit(".", 1)[-1]
    if policy == "depth":
        right, allowed = type(value) is int and value > 0, "an int > 0"
    elif policy in _QOS_VALUES:
        right, allowed = value in _QOS_VALUES[policy], "one of " + ", ".join(_QOS_VALUES[policy])
    else:
        right, allowed = False, "removed: policies are depth, " + ", ".join(_QOS_VALUES)
    if not right:
        raise ParameterError(f"parameter '{name}' must be {allowed}, got {value!r}")


def descriptor(declaration: Declaration) -> ParameterDescriptor:
    """Meaning, unit and range of a parameter, as `ros2 param describe` shows them."""
    unit = f" [{declaration.unit}]" if declaration.unit else ""
    result = ParameterDescriptor(
        description=declaration.meaning + unit,
        additional_constraints=declaration.range_text,
        read_only=True,
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
