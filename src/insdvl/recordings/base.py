"""What reading and writing recordings share: recorded messages, their types, and their bytes.

Messages are encoded and decoded with the `rosbags` library. A decoded message has the fields of the
standard ROS message, so `insdvl.messages` takes it as it takes a message of rclpy.
"""

import struct
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from insdvl.extras import extra
from insdvl.messages.convert import IMU
from insdvl.navigation.events import NS

with extra("bags"):
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import Stores, get_typestore
    from rosbags.typesys.store import Typestore


class BagError(ValueError):
    """A recording cannot be read or written as asked; the message says which and why."""


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


# ---------------------------------------------------------------- new messages

_QUATERNION = "geometry_msgs/msg/Quaternion"


def new_message(kind: str) -> Any:
    """A message with the default values of its type, ``package/msg/Name``."""
    store = typestore()
    fields = {name: _default(*definition) for name, definition in store.fielddefs[kind][1]}
    if kind == _QUATERNION:  # the one type of ours whose definition has another default than zero
        fields["w"] = 1.0
    return store.types[kind](**fields)


def _default(node: Nodetype, definition: Any) -> Any:
    """The default value of a field, by its definition in the typestore."""
    if node is Nodetype.NAME:
        return new_message(definition)
    if node is Nodetype.BASE:
        return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(definition[0], 0)
    (inner, of), size = definition
    count = size if node is Nodetype.ARRAY else 0
    if inner is Nodetype.BASE and of[0] != "string":
        return np.zeros(count, dtype=of[0])
    return [_default(inner, of) for _ in range(count)]


# ---------------------------------------------------------------- bytes


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
        struct.error, KeyError, UnicodeDecodeError or ValueError: The bytes are not such a message.
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
    """Decode a recorded message.

    Raises:
        BagError: The bytes are not a message of the type.
    """
    try:
        if raw.type == IMU:
            message: Any = _decode_imu(raw.data)
        else:
            message = typestore().deserialize_cdr(raw.data, raw.type)
    except Exception as error:  # damaged bytes make a decoder raise anything
        raise BagError(
            f"damaged message on topic {raw.topic} at {raw.time_ns / NS:.9f} s ({raw.type}): "
            f"{text_of(error)}"
        ) from error
    return Recorded(raw.topic, raw.type, raw.time_ns, message)


def encode(topic: str, time_ns: int, message: Any) -> Raw:
    """Encode a message of `typestore`."""
    kind = message.__msgtype__
    data = bytes(typestore().serialize_cdr(message, kind, little_endian=True))
    return Raw(topic, kind, time_ns, data)


def stamp_ns(raw: Raw) -> int:
    """The stamp of the header with which a recorded message begins [ns].

    Raises:
        BagError: The message is too short to have one.
    """
    try:
        sec, nanosec, _ = _HEADERS[raw.data[:2]].unpack_from(raw.data, _ENCAPSULATION)
    except (KeyError, struct.error) as error:
        raise BagError(f"damaged message on topic {raw.topic}: it has no header") from error
    return int(sec) * NS + int(nanosec)


def text_of(error: Exception) -> str:
    """The message of an exception; its type where it has none."""
    return str(error) or type(error).__name__
