"""The option of every command that has its result as numbers: where they go."""

import argparse
from pathlib import Path

#: As an output file: standard output.
TERMINAL = Path("-")


def add_json_option(parser: argparse.ArgumentParser, *, alone: bool = False) -> None:
    """Declare --json.

    Args:
        parser: Of the command.
        alone: Whether the option may stand without a file, for standard output.
    """
    parser.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        nargs="?" if alone else None,
        const=TERMINAL if alone else None,
        help="write the result as JSON; - writes it to standard output, and nothing else",
    )
