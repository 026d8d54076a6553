"""All states of a recording, which `insdvl replay` does not keep."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Records
from insdvl.navigation.filter import LAYOUT, Filter
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.base import Raw
from insdvl.recordings.played import Recording
from insdvl.studies.replay.consumer import Consumer
from insdvl.studies.replay.fold import Replayed, fold_recording


class States(Consumer):
    """Keeps all states.

    Attributes:
        parts: Those of each part between time jumps.
    """

    def __init__(self) -> None:
        self.parts: list[Records] = []
        self._bytes: list[bytes] = []

    def take(self, filter_: Filter, states: Records) -> None:
        self._bytes.append(np.ascontiguousarray(states).view(np.uint8).tobytes())

    def end(self) -> None:
        self.parts.append(np.frombuffer(b"".join(self._bytes), LAYOUT.dtype))
        self._bytes = []


class Whole(NamedTuple):
    """A folded recording and its states, those of the last part and those of all parts."""

    replayed: Replayed
    states: Records
    parts: list[Records]


def fold_whole(recording: Recording | Sequence[Raw], parameters: FilterParameters) -> Whole:
    """See `fold_recording`."""
    states = States()
    replayed = fold_recording(recording, parameters, [states])
    return Whole(replayed, states.parts[-1], states.parts)
