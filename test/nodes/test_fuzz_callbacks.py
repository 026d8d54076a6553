"""Whatever arrives at a callback of a node, the node lives, and what it publishes could be true."""

from collections.abc import Callable, Iterator
from itertools import cycle
from typing import Any

import numpy as np
import pytest
from adversary import Adversary
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistWithCovarianceStamped
from graphs import Graph
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu

from insdvl.messages import convert
from insdvl.messages.topics import BY_NAME
from insdvl.recordings.base import encode
from insdvl.recordings.drivers import DEFINITIONS
from insdvl.watch.table.layout import line, plain
from ros_insdvl.conversions import message_class
from ros_insdvl.filter import FilterNode
from ros_insdvl.monitor import Monitor
from ros_insdvl.tuner import TunerNode
from ros_insdvl_sim.relay import Relay

COUNT = 1500


class Bench(Graph):
    """A node whose callbacks are called here, and that publishes to a list."""

    def __init__(self, kind: Any, **parameters: Any) -> None:
        super().__init__()
        self.tested = self.make(kind, **parameters)
        self.published: dict[str, list[bytes]] = {topic: [] for topic in self.tested.outputs}
        for topic, output in self.tested.outputs.items():
            output.send = self._keeper(topic)

    def _keeper(self, topic: str) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            data = message if isinstance(message, bytes) else serialize_message(message)
            self.published[topic].append(data)

        return keep

    def give(self, topic: str, message: Any) -> None:
        subscription = self.tested.inputs[topic]
        if subscription.raw and not isinstance(message, bytes):
            message = serialize_message(message)
        subscription.callback(message)

    def messages(self, topic: str, kind: Any) -> list[Any]:
        return [deserialize_message(data, kind) for data in self.published[topic]]


@pytest.fixture
def bench(managed: Any) -> Callable[..., Bench]:
    return lambda kind, **parameters: managed(Bench(kind, **parameters))


def adverse(topics: dict[str, str], count: int, *, odd: float = 0.1) -> Iterator[tuple[str, Any]]:
    """Messages of rclpy, through their bytes, as they come from a network."""
    adversary = Adversary(np.random.default_rng(1), odd=odd, wire=True)
    for topic, message in adversary.messages(topics, count):
        data = encode(topic, 0, message).data
        yield topic, deserialize_message(data, message_class(topics[topic]))


def all_numbers(message: Any) -> list[float]:
    if isinstance(message, float):
        return [message]
    if isinstance(message, np.ndarray):
        return message.tolist()
    names = getattr(message, "get_fields_and_field_types", dict)()
    return [x for name in names for x in all_numbers(getattr(message, name))]


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {
            "process_noise.source": "external",
            "output_delay": 1.0,
            "dvl.type": convert.ODOMETRY,
            "dvl.noise_source": "adaptive",
        },
        {"initial.mode": "topic", "origin.source": "topic", "process_noise.source": "message"},
    ],
)
def test_filter(bench: Any, parameters: dict[str, Any]) -> None:
    b = bench(FilterNode, **({"dvl.type": convert.TWIST} | parameters))
    topics = {name: topic.types[0] for name, topic in b.tested._inputs.topics.items()}
    assert "dvl/velocity" in b.tested.inputs
    for topic, message in adverse(topics, COUNT):
        if topic in b.tested.inputs:  # a topic of the initial state is left when it has been heard
            b.give(topic, message)
    judge_filter(b)


@pytest.mark.parametrize("stamp", ["message", "arrival"])
def test_filter_with_drivers(bench: Any, stamp: str) -> None:
    """Their packages are not here: their messages are given to the callback as decoded ones."""
    b = bench(FilterNode, **{"dvl.stamp": stamp})
    adversary = Adversary(np.random.default_rng(1), odd=0.1, wire=True)
    for kind, _ in zip(cycle(DEFINITIONS), range(COUNT), strict=False):
        topics = {"imu/data_raw": convert.IMU, "dvl/velocity": kind}
        ((topic, message),) = adversary.messages(topics, 1)
        if topic == "imu/data_raw":
            b.give(topic, deserialize_message(encode(topic, 0, message).data, Imu))
        else:
            b.tested._receive(topic, message)
    judge_filter(b)


def judge_filter(b: Bench) -> None:
    odometry = b.messages("odometry/filtered", Odometry)
    assert len(odometry) > 100
    for message in odometry:
        assert np.isfinite(all_numbers(message)).all()
        for P in (message.pose.covariance, message.twist.covariance):
            P = P.reshape(6, 6)
            assert np.array_equal(P, P.T) and (np.diag(P) > 0.0).all()
    for topic, kind in (("imu/bias", Imu), ("dvl/innovation", TwistWithCovarianceStamped)):
        assert all(np.isfinite(all_numbers(m)).all() for m in b.messages(topic, kind))
    assert b.tested.rejected.total() > 50
    assert b.tested.statuses()


def test_tuner(bench: Any) -> None:
    b = bench(TunerNode, rate=10.0)
    for odd in (0.1, 0.001):  # a window takes 200 samples in a row
        for topic, message in adverse({"imu/data_raw": convert.IMU}, 2 * COUNT, odd=odd):
            b.give(topic, message)
    learned = b.messages("process_noise", Imu)
    assert learned
    for message in learned:
        for field in (
            message.linear_acceleration_covariance,
            message.angular_velocity_covariance,
        ):
            assert np.isfinite(field).all() and (field >= 0.0).all()
    assert b.tested.rejected.total() > 50
    assert b.tested.statuses()


def test_tuner_of_the_dvl(bench: Any) -> None:
    b = bench(TunerNode, measurement_noise=True)
    topics = {"imu/data_raw": convert.IMU, "dvl/velocity_cov": convert.TWIST_WITH_COVARIANCE}
    for odd in (0.1, 0.001):
        for topic, message in adverse(topics, 2 * COUNT, odd=odd):
            b.give(topic, message)
    for message in b.messages("measurement_noise", TwistWithCovarianceStamped):
        assert np.isfinite(all_numbers(message)).all()
        assert (np.linalg.eigvalsh(message.twist.covariance.reshape(6, 6)[:3, :3]) > 0.0).all()
    assert b.tested.rejected.total() > 50
    assert b.tested.statuses()


def test_monitor(bench: Any) -> None:
    b = bench(Monitor, filters=["/a", "/b"])
    topics = {
        "ground_truth/odometry": convert.ODOMETRY,
        "/a/odometry/filtered": convert.ODOMETRY,
        "/b/odometry/filtered": convert.ODOMETRY,
        "/a/imu/bias": convert.IMU,
        "process_noise": convert.IMU,
        "ground_truth/process_noise": convert.IMU,
    }
    rng = np.random.default_rng(4)
    for k, (topic, message) in enumerate(adverse(topics, COUNT)):
        b.give(topic, serialize_message(message))
        if k % 5 == 0:
            b.give("/diagnostics", serialize_message(diagnostics(rng)))
        if k % 50 == 0:
            shown = b.tested.shown()
            assert plain(shown) and line(shown)


def diagnostics(rng: np.random.Generator) -> DiagnosticArray:
    names = ("a/insdvl_filter: imu", "/b/insdvl_filter", "", ": ", "x" * 1000, "/a/insdvl_filter")
    keys = ("NIS dvl, mean of 100", "rate imu/data_raw [Hz]", "rejected imu: gate", "")
    values = ("3.0", "nan", "", "many", "-7", "1e400")
    statuses = [
        DiagnosticStatus(
            level=bytes([int(rng.integers(0, 256))]),
            name=names[rng.integers(len(names))],
            message="ü" * int(rng.integers(0, 50)),
            values=[
                KeyValue(key=keys[rng.integers(len(keys))], value=values[rng.integers(len(values))])
                for _ in range(rng.integers(0, 4))
            ],
        )
        for _ in range(rng.integers(0, 4))
    ]
    return DiagnosticArray(status=statuses)


def test_relay_sends_on_what_it_does_not_understand(bench: Any) -> None:
    b = bench(Relay, topics=list(BY_NAME), duplication=0.5, loss=0.1)
    rng = np.random.default_rng(2)
    sent = []
    for _ in range(COUNT):
        topic = list(BY_NAME)[rng.integers(len(BY_NAME))]
        data = rng.bytes(int(rng.integers(0, 200)))
        b.give("sent/" + topic, data)
        sent.append((topic, data))

    def arrived() -> int:
        return sum(len(data) for data in b.published.values())

    # Counted when they come in; what is sent on goes through a thread.
    expected = COUNT - b.tested.lost.total() + b.tested.doubled.total()
    b.until(lambda: arrived() >= expected, "the last message")
    b.remove(b.tested)  # joins the thread
    assert arrived() == expected > COUNT / 2
    assert all((topic, x) in sent for topic, data in b.published.items() for x in data[:20])
