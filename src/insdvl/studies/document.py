"""The result of a command as JSON, where --json says."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from insdvl.files import check_writable, json_text, write
from insdvl.studies.arguments.output import TERMINAL


def check_place(place: Path | None) -> None:
    """Check that the document can be written, before the work that makes it.

    Raises:
        ValueError: It cannot; the message is one sentence.
    """
    if place not in (None, TERMINAL):
        check_writable(place, "--json")


def write_document(place: Path | None, document: Mapping[str, Any]) -> None:
    """Write a document to its place; nowhere without one.

    Raises:
        OSError: The file cannot be written.
        ValueError: The document contains a NaN or an infinity.
    """
    if place is None:
        return
    text = json_text(document)
    if place == TERMINAL:
        print(text, end="")
    else:
        write(place, text.encode())


def tell(place: Path | None, document: Mapping[str, Any], text: str) -> None:
    """Write a document, and print the text unless the document is on standard output.

    Raises:
        OSError: The file cannot be written.
        ValueError: The document contains a NaN or an infinity.
    """
    write_document(place, document)
    if place != TERMINAL:
        print(text)
