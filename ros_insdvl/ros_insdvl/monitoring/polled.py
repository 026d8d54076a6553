"""Subscriptions that are looked at now and then, and never wake the executor.

For each message that comes the executor looks at everything that it waits for, which costs more
than ten times the message itself. The middleware keeps what comes meanwhile.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from ros_insdvl.qos import overridable


class _Never(CallbackGroup):
    """Callbacks that no executor waits for."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


class Polled:
    """A topic.

    Args:
        node: That subscribes.
        message_type: Class of the messages.
        topic: Its name.
        handle: Takes a message, as bytes.
        qos: Quality of service; its depth is what may come between two looks.

    Attributes:
        subscription: The subscription.
    """

    def __init__(
        self,
        node: Node,
        message_type: type[Any],
        topic: str,
        handle: Callable[[bytes], None],
        qos: QoSProfile,
    ) -> None:
        self._handle = handle
        self.subscription: Subscription = node.create_subscription(
            message_type,
            topic,
            handle,
            qos,
            callback_group=_Never(),
            raw=True,
            qos_overriding_options=overridable(),
        )

    def look(self) -> None:
        """Handle all messages that have come."""
        subscription = self.subscription
        with subscription.handle:
            for _ in range(subscription.qos_profile.depth):  # what still comes waits
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    return
                self._handle(taken[0])


class Last:
    """The last message of a topic, decoded when it is asked for.

    Args:
        message_type: Its class.
    """

    def __init__(self, message_type: type[Any]) -> None:
        self._type = message_type
        self._data: deque[bytes] = deque(maxlen=1)

    def add(self, data: bytes) -> None:
        """Keep a message."""
        self._data.append(data)

    @property
    def message(self) -> Any:
        """It, None before the first."""
        return deserialize_message(self._data[-1], self._type) if self._data else None
