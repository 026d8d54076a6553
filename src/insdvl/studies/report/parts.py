"""What a section of the report is made of."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

from insdvl.studies.report.figures import Figure
from insdvl.studies.report.results import Result


@dataclass(frozen=True)
class Part:
    """What one result shows in a section.

    Attributes:
        html: Text and tables above the figures.
        figures: The figures.
    """

    html: str
    figures: list[Figure]


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Attributes:
        name: Its anchor.
        question: Its heading.
        part: Makes it of a result; None where the result has nothing to show.
    """

    name: str
    question: str
    part: Callable[[Result], Part | None]


def table(rows: Sequence[tuple[str, ...]], head: tuple[str, ...] = ()) -> str:
    """A table of texts."""
    lines = ["<table>"]
    if head:
        lines.append("<tr>" + "".join(f"<th>{escape(text)}</th>" for text in head) + "</tr>")
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>")
    return "\n".join([*lines, "</table>"])
