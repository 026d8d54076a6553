"""The verdicts on the soak: what fails, what holds, and what the numbers cannot tell."""

import json
from pathlib import Path
from typing import Any

import pytest

from insdvl.studies.faults import page
from insdvl.studies.faults.verdicts import MEMORY_GROWTH, ROUNDING, Verdict, verdicts, worst

DOCS = Path(__file__).parents[3] / "docs"


def leg(
    number: int,
    of_filter: int,
    *,
    filter_mb: float | None = 200.0,
    tuner_mb: float = 100.0,
    latency: float | None = 10.0,
    lost: int = 0,
    mission: float = 3600.0,
) -> dict[str, Any]:
    """A leg as the soak records it; nothing was published where the memory is None."""
    sizes = {"filter": filter_mb, "tuner": tuner_mb}
    memory = {name: {"end": size, "slope": 0.0} for name, size in sizes.items()}
    return {
        "leg": number,
        "mission": mission,
        "rate_factor": 10.0,
        "held": 1.0,
        "wall": 400.0,
        "legs_of_filter": of_filter,
        "messages": [{"sent": 1000, "received": 1000 - lost}],
        "memory": None if filter_mb is None else memory,
        "latency": [{"p50": 5.0, "p99": 9.0}, {"p50": latency, "p99": latency}],
        "nis": 3.0,
        "body_velocity_rmse": 0.2,
    }


def life(**values: list[Any]) -> list[dict[str, Any]]:
    """The legs of a filter, one for each of the values."""
    rows = [dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)]
    return [leg(k, k + 1, **row) for k, row in enumerate(rows)]


HEALTH = {"asymmetry": 0.0, "smallest_eigenvalue": 0.04, "orthonormality": 4e-16}


def document(legs: list[dict[str, Any]] | None = None, **values: Any) -> dict[str, Any]:
    return {"search": [], "legs": legs or [], "core": [], "steps": {}} | values


def core_hour(samples: int = 100, outputs: int = 100, **health: float | None) -> dict[str, Any]:
    return {"samples": samples, "outputs": outputs, "health": HEALTH | health}


def verdict(found: dict[str, Any], beginning: str) -> Verdict:
    (only,) = [v for v in verdicts(found) if v.expected.startswith(beginning)]
    return only


MEMORY, LATENCY = "memory of the filter", "the median latency"


def test_without_numbers_nothing_is_judged() -> None:
    assert {v.holds for v in verdicts(document())} == {None}


def test_a_lost_message_fails() -> None:
    assert verdict(document([leg(0, 1)]), "no message").holds is True
    found = verdict(document([leg(0, 1), leg(1, 1, lost=1)]), "no message")
    assert (found.holds, found.seen) == (False, "1 of 2000")
    # What was received and never sent was counted wrong.
    assert verdict(document([leg(0, 1, lost=-1)]), "no message").holds is False


def test_a_single_leg_cannot_tell_of_growth() -> None:
    found = document([leg(0, 1, filter_mb=1e4, latency=1e4), leg(1, 1)])
    assert verdict(found, MEMORY).holds is verdict(found, LATENCY).holds is None


@pytest.mark.parametrize(("share", "holds"), [(-5.0, True), (0.99, True), (1.01, False)])
def test_memory_may_grow_by_a_gigabyte_in_a_month(share: float, holds: bool) -> None:
    assert pytest.approx(1000.0) == MEMORY_GROWTH * 30 * 24
    sizes = [200.0 + share * MEMORY_GROWTH * k for k in range(4)]
    flown = life(filter_mb=sizes)
    assert verdict(document(flown), MEMORY).holds is holds
    assert verdict(document(flown), "memory of the tuner").holds is True
    assert verdict(document(life(tuner_mb=sizes)), "memory of the tuner").holds is holds


def test_each_filter_is_judged_for_itself() -> None:
    flat, growing = life(filter_mb=[300.0, 301.0]), life(filter_mb=[500.0, 502.0, 504.0])
    assert verdict(document(flat + flat), MEMORY).holds is True
    # A filter that starts with more has not grown.
    assert verdict(document(flat + growing[:1]), MEMORY).holds is True
    found = verdict(document(growing + flat), MEMORY)
    assert found.holds is False
    assert found.seen == "+2.00 MB per hour over 2 h; +1.00 MB per hour over 1 h"


def test_an_hour_of_mission_must_lie_on_both_sides() -> None:
    halves = life(filter_mb=[100.0, 200.0, 200.5, 201.0], mission=[1800.0] * 4)
    assert verdict(document(halves[:3]), MEMORY).holds is None
    # The first hour, in which a filter takes what it needs, is no growth.
    assert verdict(document(halves), MEMORY).seen == "+1.00 MB per hour over 1 h"


@pytest.mark.parametrize(
    ("before", "after", "holds"),
    [
        (15.0, 30.0, True),  # twice
        (15.0, 30.1, False),
        (1.0, 11.0, True),  # eleven times, and 10 ms
        (1.0, 11.1, False),
        (15.0, 1.0, True),
    ],
)
def test_latency_may_grow_a_little_or_to_twice(before: float, after: float, holds: bool) -> None:
    found = verdict(document(life(latency=[before, 1000.0, after])), LATENCY)
    assert found.holds is holds
    assert found.seen == f"{before:.1f} ms, then {after:.1f} ms over 2 h"


def test_a_filter_that_fell_silent_fails() -> None:
    found = document(life(filter_mb=[200.0, None], latency=[10.0, None]))
    assert verdict(found, MEMORY).holds is verdict(found, LATENCY).holds is False


def test_the_core_publishes_each_sample() -> None:
    assert verdict(document(core=[core_hour()]), "the core").holds is True
    # One too many in an hour does not make up for one that is missing in another.
    hours = [core_hour(outputs=99), core_hour(outputs=101)]
    assert verdict(document(core=hours), "the core").holds is False


@pytest.mark.parametrize(
    ("health", "holds"),
    [
        ({}, True),
        ({"asymmetry": 2 * ROUNDING}, False),
        ({"orthonormality": 2 * ROUNDING}, False),
        ({"asymmetry": ROUNDING, "orthonormality": ROUNDING}, True),
        ({"smallest_eigenvalue": 0.0}, False),
        ({"orthonormality": None}, False),
    ],
)
def test_one_bad_number_is_enough(health: dict[str, float | None], holds: bool) -> None:
    hours = document(core=[core_hour(), core_hour(**health), core_hour()])
    assert verdict(hours, "P is symmetric").holds is holds
    steps = document(steps={"one": [HEALTH], "other": [HEALTH, HEALTH | health]})
    assert verdict(steps, "P is symmetric").holds is holds


def test_the_worst_of_many() -> None:
    other = {"asymmetry": 1e-12, "smallest_eigenvalue": 0.5, "orthonormality": None}
    assert worst([HEALTH, other]) == {
        "asymmetry": 1e-12,
        "smallest_eigenvalue": 0.04,
        "orthonormality": None,
    }


def test_the_page_tells_each_verdict() -> None:
    recorded = json.loads((DOCS / "reliability" / "soak.json").read_text())
    recorded["legs"] = life(filter_mb=[200.0, 300.0], lost=[1, 0])
    recorded["core"], recorded["steps"] = [], {"a filter": [HEALTH | {"asymmetry": None}]}
    text = page.markdown({"soak": recorded})
    assert "| no message is lost | 1 of 2000 | **no** |" in text
    assert "| +100.00 MB per hour over 1 h | **no** |" in text
    assert "| +0.00 MB per hour over 1 h | yes |" in text
    assert (
        "| the core alone publishes an odometry for each sample | no hour was flown | not" in text
    )
    assert "**Of 6 expectations 2 hold, 3 do not, and 1 cannot be judged.**" in text
    assert "| a filter | 1 million | not finite |" in text
