"""What people read in a terminal: drawn by rich (insdvl[cli]) where it is installed, else plain."""

import io
import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple, TextIO

from insdvl.extras import MissingPackageError, extra

if TYPE_CHECKING:
    from rich.console import Console


class Line(NamedTuple):
    """Something to say.

    Attributes:
        label: What it is; a sentence of its own has none.
        text: The value or the sentence.
        style: Of the text up to its first colon, as rich names styles, such as ``bold red``.
    """

    label: str
    text: str
    style: str = ""


def console_of(stream: TextIO) -> "Console | None":
    """The terminal behind a stream; None for a pipe, a terminal without a cursor or without rich.

    Colours are left out where NO_COLOR is set.
    """
    if not stream.isatty() or os.environ.get("TERM", "dumb") == "dumb":
        return None
    try:
        with extra("cli"):
            from rich.console import Console
    except MissingPackageError:
        return None
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors="replace")  # what its encoding lacks is shown as ?
    return Console(file=stream, highlight=False, markup=False, emoji=False)


def plain(lines: Iterable[Line], width: int) -> str:
    """Lines of text, the values in a column.

    Args:
        lines: What to say.
        width: Of the labels.
    """
    return "\n".join(
        f"{line.label:{width}} {line.text}".rstrip() if line.label else line.text for line in lines
    )


def say(lines: Iterable[Line], width: int, stream: TextIO) -> None:
    """Print lines; in a terminal a long value goes on below its beginning.

    Args:
        lines: What to say.
        width: Of the labels.
        stream: Where to.
    """
    console = console_of(stream)
    if console is None:
        print(plain(lines, width), file=stream)
        return
    from rich.table import Table
    from rich.text import Text

    for line in lines:
        text = Text(line.text)
        text.stylize(line.style, 0, len(line.text.partition(":")[0]))
        if not line.label:
            console.print(text)
            continue
        row = Table.grid("", "", padding=(0, 1))
        row.columns[0].min_width, row.columns[0].no_wrap = width, True
        row.add_row(Text(line.label), text)
        console.print(row)
