"""What a recording gives to those who need something of it, while it is folded."""

from collections.abc import Iterator, Sequence

import numpy as np

from insdvl.arrays import Records
from insdvl.messages.feed import Feed
from insdvl.navigation.filter import Filter
from insdvl.recordings.base import Raw


class Consumer:
    """Takes what it needs of a recording while that is folded; by default nothing."""

    def begin(self, feed: Feed) -> None:
        """The filter is set up."""

    def messages(self, raws: Sequence[Raw]) -> None:
        """The next messages, in the recorded order."""

    def take(self, filter_: Filter, states: Records) -> None:
        """The next final states (N,), in the order of their stamps; they are valid now only."""

    def end(self) -> None:
        """The time of these states ends, by a time jump or with the recording."""


def initialised(states: Records) -> Iterator[Records]:
    """The runs of initialised states among states (N,), as views.

    A filter that has diverged gives up its state and starts again: then there are several.
    """
    known = states["nav"]["initialised"] != 0
    ends = np.flatnonzero(np.diff(known, prepend=False, append=False))
    for first, last in ends.reshape(-1, 2).tolist():
        yield states[first:last]
