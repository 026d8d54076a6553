"""A whole recording, folded at once."""

from collections.abc import Sequence

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import Event
from insdvl.navigation.parameters import FilterParameters
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult


def fold_arrays(
    parameters: FilterParameters,
    stamps_ns: Stamps,
    f_b: Array,
    w_ib_b: Array,
    events: Sequence[Event],
    every: int = 1,
) -> FoldResult:
    """Fold a whole recording: the states that `Fold` reaches when everything has arrived.

    Args:
        parameters: Of the filter.
        stamps_ns: (N,) stamps of the samples, strictly increasing.
        f_b: (N, 3) specific force [m/s^2], IMU axes, forward-right-down.
        w_ib_b: (N, 3) angular rate [rad/s], same axes.
        events: All other events, in any order.
        every: Of so many samples the whole state of the last one is kept.

    Raises:
        ValueError: The arrays do not fit, are not finite, or the stamps do not increase or step by
            more than jump_limit.
    """
    fold = Fold(parameters, max(len(stamps_ns), 1), every)
    refused = fold.add_recording(stamps_ns, f_b, w_ib_b, events)
    return FoldResult(
        filter=fold.filter,
        states=fold.states,
        track=fold.track,
        updates=fold.updates,
        counts=fold.counts,
        refused=refused,
    )
