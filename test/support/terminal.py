"""A terminal: a process in a pty, and the screen that its escape codes leave (ECMA-48, xterm)."""

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from unicodedata import east_asian_width

#: A control sequence, one character, or the beginning of a sequence whose end has not come.
TOKEN = re.compile(r"\x1b\[([?0-9;]*)([A-Za-z])|(\x1b[^A-Za-z]*$)|(.)", re.DOTALL)


class Emulator:
    """The screen: what a user sees.

    A character in the last column leaves the cursor there until the next one, which begins a new
    line, as in a VT100; at the bottom the screen scrolls.

    Attributes:
        alternate: Whether the alternate screen is shown.
        scrolled: How many lines were lost at the top.
    """

    def __init__(self, columns: int, rows: int) -> None:
        self.columns, self.rows = columns, rows
        self.alternate = False
        self.scrolled = 0
        self._cursor_shown = True
        self._screens = {shown: self._blank(rows) for shown in (False, True)}
        self._row = self._column = 0
        self._saved = 0, 0  # the cursor when the alternate screen was entered
        self._rest = ""

    def _blank(self, rows: int) -> list[list[str]]:
        return [[" "] * self.columns for _ in range(rows)]

    @property
    def lines(self) -> list[str]:
        """The rows of the screen, without spaces at their ends."""
        return ["".join(row).rstrip() for row in self._screens[self.alternate]]

    @property
    def cursor_shown(self) -> bool:
        return self._cursor_shown

    def feed(self, text: str) -> None:
        """Take what a process writes; a sequence that is cut off waits for its end."""
        text, self._rest = self._rest + text, ""
        for match in TOKEN.finditer(text):
            numbers, command, cut, character = match.groups()
            if cut:
                self._rest = cut
            elif command:
                self._control(numbers, command)
            else:
                self._write(character)

    def _control(self, numbers: str, command: str) -> None:
        screen = self._screens[self.alternate]
        if (numbers, command) == ("", "H"):
            self._row = self._column = 0
        elif (numbers, command) == ("2", "K"):
            screen[self._row] = [" "] * self.columns
        elif command == "A":
            self._row = max(self._row - int(numbers or 1), 0)
        elif command in "hl" and numbers in ("?1049", "?25"):
            if numbers == "?25":
                self._cursor_shown = command == "h"
            else:
                self.alternate = command == "h"
                cursor = self._row, self._column
                self._row, self._column = cursor if self.alternate else self._saved
                self._saved = cursor
                self._screens[True] = self._blank(self.rows)
        elif command != "m":
            raise AssertionError(f"unexpected control sequence ESC [ {numbers} {command}")

    def _write(self, character: str) -> None:
        if character == "\r":
            self._column = 0
            return
        if character == "\n":
            self._down()
            return
        assert character.isprintable(), f"unexpected character {character!r}"
        if self._column == self.columns:
            self._column = 0
            self._down()
        row = self._screens[self.alternate][self._row]
        row[self._column] = character
        self._column += 1
        if east_asian_width(character) in "WF" and self._column < self.columns:
            row[self._column] = ""  # the second cell of a wide character
            self._column += 1

    def _down(self) -> None:
        if self._row < self.rows - 1:
            self._row += 1
            return
        screen = self._screens[self.alternate]
        del screen[0]
        screen += self._blank(1)
        self.scrolled += 1


class Terminal:
    """A process in a terminal of its own.

    Args:
        command: The process.
        columns: Width.
        rows: Height.
        environment: Added to the environment.
        folder: Its working directory.
    """

    def __init__(
        self,
        command: Sequence[str],
        columns: int,
        rows: int,
        environment: Mapping[str, str] | None = None,
        folder: Path | None = None,
    ) -> None:
        self._main, side = pty.openpty()
        self.resize(columns, rows)
        attributes = termios.tcgetattr(side)
        attributes[3] &= ~termios.ECHO
        termios.tcsetattr(side, termios.TCSANOW, attributes)
        self.process = subprocess.Popen(
            command,
            stdin=side,
            stdout=side,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "TERM": "xterm", **(environment or {})},
            cwd=folder,
            start_new_session=True,
        )
        os.close(side)

    def until(
        self, condition: Callable[[Emulator], object], turn: Callable[[], None] = lambda: None
    ) -> None:
        """Show what the process writes until a condition holds of the screen."""
        deadline = time.monotonic() + 300.0  # only a hang takes as long
        while not condition(self.screen):
            assert time.monotonic() < deadline, "\n".join(self.screen.lines)
            turn()
            assert self._take() or condition(self.screen), "\n".join(self.screen.lines)

    def resize(self, columns: int, rows: int) -> None:
        """Another size, with an empty screen."""
        alternate = hasattr(self, "screen") and self.screen.alternate
        self.screen = Emulator(columns, rows)
        self.screen.alternate = alternate
        fcntl.ioctl(self._main, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def type(self, text: str) -> None:
        """As from the keyboard; it is not echoed."""
        os.write(self._main, text.encode())

    def end(self) -> int:
        """Show all until the process has ended; its exit code."""
        while self._take(None):
            pass
        return self.process.wait()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._main)

    def _take(self, timeout: float | None = 0.02) -> bool:
        """Whether the process may still write."""
        if not select.select([self._main], [], [], timeout)[0]:
            return True
        try:
            data = os.read(self._main, 65536)
        except OSError:  # the other side is closed
            return False
        self.screen.feed(data.decode())
        return bool(data)
