"""A node that runs goes on whatever a callback raises, and says so; that of a test raises."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu

from insdvl.tuner.parameters import TunerParameters
from ros_insdvl.diagnostics import ERROR, OK
from ros_insdvl.node import InsdvlNode, run

DEADLINE = 60.0  # s; far beyond what any of these waits takes
QOS = QoSProfile(depth=100)


class Raising(InsdvlNode[TunerParameters]):
    """Echoes a message, or raises what nobody expects."""

    def __init__(self, **options: Any) -> None:
        super().__init__("raising", TunerParameters, **options)
        self._echo = self.advertise(Imu, "echo")
        self.listen(Imu, "in", self._take, QOS)
        self.start_diagnostics()

    def _take(self, message: Imu) -> None:
        if message.header.frame_id == "bad":
            raise ZeroDivisionError("of no use")
        self._echo.send(message)


class Peer:
    """A node that talks to a `Raising`."""

    def __init__(self) -> None:
        self.context = Context()
        self.context.init()
        self.node = Node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.echoed: list[Imu] = []
        self.errors = DiagnosticStatus()
        self.publisher = self.node.create_publisher(Imu, "in", QOS)
        self.node.create_subscription(Imu, "echo", self.echoed.append, QOS)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._keep, QOS)

    def _keep(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/raising: unexpected errors":
                self.errors = status

    def until(self, condition: Callable[[], Any]) -> None:
        start = time.monotonic()
        while not condition():
            assert time.monotonic() - start < DEADLINE
            self.executor.spin_once(timeout_sec=0.1)

    def send(self, *frames: str) -> None:
        for frame in frames:
            message = Imu()
            message.header.frame_id = frame
            self.publisher.publish(message)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture
def peer() -> Iterator[Peer]:
    made = Peer()
    yield made
    made.close()


def test_the_node_goes_on_counts_logs_and_tells(peer: Peer, tmp_path: Path) -> None:
    log = tmp_path / "log"
    environment = {**os.environ, "ROS_LOG_DIR": "/proc/none/log"}  # none can be made there
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, __file__], stdout=file, stderr=file, env=environment
        )
    try:
        peer.until(lambda: peer.publisher.get_subscription_count() == 1)
        peer.until(lambda: peer.node.count_publishers("echo") == 1)
        peer.until(lambda: peer.errors.name and peer.errors.level == OK)
        peer.send("bad", "good", "bad", "bad", "good")
        peer.until(lambda: len(peer.echoed) == 2)
        peer.until(lambda: peer.errors.level == ERROR)
        assert "3 unexpected errors" in peer.errors.message
        assert [item.value for item in peer.errors.values] == ["3"]
        # A request that rclpy itself cannot read.
        client = peer.node.create_client(SetParameters, "raising/set_parameters")
        peer.until(client.service_is_ready)
        request = SetParameters.Request(parameters=[ParameterMessage(name="rate")])
        request.parameters[0].value.type = 77
        client.call_async(request)
        peer.until(lambda: "4 unexpected errors" in peer.errors.message)
        process.send_signal(signal.SIGTERM)
        assert process.wait(DEADLINE) == 0
    finally:
        process.kill()
        process.wait()
    text = log.read_text()
    assert text.count("ZeroDivisionError: of no use") == 1  # the first, with its traceback
    assert "in _take" in text
    assert "77 is not a valid" in text
    assert "no log file, the log goes to the terminal only" in text
    assert "/proc/none/log" in text


def test_an_executor_of_a_test_raises(peer: Peer) -> None:
    node = Raising(context=peer.context)
    peer.executor.add_node(node)
    peer.until(lambda: peer.publisher.get_subscription_count() == 1)
    peer.send("bad")
    with pytest.raises(ZeroDivisionError, match="of no use"):
        peer.until(lambda: False)
    node.destroy_node()


if __name__ == "__main__":
    sys.exit(run(Raising))
