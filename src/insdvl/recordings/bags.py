"""rosbag2 recordings in and out without ROS, sqlite3 and MCAP alike.

Messages are read and written with the `rosbags` library. What comes out of a recording has the
fields of the standard ROS message, so the functions of messages/convert.py take it as they take a
message of rclpy.
"""

import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from insdvl.extras import extra
from insdvl.messages.inputs import FIX, IMU, ODOMETRY, TWIST, TWIST_WITH_COVARIANCE
from insdvl.navigation.events import NS
from insdvl.recordings.checks import (
    MAX_MESSAGE_BYTES,
    check_chunks,
    check_database,
    check_folder,
)
from insdvl.recordings.parameters import ReplayParameters

with extra("bags"):
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
    from rosbags.typesys.store import Typestore

#: What is played of a recording: the parameter that names the recorded topic, the topic that the
#: nodes know it by, and its type.
INPUTS = (
    ("imu_topic", "imu/data_raw", IMU),
    ("dvl_topic", "dvl/velocity", TWIST),
    ("dvl_covariance_topic", "dvl/velocity_cov", TWIST_WITH_COVARIANCE),
    ("process_noise_topic", "process_noise", IMU),
    ("ground_truth_topic", "ground_truth/odometry", ODOMETRY),
    ("true_process_noise_topic", "ground_truth/process_noise", IMU),
    ("fix_topic", "gps/fix", FIX),
    ("set_odometry_topic", "set_odometry", ODOMETRY),
)

STORAGES = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}


class BagError(ValueError):
    """A recording cannot be read or written as asked; the message says which and why."""


def _text(error: Exception) -> str:
    """What an exception says; its kind where it says nothing."""
    return str(error) or type(error).__name__


class Topic(NamedTuple):
    """A topic of a recording.

    Attributes:
        type: Name of its message type, ``package/msg/Name``.
        size: Number of its messages.
    """

    type: str
    size: int


class Raw(NamedTuple):
    """A recorded message as its bytes.

    Attributes:
        topic: Name of the topic in the recording.
        type: Name of the message type.
        time_ns: When it was recorded [ns].
        data: The message in CDR, its four bytes of encapsulation included.
    """

    topic: str
    type: str
    time_ns: int
    data: bytes


class Recorded(NamedTuple):
    """A recorded message; as `Raw`, with the message decoded."""

    topic: str
    type: str
    time_ns: int
    message: Any


@cache
def typestore() -> Typestore:
    """The message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


class _Time(NamedTuple):
    sec: int
    nanosec: int


class _Header(NamedTuple):
    stamp: _Time
    frame_id: str


class _Vector3(NamedTuple):
    x: float
    y: float
    z: float


class _Quaternion(NamedTuple):
    x: float
    y: float
    z: float
    w: float


class _Imu(NamedTuple):
    header: _Header
    orientation: _Quaternion
    orientation_covariance: tuple[float, ...]
    angular_velocity: _Vector3
    angular_velocity_covariance: tuple[float, ...]
    linear_acceleration: _Vector3
    linear_acceleration_covariance: tuple[float, ...]


_ENCAPSULATION = 4  # bytes before a CDR message; alignment counts from behind them
_HEADERS = {b"\x00\x01": struct.Struct("<iII"), b"\x00\x00": struct.Struct(">iII")}
_IMU_BODIES = {b"\x00\x01": struct.Struct("<37d"), b"\x00\x00": struct.Struct(">37d")}


def _decode_imu(data: bytes) -> _Imu:
    """A sensor_msgs/Imu, ten times as fast as the general decoder: nearly all messages are these.

    Raises:
        struct.error, KeyError, UnicodeDecodeError or ValueError: The bytes are no such message.
    """
    order = data[:2]
    sec, nanosec, length = _HEADERS[order].unpack_from(data, _ENCAPSULATION)
    text = _ENCAPSULATION + 12
    body = _ENCAPSULATION + (12 + length + 7) // 8 * 8
    if not body + _IMU_BODIES[order].size <= len(data) <= body + _IMU_BODIES[order].size + 3:
        raise ValueError(f"{len(data)} bytes are not the size of the message")
    v = _IMU_BODIES[order].unpack_from(data, body)
    return _Imu(
        _Header(_Time(sec, nanosec), data[text : text + max(length - 1, 0)].decode()),
        _Quaternion(*v[:4]),
        v[4:13],
        _Vector3(*v[13:16]),
        v[16:25],
        _Vector3(*v[25:28]),
        v[28:37],
    )


def decode(raw: Raw) -> Recorded:
    """A recorded message from its bytes.

    Raises:
        BagError: The bytes are no message of the type.
    """
    try:
        if raw.type == IMU:
            message: Any = _decode_imu(raw.data)
        else:
            message = typestore().deserialize_cdr(raw.data, raw.type)
    except Exception as error:  # damaged bytes make a decoder raise anything
        raise BagError(
            f"damaged message on topic {raw.topic} at {raw.time_ns / NS:.9f} s ({raw.type}): "
            f"{_text(error)}"
        ) from error
    return Recorded(raw.topic, raw.type, raw.time_ns, message)


def encode(topic: str, time_ns: int, message: Any) -> Raw:
    """A message of `typestore`, as the functions below make them, as its bytes."""
    kind = message.__msgtype__
    data = bytes(typestore().serialize_cdr(message, kind, little_endian=True))
    return Raw(topic, kind, time_ns, data)


@final
class BagReader:
    """An open recording; a context manager.

    Attributes:
        path: The folder of the recording, or its one .mcap or .db3 file.
        topics: The topics of the recording by name.
    """

    def __init__(self, path: Path) -> None:
        """Open a recording.

        Raises:
            BagError: There is none, it is damaged, incomplete or of another kind, or it is empty.
        """
        self.path = path
        if not path.exists():
            raise BagError(f"recording {path} does not exist")
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            raise BagError(f"{path} is no rosbag2 recording: it has no metadata.yaml")
        if not path.is_dir() and not (path.is_file() and path.suffix in (".mcap", ".db3")):
            raise BagError(f"{path} is no rosbag2 recording: neither a folder, .mcap nor .db3")
        try:
            with ExitStack() as stack:
                self._reader = self._open(path, stack)
                found = {
                    name: (sorted({c.msgtype for c in info.connections}), info.msgcount)
                    for name, info in self._reader.topics.items()
                }
                stack.pop_all()
        except Exception as error:  # damaged bytes make the parser raise anything
            raise BagError(f"cannot read recording {path}: {_text(error)}") from error
        for name, (types, _) in found.items():
            if len(types) > 1:
                self.close()
                raise BagError(f"topic {name} of {path} has several types: {', '.join(types)}")
        self.topics = {name: Topic(types[0], size) for name, (types, size) in found.items()}
        if not any(topic.size for topic in self.topics.values()):
            self.close()
            raise BagError(f"recording {path} is empty: it has no messages")

    @staticmethod
    def _open(path: Path, stack: ExitStack) -> Reader:
        """Open a recording when it is fit for it; the stack closes it."""
        if path.is_dir():
            check_folder(path)
        elif path.suffix == ".db3":
            check_database(path)
        reader = Reader(path)
        reader.open()
        stack.callback(reader.close)
        for storage in getattr(reader.storage, "storages", [reader.storage]):
            check_chunks(getattr(storage, "chunks", []))
        return reader

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the recording."""
        if self._reader.is_open:
            self._reader.close()

    def has(self, topic: str, *types: str) -> bool:
        """Whether a topic has messages in the recording.

        Raises:
            BagError: It is there with a type that is none of `types`.
        """
        if topic not in self.topics or not self.topics[topic].size:
            return False
        if self.topics[topic].type not in types:
            raise BagError(
                f"topic {topic} of {self.path} has type {self.topics[topic].type}, "
                f"expected {' or '.join(types)}"
            )
        return True

    def require(self, topic: str, *types: str) -> None:
        """As `has`, where a topic must be there.

        Raises:
            BagError: The topic has no messages, or another type.
        """
        if not self.has(topic, *types):
            there = ", ".join(sorted(name for name, info in self.topics.items() if info.size))
            raise BagError(f"topic {topic!r} is not in {self.path}; it has {there}")

    def raw(self, topics: Collection[str]) -> Iterator[Raw]:
        """The messages of some topics as bytes, in the order in which they were recorded.

        Raises:
            BagError: The recording is damaged, or holds fewer messages than it says.
        """
        connections = [c for c in self._reader.connections if c.topic in topics]
        expected, found = sum(c.msgcount for c in connections), 0
        if not connections:
            return
        messages = self._reader.messages(connections)
        while True:
            try:
                connection, time_ns, data = next(messages)
            except StopIteration:
                break
            except Exception as error:  # damaged bytes make the parser raise anything
                raise BagError(
                    f"recording {self.path} is damaged behind {found} messages: {_text(error)}"
                ) from error
            found += 1
            if len(data) > MAX_MESSAGE_BYTES:
                raise BagError(
                    f"a message on topic {connection.topic} of {self.path} has {len(data)} bytes, "
                    f"and at most {MAX_MESSAGE_BYTES} are read"
                )
            if found > expected:
                break
            yield Raw(connection.topic, connection.msgtype, time_ns, bytes(data))
        if found != expected:
            raise BagError(
                f"recording {self.path} is damaged: it has {found} messages or more on "
                f"{', '.join(sorted(topics))}, and says that there are {expected}"
                if found > expected
                else f"recording {self.path} is incomplete: {found} of {expected} messages on "
                f"{', '.join(sorted(topics))}"
            )

    def messages(self, topics: Collection[str]) -> Iterator[Recorded]:
        """The messages of some topics, in the order in which they were recorded.

        Raises:
            BagError: The recording or one of the messages is damaged.
        """
        return map(decode, self.raw(topics))


def played(bag: BagReader, parameters: ReplayParameters) -> dict[str, str]:
    """The recorded topics that are played, and the topics that the nodes know them by.

    Raises:
        BagError: A topic has another type, two parameters name one topic, or the IMU or the DVL is
            not in the recording.
    """
    topics: dict[str, str] = {}
    for field, topic, kind in INPUTS:
        recorded = getattr(parameters, field)
        if not recorded or not bag.has(recorded, kind):
            continue
        if recorded in topics:
            raise BagError(f"{field} {recorded!r} is already played on {topics[recorded]}")
        topics[recorded] = topic
    bag.require(parameters.imu_topic, IMU)
    if not {"dvl/velocity", "dvl/velocity_cov"} & set(topics.values()):
        bag.require(parameters.dvl_topic, TWIST)
    return topics


def stamp_ns(raw: Raw) -> int:
    """The stamp of the header that a recorded message begins with [ns].

    Raises:
        BagError: The message is too short to have one.
    """
    try:
        sec, nanosec, _ = _HEADERS[raw.data[:2]].unpack_from(raw.data, _ENCAPSULATION)
    except (KeyError, struct.error) as error:
        raise BagError(f"damaged message on topic {raw.topic}: it has no header") from error
    return int(sec) * NS + int(nanosec)


@final
class BagWriter:
    """A new recording; a context manager.

    It grows under a hidden name beside its place and takes its own when it is complete. Leaving
    the ``with`` block by an exception leaves nothing behind.
    """

    def __init__(self, path: Path, storage: str = "mcap") -> None:
        """Begin a recording.

        Args:
            path: Folder of the recording; it must not exist.
            storage: ``mcap`` or ``sqlite3``.

        Raises:
            BagError: Something is there already, or the folder cannot be made.
        """
        if storage not in STORAGES:
            raise BagError(f"storage is one of {', '.join(STORAGES)}, got {storage!r}")
        if path.exists() or path.is_symlink():
            raise BagError(f"{path} exists already and is not overwritten")
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
            self._writer = Writer(
                self._folder / path.name, version=9, storage_plugin=STORAGES[storage]
            )
            self._writer.open()
        except (OSError, sqlite3.Error) as error:
            raise BagError(f"cannot write recording {path}: {error}") from error
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def write(self, raw: Raw) -> None:
        """Append a message that is bytes already, such as a raw subscription of rclpy gives.

        Raises:
            BagError: The topic has had another type, the type is no standard one, or the disk
                refuses.
        """
        connection = self._connections.get(raw.topic)
        try:
            if connection is None:
                if raw.type not in typestore().fielddefs:
                    raise BagError(f"topic {raw.topic}: {raw.type} is no standard message type")
                connection = self._writer.add_connection(raw.topic, raw.type, typestore=typestore())
                self._connections[raw.topic] = connection
            elif connection.msgtype != raw.type:
                raise BagError(
                    f"topic {raw.topic} has type {connection.msgtype}, cannot take {raw.type}"
                )
            self._writer.write(connection, raw.time_ns, raw.data)
        except (OSError, sqlite3.Error) as error:
            raise BagError(f"cannot write recording {self.path}: {error}") from error

    def close(self) -> None:
        """Complete the recording and give it its name.

        Raises:
            BagError: The disk refuses, or something has taken the name meanwhile.
        """
        try:
            self._writer.close()
            if self.path.exists():
                raise BagError(f"{self.path} exists already and is not overwritten")
            (self._folder / self.path.name).rename(self.path)
        except (OSError, sqlite3.Error) as error:
            raise BagError(f"cannot write recording {self.path}: {error}") from error
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def abandon(self) -> None:
        """Drop the recording and what has been written of it."""
        self._writer.abort()
        shutil.rmtree(self._folder, ignore_errors=True)


def new_message(kind: str, **fields: Any) -> Any:
    """A message of `typestore`; `kind` is ``package/msg/Name``."""
    return typestore().types[kind](**fields)


def header_message(stamp_ns: int, frame_id: str) -> Any:
    """A std_msgs/Header."""
    stamp = new_message("builtin_interfaces/msg/Time", sec=stamp_ns // NS, nanosec=stamp_ns % NS)
    return new_message("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def vector_message(v: Iterable[float], kind: str = "geometry_msgs/msg/Vector3") -> Any:
    """A geometry_msgs/Vector3 or Point from three numbers."""
    x, y, z = (float(element) for element in v)
    return new_message(kind, x=x, y=y, z=z)


def _flat(P: NDArray[np.float64] | None, size: int) -> NDArray[np.float64]:
    if P is None:
        return np.zeros(size * size)
    flat = np.array(P, dtype=float).ravel()
    if flat.size != size * size:
        raise ValueError(f"a covariance of {size} x {size} is expected, got {flat.size} elements")
    return flat


def imu_message(
    stamp_ns: int,
    frame_id: str,
    f: NDArray[np.float64],
    w: NDArray[np.float64],
    Q_f: NDArray[np.float64] | None = None,
    Q_w: NDArray[np.float64] | None = None,
) -> Any:
    """A sensor_msgs/Imu without orientation (REP-145).

    Args:
        stamp_ns: Stamp of the header [ns].
        frame_id: Frame of the header.
        f: (3,) specific force [m/s^2].
        w: (3,) angular rate [rad/s].
        Q_f: (3, 3) covariance of `f` [(m/s^2)^2], None for unknown.
        Q_w: (3, 3) covariance of `w` [(rad/s)^2], None for unknown.
    """
    unknown = np.zeros(9)
    unknown[0] = -1.0
    return new_message(
        IMU,
        header=header_message(stamp_ns, frame_id),
        orientation=new_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=vector_message(w),
        angular_velocity_covariance=_flat(Q_w, 3),
        linear_acceleration=vector_message(f),
        linear_acceleration_covariance=_flat(Q_f, 3),
    )


def twist_message(
    stamp_ns: int, frame_id: str, v: NDArray[np.float64], R: NDArray[np.float64] | None = None
) -> Any:
    """A geometry_msgs/TwistStamped, with a covariance a TwistWithCovarianceStamped.

    Args:
        stamp_ns: Stamp of the header [ns].
        frame_id: Frame of the header.
        v: (3,) linear velocity [m/s].
        R: (3, 3) covariance of `v` [(m/s)^2].
    """
    header = header_message(stamp_ns, frame_id)
    twist = new_message(
        "geometry_msgs/msg/Twist", linear=vector_message(v), angular=vector_message(np.zeros(3))
    )
    if R is None:
        return new_message(TWIST, header=header, twist=twist)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = R
    with_covariance = new_message(
        "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance.ravel()
    )
    return new_message(TWIST_WITH_COVARIANCE, header=header, twist=with_covariance)


def odometry_message(
    stamp_ns: int,
    frames: tuple[str, str],
    position: NDArray[np.float64],
    quaternion_xyzw: NDArray[np.float64],
    linear: NDArray[np.float64],
    angular: NDArray[np.float64],
    pose_covariance: NDArray[np.float64] | None = None,
    twist_covariance: NDArray[np.float64] | None = None,
) -> Any:
    """A nav_msgs/Odometry (REP-105).

    Args:
        stamp_ns: Stamp of the header [ns].
        frames: frame_id and child_frame_id.
        position: (3,) of the child in the frame [m].
        quaternion_xyzw: (4,) attitude of the child in the frame.
        linear: (3,) velocity in the child's axes [m/s].
        angular: (3,) angular rate in the child's axes [rad/s].
        pose_covariance: (6, 6) or (36,) of position and rotation, None for unknown.
        twist_covariance: (6, 6) or (36,) of `linear` and `angular`, None for unknown.
    """
    x, y, z, w = (float(element) for element in quaternion_xyzw)
    pose = new_message(
        "geometry_msgs/msg/Pose",
        position=vector_message(position, "geometry_msgs/msg/Point"),
        orientation=new_message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )
    twist = new_message(
        "geometry_msgs/msg/Twist", linear=vector_message(linear), angular=vector_message(angular)
    )
    return new_message(
        ODOMETRY,
        header=header_message(stamp_ns, frames[0]),
        child_frame_id=frames[1],
        pose=new_message(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=_flat(pose_covariance, 6)
        ),
        twist=new_message(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=twist,
            covariance=_flat(twist_covariance, 6),
        ),
    )
