"""A topic whose messages may have several types is received as its publisher has it."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu

from insdvl.messages.convert import TWIST, TWIST_WITH_COVARIANCE
from insdvl.messages.drivers import DVL_MSGS
from insdvl.messages.topics import BY_NAME, DVL
from insdvl.parameters.declaration import ParameterError
from ros_insdvl.discovery import chosen_type
from ros_insdvl.filter import FilterNode
from ros_insdvl.status.diagnostics import ERROR, OK, Status

DEADLINE = 120.0  # s; far beyond what any of these waits takes


class Pair:
    """A filter and a peer with publishers of its own participant, and a wait for both."""

    def __init__(self) -> None:
        self.contexts = Context(), Context()
        for context in self.contexts:
            context.init(initialize_logging=False)
        self.executors = [SingleThreadedExecutor(context=context) for context in self.contexts]
        self.filter = FilterNode(context=self.contexts[0])
        self.peer = Node("peer", context=self.contexts[1])
        for executor, node in zip(self.executors, (self.filter, self.peer), strict=True):
            executor.add_node(node)

    def until(self, condition: Callable[[], Any]) -> None:
        start = time.monotonic()
        while not condition():
            assert time.monotonic() - start < DEADLINE
            for executor in self.executors:
                executor.spin_once(timeout_sec=0.02)

    def connections(self) -> Status:
        (status,) = (s for s in self.filter.statuses() if s.cause == "connections")
        return status

    def close(self) -> None:
        for executor in self.executors:
            executor.shutdown()
        self.filter.destroy_node()
        self.peer.destroy_node()
        for context in self.contexts:
            context.shutdown()


@pytest.fixture
def pair(managed: Any) -> Iterator[Pair]:
    return managed(Pair())


@pytest.mark.parametrize("kind", [TwistStamped, TwistWithCovarianceStamped, Odometry])
def test_the_type_is_that_of_the_publisher(pair: Pair, kind: type[Any]) -> None:
    assert DVL not in pair.filter.inputs and "imu/data_raw" in pair.filter.inputs
    publisher = pair.peer.create_publisher(kind, DVL, 10)
    pair.until(lambda: publisher.get_subscription_count())
    assert pair.filter.inputs[DVL].msg_type is kind
    message = kind()
    message.header.stamp.sec = 5
    publisher.publish(message)
    pair.until(lambda: pair.filter.received[DVL] == 1)


def test_another_type_is_not_received_and_is_named_until_it_goes(
    pair: Pair, capfd: pytest.CaptureFixture[str]
) -> None:
    wrong = pair.peer.create_publisher(Imu, DVL, 10)
    text = f"{DVL} is not received: it has type sensor_msgs/msg/Imu, expected one of"
    pair.until(lambda: text in pair.connections().message)
    assert pair.connections().level == ERROR
    said = ""

    def is_logged() -> bool:
        nonlocal said
        said += capfd.readouterr().err
        return text in said

    pair.until(is_logged)
    assert DVL not in pair.filter.inputs
    pair.peer.destroy_publisher(wrong)
    right = pair.peer.create_publisher(TwistStamped, DVL, 10)
    pair.until(lambda: right.get_subscription_count())
    assert pair.filter.inputs[DVL].msg_type is TwistStamped
    pair.until(lambda: pair.connections().level == OK)


def test_a_second_type_on_the_topic_is_an_error_that_names_both(pair: Pair) -> None:
    first = pair.peer.create_publisher(TwistStamped, DVL, 10)
    pair.until(lambda: first.get_subscription_count())
    context = Context()
    context.init(initialize_logging=False)
    other = Node("other", context=context)
    other.create_publisher(Odometry, DVL, 10)
    try:
        pair.until(lambda: "nav_msgs/msg/Odometry" in pair.connections().message)
        assert f"expected {TWIST}" in pair.connections().message
        assert pair.connections().level == ERROR
    finally:
        other.destroy_node()
        context.shutdown()


def test_a_type_whose_package_is_not_here_is_an_error_that_names_it(pair: Pair) -> None:
    """A publisher of it cannot be made here, so the graph's answer is made up."""
    pair.filter.get_publishers_info_by_topic = lambda name: [Info()] if name == DVL else []
    pair.filter._discovery.look()
    assert DVL not in pair.filter.inputs
    text = pair.filter.unheard[DVL]
    assert text.startswith(f"message type {DVL_MSGS} is not installed: no Debian package has it")


class Info:
    """An endpoint in the graph."""

    topic_type = DVL_MSGS


def test_two_types_before_there_is_a_subscription() -> None:
    topic = BY_NAME[DVL]
    assert chosen_type(DVL, topic, set()) == ""
    assert chosen_type(DVL, topic, {TWIST, "other_msgs/msg/Other"}) == TWIST
    with pytest.raises(ParameterError, match=f"{TWIST} and {TWIST_WITH_COVARIANCE}.* dvl.type"):
        chosen_type(DVL, topic, {TWIST_WITH_COVARIANCE, TWIST})
    with pytest.raises(ParameterError, match="has type a/msg/A, b/msg/B, expected one of"):
        chosen_type(DVL, topic, {"b/msg/B", "a/msg/A"})


def test_a_configured_type_is_subscribed_at_once_or_named(managed: Any) -> None:
    context = Context()
    context.init(initialize_logging=False)
    try:
        node = FilterNode(context=context, parameter_overrides=[Parameter("dvl.type", value=TWIST)])
        assert node.inputs[DVL].msg_type is TwistStamped
        node.destroy_node()
        with pytest.raises(ParameterError, match=f"{DVL_MSGS} is not installed: .*dvl_msgs"):
            FilterNode(context=context, parameter_overrides=[Parameter("dvl.type", value=DVL_MSGS)])
    finally:
        context.shutdown()
