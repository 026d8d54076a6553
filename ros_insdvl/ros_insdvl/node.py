"""What all nodes share: parameters of a group, counted topics, and statuses."""

import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future

from insdvl import kernels
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.refusals import Refused
from insdvl.parameters.declaration import ParameterError, declarations
from ros_insdvl.endpoints import Output, subscribe
from ros_insdvl.parameters import changes, declare
from ros_insdvl.process.arguments import parameter_files
from ros_insdvl.qos import overridable, publisher_qos, sensor_qos
from ros_insdvl.status.connections import Connections
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl.status.reporter import Reporter
from ros_insdvl.status.unexpected import UNEXPECTED, UnexpectedErrors

_Group = TypeVar("_Group")


class InsdvlNode(Node, Generic[_Group]):
    """A node with the parameters of a group, counted topics and statuses in /diagnostics.

    Attributes:
        parameters: The group with this node's values.
        received: Messages per topic, as the topic is named in the code.
        rejected: Messages that were not used, by topic and reason.
        inputs: The subscriptions, by topic.
        unheard: Topics that have publishers but cannot be subscribed to, and why.
        outputs: The publishers, by topic.
        finished: Completed with the exit code by a node that ends by itself.
    """

    #: Inputs that have one publisher; a second one is worth a warning.
    single_inputs: tuple[str, ...] = ()

    def __init__(
        self,
        name: str,
        group: type[_Group],
        *,
        others: Collection[type[Any]] = (),
        **options: Any,
    ) -> None:
        """Declare the parameters, before anything is published.

        Args:
            name: Name of the node.
            group: Its parameters, a dataclass (see `insdvl.parameters`).
            others: Those of the other nodes in the process.
            options: Of `rclpy.node.Node`, such as ``namespace`` and ``parameter_overrides``.

        Raises:
            ParameterError: A parameter is wrong.
        """
        ours = sys.argv[1:] if options.get("use_global_arguments", True) else []
        files = parameter_files([*ours, *(options.get("cli_args") or [])])
        super().__init__(name, **options)
        try:
            self.parameters = declare(self, group, files, others)
        except ParameterError:
            self.destroy_node()
            raise
        self._changeable = {d.name for d in declarations(group) if d.changeable}
        self.received: Counter[str] = Counter()
        self.rejected: Counter[Refused] = Counter()
        self.inputs: dict[str, Subscription] = {}
        self.unheard: dict[str, str] = {}
        self.outputs: dict[str, Output] = {}
        self.finished: Future = Future()
        self._handlers: dict[str, Callable[[Any], None]] = {}
        self._takers: dict[str, list[Callable[[Any], None]]] = {}
        self._given: set[str] = set()  # inputs that another node of this process hands on
        self._heard: dict[str, float] = {}
        self._unexpected = UnexpectedErrors()

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
        decode: Callable[[bytes], Any] | None = None,
    ) -> None:
        """A counted subscription; its quality of service is `sensor_qos` unless given.

        A `RejectedMessage` from the callback is counted by its reason. With ``raw`` the callback
        takes the message's bytes. ``decode`` reads a message from its bytes where it can, faster
        than rclpy; it gives None for one that rclpy is to read.
        """
        self.received.setdefault(topic, 0)
        takers = self._takers.setdefault(topic, [])

        def read(data: bytes) -> None:
            assert decode is not None
            message = decode(data)
            handle(deserialize_message(data, message_type) if message is None else message)

        def handle(message: Any) -> None:
            self.received[topic] += 1
            self._heard[topic] = time.monotonic()
            try:
                callback(message)
            except RejectedMessage as rejection:
                self.reject(topic, rejection.reason, str(rejection))
            finally:
                for take in takers:
                    take(message)

        self._handlers[topic] = handle
        if topic in self._given:
            return
        self.inputs[topic] = subscribe(
            self,
            message_type,
            topic,
            handle if decode is None else read,
            qos or sensor_qos(),
            raw=raw or decode is not None,
            overrides=overridable(),
        )

    def ignore(self, topic: str) -> None:
        """End a subscription."""
        self.destroy_subscription(self.inputs.pop(topic))

    def hand_on(self, topic: str, taker: "InsdvlNode[Any]") -> None:
        """Give the messages of a topic to another node of this process, as they are here.

        Those of an input when this node has handled them, those of an output when they are sent.
        The other node ends its subscription, and counts and handles them as if they came by it.

        Args:
            topic: An input or output of this node, and an input of the other.
            taker: The other node.
        """
        taker.ignore(topic)
        taker._given.add(topic)
        take = partial(taker._take, topic)
        if topic in self.outputs:
            self.outputs[topic].takers.append(take)
        else:
            self._takers[topic].append(take)
            taker.inputs[topic] = self.inputs[topic]  # to which the other's connections belong now

    def _take(self, topic: str, message: Any) -> None:
        """Handle a message of another node, which no error of this one reaches."""
        try:
            self._handlers[topic](message)
        except Exception as error:
            self.fail(error)

    def compiling(self) -> AbstractContextManager[None]:
        """Say in the log what the first start of a version compiles, and how long that takes."""
        log = self.get_logger()
        return kernels.compiling(
            begins=lambda why: log.info(
                f"compiling, {why}: about a minute, on a small computer some minutes; "
                "`insdvl warm` does it in advance"
            ),
            ends=lambda seconds: log.info(f"compiled in {seconds:.0f} s"),
            warns=log.warning,
        )

    def reject(self, topic: str, reason: str, detail: str) -> None:
        """Count a message that is not used; the first of each reason is logged."""
        refused = Refused(topic, reason)
        self.rejected[refused] += 1
        if self.rejected[refused] == 1:
            self.get_logger().warning(f"{topic} rejected, {detail} (further ones: /diagnostics)")

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Change parameters one by one, see `set_parameters_atomically`."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Change parameters; a refusal names the parameter, its value and what is allowed."""
        ours = [p for p in parameter_list if p.name in self._changeable]
        others = [p for p in parameter_list if p.name not in self._changeable]
        for parameter in others:  # rclpy forgets the name
            if not self.has_parameter(parameter.name):
                reason = f"unknown parameter '{parameter.name}'"
                return SetParametersResult(successful=False, reason=reason)
        before = self.parameters
        try:
            after, checked = changes(before, ours)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        result = super().set_parameters_atomically([*others, *checked])
        if result.successful and ours:
            self.parameters = after
            self.settings_changed(before)
        return result

    def settings_changed(self, before: _Group) -> None:
        """Parameters that may change at run time have changed; nodes that have some extend it."""

    def fail(self, error: Exception) -> None:
        """Count what a callback raised and nobody expected; the first of each is logged in full."""
        if self._unexpected.count(error):
            text = "".join(traceback.format_exception(error))
            self.get_logger().error(f"unexpected error, the node continues: {text}")

    def finish(self, exit_code: int) -> None:
        """End the node's spinning with an exit code."""
        if not self.finished.done():
            self.finished.set_result(exit_code)

    # Diagnostics

    def start_diagnostics(self) -> None:
        """Report the statuses once a second of the steady clock, from now on."""
        self._connections = Connections(self, self.single_inputs)
        self._view = View(time.monotonic())
        self._reporter = Reporter(
            self, self.statuses, lambda: [self._unexpected.status(self._view)]
        )

    def counts(self) -> Counter[str]:
        """What the node has counted beside its messages since the start; nodes extend it."""
        return Counter({UNEXPECTED: self._unexpected.total})

    def causes(self, view: View) -> list[Status]:
        """The node's own statuses; nodes extend it."""
        return []

    def statuses(self) -> list[Status]:
        """All statuses, as of now."""
        self._view.look(
            time.monotonic(),
            received=self.received,
            sent={topic: output.count for topic, output in self.outputs.items()},
            rejected=self.rejected,
            events=self.counts(),
            heard=self._heard,
        )
        publishers = {topic: output.publisher for topic, output in self.outputs.items()}
        return [
            *self.causes(self._view),
            self._connections.status(self.inputs, publishers, self.unheard),
            self._unexpected.status(self._view),
        ]
