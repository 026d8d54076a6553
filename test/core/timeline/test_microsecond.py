"""The state is continuous in the stamps: a microsecond changes the velocity by next to nothing."""

from functools import cache

import numpy as np
import pytest

from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import Mission
from insdvl.studies.consistency.flights import Case
from insdvl.studies.consistency.sensitivity import (
    LIMIT,
    SHIFTS_NS,
    STREAMS,
    change,
    mission_of,
    velocities,
)

SEED = 95_000
DURATION = 20.0  # s; changes are largest at the start, where the corrections are


@cache
def flown(grade: str, stream: str = "", shift_ns: int = 0) -> tuple[Mission, np.ndarray]:
    """A mission, and its velocities with the stamps of a stream shifted."""
    case = Case(GRADES[grade], 1.0, duration=DURATION)
    mission = mission_of(case, SEED)
    return mission, velocities(case, SEED, mission, {stream: shift_ns} if stream else None)


@pytest.mark.parametrize("stream", STREAMS)
@pytest.mark.parametrize("grade", ["fog", "mems"])
def test_a_microsecond_changes_next_to_nothing(grade: str, stream: str) -> None:
    mission, before = flown(grade)
    for shift_ns in SHIFTS_NS:
        _, after = flown(grade, stream, shift_ns)
        assert np.isfinite(after).all()
        assert 0.0 < change(mission, before, after) < LIMIT


def test_a_shift_of_a_sample_is_seen() -> None:
    """So the limit is one that can be missed: 10 ms of the DVL change more than it."""
    mission, before = flown("fog")
    _, after = flown("fog", "dvl", 10_000_000)
    assert change(mission, before, after) > 10.0 * LIMIT
