"""Tables in Markdown, and how numbers stand in them."""

from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first column is text, the others are numbers."""
    lines = [
        "| " + " | ".join(head) + " |",
        "|---|" + "--:|" * (len(head) - 1),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


def number(value: float | None, digits: int = 4) -> str:
    """A number for a table; a dash where it is missing."""
    if value is None:
        return "–"
    return f"{value:.{digits}f}" if abs(value) < 1000.0 else f"{value:.2e}"


def interval(values: Sequence[float] | None, digits: int = 3) -> str:
    """Middle, lower and upper end of an interval; a dash where it is missing."""
    if values is None:
        return "–"
    middle, low, high = (number(value, digits) for value in values)
    return f"{middle} [{low}, {high}]"
