"""The folder of a result: a rosbag2 recording with the tables and numbers beside it."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from insdvl.arrays import Records
from insdvl.extras import MissingPackageError
from insdvl.files import json_text
from insdvl.messages.feed import Feed
from insdvl.navigation.filter import Filter
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw
from insdvl.studies.replay.consumer import Consumer, initialised
from insdvl.studies.replay.fold import Replayed
from insdvl.studies.replay.output_bag import OutputBag
from insdvl.studies.replay.tables import (
    csv_text,
    reference_columns,
    track_columns,
    tum_text,
    updates_text,
)
from insdvl.studies.replay.track import Choice, TrackColumns, track_of
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


class Output(Consumer):
    """A result in the making; a context manager, see `BagWriter`.

    Args:
        path: The folder; it must not exist.
        parameters: Of the filter.
        rate: Of the states that are written [Hz]; 0 for one at each sample.

    Raises:
        BagError or OSError: The folder cannot be made.
    """

    def __init__(self, path: Path, parameters: FilterParameters, rate: float) -> None:
        self._path, self._parameters, self._rate = path, parameters, rate
        self._part, self._choice = 0, Choice(rate)
        self._held: TrackColumns | None = None  # the last state, while it is not written

    def __enter__(self) -> "Output":
        with ExitStack() as stack:
            self._bag = stack.enter_context(BagWriter(self._path, name=BAG, compressed=True))
            self._csv, self._tum = (
                stack.enter_context((self._bag.folder / name).open("w", encoding="utf-8"))
                for name in (TRACK, TUM)
            )
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def begin(self, feed: Feed) -> None:
        """See `Consumer`."""
        self._output = OutputBag(self._bag, self._parameters, feed)

    def messages(self, raws: Sequence[Raw]) -> None:
        """See `Consumer`."""
        self._output.messages(raws)

    def take(self, filter_: Filter, states: Records) -> None:
        """See `Consumer`."""
        for known in initialised(states):
            ks = self._choice.of(known["nav"]["time_ns"])
            if ks.size:
                self._write(track_of(filter_, known, ks, self._part))
            last, self._held = len(known) - 1, None
            if not ks.size or ks[-1] != last:
                self._held = track_of(filter_, known, np.array([last]), self._part)

    def end(self) -> None:
        """See `Consumer`; the last state is written in any case."""
        if self._held is not None:
            self._write(self._held)
        self._held, self._choice = None, Choice(self._rate)
        self._part += 1

    def _write(self, track: TrackColumns) -> None:
        self._output.track(track)
        is_first = not self._csv.tell()
        self._csv.write(csv_text(track.stamps_ns, track_columns(track), names=is_first))
        self._tum.write(tum_text(track))

    def finish(self, replayed: Replayed, document: dict[str, Any]) -> str:
        """Write what is known at the end.

        Args:
            replayed: The result.
            document: The numbers.

        Returns:
            Why there is no report.html; empty where there is one.

        Raises:
            BagError or OSError: The disk cannot be written.
        """
        self._csv.close()
        self._tum.close()
        self._output.updates(replayed.fold.filter, replayed.updates)
        texts = {UPDATES: updates_text(replayed.updates), NUMBERS: json_text(document)}
        at = replayed.at_reference
        if (columns := reference_columns(at)) is not None:
            texts[REFERENCE] = csv_text(at.stamps_ns, columns)
        for name, text in texts.items():
            (self._bag.folder / name).write_text(text, encoding="utf-8")
        return _write_report(self._bag.folder, self._path.name)


def _write_report(folder: Path, title: str) -> str:
    try:
        page = page_of([read_result(folder, title)])
    except MissingPackageError as error:
        return str(error)
    (folder / REPORT).write_text(page, encoding="utf-8")
    return ""
