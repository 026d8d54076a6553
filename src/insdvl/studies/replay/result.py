"""The folder of a result: a rosbag2 recording with the tables and numbers beside it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from insdvl.extras import MissingPackageError
from insdvl.files import json_text
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw
from insdvl.studies.replay.fold import Replayed
from insdvl.studies.replay.output_bag import write_bag
from insdvl.studies.replay.scores import truth_of
from insdvl.studies.replay.tables import (
    csv_text,
    reference_columns,
    track_columns,
    tum_text,
    updates_text,
)
from insdvl.studies.replay.track import track_of
from insdvl.studies.report.page import page_of
from insdvl.studies.report.results import (
    NUMBERS,
    REFERENCE,
    REPORT,
    TRACK,
    UPDATES,
    read_result,
)

TUM = "track.tum"
BAG = "result"  # name of the data file


def new_folder(bag: Path) -> Path:
    """A folder in the working directory that does not exist, named after a recording."""
    name = f"{bag.resolve().stem}-replay"
    path, number = Path(name), 2
    while path.exists() or path.is_symlink():
        path, number = Path(f"{name}-{number}"), number + 1
    return path


def write_result(
    path: Path,
    recording: Sequence[Raw],
    replayed: Replayed,
    parameters: FilterParameters,
    document: dict[str, Any],
    rate: float,
) -> str:
    """Write the folder, completely or not at all.

    Args:
        path: The folder; it must not exist.
        recording: What was folded.
        replayed: The result.
        parameters: Of the filter.
        document: The numbers.
        rate: Of the states that are written [Hz]; 0 for one at each sample.

    Returns:
        Why there is no report.html; empty where there is one.

    Raises:
        BagError or OSError: The disk cannot be written.
    """
    track = track_of(replayed, rate)
    with BagWriter(path, name=BAG, compressed=True) as bag:
        write_bag(bag, recording, replayed, parameters, track)
        texts = {
            TRACK: csv_text(track.stamps_ns, track_columns(track)),
            TUM: tum_text(track),
            UPDATES: updates_text(replayed.updates),
            NUMBERS: json_text(document),
        }
        reference = reference_columns(replayed.fold, *truth_of(recording))
        if reference is not None:
            texts[REFERENCE] = csv_text(*reference)
        for name, text in texts.items():
            (bag.folder / name).write_text(text, encoding="utf-8")
        return _write_report(bag.folder, path.name)


def _write_report(folder: Path, title: str) -> str:
    try:
        page = page_of([read_result(folder, title)])
    except MissingPackageError as error:
        return str(error)
    (folder / REPORT).write_text(page, encoding="utf-8")
    return ""
