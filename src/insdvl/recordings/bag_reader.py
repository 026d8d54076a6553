"""Reading a rosbag2 recording without ROS, sqlite3 and MCAP alike."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, NamedTuple, final

from insdvl.extras import extra
from insdvl.recordings.base import BagError, Raw, Recorded, decode, text_of, typestore
from insdvl.recordings.checks import (
    MAX_MESSAGE_BYTES,
    check_chunks,
    check_database,
    check_folder,
    complete_index,
)
from insdvl.recordings.foreign import STORAGES, files_of, remedy_of_file, remedy_of_folder
from insdvl.recordings.mcap_messages import messages as mcap_messages

with extra("bags"):
    from rosbags.interfaces import Connection, MessageDefinitionFormat
    from rosbags.rosbag2 import Reader
    from rosbags.rosbag2.storage_mcap import McapReader


#: Encoding of the messages of ROS 2.
ENCODING = "cdr"


class RecordedTopic(NamedTuple):
    """A topic of a recording.

    Attributes:
        type: Name of its message type, ``package/msg/Name``.
        size: Number of its messages.
    """

    type: str
    size: int


@final
class BagReader:
    """An open recording; a context manager.

    Attributes:
        path: The folder of the recording, or its one .mcap or .db3 file.
        topics: The topics of the recording by name.
        remarks: What a reader should know of it, each in a sentence.
    """

    def __init__(self, path: Path, begin: float | None = None, end: float | None = None) -> None:
        """Open a recording.

        Args:
            path: The recording.
            begin: Read from this time after its first message on [s]; from there by default.
            end: Read to this time; to the end by default. `topics` are of the whole recording.

        Raises:
            BagError: It does not exist, is damaged, incomplete, empty or not a rosbag2 recording.
        """
        self.path, self._begin, self._end = path, begin, end
        self.remarks: list[str] = []
        if not path.exists():
            raise BagError(f"recording {path} does not exist")
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            remedy = "; ".join(["it has no metadata.yaml", remedy_of_folder(path)]).rstrip("; ")
            raise BagError(f"{path} is not a rosbag2 recording: {remedy}")
        if not path.is_dir() and not (path.is_file() and path.suffix in STORAGES):
            what = remedy_of_file(path) if path.is_file() else ""
            raise BagError(
                f"{path} is not a rosbag2 recording: "
                f"{what or 'neither a folder nor an .mcap or .db3 file'}"
            )
        try:
            with ExitStack() as stack:
                self._reader = self._open(path, stack)
                self._connections = self._read_connections()
                found = self._found()
                stack.pop_all()
        except Exception as error:  # damaged bytes make the parser raise anything
            files = [path] if path.is_file() else files_of(path)
            remedy = "".join(f"; {what}" for file in files if (what := remedy_of_file(file)))
            raise BagError(f"cannot read recording {path}: {text_of(error)}{remedy}") from error
        for name, (types, _) in found.items():
            if len(types) > 1:
                self.close()
                raise BagError(f"topic {name} of {path} has several types: {', '.join(types)}")
        self.topics = {name: RecordedTopic(types[0], size) for name, (types, size) in found.items()}
        if not any(topic.size for topic in self.topics.values()):
            self.close()
            raise BagError(f"recording {path} is empty: it has no messages")

    @staticmethod
    def _open(path: Path, stack: ExitStack) -> Reader:
        """Check a recording and open it; the stack closes it."""
        if path.is_dir():
            check_folder(path)
        elif path.suffix == ".db3":
            check_database(path)
        reader = Reader(path)
        reader.open()
        stack.callback(reader.close)
        for storage in _storages(reader):
            check_chunks(getattr(storage, "chunks", []))
            complete_index(storage)
            if isinstance(storage, McapReader):
                storage.messages = partial(mcap_messages, storage)  # type: ignore[method-assign]
        return reader

    def _read_connections(self) -> list[Connection]:
        """The connections whose messages are read: those of ROS 2's encoding."""
        read = []
        for c in self._reader.connections:
            encoding = getattr(c.ext, "serialization_format", ENCODING)
            if encoding == ENCODING:
                read.append(c)
            else:
                self.remarks.append(
                    f"topic {c.topic} is left out: it is encoded as {encoding}, {ENCODING} is read"
                )
        return read

    def _found(self) -> dict[str, tuple[list[str], int]]:
        """Types of each topic, and the number of its messages by metadata or files, the larger."""
        told: Counter[str] = Counter()
        there: Counter[str] = Counter()
        for c in self._connections:
            told[c.topic] += c.msgcount
        for c in (c for storage in _storages(self._reader) for c in storage.connections):
            there[c.topic] += c.msgcount
        for name in told:
            if told[name] < there[name]:
                self.remarks.append(
                    f"metadata.yaml tells of {told[name]} messages on {name}, its files have "
                    f"{there[name]}: all are read"
                )
        types: dict[str, set[str]] = {}
        for c in self._connections:
            types.setdefault(c.topic, set()).add(c.msgtype)
        return {name: (sorted(types[name]), max(told[name], there[name])) for name in types}

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

    @property
    def duration(self) -> float:
        """Time from the first message to the last, as the recording tells it [s]."""
        return float(self._reader.duration) / 1e9

    def has(self, topic: str, *types: str) -> bool:
        """Whether a topic has messages in the recording.

        Raises:
            BagError: Its type is not one of `types`.
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
        """As `has`, for a topic that is required.

        Raises:
            BagError: The topic has no messages, or another type.
        """
        if not self.has(topic, *types):
            there = ", ".join(sorted(name for name, info in self.topics.items() if info.size))
            raise BagError(f"topic {topic!r} is not in {self.path}; it has {there}")

    def raw(
        self, topics: Collection[str], names: Mapping[str, str] = MappingProxyType({})
    ) -> Iterator[Raw]:
        """The messages of some topics as bytes, in the order in which they were recorded.

        Args:
            topics: Names in the recording.
            names: Other names that the messages are given.

        Raises:
            BagError: The recording is damaged, has fewer messages than its index says, or none in
                the part that is read.
        """
        part = self._part_ns() if (self._begin, self._end) != (None, None) else None
        connections = [c for c in self._connections if c.topic in topics]
        expected = sum(self.topics[name].size for name in {c.topic for c in connections})
        found = within = 0
        if not connections:
            return
        messages = self._reader.messages(connections)
        told = {c.id: (names.get(c.topic, c.topic), c.msgtype, _definition(c)) for c in connections}
        while True:
            try:
                connection, time_ns, data = next(messages)
            except StopIteration:
                break
            except Exception as error:  # damaged bytes make the parser raise anything
                raise BagError(
                    f"recording {self.path} is damaged after {found} messages: {text_of(error)}"
                ) from error
            found += 1
            if len(data) > MAX_MESSAGE_BYTES:
                raise BagError(
                    f"a message on topic {connection.topic} of {self.path} has {len(data)} bytes; "
                    f"at most {MAX_MESSAGE_BYTES} are read"
                )
            if found > expected:
                break
            if part is not None:
                if time_ns > part[1]:
                    found = expected  # messages come in the order of their recording
                    break
                if time_ns < part[0]:
                    continue
            within += 1
            topic, kind, definition = told[connection.id]
            yield Raw(topic, kind, time_ns, bytes(data), definition)
        if found != expected:
            raise BagError(
                f"recording {self.path} is damaged: it has {found} or more messages on "
                f"{', '.join(sorted(topics))}, but its index says {expected}"
                if found > expected
                else f"recording {self.path} is incomplete: {found} of {expected} messages on "
                f"{', '.join(sorted(topics))}"
            )
        if part is not None and not within:
            until = "its end" if self._end is None else f"{self._end:g} s"
            raise BagError(f"nothing is recorded from {self._begin or 0.0:g} s to {until}")

    def _part_ns(self) -> tuple[int, float]:
        """Begin and end of what is read.

        Raises:
            BagError: The recording is damaged.
        """
        try:
            _, first_ns, _ = next(self._reader.messages(self._connections))
        except Exception as error:  # damaged bytes make the parser raise anything
            raise BagError(f"recording {self.path} is damaged: {text_of(error)}") from error
        end_ns = math.inf if self._end is None else first_ns + round(self._end * 1e9)
        return first_ns + round((self._begin or 0.0) * 1e9), end_ns

    def messages(self, topics: Collection[str]) -> Iterator[Recorded]:
        """The messages of some topics, in the order in which they were recorded.

        Raises:
            BagError: The recording or one of the messages is damaged.
        """
        return map(decode, self.raw(topics))


def _storages(reader: Reader) -> list[Any]:
    """The files of an open recording."""
    return list(getattr(reader.storage, "storages", [reader.storage]))


def _definition(connection: Connection) -> str:
    """The definition of a type that is not a standard one; empty where the recording has none."""
    if connection.msgtype in typestore().fielddefs:
        return ""
    form, text = connection.msgdef
    return str(text) if form is MessageDefinitionFormat.MSG else ""
