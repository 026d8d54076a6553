"""The fault matrix: its short form is met, its judge can say no, and the page is of its numbers."""

import weakref
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl.messages.topics import DVL, IMU
from insdvl.navigation.events import NS
from insdvl.studies.faults import changes, page, soak
from insdvl.studies.faults.changes import Change
from insdvl.studies.faults.checks import (
    Check,
    Pair,
    covered,
    nothing_refused,
    refused,
    rejoins,
    same_bits,
    used,
)
from insdvl.studies.faults.flight import Flight, fly, parameters_of
from insdvl.studies.faults.matrix import judged
from insdvl.studies.faults.rows import ROWS, base
from insdvl.studies.faults.rows.base import ONE_SEED, FlightRow
from insdvl.studies.faults.stream import Sensors, stream_of
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner

DOCS = Path(__file__).parents[3] / "docs"
SENSORS = Sensors()

#: Two rows, beside `make faults`, which has all of them.
SHORT = ("one copy with a stamp 10^6 s ahead", "clock set back by 500 s; jump_action reset")


def assert_met(row: FlightRow) -> None:
    result = judged(replace(row, seeds=ONE_SEED))
    assert result["met"], [check for check in result["checks"] if not check["met"]]
    assert result["lost"] == 0


@pytest.mark.long
@pytest.mark.parametrize("name", SHORT)
def test_short_form(name: str) -> None:
    assert_met(next(row for row in ROWS if row.name == name))


def test_a_row_of_an_early_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of the matrix as it is, but for the time of the fault: a third of the mission."""
    monkeypatch.setattr(base, "END", 0.0)
    row = next(row for row in ROWS if row.name == SHORT[1])
    early = replace(row, change=changes.clock_step(20.0, -500.0), begin=20.0, end=20.0)
    assert early.duration < 70.0
    assert_met(early)


def test_rows_have_names_of_their_own() -> None:
    names = [(row.group, row.name) for row in ROWS]
    assert len(set(names)) == len(names)


@cache
def flown(change: Change = changes.unchanged, seed: int = 1) -> Flight:
    """Ten seconds."""
    stream = stream_of(SENSORS, 1, 10.0)
    parameters = parameters_of(stream.mission, SENSORS, seed, {})
    return fly(change(stream, np.random.default_rng(5)), parameters)


def judge(check: Check, change: Change) -> tuple[str, bool]:
    """A check of a fault from 4 to 5 s."""
    begin_ns = SENSORS.start_ns + 4 * NS
    return check.judge([Pair(flown(change), flown(), begin_ns, begin_ns + NS)])


def test_a_flight_repeats_to_the_bit() -> None:
    again = flown.__wrapped__()
    assert flown().digest == again.digest != flown(seed=2).digest


def test_a_valid_message_without_output_is_lost() -> None:
    assert flown().lost == 0
    assert flown(changes.late(IMU, 4.0, 5.0, delay=3.0, share=1.0)).lost == 100
    assert flown(changes.dropped(IMU, 4.0, 5.0)).lost == 0  # nobody has sent it
    unstamped = changes.edited(DVL, 3.9, 5.1, changes.stamped(0, 0), valid=True)
    assert flown(unstamped).lost == 2


def test_checks_say_no() -> None:
    gap = changes.dropped(IMU, 4.0, 4.05)
    copies = changes.added(IMU, 4.0, 5.0, lambda message: message)
    unstamped = changes.added(IMU, 4.0, 5.0, changes.stamped(0, 0))
    both = changes.all_of(copies, unstamped)
    assert judge(same_bits(), copies)[1] and not judge(same_bits(), gap)[1]
    assert judge(nothing_refused(), gap)[1] and not judge(nothing_refused(), copies)[1]
    assert judge(refused("duplicate", IMU), copies) == ("`duplicate` 100 of 100", True)
    assert not judge(refused("no_stamp", IMU), both)[1]
    assert not judge(rejoins(), changes.dropped(DVL, 0.0, 10.0))[1]


def test_sigma_that_does_not_tell_the_error_is_not_met() -> None:
    calm = flown()

    def met(sigmas: float, samples: int) -> bool:
        error = 0.5 * calm.sigma
        error[-samples:, 1] = sigmas * calm.sigma[-samples:, 1]
        flight = replace(calm, error=error)
        return covered().judge([Pair(flight, calm, SENSORS.start_ns, int(calm.times_ns[-1]))])[1]

    assert met(2.9, 1000)
    assert met(4.9, 100)  # 3 % of the three axes
    assert not met(4.9, 200)
    assert met(5.9, 1)
    assert not met(6.1, 1)


def test_measurements_used_are_counted_within_the_fault() -> None:
    again = changes.second_publisher(3.9, 5.9, 0.001, DVL, decimals=3)
    assert judge(used(2), again) == ("2 used", True)
    assert not judge(used(2), changes.unchanged)[1]


def test_a_clock_that_is_set_back_is_the_one_from_before() -> None:
    stream = stream_of(SENSORS, 1, 10.0)
    there = changes.clock_step(4.0, 1000.0)
    change = changes.all_of(there, changes.clock_step(5.0, -1000.0))
    moved = change(stream, np.random.default_rng(5))
    assert [epoch.stamp_ns for epoch in moved.epochs] == [0, 1000 * NS, 0]
    assert moved.arrivals[-1] == stream.arrivals[-1]


def test_the_last_stamps_are_just_below_2_to_31_seconds() -> None:
    (row,) = [row for row in ROWS if row.name == "stamps up to 2^31 s"]
    assert 0 < 2**31 * NS - (row.sensors.start_ns + round(row.duration * NS)) < NS


def test_a_tuner_tells_what_it_learns_from_the_faulted_messages() -> None:
    sensors = Sensors(learned=True)
    stream = stream_of(sensors, 1, 10.0)
    assert {arrival.topic for arrival in stream.arrivals} == {IMU, DVL}
    parameters = parameters_of(
        stream.mission, sensors, 1, {"process_noise.source": "external", "q_timeout": 2.5}
    )

    def timeouts(change: Change) -> int:
        faulted = change(stream, np.random.default_rng(5))
        return fly(faulted, parameters, Tuner(TunerParameters())).counts["q_timeouts"]

    assert timeouts(changes.unchanged) == 0
    # What the filter does not get, or refuses, the tuner does not learn from either: it has no
    # whole window for two seconds.
    not_finite = changes.triad(changes.FORCE, lambda f: f * np.nan)
    assert timeouts(changes.dropped(IMU, 4.0, 5.0)) == 1
    assert timeouts(changes.edited(IMU, 4.0, 5.0, not_finite)) == 1


def test_recovery_is_the_time_until_the_calm_flight_is_met_again() -> None:
    calm = flown()
    begin_ns, end_ns = SENSORS.start_ns + 4 * NS, SENSORS.start_ns + 5 * NS

    def recovery(far: Any) -> float | None:
        v_b = calm.v_b.copy()
        v_b[far(calm.times_ns - end_ns)] += 0.06
        return Pair(replace(calm, v_b=v_b), calm, begin_ns, end_ns).recovery()

    assert recovery(lambda t: t < 0) == 0.0
    assert recovery(lambda t: (t >= 0) & (t <= 2 * NS)) == pytest.approx(2.01)
    assert recovery(lambda t: t >= 0) is None


def test_the_page_in_docs_is_the_one_of_its_numbers() -> None:
    found = page.documents(DOCS / "reliability")
    assert (DOCS / "reliability.md").read_text() == page.markdown(found)


def test_the_page_names_what_is_not_met_and_what_is_missing() -> None:
    row = {
        "group": "IMU",
        "fault": "a fault",
        "error_during": 0.1234,
        "error_during_calm": 0.1,
        "error_after": None,
        "error_after_calm": None,
        "recovery": 2.0,
        "lost": 3,
        "checks": [
            {"expected": "this", "seen": "that", "met": False},
            {"expected": "no loss", "seen": "none", "met": True, "always": True},
        ],
        "met": False,
    }
    text = page.markdown({"messages": {"rows": [row]}})
    assert "| a fault | this | **that** | 0.123 (0.100) | – | 2.0 | 3 | **no** |" in text
    assert "**0 of 1 rows are met; valid messages lost: 3.**" in text
    assert "Not computed: processes." in text and "Not computed: soak." in text


def test_the_core_soaks() -> None:
    hours = list(soak.flown_hours(2, duration=12.0))
    for hour in hours:
        assert hour.samples == hour.outputs == 1200
        assert hour.body_velocity_rmse < 0.3
        assert 1.0 < hour.nis < 8.0
        assert hour.health.asymmetry < 1e-12 and hour.health.orthonormality < 1e-12
        assert 1e-12 < hour.health.smallest_eigenvalue < 1.0


def test_the_mission_of_an_hour_is_gone_at_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes more than filter and tuner, and would be counted as theirs."""
    made: list[weakref.ref[Any]] = []
    simulated = soak.hour

    def hour(number: int, duration: float) -> Any:
        assert all(mission() is None for mission in made)
        mission = simulated(number, duration)
        made.append(weakref.ref(mission))
        return mission

    monkeypatch.setattr(soak, "hour", hour)
    for number, _ in enumerate(soak.flown_hours(2, duration=2.0)):
        assert len(made) == number + 1
        assert made[number]() is None
