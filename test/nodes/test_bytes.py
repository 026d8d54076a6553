"""Messages of the IMU that are not in the usual layout are read all the same."""

import struct
from typing import Any

import pytest
from graphs import RELIABLE, Graph, reliable
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from ros_messages import sample_at_rest, stamp_of
from sensor_msgs.msg import Imu

from insdvl.messages.cdr.imu_bytes import decode_imu
from insdvl.navigation.events import NS
from ros_insdvl.filter import FilterNode

START_NS = 1_700_000_000 * NS


def big_endian(message: Imu) -> bytes:
    """The message as a machine of the other byte order sends it."""
    frame_id = message.header.frame_id.encode() + b"\0"
    stamp, q = message.header.stamp, message.orientation
    w, f = message.angular_velocity, message.linear_acceleration
    head = struct.pack(">iII", stamp.sec, stamp.nanosec, len(frame_id)) + frame_id
    numbers = [
        *(q.x, q.y, q.z, q.w, *message.orientation_covariance),
        *(w.x, w.y, w.z, *message.angular_velocity_covariance),
        *(f.x, f.y, f.z, *message.linear_acceleration_covariance),
    ]
    return b"\0\0\0\0" + head + bytes(-len(head) % 8) + struct.pack(">37d", *numbers)


@pytest.fixture
def graph(managed: Any) -> Graph:
    return managed(Graph("/bytes"))


def test_rclpy_reads_what_the_fast_parser_does_not(graph: Graph) -> None:
    node = graph.make(
        FilterNode, **{"initial.mode": "parameters"}, **reliable("/bytes", "imu/data_raw")
    )
    heard = graph.keep(Odometry, "odometry/filtered")
    imu = graph.peer.create_publisher(Imu, "imu/data_raw", RELIABLE)
    graph.until(lambda: imu.get_subscription_count() == 1)
    graph.until(lambda: graph.peer.count_publishers("odometry/filtered") == 1)
    for k in range(1, 21):
        message = sample_at_rest(START_NS, k)
        usual, other = serialize_message(message), big_endian(message)
        assert decode_imu(usual) is not None and decode_imu(other) is None
        imu.publish(other if k % 2 else usual)
    graph.until(lambda: len(heard) == 20)
    assert [stamp_of(message) for message in heard] == [
        START_NS + k * NS // 100 for k in range(1, 21)
    ]
    assert node.received["imu/data_raw"] == 20 and not node.rejected


def test_a_message_that_is_refused_is_refused_in_the_same_words(graph: Graph) -> None:
    """Whichever decoder reads it: what is wrong is found behind both."""
    node = graph.make(FilterNode, **reliable("/bytes", "imu/data_raw"))
    imu = graph.peer.create_publisher(Imu, "imu/data_raw", RELIABLE)
    graph.until(lambda: imu.get_subscription_count() == 1)
    no_stamp, not_finite, no_data = (sample_at_rest(START_NS, k) for k in (1, 2, 3))
    no_stamp.header.stamp.sec = no_stamp.header.stamp.nanosec = 0
    not_finite.angular_velocity.y = float("nan")
    no_data.linear_acceleration_covariance[0] = -1.0
    for message in (no_stamp, not_finite, no_data):
        imu.publish(message)
        imu.publish(big_endian(message))
    graph.until(lambda: node.received["imu/data_raw"] == 6)
    assert {refused.reason: count for refused, count in node.rejected.items()} == {
        "no_stamp": 2,
        "not_finite": 2,
        "no_data": 2,
    }
