"""The tuner node in a graph: what it publishes, its service, its diagnostics, its refusals."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

from insdvl.parameters.declaration import ParameterError
from insdvl.tuner.models import load_model
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner
from ros_insdvl import node
from ros_insdvl.diagnostics import Status
from ros_insdvl.tuner import TunerNode

START_NS = 1_700_000_000_123_000_000
STEP_NS = 10_000_000
VARIANCES = np.array([0.01, 0.02, 0.03, 0.002, 0.01, 0.04])
SHIPPED = load_model("paper").path
RELIABLE = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
DEADLINE = 30.0  # s; far beyond what any of these waits takes


class Graph:
    """The tuner in the namespace /auv, and a node that talks to it; one executor turns both."""

    def __init__(self, **parameters: object) -> None:
        self.context = Context()
        self.context.init()
        parameters["qos_overrides./auv/imu/data_raw.subscription.reliability"] = "reliable"
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        try:
            self.tuner = TunerNode(
                namespace="/auv", context=self.context, parameter_overrides=overrides
            )
        except BaseException:
            self.context.shutdown()
            raise
        self.peer = Node("peer", namespace="/auv", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.tuner)
        self.executor.add_node(self.peer)
        self.received: list[Imu] = []
        self.imu = self.peer.create_publisher(Imu, "imu/data_raw", RELIABLE)
        self.noise = self.listen("process_noise", RELIABLE, self.received)
        self.client = self.peer.create_client(SetBool, "insdvl_tuner/enable")
        self.until(lambda: self.imu.get_subscription_count() == 1)
        self.until(lambda: self.peer.count_publishers("process_noise") == 1)

    def listen(self, topic: str, qos: QoSProfile, into: list[Imu]) -> object:
        return self.peer.create_subscription(Imu, topic, into.append, qos)

    def until(self, condition: object) -> None:
        clock = self.peer.get_clock()
        start = clock.now()
        while not condition():
            assert (clock.now() - start).nanoseconds < DEADLINE * 1e9
            self.executor.spin_once(timeout_sec=0.1)

    def send(self, messages: list[Imu]) -> None:
        """Publish, and wait until the tuner has handled all."""
        target = self.tuner.received["imu/data_raw"] + len(messages)
        for message in messages:
            self.imu.publish(message)
        self.until(lambda: self.tuner.received["imu/data_raw"] == target)

    def wait_for_stamps(self, stamps: list[int]) -> None:
        self.until(lambda: len(self.received) >= len(stamps))
        assert [stamp_of(message) for message in self.received] == stamps

    def enable(self, value: bool) -> SetBool.Response:
        self.until(self.client.service_is_ready)
        future = self.client.call_async(SetBool.Request(data=value))
        self.until(future.done)
        return future.result()

    def close(self) -> None:
        self.executor.shutdown()
        self.tuner.destroy_node()
        self.peer.destroy_node()
        self.context.shutdown()


@pytest.fixture
def graph():
    graph = Graph()
    yield graph
    graph.close()


def stamp_of(message: Imu) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def imu_message(k: int, sample: np.ndarray) -> Imu:
    message = Imu()
    message.header.frame_id = "imu_link"
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(START_NS + k * STEP_NS, 10**9)
    f, w = message.linear_acceleration, message.angular_velocity
    f.x, f.y, f.z, w.x, w.y, w.z = sample.tolist()
    message.orientation.w = 0.5
    return message


def samples(n: int) -> np.ndarray:
    rng = np.random.default_rng(20)
    return np.array([0.0, 0.0, 9.8, 0.0, 0.0, 0.0]) + rng.normal(size=(n, 6)) * np.sqrt(VARIANCES)


def boundaries(first: int, last: int) -> list[int]:
    """Stamps on whole seconds' first samples: 1.7e9 s and some, at 0.123 s + k * 0.01 s."""
    return [1_700_000_000_000_000_000 + s * 10**9 + 3_000_000 for s in range(first, last + 1)]


def test_republishes_the_closing_sample_with_the_offline_tuners_variances(graph):
    data = samples(700)
    sent = [imu_message(k, sample) for k, sample in enumerate(data)]
    graph.send(sent)

    offline = Tuner(TunerParameters())
    expected = [
        tuned
        for k, sample in enumerate(data)
        if (tuned := offline.add(START_NS + k * STEP_NS, sample)) is not None
    ]
    graph.wait_for_stamps(boundaries(3, 7))
    assert [tuned.stamp_ns for tuned in expected] == boundaries(3, 7)
    by_stamp = {stamp_of(message): message for message in sent}
    for message, tuned in zip(graph.received, expected, strict=True):
        original = by_stamp[tuned.stamp_ns]
        assert message.header == original.header
        assert message.linear_acceleration == original.linear_acceleration
        assert message.angular_velocity == original.angular_velocity
        assert message.orientation_covariance[0] == -1.0
        np.testing.assert_array_equal(
            np.reshape(message.linear_acceleration_covariance, (3, 3)), np.diag(tuned.variances[:3])
        )
        np.testing.assert_array_equal(
            np.reshape(message.angular_velocity_covariance, (3, 3)), np.diag(tuned.variances[3:])
        )


def test_a_late_consumer_gets_the_last_estimates(graph):
    graph.send([imu_message(k, sample) for k, sample in enumerate(samples(700))])
    graph.wait_for_stamps(boundaries(3, 7))
    late: list[Imu] = []
    subscription = graph.listen("process_noise", LATCHED, late)
    graph.until(lambda: len(late) == 5)
    assert [stamp_of(message) for message in late] == boundaries(3, 7)
    graph.peer.destroy_subscription(subscription)


def test_the_service_stops_and_resumes_publishing(graph):
    sent = [imu_message(k, sample) for k, sample in enumerate(samples(800))]
    graph.send(sent[:400])  # up to 4.113 s
    assert graph.enable(False).success
    graph.send(sent[400:600])  # over 5 s and 6 s
    response = graph.enable(True)
    assert response.success and response.message == "enabled"
    graph.send(sent[600:])
    graph.wait_for_stamps([*boundaries(3, 4), *boundaries(7, 8)])


def test_starts_disabled_where_the_parameter_says_so():
    graph = Graph(enabled=False)
    sent = [imu_message(k, sample) for k, sample in enumerate(samples(500))]
    graph.send(sent[:400])
    graph.enable(True)
    graph.send(sent[400:])
    graph.wait_for_stamps(boundaries(5, 5))
    graph.close()


def test_unusable_messages_are_counted_and_named_in_the_diagnostics(graph):
    statuses: list[DiagnosticStatus] = []

    def keep(message: DiagnosticArray) -> None:
        statuses.extend(s for s in message.status if s.name.startswith("/auv/insdvl_tuner"))

    graph.peer.create_subscription(DiagnosticArray, "/diagnostics", keep, RELIABLE)
    sent = [imu_message(k, sample) for k, sample in enumerate(samples(500))]
    sent[210].linear_acceleration.x = float("nan")
    sent[220].angular_velocity.z = float("inf")
    sent[230].angular_velocity_covariance[0] = -1.0
    sent[240].header.stamp = sent[239].header.stamp
    sent[250].header.stamp = sent[245].header.stamp
    graph.send(sent)
    graph.wait_for_stamps(boundaries(3, 5))

    def value(name: str) -> str | None:
        found = [e.value for s in statuses for e in s.values if e.key == name]
        return found[-1] if found else None

    graph.until(lambda: value("samples") == "495")
    assert value("rejected imu/data_raw: not_finite") == "2"
    assert value("rejected imu/data_raw: no_data") == "1"
    assert value("duplicates") == "1"
    assert value("out_of_order") == "1"
    assert value("model") == "default"
    assert value("sent process_noise") == "3"
    assert float(value("Q sigma f_x [m/s^2]")) == pytest.approx(0.1, rel=0.2)
    imu = [s for s in statuses if s.name == "/auv/insdvl_tuner: imu"][-1]
    assert imu.level == DiagnosticStatus.WARN
    for text in ("2 not_finite", "1 no_data", "1 duplicates", "1 out_of_order"):
        assert text in imu.message


def test_the_diagnostics_warn_of_a_tuner_that_is_disabled_or_deaf(graph):
    def told(cause: str) -> tuple[bytes, str]:
        (status,) = (s for s in graph.tuner.statuses() if s.cause == cause)
        return status.level, status.message

    level, message = told("imu")
    assert level == DiagnosticStatus.ERROR
    assert "no imu/data_raw received" in message
    graph.send([imu_message(0, samples(1)[0])])
    assert {s.level for s in graph.tuner.statuses()} == {DiagnosticStatus.OK}
    graph.enable(False)
    level, message = told("process noise")
    assert level == DiagnosticStatus.WARN
    assert "disabled" in message


def test_a_window_that_reordering_empties_is_told_with_how_often(graph, monkeypatch):
    later = 0.0
    monkeypatch.setattr(node, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + later))

    def told() -> dict[str, Status]:
        return {status.cause: status for status in graph.tuner.statuses()}

    rows = samples(310)
    graph.send([imu_message(k, rows[k]) for k in range(10)])
    assert told()["process noise"].level == DiagnosticStatus.OK  # not yet full is nothing wrong
    later = 10.0
    blocks = [range(first, first + 30) for first in range(10, 310, 30)]
    swapped = [blocks[k ^ 1] for k in range(10)]  # each pair the other way round, 0.6 s apart
    graph.send([imu_message(k, rows[k]) for block in swapped for k in block])
    statuses = told()
    assert statuses["imu"].level == statuses["process noise"].level == DiagnosticStatus.WARN
    assert statuses["imu"].values["restarts"] == 5
    assert "5 restarts in the last 10 s: stamps went back" in statuses["imu"].message
    message = statuses["process noise"].message
    assert "5 gaps and 5 restarts emptied it" in message
    assert "raise max_gap (0.1 s)" in message
    graph.send([imu_message(k, row) for k, row in enumerate(samples(500), 310)])
    graph.until(lambda: graph.received)
    assert told()["process noise"].level == DiagnosticStatus.OK


def test_a_wrong_parameter_is_named():
    with pytest.raises(ParameterError, match=r"'rate'.*-1\.0"):
        Graph(rate=-1.0)


def run_tuner(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "ros_insdvl.tuner", "--ros-args", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ,
        check=False,
    )


def test_an_altered_model_ends_the_node_with_its_name_and_hash(tmp_path: Path):
    for file in (SHIPPED, SHIPPED.with_suffix(".json")):
        shutil.copy(file, tmp_path)
    model = tmp_path / "paper.npz"
    data = bytearray(model.read_bytes())
    data[len(data) // 2] ^= 1
    model.write_bytes(data)

    ended = run_tuner("-p", f"model:={model}")
    assert ended.returncode == 1
    assert str(model) in ended.stderr
    assert json.loads((tmp_path / "paper.json").read_text())["sha256"] in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_missing_model_ends_the_node_with_its_name(tmp_path: Path):
    ended = run_tuner("-p", f"model:={tmp_path / 'absent.npz'}")
    assert ended.returncode == 1
    assert str(tmp_path / "absent.json") in ended.stderr
    assert "Traceback" not in ended.stderr
