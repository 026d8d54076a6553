"""What all nodes share: parameters, counted topics, quality of service, diagnostics, the exit."""

import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from math import inf
from typing import Any, Generic, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle, InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
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

from insdvl.messages.convert import RejectedMessage
from insdvl.parameters.declaration import ParameterError
from ros_insdvl.connections import Connections
from ros_insdvl.diagnostics import ERROR, OK, RECENT, Recent, Status, View
from ros_insdvl.parameters import declare

_Group = TypeVar("_Group")

#: Messages of a topic that a node handles before it looks at its other topics.
TURN = 20


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


class Output:
    """A publisher that counts what it sends."""

    def __init__(self, node: Node, message_type: type[Any], topic: str, qos: QoSProfile) -> None:
        self.publisher = node.create_publisher(
            message_type, topic, qos, qos_overriding_options=_overridable()
        )
        self.count = 0

    def send(self, message: Any) -> None:
        """Publish a message; it is serialised here, so the caller may use it again."""
        self.publisher.publish(message)
        self.count += 1

    @property
    def listeners(self) -> int:
        """How many subscriptions match."""
        return int(self.publisher.get_subscription_count())

    def acknowledged(self, timeout: Duration) -> bool:
        """Whether all that was sent arrives at the reliable subscriptions within a time."""
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
    """A node with the parameters of a group, counted topics and statuses in /diagnostics.

    Attributes:
        parameters: The group with this node's values.
        received: Messages per topic, as the topic is named in the code.
        rejected: Messages that were not used, by ``topic: reason``.
        inputs: The subscriptions, by topic.
        outputs: The publishers, by topic.
        finished: Completed with the exit code by a node that ends by itself.
    """

    #: Inputs that have one publisher; a second one is worth a warning.
    single_inputs: tuple[str, ...] = ()

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
        self.inputs: dict[str, Subscription] = {}
        self.outputs: dict[str, Output] = {}
        self.finished: Future = Future()
        self._heard: dict[str, float] = {}
        self._failures: Counter[str] = Counter()

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
    ) -> None:
        """A counted subscription; its quality of service is `sensor_qos` unless given.

        A `RejectedMessage` from the callback is counted by its reason. With ``raw`` the callback
        takes the message's bytes.
        """
        self.received.setdefault(topic, 0)

        def handle(message: Any) -> None:
            self.received[topic] += 1
            self._heard[topic] = time.monotonic()
            try:
                callback(message)
            except RejectedMessage as rejection:
                self.reject(topic, rejection.reason, str(rejection))

        self.inputs[topic] = subscribe(
            self,
            message_type,
            topic,
            handle,
            qos or sensor_qos(),
            raw=raw,
            overrides=_overridable(),
        )

    def ignore(self, topic: str) -> None:
        """End a subscription."""
        self.destroy_subscription(self.inputs.pop(topic))

    def reject(self, topic: str, reason: str, detail: str) -> None:
        """Count a message that is not used; the first of each reason is logged."""
        key = f"{topic}: {reason}"
        self.rejected[key] += 1
        if self.rejected[key] == 1:
            self.get_logger().warning(f"{topic} rejected, {detail} (further ones: /diagnostics)")

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Refuse a change by the parameter's name; rclpy forgets the name of an unknown one."""
        for parameter in parameter_list:
            if not self.has_parameter(parameter.name):
                reason = f"unknown parameter '{parameter.name}'"
                return SetParametersResult(successful=False, reason=reason)
        return super().set_parameters_atomically(parameter_list)

    def fail(self, error: Exception) -> None:
        """Count what a callback raised and nobody expected; the first of each is logged whole."""
        place = traceback.extract_tb(error.__traceback__)[-1]
        key = f"{type(error).__name__} at {place.name}, line {place.lineno}"
        self._failures[key] += 1
        if self._failures[key] == 1:
            text = "".join(traceback.format_exception(error))
            self.get_logger().error(f"unexpected error, the node goes on: {text}")

    def finish(self, exit_code: int) -> None:
        """End the node's spinning with an exit code."""
        if not self.finished.done():
            self.finished.set_result(exit_code)

    # Diagnostics

    def start_diagnostics(self) -> None:
        """Publish the statuses once a second of the steady clock."""
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", publisher_qos())
        self._connections = Connections(self, self.single_inputs)
        self._recent = Recent()
        self._looked = time.monotonic()
        self._told: dict[str, dict[str, bytes]] = {}
        self.create_timer(
            1.0, self._publish_statuses, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def counts(self) -> Counter[str]:
        """What has been counted since the start, see `View`; nodes extend it."""
        counts = Counter({f"received {topic}": n for topic, n in self.received.items()})
        counts.update({f"sent {topic}": output.count for topic, output in self.outputs.items()})
        counts.update({f"rejected {key}": n for key, n in self.rejected.items()})
        counts.update({"unexpected errors": self._failures.total()})
        return counts

    def causes(self, view: View) -> list[Status]:
        """The node's own statuses; nodes extend it."""
        return []

    def statuses(self) -> list[Status]:
        """All statuses, as of now."""
        now = time.monotonic()
        total = self.counts()
        self._recent.look(now, total)
        elapsed, self._looked = max(now - self._looked, 1e-3), now
        step = self._recent.step
        view = View(
            total=total,
            recent=self._recent.growth,
            rates={
                topic: step[f"{verb} {topic}"] / elapsed
                for verb, topics in (("received", self.received), ("sent", self.outputs))
                for topic in topics
            },
            silence={topic: now - self._heard.get(topic, -inf) for topic in self.received},
        )
        publishers = {topic: output.publisher for topic, output in self.outputs.items()}
        return [
            *self.causes(view),
            self._connections.status(self.inputs, publishers),
            self._unexpected(view),
        ]

    def _unexpected(self, view: View) -> Status:
        status = Status("unexpected errors", "none")
        status.values.update(self._failures)
        if count := view.recent["unexpected errors"]:
            status.complain(
                ERROR,
                "errors",
                f"{count} unexpected errors in the last {RECENT:.0f} s: this is a bug, please "
                "report what the node's log says; where they go on, start the node again",
            )
        return status

    def _publish_statuses(self) -> None:
        statuses = self.statuses()
        self._log_changes(statuses)
        name = self.get_fully_qualified_name()
        message = DiagnosticArray(status=[status.of_node(name) for status in statuses])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _log_changes(self, statuses: list[Status]) -> None:
        """A line for each complaint that is new or worse, and for each status well again."""
        for status in statuses:
            before = self._told.get(status.cause, {})
            for complaint in status.complaints:
                if complaint.level <= before.get(complaint.about, OK):
                    continue
                # One line each: rclpy keeps the level of a line of code.
                if complaint.level == ERROR:
                    self.get_logger().error(f"{status.cause}: {complaint.text}")
                else:
                    self.get_logger().warning(f"{status.cause}: {complaint.text}")
            if before and status.level == OK:
                self.get_logger().info(f"{status.cause}: ok again, {status.summary}")
            self._told[status.cause] = {c.about: c.level for c in status.complaints}


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
        _init()
    except RuntimeError as error:  # what rcl's errors are derived from
        print(f"cannot start ROS: {error}", file=sys.stderr)
        return 2
    try:
        node = factory()
        nodes.append(node)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        _turn(executor, node)
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


def _init() -> None:
    """Start ROS, without log files where their folder cannot be written."""
    try:
        rclpy.init()
    except RuntimeError as error:
        if "logging" not in str(error):
            raise
        rclpy.try_shutdown()
        rclpy.init(args=[*sys.argv, "--ros-args", "--disable-external-lib-logs"])
        print(f"no log file, the log goes to the terminal only: {error}", file=sys.stderr)


def _turn(executor: SingleThreadedExecutor, node: InsdvlNode[Any]) -> None:
    """Handle messages until the node finishes; no message, whatever is in it, ends this.

    Only a node that runs by itself goes on like this: an executor of a test's own raises.
    """
    # rclpy's own spin_until_future_complete adds such a callback with every turn and forgets none.
    node.finished.add_done_callback(lambda future: executor.wake())
    while rclpy.ok() and not node.finished.done():
        try:
            executor.spin_once()
        except ExternalShutdownException:
            raise
        except Exception as error:
            if not rclpy.ok():  # interrupted: the middleware is gone
                return
            node.fail(error)


def _ignore_interrupts() -> None:
    """A further Ctrl-C while the node is taken down would end in a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
