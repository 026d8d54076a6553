"""A topic whose messages may have several types is received as its publisher has it."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu

from insdvl.messages import topics
from insdvl.messages.topics import BY_NAME, DVL, DVL_WITH_COVARIANCE, TOPICS
from ros_insdvl.filter import FilterNode

DEADLINE = 120.0  # s; far beyond what any of these waits takes


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[FilterNode, Node, Any]]:
    """A filter that takes either type of DVL on one topic, a peer, and a wait for both."""
    types = BY_NAME[DVL].types + BY_NAME[DVL_WITH_COVARIANCE].types
    rows = [topic for topic in TOPICS if topic.measurement != "dvl"]
    monkeypatch.setattr(topics, "TOPICS", (*rows, replace(BY_NAME[DVL], types=types)))
    context = Context()
    context.init()
    executor = SingleThreadedExecutor(context=context)
    peer = Node("peer", context=context)
    node = FilterNode(context=context)
    executor.add_node(peer)
    executor.add_node(node)

    def until(condition: Callable[[], Any]) -> None:
        start = time.monotonic()
        while not condition():
            assert time.monotonic() - start < DEADLINE
            executor.spin_once(timeout_sec=0.1)

    yield node, peer, until
    executor.shutdown()
    node.destroy_node()
    peer.destroy_node()
    context.shutdown()


@pytest.mark.parametrize("kind", [TwistStamped, TwistWithCovarianceStamped])
def test_the_type_is_that_of_the_publisher(graph: Any, kind: type[Any]) -> None:
    node, peer, until = graph
    assert DVL not in node.inputs and "imu/data_raw" in node.inputs
    publisher = peer.create_publisher(kind, DVL, 10)
    until(lambda: publisher.get_subscription_count())
    assert node.inputs[DVL].msg_type is kind
    message = kind()
    message.header.stamp.sec = 5
    publisher.publish(message)
    until(lambda: node.received[DVL] == 1)


def test_another_type_is_not_received_and_is_named(
    graph: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    node, peer, until = graph
    wrong = peer.create_publisher(Imu, DVL, 10)
    said = ""

    def is_named() -> bool:
        nonlocal said
        said += capfd.readouterr().err
        return f"{DVL} is not received: it has type sensor_msgs/msg/Imu, expected one of" in said

    until(is_named)
    assert DVL not in node.inputs
    peer.destroy_publisher(wrong)
    right = peer.create_publisher(TwistStamped, DVL, 10)
    until(lambda: right.get_subscription_count())
    assert node.inputs[DVL].msg_type is TwistStamped
