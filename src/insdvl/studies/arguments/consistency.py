"""The arguments of `insdvl consistency`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from insdvl.commands import examples, unknown_names
from insdvl.jobs.arguments import add_worker_options, worker_faults
from insdvl.studies.arguments.evaluation import MIN_RUNS

#: The names of the studies in page.py; a test holds that they are the same.
STUDIES = ("blocks", "position", "outage", "gyrocompassing", "heading", "sensitivity")
NAME = "consistency"
RUNS, QUICK_RUNS = 100, 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "consistency --studies blocks,position --jobs 2",
        "consistency --quick --out docs/results",
    )
    parser.set_defaults(faults=_faults)
    names = ", ".join(STUDIES)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("docs", "results"),
        metavar="DIR",
        help=f"folder of {NAME}.md and {NAME}.json (default: ./docs/results)",
    )
    parser.add_argument(
        "--studies",
        metavar="NAME,NAME",
        help="studies to compute, separated by commas, or 'none' to write the page only (default: "
        f"all): {names}; the numbers of the others are kept",
    )
    parser.add_argument(
        "--runs",
        type=int,
        metavar="N",
        help=f"number of runs of each row (default: {RUNS}, or {QUICK_RUNS} with --quick)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="leave out rows that another one resembles"
    )
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: 1)")
    add_worker_options(parser)


def _faults(arguments: argparse.Namespace) -> Iterator[str]:
    if arguments.studies not in (None, "none"):
        yield from unknown_names("--studies", arguments.studies.split(","), STUDIES)
    if arguments.runs is not None and arguments.runs < MIN_RUNS:
        yield f"--runs must be >= {MIN_RUNS}, got {arguments.runs}"
    if arguments.seed < 0:
        yield f"--seed must be >= 0, got {arguments.seed}"
    yield from worker_faults(arguments)
