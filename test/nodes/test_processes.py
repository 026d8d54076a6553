"""Nodes as processes: they find each other, do their work and end cleanly."""

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from graphs import RELIABLE, Graph
from nav_msgs.msg import Odometry
from ros_messages import sample_at_rest, stamp_of
from sensor_msgs.msg import Imu

from insdvl.navigation.events import NS

START_NS = 1_700_000_000_000_000_000
DEADLINE = 300.0  # s; far beyond what a process takes to end
FILTER = [
    *("-p", "qos_overrides./imu/data_raw.subscription.reliability:=reliable"),
    *("-p", "initial.mode:=parameters"),
]


class Peer(Graph):
    """A node of this process, and the nodes that it starts as processes."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []

    def start(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{len(self.processes)}.log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", f"ros_insdvl.{module}", "--ros-args", *arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self.processes.append(process)
        return process

    def output(self, process: subprocess.Popen[bytes]) -> str:
        return (self.folder / f"{self.processes.index(process)}.log").read_text()

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
        super().close()


@pytest.fixture
def peer(managed: Any, tmp_path: Path) -> Peer:
    return managed(Peer(tmp_path))


def imu_message(k: int) -> Imu:
    return sample_at_rest(START_NS, k)


def test_killed_and_restarted_it_goes_on_from_its_state_file(peer: Peer) -> None:
    received: list[Odometry] = []
    peer.node.create_subscription(Odometry, "odometry/filtered", received.append, RELIABLE)
    publisher = peer.node.create_publisher(Imu, "imu/data_raw", RELIABLE)
    arguments = [*FILTER, "-p", f"state_file:={peer.folder / 'state'}", "-p", "state_period:=0.1"]

    def takers() -> set[bytes]:
        infos = peer.node.get_subscriptions_info_by_topic("/imu/data_raw")
        return {bytes(info.endpoint_gid) for info in infos}

    def givers() -> set[bytes]:
        infos = peer.node.get_publishers_info_by_topic("/odometry/filtered")
        return {bytes(info.endpoint_gid) for info in infos}

    def fly(first: int, last: int) -> subprocess.Popen[bytes]:
        # One that was killed stays in the graph for a while: the new one is whom nobody knew.
        known = takers() | givers()
        process = peer.start("filter", *arguments)
        peer.until(lambda: takers() - known and givers() - known)
        peer.until(lambda: publisher.get_subscription_count() == len(takers()))
        target = len(received) + last - first
        for k in range(first, last):
            publisher.publish(imu_message(k))
        peer.until(lambda: len(received) == target)
        return process

    killed = fly(1, 301)
    before = received[-1]
    killed.kill()
    killed.wait()
    process = fly(401, 431)
    after = received[-30]
    assert stamp_of(after) == START_NS + 401 * NS // 100
    assert after.pose.pose.position.z == pytest.approx(before.pose.pose.position.z, abs=0.5)
    # Of 1.09 s from the state that was written last, at 2.91 s: 0.5 m/s^2 may have gone unseen.
    grown = after.twist.covariance[14] - before.twist.covariance[14]
    assert 1.0 * 0.5 < grown**0.5 < 1.2 * 0.5
    process.send_signal(signal.SIGTERM)
    assert process.wait(DEADLINE) == 0
    assert "from the state at stamp 1700000002.9" in peer.output(process)


def interrupt_twice(
    peer: Peer, process: "subprocess.Popen[bytes]", kind: signal.Signals, gap: float
) -> None:
    """Two signals end a process cleanly."""
    process.send_signal(kind)
    time.sleep(gap)  # the second meets another stage of the end
    process.send_signal(kind)
    assert process.wait(DEADLINE) == 0
    assert "Traceback" not in peer.output(process)


def test_two_processes_lose_nothing(peer: Peer) -> None:
    received: list[Odometry] = []
    peer.node.create_subscription(Odometry, "odometry/filtered", received.append, RELIABLE)
    publisher = peer.node.create_publisher(Imu, "imu/data_raw", RELIABLE)
    process = peer.start("filter", *FILTER)
    peer.until(lambda: publisher.get_subscription_count() == 1)
    peer.until(lambda: peer.node.count_publishers("odometry/filtered") == 1)
    for k in range(1, 1001):
        publisher.publish(imu_message(k))
    peer.until(lambda: len(received) == 1000)
    expected = [START_NS + k * NS // 100 for k in range(1, 1001)]
    assert [stamp_of(message) for message in received] == expected
    interrupt_twice(peer, process, signal.SIGINT, 0.005)


@pytest.mark.parametrize(
    ("module", "kind", "gap"),
    [
        ("filter", signal.SIGINT, 0.0),  # two at once may become one
        pytest.param("filter", signal.SIGTERM, 0.05, marks=pytest.mark.long),
        ("monitor", signal.SIGTERM, 0.005),
    ],
)
def test_interrupted_twice_it_ends_cleanly(
    peer: Peer, module: str, kind: signal.Signals, gap: float
) -> None:
    topic = {"filter": "imu/data_raw", "monitor": "ground_truth/odometry"}[module]
    process = peer.start(module)
    peer.until(lambda: peer.node.count_subscribers(topic) == 1)
    interrupt_twice(peer, process, kind, gap)
    peer.until(lambda: peer.node.count_subscribers(topic) == 0)


@pytest.mark.parametrize("gap", [0.005, pytest.param(0.05, marks=pytest.mark.long)])
def test_interrupted_under_load_it_ends_cleanly(peer: Peer, gap: float) -> None:
    received: list[Odometry] = []
    peer.node.create_subscription(Odometry, "odometry/filtered", received.append, RELIABLE)
    publisher = peer.node.create_publisher(Imu, "imu/data_raw", RELIABLE)
    process = peer.start("filter", *FILTER)
    peer.until(lambda: publisher.get_subscription_count() == 1)
    for k in range(1, 1501):
        publisher.publish(imu_message(k))
    peer.until(lambda: len(received) > 10)
    interrupt_twice(peer, process, signal.SIGINT, gap)
