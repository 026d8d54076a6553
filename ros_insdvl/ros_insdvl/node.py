"""What all nodes share: parameters, counted topics, quality of service, diagnostics, the exit."""

import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle, InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.task import Future

from insdvl.messages import RejectedMessage
from insdvl.parameters import ParameterError
from ros_insdvl.parameters import declare

_Group = TypeVar("_Group")

#: Messages of a topic that a node handles before it looks at its other topics.
TURN = 20

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR


def publisher_qos() -> QoSProfile:
    """Reliable and deep: a consumer that also asks for it loses nothing in a stall of seconds."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=2000, reliability=ReliabilityPolicy.RELIABLE
    )


def sensor_qos() -> QoSProfile:
    """Subscription to a sensor: best effort, so that every driver's publisher matches."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT
    )


def command_qos() -> QoSProfile:
    """Subscription to what is sent once and has to arrive; any reliable publisher matches."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE
    )


def latched_qos() -> QoSProfile:
    """Publisher whose last messages a consumer gets that starts later."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=10,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def _overridable() -> QoSOverridingOptions:
    return QoSOverridingOptions(
        (
            QoSPolicyKind.HISTORY,
            QoSPolicyKind.DEPTH,
            QoSPolicyKind.RELIABILITY,
            QoSPolicyKind.DURABILITY,
        )
    )


@dataclass
class Health:
    """What a node says of itself in /diagnostics; complaints raise the level."""

    level: bytes = OK
    complaints: list[str] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)

    def complain(self, level: bytes, text: str) -> None:
        """Add a complaint; the status takes the worst level of all of them."""
        self.level = max(self.level, level)
        self.complaints.append(text)


class Output:
    """A publisher that counts what it sends."""

    def __init__(self, node: Node, message_type: type[Any], topic: str, qos: QoSProfile) -> None:
        self._publisher = node.create_publisher(
            message_type, topic, qos, qos_overriding_options=_overridable()
        )
        self.count = 0

    def send(self, message: Any) -> None:
        """Publish a message; it is serialised here, so the caller may use it again."""
        self._publisher.publish(message)
        self.count += 1

    @property
    def listeners(self) -> int:
        """How many subscriptions match."""
        return int(self._publisher.get_subscription_count())

    def acknowledged(self, timeout: Duration) -> bool:
        """Whether all that was sent arrives at the reliable subscriptions within a time."""
        return bool(self._publisher.wait_for_all_acked(timeout))


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
    """A subscription whose turn takes all messages that wait, up to `TURN`.

    The executor spends more on finding out which topic has a message than a node on the message, so
    a node that is behind would stay behind; one that is not never notices.

    Args:
        handle: Takes a message, or with ``raw`` its bytes.
        overrides: What of the quality of service a parameter may change.
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


class InsdvlNode(Node, Generic[_Group]):
    """A node with the parameters of a group, counted topics and a status in /diagnostics.

    Attributes:
        parameters: The group with this node's values.
        received: Messages per topic, as the topic is named in the code.
        rejected: Messages that were not used, by ``topic: reason``.
        outputs: The publishers, by topic.
        finished: Completed with the exit code by a node that ends by itself.
    """

    def __init__(self, name: str, group: type[_Group], **options: Any) -> None:
        """Declare the parameters, before anything is published.

        Args:
            name: Name of the node.
            group: Its parameters, a dataclass (see `insdvl.parameters`).
            options: Of `rclpy.node.Node`, such as ``namespace`` and ``parameter_overrides``.

        Raises:
            ParameterError: A parameter is wrong.
        """
        super().__init__(name, **options)
        try:
            self.parameters = declare(self, group)
        except ParameterError:
            self.destroy_node()
            raise
        self.received: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.outputs: dict[str, Output] = {}
        self.finished: Future = Future()

    def advertise(
        self, message_type: type[Any], topic: str, qos: QoSProfile | None = None
    ) -> Output:
        """A counted publisher; its quality of service is `publisher_qos` unless given."""
        output = Output(self, message_type, topic, qos or publisher_qos())
        self.outputs[topic] = output
        return output

    def listen(
        self,
        message_type: type[Any],
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile | None = None,
        *,
        raw: bool = False,
    ) -> Subscription:
        """A counted subscription; its quality of service is `sensor_qos` unless given.

        A `RejectedMessage` from the callback is counted by its reason. With ``raw`` the callback
        takes the message's bytes.
        """
        self.received[topic] = 0

        def handle(message: Any) -> None:
            self.received[topic] += 1
            try:
                callback(message)
            except RejectedMessage as rejection:
                self.reject(topic, rejection.reason, str(rejection))

        return subscribe(
            self,
            message_type,
            topic,
            handle,
            qos or sensor_qos(),
            raw=raw,
            overrides=_overridable(),
        )

    def reject(self, topic: str, reason: str, detail: str) -> None:
        """Count a message that is not used; the first of each reason is logged."""
        key = f"{topic}: {reason}"
        self.rejected[key] += 1
        if self.rejected[key] == 1:
            self.get_logger().warning(f"{topic} rejected, {detail} (further ones: /diagnostics)")

    def start_diagnostics(self) -> None:
        """Publish the status once a second of the steady clock."""
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", publisher_qos())
        self._last_counts: Counter[str] = Counter()
        self._last_time = time.monotonic()
        self.create_timer(1.0, self._publish_status, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def health(self) -> Health:
        """The node's own part of its status; nodes extend it."""
        return Health()

    def finish(self, exit_code: int) -> None:
        """End the node's spinning with an exit code."""
        if not self.finished.done():
            self.finished.set_result(exit_code)

    def status(self) -> DiagnosticStatus:
        """The node's status, counters and rates included."""
        health = self.health()
        values = dict(health.values)
        counts = Counter(self.received)
        for topic, output in self.outputs.items():
            counts[topic] += output.count
            values[f"sent {topic}"] = output.count
        now = time.monotonic()
        elapsed = now - self._last_time
        for topic, count in self.received.items():
            values[f"received {topic}"] = count
        for topic, count in counts.items():
            values[f"rate {topic} [Hz]"] = f"{(count - self._last_counts[topic]) / elapsed:.1f}"
        for reason, count in self.rejected.items():
            values[f"rejected {reason}"] = count
        self._last_counts, self._last_time = counts, now
        return DiagnosticStatus(
            level=health.level,
            name=self.get_fully_qualified_name(),
            message="; ".join(health.complaints) or "running",
            hardware_id="insdvl",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )

    def _publish_status(self) -> None:
        message = DiagnosticArray(status=[self.status()])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def run(factory: Callable[[], InsdvlNode[Any]]) -> int:
    """Make a node and spin it until it finishes, is interrupted or is terminated.

    Returns:
        The exit code: 0 after SIGINT or SIGTERM, 2 where a parameter is wrong (one line on stderr
        names it), else what the node finished with. Any other exception passes, which ends a
        program with 1.
    """
    nodes: list[InsdvlNode[Any]] = []
    try:
        return _spin(factory, nodes)
    except KeyboardInterrupt:  # a second one, while the first was handled
        return 0
    finally:
        _ignore_interrupts()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def _spin(factory: Callable[[], InsdvlNode[Any]], nodes: list[InsdvlNode[Any]]) -> int:
    """As `run`, which takes down the node that is put into ``nodes``."""
    try:
        rclpy.init()
    except RuntimeError as error:  # what rcl's errors are derived from
        print(f"cannot read the ROS arguments: {error}", file=sys.stderr)
        return 2
    try:
        node = factory()
        nodes.append(node)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin_until_future_complete(node.finished)
        return int(node.finished.result()) if node.finished.done() else 0
    except (ParameterError, InvalidParameterTypeException) as error:
        print(error, file=sys.stderr)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        _ignore_interrupts()
        return 0
    except RuntimeError:  # what rcl's errors are derived from
        if rclpy.ok():
            raise
        return 0  # interrupted while the node was made: the middleware is gone


def _ignore_interrupts() -> None:
    """A further Ctrl-C while the node is taken down would end in a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
