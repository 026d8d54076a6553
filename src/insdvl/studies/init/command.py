"""The command `insdvl init`: a parameter file, filled from a recording."""

import argparse
import sys

from insdvl.files import check_writable, write
from insdvl.parameters.settings import settings
from insdvl.studies.check.answers import answers
from insdvl.studies.check.command import GROUPS, looked_at, parameters_of
from insdvl.studies.check.findings import CHECK
from insdvl.studies.document import check_place, tell
from insdvl.studies.init.template import parameter_file, parameter_lines


def run(arguments: argparse.Namespace) -> int:
    """Write the file; the exit code is 1 where the recording is not usable, 2 for invalid input."""
    try:
        check_writable(arguments.out, "--out")
        check_place(arguments.json)
        filter_, replay = parameters_of([], arguments.set)
        seen = looked_at(arguments, filter_, replay, adapt=True)
        found = answers(seen)
        fatal = [finding.text for finding in found if finding.fatal]
        if fatal:
            print(f"insdvl init: {arguments.bag} is not usable: {' '.join(fatal)}", file=sys.stderr)
            return 1
        told = settings(arguments.set, GROUPS, [])
        lines = parameter_lines(seen, found, told)
        write(arguments.out, parameter_file(arguments.bag.name, lines).encode())
        document = {
            "bag": str(arguments.bag),
            "file": str(arguments.out),
            "parameters": {
                node: {line.name: {"value": line.value, "why": line.why} for line in of_node}
                for node, of_node in lines.items()
            },
        }
        said = f"{arguments.out}: look at the lines with {CHECK}, then insdvl replay "
        tell(arguments.json, document, f"{said}{arguments.bag} -c {arguments.out}")
    except (ValueError, OSError) as error:
        for line in str(error).splitlines():
            print(f"insdvl init: {line}", file=sys.stderr)
        return 2
    return 0
