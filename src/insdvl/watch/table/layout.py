"""The table: a row for each quantity, a column for each filter, and below it what is not right.

Every line takes one row of the terminal: none is wider than the terminal, and there are no more of
them than it has.
"""

import textwrap
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from insdvl.watch.table.digits import clipped, number, padded, printable
from insdvl.watch.table.numbers import ERROR, LEVELS, OK, Shown
from insdvl.watch.table.rows import ESSENCE, SILENT, rows_of

LABEL = 17  # cells
COLUMN = 29  # cells that a filter needs; more are used where they are


class Line(NamedTuple):
    """A line of the table.

    Attributes:
        text: Its text.
        level: `OK`, or the level of the finding that it belongs to.
    """

    text: str
    level: int = OK


class Size(NamedTuple):
    """Size of a terminal, in cells."""

    columns: int
    rows: int


def table(filters: Sequence[Shown], size: Size, notes: Sequence[str] = ()) -> list[Line]:
    """The lines of the table, which fit into a terminal.

    Args:
        filters: What is shown of each filter.
        size: Of the terminal; below 80 columns the lines are cut.
        notes: What else to show, below the findings.
    """
    lines = [Line(_title(filters))]
    for group in _groups(filters, size.columns):
        lines += _block(group, size.columns)
    findings = list(_findings(filters, size.columns))
    for note in notes:
        findings += _wrapped(note, OK, size.columns)
    room = size.rows - len(lines)
    if len(findings) > room:
        kept = max(room - 1, 0)
        rest = f"… {len(findings) - kept} more lines: make the terminal higher, or see /diagnostics"
        findings = [*findings[:kept], Line(rest, max(line.level for line in findings))]
    lines = [Line(clipped(line.text, size.columns), line.level) for line in [*lines, *findings]]
    return lines[: size.rows]


def line(filters: Sequence[Shown]) -> str:
    """The essence of the table in one line, for a log."""
    parts = []
    for shown in filters:
        worst = max((finding.level for finding in shown.findings), default=OK)
        said = [shown.label, *(f"{row.label} {row.cell(shown, 0)}" for row in ESSENCE)]
        if shown.error is not None:
            said.append(f"velocity error {number(shown.error.rms)} m/s")
        nis = "-" if shown.nis is None else f"{shown.nis:.2f}"
        parts.append(", ".join([*said, f"NIS {nis}", LEVELS.get(worst, "?")]))
    return printable(f"stamp {_stamp(filters)} | {' | '.join(parts)}")


def _stamp(filters: Sequence[Shown]) -> str:
    stamps = [shown.pose.stamp_s for shown in filters if shown.pose is not None]
    return f"{max(stamps):.1f} s" if stamps else "none, no odometry yet"


def _title(filters: Sequence[Shown]) -> str:
    return f"insdvl monitor, stamp {_stamp(filters)}"


def _groups(filters: Sequence[Shown], columns: int) -> Iterator[Sequence[Shown]]:
    """Filters that stand side by side."""
    count = max((columns - LABEL) // COLUMN, 1)
    for begin in range(0, len(filters), count):
        yield filters[begin : begin + count]


def _block(group: Sequence[Shown], columns: int) -> Iterator[Line]:
    width = (columns - LABEL) // len(group)
    yield Line(" " * LABEL + "".join(padded(printable(s.label), width) for s in group))
    for row in rows_of(group):
        texts = (printable(row.cell(shown, width - 1)) for shown in group)
        yield Line(padded(row.label, LABEL) + "".join(padded(text, width) for text in texts))


def _findings(filters: Sequence[Shown], columns: int) -> Iterator[Line]:
    """Each on lines of its own; what is waited for first."""
    for shown in filters:
        if shown.silent is None:
            yield from _wrapped(
                f"waits for {shown.node}: start it; check ROS_DOMAIN_ID, and the parameter "
                "'filters' of the monitor",
                OK,
                columns,
            )
        elif shown.silent > SILENT:
            yield from _wrapped(
                f"{shown.label} ERROR no diagnostics for {shown.silent:.0f} s, it may have ended",
                ERROR,
                columns,
            )
        for finding in shown.findings:
            level = LEVELS.get(finding.level, "?")
            text = f"{shown.label} {level} {finding.text}"
            yield from _wrapped(text, finding.level, columns)


def _wrapped(text: str, level: int, columns: int) -> Iterator[Line]:
    for part in textwrap.wrap(printable(text), max(columns, 20), subsequent_indent="  "):
        yield Line(part, level)
