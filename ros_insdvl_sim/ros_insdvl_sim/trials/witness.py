"""Nodes of this process that listen to a graph: the only implementation of it.

Demo, fault rows, soak and tests wait through it for what happens. A wait is for an event; its limit
is there for a hang, and far above what a busy machine takes.
"""

import struct
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node

from insdvl.navigation.events import NS
from ros_insdvl.endpoints import subscribe
from ros_insdvl.process.executor import NodeExecutor
from ros_insdvl.qos import publisher_qos
from ros_insdvl.status.heard import HeardDiagnostics, HeardStatus
from ros_insdvl_sim.trials.environment import TrialError

PATIENCE = 600.0  # s of the wall; programs without a cache compile first, on a busy machine
DEPTH = 20_000  # messages that may wait for a subscriber

_STAMP = struct.Struct("<iI")  # of a header, behind the four bytes of encapsulation
_AnyNode = TypeVar("_AnyNode", bound=Node)


def stamp_of(data: bytes) -> int:
    """Stamp [ns] of a message with a header, from its bytes."""
    sec, nanosec = _STAMP.unpack_from(data, 4)
    return int(sec) * NS + int(nanosec)


class Witness:
    """A node that hears what is published, and the executor that turns it and others.

    Attributes:
        context: Of all nodes here.
        executor: Turns them.
        node: The witness itself.
        counts: Messages heard, by topic.
        diagnostics: What all nodes of the graph say of themselves.
    """

    def __init__(self, name: str = "witness", namespace: str | None = None) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.executor = NodeExecutor(context=self.context)
        self._nodes: list[Node] = []
        self.node = self.add(Node(name, namespace=namespace, context=self.context))
        self.counts: Counter[str] = Counter()
        self.diagnostics = HeardDiagnostics()
        subscribe(self.node, DiagnosticArray, "/diagnostics", self.diagnostics.add, publisher_qos())

    def add(self, node: _AnyNode) -> _AnyNode:
        """Turn another node of this context, and take it down at the end."""
        self._nodes.append(node)
        self.executor.add_node(node)
        return node

    def remove(self, node: Node) -> None:
        """Take a node down before the end."""
        self._nodes.remove(node)
        self.executor.remove_node(node)
        self.executor.let_go()
        node.destroy_node()

    def hear(self, message_type: type[Any], topic: str, handle: Callable[[bytes], None]) -> None:
        """Take the bytes of every message of a topic; none is lost."""
        qos = publisher_qos()
        qos.depth = DEPTH

        def count(data: bytes) -> None:
            self.counts[topic] += 1
            handle(data)

        subscribe(self.node, message_type, topic, count, qos, raw=True)

    def node_names(self) -> set[str]:
        """Full names of all nodes in the graph."""
        pairs = self.node.get_node_names_and_namespaces()
        return {f"{namespace.rstrip('/')}/{name}" for name, namespace in pairs}

    def status(self, node: str, cause: str) -> HeardStatus:
        """The last status of a cause; level -1 before the first."""
        statuses = self.diagnostics.report(node).statuses
        return statuses.get(cause, HeardStatus(-1, "not reported"))

    # Waiting

    def turn(self) -> None:
        """Handle the next message, or wait a moment for it."""
        self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        """Handle messages for a time of the wall."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.turn()

    def until(
        self, condition: Callable[[], Any], what: str = "it", patience: float = PATIENCE
    ) -> None:
        """Handle messages until a condition holds.

        Args:
            condition: The condition.
            what: Its name in the error.
            patience: The limit [s].

        Raises:
            TrialError: It does not hold within the limit.
        """
        deadline = time.monotonic() + patience
        while not condition():
            if time.monotonic() > deadline:
                raise TrialError(f"{what} did not happen within {patience:g} s")
            self.turn()

    def until_reported(self, *nodes: str, times: int = 1) -> None:
        """Handle messages until each node has reported its statuses so often from now on."""
        reports = self.diagnostics.report
        wanted = {node: reports(node).count + times for node in nodes}
        self.until(
            lambda: all(reports(node).count >= count for node, count in wanted.items()),
            f"a report of {', '.join(nodes)}",
        )

    def until_settled(
        self,
        state: Callable[[], Any],
        *nodes: str,
        done: Callable[[], bool] = lambda: False,
        reports: int = 3,
    ) -> None:
        """Handle messages until nothing more comes.

        Args:
            state: What may change; it is settled if it stays the same over some reports.
            nodes: Whose reports count.
            done: Ends the wait at once.
            reports: How many reports of each node.

        Raises:
            TrialError: The nodes do not report.
        """
        last: Any = object()  # no state yet
        wanted: dict[str, int] = {}
        deadline = time.monotonic() + PATIENCE
        while not done():
            counts = {node: self.diagnostics.report(node).count for node in nodes}
            now = state()
            if now != last:
                last, deadline = now, time.monotonic() + PATIENCE
                wanted = {node: count + reports for node, count in counts.items()}
            elif all(counts[node] >= count for node, count in wanted.items()):
                return
            if time.monotonic() > deadline:
                raise TrialError(f"{', '.join(nodes)} did not report for {PATIENCE:g} s")
            self.turn()

    def close(self) -> None:
        """Take all nodes down."""
        if not self.context.ok():
            return
        self.executor.let_go()
        self.executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        self.context.try_shutdown()
