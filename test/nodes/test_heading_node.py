"""A heading in the filter node: in the messages of its IMU, and on a topic found by its type."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import QuaternionStamped, TwistWithCovarianceStamped
from graphs import RELIABLE, Graph, reliable
from nav_msgs.msg import Odometry
from ros_messages import sample_at_rest, stamp_of
from sensor_msgs.msg import Imu
from told import TOLD

from insdvl.messages.make import set_quaternion
from insdvl.navigation.events import NS
from insdvl.parameters.declaration import ParameterError
from ros_insdvl.conversions import time_of
from ros_insdvl.filter import FilterNode
from ros_insdvl.status.heard import OK, WARN

NODE = "/auv/insdvl_filter"
START_NS = 1_700_000_000 * NS
STARTED = {n: v for n, v in TOLD.items() if n == "initial.mode" or n.endswith("_std")}


class HeadingGraph(Graph):
    """The filter, and a peer with an IMU and a compass."""

    def __init__(self, topic: str, **parameters: Any) -> None:
        super().__init__("/auv")
        self.publishers = {
            "imu/data_raw": self.peer.create_publisher(Imu, "imu/data_raw", RELIABLE)
        }
        if topic != "imu/data_raw":
            compass = self.peer.create_publisher(QuaternionStamped, topic, RELIABLE)
            self.publishers[topic] = compass
        self.filter = self.make(
            FilterNode,
            **reliable("/auv", *self.publishers),
            **STARTED,
            **{"heading.topic": topic, "heading.interval": 0.0, **parameters},
        )
        self.innovations = self.keep(TwistWithCovarianceStamped, "heading/innovation")
        self.odometry = self.keep(Odometry, "odometry/global")
        self.until(
            lambda: (
                all(p.get_subscription_count() for p in self.publishers.values())
                and self.filter.outputs["heading/innovation"].listeners
                and self.filter.outputs["odometry/global"].listeners
            )
        )

    def send(self, topic: str, message: Any) -> None:
        target = self.filter.received[topic] + 1
        self.publishers[topic].publish(message)
        self.until(lambda: self.filter.received[topic] == target)

    def status(self) -> Any:
        self.until_reported(NODE, times=2)
        return self.diagnostics.report(NODE).statuses["heading"]


@pytest.fixture
def graph(managed: Any) -> Callable[..., HeadingGraph]:
    return lambda topic, **parameters: managed(HeadingGraph(topic, **parameters))


def facing(message: Any, yaw: float) -> None:
    q = (0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0))
    set_quaternion(message.quaternion if hasattr(message, "quaternion") else message.orientation, q)


def test_the_orientation_of_the_imu_is_a_heading(graph: Callable[..., HeadingGraph]) -> None:
    """Counterclockwise from east: the innovation is about z of the stream."""
    g = graph("imu/data_raw")
    for k in range(1, 30):
        message = sample_at_rest(START_NS, k)
        facing(message, 0.01 + 1e-5 * k)
        message.orientation_covariance = np.diag([1e-4, 1e-4, 1e-3]).ravel()
        g.send("imu/data_raw", message)
    g.until(lambda: len(g.innovations) == 29 and len(g.odometry) == 29)
    first = g.innovations[0]
    assert stamp_of(first) == START_NS + NS // 100
    assert first.header.frame_id == "imu_link"
    assert first.twist.twist.angular.z == pytest.approx(0.01 + 1e-5, abs=1e-6)
    assert first.twist.twist.linear.z == 0.0
    assert first.twist.covariance.reshape(6, 6)[5, 5] > 1e-3
    assert g.status().level == OK
    yaw = 2.0 * np.arcsin(g.odometry[-1].pose.pose.orientation.z)
    assert 0.001 < yaw < 0.011  # between what it was told at the start, 1 deg, and the heading


def test_an_imu_that_does_not_measure_it_is_named(graph: Callable[..., HeadingGraph]) -> None:
    g = graph("imu/data_raw")
    for k in range(1, 10):
        message = sample_at_rest(START_NS, k)
        message.orientation_covariance[0] = -1.0
        g.send("imu/data_raw", message)
    status = g.status()
    assert status.level == WARN
    assert "9 no_data" in status.message
    assert len(g.odometry) == 9


def test_a_compass_is_found_by_its_type(graph: Callable[..., HeadingGraph]) -> None:
    g = graph("compass")
    for k in range(1, 10):
        g.send("imu/data_raw", sample_at_rest(START_NS, k))
        message = QuaternionStamped()
        message.header.stamp = time_of(START_NS + k * NS // 100)
        facing(message, 0.02 + 1e-4 * k)
        g.send("compass", message)
    g.until(lambda: len(g.innovations) == 9)
    assert g.innovations[0].twist.twist.angular.z == pytest.approx(0.0201, abs=1e-6)


def test_another_name_of_the_imus_topic_is_refused() -> None:
    """By a namespace or a remap; it would be heard twice, and imu.mount would not count."""
    with pytest.raises(ParameterError) as caught:
        Graph("/auv").make(FilterNode, **{"heading.topic": "/auv/imu/data_raw"})
    assert str(caught.value) == (
        "parameter 'heading.topic' must be 'imu/data_raw', got '/auv/imu/data_raw': to ROS both "
        "are /auv/imu/data_raw, whose messages have both"
    )
