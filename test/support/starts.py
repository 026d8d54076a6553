"""Starts of a node with one set of arguments after the other, all in one process."""

import json
import subprocess
import sys
from collections.abc import Sequence
from typing import NamedTuple

_SCRIPT = """
import json
import sys
from importlib import import_module
from ros_insdvl.execution import run_node

module, name = sys.argv[1:]
factory = getattr(import_module(module), name)
for line in sys.stdin:
    sys.argv = [name, "--ros-args", *json.loads(line)]
    print("CODE", run_node(factory), flush=True)
    print("CODE", file=sys.stderr, flush=True)
"""


class Start(NamedTuple):
    """Exit code and output of a start."""

    code: int
    out: str
    err: str


def starts(module: str, node: str, arguments: Sequence[Sequence[str]]) -> list[Start]:
    """Each start of a node, as its executable makes it."""
    result = subprocess.run(
        [sys.executable, "-c", _SCRIPT, module, node],
        input="\n".join(map(json.dumps, arguments)),
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    found, out = [], ""
    errors = result.stderr.split("CODE\n")
    for line in result.stdout.splitlines():
        if line.startswith("CODE "):
            found.append(Start(int(line.removeprefix("CODE ")), out, errors[len(found)]))
            out = ""
        else:
            out += line + "\n"
    return found
