"""The command `insdvl init`: a parameter file, filled from a recording."""

import argparse
import sys

from insdvl.files import check_writable, write
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.parameters import ReplayParameters
from insdvl.studies.check.answers import answers
from insdvl.studies.check.command import looked_at
from insdvl.studies.init.template import CHECK, parameter_file


def run(arguments: argparse.Namespace) -> int:
    """Write the file; the exit code is 1 where the recording is not usable, 2 for invalid input."""
    try:
        if arguments.out.exists():
            raise ValueError(f"--out {arguments.out} exists already and is not overwritten")
        check_writable(arguments.out, "--out")
        seen = looked_at(arguments.bag, FilterParameters(), ReplayParameters(), adapt=True)
        found = answers(seen)
        fatal = [finding.text for finding in found if finding.fatal]
        if fatal:
            print(f"insdvl init: {arguments.bag} is not usable: {' '.join(fatal)}", file=sys.stderr)
            return 1
        text = parameter_file(arguments.bag.name, seen, found)
        write(arguments.out, text.encode())
    except (ValueError, OSError) as error:
        print(f"insdvl init: {error}", file=sys.stderr)
        return 2
    print(
        f"{arguments.out}: look at the lines with {CHECK}, then insdvl replay {arguments.bag} "
        f"-c {arguments.out}"
    )
    return 0
