"""Mounts and lever arms from /tf_static: the composition, the convention, and what is missing."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.messages import drivers
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.dvl import dvl
from insdvl.messages.extrinsics import Extrinsics, FrameError, FrameTree
from insdvl.messages.topics import DVL, IMU, taken
from insdvl.navigation.events import NS
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import CONVENTIONS, rotation_from_rpy
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.drivers import dvl_message


def transform(parent: str, child: str, xyz: Any = (0, 0, 0), rpy: Any = (0, 0, 0)) -> Any:
    q = Rotation.from_euler("xyz", rpy).as_quat()
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=parent),
        child_frame_id=child,
        transform=SimpleNamespace(
            translation=SimpleNamespace(**dict(zip("xyz", map(float, xyz), strict=True))),
            rotation=SimpleNamespace(**dict(zip("xyzw", q.tolist(), strict=True))),
        ),
    )


def tree(*transforms: Any) -> FrameTree:
    found = FrameTree()
    found.add(SimpleNamespace(transforms=list(transforms)))
    return found


def message(frame_id: str) -> Any:
    return SimpleNamespace(header=SimpleNamespace(frame_id=frame_id))


def extrinsics(**values: Any) -> Extrinsics:
    names = {name.replace("__", "."): value for name, value in values.items()}
    parameters = build(FilterParameters, {"extrinsics": "tf"} | names)
    return Extrinsics(parameters, taken(parameters))


def test_a_chain_composes() -> None:
    """base_link -> plate -> dvl, as each step says it."""
    step = transform("base_link", "plate", (1.0, 0.0, -0.2), (0.0, 0.0, np.pi / 2))
    last = transform("plate", "dvl", (0.5, 0.1, 0.0), (np.pi, 0.0, 0.0))
    pose = tree(step, last).pose("base_link", "dvl")
    np.testing.assert_allclose(pose.t, [0.9, 0.5, -0.2], atol=1e-15)
    np.testing.assert_allclose(pose.R @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(pose.R @ [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], atol=1e-15)


def test_frames_above_base_link_are_passed_both_ways() -> None:
    """A sensor on the hull, of which base_link is a child."""
    rng = np.random.default_rng(7)
    numbers = rng.uniform(-1.0, 1.0, (3, 2, 3))
    frames = [("hull", "base_link"), ("hull", "mast"), ("mast", "imu")]
    found = tree(*(transform(*f, *n) for f, n in zip(frames, numbers, strict=True)))
    pose = found.pose("base_link", "imu")
    R = [Rotation.from_euler("xyz", rpy).as_matrix() for _, rpy in numbers]
    t = [xyz for xyz, _ in numbers]
    in_hull = t[1] + R[1] @ t[2]
    np.testing.assert_allclose(pose.R, R[0].T @ R[1] @ R[2], atol=1e-14)
    np.testing.assert_allclose(pose.t, R[0].T @ (in_hull - t[0]), atol=1e-14)


@pytest.mark.parametrize("convention", ["enu", "ned"])
def test_the_filter_has_the_mount_that_its_parameter_would_have(convention: str) -> None:
    found = extrinsics(frame_convention=convention)
    rpy, xyz = (3.0, -0.2, 1.4), (0.3, -0.1, 0.2)
    found.hear("imu/data_raw", message("imu_link"))
    found.hear("dvl/velocity", message("/dvl"))
    found.add(
        SimpleNamespace(
            transforms=[
                transform("base_link", "imu_link", xyz, rpy),
                transform("base_link", "dvl", (0.0, 0.0, -0.4), (0.0, 0.0, 0.8)),
            ]
        )
    )
    parameters = found.applied(build(FilterParameters, {"frame_convention": convention}))
    np.testing.assert_allclose(parameters.imu.lever_arm, xyz)
    np.testing.assert_allclose(
        rotation_from_rpy(np.array(parameters.imu.mount)), rotation_from_rpy(np.array(rpy))
    )
    np.testing.assert_allclose(parameters.dvl.mount, (0.0, 0.0, 0.8), atol=1e-15)
    told = build(
        FilterParameters,
        {"frame_convention": convention, "imu.mount": rpy, "imu.lever_arm": xyz},
    )
    np.testing.assert_allclose(Filter(parameters).C_b_i, Filter(told).C_b_i, atol=1e-15)
    np.testing.assert_allclose(
        Filter(parameters).vehicle.l_b_imu, Filter(told).vehicle.l_b_imu, atol=1e-15
    )
    assert "imu.mount" in found.text and "'/dvl'" in found.text


def test_what_is_missing_is_named() -> None:
    found = extrinsics(depth__topic="depth")
    of_imu, of_dvl, of_depth = found.missing()
    assert "imu/data_raw" in of_imu and "imu.frame_id" in of_imu
    assert "dvl/velocity or dvl/velocity_cov" in of_dvl and "on depth," in of_depth
    for topic, frame in (
        ("imu/data_raw", "imu"),
        ("dvl/velocity_cov", "dvl"),
        ("depth", "base_link"),
    ):
        found.hear(topic, message(frame))
    assert found.missing() == [
        "imu: /tf_static has no frame 'imu'",
        "dvl: /tf_static has no frame 'dvl'",
    ]
    found.add(SimpleNamespace(transforms=[transform("base_link", "imu"), transform("x", "dvl")]))
    assert found.missing() == [
        "dvl: /tf_static does not connect 'dvl', which is below 'x', with 'base_link', which is "
        "below 'base_link'"
    ]
    with pytest.raises(FrameError, match="'dvl'"):
        found.applied(FilterParameters())
    found.add(SimpleNamespace(transforms=[transform("base_link", "x", (2000.0, 0.0, 0.0))]))
    assert found.missing() == [
        "parameter 'dvl.lever_arm' must be 3 values, each >= -1000 and <= 1000, got "
        "(2000.0, 0.0, 0.0)"
    ]
    found.add(SimpleNamespace(transforms=[transform("base_link", "x", (2.0, 0.0, 0.0))]))
    assert found.missing() == [] and found.applied(FilterParameters()).dvl.lever_arm == (
        2.0,
        0.0,
        0.0,
    )


def test_a_frame_of_the_parameters_needs_no_message() -> None:
    told = transform("base_link", "imu"), transform("base_link", "dvl")
    waits = extrinsics(imu__frame_id="imu", dvl__frame_id="dvl")
    waits.add(SimpleNamespace(transforms=list(told)))
    assert waits.missing() == [
        "no message on dvl/velocity or dvl/velocity_cov, whose type tells the axes of the sensor's "
        "frame (or set dvl.type)"
    ]
    found = extrinsics(imu__frame_id="imu", dvl__frame_id="dvl", dvl__type=drivers.DVL_MSGS)
    found.add(SimpleNamespace(transforms=list(told)))
    assert found.missing() == []


@pytest.mark.parametrize("convention", ["enu", "ned"])
@pytest.mark.parametrize("kind", [k for k, d in drivers.DRIVERS.items() if d.header])
@pytest.mark.parametrize("is_set", [False, True])
def test_the_frame_of_a_dvl_has_the_axes_of_its_messages(
    kind: str, convention: str, is_set: bool
) -> None:
    """So the transform takes the velocity of a message to base_link, whatever its type."""
    rpy = (2.9, -0.1, 0.7)
    given = {"dvl.type": kind} if is_set else {}
    parameters = build(
        FilterParameters, {"extrinsics": "tf", "frame_convention": convention, **given}
    )
    found = Extrinsics(parameters, taken(parameters))
    found.add(
        SimpleNamespace(
            transforms=[transform("base_link", "dvl", rpy=rpy), transform("base_link", "imu")]
        )
    )
    axes = CONVENTIONS[convention]
    ping = dvl_message(kind, 10 * NS, (1.2, -0.3, 0.2), convention=axes)
    if hasattr(ping, "child_frame_id"):
        ping.header.frame_id, ping.child_frame_id = "odom", "dvl"
    else:
        ping.header.frame_id = "dvl"
    found.hear(DVL, ping)
    found.hear(IMU, message("imu"))
    assert found.missing() == []
    mount = rotation_from_rpy(np.array(found.applied(parameters).dvl.mount))
    v_b = axes.body_rotation(mount) @ dvl(ping, axes).v_d
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    np.testing.assert_allclose(axes.body @ v_b, R @ drivers.ping(ping).velocity, atol=1e-12)


def test_messages_that_tell_no_frame_are_named() -> None:
    found = extrinsics(imu__frame_id="imu", dvl__type=drivers.NUCLEUS_BOTTOM)
    found.add(SimpleNamespace(transforms=[transform("base_link", "imu")]))
    found.hear(DVL, SimpleNamespace())
    assert found.missing() == ["dvl: its messages have no frame: set dvl.frame_id"]
    found.hear(DVL, message(""))
    assert found.missing() == ["dvl: the frame_id of its messages is empty: its driver must set it"]
    found.hear(DVL, message("imu"))
    assert found.missing() == []


def test_a_message_tells_its_sensors_frame_by_its_kind() -> None:
    """An odometry by its child; an attitude tells another frame, so the parameters hold."""
    found = extrinsics(
        heading__topic="compass", heading__mount=(0.0, 0.0, 0.1), imu__frame_id="imu"
    )
    odometry = message("odom")
    odometry.child_frame_id = "dvl"
    found.hear("dvl/velocity", odometry)
    quaternion = message("map")
    quaternion.quaternion = None
    found.hear("compass", quaternion)
    found.add(
        SimpleNamespace(transforms=[transform("base_link", "imu"), transform("base_link", "dvl")])
    )
    assert found.missing() == [] and "heading.mount" not in found.found()


def test_frames_in_a_circle_are_refused() -> None:
    with pytest.raises(FrameError, match="circle"):
        tree(transform("a", "b"), transform("b", "a")).pose("base_link", "a")


def test_a_transform_that_is_none_is_refused_whole() -> None:
    bad, good = transform("base_link", "dvl"), transform("base_link", "imu")
    bad.transform.rotation.w = 0.3
    found = FrameTree()
    with pytest.raises(RejectedMessage, match="base_link -> dvl") as caught:
        found.add(SimpleNamespace(transforms=[good, bad]))
    assert caught.value.reason == "bad_quaternion"
    bad.transform.rotation.w, bad.transform.translation.x = 1.0, np.nan
    with pytest.raises(RejectedMessage, match="not_finite"):
        found.add(SimpleNamespace(transforms=[good, bad]))
    with pytest.raises(FrameError, match="'imu'"):
        found.pose("base_link", "imu")


def test_the_last_transform_of_a_frame_counts() -> None:
    found = tree(transform("base_link", "dvl", (1.0, 0.0, 0.0)))
    found.add(SimpleNamespace(transforms=[transform("base_link", "dvl", (2.0, 0.0, 0.0))]))
    assert found.pose("base_link", "dvl").t[0] == 2.0


def test_the_topics_are_those_of_the_table() -> None:
    assert {IMU, DVL} <= set(taken(FilterParameters()))
