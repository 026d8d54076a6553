"""The monitor's table: digits, rows, words, findings, and that it fits into the terminal."""

import io
import os
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, chi2
from shown import POSE, SHOWN
from terminal import Emulator, Terminal

from insdvl.watch.consistency import nis_interval, nis_median_limit
from insdvl.watch.table.digits import number, printable, with_sigma
from insdvl.watch.table.layout import LABEL, blocks, line, plain, title, told
from insdvl.watch.table.numbers import (
    ERROR,
    WARN,
    Finding,
    Measured,
    Pose,
    Shown,
    Triads,
    VelocityError,
)
from insdvl.watch.table.rows import bar
from insdvl.watch.table.screen import Screen

SILENT_NOW = Shown("/other", "/other/insdvl_filter")
WIDE, NARROW = 120, 80  # columns


def row(label: str, *filters: Shown, columns: int = WIDE) -> str:
    """The texts of a row, of the block that has it."""
    rows = [one for block in blocks(filters, columns) for one in block.rows]
    (found,) = [texts for name, *texts in rows if name == label]
    return " ".join(found)


def said(*filters: Shown) -> list[tuple[str, int]]:
    return [(one.text, one.level) for one in told(filters)]


def screen_of(filters: list[Shown], columns: int, rows: int) -> list[str]:
    """What a terminal shows of a table; nothing scrolls."""
    console = pytest.importorskip("rich.console").Console
    file = io.StringIO()
    given: dict[str, Any] = {"force_terminal": True, "width": columns, "height": rows}
    screen = Screen(console(file=file, highlight=False, _environ={}, **given))
    screen.draw(filters)
    terminal = Emulator(columns, rows)
    terminal.feed(file.getvalue().replace("\n", "\r\n"))  # as a terminal does
    screen.close()
    assert terminal.alternate and terminal.scrolled == 0
    return terminal.lines


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (123.456, 1.23, "123.5 ± 1.2"),
        (12.3456, 0.052, "12.346 ± 0.052"),
        (-0.004, 0.096, "-0.004 ± 0.096"),
        (1234.5, 250.0, "1234 ± 250"),
        (1.23456, 0.0, "1.23"),
        (1.23456, np.nan, "1.23"),
        (np.nan, 0.1, "- ± 0.10"),
        (12_345_678.0, np.inf, "1.23e+07"),
        (123_456.0, np.inf, "123456"),
    ],
)
def test_a_value_has_the_digits_that_its_sigma_leaves(
    value: float, sigma: float, text: str
) -> None:
    assert with_sigma([value], [sigma]) == text


def test_of_several_values_the_largest_sigma_counts() -> None:
    assert with_sigma([1.5, 0.02], [0.021, 0.3]) == "1.50 0.02 ± 0.30"
    assert number(np.inf) == "-"


def test_a_text_moves_no_cursor() -> None:
    assert printable("a\x1b[2Jb\n") == "a?[2Jb?"


def test_the_state_comes_first() -> None:
    assert title([SHOWN]) == "insdvl monitor, stamp 1234.6 s"
    (block,) = blocks([SHOWN], WIDE)
    assert block.rows[0] == ("", "/learned")
    assert [label for label, _ in block.rows[1:8]] == [
        "state",
        "north [m]",
        "east [m]",
        "depth [m]",
        "heading [deg]",
        "speed [m/s]",
        "v x y z [m/s]",
    ]
    assert row("depth [m]", SHOWN) == "12.346 ± 0.052"
    assert row("heading [deg]", SHOWN) == "271.9 ± 1.4"
    assert row("speed [m/s]", SHOWN) == "1.500 ± 0.021"
    assert row("state", SHOWN) == "navigates, all well"


def test_what_the_rows_say() -> None:
    assert row("DVL", SHOWN) == "0.42 s ago, 99.5 % of 400 used (gate 1, no_lock 1)"
    assert row("depth sensor", SHOWN) == "0.1 s ago, 100.0 % of 4000 used"
    assert row("gate", SHOWN) == "1 refused, 2 inflations, 0 restarts"
    assert row("noise f [m/s^2]", SHOWN) == "0.012 0.011 0.013 = 1.2 1.1 1.3 x nominal"
    assert row("bias f [mm/s^2]", SHOWN) == "1.20 -0.30 0.00 ± 0.80"
    assert row("bias w [deg/h]", SHOWN) == "0.21 0.41 -0.21 ± 0.10"
    assert row("process noise", SHOWN) == "external, 0.5 s old"
    assert row("rates [Hz]", SHOWN) == "IMU 100, odometry 100"


@pytest.mark.parametrize(
    ("nis", "said"),
    [(2.95, "as expected"), (4.5, "overconfident"), (1.5, "too cautious"), (None, "no DVL")],
)
def test_without_a_truth_the_innovations_speak(nis: float | None, said: str) -> None:
    assert said in row("fit", replace(SHOWN, nis=nis))
    assert "truth" not in plain([SHOWN])
    error = VelocityError(now=0.123, rms=0.11, three_sigma=0.3)
    assert row("truth [m/s]", replace(SHOWN, error=error)) == "0.123 off, RMS 0.11, 3 sigma 0.3"


@pytest.mark.parametrize("count", [1, 100])
def test_the_interval_of_the_nis_is_that_of_chi_square(count: int) -> None:
    expected = chi2.ppf([0.05, 0.95], 3 * count) / count
    assert nis_interval(3, count, 0.9) == pytest.approx(tuple(expected), rel=1e-9)


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("count", [1, 2, 7, 49])
def test_the_limit_of_the_median_nis_is_exceeded_by_chance_as_told(rows: int, count: int) -> None:
    limit = nis_median_limit(rows, count, 1e-3)
    half = (count + 1) // 2  # of them exceed it where their median does
    assert binom.sf(half - 1, count, chi2.sf(limit, rows)) == pytest.approx(1e-3, rel=1e-6)


def test_the_bar_marks_the_nis_inside_and_outside() -> None:
    inside, outside, beyond = bar(3.0, 2.6, 3.4), bar(5.0, 2.6, 3.4), bar(1e6, 2.6, 3.4)
    assert len(inside) == len(outside) == 27
    assert inside[13] == "#" and inside[11:16] == "==#=="
    assert outside[21] == "!" and outside[11:16] == "====="
    assert beyond.endswith("!]")


def test_what_is_waited_for_is_said() -> None:
    ((text, _),) = said(SILENT_NOW)
    assert text.startswith("waits for /other/insdvl_filter: start it")
    assert row("state", SILENT_NOW) == "not heard of yet"
    assert "stamp none, no odometry yet" in line([SILENT_NOW])
    ended = said(replace(SHOWN, silent=7.0))
    assert ended == [("/learned ERROR no diagnostics for 7 s, it may have ended", ERROR)]


def test_findings_have_lines_of_their_own() -> None:
    text = "dvl: no DVL measurement used for 7 s: " + "none is received, check the driver; " * 5
    found = replace(SHOWN, findings=(Finding(ERROR, text), Finding(WARN, "imu: gaps")))
    assert said(found) == [(f"/learned ERROR {text}", ERROR), ("/learned WARN imu: gaps", WARN)]
    lines = screen_of([found], NARROW, 60)
    begin = next(k for k, one in enumerate(lines) if one.startswith("/learned ERROR dvl: no DVL"))
    shown = " ".join(lines[begin:]).split()
    assert shown == f"/learned ERROR {text} /learned WARN imu: gaps".split()


LONG = "the number that led to it, and what an operator is to do about it; " * 5
SMALL = [(80, 24), (60, 20)]


def findings_in(lines: list[str]) -> list[str]:
    """The levels of the findings on a screen, in their order."""
    return [text.split()[1] for text in lines if text.startswith("/learned ")]


@pytest.mark.parametrize(("columns", "rows"), SMALL)
def test_what_is_not_right_is_seen_in_a_small_terminal(columns: int, rows: int) -> None:
    """Also where the table alone fills it; the error first, and each cut says so."""
    error = VelocityError(now=0.123, rms=0.11, three_sigma=0.3)
    found = tuple(Finding(level, LONG) for level in (WARN, ERROR, WARN))
    shown = replace(SHOWN, findings=found, error=error, true_noise=SHOWN.noise)
    lines = screen_of([shown], columns, rows)
    assert findings_in(lines) == ["ERROR", "WARN", "WARN"]
    assert sum(text.endswith("…") for text in lines) == 3
    begin = next(k for k, text in enumerate(lines) if text.startswith("/learned ERROR"))
    assert lines[2].startswith("state") and lines[begin - 1].split()[0] in ("NIS", "bias")
    assert f"… {24 - begin} rows, 3 findings cut: make the terminal larger" in lines[rows - 1]


@pytest.mark.parametrize(("columns", "rows"), SMALL)
def test_more_findings_than_lines(columns: int, rows: int) -> None:
    """The state stays, the last findings go, and all are counted."""
    found = (*(Finding(WARN, LONG) for _ in range(30)), Finding(ERROR, LONG))
    lines = screen_of([replace(SHOWN, findings=found)], columns, rows)
    assert lines[2] == "state            ERROR, see below (31)"
    assert findings_in(lines) == ["ERROR", *["WARN"] * (rows - 5)]
    assert "… 18 rows, 31 findings cut: make the terminal larger" in lines[rows - 1]


def test_a_small_terminal_is_filled() -> None:
    """What a filter that is not heard of leaves is for the rows of the others."""
    wrong = replace(SHOWN, findings=(Finding(ERROR, LONG),))
    assert all(screen_of([wrong, SILENT_NOW], 60, 20))


def test_an_error_is_seen_beside_more_filters_than_fit() -> None:
    wrong = replace(SHOWN, findings=(Finding(ERROR, LONG),))
    lines = screen_of([*[SHOWN] * 12, wrong], 60, 20)
    assert findings_in(lines) == ["ERROR"]


def test_in_a_small_terminal_rows_without_a_value_go_first() -> None:
    lines = [text for text in screen_of([SILENT_NOW], 60, 20) if text]
    assert not any(text.endswith(" -") for text in lines)
    assert " ".join(lines[-3:-1]).startswith("waits for /other/insdvl_filter: start it")
    assert " ".join(lines[-3:-1]).endswith("parameter 'filters' of the monitor")
    assert lines[-1] == "… 16 rows without a value left out"


def test_an_unknown_heading_is_called_so_at_any_width() -> None:
    lost = replace(POSE, rpy_sigma_deg=np.array([0.05, 0.05, 100.0]))
    for columns in (60, 80, 120):
        said = row("heading [deg]", replace(SHOWN, pose=lost), columns=columns)
        assert said == "272 ± 100 (unknown)"


def test_ages_go_on_where_the_filter_stands_still() -> None:
    """They are of its stamps, which need samples of the IMU."""
    assert row("DVL", replace(SHOWN, still=0.2)).startswith("0.42 s ago")
    stopped = replace(SHOWN, still=12.0)
    assert row("DVL", stopped).startswith("12 s ago")
    assert row("state", stopped) == "NO ODOMETRY for 12 s"


def test_filters_side_by_side_do_not_touch() -> None:
    longest = replace(SHOWN, measured=(Measured("DVL", 39_800, {"gate": 1}, 0.42),))
    (text,) = [t for t in screen_of([longest] * 2, NARROW, 40) if t.startswith("DVL")]
    assert len(text) < NARROW and text[LABEL + (NARROW - LABEL) // 2 - 1] == " "


@pytest.mark.parametrize("columns", [60, 80, 100, 120, 200])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_it_fits_into_the_terminal(columns: int, count: int) -> None:
    """Rows are cut at their column, what is too much is counted."""
    findings = tuple(Finding(WARN, "海" * 100 + "\x1b[2J" + "x" * 300) for _ in range(9))
    filters = [replace(SHOWN, label="x" * 300, findings=findings)] * count
    for rows in (24, 30, 60):
        lines = screen_of(filters, columns, rows)
        assert "cut: make the terminal larger" in [text for text in lines if text][-1]
        assert lines[0] == "insdvl monitor, stamp 1234.6 s" and "…" in lines[1]


def test_filters_stand_side_by_side_where_there_is_room() -> None:
    both = [SHOWN, SILENT_NOW]
    assert row("depth [m]", *both, columns=NARROW) == "12.346 ± 0.052 -"
    assert [len(block.rows[0]) - 1 for block in blocks([SHOWN] * 3, NARROW)] == [2, 1]
    assert [len(block.rows[0]) - 1 for block in blocks([SHOWN] * 3, WIDE)] == [3]


def test_without_rich_the_table_is_text() -> None:
    lines = plain([SHOWN, SILENT_NOW], ["a note"]).splitlines()
    assert lines[1] == "insdvl monitor, stamp 1234.6 s"
    assert "depth [m]        12.346 ± 0.052               -" in lines
    assert lines[-1] == "a note" and lines[-2].startswith("waits for /other/insdvl_filter")


def test_nothing_that_a_node_reports_breaks_the_table() -> None:
    odd = Pose(np.nan, *(np.full(3, np.nan) for _ in range(6)))
    strange = replace(SHOWN, pose=odd, nis=1e300, bias_sigma=Triads(*np.full((2, 3), np.nan)))
    assert plain([strange]) and line([strange]) and screen_of([strange], NARROW, 40)
    at_rest = replace(POSE, velocity=np.zeros(3))
    assert row("speed [m/s]", replace(SHOWN, pose=at_rest)) == "0.000 ± 0.021"


DRAW = """
import sys
from dataclasses import replace
from shown import SHOWN
from insdvl.terminal import console_of
from insdvl.watch.table.numbers import Finding
from insdvl.watch.table.screen import Screen

screen = Screen(console_of(sys.stdout))
long = replace(SHOWN, findings=(Finding(2, "x" * 1000),))
print("before")
for shown in ([long], [SHOWN], [SHOWN, SHOWN], [SHOWN]):
    screen.draw(shown)
sys.stdin.readline()
screen.close()
print("after")
"""


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (120, 60)])
def test_a_terminal_shows_the_table_and_is_given_back(columns: int, rows: int) -> None:
    """What was drawn before, longer or wider, is gone; nothing scrolls."""
    expected = screen_of([SHOWN], columns, rows)
    paths = {"PYTHONPATH": os.pathsep.join(sys.path)}
    terminal = Terminal([sys.executable, "-c", DRAW], columns, rows, paths)
    try:
        terminal.until(lambda screen: screen.alternate and screen.lines == expected)
        assert terminal.screen.scrolled == 0 and not terminal.screen.cursor_shown
        terminal.type("\n")
        assert terminal.end() == 0
    finally:
        terminal.close()
    screen = terminal.screen
    assert not screen.alternate and screen.cursor_shown
    assert [text for text in screen.lines if text] == ["before", "after"]


def test_the_emulator_wraps_and_scrolls() -> None:
    """A line that is too long would be seen by the test above."""
    screen = Emulator(4, 2)
    screen.feed("abcdef\r\ngh")
    assert screen.lines == ["ef", "gh"] and screen.scrolled == 1
