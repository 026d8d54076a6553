"""Nodes of a test in one process: those under test, a peer that talks to them, one executor."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from ros_insdvl.status import reporter
from ros_insdvl_sim.trials.witness import Witness

REPORT_PERIOD = 0.1  # s between the diagnostics of a node here, so that no test waits for seconds
RELIABLE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def overrides(parameters: dict[str, Any]) -> list[Parameter]:
    """Parameters as rclpy takes them."""
    return [
        Parameter(name, value=list(value) if isinstance(value, tuple) else value)
        for name, value in parameters.items()
    ]


def reliable(namespace: str, *topics: str) -> dict[str, Any]:
    """Parameters of reliable subscriptions: nothing that a test sends is lost."""
    return {
        f"qos_overrides.{namespace}/{topic}.subscription.reliability": "reliable"
        for topic in topics
    }


class Graph(Witness):
    """A peer in a namespace, and the nodes that it makes there."""

    def __init__(self, namespace: str = "") -> None:
        super().__init__("peer", namespace or None)
        self.namespace = namespace
        self.peer = self.node

    def make(self, kind: Callable[..., Any], **parameters: Any) -> Any:
        """A node of ours, turned here; it reports every `REPORT_PERIOD`."""
        with mock.patch.object(reporter, "PERIOD", REPORT_PERIOD):
            node = kind(
                namespace=self.namespace or None,
                context=self.context,
                parameter_overrides=overrides(parameters),
            )
        return self.add(node)

    def keep(
        self, kind: type[Any], topic: str, qos: QoSProfile = RELIABLE, *, raw: bool = False
    ) -> list[Any]:
        """All messages of a topic from now on."""
        kept: list[Any] = []
        self.peer.create_subscription(kind, topic, kept.append, qos, raw=raw)
        return kept

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """The response of a service."""
        client = self.peer.create_client(kind, service)
        self.until(client.service_is_ready, service)
        future = client.call_async(request)
        self.until(future.done, f"the response of {service}")
        self.peer.destroy_client(client)
        return future.result()


@contextmanager
def participant(name: str, namespace: str) -> Iterator[Node]:
    """A node in the graph, as if it were another process."""
    context = Context()
    context.init(initialize_logging=False)
    node = Node(name, namespace=namespace, context=context, enable_rosout=False)
    yield node
    node.destroy_node()
    context.shutdown()


def children_of(pid: int) -> dict[int, str]:
    """The command lines of a process' children, by their ids."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return {int(c): Path(f"/proc/{c}/cmdline").read_bytes().decode() for c in children}


def runs(pid: int) -> bool:
    """Whether a process is there, and not only waits to be reaped."""
    try:
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0]
    except (ProcessLookupError, FileNotFoundError):
        return False
    return state != "Z"
