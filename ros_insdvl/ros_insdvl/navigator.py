"""The nodes `insdvl_filter` and `insdvl_tuner` in one process, which decodes the IMU once.

Each is the node that it is in a process of its own, with its name, parameters, topics, services and
statuses. The filter's subscription of the IMU serves both. What the tuner learns is published as
always; the filter has it without the wire.
"""

import sys
from collections.abc import Iterator
from typing import Any

from insdvl.messages.topics import IMU, MEASUREMENT_NOISE, PROCESS_NOISE
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, flatten
from insdvl.tuner.models import ModelError
from insdvl.tuner.parameters import TunerParameters
from ros_insdvl.filter import FilterNode
from ros_insdvl.node import InsdvlNode
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_nodes
from ros_insdvl.tuner import TunerNode

HELP = Help(
    package="ros_insdvl",
    executable="navigator",
    node="/insdvl_filter",
    about="""
The filter and the tuner in one process, which receives and decodes the IMU once. Both nodes,
/insdvl_filter and /insdvl_tuner, are as those of the executables filter and tuner, with their
names, parameters, topics and services.

The filter uses what the tuner learns with process_noise.source 'external', and of the DVL with
dvl.noise_source 'adaptive' or 'learned'.
""",
    examples=(
        "--params-file vehicle.yaml",
        "-p process_noise.source:=external -p rate:=2.0",
    ),
)


def navigator_nodes(**options: Any) -> Iterator[InsdvlNode[Any]]:
    """The two nodes, which hand on to each other what both of them use.

    Args:
        options: Of both nodes, see `InsdvlNode`.

    Raises:
        ModelError: The tuner's model cannot be used.
        ParameterError: A parameter is wrong, or both nodes have one name.
    """
    filter_node = FilterNode(**options, others=[TunerParameters])
    yield filter_node
    tuner = TunerNode(**options, others=[FilterParameters])
    yield tuner
    name = filter_node.get_fully_qualified_name()
    if name == tuner.get_fully_qualified_name():
        raise ParameterError(
            f"both nodes are named {name}: rename one at a time, with "
            "-r insdvl_filter:__node:=NAME or -r insdvl_tuner:__node:=NAME"
        )
    _share(filter_node, IMU, tuner)
    if MEASUREMENT_NOISE in filter_node.inputs and MEASUREMENT_NOISE in tuner.outputs:
        _share(tuner, MEASUREMENT_NOISE, filter_node)
    if tuner.parameters.measurement_noise:
        _compare_vehicles(filter_node, tuner)
    if PROCESS_NOISE in filter_node.inputs:
        _share(tuner, PROCESS_NOISE, filter_node)
    else:
        source = filter_node.parameters.process_noise.source
        filter_node.get_logger().info(
            f"the tuner's process noise is published and not used: process_noise.source is "
            f"'{source}', not 'external'"
        )


def _compare_vehicles(filter_node: FilterNode, tuner: TunerNode) -> None:
    """Warn where the two nodes are told of different vehicles."""
    told, ours = (flatten(node.parameters) for node in (filter_node, tuner))
    same = flatten(tuner.parameters.of_vehicle(filter_node.parameters))
    if others := [name for name, value in same.items() if value != ours[name]]:
        text = ", ".join(f"{name} {ours[name]!r}, not {told[name]!r}" for name in others)
        tuner.get_logger().warning(
            f"measurement_noise is learned for another vehicle than the filter's: {text}; put what "
            "both nodes are to know into the section '/**:' of a parameter file"
        )


def _share(giver: InsdvlNode[Any], topic: str, taker: InsdvlNode[Any]) -> None:
    """Let a node hand on a topic to the other, unless a remap gives each a topic of its own."""
    theirs = taker.resolve_topic_name(topic)
    if giver.resolve_topic_name(topic) != theirs:
        return
    ignored = _subscription_qos(taker, theirs)
    if topic in giver.inputs and ignored != _subscription_qos(giver, theirs):
        taker.get_logger().warning(
            f"qos_overrides.{theirs}.subscription.* of this node are not used: the subscription is "
            f"that of {giver.get_name()}"
        )
    giver.hand_on(topic, taker)


def _subscription_qos(node: InsdvlNode[Any], topic: str) -> dict[str, Any]:
    """The quality of service that a node's parameters ask for."""
    found: dict[str, Any] = node.get_parameters_by_prefix(f"qos_overrides.{topic}.subscription")
    return {name: parameter.value for name, parameter in found.items()}


def main() -> int:
    """Run both nodes until they are interrupted."""
    try:
        return run_nodes(navigator_nodes, HELP)
    except ModelError:  # the tuner has logged it
        return 1


if __name__ == "__main__":
    sys.exit(main())
