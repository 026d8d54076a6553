"""Frames in replay: odometry/global, /tf, errors of the estimate, and mounts from /tf_static."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import record, save
from scipy.spatial.transform import Rotation
from told import TOLD

from insdvl import cli
from insdvl.messages.make import fill_transform
from insdvl.messages.topics import GLOBAL_ODOMETRY, HEADING, ODOMETRY
from insdvl.messages.transforms import TF, TF_MESSAGE, TF_STATIC, TRANSFORM
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import Raw, decode, encode, new_message
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.simulation.trajectories import AUV

DURATION = 6.0
MOUNT, ARM = (0.0, 0.0, 0.6), (0.4, 0.0, -0.2)
VALUES: dict[str, Any] = {
    "initial.mode": "topic",
    "initial.heading_std": 0.5,
    "origin.height": float(AUV.h_0),
}


@pytest.fixture(scope="module")
def raws() -> list[Raw]:
    """A mission with a heading, whose DVL is turned and off base_link, and its truth."""
    mission = simulate(
        AUV,
        constant([1e-4] * 3 + [1e-6] * 3),
        seed=11,
        duration=DURATION,
        heading=HeadingModel(rate=2.0),
        dvl=DvlModel(mount=(MOUNT[0], -MOUNT[1], -MOUNT[2]), lever_arm=(ARM[0], -ARM[1], -ARM[2])),
    )
    return record(mission)


def static(*frames: tuple[str, str, Any, Any]) -> Raw:
    message = new_message(TF_MESSAGE)
    for parent, child, xyz, rpy in frames:
        stamped = new_message(TRANSFORM)
        stamped.header.frame_id, stamped.child_frame_id = parent, child
        fill_transform(stamped, 0, xyz, Rotation.from_euler("xyz", rpy).as_quat())
        message.transforms.append(stamped)
    return encode(TF_STATIC, 1, message)


def yaml(value: Any) -> str:
    """A value as the files of nodes have it: YAML takes 1e-05 for a string."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(yaml, value))}]"
    return f"{value:.12f}" if isinstance(value, float) else json.dumps(value)


def replay(folder: Path, raws: list[Raw], **values: Any) -> tuple[int, dict[str, Any], Path]:
    """The command over a recording: its exit code, its JSON and its recording."""
    folder.mkdir(exist_ok=True)
    bag = save(folder / "bag", raws)
    names = {name.replace("__", "."): value for name, value in values.items()}
    lines = [f"    {name}: {yaml(value)}" for name, value in (TOLD | VALUES | names).items()]
    config, out = folder / "config.yaml", folder / "out"
    config.write_text(
        "/**/insdvl_filter:\n  ros__parameters:\n"
        + "\n".join(lines)
        + "\n/**/insdvl_replay:\n  ros__parameters:\n    imu_topic: /imu\n    dvl_topic: /dvl\n"
        "    ground_truth_topic: /truth\n"
    )
    paths = {"--config": config, "--json": folder / "json", "--out": out, "--rate": 0}
    options = [str(part) for option in paths.items() for part in option]
    code = cli.main(["replay", str(bag), *options])
    return code, json.loads((folder / "json").read_text()) if code == 0 else {}, out


def messages(bag: Path, topic: str) -> list[Any]:
    with BagReader(bag) as reader:
        return [decode(raw).message for raw in reader.raw([topic])]


def place(pose: Any) -> np.ndarray:
    return np.array([pose.position.x, pose.position.y, pose.position.z])


def turn(q: Any) -> Rotation:
    return Rotation.from_quat([q.x, q.y, q.z, q.w])


def test_the_estimate_is_in_map_and_seen_through_map_to_odom(
    raws: list[Raw], tmp_path: Path
) -> None:
    """The start is 0.4 rad off in the heading, which the heading sensor then tells."""
    start = decode(next(raw for raw in raws if raw.topic == "/truth")).message
    roll, pitch, yaw = turn(start.pose.pose.orientation).as_euler("xyz").tolist()
    velocity = start.twist.twist.linear
    code, numbers, out = replay(
        tmp_path / "a",
        raws,
        initial__mode="parameters",
        initial__rpy=(roll, pitch, yaw + 0.4),
        initial__velocity=(velocity.x, velocity.y, velocity.z),
        heading__topic=HEADING,
        publish_tf=True,
        dvl__mount=MOUNT,
        dvl__lever_arm=ARM,
    )
    assert code == 0
    in_map, in_odom = messages(out, f"/{GLOBAL_ODOMETRY}"), messages(out, f"/{ODOMETRY}")
    transforms = messages(out, TF)
    assert len(in_map) == len(in_odom) == len(transforms) > 500
    for a, b, tf in list(zip(in_map, in_odom, transforms, strict=True))[::50]:
        assert (a.header.frame_id, b.header.frame_id) == ("map", "odom")
        assert a.child_frame_id == b.child_frame_id == "base_link"
        base, odom = tf.transforms
        assert (base.header.frame_id, base.child_frame_id) == ("odom", "base_link")
        assert (odom.header.frame_id, odom.child_frame_id) == ("map", "odom")
        assert base.header.stamp == odom.header.stamp == a.header.stamp
        t, q = base.transform.translation, base.transform.rotation
        assert (t.x, t.y, t.z) == tuple(place(b.pose.pose)) and q == b.pose.pose.orientation
        R = turn(odom.transform.rotation)
        t = odom.transform.translation
        seen = np.array([t.x, t.y, t.z]) + R.apply(place(b.pose.pose))
        np.testing.assert_allclose(seen, place(a.pose.pose), atol=1e-8)
        whole = R * turn(b.pose.pose.orientation)
        assert (whole.inv() * turn(a.pose.pose.orientation)).magnitude() < 1e-8
        np.testing.assert_array_equal(a.twist.covariance, b.twist.covariance)
    end = turn(transforms[-1].transforms[1].transform.rotation).magnitude()
    assert end == pytest.approx(0.4, abs=0.06)
    errors = [heading_error(message, raws) for message in (in_map[-1], in_odom[-1])]
    assert errors[0] < 4.0 and 19.0 < errors[1] < 27.0
    assert numbers["heading_rmse_deg"] < 10.0  # of the estimate


def heading_error(message: Any, raws: list[Raw]) -> float:
    truth = [decode(raw).message for raw in raws if raw.topic == "/truth"]
    true = next(t for t in truth if t.header.stamp == message.header.stamp)
    off = turn(true.pose.pose.orientation).inv() * turn(message.pose.pose.orientation)
    return float(np.degrees(abs(off.as_rotvec()[2])))


def test_without_a_heading_there_is_no_map(raws: list[Raw], tmp_path: Path) -> None:
    code, _, out = replay(tmp_path / "a", raws, dvl__mount=MOUNT, dvl__lever_arm=ARM)
    assert code == 0
    with BagReader(out) as bag:
        assert f"/{ODOMETRY}" in bag.topics
        assert not {f"/{GLOBAL_ODOMETRY}", TF} & bag.topics.keys()


def test_mounts_from_tf_static_are_those_of_the_parameters(raws: list[Raw], tmp_path: Path) -> None:
    frames = static(("base_link", "imu", (0, 0, 0), (0, 0, 0)), ("base_link", "dvl", ARM, MOUNT))
    by_tf, told = (
        replay(tmp_path / "a", [frames, *raws], extrinsics="tf"),
        replay(tmp_path / "b", raws, dvl__mount=MOUNT, dvl__lever_arm=ARM),
    )
    assert by_tf[0] == told[0] == 0
    values = by_tf[1]["parameters"]["insdvl_filter"]
    assert values["dvl.mount"] == pytest.approx(MOUNT) and values["dvl.lever_arm"] == list(ARM)
    assert by_tf[1]["body_velocity_rmse"] == pytest.approx(told[1]["body_velocity_rmse"], rel=1e-9)


def test_a_recording_that_does_not_tell_all_is_refused(
    raws: list[Raw], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, _ = replay(tmp_path / "a", raws, extrinsics="tf")
    assert code == 2 and "topic '/tf_static' is not in" in capsys.readouterr().err
    frames = static(("base_link", "imu", (0, 0, 0), (0, 0, 0)))
    code, _, out = replay(tmp_path / "b", [frames, *raws], extrinsics="tf")
    error = capsys.readouterr().err
    assert code == 2 and "extrinsics is 'tf': dvl: /tf_static has no frame 'dvl'" in error
    assert not out.exists()


def test_map_must_have_a_frame_of_its_own_where_there_is_one(
    raws: list[Raw], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, _ = replay(tmp_path / "a", raws, heading__topic=HEADING, odom_frame="map")
    error = capsys.readouterr().err
    assert code == 2 and "parameter 'map_frame' must differ from odom_frame" in error
    assert build(FilterParameters, {"odom_frame": "map"}).odom_frame == "map"
