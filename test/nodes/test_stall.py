"""A node whose callbacks stand still for 10 s loses no sample of an IMU at 1 kHz."""

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from graphs import Graph, reliable
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from ros_messages import stamp_of
from sensor_msgs.msg import Imu

from insdvl.messages.make import fill_imu, fill_twist
from insdvl.navigation.events import NS
from ros_insdvl.filter import FilterNode
from ros_insdvl.tuner import TunerNode

START_NS, RATE, STALL = 1_700_000_000 * NS, 1000, 10
COUNT = RATE * STALL
DEEP = QoSProfile(depth=2 * COUNT)
TYPE = "geometry_msgs/msg/TwistStamped"


def send_all(graph: Graph, imu: Any, dvl: Any) -> None:
    """What the sensors send meanwhile; nobody is turned."""
    sample, ping, rng = Imu(), TwistStamped(), np.random.default_rng(3)
    for k in range(1, COUNT + 1):
        stamp_ns = START_NS + k * NS // RATE
        f, w = rng.normal([0.0, 0.0, 9.8], 0.01), rng.normal(0.0, 1e-3, 3)
        fill_imu(sample, stamp_ns, f, w)
        imu.publish(sample)
        if k % RATE == 0:
            fill_twist(ping, stamp_ns, rng.normal(0.0, 0.02, 3))
            dvl.publish(ping)


@pytest.mark.long
def test_filter_and_tuner_lose_nothing_in_a_stall(managed: Any) -> None:
    graph = managed(Graph("/stall"))
    topics = "imu/data_raw", "dvl/velocity"
    node = graph.make(
        FilterNode,
        **{"imu.rate": float(RATE), "initial.mode": "parameters", "dvl.type": TYPE},
        **reliable("/stall", *topics),
    )
    tuner = graph.make(TunerNode, **reliable("/stall", topics[0]))
    heard = graph.keep(Odometry, "odometry/filtered", DEEP)
    imu = graph.peer.create_publisher(Imu, topics[0], DEEP)
    dvl = graph.peer.create_publisher(TwistStamped, topics[1], DEEP)
    graph.until(lambda: imu.get_subscription_count() == 2 and dvl.get_subscription_count() == 1)
    graph.until(lambda: graph.peer.count_publishers("odometry/filtered") == 1)
    send_all(graph, imu, dvl)
    graph.until(lambda: len(heard) == COUNT and tuner.received[topics[0]] == COUNT)
    assert [stamp_of(message) for message in heard[:: RATE // 2]] == [
        START_NS + k * NS // RATE for k in range(1, COUNT + 1, RATE // 2)
    ]
    assert node.received[topics[1]] == STALL
    assert not node.rejected and not tuner.rejected
