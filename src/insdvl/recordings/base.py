"""What reading and writing recordings share: recorded messages, their types, and their bytes.

Messages are encoded and decoded with the `rosbags` library. A decoded message has the fields of the
standard ROS message, so `insdvl.messages` takes it as it takes a message of rclpy.
"""

import struct
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np

from insdvl.extras import extra
from insdvl.messages.cdr.imu_bytes import decode_imu
from insdvl.messages.convert import IMU
from insdvl.navigation.events import NS

with extra("bags"):
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
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
        definition: Of a type that is not a standard one, as the recording holds it: message
            definition of the type and of those that it is made of.
    """

    topic: str
    type: str
    time_ns: int
    data: bytes
    definition: str = ""


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


#: Limits of a definition that a recording brings: its text, and the elements of its arrays. Those
#: of drivers have a few kilobytes, and some dozens of elements.
MAX_DEFINITION, MAX_ELEMENTS = 65_536, 100_000


@lru_cache(maxsize=64)
def typestore_with(kind: str, definition: str) -> Typestore:
    """The message types of ROS 2 Jazzy, and one with the definition that a recording brings.

    Raises:
        BagError: There is no definition, it cannot be read, or it is too large.
    """
    if kind in typestore().fielddefs:
        return typestore()
    if not definition:
        raise BagError(
            f"{kind} is not a standard message type, and the recording has no definition of it; "
            "record it with MCAP, or with sqlite3 of ROS 2 Iron or later"
        )
    if len(definition) > MAX_DEFINITION:
        raise BagError(
            f"the definition of {kind} has {len(definition)} characters, at most {MAX_DEFINITION} "
            "are read"
        )
    store = get_typestore(Stores.ROS2_JAZZY)
    try:
        types = get_types_from_msg(definition, kind)
        sizes = [_elements(field) for _, fields in types.values() for _, field in fields]
        if sum(sizes) > MAX_ELEMENTS:
            raise ValueError(f"arrays of {sum(sizes)} elements, at most {MAX_ELEMENTS} are read")
        store.register(types)
        store.get_msgdef(kind)
    except Exception as error:  # a damaged text makes the parser raise anything
        raise BagError(f"cannot read the definition of {kind}: {text_of(error)}") from error
    return store


def _elements(field: Any) -> int:
    """Number of elements of an array of fixed size, by the definition of the field."""
    node, of = field
    return int(of[1]) if node == Nodetype.ARRAY else 0


# ---------------------------------------------------------------- new messages

_QUATERNION = "geometry_msgs/msg/Quaternion"


def new_message(kind: str, *, definition: str = "", of: str = "") -> Any:
    """A message with the default values of its type.

    Args:
        kind: The type, ``package/msg/Name``.
        definition: Of a type that is not a standard one.
        of: The type that the definition is of, where `kind` is a part of it.
    """
    return _new(kind, typestore_with(of or kind, definition))


def _new(kind: str, store: Typestore) -> Any:
    fields = {name: _default(field, store) for name, field in store.fielddefs[kind][1]}
    if kind == _QUATERNION:  # the one type of ours whose definition has another default than zero
        fields["w"] = 1.0
    return store.types[kind](**fields)


def _default(field: Any, store: Typestore) -> Any:
    """The default value of a field, by its definition in the typestore."""
    node, definition = field
    if node is Nodetype.NAME:
        return _new(definition, store)
    if node is Nodetype.BASE:
        return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(definition[0], 0)
    (inner, of), size = definition
    count = size if node is Nodetype.ARRAY else 0
    if inner is Nodetype.BASE and of[0] != "string":
        return np.zeros(count, dtype=of[0])
    return [_default((inner, of), store) for _ in range(count)]


# ---------------------------------------------------------------- bytes


_ENCAPSULATION = 4  # bytes before a CDR message; alignment counts from behind them
_HEADERS = {b"\x00\x01": struct.Struct("<iII"), b"\x00\x00": struct.Struct(">iII")}


def decode(raw: Raw) -> Recorded:
    """Decode a recorded message.

    Raises:
        BagError: The bytes are not a message of the type.
    """
    try:
        message: Any = decode_imu(raw.data) if raw.type == IMU else None
        if message is None:
            store = typestore_with(raw.type, raw.definition)
            message = store.deserialize_cdr(raw.data, raw.type)
    except BagError as error:  # it is not the message that is wrong
        raise BagError(f"topic {raw.topic}: {error}") from error
    except Exception as error:  # damaged bytes make a decoder raise anything
        raise BagError(
            f"damaged message on topic {raw.topic} at {raw.time_ns / NS:.9f} s ({raw.type}): "
            f"{text_of(error)}"
        ) from error
    return Recorded(raw.topic, raw.type, raw.time_ns, message)


def encode(topic: str, time_ns: int, message: Any, definition: str = "") -> Raw:
    """Encode a message of `typestore`, or of `new_message` with a definition."""
    kind = message.__msgtype__
    store = typestore_with(kind, definition)
    data = bytes(store.serialize_cdr(message, kind, little_endian=True))
    return Raw(topic, kind, time_ns, data, definition)


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
