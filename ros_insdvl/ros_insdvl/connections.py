"""Who else is in the graph: publishers and subscriptions that do not match, nodes of one name.

All is asked of the graph, so what has gone is told no more.
"""

import time
from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ros_insdvl.diagnostics import ERROR, WARN, Status

#: A process that was killed stays in the graph until its lease is over: Fast DDS' is 20 s.
LEASE = 20.0
#: Stands for the name of a node that the graph does not know.
UNKNOWN = "of an unknown node"


class Connections:
    """Looks at the graph around a node.

    Args:
        node: The node.
        single: Inputs on which a second publisher is worth a warning.
    """

    def __init__(self, node: Node, single: tuple[str, ...] = ()) -> None:
        self._node = node
        self._single = single
        self._name = node.get_fully_qualified_name()
        self._doubled_since: float | None = None

    def status(
        self, inputs: Mapping[str, Subscription], outputs: Mapping[str, Publisher]
    ) -> Status:
        """The status of the connections.

        Args:
            inputs: The node's subscriptions, by topic.
            outputs: Its publishers, by topic.
        """
        status = Status("connections", "all that is there matches")
        self._tell_names(status)
        for topic, subscription in inputs.items():
            publishers, subscriptions = self._endpoints(topic)
            status.values[f"publishers {topic}"] = len(publishers)
            self._tell_mismatches(status, topic, subscription, subscriptions, publishers)
            if topic in self._single and len(publishers) > 1:
                names = ", ".join(sorted(map(_name, publishers)))
                status.complain(
                    WARN,
                    f"publishers {topic}",
                    f"{len(publishers)} publishers of {topic} ({names}): stop all but one",
                )
        for topic, publisher in outputs.items():
            publishers, subscriptions = self._endpoints(topic)
            status.values[f"subscriptions {topic}"] = len(subscriptions)
            self._tell_mismatches(status, topic, publisher, publishers, subscriptions)
            rivals = sorted({*map(_name, publishers)} - {self._name, UNKNOWN})
            if rivals:
                status.complain(
                    ERROR,
                    f"rivals {topic}",
                    f"{topic} is published by {', '.join(rivals)} as well: stop it, or give one a "
                    "namespace; consumers get a mixture",
                )
        return status

    def _endpoints(self, topic: str) -> tuple[list[TopicEndpointInfo], list[TopicEndpointInfo]]:
        """Publishers and subscriptions of a topic, the node's own included."""
        return (
            self._node.get_publishers_info_by_topic(topic),
            self._node.get_subscriptions_info_by_topic(topic),
        )

    def _tell_names(self, status: Status) -> None:
        names = self._node.get_node_names_and_namespaces()
        same = sum(f"{space.rstrip('/')}/{name}" == self._name for name, space in names)
        now = time.monotonic()
        if same < 2:
            self._doubled_since = None
            return
        if self._doubled_since is None:
            self._doubled_since = now
        lasts = now - self._doubled_since
        status.complain(
            ERROR if lasts > LEASE else WARN,
            "names",
            f"{same} nodes are named {self._name}: stop all but one, or give each a namespace; "
            "consumers get a mixture"
            + ("" if lasts > LEASE else f" (one that was killed is listed for {LEASE:.0f} s)"),
        )

    def _tell_mismatches(
        self,
        status: Status,
        topic: str,
        entity: Subscription | Publisher,
        same: list[TopicEndpointInfo],
        others: list[TopicEndpointInfo],
    ) -> None:
        """Complain of endpoints that never exchange a message with ours.

        Args:
            status: Where to.
            topic: As the node calls it.
            entity: Ours.
            same: The topic's endpoints of its kind, itself among them.
            others: Those of the other kind.
        """
        subscribes = isinstance(entity, Subscription)
        ours, theirs = (
            ("subscription", "publisher") if subscribes else ("publisher", "subscription")
        )
        level = ERROR if subscribes else WARN
        type_name = _type_name(entity.msg_type)
        qos = next((end.qos_profile for end in same if _name(end) == self._name), None)
        for other in others:
            what = f"{theirs} {_name(other)} of {topic}"
            if other.topic_type != type_name:
                status.complain(
                    level,
                    f"type {what}",
                    f"{what} has the type {other.topic_type} and not {type_name}: remap one of "
                    "the two",
                )
            elif qos is not None:
                offered, asked = (
                    (other.qos_profile, qos) if subscribes else (qos, other.qos_profile)
                )
                if reason := _mismatch(offered, asked):
                    status.complain(
                        level,
                        f"qos {what}",
                        f"{what} does not match, no message passes: {reason}; set qos_overrides."
                        f"{self._node.resolve_topic_name(topic)}.{ours}.*, or the other side's",
                    )


def _mismatch(offered: QoSProfile, asked: QoSProfile) -> str:
    """Why a publisher and a subscription exchange nothing; empty where they do.

    Both profiles are as the graph tells them, where nothing is left to a default.
    """
    compatibility, reason = qos_check_compatible(offered, asked)
    if compatibility != QoSCompatibility.ERROR:
        return ""
    return ", ".join(part.removeprefix("ERROR: ") for part in reason.split(";") if part)


def _name(endpoint: TopicEndpointInfo) -> str:
    """Full name of an endpoint's node; the graph may learn it later than the endpoint."""
    if endpoint.node_name == "_NODE_NAME_UNKNOWN_":
        return UNKNOWN
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _type_name(message_type: Any) -> str:
    package, kind, _ = message_type.__module__.split(".")
    return f"{package}/{kind}/{message_type.__name__}"
