"""Files: read within a size limit, written completely or not at all."""

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
MAX_PART_BYTES = 2**24  # of the numbers of a part of a page, of a hundred missions of 66 vehicles


def read(path: Path, limit: int) -> bytes:
    """The bytes of a file.

    Raises:
        OSError: It cannot be read, is larger than ``limit`` bytes, or is not a regular file (a pipe
            or a device may never end).
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "not a regular file")
    if status.st_size > limit:
        raise OSError(errno.EFBIG, f"{status.st_size} bytes, more than the limit of {limit}")
    with path.open("rb") as file:
        return file.read(status.st_size)  # not more, even if the file is growing


def read_json(path: Path, limit: int) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        ValueError: The file cannot be read, is larger than ``limit`` bytes or holds no JSON object;
            the message names it.
    """
    try:
        document = json.loads(read(path, limit).decode("utf-8"), parse_constant=_refuse)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not valid JSON: {beginning(str(error))}") from error
    if not isinstance(document, dict):
        raise ValueError(f"{path} is not a JSON object")
    return document


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is not allowed")


def read_parts(
    folder: Path, names: Iterable[str], page: Callable[[Mapping[str, Any]], object]
) -> dict[str, Any]:
    """The available parts of a page, each read from a JSON file.

    Args:
        folder: Folder of the files.
        names: Names of the parts; a file has the name of its part.
        page: Writes the page or pages from parts; a part that it cannot use is damaged.

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
            except Exception as error:  # a missing key or a wrong type may raise anything
                reason = beginning(f"{type(error).__name__}: {error}")
                raise ValueError(
                    f"{file} does not have the content that the page needs: {reason}"
                ) from error
    return parts


def archive(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Arrays as the bytes of an ``.npz`` file.

    It is not compressed, so the bytes do not depend on the version of a compressor.
    """
    buffer = io.BytesIO()
    named: dict[str, Any] = dict(arrays)
    np.savez(buffer, **named)
    return buffer.getvalue()


def arrays(data: bytes, limit: int) -> dict[str, NDArray[Any]]:
    """The arrays in the bytes of an ``.npz`` file.

    Raises:
        ValueError: It is not such a file, it is damaged, an array holds Python objects, or the
            arrays are larger than ``limit`` bytes.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            entries = file.infolist()
            size = sum(entry.file_size for entry in entries)
            if size > limit:
                raise ValueError(f"{size} bytes unpacked, more than the limit of {limit}")
            return {
                entry.filename.removesuffix(".npy"): _array(_unpacked(file, entry))
                for entry in entries
            }
    except Exception as error:  # on damaged bytes zipfile, zlib and numpy raise anything
        raise ValueError(f"not a valid .npz archive: {beginning(str(error))}") from error


def _unpacked(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    """The bytes of an entry; not more is unpacked than the size that it declares."""
    with archive.open(entry) as file:
        data = file.read(entry.file_size)
        if len(data) < entry.file_size or file.read(1):  # the second read also verifies the CRC
            raise ValueError(
                f"{entry.filename} does not have the {entry.file_size} bytes it declares"
            )
    return data


def _array(data: bytes) -> NDArray[Any]:
    """An array from the bytes of an ``.npy`` file.

    numpy's own reader allocates what the header declares before it reads the elements.
    """
    file = io.BytesIO(data)
    version = npy.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"unknown .npy version {version}")
    shape, is_fortran, dtype = _HEADERS[version](file)
    if dtype.hasobject:
        raise ValueError("an array holds Python objects, which may run code")
    if min(shape, default=0) < 0:
        raise ValueError(f"an array has the invalid shape {shape}")
    elements = np.frombuffer(data, dtype, offset=file.tell())
    return np.array(elements.reshape(shape, order="F" if is_fortran else "C"))


def shown(value: Any) -> str:
    """A value as text for a message, shortened if it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print integers with thousands of digits
        text = f"an {type(value).__name__} too large to print"
    return beginning(text)


def beginning(text: str) -> str:
    """A text for a message, shortened if it is long."""
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}... ({len(text)} characters)"


def write(path: Path, data: bytes) -> None:
    """Write a file completely or not at all; until then an existing file of that name stays.

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
    """A document as JSON.

    Raises:
        ValueError: It contains a NaN or an infinity, which JSON does not have.
    """
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """A value, or a dictionary of values, with None in place of NaN and infinity."""
    if isinstance(value, dict):
        return {name: finite(item) for name, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def check_writable(path: Path, option: str) -> None:
    """Check that a file can be written, before the work whose result it is to hold.

    Args:
        path: The file.
        option: The option that named it, for the message.

    Raises:
        ValueError: It cannot be written; the message is one sentence.
    """
    if not path.parent.is_dir():
        raise ValueError(f"{option} {path}: {path.parent} is not a folder")
    if path.is_dir():
        raise ValueError(f"{option} {path}: is a folder")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ValueError(f"{option} {path}: {error.strerror or error}") from error
