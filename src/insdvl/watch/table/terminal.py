"""The screen of a terminal, drawn again and again with standard escape codes (ECMA-48, xterm).

The alternate screen is used, so that what was in the terminal is there again at the end.
"""

import os
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TextIO

from insdvl.watch.table.layout import Line, Size
from insdvl.watch.table.numbers import ERROR, STALE, WARN

_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"  # and hide, show the cursor
_HOME, _ERASE_LINE, _ERASE_BELOW = "\x1b[H", "\x1b[K", "\x1b[J"
_PLAIN = "\x1b[0m"
_COLOURS: Mapping[int, str] = MappingProxyType(
    {WARN: "\x1b[33m", ERROR: "\x1b[31m", STALE: "\x1b[31m"}
)


def is_screen(stream: TextIO) -> bool:
    """Whether lines can be drawn in place there."""
    return stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"


class Screen:
    """The screen of a terminal.

    Args:
        stream: The terminal, see `is_screen`.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._drawn = False
        self._colours = not os.environ.get("NO_COLOR")

    @property
    def size(self) -> Size:
        """Its size now."""
        columns, rows = os.get_terminal_size(self._stream.fileno())
        return Size(columns or 80, rows or 24)  # a serial line may say 0

    def draw(self, lines: Sequence[Line]) -> None:
        """Draw lines that fit, see `insdvl.watch.table.layout.table`."""
        enter = "" if self._drawn else _ENTER
        self._drawn = True
        # Erased before it is written: behind the last column, that would erase its character.
        rows = "\r\n".join(_ERASE_LINE + self._styled(line) for line in lines)
        below = f"\r\n{_ERASE_BELOW}" if len(lines) < self.size.rows else ""
        self._write(f"{enter}{_HOME}{rows}{below}")

    def close(self) -> None:
        """Give the terminal back as it was."""
        if self._drawn:
            self._drawn = False
            self._write(_LEAVE)

    def _styled(self, line: Line) -> str:
        colour = _COLOURS.get(line.level, "") if self._colours else ""
        return f"{colour}{line.text}{_PLAIN}" if colour else line.text

    def _write(self, text: str) -> None:
        encoding = self._stream.encoding or "ascii"
        self._stream.write(text.encode(encoding, errors="replace").decode(encoding))
        self._stream.flush()
