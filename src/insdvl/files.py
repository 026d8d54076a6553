"""How files are read and written: read within a limit, written whole or not at all."""

import errno
import io
import json
import math
import os
import stat
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_SHOWN = 200  # characters of a value in a message
MAX_PART_BYTES = 4 * 2**20  # of a page's numbers; a twentieth is used, or a thousand hours of soak


def read(path: Path, limit: int) -> bytes:
    """The bytes of a file.

    Raises:
        OSError: It cannot be read, has more than ``limit`` bytes, or is none that ends, such as a
            pipe or a device.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is no regular file")
    if status.st_size > limit:
        raise OSError(errno.EFBIG, f"it has {status.st_size} bytes, and at most {limit} are read")
    with path.open("rb") as file:
        return file.read(status.st_size)  # no more, should it grow meanwhile


def read_json(path: Path, limit: int) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        ValueError: The file cannot be read, has more than ``limit`` bytes or no JSON object in it;
            the message names it.
    """
    try:
        document = json.loads(read(path, limit).decode("utf-8"), parse_constant=_refuse)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is no JSON: {beginning(str(error))}") from error
    if not isinstance(document, dict):
        raise ValueError(f"{path} is no JSON object")
    return document


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is no number")


def read_parts(
    folder: Path, names: Iterable[str], page: Callable[[Mapping[str, Any]], str]
) -> dict[str, Any]:
    """The parts of a page that are there, each a JSON file of the folder.

    Args:
        folder: Of the files.
        names: Of the parts.
        page: Makes the page of the parts; one that it cannot tell of is damaged.

    Raises:
        ValueError: A file cannot be read or is damaged; the message names it.
    """
    parts: dict[str, Any] = {}
    for name in names:
        file = folder / f"{name}.json"
        if file.exists():
            parts[name] = read_json(file, MAX_PART_BYTES)
            try:
                page({name: parts[name]})
            except Exception as error:  # what is missing or of another type raises anything
                reason = beginning(f"{type(error).__name__}: {error}")
                raise ValueError(f"{file} lacks what the page tells of it: {reason}") from error
    return parts


def archive(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of an ``.npz`` file of arrays.

    Not compressed, so that the bytes do not depend on a compressor's version.
    """
    buffer = io.BytesIO()
    named: dict[str, Any] = dict(arrays)
    np.savez(buffer, **named)
    return buffer.getvalue()


def arrays(data: bytes, limit: int) -> dict[str, NDArray[Any]]:
    """The arrays in the bytes of an ``.npz`` file.

    Raises:
        ValueError: They are no such file, it is damaged, an array is of objects, or the arrays have
            more than ``limit`` bytes.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            entries = file.infolist()
            size = sum(entry.file_size for entry in entries)
            if size > limit:
                raise ValueError(f"they have {size} bytes, and at most {limit} are read")
            return {
                entry.filename.removesuffix(".npy"): _array(_unpacked(file, entry))
                for entry in entries
            }
    except Exception as error:  # damaged bytes raise what zipfile, zlib or numpy make of them
        raise ValueError(f"no archive of arrays: {beginning(str(error))}") from error


def _unpacked(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    """The bytes of an entry, of which no more is unpacked than it says that it has."""
    with archive.open(entry) as file:
        data = file.read(entry.file_size)
        if len(data) < entry.file_size or file.read(1):  # the second read also checks the sum
            raise ValueError(f"{entry.filename} has not the {entry.file_size} bytes that it says")
    return data


def _array(data: bytes) -> NDArray[Any]:
    """An array from the bytes of an ``.npy`` file.

    numpy's own function makes room for what the header says before it looks for the elements.
    """
    file = io.BytesIO(data)
    version = npy.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"version {version} is unknown")
    shape, is_fortran, dtype = _HEADERS[version](file)
    if dtype.hasobject:
        raise ValueError("an array is of objects, which may run code")
    if min(shape, default=0) < 0:
        raise ValueError(f"an array has the shape {shape}")
    elements = np.frombuffer(data, dtype, offset=file.tell())
    return np.array(elements.reshape(shape, order="F" if is_fortran else "C"))


def shown(value: Any) -> str:
    """A value in a message, cut where it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python does not write integers of thousands of digits
        text = f"an {type(value).__name__} too large to be written"
    return beginning(text)


def beginning(text: str) -> str:
    """A text in a message, cut where it is long."""
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}... ({len(text)} characters)"


def write(path: Path, data: bytes) -> None:
    """Write a file; it is complete when it takes its name, and another of that name lives on else.

    Raises:
        OSError: It cannot be written.
    """
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with open(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fchmod(file.fileno(), 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def json_text(document: Mapping[str, Any]) -> str:
    """A document as JSON, which knows no nan.

    Raises:
        ValueError: There is a nan or an infinity in it.
    """
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """A value, or values by their names, with None for a float that JSON does not know."""
    if isinstance(value, dict):
        return {name: finite(item) for name, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def check_writable(path: Path, option: str) -> None:
    """Try whether a file can be written, before the work that makes it.

    Args:
        path: The file.
        option: Where it comes from, for the message.

    Raises:
        ValueError: It cannot; the message is one sentence.
    """
    if not path.parent.is_dir():
        raise ValueError(f"{option} {path}: {path.parent} is no folder")
    if path.is_dir():
        raise ValueError(f"{option} {path}: it is a folder")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ValueError(f"{option} {path}: {error.strerror or error}") from error
