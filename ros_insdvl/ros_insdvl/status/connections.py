"""The cause `connections`: endpoints that do not match, a second publisher, nodes of one name.

Everything is asked of the graph at each look, so what has left it is no longer reported.
"""

import time
from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ros_insdvl.status.diagnostics import ERROR, WARN, Status

#: A killed process stays in the graph until its lease expires: Fast DDS' is 20 s.
LEASE = 20.0
#: Outputs that other nodes publish as well.
SHARED = ("/tf",)
#: Used as the name of a node that the graph does not know yet.
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
        self,
        inputs: Mapping[str, Subscription],
        outputs: Mapping[str, Publisher],
        unheard: Mapping[str, str],
    ) -> Status:
        """The status of the connections.

        Args:
            inputs: The node's subscriptions, by topic.
            outputs: Its publishers, by topic.
            unheard: Topics that it cannot subscribe to, and why.
        """
        status = Status("connections", "all endpoints match")
        self._report_names(status)
        for topic, reason in unheard.items():
            status.complain(ERROR, f"unheard {topic}", reason)
        for topic, subscription in inputs.items():
            publishers, subscriptions = self._endpoints(topic)
            status.values[f"publishers {topic}"] = len(publishers)
            self._report_mismatches(status, topic, subscription, subscriptions, publishers)
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
            self._report_mismatches(status, topic, publisher, publishers, subscriptions)
            rivals = sorted({*map(_name, publishers)} - {self._name, UNKNOWN})
            if rivals and topic not in SHARED:
                status.complain(
                    ERROR,
                    f"rivals {topic}",
                    f"{topic} is also published by {', '.join(rivals)}: stop it, or give one a "
                    "namespace; subscribers receive both",
                )
        return status

    def _endpoints(self, topic: str) -> tuple[list[TopicEndpointInfo], list[TopicEndpointInfo]]:
        """Publishers and subscriptions of a topic, the node's own included."""
        return (
            self._node.get_publishers_info_by_topic(topic),
            self._node.get_subscriptions_info_by_topic(topic),
        )

    def _report_names(self, status: Status) -> None:
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
            "subscribers receive both"
            + ("" if lasts > LEASE else f" (a killed node stays listed for {LEASE:.0f} s)"),
        )

    def _report_mismatches(
        self,
        status: Status,
        topic: str,
        entity: Subscription | Publisher,
        same: list[TopicEndpointInfo],
        others: list[TopicEndpointInfo],
    ) -> None:
        """Complain of endpoints that never exchange a message with ours.

        Args:
            status: Takes the complaints.
            topic: As the node names it.
            entity: Our endpoint.
            same: The topic's endpoints of its kind, ours among them.
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
                    f"{what} has type {other.topic_type}, expected {type_name}: remap one of them",
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
                        f"{self._node.resolve_topic_name(topic)}.{ours}.*, or those of the other "
                        "side",
                    )


def _mismatch(offered: QoSProfile, asked: QoSProfile) -> str:
    """Why a publisher and a subscription exchange nothing; empty if they do.

    Both profiles come from the graph, where nothing is left to a default.
    """
    compatibility, reason = qos_check_compatible(offered, asked)
    if compatibility != QoSCompatibility.ERROR:
        return ""
    return ", ".join(part.removeprefix("ERROR: ") for part in reason.split(";") if part)


def _name(endpoint: TopicEndpointInfo) -> str:
    """Full name of an endpoint's node, which the graph may learn later than the endpoint."""
    if endpoint.node_name == "_NODE_NAME_UNKNOWN_":
        return UNKNOWN
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _type_name(message_type: Any) -> str:
    package, kind, _ = message_type.__module__.split(".")
    return f"{package}/{kind}/{message_type.__name__}"
