"""Recordings as recorders leave them behind: all is read, or what mends them is told."""

import shutil
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml
from backports import zstd

from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import BagError, encode
from insdvl.recordings.messages import imu_message, twist_message
from insdvl.recordings.parameters import ReplayParameters
from insdvl.studies.replay.fold import read

COUNT = 40
MAGIC = b"\x89MCAP0\r\n"


def write(path: Path, storage: str = "mcap") -> Path:
    """A recording; its one file."""
    with BagWriter(path, storage) as bag:
        for k in range(COUNT):
            stamp = (k + 1) * 10_000_000
            f = np.array([0.0, 0.0, 9.8])
            bag.write(encode("/imu", stamp, imu_message(stamp, "imu", f, np.zeros(3))))
            if k % 10 == 0:
                bag.write(encode("/dvl", stamp, twist_message(stamp, "dvl", np.ones(3))))
    return next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))


def counted(path: Path) -> tuple[int, int, list[str]]:
    """Numbers of messages on both topics, as they are read, and the remarks."""
    with BagReader(path) as bag:
        sizes = [sum(1 for _ in bag.messages([topic])) for topic in ("/imu", "/dvl")]
        assert sizes == [bag.topics["/imu"].size, bag.topics["/dvl"].size]
        return sizes[0], sizes[1], bag.remarks


def said(path: Path) -> str:
    with pytest.raises(BagError) as refused:
        BagReader(path)
    assert str(path) in str(refused.value)
    return str(refused.value)


# ---------------------------------------------------------------- read


def records(data: bytes) -> list[tuple[int, bytes]]:
    """Opcodes and contents of the records of an MCAP file."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        size = struct.unpack_from("<Q", data, at + 1)[0]
        found.append((data[at], data[at + 9 : at + 9 + size]))
        at += 9 + size
    return found


def record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + struct.pack("<Q", len(content)) + content


def without_message_index(data: bytes) -> bytes:
    """An MCAP file with an index of its chunks, but none of their messages."""
    out, summary, moved = bytearray(MAGIC), 0, {}
    at = len(MAGIC)
    for opcode, content in records(data):
        start = at
        at += 9 + len(content)
        if opcode == 0x07:  # message index
            continue
        if opcode == 0x06:  # chunk
            moved[start] = len(out)
        if opcode == 0x0F:  # data end
            out += record(opcode, content)
            summary = len(out)
            continue
        if opcode == 0x08:  # chunk index
            first, last, offset, length = struct.unpack_from("<QQQQ", content)
            size = struct.unpack_from("<I", content, 32)[0]
            rest = content[36 + size + 8 :]
            content = struct.pack("<QQQQ", first, last, moved[offset], length)
            content += struct.pack("<I", 0) + struct.pack("<Q", 0) + rest
        if opcode == 0x0E:  # summary offset
            continue
        if opcode == 0x02:  # footer
            content = struct.pack("<QQI", summary, 0, 0)
        out += record(opcode, content)
    return bytes(out + MAGIC)


def test_chunks_without_an_index_of_their_messages_are_read(tmp_path: Path) -> None:
    file = write(tmp_path / "bag")
    file.write_bytes(without_message_index(file.read_bytes()))
    assert counted(file) == (COUNT, 4, [])
    assert counted(tmp_path / "bag") == (COUNT, 4, [])


def test_a_channel_of_another_encoding_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as a JSON schema, by a program that records beside ROS."""
    file = write(tmp_path / "bag")
    data = file.read_bytes()

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    schema = struct.pack("<H", 99) + text("tool.State") + text("jsonschema") + text("{}")
    channel = struct.pack("<HH", 99, 99) + text("/tool") + text("json") + struct.pack("<I", 0)
    summary = struct.unpack_from("<Q", data, len(data) - 28)[0]
    footer = record(0x02, struct.pack("<QQI", summary, 0, 0))
    kept = [(o, c) for o, c in records(data[:summary] + MAGIC)]
    begin = MAGIC + b"".join(record(o, c) for o, c in kept)
    rest = [record(o, c) for o, c in records(MAGIC + data[summary:]) if o not in (0x02, 0x0E)]
    file.write_bytes(
        begin + record(3, schema) + record(4, channel) + b"".join(rest) + footer + MAGIC
    )
    imu, dvl, remarks = counted(file)
    assert (imu, dvl) == (COUNT, 4)
    assert remarks == ["topic /tool is left out: it is encoded as json, cdr is read"]
    read(file, ReplayParameters(imu_topic="/imu", dvl_topic="/dvl"))
    assert capsys.readouterr().err == f"{file}: {remarks[0]}\n"


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_counts_in_the_metadata_that_are_too_low_are_said(tmp_path: Path, storage: str) -> None:
    write(tmp_path / "bag", storage)
    path = tmp_path / "bag" / "metadata.yaml"
    document = yaml.safe_load(path.read_text())
    for topic in document["rosbag2_bagfile_information"]["topics_with_message_count"]:
        topic["message_count"] -= 3
    path.write_text(yaml.safe_dump(document))
    imu, dvl, remarks = counted(tmp_path / "bag")
    assert (imu, dvl) == (COUNT, 4)
    assert any(f"of {COUNT - 3} messages on /imu, its files have {COUNT}" in r for r in remarks)
    for topic in document["rosbag2_bagfile_information"]["topics_with_message_count"]:
        topic["message_count"] += 5
    path.write_text(yaml.safe_dump(document))
    with BagReader(tmp_path / "bag") as bag, pytest.raises(BagError, match="incomplete"):
        list(bag.messages(["/imu"]))


# ---------------------------------------------------------------- what mends it


def test_a_database_with_an_unfinished_log_is_refused(tmp_path: Path) -> None:
    """A killed recorder: half of the messages are in the -wal file only."""
    file = write(tmp_path / "bag", "sqlite3")
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        database.execute(
            "INSERT INTO messages SELECT id + 1000, topic_id, timestamp, data FROM messages"
        )
        database.commit()
        shutil.copytree(tmp_path / "bag", tmp_path / "killed")
    killed = tmp_path / "killed" / file.name
    for path in (tmp_path / "killed", killed):
        assert f"{file.name}-wal beside it holds messages" in said(path)
    with closing(sqlite3.connect(killed)) as database:  # what the message says
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    assert counted(killed)[0] == 2 * COUNT


def zstd_file(folder: Path) -> Path:
    file = write(folder / "bag", "sqlite3")
    packed = folder / "bag.db3.zstd"
    packed.write_bytes(zstd.compress(file.read_bytes()))
    return packed


def zstd_without_its_suffix(folder: Path) -> Path:
    return zstd_file(folder).rename(folder / "packed.db3")


def ros_1(folder: Path) -> Path:
    path = folder / "old.bag"
    path.write_bytes(b"#ROSBAG V2.0\nE\x00\x00\x00")
    return path


def killed(folder: Path) -> Path:
    path = folder / "cut.mcap"
    path.write_bytes(write(folder / "bag").read_bytes()[:-200])
    return path


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (zstd_file, "it is compressed: zstd -d {path} -o {folder}/bag.db3"),
        (zstd_without_its_suffix, "it is compressed: zstd -d {path} -o {folder}/plain-packed.db3"),
        (ros_1, "it is a bag of ROS 1: rosbags-convert --src {path} --dst {folder}/old"),
        (killed, "the recorder was killed: mcap recover {path} -o {folder}/cut-recovered.mcap"),
    ],
)
def test_a_file_that_is_near_a_recording_is_named_with_its_remedy(
    make: Callable[[Path], Path], what: str, tmp_path: Path
) -> None:
    path = make(tmp_path)
    assert what.format(path=path, folder=tmp_path) in said(path)


def test_a_folder_with_a_file_that_was_cut_is_told_what_mends_the_file(tmp_path: Path) -> None:
    file = write(tmp_path / "bag")
    file.write_bytes(file.read_bytes()[:-200])
    text = said(tmp_path / "bag")
    mended = file.with_name(f"{file.stem}-recovered.mcap")
    assert f"the recorder was killed: mcap recover {file} -o {mended}" in text


def test_a_folder_without_metadata_is_told_how_to_get_it(tmp_path: Path) -> None:
    file = write(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    text = said(tmp_path / "bag")
    assert f"ros2 bag reindex {tmp_path / 'bag'} writes it, or read {file} alone" in text
    assert counted(file)[0] == COUNT


def test_metadata_without_a_storage_is_told_what_to_write(tmp_path: Path) -> None:
    write(tmp_path / "bag")
    path = tmp_path / "bag" / "metadata.yaml"
    text = path.read_text()
    path.write_text(text.replace("storage_identifier: mcap", "storage_identifier: ''"))
    assert "storage_identifier is empty; write mcap there" in said(tmp_path / "bag")
