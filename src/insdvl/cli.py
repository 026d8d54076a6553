"""The command `insdvl`, with each subcommand in a module of its own."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from insdvl.extras import MissingPackageError

#: Module and meaning of each subcommand. A module has add_arguments(parser) and run(arguments) ->
#: exit code; only the module of the given subcommand is imported.
COMMANDS = {
    "train": (
        "insdvl.studies.training.command",
        "train a process noise model on simulations",
    ),
    "replay": ("insdvl.studies.replay.command", "run the filter over a rosbag2 recording"),
    "report": ("insdvl.studies.report.command", "write the page of a replay, or of two"),
    "evaluate": (
        "insdvl.studies.evaluation.command",
        "compare sources of process noise on simulations",
    ),
    "results": ("insdvl.studies.results.command", "recompute the results page"),
    "consistency": (
        "insdvl.studies.consistency.command",
        "recompute the page on consistency: is the filter as good as it says?",
    ),
    "warm": ("insdvl.studies.warm", "compile all functions and cache them, for the first start"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit code is 0, or 2 if the input is refused, or 1 on other failures."""
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
        parser.error(f"no command given; choose from {', '.join(COMMANDS)}")
    return int(command.run(parsed))


if __name__ == "__main__":
    sys.exit(main())
