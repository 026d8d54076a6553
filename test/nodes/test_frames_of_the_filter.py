"""Frames of the filter node: odometry/global, /tf, mounts from /tf_static; an unknown heading."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import QuaternionStamped, TransformStamped, TwistStamped
from graphs import RELIABLE, Graph, reliable
from nav_msgs.msg import Odometry
from ros_messages import STEP_NS, dvl_message, imu_message, odometry_message, stamp_of
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger
from told import TOLD

from insdvl.messages.transforms import TF, TF_MESSAGE, TF_STATIC, Transforms
from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, build
from ros_insdvl import conversions
from ros_insdvl import filter as filter_module
from ros_insdvl.filter import FilterNode
from ros_insdvl.status.heard import OK, WARN

NODE = "/auv/insdvl_filter"
START_NS = 1_700_000_000 * NS
STARTED = {n: v for n, v in TOLD.items() if n == "initial.mode" or n.endswith("_std")}
INPUTS = {
    "imu/data_raw": Imu,
    "dvl/velocity": TwistStamped,
    "set_odometry": Odometry,
    "start": Odometry,
    "compass": QuaternionStamped,
}


class FramesGraph(Graph):
    """The filter with the topics that are sent here."""

    def __init__(self, *topics: str, **parameters: Any) -> None:
        super().__init__("/auv")
        given = {**reliable("/auv", "imu/data_raw", "dvl/velocity", "compass"), **STARTED}
        self.in_odom = self.keep(Odometry, "odometry/filtered")
        self.in_map = self.keep(Odometry, "odometry/global")
        self.publishers = {
            topic: self.peer.create_publisher(INPUTS[topic], topic, RELIABLE) for topic in topics
        }
        self.filter = self.make(FilterNode, **{**given, **parameters})
        self.until(
            lambda: (
                all(p.get_subscription_count() for p in self.publishers.values())
                and self.filter.outputs["odometry/filtered"].listeners
            )
        )

    def send(self, *items: tuple[str, Any]) -> None:
        """Publish one by one, each when the last has been handled."""
        for topic, message in items:
            target = self.filter.received[topic] + 1
            self.publishers[topic].publish(message)
            self.until(lambda t=topic, n=target: self.filter.received[t] == n)

    def status(self, cause: str) -> Any:
        self.until_reported(NODE, times=2)
        return self.diagnostics.report(NODE).statuses[cause]

    def values(self) -> dict[str, str]:
        self.until_reported(NODE, times=2)
        return self.diagnostics.report(NODE).values


@pytest.fixture
def graph(managed: Any) -> Callable[..., FramesGraph]:
    return lambda *topics, **parameters: managed(FramesGraph(*topics, **parameters))


def samples(first: int, last: int) -> list[tuple[str, Any]]:
    return [("imu/data_raw", imu_message(START_NS + k * STEP_NS)) for k in range(first, last)]


def compass(k: int, yaw: float) -> tuple[str, Any]:
    message = QuaternionStamped()
    message.header.stamp = conversions.time_of(START_NS + k * STEP_NS)
    message.header.frame_id = "map"
    x, y, z, w = Rotation.from_euler("z", yaw).as_quat().tolist()
    q = message.quaternion
    q.x, q.y, q.z, q.w = x, y, z, w
    return "compass", message


def yaw_of(message: Odometry) -> float:
    q = message.pose.pose.orientation
    return float(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_euler("ZYX")[0])


# ------------------------------------------------------------------ odometry/global


HEADING = {"heading.topic": "compass", "initial.heading_std": 0.3}


def test_a_heading_moves_map_and_not_odom(graph: Any) -> None:
    g = graph("imu/data_raw", "compass", **HEADING)
    g.send(*samples(0, 10), compass(9, 0.2), *samples(10, 20))
    g.until(lambda: len(g.in_odom) == len(g.in_map) == 20)
    assert {m.header.frame_id for m in g.in_map} == {"map"}
    assert {m.header.frame_id for m in g.in_odom} == {"odom"}
    assert {m.child_frame_id for m in g.in_map + g.in_odom} == {"base_link"}
    assert [stamp_of(m) for m in g.in_map] == [stamp_of(m) for m in g.in_odom]
    assert g.in_map[8] != g.in_odom[8] and yaw_of(g.in_map[8]) == yaw_of(g.in_odom[8])
    assert yaw_of(g.in_map[-1]) == pytest.approx(0.2, abs=0.02)
    assert yaw_of(g.in_odom[-1]) == pytest.approx(0.0, abs=1e-5)
    values = g.values()
    assert float(values["map to odom, yaw [deg]"]) == pytest.approx(np.degrees(0.2), abs=1.0)
    assert values["odom_resets"] == "0"


def test_without_a_heading_nothing_is_published_in_map(graph: Any) -> None:
    g = graph("imu/data_raw")
    g.send(*samples(0, 3))
    g.until(lambda: len(g.in_odom) == 3)
    assert "odometry/global" not in g.filter.outputs and "map to odom, yaw [deg]" not in g.values()


def test_with_a_heading_a_pose_is_told_in_map(graph: Any) -> None:
    """In odom it would say nothing of the heading; then odom is map, and that is a reset."""
    g = graph("imu/data_raw", "compass", "set_odometry", **HEADING)
    g.send(*samples(0, 10), compass(9, 0.2))
    in_odom, in_map = (odometry_message(START_NS + 9 * STEP_NS) for _ in range(2))
    in_odom.header.frame_id, in_map.header.frame_id = "odom", "map"
    g.send(("set_odometry", in_odom), *samples(10, 12))
    assert "wrong_frame" in {refused.reason for refused in g.filter.rejected}
    in_map.header.stamp = conversions.time_of(START_NS + 11 * STEP_NS)
    g.send(("set_odometry", in_map), *samples(12, 14))
    g.until(lambda: len(g.in_odom) == len(g.in_map) == 14)
    assert yaw_of(g.in_map[-1]) == yaw_of(g.in_odom[-1]) == pytest.approx(np.pi, abs=1e-3)
    assert g.values()["odom_resets"] == "1"


# ------------------------------------------------------------------ an unknown heading


def test_an_unknown_heading_is_said_until_it_is_known(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    g = graph("imu/data_raw", "set_odometry", **{"initial.heading_std": 1.5})
    monkeypatch.setattr(g.filter.get_logger(), "info", said.append)
    g.send(*samples(0, 10))
    status = g.status("initialisation")
    assert (
        status.level == WARN and "heading unknown, one sigma 85.9 deg: odom turns" in status.message
    )
    known = odometry_message(START_NS + 9 * STEP_NS)
    known.pose.covariance[::7] = [1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4]
    g.send(("set_odometry", known), *samples(10, 210))
    assert [text for text in said if text.startswith("heading known, one sigma 2.6")]
    assert len([text for text in said if text.startswith("heading known")]) == 1
    assert g.status("initialisation").level == OK


# ------------------------------------------------------------------ /tf


class TFMessage:
    """tf2_msgs/TFMessage, which no wheel has."""

    def __init__(self) -> None:
        self.transforms: list[TransformStamped] = []


def test_a_missing_package_is_one_sentence() -> None:
    for parameters in ({"publish_tf": True}, {"extrinsics": "tf"}):
        with pytest.raises(ParameterError) as caught:
            Graph("/auv").make(FilterNode, **parameters)
        assert str(caught.value) == (
            "message type tf2_msgs/msg/TFMessage is not installed: install ros-jazzy-tf2-msgs, or "
            "source the workspace that has tf2_msgs"
        )


def test_the_class_is_looked_up_when_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    package, messages = ModuleType("tf2_msgs"), ModuleType("tf2_msgs.msg")
    messages.TFMessage = TFMessage  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tf2_msgs", package)
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", messages)
    assert conversions.message_class(TF_MESSAGE) is TFMessage
    names = {"map_frame": "world", "odom_frame": "o", "base_frame": "b"}
    for has_map in (False, True):
        transforms = Transforms(
            conversions.new_message, build(FilterParameters, names), has_map=has_map
        )
        pose = SimpleNamespace(
            position=np.array([1.0, 2.0, 3.0]), quaternion_xyzw=np.array([0.0, 0.6, 0.0, 0.8])
        )
        output = SimpleNamespace(
            stamp_ns=5 * NS + 7, in_odom=pose, map_to_odom=np.array([4.0, 5.0, 6.0, np.pi / 2])
        )
        base, *rest = transforms.of(output).transforms
        assert isinstance(base, TransformStamped)
        assert (base.header.frame_id, base.child_frame_id) == ("o", "b")
        assert (base.header.stamp.sec, base.header.stamp.nanosec) == (5, 7)
        t, q = base.transform.translation, base.transform.rotation
        assert (t.x, t.y, t.z) == (1.0, 2.0, 3.0) and (q.y, q.w) == (0.6, 0.8)
        assert len(rest) == has_map
        for of_odom in rest:
            assert (of_odom.header.frame_id, of_odom.child_frame_id) == ("world", "o")
            assert of_odom.header.stamp == base.header.stamp
            t, q = of_odom.transform.translation, of_odom.transform.rotation
            assert (t.x, t.y, t.z) == (4.0, 5.0, 6.0)
            assert (q.z, q.w) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)))


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """The node's endpoints have a type that is there; what is filled has the fields of tf2_msgs."""
    look_up = conversions.message_class

    def found(kind: str) -> Any:
        return TransformStamped if kind == TF_MESSAGE else look_up(kind)

    monkeypatch.setattr(filter_module, "message_class", found)
    monkeypatch.setattr(
        filter_module,
        "new_message",
        lambda kind: TFMessage() if kind == TF_MESSAGE else look_up(kind)(),
    )


@pytest.mark.usefixtures("stand_in")
def test_each_output_is_also_on_tf(graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    g = graph("imu/data_raw", "compass", publish_tf=True, **HEADING)
    assert g.filter.outputs[TF].publisher.topic_name == "/tf"
    sent: list[list[tuple[str, str]]] = []
    monkeypatch.setattr(
        g.filter.outputs[TF],
        "send",
        lambda m: sent.append([(t.header.frame_id, t.child_frame_id) for t in m.transforms]),
    )
    g.send(*samples(0, 5))
    assert sent == [[("odom", "base_link"), ("map", "odom")]] * 5


# ------------------------------------------------------------------ mounts from /tf_static


def static(*frames: tuple[str, tuple[float, float, float], float]) -> Any:
    message = TFMessage()
    for child, xyz, yaw in frames:
        stamped = TransformStamped(child_frame_id=child)
        stamped.header.frame_id = "base_link"
        t, q = stamped.transform.translation, stamped.transform.rotation
        t.x, t.y, t.z = xyz
        q.z, q.w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
        message.transforms.append(stamped)
    return message


@pytest.mark.usefixtures("stand_in")
def test_the_filter_waits_for_its_mounts_and_loses_nothing(graph: Any) -> None:
    items = [
        *samples(0, 10),
        ("dvl/velocity", dvl_message(START_NS + 9 * STEP_NS, (0.02, 0.05, 0.0))),
    ]
    told = graph("imu/data_raw", "dvl/velocity", **{"dvl.mount": [0.0, 0.0, 0.5]})
    told.send(*items, *samples(10, 20))
    told.until(lambda: len(told.in_odom) == 20)
    expected = list(told.in_odom)

    g = graph("imu/data_raw", "dvl/velocity", extrinsics="tf")
    g.send(*items)
    assert g.in_odom == []
    status = g.status("extrinsics")
    assert status.level == WARN and "imu: /tf_static has no frame 'imu_link'" in status.message
    g.filter._receive_transforms(static(("imu_link", (0.0, 0.0, 0.0), 0.0)))
    assert "dvl: /tf_static has no frame 'dvl_link'" in g.status("extrinsics").message
    g.filter._receive_transforms(static(("dvl_link", (0.0, 0.0, 0.0), 0.5)))
    g.send(*samples(10, 20))
    g.until(lambda: len(g.in_odom) == 20)
    status = g.status("extrinsics")
    assert status.level == OK and "dvl.mount [0, -0, 0.5] from 'dvl_link'" in status.message
    assert not g.filter.rejected
    assert g.filter.parameters.dvl.mount == pytest.approx((0.0, 0.0, 0.5))
    for a, b in zip(g.in_odom, expected, strict=True):
        assert stamp_of(a) == stamp_of(b)
        v, w = a.twist.twist.linear, b.twist.twist.linear
        np.testing.assert_allclose([v.x, v.y, v.z], [w.x, w.y, w.z], atol=1e-12)


@pytest.mark.usefixtures("stand_in")
def test_initial_states_that_have_waited_are_used_and_the_rest_follows(graph: Any) -> None:
    """Its topic is left when max_delay is over, and several that wait come later."""
    g = graph(
        *("imu/data_raw", "start"),
        **{"extrinsics": "tf", "initial.mode": "topic", "initial.topic": "start"},
        **{"imu.frame_id": "imu_link", "dvl.frame_id": "dvl_link"},
        **{"dvl.type": "geometry_msgs/msg/TwistStamped", "max_delay": 0.05},
    )
    for first in (0, 10, 20, 30):
        told = odometry_message(START_NS + first * STEP_NS)
        g.send(("start", told), *samples(first, first + 10))
    g.filter._receive_transforms(
        static(("imu_link", (0.0, 0.0, 0.0), 0.0), ("dvl_link", (0.0, 0.0, 0.0), 0.0))
    )
    g.until(lambda: len(g.in_odom) == 40)
    assert "start" not in g.filter.inputs


@pytest.mark.usefixtures("stand_in")
def test_a_reset_while_it_waits_forgets_the_state_file(graph: Any, tmp_path: Path) -> None:
    path = tmp_path / "state"
    path.write_text("of another dive")
    g = graph("imu/data_raw", extrinsics="tf", state_file=str(path))
    response = g.filter._reset(Trigger.Request(), Trigger.Response())
    assert response.success and not path.exists()


@pytest.mark.usefixtures("stand_in")
def test_too_many_messages_that_wait_are_counted(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ros_insdvl.waiting.MAX_KEPT", 5)
    g = graph("imu/data_raw", extrinsics="tf")
    assert TF_STATIC in g.filter.inputs
    g.send(*samples(0, 8))
    (refused,) = g.filter.rejected
    assert (refused.topic, refused.reason) == ("imu/data_raw", "no_extrinsics")
    assert g.filter.rejected[refused] == 3
