"""Recordings: what is written is read back; what is damaged or missing is named."""

import struct
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from insdvl.messages.convert import FIX, IMU, ODOMETRY, TWIST, TWIST_WITH_COVARIANCE, stamp_ns
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import BagError, Raw, decode, encode, typestore
from insdvl.recordings.messages import imu_message, odometry_message, twist_message

SIZE = 200


def write(path: Path, storage: str = "mcap", count: int = SIZE) -> None:
    rng = np.random.default_rng(7)
    with BagWriter(path, storage) as bag:
        for k in range(count):
            stamp_ns = 1_700_000_000_000_000_000 + 10_000_000 * k
            f, w = rng.standard_normal((2, 3))
            Q = np.diag([1.0, 2.0, 3.0]) + 0.1
            bag.write(encode("/imu", stamp_ns + 5, imu_message(stamp_ns, "imu", f, w, Q, 2 * Q)))
            if k % 10 == 0:
                v = rng.standard_normal(3)
                bag.write(encode("/dvl", stamp_ns + 7, twist_message(stamp_ns, "dvl", v)))
                bag.write(encode("/cov", stamp_ns + 7, twist_message(stamp_ns, "dvl", v, Q)))
                message = odometry_message(
                    stamp_ns, ("odom", "base_link"), v, np.array([0, 0, 0.6, 0.8]), f, w, np.eye(6)
                )
                bag.write(encode("/odometry", stamp_ns + 9, message))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_is_written_is_read_back(tmp_path: Path, storage: str) -> None:
    write(tmp_path / "bag", storage)
    with BagReader(tmp_path / "bag") as bag:
        assert {name: tuple(topic) for name, topic in bag.topics.items()} == {
            "/imu": (IMU, SIZE),
            "/dvl": (TWIST, SIZE // 10),
            "/cov": (TWIST_WITH_COVARIANCE, SIZE // 10),
            "/odometry": (ODOMETRY, SIZE // 10),
        }
        messages = list(bag.messages(bag.topics))
    assert [m.time_ns for m in messages] == sorted(m.time_ns for m in messages)

    rng = np.random.default_rng(7)
    f, w = rng.standard_normal((2, 3))
    v = rng.standard_normal(3)
    first = {m.topic: m for m in reversed(messages)}
    imu = first["/imu"].message
    assert first["/imu"].time_ns == 1_700_000_000_000_000_005
    assert (imu.header.stamp.sec, imu.header.stamp.nanosec) == (1_700_000_000, 0)
    assert imu.header.frame_id == "imu"
    assert tuple(imu.linear_acceleration) == tuple(f)
    assert tuple(imu.angular_velocity) == tuple(w)
    Q = np.diag([1.0, 2.0, 3.0]) + 0.1
    np.testing.assert_array_equal(imu.linear_acceleration_covariance, Q.ravel())
    np.testing.assert_array_equal(imu.angular_velocity_covariance, 2 * Q.ravel())
    assert imu.orientation_covariance[0] == -1.0
    linear = first["/cov"].message.twist.twist.linear
    assert (linear.x, linear.y, linear.z) == tuple(v)
    R = first["/cov"].message.twist.covariance.reshape(6, 6)
    np.testing.assert_array_equal(R[:3, :3], Q)
    odometry = first["/odometry"].message
    assert odometry.header.frame_id == "odom"
    assert odometry.child_frame_id == "base_link"
    assert odometry.pose.pose.orientation.w == 0.8
    assert odometry.twist.twist.angular.z == w[2]
    np.testing.assert_array_equal(odometry.pose.covariance, np.eye(6).ravel())


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_storage_file_alone_is_a_recording(tmp_path: Path, storage: str) -> None:
    write(tmp_path / "bag", storage)
    file = next(f for f in (tmp_path / "bag").iterdir() if f.suffix in (".mcap", ".db3"))
    with BagReader(tmp_path / "bag") as folder, BagReader(file) as alone:
        assert list(alone.raw(alone.topics)) == list(folder.raw(folder.topics))


def test_a_big_endian_imu_is_read_as_well() -> None:
    rng = np.random.default_rng(3)
    values = rng.standard_normal((2, 3)), rng.standard_normal((2, 3, 3))
    message = imu_message(1_234_567_890_123_456_789, "imu_link", *values[0], *values[1])
    little, big = (
        decode(Raw("/imu", IMU, 0, bytes(data))).message
        for data in (
            typestore().serialize_cdr(message, IMU, little_endian=True),
            typestore().serialize_cdr(message, IMU, little_endian=False),
        )
    )
    assert little.header.frame_id == big.header.frame_id == "imu_link"
    assert stamp_ns(little.header) == stamp_ns(big.header) == 1_234_567_890_123_456_789
    for name in ("angular_velocity", "linear_acceleration"):
        assert getattr(little, name).y == getattr(big, name).y
        name += "_covariance"
        np.testing.assert_array_equal(getattr(little, name), getattr(big, name))


def test_bytes_pass_through_unchanged(tmp_path: Path) -> None:
    data = bytes(
        typestore().serialize_cdr(
            twist_message(1_000_000_001, "dvl", np.array([1.0, 2.0, 3.0])), TWIST
        )
    )
    with BagWriter(tmp_path / "bag") as bag:
        bag.write(Raw("/dvl", TWIST, 3, data))
    with BagReader(tmp_path / "bag") as bag:
        assert list(bag.raw(["/dvl"])) == [Raw("/dvl", TWIST, 3, data)]


def test_only_the_topics_asked_for(tmp_path: Path) -> None:
    write(tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        assert {m.topic for m in bag.messages(["/dvl", "/absent"])} == {"/dvl"}
        assert list(bag.raw(["/absent"])) == []


def test_a_topic_of_another_type_is_named(tmp_path: Path) -> None:
    write(tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        assert bag.has("/dvl", TWIST, TWIST_WITH_COVARIANCE)
        assert not bag.has("/absent", IMU)
        with pytest.raises(BagError, match=f"/dvl .* has type {TWIST}, expected {IMU} or {FIX}"):
            bag.has("/dvl", IMU, FIX)
        with pytest.raises(BagError, match="'/absent' is not in .*; it has /cov, /dvl, /imu"):
            bag.require("/absent", IMU)


def test_what_is_no_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="absent does not exist"):
        BagReader(tmp_path / "absent")
    with pytest.raises(BagError, match="no metadata.yaml"):
        BagReader(tmp_path)
    for name in ("notes.txt", "bag.mcap", "bag.db3"):
        (tmp_path / name).write_text("nothing of the kind, and longer than a footer of MCAP has")
        with pytest.raises(BagError, match=name):
            BagReader(tmp_path / name)
        (tmp_path / name).write_bytes(b"")
        with pytest.raises(BagError, match=name):
            BagReader(tmp_path / name)
    (tmp_path / "metadata.yaml").write_text("[1, 2")
    with pytest.raises(BagError, match="metadata"):
        BagReader(tmp_path)
    with BagWriter(tmp_path / "empty"):
        pass
    with pytest.raises(BagError, match="is empty"):
        BagReader(tmp_path / "empty")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_truncated_recording_is_an_error_and_not_a_short_one(
    tmp_path: Path, storage: str
) -> None:
    write(tmp_path / "bag", storage)
    file = next(f for f in (tmp_path / "bag").iterdir() if f.suffix in (".mcap", ".db3"))
    whole = file.read_bytes()
    for length in (0, 1, 7, 8, 20, 100, len(whole) // 3, len(whole) // 2, len(whole) - 4096):
        file.write_bytes(whole[:length])
        for path in (tmp_path / "bag", file):
            with pytest.raises(BagError, match="bag"), BagReader(path) as bag:
                list(bag.messages(bag.topics))
    file.unlink()
    with pytest.raises(BagError, match="missing"):
        BagReader(tmp_path / "bag")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_damage_anywhere_is_a_bag_error_or_is_harmless(tmp_path: Path, storage: str) -> None:
    write(tmp_path / "bag", storage, count=30)
    file = next(f for f in (tmp_path / "bag").iterdir() if f.suffix in (".mcap", ".db3"))
    whole = file.read_bytes()
    rng = np.random.default_rng(11)
    caught = 0
    for _ in range(150):
        damaged = bytearray(whole)
        start = int(rng.integers(len(whole) - 16))
        damaged[start : start + 16] = rng.bytes(16)
        file.write_bytes(damaged)
        try:
            with BagReader(file) as bag:
                list(bag.messages(bag.topics))
        except BagError as error:
            assert "bag" in str(error) or "topic" in str(error)
            caught += 1
    assert caught > 5


def test_a_damaged_message_is_named() -> None:
    data = bytes(typestore().serialize_cdr(imu_message(0, "imu", np.zeros(3), np.ones(3)), IMU))
    endless = data[:12] + struct.pack("<I", 2**31) + data[16:]
    for damaged in (b"", data[:3], data[:40], data[:-1], data + bytes(8), endless, b"\x07" + data):
        with pytest.raises(BagError, match="damaged message on topic /imu at 1.5"):
            decode(Raw("/imu", IMU, 1_500_000_000, damaged))
    with pytest.raises(BagError, match="damaged message on topic /dvl"):
        decode(Raw("/dvl", TWIST, 0, data))


def test_an_existing_recording_is_never_overwritten(tmp_path: Path) -> None:
    write(tmp_path / "bag", count=1)
    before = sorted((f.name, f.read_bytes()) for f in (tmp_path / "bag").iterdir())
    with pytest.raises(BagError, match="bag exists already"):
        BagWriter(tmp_path / "bag")
    late = tmp_path / "late"
    with pytest.raises(BagError, match="late exists already"), BagWriter(late) as bag:
        bag.write(encode("/dvl", 0, twist_message(0, "dvl", np.zeros(3))))
        late.mkdir()
    assert sorted(f.name for f in tmp_path.iterdir()) == ["bag", "late"]
    assert list(late.iterdir()) == []
    assert sorted((f.name, f.read_bytes()) for f in (tmp_path / "bag").iterdir()) == before


def test_a_recording_has_its_name_only_when_it_is_complete(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "on" / "demand"
    with BagWriter(folder / "bag") as bag:
        bag.write(encode("/dvl", 0, twist_message(0, "dvl", np.zeros(3))))
        assert not (folder / "bag").exists()
    assert [f.name for f in folder.iterdir()] == ["bag"]

    with pytest.raises(RuntimeError, match="half way"), BagWriter(folder / "half") as bag:
        bag.write(encode("/dvl", 0, twist_message(0, "dvl", np.zeros(3))))
        raise RuntimeError("half way")
    assert [f.name for f in folder.iterdir()] == ["bag"]


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="cannot write recording"):
        BagWriter(tmp_path / "file" / "bag")
    with pytest.raises(BagError, match="storage must be one of mcap, sqlite3, got 'tape'"):
        BagWriter(tmp_path / "bag", "tape")
    with BagWriter(tmp_path / "bag") as bag:
        bag.write(encode("/dvl", 0, twist_message(0, "dvl", np.zeros(3))))
        with pytest.raises(BagError, match=f"/dvl has type {TWIST}, cannot take {IMU}"):
            bag.write(encode("/dvl", 0, imu_message(0, "imu", np.zeros(3), np.zeros(3))))
        with pytest.raises(BagError, match="our_msgs/msg/Own is not a standard message type"):
            bag.write(Raw("/own", "our_msgs/msg/Own", 0, b""))
    with pytest.raises(ValueError, match="a covariance must have 9 values, got 36"):
        imu_message(0, "imu", np.zeros(3), np.zeros(3), np.eye(6))


@pytest.mark.parametrize("compressed", [False, True])
def test_chunks_whose_times_overlap_are_read_in_the_order_of_the_times(
    tmp_path: Path, compressed: bool
) -> None:
    """As the library itself reads them, one message after the other."""
    rng = np.random.default_rng(5)
    times_ns = rng.permutation(400) // 4 * 4 + 500 * np.arange(400) // 60  # some times are equal
    with BagWriter(tmp_path / "bag", compressed=compressed) as bag:
        for k, time_ns in enumerate(times_ns.tolist()):
            topic, frame_id = ("/imu", "imu") if k % 3 else ("/other", "x" * 20_000)
            message = imu_message(k + 1, frame_id, rng.normal(size=3), rng.normal(size=3))
            bag.write(encode(topic, time_ns + 1, message))
    for topics in {"/imu"}, {"/imu", "/other"}:
        with Reader(tmp_path / "bag") as reader:
            assert sum(len(storage.chunks) for storage in reader.storage.storages) > 2
            chosen = [c for c in reader.connections if c.topic in topics]
            expected = [(c.topic, t, data) for c, t, data in reader.messages(chosen)]
        with BagReader(tmp_path / "bag") as bag:
            found = [(raw.topic, raw.time_ns, raw.data) for raw in bag.raw(topics)]
        assert found == expected
        assert len(found) > 200
