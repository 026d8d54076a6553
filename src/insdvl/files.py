"""How results reach the disk: whole or not at all, and tried before the work."""

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any


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
        os.unlink(temporary)
        raise


def json_text(document: Mapping[str, Any]) -> str:
    """A document as JSON, which knows no nan.

    Raises:
        ValueError: There is a nan or an infinity in it.
    """
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


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
