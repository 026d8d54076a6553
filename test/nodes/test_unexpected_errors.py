"""A node that runs goes on whatever a callback raises, and says so; that of a test raises."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import graphs
import pytest
from graphs import Graph
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu

from insdvl.tuner.parameters import TunerParameters
from ros_insdvl.node import InsdvlNode
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl.status.heard import ERROR, OK, HeardStatus
from ros_insdvl.status.unexpected import UNEXPECTED

NODE = "/raising"
DEADLINE = 300.0  # s; far beyond what a process takes to end
QOS = QoSProfile(depth=100)


class Raising(InsdvlNode[TunerParameters]):
    """Echoes a message, or raises what nobody expects, there or in its statuses."""

    def __init__(self, **options: Any) -> None:
        super().__init__("raising", TunerParameters, **options)
        self._echo, self._is_ill = self.advertise(Imu, "echo"), False
        self.listen(Imu, "in", self._take, QOS)
        self.start_diagnostics()

    def _take(self, message: Imu) -> None:
        if message.header.frame_id == "bad":
            raise ZeroDivisionError("of no use")
        self._is_ill = message.header.frame_id == "ill"
        self._echo.send(message)

    def causes(self, view: View) -> list[Status]:
        if self._is_ill:
            raise ArithmeticError("of a status")
        return []


class Peer(Graph):
    """A node that talks to a `Raising`."""

    def __init__(self) -> None:
        super().__init__()
        self.echoed = self.keep(Imu, "echo", QOS)
        self.publisher = self.peer.create_publisher(Imu, "in", QOS)

    @property
    def errors(self) -> HeardStatus:
        return self.status(NODE, UNEXPECTED)

    def send(self, *frames: str) -> None:
        for frame in frames:
            message = Imu()
            message.header.frame_id = frame
            self.publisher.publish(message)


@pytest.fixture
def peer(managed: Any) -> Peer:
    return managed(Peer())


def test_the_node_goes_on_counts_logs_and_tells(peer: Peer, tmp_path: Path) -> None:
    log = tmp_path / "log"
    environment = {
        **os.environ,
        "ROS_LOG_DIR": "/proc/none/log",  # none can be made there
        "PYTHONPATH": str(Path(graphs.__file__).parent),
    }
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, __file__], stdout=file, stderr=file, env=environment
        )

    def until(condition: Callable[[], Any]) -> None:
        def holds() -> Any:
            assert process.poll() is None, log.read_text()
            return condition()

        peer.until(holds)

    try:
        until(lambda: peer.publisher.get_subscription_count() == 1)
        until(lambda: peer.peer.count_publishers("echo") == 1)
        until(lambda: peer.errors.level == OK)
        peer.send("bad", "good", "bad", "bad", "good")
        until(lambda: len(peer.echoed) == 2)
        until(lambda: peer.errors.level == ERROR)
        assert "3 unexpected errors" in peer.errors.message
        values = peer.diagnostics.report(NODE).values
        assert [v for key, v in values.items() if key.startswith("ZeroDivisionError")] == ["3"]
        # A request that rclpy itself cannot read.
        client = peer.peer.create_client(SetParameters, "raising/set_parameters")
        until(client.service_is_ready)
        request = SetParameters.Request(parameters=[ParameterMessage(name="rate")])
        request.parameters[0].value.type = 77
        client.call_async(request)
        until(lambda: "4 unexpected errors" in peer.errors.message)
        # Where the statuses themselves fail, that is told.
        peer.send("ill")
        until(
            lambda: any(
                key.startswith("Arithmetic") for key in peer.diagnostics.report(NODE).values
            )
        )
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
    peer.make(Raising)
    peer.until(lambda: peer.publisher.get_subscription_count() == 1)
    peer.send("bad")
    with pytest.raises(ZeroDivisionError, match="of no use"):
        peer.until(lambda: False)


if __name__ == "__main__":
    sys.exit(run_node(Raising, Help("none", "raising", "/raising", "", ())))
