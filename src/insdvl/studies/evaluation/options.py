"""Checks of the options that the commands of the evaluation share."""

import argparse
from collections.abc import Collection, Iterable

from insdvl.studies.evaluation.comparison import MIN_RUNS


def check_numbers(arguments: argparse.Namespace) -> None:
    """Refuse --runs and --tuning-runs without an interval, and a negative --seed.

    Raises:
        ValueError: One is out of its range.
    """
    for option, value in ("--runs", arguments.runs), ("--tuning-runs", arguments.tuning_runs):
        if value is not None and value < MIN_RUNS:
            raise ValueError(f"{option} must be >= {MIN_RUNS}, got {value}")
    if arguments.seed < 0:
        raise ValueError(f"--seed must be >= 0, got {arguments.seed}")


def check_names(option: str, values: Iterable[str], known: Collection[str]) -> None:
    """Refuse a name that is not known.

    Raises:
        ValueError: The first of them, and those that are known.
    """
    for value in values:
        if value not in known:
            raise ValueError(f"{option}: unknown name {value!r}; known are {', '.join(known)}")
