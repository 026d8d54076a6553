"""The table on the whole screen of a terminal, drawn again and again by rich."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from insdvl.watch.table.fit import fit, rows_in, with_values
from insdvl.watch.table.layout import LABEL, Block, Told, blocks, title, told
from insdvl.watch.table.numbers import ERROR, OK, STALE, WARN, Shown

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

_STYLES: Mapping[int, str] = MappingProxyType({WARN: "yellow", ERROR: "red", STALE: "red"})


class Screen:
    """The screen; what was in the terminal is there again at the end.

    Args:
        console: The terminal, see `insdvl.terminal.console_of`.
    """

    def __init__(self, console: "Console") -> None:
        from rich.live import Live

        self._console = console
        # Without a thread of its own: it is drawn when there is something new.
        self._live = Live(
            console=console,
            screen=True,
            auto_refresh=False,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def draw(self, filters: Sequence[Shown], notes: Sequence[str] = ()) -> None:
        """Draw the table, as much of it as fits.

        What is not right comes before numbers, see `fit.fit`; the last line tells what was cut.

        Args:
            filters: What is shown of each filter.
            notes: What else to say, below the findings.
        """
        page = self._page(filters, notes)
        self._live.start()
        self._live.update(page, refresh=True)

    def close(self) -> None:
        """Give the terminal back as it was."""
        self._live.stop()

    def _page(self, filters: Sequence[Shown], notes: Sequence[str]) -> "RenderableType":
        from rich.console import Group
        from rich.text import Text

        columns, height = self._console.size
        said = list(told(filters, notes))
        sentences = [list(_text(one).wrap(self._console, columns)) for one in said]
        tables = list(blocks(filters, columns))
        below = []
        if 1 + rows_in(tables) + sum(map(len, sentences)) > height:
            lengths, whole = [len(lines) for lines in sentences], rows_in(tables)
            known = with_values(tables)
            tables, left = fit(known, lengths, height - 2)
            cut = [one for one, k, n in zip(said, left, lengths, strict=True) if k < n]
            rows = rows_in(known) - rows_in(tables)
            below = [_text(_cut(rows, whole - rows_in(known), cut, columns))]
            sentences = [_shortened(*of, columns) for of in zip(sentences, left, strict=True)]
        head = Text(title(filters), no_wrap=True, overflow="ellipsis")
        lines = (line for sentence in sentences for line in sentence)
        return Group(head, *map(_grid, tables), *lines, *below)


def _text(said: Told) -> "Text":
    from rich.text import Text

    return Text(said.text, _STYLES.get(said.level, ""), overflow="fold")


def _shortened(lines: "list[Text]", count: int, columns: int) -> "list[Text]":
    """The first lines of a sentence; where some are left out, the last one ends in an ellipsis."""
    shown = lines[:count]
    if 0 < count < len(lines):
        shown[-1].truncate(columns - 1)
        shown[-1].append("…")
    return shown


def _cut(rows: int, valueless: int, said: Sequence[Told], columns: int) -> Told:
    """Tells in one line what of the page is not shown.

    Args:
        rows: Rows with a value.
        valueless: Rows without one, where that is all.
        said: Sentences that are shortened or left out.
        columns: Width of the terminal, in cells.
    """
    if not rows and not said:
        return Told(f"… {valueless} rows without a value left out"[:columns])
    counts = ((rows, "row"), (len(said), "finding"))
    what = ", ".join(f"{n} {name}{'s' * (n > 1)}" for n, name in counts if n)
    text = f"… {what} cut: make the terminal larger"
    longer = f"{text}, or see /diagnostics"
    level = max((one.level for one in said), default=OK)
    return Told(longer if len(longer) <= columns else text[:columns], level)


def _grid(block: Block) -> "RenderableType":
    from rich.table import Table
    from rich.text import Text

    grid = Table.grid(padding=(0, 1, 0, 0))
    for width in (LABEL, *(block.width for _ in block.rows[0][1:])):
        grid.add_column(width=width - 1, no_wrap=True, overflow="ellipsis")
    for row in block.rows:
        grid.add_row(*map(Text, row))
    return grid
