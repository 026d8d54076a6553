"""Publishers that count, and subscriptions that catch up."""

from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from ros_insdvl.qos import overridable

#: Messages of a topic that a node handles before it looks at its other topics.
TURN = 20


class Output:
    """A publisher that counts what it sends.

    Attributes:
        publisher: The publisher.
        count: Number of messages sent.
        takers: Nodes of this process that are given each message, see `InsdvlNode.hand_on`.
    """

    def __init__(self, node: Node, message_type: type[Any], topic: str, qos: QoSProfile) -> None:
        self.publisher = node.create_publisher(
            message_type, topic, qos, qos_overriding_options=overridable()
        )
        self.count = 0
        self.takers: list[Callable[[Any], None]] = []

    def send(self, message: Any) -> None:
        """Publish a message; it is serialised here, so the caller may use it again."""
        self.publisher.publish(message)
        self.count += 1
        for take in self.takers:
            take(message)

    @property
    def listeners(self) -> int:
        """Number of matching subscriptions."""
        return int(self.publisher.get_subscription_count())

    def acknowledged(self, timeout: Duration) -> bool:
        """Whether all that was sent reaches the reliable subscriptions within a time."""
        return bool(self.publisher.wait_for_all_acked(timeout))


def subscribe(
    node: Node,
    message_type: type[Any],
    topic: str,
    handle: Callable[[Any], None],
    qos: QoSProfile,
    *,
    raw: bool = False,
    overrides: QoSOverridingOptions | None = None,
) -> Subscription:
    """A subscription that handles all waiting messages in one turn, up to `TURN`.

    To find out which topic has a message costs the executor more than the message itself, so a node
    that is behind would stay behind; one that is not behind never notices.

    Args:
        node: The node.
        message_type: Class of the messages.
        topic: Name of the topic.
        handle: Takes a message, or with ``raw`` its bytes.
        qos: Quality of service.
        raw: Whether messages stay serialised.
        overrides: What of the quality of service parameters may change.
    """

    def take_turn(message: Any) -> None:
        handle(message)
        for _ in range(TURN - 1):
            try:
                with subscription.handle:
                    taken = subscription.handle.take_message(message_type, raw)
            except InvalidHandle:  # the callback has ended the subscription
                return
            if taken is None:
                return
            handle(taken[0])

    subscription = node.create_subscription(
        message_type, topic, take_turn, qos, raw=raw, qos_overriding_options=overrides
    )
    return subscription
