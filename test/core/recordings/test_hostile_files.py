"""Whatever is in a file: a good result, or the reader's own error, in bounded memory and time."""

import hashlib
import io
import json
import os
import resource
import signal
import sqlite3
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, storage_mcap

from insdvl import files, yaml_files
from insdvl.jobs.store import MAX_RESULT_BYTES, read_result
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError
from insdvl.parameters.sections import load_section
from insdvl.recordings import checks as bag_checks
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import BagError, encode, typestore
from insdvl.recordings.messages import imu_message, twist_message
from insdvl.simulation.noise import from_file
from insdvl.studies.faults import page
from insdvl.studies.results.command import documents
from insdvl.tuner.forest import MAX_BYTES, Forest, ForestError
from insdvl.tuner.models import MAX_WINDOW, ModelError, load_model
from insdvl.tuner.network import Network, NetworkError

ROOT = Path(__file__).parents[3]
RELIABILITY = ROOT / "docs" / "reliability"
MB = 2**20
LONG = pytest.mark.long


@pytest.fixture(autouse=True)
def _ends() -> Iterator[None]:
    """A reader that never ends fails its test, and does not stop all of them."""

    def late(*_: Any) -> None:
        raise TimeoutError("the reader does not end")

    previous = signal.signal(signal.SIGALRM, late)
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, previous)


@contextmanager
def at_most(size: int) -> Iterator[None]:
    """What is done inside takes no more memory at any time [bytes]."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < size


def resident() -> int:
    """Most memory that this process has had so far [bytes].

    What is asked for and never written to, as rosbags does for a record of a wrong size, is none.
    """
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


# ---------------------------------------------------------------- good files


def write_bag(path: Path, storage: str, count: int = 30) -> Path:
    with BagWriter(path, storage) as bag:
        for k in range(count):
            f, w = np.random.default_rng(k).standard_normal((2, 3))
            bag.write(encode("/imu", k, imu_message(k, "imu", f, w)))
            if k % 10 == 0:
                bag.write(encode("/dvl", k, twist_message(k, "dvl", f)))
    return path


def write_compressed(path: Path, kind: CompressionFormat) -> Path:
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, kind)
    with writer:
        raw = encode("/imu", 0, imu_message(0, "imu", np.zeros(3), np.zeros(3)))
        connection = writer.add_connection(raw.topic, raw.type, typestore=typestore())
        for k in range(30):
            writer.write(connection, k, raw.data)
    return path


def read_bag(path: Path) -> None:
    with BagReader(path) as bag:
        for _ in bag.messages(bag.topics):
            pass


def npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


TREES = {
    "feature": np.array([0, -1, 1, -1, -1, -1], np.int16),
    "threshold": np.array([0.5, 0.25], np.float32),
    "value": np.array([1.0, 2.0, 3.0, 4.0]),
    "roots": np.array([0, 5], np.int32),
    "n_features": np.array(2, np.int32),
}
PARAMETERS = """
/**/insdvl_filter:
  ros__parameters:
    frame_convention: ned
    max_delay: 3.0
    dvl:
      lever_arm: [0.1, 0.0, -0.2]
      bias_model: "gauss_markov"
    gate.enabled: false
"""
PROFILE = "# noise\n0, 1, 1, 1, 2, 2, 2\n10.5, 0.1, 0.1, 0.1, 0.2, 0.2, 0.2\n"


@dataclass(frozen=True)
class Reader:
    """A reader of files.

    Attributes:
        good: Writes a good file in a folder, and gives its path.
        read: Reads what is in a folder.
        error: The one that it may raise; None where it may raise none.
        count: Of damaged files.
    """

    good: Callable[[Path], Path]
    read: Callable[[Path], Any]
    error: type[Exception] | None
    count: int = 150


def written(name: str, data: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return write


def model(folder: Path, data: bytes, **card: Any) -> Path:
    """A model's card for its bytes, of the kind of the shipped one of trees."""
    shipped = json.loads((ROOT / "models" / "default.json").read_text())
    shipped |= {"sha256": hashlib.sha256(data).hexdigest(), **card}
    (folder / "model.npz").write_bytes(data)
    (folder / "model.json").write_text(json.dumps(shipped))
    return folder / "model.json"


def storage(kind: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        suffix = {"mcap": ".mcap", "sqlite3": ".db3"}[kind]
        return next(write_bag(folder / "bag", kind).glob(f"*{suffix}"))

    return write


def load_altered(folder: Path) -> None:
    """A model whose card goes with its bytes, whatever they are."""
    model(folder, (folder / "model.npz").read_bytes())
    load_model(str(folder / "model.npz"))


READERS = {
    "parameters": Reader(
        written("file.yaml", PARAMETERS.encode()),
        lambda folder: load_section(folder / "file.yaml", "insdvl_filter", FilterParameters),
        ParameterError,
    ),
    "noise profile": Reader(
        written("file.csv", PROFILE.encode()),
        lambda folder: from_file(folder / "file.csv"),
        ValueError,
    ),
    "trees": Reader(
        written("file.npz", npz(**TREES)),
        lambda folder: Forest.load((folder / "file.npz").read_bytes()).predict(np.zeros((2, 2))),
        ForestError,
        300,
    ),
    "model": Reader(
        written("model.npz", (ROOT / "models" / "default.npz").read_bytes()),
        load_altered,
        ModelError,
    ),
    "card": Reader(
        lambda folder: model(folder, (ROOT / "models" / "default.npz").read_bytes()),
        lambda folder: load_model(str(folder / "model.npz")),
        ModelError,
    ),
    "result": Reader(
        written("file.npz", npz(**TREES)), lambda folder: read_result(folder / "file.npz"), None
    ),
    "page of faults": Reader(
        written("messages.json", (RELIABILITY / "messages.json").read_bytes()),
        page.documents,
        ValueError,
        60,
    ),
    "page of the soak": Reader(
        written("soak.json", (RELIABILITY / "soak.json").read_bytes()), page.documents, ValueError
    ),
    "page of results": Reader(
        written("window.json", (ROOT / "docs" / "results" / "window.json").read_bytes()),
        documents,
        ValueError,
    ),
    "mcap": Reader(storage("mcap"), lambda folder: read_bag(folder / "bag"), BagError),
    "mcap alone": Reader(
        storage("mcap"), lambda folder: read_bag(next(folder.glob("bag/*.mcap"))), BagError
    ),
    "mcap zstd": Reader(
        lambda folder: next(
            write_compressed(folder / "bag", CompressionFormat.ZSTD).glob("*.mcap")
        ),
        lambda folder: read_bag(folder / "bag"),
        BagError,
    ),
    "sqlite3": Reader(storage("sqlite3"), lambda folder: read_bag(folder / "bag"), BagError),
    "sqlite3 alone": Reader(
        storage("sqlite3"), lambda folder: read_bag(next(folder.glob("bag/*.db3"))), BagError
    ),
    "metadata": Reader(
        lambda folder: write_bag(folder / "bag", "mcap") / "metadata.yaml",
        lambda folder: read_bag(folder / "bag"),
        BagError,
        60,
    ),
}


def damaged(good: bytes, rng: np.random.Generator) -> bytes:
    """A good file with one kind of damage."""
    data = bytearray(good)
    start = int(rng.integers(len(data)))
    length = int(min(rng.geometric(0.05), len(data) - start))
    kind = rng.integers(6)
    if kind == 0:
        data[start] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        data[start : start + length] = rng.bytes(length)
    elif kind == 2:
        del data[start:]
    elif kind == 3:
        del data[start : start + length]
    elif kind == 4:
        data[start:start] = rng.bytes(length)
    else:  # large numbers
        data[start : start + 8] = b"\xff" * 7 + b"\x7f"
    return bytes(data)


@pytest.mark.parametrize("share", [0.3, pytest.param(1.0, marks=LONG)])
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused(
    name: str, share: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reader = READERS[name]
    count = round(share * reader.count)
    path = reader.good(tmp_path)
    reader.read(tmp_path)
    good = path.read_bytes()
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    refused = 0
    before = resident()
    for _ in range(count):
        path.write_bytes(damaged(good, rng))
        try:
            reader.read(tmp_path)
        except Exception as error:
            assert type(error) is reader.error, repr(error)
            assert len(str(error)) < 2000
            refused += 1
    assert resident() - before < 100 * MB
    assert refused > count / 10 or reader.error is None


def test_a_damaged_network_is_run_or_refused() -> None:
    pytest.importorskip("onnxruntime")
    good = (ROOT / "models" / "dnn.onnx").read_bytes()
    rng = np.random.default_rng(5)
    refused = 0
    for _ in range(100):
        try:
            network = Network.load(damaged(good, rng))
            network.predict(np.ones((1, network.n_features)))
        except Exception as error:
            # An answer that is not finite is the row's, and no error of the file.
            assert type(error) is NetworkError or "the network's output" in str(error), repr(error)
            refused += 1
    assert refused > 10


# ---------------------------------------------------------------- large files


@pytest.mark.parametrize("name", sorted(READERS.keys() - {"result"}))
def test_what_never_ends_is_no_file(name: str, tmp_path: Path) -> None:
    reader = READERS[name]
    path = reader.good(tmp_path)
    path.unlink()
    if name in ("trees", "model"):  # their bytes come from load_model
        card = model(tmp_path, b"")
        (tmp_path / "model.npz").unlink()
        os.mkfifo(tmp_path / "model.npz")
        with pytest.raises(ModelError, match=f"{card.with_suffix('.npz')}: not a regular file"):
            load_model(str(card.with_suffix(".npz")))
    else:
        os.mkfifo(path)
        with pytest.raises(reader.error or AssertionError):
            reader.read(tmp_path)


PAGES = ("page of faults", "page of the soak", "page of results")


@pytest.mark.parametrize("name", ["parameters", "noise profile", "card", "metadata", *PAGES])
def test_a_huge_file_is_refused_before_it_is_read(name: str, tmp_path: Path) -> None:
    reader = READERS[name]
    path = reader.good(tmp_path)
    os.truncate(path, 10**12)  # takes no room on the disk
    with (
        at_most(20 * MB),
        pytest.raises(
            reader.error or AssertionError, match=rf"{10**12} bytes, more than the limit"
        ),
    ):
        reader.read(tmp_path)


def test_a_huge_model_is_refused_before_it_is_read(tmp_path: Path) -> None:
    for suffix, kind in (".npz", "forest"), (".onnx", "network"):
        card = model(tmp_path, b"", kind=kind)
        with open(card.with_suffix(suffix), "wb") as file:
            file.truncate(10**12)
        with (
            at_most(100 * MB),
            pytest.raises(ModelError, match=f"{10**12} bytes, more than the limit of {MAX_BYTES}"),
        ):
            load_model(str(card.with_suffix(suffix)))


def test_a_kept_result_that_never_ends_or_is_huge_is_computed_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "file.npz"
    os.mkfifo(path)
    assert read_result(path) is None
    assert f"{path} is damaged (" in capsys.readouterr().err
    path.unlink()
    with path.open("wb") as file:
        file.truncate(10**12)
    with at_most(20 * MB):
        assert read_result(path) is None
    assert f"more than the limit of {MAX_RESULT_BYTES}" in capsys.readouterr().err


# ---------------------------------------------------------------- numbers of the pages


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is not valid JSON: Expecting value"),
        (b"[]", "is not a JSON object"),
        (b"\xff\xfe", "is not valid JSON: 'utf-8' codec"),
        (b"[" * 100_000, "is not valid JSON: maximum recursion depth"),
        (b'{"rows": [NaN]}', "is not valid JSON: NaN is not allowed"),
        (b"{}", "does not have the content that the page needs: KeyError"),
        (
            b'{"rows": 1, "rate_factor": 1, "search": 1, "environment": {}}',
            "does not have the content that the page needs",
        ),
    ],
)
def test_numbers_that_no_page_can_be_made_of_are_named(
    name: str, content: bytes, expected: str, tmp_path: Path
) -> None:
    reader = READERS[name]
    path = reader.good(tmp_path)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=f"{path} {expected}"):
        reader.read(tmp_path)


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def made_a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize(
    ("damaged", "expected"),
    [
        (cut, "{path} is not valid JSON"),
        (made_a_pipe, "^cannot read {path}: not a regular file$"),
    ],
)
def test_numbers_that_are_not_whole_are_named(
    name: str, damaged: Callable[[Path], None], expected: str, tmp_path: Path
) -> None:
    reader = READERS[name]
    path = reader.good(tmp_path)
    damaged(path)
    with pytest.raises(ValueError, match=expected.format(path=path)):
        reader.read(tmp_path)


# ---------------------------------------------------------------- YAML


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", "line 2 has an alias, *a"),
        ("a: " + "[" * 60 + "]" * 60, "line 1 has more than 50 levels"),
        ("a: " + "[" * 100_000, "line 1 has more than 50 levels"),
        ("- " * 100_000, "line 1 has more than 50 levels"),
        ("a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\n", "duplicate key 'c' in lines 3 and 5"),
        ("a: 1\n'a': 1\n", "duplicate key 'a' in lines 1 and 2"),
        ("{[a]: 1}", "line 1 has a key that is not text"),
        ("a: " + "9" * 70_000, "line 1 has a value of 70000 characters"),
        ("a: 2001-99-99", "month must be in 1..12"),
        ("a: !!int b", "invalid literal"),
        ("a: !!python/object/apply:os.mkdir [executed]", "could not determine a constructor"),
        ("a: !!python/name:os.system", "could not determine a constructor"),
        ("a: \x07", "unacceptable character|control characters"),
        ("--- 1\n--- 2\n", "expected a single document"),
    ],
)
def test_what_is_no_plain_data_is_refused(
    text: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "file.yaml"
    path.write_text(text)
    with at_most(20 * MB), pytest.raises(yaml_files.YamlError, match=expected.replace("*", r"\*")):
        yaml_files.load(path)
    for read in READERS["parameters"].read, lambda folder: read_bag(folder / "bag"):
        write_bag(tmp_path / "bag", "mcap") if not (tmp_path / "bag").exists() else None
        (tmp_path / "bag" / "metadata.yaml").write_text(text)
        with pytest.raises((ParameterError, BagError), match=r"file\.yaml|bag"):
            read(tmp_path)
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize("limit", [2**16, pytest.param(yaml_files.MAX_BYTES, marks=LONG)])
def test_a_file_of_parameters_as_large_as_allowed_is_read(
    limit: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(yaml_files, "MAX_BYTES", limit)
    count = limit // 70
    lines = [f"/**/node_{k}: {{ros__parameters: {{gain: {k}.5}}}}\n" for k in range(count)]
    text = "".join(lines) + PARAMETERS
    assert 0.5 * yaml_files.MAX_BYTES < len(text) < yaml_files.MAX_BYTES
    (tmp_path / "file.yaml").write_text(text)
    loaded = load_section(tmp_path / "file.yaml", "insdvl_filter", FilterParameters)
    assert loaded.max_delay == 3.0


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("{max_delay: " + "[1.0, " * 40 + "]" * 40 + "}", "'max_delay' in line 1 has lists"),
        ("{max_delay: [" + "1.0, " * 9999 + "]}", r"\(\d+ characters\)"),
        (
            "{process_noise: {adaptive_window: 0x" + "f" * 5000 + "}}",
            "must be an int, got '0xfff",
        ),
        ('{odom_frame: "a\\0b"}', "'odom_frame' must not contain NUL"),
        ("{max_delay: 1.0e+999}", "'max_delay' must be a float, got '1.0e"),
        ("{max_delay: 2001-01-01}", r"'max_delay' must be a float, got '2001-"),
        ("{dvl: {mount: []}}", "'dvl.mount' must be 3 values"),
        ("{dvl.noise_std: [0.1, 0.1, 0.1], dvl: {noise_std: [0.2, 0.2, 0.2]}}", "given again"),
        ("{dvl: 1.0}", "unknown parameter 'dvl'"),
        ("{imu: null}", "unknown parameter 'imu'"),
    ],
)
def test_a_wrong_value_is_told_in_one_short_line(
    section: str, expected: str, tmp_path: Path
) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(f"/**/insdvl_filter: {{ros__parameters: {section}}}\n")
    with pytest.raises(ParameterError, match=expected) as caught:
        load_section(path, "insdvl_filter", FilterParameters)
    assert len(str(caught.value)) < 600


# ---------------------------------------------------------------- models


class Executed:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def test_an_array_of_objects_is_refused_and_runs_nothing(tmp_path: Path) -> None:
    data = npz(**{**TREES, "value": np.array([Executed(tmp_path / "executed")], dtype=object)})
    with pytest.raises(ForestError, match="an array holds Python objects"):
        Forest.load(data)
    model(tmp_path, data)
    with pytest.raises(ModelError, match="an array holds Python objects"):
        load_model(str(tmp_path / "model.npz"))
    assert not (tmp_path / "executed").exists()


def test_an_archive_that_unpacks_to_more_than_allowed_is_refused() -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (9 * MB,)}
    )
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("value.npy", "w") as file,
    ):
        file.write(header.getvalue())
        for _ in range(72):
            file.write(bytes(MB))
    data = buffer.getvalue()
    assert len(data) < MB
    with at_most(10 * MB), pytest.raises(ForestError, match=rf"more than the limit of {MAX_BYTES}"):
        Forest.load(data)
    # One that says that it is small ends where it says.
    sizes = struct.pack("<I", len(header.getvalue()) + 72 * MB)
    assert data.count(sizes) >= 1
    with at_most(10 * MB), pytest.raises(ForestError, match="not a valid .npz archive"):
        Forest.load(data.replace(sizes, struct.pack("<I", 1000)))


@pytest.mark.parametrize("shape", [(10**15,), (10**9,), (2**62, 4), (-2,)])
def test_a_shape_that_the_bytes_do_not_fill_is_refused(shape: tuple[int, ...]) -> None:
    array = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        array, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("value.npy", array.getvalue() + bytes(80))
    with at_most(MB), pytest.raises(ForestError, match="not a valid .npz archive"):
        Forest.load(buffer.getvalue())


@pytest.mark.parametrize(
    ("card", "expected"),
    [
        ("[" * 100_000, "is not valid JSON"),
        ("1" * 10_000, "is not valid JSON"),
        ('"' + "a" * 500_000 + '"', "is not a JSON object"),
        (json.dumps({"name": ["a" * 500_000]}), r"name must be of type str, got .*characters"),
        ("\ufeff{}", "is not valid JSON"),
    ],
)
def test_a_card_that_is_none_is_named(card: str, expected: str, tmp_path: Path) -> None:
    model(tmp_path, npz(**TREES)).write_text(card)
    with pytest.raises(ModelError, match=rf"model\.json.* {expected}") as caught:
        load_model(str(tmp_path / "model.npz"))
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("window", [-5, 0, MAX_WINDOW + 1, 10**30])
def test_a_window_that_no_tuner_can_use_is_refused(window: int, tmp_path: Path) -> None:
    model(tmp_path, npz(**TREES), window=window)
    with pytest.raises(ModelError, match=f"window must be >= .* <= {MAX_WINDOW}, got {window}"):
        load_model(str(tmp_path / "model.npz"))


# ---------------------------------------------------------------- recordings


@pytest.mark.parametrize("kind", [CompressionFormat.ZSTD])
def test_compressed_chunks_are_read(kind: CompressionFormat, tmp_path: Path) -> None:
    write_compressed(tmp_path / "bag", kind)
    with BagReader(tmp_path / "bag") as bag:
        assert len(list(bag.messages(bag.topics))) == 30


PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": storage_mcap.zstd.compress,
    "lz4": lz4.frame.compress,
}


@pytest.mark.parametrize("compression", PACKERS)
def test_a_chunk_is_unpacked_to_its_size_and_no_further(compression: str) -> None:
    pack, unpack = PACKERS[compression], storage_mcap.DECOMPRESSORS[compression]
    data = np.random.default_rng(0).bytes(MB)
    packed = pack(data[:1000]) + pack(data[1000:])  # a chunk may be in several frames
    assert unpack(packed, MB) == data
    bomb = pack(bytes(100 * MB))
    with at_most(10 * MB):
        assert len(unpack(bomb, MB)) == MB + 1
        assert len(unpack(bomb * 10, 0)) == 1
    assert len(unpack(packed[:-10], MB)) <= MB
    with pytest.raises(bag_checks.UnfitError, match="a chunk has 10000000000 bytes; at most"):
        unpack(bomb, 10**10)


def mcap(chunk: bytes, size: int, compression: str) -> bytes:
    """A file of one chunk."""

    def record(op: int, body: bytes) -> bytes:
        return struct.pack("<BQ", op, len(body)) + body

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    magic = b"\x89MCAP0\r\n"
    body = struct.pack("<QQQI", 0, 0, size, 0) + text(compression.encode())
    body += struct.pack("<Q", len(chunk)) + chunk
    header = record(1, text(b"ros2") + text(b""))
    return magic + header + record(6, body) + record(2, bytes(20)) + magic


@pytest.mark.parametrize("compression", PACKERS)
@pytest.mark.parametrize("size", [0, 1000, 10**15])
def test_a_chunk_that_unpacks_to_another_size_is_refused(
    compression: str, size: int, tmp_path: Path
) -> None:
    bomb = PACKERS[compression](bytes(100 * MB))
    (tmp_path / "bag.mcap").write_bytes(mcap(bomb, size, compression))
    with at_most(20 * MB), pytest.raises(BagError, match=r"bag\.mcap.*[Cc]hunk"):
        read_bag(tmp_path / "bag.mcap")


def chunk(start: int, length: int, first: int, last: int, size: int) -> storage_mcap.ChunkInfo:
    return storage_mcap.ChunkInfo(first, last, start, length, {}, 0, "", length, size, {})


def test_an_index_that_opens_more_than_the_file_has_is_refused() -> None:
    size = bag_checks.MAX_OPEN_BYTES // 4
    in_turn = [chunk(100 * k, 100, 10 * k, 10 * k + 10, size) for k in range(1000)]
    bag_checks.check_chunks(in_turn)
    with pytest.raises(bag_checks.UnfitError, match="chunks at 0 and 99 overlap"):
        bag_checks.check_chunks([in_turn[0], chunk(99, 100, 0, 0, 1)])
    with pytest.raises(bag_checks.UnfitError, match=f"of 7 ns have .* {bag_checks.MAX_OPEN_BYTES}"):
        bag_checks.check_chunks([chunk(100 * k, 100, 7, 9, size) for k in range(5)])


@pytest.mark.parametrize("mode", ["file", "message", "FILE", "{a: b}"])
def test_a_recording_of_compressed_files_or_messages_is_refused(mode: str, tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", "mcap") / "metadata.yaml"
    path.write_text(path.read_text().replace("compression_mode: ''", f"compression_mode: {mode}"))
    with pytest.raises(BagError, match="bag: its compression_mode is .*ros2 bag convert"):
        read_bag(tmp_path / "bag")


DATABASES = {
    "a view that has no end": (
        "CREATE VIEW schema AS WITH RECURSIVE n(schema_version) AS "
        "(SELECT 1 UNION ALL SELECT schema_version + 1 FROM n) "
        "SELECT max(schema_version) AS schema_version FROM n",
        "only plain tables and indices are read; 'schema' is neither",
    ),
    "a trigger": (
        "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM messages; END",
        "only plain tables and indices are read; 't' is neither",
    ),
    "a column of a gigabyte": (
        "ALTER TABLE messages ADD COLUMN huge BLOB AS (zeroblob(1000000000))",
        "column 'huge' of table 'messages' is generated",
    ),
    "many tables": (
        "; ".join(f"CREATE TABLE t{k} (a)" for k in range(60)),
        "it has more than 50 tables and indices",
    ),
}


@pytest.mark.parametrize("name", DATABASES)
def test_a_database_that_brings_queries_along_is_refused(name: str, tmp_path: Path) -> None:
    sql, expected = DATABASES[name]
    path = storage("sqlite3")(tmp_path)
    with closing(sqlite3.connect(path)) as database:
        if "schema" in sql:
            database.execute("DROP TABLE schema")
        database.executescript(sql)
        database.commit()
    for place in path, path.parent:
        with at_most(20 * MB), pytest.raises(BagError, match=f"bag.*: {expected}"):
            read_bag(place)


def test_a_tree_of_pages_that_leads_to_itself_is_refused(tmp_path: Path) -> None:
    path = next(write_bag(tmp_path / "bag", "sqlite3", 300).glob("*.db3"))
    with closing(sqlite3.connect(path)) as database:
        ((root, size),) = database.execute(
            "SELECT rootpage, page_size FROM sqlite_master, pragma_page_size WHERE name='messages'"
        )
    data = bytearray(path.read_bytes())
    page = (root - 1) * size
    assert data[page] == 5  # an inner page: its children are
    data[page + 8 : page + 12] = struct.pack(">I", root)  # itself
    path.write_bytes(data)
    with pytest.raises(BagError, match=r"bag.*it is damaged"):
        read_bag(path)


def test_a_message_that_is_too_large_is_refused(tmp_path: Path) -> None:
    frame = "x" * (bag_checks.MAX_MESSAGE_BYTES + 1)
    with BagWriter(tmp_path / "bag") as bag:
        bag.write(encode("/dvl", 0, twist_message(0, frame, np.zeros(3))))
    with pytest.raises(BagError, match=rf"/dvl of .*; at most {bag_checks.MAX_MESSAGE_BYTES}"):
        read_bag(tmp_path / "bag")


# ---------------------------------------------------------------- values in messages


def test_a_value_is_shown_up_to_its_beginning() -> None:
    assert files.shown([1.0, "a"]) == "[1.0, 'a']"
    assert files.shown("x" * 1000) == "'" + "x" * 199 + "... (1002 characters)"
    assert files.shown(10**5000) == "an int too large to print"
