"""Outages of DVL and IMU in a replay: incidents with their times, and findings."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from looked_at import START_NS, flown, raws_of

from insdvl.messages.topics import DVL, IMU
from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.base import Raw, encode, stamp_ns
from insdvl.recordings.messages import twist_message
from insdvl.simulation.grades import GRADES
from insdvl.simulation.trajectories import STATIC
from insdvl.studies.judgement.incidents import Incident, incidents_of
from insdvl.studies.judgement.outages import (
    Outage,
    Outages,
    of_dvl_outages,
    of_imu_outages,
    outages_of,
)
from insdvl.studies.judgement.verdict import Verdict, verdict
from insdvl.studies.replay.fold import Replayed, fold_recording
from insdvl.studies.replay.scores import report

TOPICS = {"/imu": IMU, "/dvl": DVL, "/truth": "ground_truth/odometry"}
VARIANCES = GRADES["tactical"].variances().tolist()
#: The vehicle and its instruments as they are.
RIGHT = {
    "initial.mode": "topic",
    "dvl.noise_std": (0.02,) * 3,
    "process_noise.accelerometer_variance": tuple(VARIANCES[:3]),
    "process_noise.gyroscope_variance": tuple(VARIANCES[3:]),
}
SECONDS = 120.0


def since(raw: Raw) -> float:
    return (raw.time_ns - START_NS) / NS


@pytest.fixture(scope="module")
def raws() -> list[Raw]:
    return [raw._replace(topic=TOPICS[raw.topic]) for raw in raws_of(flown(SECONDS))]


def without(raws: list[Raw], topic: str, is_lost: Callable[[float], bool]) -> list[Raw]:
    return [raw for raw in raws if raw.topic != topic or not is_lost(since(raw))]


def folded(raws: list[Raw], **parameters: Any) -> tuple[Replayed, FilterParameters]:
    told = build(FilterParameters, RIGHT | parameters)
    return fold_recording(raws, told), told


def judged(raws: list[Raw]) -> Verdict:
    replayed, told = folded(raws)
    return verdict(replayed, told, report(replayed))


def lost(raws: list[Raw], sensor: str = "dvl", **parameters: Any) -> list[Incident]:
    incidents = incidents_of(folded(raws, **parameters)[0])
    return [incident for incident in incidents if incident.name == f"{sensor} outage"]


def times(incidents: list[Incident]) -> list[tuple[float, float]]:
    """Begin and end of each, since the recording began [s]."""
    start = START_NS / NS
    return [(round(i.begin - start, 1), round(i.end - start, 1)) for i in incidents]


def test_without_an_outage_none_is_told(raws: list[Raw]) -> None:
    """Also not for the stretches that the verdict withholds."""
    found = judged(raws)
    assert [w["seconds"] for w in found.numbers["withheld"]] == [10.0, 30.0, 60.0]
    assert found.numbers["dvl_outages"]["count"] == 0
    assert lost(raws) == lost(raws, "imu") == []
    assert "not used" not in found.judgement


def test_an_outage_of_the_dvl_is_an_incident_with_begin_and_end(raws: list[Raw]) -> None:
    short = without(raws, DVL, lambda t: 20.5 < t < 24.5 or 50.5 < t < 60.5)
    assert times(lost(short)) == [(50.0, 61.0)]
    found = judged(short)
    assert found.numbers["dvl_outages"]["longest"] == pytest.approx(11.0, abs=0.1)
    assert [finding.name for finding in found.findings] == []
    assert "; the DVL was not used for 11 s" in found.judgement
    # At the end, at the beginning of a filter that knows its state, and refused by name.
    assert times(lost(without(raws, DVL, lambda t: t > 90.5))) == [(90.0, SECONDS)]
    (late,) = times(lost(without(raws, DVL, lambda t: t < 40.5)))
    assert late == (pytest.approx(0.0, abs=0.1), 41.0)
    assert len(lost(raws, **{"dvl.max_speed": 0.05})) == 1


def test_most_of_the_time_under_way_without_a_dvl_is_a_finding(raws: list[Raw]) -> None:
    for end, names in ((65.5, []), (55.5, ["dvl_outage"])):
        found = judged(without(raws, DVL, lambda t, end=end: t > end))
        assert [f.name for f in found.findings if f.name.endswith("outage")] == names
    assert found.judgement.startswith("NOT RIGHT: the DVL was not used for 65 of 120 s under way")
    assert "(from 55 to 120 s)" in found.judgement


def test_a_dvl_that_pings_every_five_seconds_is_not_lost_between_two_pings(raws: list[Raw]) -> None:
    """A fifth of a ping a second: the third interval without one is an outage."""
    slow = without(raws, DVL, lambda t: round(t) % 5 != 0)
    assert lost(slow) == []
    assert lost(without(slow, DVL, lambda t: 41.0 < t < 54.0)) == []
    assert times(lost(without(slow, DVL, lambda t: 41.0 < t < 64.0))) == [(40.0, 65.0)]


def test_one_good_ping_in_many_is_no_slow_dvl(raws: list[Raw]) -> None:
    """The others have no bottom lock, which their driver marks."""
    marked = []
    for raw in raws:
        if raw.topic == DVL and round(since(raw)) % 20:
            bad = twist_message(stamp_ns(raw), "dvl", (np.nan,) * 3)
            raw = encode(raw.topic, raw.time_ns, bad)
        marked.append(raw)
    assert len(lost(marked)) == 6


def test_a_vehicle_at_rest_needs_no_dvl() -> None:
    """Its speed drifts meanwhile; where it moves behind the outage it was under way."""
    still = [raw._replace(topic=TOPICS[raw.topic]) for raw in raws_of(flown(60.0, STATIC))]
    replayed, _ = folded(without(still, DVL, lambda t: t > 10.5))
    found = outages_of(replayed)
    assert len(found.dvl) == 1
    assert (found.under_way, found.lost) == (0.0, 0.0)
    assert list(of_dvl_outages(found)) == []


@pytest.mark.parametrize(
    ("is_lost", "expected", "named"),
    [
        (lambda t: t > 100.0, (100.0, 120.0), False),
        (lambda t: t > 50.0, (50.0, 120.0), True),
        (lambda t: t < 20.0, (0.0, 20.0), False),
        (lambda t: t < 70.0, (0.0, 70.0), True),
        (lambda t: t > 116.0, None, False),
    ],
)
def test_an_imu_that_starts_late_or_stops_is_told(
    is_lost: Callable[[float], bool],
    expected: tuple[float, float] | None,
    named: bool,
    raws: list[Raw],
) -> None:
    """By the messages of the DVL, whatever the clock of the recorder is."""
    slow = [
        raw._replace(time_ns=raw.time_ns - START_NS // 2)
        for raw in without(raws, IMU, is_lost)
        if raw.topic in (IMU, DVL)
    ]
    replayed, _ = folded(slow, **{"initial.mode": "auto"})
    found = [i for i in incidents_of(replayed) if i.name == "imu outage"]
    if expected is None:
        assert found == []
    else:
        np.testing.assert_allclose(times(found), [expected], atol=1.1)
    findings = list(of_imu_outages(outages_of(replayed)))
    assert ["imu_outage"] * named == [finding.name for finding in findings]
    assert all("look for why its driver stopped" in finding.remedy for finding in findings)


def test_the_imu_is_missed_for_a_minute_of_a_long_recording() -> None:
    for seconds, count in ((59.0, 0), (60.0, 1)):
        found = Outages(imu=[Outage(900.0, 900.0 + seconds)], begin=0.0, recorded=1000.0)
        assert len(list(of_imu_outages(found))) == count


def test_an_imu_that_ends_is_the_cause_of_what_is_refused_behind_its_end(raws: list[Raw]) -> None:
    """Most pings are far ahead of the last sample, which is told after the IMU."""
    stopped = without(raws, IMU, lambda t: t > 35.0)
    replayed, told = folded(stopped, **{"jump_limit": 10.0, "imu.rate": 1000.0})
    found = verdict(replayed, told, report(replayed))
    assert [finding.name for finding in found.findings[:2]] == ["imu_outage", "refused"]
    assert found.judgement.startswith("NOT RIGHT: the IMU is missing for 85 of 120 s")
