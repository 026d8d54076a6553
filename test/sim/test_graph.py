"""Simulator, tuner and filter in one process with one executor: the whole graph."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

from insdvl.messages.convert import stamp_ns
from insdvl.navigation.events import NS
from ros_insdvl.filter import FilterNode
from ros_insdvl.tuner import TunerNode
from ros_insdvl_sim.simulator import Simulator

RELIABLE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
DEADLINE = 120.0  # s; far beyond what any of these waits takes
DURATION = 6.0


class Graph:
    """The three nodes and a listener."""

    def __init__(self) -> None:
        self.context = Context()
        self.context.init()
        reliable = {
            f"qos_overrides./auv/{topic}.subscription.reliability": "reliable"
            for topic in ("imu/data_raw", "dvl/velocity")
        }
        self.peer = Node("peer", namespace="/auv", context=self.context)
        self.received: dict[str, list[Any]] = {}
        topics = {
            "odometry/filtered": Odometry,
            "ground_truth/odometry": Odometry,
            "process_noise": Imu,
        }
        for topic, kind in topics.items():
            self.received[topic] = []
            self.peer.create_subscription(kind, topic, self.received[topic].append, RELIABLE)
        self.filter = self.make(
            FilterNode,
            **reliable,
            **{"process_noise.source": "external", "gate.enabled": False, "origin.height": -5.0},
        )
        tuner_qos = "qos_overrides./auv/imu/data_raw.subscription.reliability"
        self.tuner = self.make(TunerNode, **{tuner_qos: "reliable"})
        self.simulator = self.make(
            Simulator, rate_factor=20.0, min_subscribers=2, duration=DURATION, seed=3
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in (self.peer, self.filter, self.tuner, self.simulator):
            self.executor.add_node(node)

    def make(self, node: Any, **parameters: Any) -> Any:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        return node(namespace="/auv", context=self.context, parameter_overrides=overrides)

    def until(self, condition: Callable[[], bool]) -> None:
        start = time.monotonic()
        while not condition():
            assert time.monotonic() - start < DEADLINE
            self.executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        for node in (self.simulator, self.tuner, self.filter, self.peer):
            node.destroy_node()
        self.context.shutdown()


@pytest.fixture(scope="module")
def graph() -> Iterator[Graph]:
    made = Graph()
    made.until(made.simulator.finished.done)
    made.until(
        lambda: (
            len(made.received["odometry/filtered"]) == 100 * DURATION
            and len(made.received["process_noise"]) == DURATION - 1
            and made.filter.received["process_noise"] == DURATION - 1
            and stamp_ns(made.received["ground_truth/odometry"][-1].header) == DURATION * NS
        )
    )
    yield made
    made.close()


def test_every_sample_gives_one_odometry(graph: Graph) -> None:
    stamps = [stamp_ns(message.header) for message in graph.received["odometry/filtered"]]
    assert stamps == [k * NS // 100 for k in range(1, int(100 * DURATION) + 1)]
    assert graph.filter.rejected == {}


def test_noise_is_learned_once_a_second_and_used(graph: Graph) -> None:
    stamps = [stamp_ns(message.header) for message in graph.received["process_noise"]]
    assert stamps == [second * NS for second in range(2, int(DURATION) + 1)]
    state = graph.filter._fold.latest
    learned = graph.received["process_noise"][-1]
    np.testing.assert_allclose(
        np.diag(state["noise"]["Q_f"]), learned.linear_acceleration_covariance[::4], rtol=1e-12
    )
    assert state["noise"]["q_ns"] == DURATION * NS
    assert learned.orientation_covariance[0] == -1.0


def test_velocity_follows_the_truth(graph: Graph) -> None:
    truth = {stamp_ns(m.header): m for m in graph.received["ground_truth/odometry"]}
    error = []
    for message in graph.received["odometry/filtered"]:
        v, v_true = message.twist.twist.linear, truth[stamp_ns(message.header)].twist.twist.linear
        error.append([v.x - v_true.x, v.y - v_true.y, v.z - v_true.z])
    # The filter starts at rest by its parameters, the vehicle at 1 m/s.
    assert np.linalg.norm(error[0]) > 0.5
    assert np.sqrt(np.mean(np.sum(np.square(error[300:]), axis=1))) < 0.5
