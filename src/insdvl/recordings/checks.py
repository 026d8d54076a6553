"""Checks of a recording before and while `rosbags` reads it.

That library trusts what a file says about itself. A few damaged or malicious bytes could make it
decompress without end, follow a table that leads to itself, or run a query that never ends. No
recorder writes what is refused here.
"""

import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote

from insdvl import yaml_files
from insdvl.extras import extra
from insdvl.files import shown
from insdvl.recordings.foreign import STORAGES, unfinished_log
from insdvl.yaml_files import YamlError

with extra("bags"):
    import lz4.frame
    from rosbags.rosbag2 import storage_mcap

#: Limit of an MCAP chunk, decompressed. A recorder closes a chunk at some megabytes, and a message
#: of our topics has less than a kilobyte.
MAX_CHUNK_BYTES = 64 * 2**20
#: Limit of all chunks, decompressed, with messages of one moment: they are in memory together.
MAX_OPEN_BYTES = 256 * 2**20
#: Limit of one message. An Odometry with long frame names has a kilobyte.
MAX_MESSAGE_BYTES = 2**20
#: Limit of the tables and indices of a database; rosbag2 makes less than ten.
MAX_TABLES = 50


class UnfitError(ValueError):
    """A file of a recording is not safe to read; the message says why."""


# ---------------------------------------------------------------- metadata.yaml


def check_folder(path: Path) -> None:
    """Check the metadata of a recording's folder, and the files that it names.

    What is missing or has another type is left to rosbags, which reports it.

    Raises:
        UnfitError: `yaml_files.load` refuses the metadata, files or messages are compressed, or a
            file is not safe to read.
    """
    try:
        document = yaml_files.load(path / "metadata.yaml")
    except (OSError, YamlError) as error:
        raise UnfitError(f"metadata.yaml: {error}") from error
    information = document.get("rosbag2_bagfile_information") if type(document) is dict else None
    if type(information) is not dict:
        return
    mode = information.get("compression_mode")
    if mode and str(mode).lower() != "none":
        raise UnfitError(
            f"its compression_mode is {shown(mode)}; only the chunks of MCAP may be compressed "
            "(convert it with `ros2 bag convert`)"
        )
    names = information.get("relative_file_paths")
    storage = information.get("storage_identifier")
    if storage == "" and type(names) is list:
        by_suffix = sorted({STORAGES.get(PurePath(str(name)).suffix, "") for name in names} - {""})
        raise UnfitError(
            f"metadata.yaml: storage_identifier is empty; write {' or '.join(by_suffix)} there"
        )
    for name in names if type(names) is list else []:
        file = path / PurePath(str(name)).name  # where rosbags looks for it
        if not file.exists():
            continue
        if not file.is_file():
            raise UnfitError(f"{file.name} is not a regular file")
        if storage == "sqlite3":
            check_database(file)


# ---------------------------------------------------------------- MCAP


def _bounded(new: Callable[[], Any]) -> Callable[[bytes, int], bytes]:
    """A decompressor that stops at the declared size of the chunk."""

    def decompress(data: bytes, size: int) -> bytes:
        if size > MAX_CHUNK_BYTES:
            raise UnfitError(f"a chunk has {size} bytes; at most {MAX_CHUNK_BYTES} are read")
        parts, left = [], size + 1  # one more, so that a chunk that is too long is detected
        while data and left > 0:
            frame = new()
            part = frame.decompress(data, max_length=left)
            parts.append(part)
            left -= len(part)
            if not frame.eof:  # the frame is cut, or longer than declared
                break
            data = frame.unused_data or b""
        return b"".join(parts)

    return decompress


# rosbags refuses a whole file for one channel of an encoding that it does not know. Such a channel
# is left out by `BagReader`.
_get_msgdef = storage_mcap.get_msgdef


def _definition(schema: storage_mcap.Schema | None) -> Any:
    try:
        return _get_msgdef(schema)
    except KeyError:
        return _get_msgdef(None)


storage_mcap.get_msgdef = _definition


# rosbags passes the declared size to its decompressors, which ignore it, and checks it afterwards.
storage_mcap.DECOMPRESSORS.update(
    zstd=_bounded(storage_mcap.zstd.ZstdDecompressor),
    lz4=_bounded(lz4.frame.LZ4FrameDecompressor),
)


def check_chunks(chunks: Iterable[storage_mcap.ChunkInfo]) -> None:
    """Check the index of chunks of an open MCAP file.

    Raises:
        UnfitError: Chunks are too large or overlap in the file, or too many have messages of one
            moment.
    """
    ordered = sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)
    for before, after in pairwise(ordered):
        if before.chunk_start_offset + before.chunk_length > after.chunk_start_offset:
            raise UnfitError(
                f"chunks at {before.chunk_start_offset} and {after.chunk_start_offset} overlap"
            )
    for chunk in ordered:
        if chunk.message_end_time < chunk.message_start_time:
            raise UnfitError(f"the chunk at {chunk.chunk_start_offset} ends before it begins")
    # A chunk is opened at its first stamp and closed at its last one.
    changes = [(chunk.message_start_time, 0, chunk.uncompressed_size) for chunk in ordered]
    changes += [(chunk.message_end_time, 1, -chunk.uncompressed_size) for chunk in ordered]
    size = 0
    for time_ns, _, change in sorted(changes):
        size += change
        if size > MAX_OPEN_BYTES:
            raise UnfitError(
                f"the chunks with messages of {time_ns} ns have {size} bytes together; at most "
                f"{MAX_OPEN_BYTES} are read"
            )


def complete_index(storage: Any) -> None:
    """Read chunks that have no index of their messages, which some recorders leave out.

    rosbags takes them for empty. Their messages are counted by reading the file once.
    """
    unindexed = [c for c in getattr(storage, "chunks", []) if not c.message_index_offsets]
    if not unindexed:
        return
    for chunk in unindexed:  # any channel may be in it
        chunk.channel_count.update({c.id: 1 for c in storage.connections})
    storage.meta_scan()
    counts = storage.statistics.channel_message_counts
    storage.connections = [c._replace(msgcount=counts.get(c.id, 0)) for c in storage.connections]


# ---------------------------------------------------------------- sqlite3


def check_database(path: Path) -> None:
    """Check that a database is intact, and that reading it executes nothing that is stored in it.

    Views, triggers, virtual tables and generated columns are queries and functions that a file
    contains.

    Raises:
        UnfitError: The file is not a database, is damaged, has any of these, or not all messages.
    """
    if log := unfinished_log(path):
        raise UnfitError(log)
    try:
        with closing(
            sqlite3.connect(f"file:{quote(str(path))}?mode=ro&immutable=1", uri=True)
        ) as database:
            database.execute("PRAGMA trusted_schema = OFF")
            database.execute("PRAGMA ignore_check_constraints = ON")
            objects = database.execute(
                "SELECT name, sql FROM sqlite_master LIMIT ?", (MAX_TABLES + 1,)
            ).fetchall()
            if len(objects) > MAX_TABLES:
                raise UnfitError(f"it has more than {MAX_TABLES} tables and indices")
            for name, sql in objects:
                _check_object(database, name, sql)
            # This also finds a page that is used twice: a tree that leads to itself has no end.
            ((verdict,),) = database.execute("PRAGMA quick_check(1)").fetchall()
            if verdict != "ok":
                raise UnfitError(f"it is damaged: {shown(verdict)}")
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise UnfitError(str(error)) from error


def _check_object(database: sqlite3.Connection, name: str, sql: str | None) -> None:
    # By the SQL text, as sqlite does; an index of sqlite's own has none.
    if sql is None or sql.startswith(("CREATE INDEX ", "CREATE UNIQUE INDEX ")):
        return
    if not sql.startswith("CREATE TABLE "):
        raise UnfitError(f"only plain tables and indices are read; {shown(name)} is neither")
    columns = database.execute("SELECT name, hidden FROM pragma_table_xinfo(?)", (name,))
    for column, hidden in columns.fetchall():
        if hidden:
            raise UnfitError(f"column {shown(column)} of table {shown(name)} is generated")
