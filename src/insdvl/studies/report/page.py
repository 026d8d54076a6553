"""The report: one page with everything in it, for a browser without a network."""

import base64
import gzip
import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import Any

from insdvl.extras import MissingPackageError, extra
from insdvl.studies.report.figures import Figure
from insdvl.studies.report.results import Result
from insdvl.studies.report.sections import SECTIONS

#: Oldest plotly.js that reads arrays in base64.
OLDEST = (2, 35)
#: What a browser shows that cannot unpack the script.
UNDRAWN = (
    "No figures: this browser cannot unpack the script that draws them. "
    "Take Chrome or Edge from version 80 on, Firefox from 113 on, or Safari from 16.4 on."
)


def page_of(results: Sequence[Result]) -> str:
    """The page of one result, or of two side by side.

    Raises:
        MissingPackageError: plotly is not installed, or too old.
    """
    script = _packed(_plotly())
    drawn: list[Figure] = []
    body: list[str] = []
    links: list[str] = []
    for section in SECTIONS:
        parts = [section.part(result) for result in results]
        if all(part is None for part in parts):
            continue
        links.append(f'<a href="#{section.name}">{escape(section.question)}</a>')
        columns = []
        for result, part in zip(results, parts, strict=True):
            heading = f"<h3>{escape(result.title)}</h3>" if len(results) > 1 else ""
            if part is None:
                columns.append(f"<div>{heading}<p>Nothing to show.</p></div>")
                continue
            places = []
            for figure in part.figures:
                if figure["time"]:
                    figure["layout"]["xaxis"]["range"] = [0.0, result.duration]
                height = figure["layout"]["height"]
                places.append(
                    f'<div class="figure" data-figure="{len(drawn)}" style="height:{height}px">'
                    "</div>"
                )
                drawn.append(figure)
            columns.append("\n".join([f"<div>{heading}{part.html}", *places, "</div>"]))
        body.append(
            f'<section id="{section.name}"><h2>{escape(section.question)}</h2>'
            f'<div class="columns">{"".join(columns)}</div></section>'
        )
    title = " and ".join(result.title for result in results)
    arrays: dict[str, int] = {}
    shared = {"figures": _shared(drawn, arrays), "arrays": list(arrays)}
    # "</" would end the script element.
    data = json.dumps(shared, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}: replay</title>",
            f"<style>{_asset('report.css')}</style>",
            "</head><body>",
            f"<header><h1>{escape(title)}</h1><nav>{' '.join(links)}</nav></header>",
            f'<main><p id="undrawn" class="judgement unknown" hidden>{UNDRAWN}</p>',
            *body,
            "</main>",
            f'<script type="application/json" id="figures">{data}</script>',
            f'<script type="application/gzip" id="plotly">{script}</script>',
            f"<script>{_asset('report.js')}</script>",
            "</body></html>",
            "",
        ]
    )


def _shared(value: Any, arrays: dict[str, int]) -> Any:
    """A document with each array as its number among all that differ: many share their times.

    Args:
        value: The document.
        arrays: Arrays in base64 and their numbers, to which those of the document are added.
    """
    if isinstance(value, list):
        return [_shared(item, arrays) for item in value]
    if not isinstance(value, dict):
        return value
    return {
        key: arrays.setdefault(item, len(arrays)) if key == "bdata" else _shared(item, arrays)
        for key, item in value.items()
    }


def _plotly() -> str:
    """The script plotly.js."""
    with extra("report"):
        from plotly.offline import get_plotlyjs, get_plotlyjs_version
    version = get_plotlyjs_version()
    if tuple(int(part) for part in version.split(".")[:2]) < OLDEST:
        raise MissingPackageError(
            f"plotly is too old, its plotly.js is {version}: install insdvl[report]", name="plotly"
        )
    return str(get_plotlyjs())


def _packed(script: str) -> str:
    """A script in gzip and base64, two fifths of its size; the browser unpacks it."""
    return base64.b64encode(gzip.compress(script.encode(), mtime=0)).decode()


def _asset(name: str) -> str:
    return (files("insdvl.studies.report") / "assets" / name).read_text(encoding="utf-8")
