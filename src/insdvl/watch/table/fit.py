"""What of the table and its sentences fits into a terminal that is too small for all."""

from collections.abc import Sequence
from math import inf

from insdvl.watch.table.digits import UNKNOWN
from insdvl.watch.table.layout import Block

#: Rows of a block that a navigator needs: the names, and the state down to the speed.
NAVIGATION = 7
#: Rows of a block that stay, unless those of all blocks take more than half of the room: the names
#: and the state.
STATE = 2


def rows_in(blocks: Sequence[Block]) -> int:
    """How many rows there are in all blocks."""
    return sum(len(block.rows) for block in blocks)


def with_values(blocks: Sequence[Block]) -> list[Block]:
    """The blocks without the rows that have a value of no filter."""
    return [
        block._replace(rows=[row for row in block.rows if any(c != UNKNOWN for c in row[1:])])
        for block in blocks
    ]


def fit(
    blocks: Sequence[Block], lengths: Sequence[int], room: int
) -> tuple[list[Block], list[int]]:
    """Choose what is shown; what is not right comes before numbers.

    Each sentence is shortened, to two lines if need be; then rows go from below, then each sentence
    is shortened to one line, and in the end the last sentences go.

    Args:
        blocks: The table.
        lengths: Lines that each sentence takes, the most important one first.
        room: Lines that there are.

    Returns:
        The blocks with the rows that fit, and how many lines each sentence gets, 0 for none.
    """
    limits = ((inf, inf), (4, inf), (3, inf), (2, inf), (2, NAVIGATION), (1, STATE))
    for most, fewest in limits:
        lines = [int(min(length, most)) for length in lengths]
        needed = int(sum(min(len(block.rows), fewest) for block in blocks))
        if sum(lines) + needed <= room:
            break
    for k in reversed(range(len(lines))):
        if sum(lines) > max(room - needed, room // 2):
            lines[k] = 0
    left, shown = room - sum(lines), list(blocks)
    # The shortest first: what one does not take is for the others.
    order = sorted(range(len(blocks)), key=lambda k: len(blocks[k].rows))
    for taken, k in enumerate(order):
        share = max(left, 0) // (len(blocks) - taken)
        shown[k] = blocks[k]._replace(rows=blocks[k].rows[:share])
        left -= len(shown[k].rows)
    return shown, lines
