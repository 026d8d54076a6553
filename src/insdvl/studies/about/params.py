"""The command `insdvl params`: what a parameter means."""

import argparse
import sys
import textwrap
from collections.abc import Iterator

from insdvl.commands import nearest
from insdvl.parameters.declaration import Declaration, declarations
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
    for node, declared in found.items():
        if declared:
            print(f"{node}:")
        for declaration in declared:
            print("\n".join(_lines(declaration)))
    if any(found.values()):
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


def _lines(d: Declaration) -> Iterator[str]:
    """Name, default, unit and range; then the meaning."""
    unit = f" {d.unit}" if d.unit else ""
    facts = "; ".join(fact for fact in (d.type_name, d.range_text) if fact)
    yield f"  {d.name}: {yaml_value(d.default)}{unit}"
    for text in (d.meaning, f"({facts})"):
        yield from textwrap.wrap(
            text, WIDTH, initial_indent="      ", subsequent_indent="      ", break_on_hyphens=False
        )
