"""The replay node in a graph: what was recorded arrives unchanged, what cannot is named."""

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from graphs import LATCHED, RELIABLE, Graph
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from insdvl.messages.transforms import TF_MESSAGE, TF_STATIC
from insdvl.navigation.events import NS
from insdvl.parameters.declaration import ParameterError
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import encode, new_message
from insdvl.recordings.messages import imu_message, odometry_message, twist_message
from ros_insdvl_sim import replay as replay_module
from ros_insdvl_sim.replay import Replay

DEADLINE = 300.0  # s; only a hang takes so long
START_NS = 1_700_000_000 * NS
SIZE = 300
STEP_NS = 10_000_000
LATE = 120  # this sample is recorded after the next one


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(1)
    path = tmp_path_factory.mktemp("bags") / "recording"
    order = list(range(SIZE))
    order[LATE], order[LATE + 1] = order[LATE + 1], order[LATE]
    with BagWriter(path) as writer:
        for k, sample in enumerate(order):
            stamp_ns, time_ns = START_NS + sample * STEP_NS, 5 * NS + k * STEP_NS
            message = imu_message(stamp_ns, "imu", *rng.standard_normal((2, 3)))
            writer.write(encode("/sensors/imu", time_ns, message))
            if k % 100 == 50:
                v = rng.standard_normal(3)
                writer.write(encode("/dvl", time_ns + 1, twist_message(stamp_ns, "dvl", v)))
                message = odometry_message(
                    stamp_ns, ("odom", "base_link"), v, np.array([0.0, 0.0, 0.0, 1.0]), v, v
                )
                writer.write(encode("/truth", time_ns + 2, message))
                message = imu_message(stamp_ns, "imu", v, v, np.eye(3), np.eye(3))
                writer.write(encode("/process_noise", time_ns + 3, message))
                writer.write(encode("/other", time_ns + 4, twist_message(stamp_ns, "x", v)))
    return path


class ReplayGraph(Graph):
    """A node that listens, and the replay node."""

    def replay(self, **parameters: Any) -> Replay:
        return self.make(Replay, **parameters)


@pytest.fixture
def graph(managed: Any) -> ReplayGraph:
    return managed(ReplayGraph())


def topics(bag: Path) -> dict[str, object]:
    return {
        "bag": str(bag),
        "imu_topic": "/sensors/imu",
        "dvl_topic": "/dvl",
        "ground_truth_topic": "/truth",
        "rate_factor": 100.0,
    }


def recorded(bag: Path, topic: str) -> list[bytes]:
    with BagReader(bag) as reader:
        return [raw.data for raw in reader.raw([topic])]


def test_every_message_is_played_unchanged_and_in_order(
    graph: ReplayGraph, bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    received = {
        "/sensors/imu": graph.keep(Imu, "imu/data_raw", raw=True),
        "/dvl": graph.keep(TwistStamped, "dvl/velocity", raw=True),
        "/truth": graph.keep(Odometry, "ground_truth/odometry", raw=True),
        "/process_noise": graph.keep(Imu, "process_noise", LATCHED, raw=True),
    }
    node = graph.replay(**topics(bag))
    assert set(node.outputs) == {
        "imu/data_raw", "dvl/velocity", "ground_truth/odometry", "process_noise"
    }  # fmt: skip
    graph.until(node.finished.done)
    assert node.finished.result() == 0
    expected = {topic: recorded(bag, topic) for topic in received}
    graph.until(lambda: all(len(received[t]) >= len(expected[t]) for t in expected))
    assert received == expected
    assert len(expected["/sensors/imu"]) == SIZE
    printed = capsys.readouterr().out
    assert f"imu/data_raw {SIZE}" in printed
    assert "dvl/velocity 3" in printed


def test_the_pace_is_that_of_the_stamps_and_the_clock_never_runs_back(
    graph: ReplayGraph, bag: Path
) -> None:
    arrivals: list[float] = []
    graph.peer.create_subscription(
        Imu, "imu/data_raw", lambda message: arrivals.append(time.monotonic()), RELIABLE
    )
    clock = graph.keep(Clock, "/clock")
    node = graph.replay(**(topics(bag) | {"rate_factor": 2.0}))
    last_ns = START_NS + (SIZE - 1) * STEP_NS

    def now_ns(message: Clock) -> int:
        return message.clock.sec * NS + message.clock.nanosec

    graph.until(lambda: node.finished.done() and bool(clock) and now_ns(clock[-1]) == last_ns)
    duration = (SIZE - 1) * STEP_NS / NS / 2.0
    assert arrivals[-1] - arrivals[0] > 0.9 * duration
    times = [now_ns(message) for message in clock]
    assert times == sorted(times)
    assert times[0] >= START_NS
    assert len(times) <= (arrivals[-1] - arrivals[0] + 1.0) / 0.02


def test_without_a_rate_factor_there_is_no_clock(graph: ReplayGraph, bag: Path) -> None:
    graph.keep(Imu, "imu/data_raw", raw=True)
    node = graph.replay(**(topics(bag) | {"rate_factor": 0.0}))
    graph.until(lambda: node.outputs["imu/data_raw"].count > 0)
    assert graph.peer.count_publishers("/clock") == 0


def test_nothing_is_sent_before_the_consumers_are_there(graph: ReplayGraph, bag: Path) -> None:
    first = graph.keep(Imu, "imu/data_raw", raw=True)
    node = graph.replay(**(topics(bag) | {"min_subscribers": 2}))
    graph.until(lambda: node.outputs["imu/data_raw"].listeners == 1)
    for _ in range(20):
        graph.executor.spin_once(timeout_sec=0.1)
    assert node.outputs["imu/data_raw"].count == 0
    second = graph.keep(Imu, "imu/data_raw", raw=True)
    graph.until(lambda: len(first) == len(second) == SIZE)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"bag": ""}, "'bag': it is empty"),
        ({"bag": "/absent"}, "'bag': recording /absent does not exist"),
        ({"imu_topic": "/absent"}, "'/absent' is not in .*; it has /dvl, /other"),
        ({"dvl_topic": "/sensors/imu"}, "/imu .* has type sensor_msgs/msg/Imu, expected"),
        ({"rate_factor": -1.0}, "'rate_factor' must be"),
        ({"rate_factr": 1.0}, "'rate_factr'"),
    ],
)
def test_what_cannot_be_played_is_named(
    graph: ReplayGraph, bag: Path, parameters: dict[str, object], expected: str
) -> None:
    with pytest.raises(ParameterError, match=expected):
        graph.replay(**(topics(bag) | parameters))
    assert graph.peer.count_publishers("imu/data_raw") == 0


def test_a_damaged_recording_ends_the_process_before_it_publishes(
    bag: Path, tmp_path: Path
) -> None:
    damaged = tmp_path / "damaged.mcap"
    whole = next(bag.glob("*.mcap")).read_bytes()
    damaged.write_bytes(whole[: len(whole) // 2])
    arguments = ["--ros-args", "-p", f"bag:={damaged}"]
    result = subprocess.run(
        [sys.executable, "-m", "ros_insdvl_sim.replay", *arguments],
        capture_output=True,
        text=True,
        timeout=DEADLINE,
        check=False,
    )
    assert result.returncode == 2
    assert "parameter 'bag'" in result.stderr
    assert "damaged.mcap" in result.stderr
    assert "Traceback" not in result.stderr


def test_transforms_are_played_to_those_who_come_later(
    graph: ReplayGraph, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where their type is installed; the filter takes its mounts from them."""
    with BagReader(bag) as source, BagWriter(tmp_path / "bag") as writer:
        message = new_message(TF_MESSAGE)
        writer.write(encode(TF_STATIC, NS, message))
        for raw in source.raw({topic: topic for topic in source.topics}):
            writer.write(raw)
    given = {**topics(bag), "bag": str(tmp_path / "bag"), "min_subscribers": 1}
    assert TF_STATIC not in graph.replay(**given).outputs
    look_up = replay_module.message_class
    monkeypatch.setattr(
        replay_module, "message_class", lambda k: TwistStamped if k == TF_MESSAGE else look_up(k)
    )
    node = graph.replay(**given)
    assert node.outputs[TF_STATIC].publisher.topic_name == TF_STATIC
    (info,) = graph.peer.get_publishers_info_by_topic(TF_STATIC)
    assert info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert next(node.timeline())[1] == TF_STATIC
