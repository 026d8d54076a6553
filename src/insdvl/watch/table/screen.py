"""The table on the whole screen of a terminal, drawn again and again by rich."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from insdvl.watch.table.layout import LABEL, Block, Told, blocks, title, told
from insdvl.watch.table.numbers import ERROR, OK, STALE, WARN, Shown

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

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
        from rich.segment import SegmentLines
        from rich.text import Text

        columns, rows = self._console.size
        said = list(told(filters, notes))
        tables = [_grid(block) for block in blocks(filters, columns)]
        page = Group(Text(title(filters)), *tables, *map(_text, said))
        lines = self._console.render_lines(page, pad=False)
        if (left := len(lines) - rows) > 0:
            rest = f"… {left + 1} more lines: make the terminal higher, or see /diagnostics"
            more = _text(Told(rest, max((one.level for one in said), default=OK)))
            lines[rows - 1 :] = self._console.render_lines(more, pad=False)[:1]
        return SegmentLines(lines, new_lines=True)


def _text(said: Told) -> "RenderableType":
    from rich.text import Text

    return Text(said.text, _STYLES.get(said.level, ""), overflow="fold")


def _grid(block: Block) -> "RenderableType":
    from rich.table import Table
    from rich.text import Text

    grid = Table.grid()
    grid.add_column(width=LABEL, no_wrap=True, overflow="ellipsis")
    for _ in block.rows[0][1:]:
        grid.add_column(width=block.width, no_wrap=True, overflow="ellipsis")
    for row in block.rows:
        grid.add_row(*map(Text, row))
    return grid
