"""The command `insdvl`: its subcommands, each in the module that does the work."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from insdvl.extras import MissingPackageError

#: Module of each subcommand, with add_arguments(parser) and run(arguments) -> exit code, and what
#: it does. Only the module that is asked for is imported.
COMMANDS = {
    "train": (
        "insdvl.studies.training.command",
        "learn a model of the process noise from simulations",
    ),
    "replay": ("insdvl.studies.replay.command", "run the filter over a rosbag2 recording"),
    "evaluate": (
        "insdvl.studies.evaluation.command",
        "compare sources of process noise on simulations",
    ),
    "results": ("insdvl.studies.evaluation.results", "compute the page of results again"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit code is 0, 2 where the input is refused, 1 on any other failure."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    parser = argparse.ArgumentParser(prog="insdvl", description="INS/DVL navigation without ROS.")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND")
    asked = next((word for word in given if not word.startswith("-")), None)
    for name, (module, meaning) in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=meaning, description=meaning)
        if name == asked:
            try:
                command = import_module(module)
            except MissingPackageError as error:
                print(f"insdvl {name}: {error}", file=sys.stderr)
                return 2
            command.add_arguments(subparser)
    parsed = parser.parse_args(given)
    if parsed.version:
        print(f"insdvl {version('insdvl')}")
        return 0
    if parsed.command is None:
        parser.error(f"a command is needed: {', '.join(COMMANDS)}")
    return int(command.run(parsed))


if __name__ == "__main__":
    sys.exit(main())
