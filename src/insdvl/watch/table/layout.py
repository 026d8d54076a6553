"""The table: a row for each quantity, a column for each filter, and below it what is not right."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from insdvl.watch.table.digits import number, printable
from insdvl.watch.table.numbers import ERROR, LEVELS, OK, WARN, Shown
from insdvl.watch.table.rows import ESSENCE, SILENT, rows_of

LABEL = 17  # cells
COLUMN = 29  # cells that a filter needs; more are used where they are


class Told(NamedTuple):
    """A sentence below the table.

    Attributes:
        text: The sentence.
        level: `OK`, or the level of the finding.
    """

    text: str
    level: int = OK


class Block(NamedTuple):
    """Filters that stand side by side.

    Attributes:
        width: Of the column of each filter, in cells.
        rows: Texts of a row, its label first; the first row has the labels of the filters.
    """

    width: int
    rows: list[tuple[str, ...]]


def title(filters: Sequence[Shown]) -> str:
    """The first line."""
    return f"insdvl monitor, stamp {_stamp(filters)}"


def blocks(filters: Sequence[Shown], columns: int) -> Iterator[Block]:
    """The table.

    Args:
        filters: What is shown of each filter.
        columns: Width of the terminal, in cells.
    """
    count = max((columns - LABEL) // COLUMN, 1)
    for begin in range(0, len(filters), count):
        group = filters[begin : begin + count]
        width = max(columns - LABEL, COLUMN) // len(group)
        rows = [("", *(printable(shown.label) for shown in group))]
        for row in rows_of(group):
            rows.append((row.label, *(printable(row.cell(s, width - 1)) for s in group)))
        yield Block(width, rows)


def told(filters: Sequence[Shown], notes: Sequence[str] = ()) -> list[Told]:
    """The sentences below the table, the worst first and the notes last.

    Args:
        filters: What is shown of each filter.
        notes: What else to say.
    """
    found = [said for shown in filters for said in _of_filter(shown)]
    found.sort(key=lambda said: -said.level)
    return [*found, *(Told(printable(note)) for note in notes)]


def _of_filter(shown: Shown) -> Iterator[Told]:
    if shown.silent is None:
        yield Told(
            f"waits for {printable(shown.node)}: start it; check ROS_DOMAIN_ID, and the "
            "parameter 'filters' of the monitor",
            WARN,
        )
    elif shown.silent > SILENT:
        text = f"ERROR no diagnostics for {shown.silent:.0f} s, it may have ended"
        yield Told(f"{printable(shown.label)} {text}", ERROR)
    for finding in shown.findings:
        text = f"{shown.label} {LEVELS.get(finding.level, '?')} {finding.text}"
        yield Told(printable(text), finding.level)


def plain(filters: Sequence[Shown], notes: Sequence[str] = ()) -> str:
    """The table as text, for a terminal that cannot be drawn on."""
    lines = ["", title(filters)]
    for block in blocks(filters, LABEL + COLUMN * len(filters)):
        for label, *texts in block.rows:
            cells = "".join(f"{text:{block.width}}" for text in texts)
            lines.append(f"{label:{LABEL}}{cells}".rstrip())
    return "\n".join([*lines, *(said.text for said in told(filters, notes))])


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
