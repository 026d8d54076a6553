"""Checks of options that several commands share."""

import argparse
from collections.abc import Collection, Iterable

from insdvl.commands import nearest
from insdvl.studies.evaluation.comparison import MIN_RUNS


def check_numbers(arguments: argparse.Namespace) -> None:
    """Check --runs, --tuning-runs and --seed.

    Raises:
        ValueError: One is out of range.
    """
    for option, value in ("--runs", arguments.runs), ("--tuning-runs", arguments.tuning_runs):
        if value is not None and value < MIN_RUNS:
            raise ValueError(f"{option} must be >= {MIN_RUNS}, got {value}")
    if arguments.seed < 0:
        raise ValueError(f"--seed must be >= 0, got {arguments.seed}")


def check_names(option: str, values: Iterable[str], known: Collection[str]) -> None:
    """Check that all names are known.

    Raises:
        ValueError: Names the first unknown value, and the known ones.
    """
    for value in values:
        if value not in known:
            raise ValueError(
                f"{option}: unknown name {value!r}{nearest(value, known)}; known are "
                f"{', '.join(known)}"
            )
