"""The arguments of `insdvl report`."""

import argparse
from pathlib import Path

from insdvl.commands import examples


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples("report dive-replay", "report run1 run2 -o both.html")
    parser.add_argument(
        "results",
        type=Path,
        nargs="+",
        metavar="OUT",
        help="one or two folders that insdvl replay wrote",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="the page (default: report.html in the folder; of two, comparison.html in the working "
        "directory)",
    )
    for suffix in ("png", "pdf", "svg"):
        parser.add_argument(
            f"--{suffix}",
            type=Path,
            metavar="FILE",
            help=f"also draw the (first) result on one page of paper, as {suffix.upper()}",
        )
