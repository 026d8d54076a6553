"""The tuner's measurement_noise in a graph: what it publishes, and what the filter does with it."""

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from graphs import RELIABLE, Graph, reliable
from ros_messages import STEP_NS, stamp_of
from sensor_msgs.msg import Imu

from insdvl.messages.make import fill_imu, fill_twist
from insdvl.messages.topics import DVL, DVL_WITH_COVARIANCE, MEASUREMENT_NOISE
from insdvl.navigation.events import Imu as Sample
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.tuner.measurement_noise import UNUSED, DvlTuner
from insdvl.tuner.parameters import TunedDvl, TunerParameters
from ros_insdvl.filter import FilterNode
from ros_insdvl.navigator import navigator_nodes
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl.status.heard import OK, WARN
from ros_insdvl.status.tuner.measurement_noise import measurement_noise_status
from ros_insdvl.tuner import TunerNode

NODE = "/auv/insdvl_tuner"
START_NS = 1_700_000_000_000_000_000
FLU = np.array([1.0, -1.0, -1.0])
STD = (0.05, 0.05, 0.1)


class TunerGraph(Graph):
    """The tuner of the DVL in the namespace /auv, and a peer that talks to it."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__("/auv")
        overrides = reliable("/auv", "imu/data_raw", "dvl/velocity", "dvl/velocity_cov")
        told = {"measurement_noise": True, "dvl.noise_std": STD, **parameters}
        self.tuner = self.make(TunerNode, **overrides, **told)
        self.imu = self.peer.create_publisher(Imu, "imu/data_raw", RELIABLE)
        self.dvl = self.peer.create_publisher(TwistStamped, "dvl/velocity", RELIABLE)
        self.received = self.keep(TwistWithCovarianceStamped, "measurement_noise")
        self.until(lambda: self.imu.get_subscription_count() == 1)
        self.until(lambda: self.dvl.get_subscription_count() == 1)
        self.until(lambda: self.peer.count_publishers("measurement_noise") == 1)

    def send(self, k: int, f: np.ndarray, v: np.ndarray | None) -> None:
        publish(self.imu, self.dvl, k, f, v)


def publish(imu: Any, dvl: Any, k: int, f: np.ndarray, v: np.ndarray | None) -> None:
    """A sample, and with a velocity a ping of its stamp; in the axes of ROS."""
    message = Imu()
    fill_imu(message, START_NS + k * STEP_NS, f, np.zeros(3))
    imu.publish(message)
    if v is not None:
        ping = TwistStamped()
        ping.header.frame_id = "dvl_link"
        fill_twist(ping, START_NS + k * STEP_NS, v)
        dvl.publish(ping)


@pytest.fixture
def graph(managed):
    return managed(TunerGraph())


def readings(n: int) -> list[tuple[np.ndarray, np.ndarray | None]]:
    """Of a vehicle that goes straight on; pings at 5 Hz."""
    rng = np.random.default_rng(8)
    return [
        (
            np.array([0.0, 0.0, 9.8]),
            np.array([1.0, 0.2, 0.0]) + rng.normal(0.0, STD) if k % 20 == 10 else None,
        )
        for k in range(n)
    ]


def test_publishes_what_the_offline_tuner_tells(graph):
    offline = DvlTuner(TunerParameters(dvl=TunedDvl(noise_std=STD)))
    expected = []
    for k, (f, v) in enumerate(readings(400)):
        graph.send(k, f, v)
        stamp = START_NS + k * STEP_NS
        expected += offline.add_sample(Sample(stamp, FLU * f, np.zeros(3)))
        if v is not None:
            expected += offline.add_ping(Dvl(stamp, FLU * v))
    assert len(expected) == 20 - 7
    graph.until(lambda: len(graph.received) >= len(expected))
    for message, one in zip(graph.received, expected, strict=True):
        assert stamp_of(message) == one.stamp_ns
        assert message.header.frame_id == "dvl_link"
        P = message.twist.covariance.reshape(6, 6)
        np.testing.assert_array_equal(P[:3, :3], FLU[:, None] * one.R * FLU)
        assert not P[3:].any() and not P[:, 3:].any()
        assert message.twist.twist == type(message.twist.twist)()
    assert 0.02 < np.sqrt(P[0, 0]) < 0.12
    graph.until_reported(NODE, times=2)
    status = graph.status(NODE, "measurement noise")
    assert status.level == OK
    assert graph.diagnostics.report(NODE).values["pings"] == "20"


def test_pings_that_cannot_be_used_are_counted_and_nothing_is_told_of_them(graph):
    rows = readings(300)
    for k, (f, v) in enumerate(rows):
        if k in (110, 130):
            v = v + np.array([np.nan, 0.0, 0.0])
        graph.send(k, f, v)
    graph.until(lambda: graph.tuner.received["imu/data_raw"] == 300)
    graph.until(lambda: graph.tuner.received["dvl/velocity"] == 15)
    graph.until(lambda: len(graph.received) == 15 - 2 - 7)
    assert all(np.isfinite(message.twist.covariance).all() for message in graph.received)
    graph.until_reported(NODE, times=2)
    status = graph.status(NODE, "measurement noise")
    assert status.level == WARN and "2 not_finite" in status.message


@pytest.mark.parametrize(
    ("unused", "told"),
    [
        ("pings_incomplete", "50 with a component that is not measured"),
        ("pings_without_lock", "50 zero, repeated or not finite"),
        ("pings_out_of_order", "50 not newer than the one before"),
        ("pings_far_ahead", "50 far ahead of the IMU's stamps"),
        ("pings_without_samples", "50 without IMU samples around them"),
    ],
)
def test_that_no_ping_tells_the_noise_is_reported_with_the_reason(unused: str, told: str) -> None:
    assert not status_of([{"pings": 50}, {"pings": 50, unused: 50}]).complaints
    status = status_of([{"pings": 50}, {"pings": 50}, {"pings": 50, unused: 50}])
    assert status.complaints and told in status.message
    assert not status_of([{}, {}, {"pings": 1, unused: 50}]).complaints  # one of them was used


def status_of(counts: list[dict[str, int]]) -> Status:
    """The status after counts of pings that are 8 s apart; a sum over 10 s sees the last two."""
    view, names = View(0.0), ("pings", *UNUSED)
    heard = dict.fromkeys((DVL, DVL_WITH_COVARIANCE), 0)
    for k, events in enumerate(counts):
        now = 8.0 * (k + 1)
        heard[DVL] += 1
        view.look(
            now,
            received=heard,
            sent={MEASUREMENT_NOISE: 0},
            rejected={},
            events=events,
            heard={DVL: now},
        )
    return measurement_noise_status(view, None, names)


def test_without_the_parameter_the_dvl_is_not_listened_to(managed):
    graph = managed(Graph("/auv"))
    tuner = graph.make(TunerNode)
    assert set(tuner.inputs) == {"imu/data_raw"}
    assert "measurement_noise" not in tuner.outputs


def test_the_filter_takes_it_and_refuses_what_is_no_covariance(managed):
    graph = managed(Graph("/auv"))
    node = graph.make(FilterNode, **{"dvl.noise_source": "learned"})
    peer = graph.peer.create_publisher(TwistWithCovarianceStamped, "measurement_noise", RELIABLE)
    graph.until(lambda: peer.get_subscription_count() == 1)
    for k, variance in enumerate((0.01, -2.0, 0.0, -1.0, np.nan, np.inf)):
        message = TwistWithCovarianceStamped()
        fill_twist(message, START_NS + k, np.zeros(3), np.diag([variance] * 3))
        peer.publish(message)
    graph.until(lambda: node.received["measurement_noise"] == 6)
    told = {refused.reason: count for refused, count in node.rejected.items()}
    assert told == {"bad_covariance": 3, "no_data": 2}
    (status,) = (one for one in node.statuses() if one.cause == "measurement noise")
    assert status.level != b"\0" and "3 bad_covariance" in status.message
    assert status.values["received measurement_noise"] == 6
    assert status.values["rejected measurement_noise: bad_covariance"] == 3


def test_in_one_process_it_is_handed_on_and_another_vehicle_is_warned_of(
    managed: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    graph = managed(Graph())
    told = ("measurement_noise:=true", "dvl.noise_source:=adaptive", "imu.lever_arm:=[0.5,0.,0.]")
    arguments = ["--ros-args", *(word for text in told for word in ("-p", text))]
    arguments += ["-p", "insdvl_filter:dvl.mount:=[0.0, 0.0, 1.0]"]
    for topic in ("imu/data_raw", "dvl/velocity"):
        name = f"qos_overrides./{topic}.subscription.reliability:=reliable"
        arguments += ["-p", f"insdvl_filter:{name}", "-p", f"insdvl_tuner:{name}"]
    made = []
    for node in navigator_nodes(context=graph.context, cli_args=arguments):
        made.append(graph.add(node))
    filter_node, tuner = made
    log = capfd.readouterr().err
    assert (
        "another vehicle than the filter's: dvl.mount (0.0, 0.0, 0.0), not (0.0, 0.0, 1.0)" in log
    )
    assert "imu.lever_arm" not in log
    imu = graph.peer.create_publisher(Imu, "imu/data_raw", RELIABLE)
    dvl = graph.peer.create_publisher(TwistStamped, "dvl/velocity", RELIABLE)
    graph.until(lambda: imu.get_subscription_count() == 1 and dvl.get_subscription_count() == 2)
    for k, (f, v) in enumerate(readings(300)):
        publish(imu, dvl, k, f, v)
    graph.until(lambda: tuner.outputs["measurement_noise"].count == 15 - 7)
    assert filter_node.received["measurement_noise"] == 15 - 7
    assert not [one for one in filter_node.rejected if one.topic == "measurement_noise"]
