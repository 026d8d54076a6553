"""The tuner node in a graph: what it publishes, its service, its diagnostics, its refusals."""

import json
import shutil
import time
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from graphs import LATCHED, RELIABLE, Graph, reliable
from rclpy.parameter import Parameter
from ros_messages import STEP_NS, stamp_of
from sensor_msgs.msg import Imu
from starts import starts
from std_srvs.srv import SetBool

from insdvl.parameters.declaration import ParameterError
from insdvl.tuner import tuner as tuner_of_core
from insdvl.tuner.models import load_model
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner
from ros_insdvl import node
from ros_insdvl.status import diagnostics
from ros_insdvl.status.heard import OK, WARN
from ros_insdvl.tuner import TunerNode

NODE = "/auv/insdvl_tuner"
START_NS = 1_700_000_000_123_000_000
VARIANCES = np.array([0.01, 0.02, 0.03, 0.002, 0.01, 0.04])
SHIPPED = load_model("paper").path


class TunerGraph(Graph):
    """The tuner in the namespace /auv, and a peer that talks to it."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__("/auv")
        self.tuner = self.make(TunerNode, **reliable("/auv", "imu/data_raw"), **parameters)
        self.imu = self.peer.create_publisher(Imu, "imu/data_raw", RELIABLE)
        self.received = self.keep(Imu, "process_noise")
        self.until(lambda: self.imu.get_subscription_count() == 1)
        self.until(lambda: self.peer.count_publishers("process_noise") == 1)

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
        return self.call(SetBool, "insdvl_tuner/enable", SetBool.Request(data=value))


@pytest.fixture
def graph(managed):
    return managed(TunerGraph())


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
    late = graph.keep(Imu, "process_noise", LATCHED)
    graph.until(lambda: len(late) == 5)
    assert [stamp_of(message) for message in late] == boundaries(3, 7)


def test_the_service_stops_and_resumes_publishing(graph):
    sent = [imu_message(k, sample) for k, sample in enumerate(samples(800))]
    graph.send(sent[:400])  # up to 4.113 s
    assert graph.enable(False).success
    graph.send(sent[400:600])  # over 5 s and 6 s
    response = graph.enable(True)
    assert response.success and response.message == "enabled"
    graph.send(sent[600:])
    graph.wait_for_stamps([*boundaries(3, 4), *boundaries(7, 8)])


def test_service_and_parameter_say_the_same(graph):
    tuner = graph.tuner
    assert graph.enable(False).message == "disabled"
    assert tuner.get_parameter("enabled").value is tuner.parameters.enabled is False
    (result,) = tuner.set_parameters([Parameter("enabled", value=True)])
    assert result.successful and tuner._tuner.enabled
    assert tuner.get_parameter("enabled").value is True
    assert tuner.statuses()[1].values["enabled"] is True


def test_starts_disabled_where_the_parameter_says_so(managed):
    graph = managed(TunerGraph(enabled=False))
    sent = [imu_message(k, sample) for k, sample in enumerate(samples(500))]
    graph.send(sent[:400])
    graph.enable(True)
    graph.send(sent[400:])
    graph.wait_for_stamps(boundaries(5, 5))


def test_unusable_messages_are_counted_and_named_in_the_diagnostics(graph):
    sent = [imu_message(k, sample) for k, sample in enumerate(samples(500))]
    sent[210].linear_acceleration.x = float("nan")
    sent[220].angular_velocity.z = float("inf")
    sent[230].angular_velocity_covariance[0] = -1.0
    sent[240].header.stamp = sent[239].header.stamp
    sent[250].header.stamp = sent[245].header.stamp
    graph.send(sent)
    graph.wait_for_stamps(boundaries(3, 5))

    def value(name: str) -> str | None:
        return graph.diagnostics.report(NODE).values.get(name)

    graph.until(lambda: value("samples") == "495" and value("sent process_noise") == "3")
    assert value("rejected imu/data_raw: not_finite") == "2"
    assert value("rejected imu/data_raw: no_data") == "1"
    assert value("duplicates") == "1"
    assert value("out_of_order") == "1"
    assert value("model") == "default"
    assert float(value("Q sigma f_x [m/s^2]")) == pytest.approx(0.1, rel=0.2)
    imu = graph.status(NODE, "imu")
    assert imu.level == WARN
    for text in ("2 not_finite", "1 no_data", "1 duplicates", "1 out_of_order"):
        assert text in imu.message


def test_the_diagnostics_warn_of_a_tuner_that_is_disabled_or_deaf(graph):
    def told(cause: str) -> tuple[int, str]:
        graph.until_reported(NODE, times=2)
        return graph.status(NODE, cause)

    level, message = told("imu")
    assert level == WARN
    assert "waits for imu/data_raw" in message
    graph.send([imu_message(0, samples(1)[0])])
    graph.until_reported(NODE, times=2)
    assert {s.level for s in graph.diagnostics.report(NODE).statuses.values()} == {OK}
    graph.enable(False)
    level, message = told("process noise")
    assert level == WARN
    assert "disabled" in message


def test_a_window_that_reordering_empties_is_told_with_how_often(graph, monkeypatch):
    later = 0.0
    monkeypatch.setattr(node, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + later))

    def told() -> dict[str, diagnostics.Status]:
        return {status.cause: status for status in graph.tuner.statuses()}

    rows = samples(310)
    graph.send([imu_message(k, rows[k]) for k in range(10)])
    assert told()["process noise"].level == diagnostics.OK  # not yet full is nothing wrong
    later = 10.0
    blocks = [range(first, first + 30) for first in range(10, 310, 30)]
    swapped = [blocks[k ^ 1] for k in range(10)]  # each pair the other way round, 0.6 s apart
    graph.send([imu_message(k, rows[k]) for block in swapped for k in block])
    statuses = told()
    assert statuses["imu"].level == statuses["process noise"].level == diagnostics.WARN
    assert statuses["imu"].values["restarts"] == 5
    assert "5 restarts in the last 10 s: stamps went back" in statuses["imu"].message
    message = statuses["process noise"].message
    assert "5 gaps and 5 restarts emptied it" in message
    assert "raise max_gap (0.1 s)" in message
    graph.send([imu_message(k, row) for k, row in enumerate(samples(500), 310)])
    graph.until(lambda: graph.received)
    assert told()["process noise"].level == diagnostics.OK


def test_a_wrong_parameter_is_named(managed):
    with pytest.raises(ParameterError, match=r"'rate'.*-1\.0"):
        managed(Graph("/auv")).make(TunerNode, rate=-1.0)


@pytest.fixture(scope="module")
def bad_models(tmp_path_factory):
    """An altered and an absent model and a wrong name, with the start of a tuner with each."""
    folder = tmp_path_factory.mktemp("models")
    for file in (SHIPPED, SHIPPED.with_suffix(".json")):
        shutil.copy(file, folder)
    altered, absent = folder / "paper.npz", folder / "absent.npz"
    data = bytearray(altered.read_bytes())
    data[len(data) // 2] ^= 1
    altered.write_bytes(data)
    paths = [altered, absent, "nope"]
    ended = starts("ros_insdvl.tuner", [["-p", f"model:={path}"] for path in paths])
    return list(zip(paths, ended, strict=True))


def test_an_altered_model_ends_the_node_with_its_name_and_hash(bad_models):
    model, ended = bad_models[0]
    assert ended.code == 1
    assert str(model) in ended.err
    assert json.loads(model.with_suffix(".json").read_text())["sha256"] in ended.err
    assert "Traceback" not in ended.err


def test_a_model_that_is_not_there_is_a_wrong_parameter(bad_models):
    """Which a service file does not try again."""
    for model, ended in bad_models[1:]:
        assert ended.code == 2
        assert f"parameter 'model': there is no model '{model}': shipped are bands" in ended.err
        assert "Traceback" not in ended.err


def test_an_estimator_of_your_own_is_published_and_its_failure_told(managed, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "noise_of_a_node_test.py").write_text(
        "def variances(samples, rate):\n    return [1.0] * 6 if len(samples) < 350 else 1 / 0\n"
    )
    own = "noise_of_a_node_test:variances"
    graph = managed(TunerGraph(estimator=own))
    graph.send([imu_message(k, sample) for k, sample in enumerate(samples(500))])
    graph.wait_for_stamps(boundaries(3, 3))
    assert graph.received[0].linear_acceleration_covariance[0] == 1.0
    graph.until_reported(NODE, times=2)
    status = graph.status(NODE, "process noise")
    assert status.level == WARN
    assert f"estimator '{own}' failed: ZeroDivisionError" in status.message
    assert graph.diagnostics.report(NODE).values["model"] == own
    with pytest.raises(ParameterError, match="has no function 'absent'"):
        managed(Graph("/auv")).make(TunerNode, estimator="noise_of_a_node_test:absent")


def test_a_failing_estimator_is_not_told_as_a_window_with_gaps(managed, tmp_path, monkeypatch):
    later = 0.0
    monkeypatch.setattr(node, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + later))
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "failing_of_a_node_test.py").write_text(
        "def variances(samples, rate):\n    return [1.0] * 6 if len(samples) == 200 else 1 / 0\n"
    )
    graph = managed(TunerGraph(estimator="failing_of_a_node_test:variances"))
    rows = samples(900)
    graph.send([imu_message(k, rows[k]) for k in range(500)])
    graph.tuner.statuses()
    later = 20.0  # what was counted until then is not recent any more
    graph.send([imu_message(k, rows[k]) for k in range(500, 900)])
    (status,) = (s for s in graph.tuner.statuses() if s.cause == "process noise")
    assert "4 times in the last 10 s: estimator" in status.message
    assert "no window was usable" not in status.message


def test_an_estimator_that_is_slower_than_its_rate_is_named(managed, tmp_path, monkeypatch):
    """By a clock that the estimator turns: 1.5 s in each call."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(tuner_of_core, "perf_counter", lambda: clock.now)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "slow_of_a_node_test.py").write_text(
        "clock = None\n\n\ndef variances(samples, rate):\n"
        "    if clock is not None:\n        clock.now += clock.seconds\n    return [1.0] * 6\n"
    )
    own = "slow_of_a_node_test:variances"
    graph = managed(TunerGraph(estimator=own))
    import_module("slow_of_a_node_test").clock = clock
    rows = samples(1000)

    def told(first: int, last: int, stamps: Any) -> diagnostics.Status:
        graph.send([imu_message(k, rows[k]) for k in range(first, last)])
        graph.wait_for_stamps(stamps)
        (status,) = (s for s in graph.tuner.statuses() if s.cause == "process noise")
        return status

    clock.seconds = 0.9
    status = told(0, 500, boundaries(3, 5))
    assert status.level == diagnostics.OK and status.values["time per estimate [s]"] == "0.9"
    clock.seconds = 1.5
    status = told(500, 1000, boundaries(3, 10))
    assert status.level == diagnostics.WARN
    slow = f"estimator {own} takes 1.5 s per call, more than the 1 s between calls"
    assert slow in status.message
