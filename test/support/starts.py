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

main = import_module(sys.argv[1]).main
for line in sys.stdin:
    sys.argv = ["node", "--ros-args", *json.loads(line)]
    try:
        code = main()
    except SystemExit as end:
        code = end.code
    print("CODE", code, flush=True)
    print("CODE", file=sys.stderr, flush=True)
"""


class Start(NamedTuple):
    """Exit code and output of a start."""

    code: int
    out: str
    err: str


def starts(module: str, arguments: Sequence[Sequence[str]]) -> list[Start]:
    """Each start of the node of a module, as its executable makes it."""
    result = subprocess.run(
        [sys.executable, "-c", _SCRIPT, module],
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
