"""YAML files, as plain data or as texts with their lines. Large, deeply nested files are refused.

With aliases a few lines of YAML can stand for billions of values. ROS 2 does not accept them in
parameter files and rosbag2 does not write them, so they are refused here as well.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from insdvl.files import read

MAX_BYTES = 2**20  # a thousand parameters or topics need less
MAX_DEPTH = 50  # nested levels; parameters and recordings have fewer than ten
MAX_TEXT = 2**16  # characters of one value; rosbag2 writes the QoS of all publishers in one

_STRING = "tag:yaml.org,2002:str"  # the tag !!str
#: The loader in C, if PyYAML was built with it.
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class YamlError(ValueError):
    """A file that is not valid YAML, or that contains something that is refused."""


class _Loader(_SafeLoader):
    """Refuses duplicate keys, of which PyYAML silently takes the last."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        lines: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise YamlError(f"line {line} has a key that is not text")
            if key.value in lines:
                raise YamlError(
                    f"duplicate key {key.value!r} in lines {lines[key.value]} and {line}"
                )
            lines[key.value] = line
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping


def load(path: Path) -> Any:
    """The document in a file: dictionaries, lists and plain values.

    Raises:
        OSError: The file cannot be read or is too large.
        YamlError: It is not valid YAML, or it has an alias, too many levels, a value that is too
            long, or a duplicate key.
    """
    data = read(path, MAX_BYTES)
    try:
        text = data.decode("utf-8")
        for _ in _checked(text):
            pass
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except YamlError:
        raise
    except Exception as error:  # a tag that does not fit its text may raise anything
        raise YamlError(" ".join(str(error).split())) from error


@dataclass(frozen=True)
class Scalar:
    """A text, its line, and whether it is quoted or tagged as a string."""

    text: str
    line: int
    is_string: bool


@dataclass(frozen=True)
class Sequence:
    """A list and its line."""

    elements: "tuple[Node, ...]"
    line: int


@dataclass(frozen=True)
class Mapping:
    """Keys and values in their order, repeated keys too, and the line of the first."""

    items: "tuple[tuple[Scalar, Node], ...]"
    line: int


Node = Scalar | Sequence | Mapping


def nodes(path: Path) -> list[Node]:
    """The documents in a file, without a type of any value.

    Raises:
        OSError: The file cannot be read or is too large.
        YamlError: As `documents`.
    """
    return documents(read(path, MAX_BYTES))


def documents(data: bytes) -> list[Node]:
    """The documents in a text, without a type of any value.

    Raises:
        YamlError: It is not valid YAML, or it has an alias, too many levels, a value that is too
            long, or a key that is not text.
    """
    try:
        events = _checked(data.decode("utf-8"))
        return [
            _node(next(events), events)
            for event in events
            if isinstance(event, yaml.DocumentStartEvent)
        ]
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise YamlError(" ".join(str(error).split())) from error


def _node(event: Any, events: Iterator[Any]) -> Node:
    """What begins with an event."""
    line = event.start_mark.line + 1
    if isinstance(event, yaml.SequenceStartEvent):
        elements = []
        while not isinstance(event := next(events), yaml.SequenceEndEvent):
            elements.append(_node(event, events))
        return Sequence(tuple(elements), line)
    if isinstance(event, yaml.MappingStartEvent):
        items = []
        while not isinstance(event := next(events), yaml.MappingEndEvent):
            key = _node(event, events)
            if not isinstance(key, Scalar):
                raise YamlError(f"line {key.line} has a key that is not text")
            items.append((key, _node(next(events), events)))
        return Mapping(tuple(items), line)
    is_string = event.style in ("'", '"') or event.tag == _STRING
    return Scalar(event.value, line, is_string)


def _checked(text: str) -> Iterator[Any]:
    """The events of a document, each checked before any object is made from it."""
    depth = 0
    for event in yaml.parse(text, Loader=_SafeLoader):
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            raise YamlError(f"line {line} has an alias, *{event.anchor}")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > MAX_TEXT:
            raise YamlError(
                f"line {line} has a value of {len(event.value)} characters, more than {MAX_TEXT}"
            )
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                raise YamlError(f"line {line} has more than {MAX_DEPTH} levels")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        yield event
