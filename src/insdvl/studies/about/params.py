"""The command `insdvl params`: what a parameter means."""

import argparse
import sys
import textwrap
from collections.abc import Iterable, Iterator
from typing import Any

from insdvl.commands import nearest
from insdvl.parameters.declaration import Declaration, declarations
from insdvl.studies.document import check_place, tell
from insdvl.studies.report.parameter_page import SECTIONS, yaml_value

WIDTH = 80


def run(arguments: argparse.Namespace) -> int:
    """Print the parameters; the exit code is 1 where there is none."""
    if arguments.node is not None and arguments.node not in SECTIONS:
        print(
            f"insdvl params: unknown node {arguments.node!r}{nearest(arguments.node, SECTIONS)}; "
            f"known are {', '.join(SECTIONS)}",
            file=sys.stderr,
        )
        return 2
    nodes = [arguments.node] if arguments.node else list(SECTIONS)
    found = {node: list(_fitting(node, arguments.word.lower())) for node in nodes}
    if any(found.values()):
        found = {node: declared for node, declared in found.items() if declared}
        document = {node: {d.name: _facts(d) for d in ds} for node, ds in found.items()}
        lines = [line for node, ds in found.items() for line in (f"{node}:", *_all_lines(ds))]
        try:
            check_place(arguments.json)
            tell(arguments.json, document, "\n".join(lines))
        except (ValueError, OSError) as error:
            print(f"insdvl params: {error}", file=sys.stderr)
            return 2
        return 0
    names = [d.name for node in nodes for d in declarations(SECTIONS[node])]
    print(
        f"insdvl params: no parameter has {arguments.word!r} in its name or meaning"
        f"{nearest(arguments.word, names)}",
        file=sys.stderr,
    )
    return 1


def _fitting(node: str, word: str) -> Iterator[Declaration]:
    for declaration in declarations(SECTIONS[node]):
        if word in declaration.name.lower() or word in declaration.meaning.lower():
            yield declaration


def _facts(d: Declaration) -> dict[str, Any]:
    """A parameter for the JSON document."""
    return {
        "default": d.default,
        "unit": d.unit,
        "type": d.type_name,
        "range": d.range_text,
        "meaning": d.meaning,
    }


def _all_lines(declared: Iterable[Declaration]) -> Iterator[str]:
    for declaration in declared:
        yield from _lines(declaration)


def _lines(d: Declaration) -> Iterator[str]:
    """Name, default, unit and range; then the meaning."""
    unit = f" {d.unit}" if d.unit else ""
    facts = "; ".join(fact for fact in (d.type_name, d.range_text) if fact)
    yield f"  {d.name}: {yaml_value(d.default)}{unit}"
    for text in (d.meaning, f"({facts})"):
        yield from textwrap.wrap(
            text, WIDTH, initial_indent="      ", subsequent_indent="      ", break_on_hyphens=False
        )
