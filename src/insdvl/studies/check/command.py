"""The command `insdvl check`: a recording is looked at, and judged for the filter."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from insdvl.jobs.progress import Progress
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError
from insdvl.parameters.files import read
from insdvl.parameters.sections import full_name, nothing_for, reaches
from insdvl.parameters.settings import load_set, settings
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.parameters import ReplayParameters
from insdvl.studies.check.answers import answers
from insdvl.studies.check.findings import FILTER, REPLAY, is_usable
from insdvl.studies.check.inspection import Inspection, inspect
from insdvl.studies.check.text import document_of, text_of
from insdvl.studies.check.topics import READ
from insdvl.studies.document import check_place, tell

#: The nodes whose parameters are used here.
GROUPS = {FILTER: FilterParameters, REPLAY: ReplayParameters}


def run(arguments: argparse.Namespace) -> int:
    """Check; the exit code is 1 where the recording is not usable, 2 where it cannot be read."""
    try:
        check_place(arguments.json)
        filter_, replay = parameters_of(arguments.config or [], arguments.set)
        adapt = arguments.config is None and not arguments.set
        seen = looked_at(arguments, filter_, replay, adapt=adapt)
        found = answers(seen)
        name = str(arguments.bag)
        tell(arguments.json, document_of(name, seen, found), text_of(name, seen, found))
    except (ValueError, OSError) as error:
        for line in str(error).splitlines():
            print(f"insdvl check: {line}", file=sys.stderr)
        return 2
    return 0 if is_usable(found) else 1


def parameters_of(
    paths: Sequence[Path], rules: Sequence[str]
) -> tuple[FilterParameters, ReplayParameters]:
    """By files and settings; one of the files must be for the filter.

    Raises:
        ParameterError: Values are refused; a line for each fault.
    """
    files = read(paths)
    faults: list[str] = []
    told = settings(rules, GROUPS, faults)
    name = full_name(files, FILTER)
    if files and not any(reaches(file, [name]) for file in files):
        raise ParameterError(nothing_for(files[0], [name]))
    of_filter, of_replay = FilterParameters(), ReplayParameters()
    try:
        of_filter = load_set(files, name, FilterParameters, told[FILTER]).parameters
    except ParameterError as error:
        faults += str(error).splitlines()
    try:
        replay_name = full_name(files, REPLAY)
        of_replay = load_set(files, replay_name, ReplayParameters, told[REPLAY]).parameters
    except ParameterError as error:
        faults += str(error).splitlines()
    if faults:
        raise ParameterError("\n".join(faults))
    return of_filter, of_replay


def looked_at(
    arguments: argparse.Namespace,
    filter_: FilterParameters,
    replay: ReplayParameters,
    *,
    adapt: bool,
) -> Inspection:
    """See `inspect`; on a terminal with its progress.

    Args:
        arguments: With the recording, and the part of it that is looked at.
        filter_: See `inspect`.
        replay: See `inspect`.
        adapt: See `inspect`.

    Raises:
        BagError: The recording cannot be read.
    """
    with BagReader(arguments.bag, arguments.begin, arguments.end) as bag:
        if not sys.stderr.isatty():
            return inspect(bag, filter_, replay, adapt=adapt)
        size = sum(topic.size for topic in bag.topics.values() if topic.type in READ)
        with Progress("messages", size) as progress:
            seen = inspect(bag, filter_, replay, adapt=adapt, show=progress.show)
            progress.show(size)
            return seen
