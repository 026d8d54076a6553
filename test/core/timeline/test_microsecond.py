"""The state is continuous in the stamps: a microsecond changes the velocity by next to nothing."""

from functools import cache

import numpy as np
import pytest

from insdvl.simulation.grades import GRADES
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
DURATION = 30.0  # s; changes are largest at the start, where the corrections are


@cache
def case(grade: str) -> Case:
    return Case(GRADES[grade], 1.0, duration=DURATION)


@pytest.mark.parametrize("stream", STREAMS)
@pytest.mark.parametrize("grade", ["fog", "mems"])
def test_a_microsecond_changes_next_to_nothing(grade: str, stream: str) -> None:
    mission = mission_of(case(grade), SEED)
    before = velocities(case(grade), SEED, mission)
    for shift_ns in SHIFTS_NS:
        after = velocities(case(grade), SEED, mission, {stream: shift_ns})
        assert 0.0 < change(mission, before, after) < LIMIT


def test_a_shift_of_a_sample_is_seen() -> None:
    """So the limit is one that can be missed: 10 ms of the DVL change more than it."""
    mission = mission_of(case("fog"), SEED)
    before = velocities(case("fog"), SEED, mission)
    after = velocities(case("fog"), SEED, mission, {"dvl": 10_000_000})
    # Behind the shifted ping, and before the next one.
    assert change(mission, before, after) > 10.0 * LIMIT
    assert np.isfinite(after).all()
