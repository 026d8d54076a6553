"""What commands print: lines and progress, in a terminal with and without rich, and in a pipe."""

import io
import os
import re
import sys

import pytest
from terminal import Emulator, Terminal

from insdvl.jobs.progress import Progress
from insdvl.terminal import Line, console_of, say

LINES = [
    Line("configuration", "a.yaml"),
    Line("  position", f"{'far ' * 30}[m]"),
    Line("", "NOT RIGHT: " + "a cause " * 12 + "here", "bold red"),
]
#: A process that says them in a terminal, and shows progress.
SAY = """
import sys
from insdvl.jobs.progress import Progress
from insdvl.terminal import Line, say
sys.stderr = sys.stdout
if {without}:
    sys.modules["rich"] = None
with Progress("seconds", 20) as progress:
    for done in range(21):
        progress.show(done)
say({lines}, 20, sys.stdout)
"""


class Tty(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown(columns: int, *, without_rich: bool, **environment: str) -> tuple[list[str], Emulator]:
    code = SAY.format(without=without_rich, lines=f"[Line(*x) for x in {list(map(tuple, LINES))}]")
    paths = {"PYTHONPATH": os.pathsep.join(sys.path), **environment}
    terminal = Terminal([sys.executable, "-c", code], columns, 40, paths)
    try:
        assert terminal.end() == 0
    finally:
        terminal.close()
    return [text for text in terminal.screen.lines if text], terminal.screen


def test_it_is_drawn_where_there_is_a_terminal_and_rich(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    assert console_of(io.StringIO()) is None
    monkeypatch.setitem(sys.modules, "rich.console", None)
    assert console_of(Tty()) is None
    monkeypatch.undo()
    pytest.importorskip("rich")
    monkeypatch.setenv("TERM", "xterm")
    assert console_of(Tty()) is not None
    monkeypatch.setenv("TERM", "dumb")
    assert console_of(Tty()) is None


def test_a_pipe_gets_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    say(LINES, 20, sys.stdout)
    first, second, third = capsys.readouterr().out.splitlines()
    assert first == "configuration        a.yaml"
    assert second == "  position           " + LINES[1].text
    assert third == LINES[2].text
    with Progress("seconds", 20) as progress:
        for done in range(21):
            progress.show(done)
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "seconds: 0/20" and len(said) == 11
    assert re.fullmatch(r"seconds: 20/20, 0:\d\d elapsed, 0:00 left", said[-1])


@pytest.mark.parametrize("columns", [80, 120])
def test_a_long_value_goes_on_below_its_beginning(columns: int) -> None:
    pytest.importorskip("rich")
    lines, screen = shown(columns, without_rich=False)
    assert re.fullmatch(r"seconds ━+ 20/20 0:00:\d\d", lines[0])
    assert len(lines[0]) <= columns and screen.cursor_shown
    assert lines[1] == "configuration        a.yaml"
    end = next(k for k, text in enumerate(lines) if text.startswith("NOT RIGHT"))
    assert end > 3 and lines[2].startswith("  position           far far")
    assert {text[:21] for text in lines[3:end]} == {" " * 21}
    assert " ".join(text[21:] for text in lines[2:end]) == LINES[1].text
    assert " ".join(lines[end:]) == LINES[2].text


def test_without_rich_a_terminal_gets_plain_lines() -> None:
    lines, _ = shown(120, without_rich=True)
    assert lines[0] == "seconds: 0/20"
    assert re.fullmatch(r"seconds: 20/20, 0:\d\d elapsed, 0:00 left", lines[10])
    assert lines[11] == "configuration        a.yaml"


def test_no_color_means_no_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rich")
    monkeypatch.setenv("TERM", "xterm")
    for value, has_colour in (("", True), ("1", False)):
        monkeypatch.setenv("NO_COLOR", value)
        file = Tty()
        say(LINES, 20, file)
        assert ("\x1b[1;31m" in file.getvalue()) == has_colour
        assert "31m" in file.getvalue() or not has_colour
