"""Operators and tensors of an ``.onnx`` file, read before onnxruntime loads it.

The file is one protobuf message. Only the fields that lead to operators and tensors are followed,
by their numbers in onnx.proto. Protobuf allows several encodings of the same number, length and
file, so the bytes are parsed as protobuf parses them, and not searched.
"""

from collections.abc import Iterator
from dataclasses import dataclass

Value = int | memoryview | None

MAX_DEPTH = 100  # messages within messages, as protobuf has it
MAX_MESSAGES = 1_000_000  # operators, attributes and tensors, of some hundred bytes each
MAX_FIELDS = 10_000_000  # a second for each million

#: For each kind of message, the fields whose messages lead to operators and tensors.
_WITHIN: dict[str, dict[int, str]] = {
    "model": {7: "graph", 25: "function"},
    "graph": {1: "node", 5: "tensor", 15: "sparse tensor"},
    "function": {7: "node", 11: "attribute"},
    "node": {5: "attribute"},
    "attribute": {
        5: "tensor",
        6: "graph",
        10: "tensor",
        11: "graph",
        22: "sparse tensor",
        23: "sparse tensor",
    },
    "sparse tensor": {1: "tensor", 2: "tensor"},
    "tensor": {},
}
_OPERATOR = ("node", 4)
#: Fields that place the values of a tensor in another file.
_ELSEWHERE = (("tensor", 13), ("tensor", 14))


@dataclass(frozen=True)
class Content:
    """Content of a file.

    Attributes:
        operators: Names of the operators, also in branches and functions.
        has_all: Whether all values of tensors are in the file itself.
    """

    operators: frozenset[bytes]
    has_all: bool


def read(data: bytes) -> Content:
    """Parse the bytes of an ``.onnx`` file.

    Raises:
        ValueError: They are not a protobuf message, or exceed `MAX_DEPTH`, `MAX_MESSAGES` or
            `MAX_FIELDS`.
    """
    operators: set[bytes] = set()
    has_all = True
    messages = fields = 0
    unfinished = [("model", _fields(memoryview(data)))]
    while unfinished:
        kind, rest = unfinished[-1]
        for number, value in rest:
            fields += 1
            if fields > MAX_FIELDS:
                raise ValueError(f"it has more than {MAX_FIELDS} fields")
            if (kind, number) == _OPERATOR and isinstance(value, memoryview):
                operators.add(bytes(value))
            elif (kind, number) in _ELSEWHERE and value:
                has_all = False
            elif number in _WITHIN[kind] and isinstance(value, memoryview):
                messages += 1
                if messages > MAX_MESSAGES:
                    raise ValueError(
                        f"it has more than {MAX_MESSAGES} operators, attributes and tensors"
                    )
                if len(unfinished) == MAX_DEPTH:
                    raise ValueError(f"it has more than {MAX_DEPTH} levels")
                unfinished.append((_WITHIN[kind][number], _fields(value)))
                break  # the rest of this message follows after the inner one
        else:
            unfinished.pop()
    return Content(frozenset(operators), has_all)


def _fields(message: memoryview) -> Iterator[tuple[int, Value]]:
    """Number and value of each field of a message; None for a number of fixed size."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        value: Value = None
        match key & 7:
            case 0:
                value, at = _varint(message, at)
            case 1:
                at += 8
            case 2:
                size, at = _varint(message, at)
                value = message[at : at + size]
                at += size
            case 5:
                at += 4
            case other:
                raise ValueError(f"it has a field of type {other}, which ONNX does not use")
        if at > len(message):
            raise ValueError("it ends within a field")
        yield (key & 0xFFFFFFFF) >> 3, value  # protobuf's keys have 32 bits


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number of up to ten bytes with seven bits each, and the position after it."""
    number = shift = 0
    while shift < 70 and at < len(message):
        byte = message[at]
        number |= (byte & 0x7F) << shift
        at += 1
        if byte < 0x80:
            return number, at
        shift += 7
    raise ValueError("it has a number that does not end")
