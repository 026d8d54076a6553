"""What a verdict says of heading, position and distance, and which of several causes is first."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recordings import record
from test_judgement import NS, RIGHT, TOPICS, flown, judged

from insdvl.arrays import Array
from insdvl.navigation.geometry.frames import rotation_from_rpy, rpy_from_rotation
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.base import decode, encode
from insdvl.recordings.played import Listed
from insdvl.studies.evaluation.metrics import Track, path_length
from insdvl.studies.judgement import pose
from insdvl.studies.judgement.innovations import CHANCE
from insdvl.studies.replay.part import Travelled
from insdvl.studies.replay.reference import AtReference, reference_of

COUNT = 400
DOCUMENT: dict[str, Any] = {"start": None, "counts": {"odom_resets": 0}}


def turned(yaw: Array) -> Array:
    return np.array([rotation_from_rpy(np.array([0.0, 0.0, angle])) for angle in yaw])


def against(
    heading: Array | float = 0.0,
    beside: Array | float = 0.0,
    *,
    heading_sigma: Array | float = 0.05,
    position_sigma: float = 1.0,
    offset: float = 0.0,
    told: tuple[float, float] = (0.0, 0.0),
    has_attitude: bool = True,
) -> AtReference:
    """A straight way of 400 m; heading [rad] and position [m] beside it are off by so much."""
    t = np.arange(COUNT, dtype=float)
    none = np.zeros(COUNT)
    yaw = 0.1 * np.sin(t)
    way = np.column_stack([t, none, none])
    off = np.column_stack([none, none + beside, none])
    sigma = np.full((COUNT, 6), position_sigma / math.sqrt(2.0))
    return AtReference(
        (t * NS).astype(np.int64),
        Track(turned(yaw if has_attitude else none), np.zeros((COUNT, 3)), way + offset),
        Track(turned(yaw + heading), np.zeros((COUNT, 3)), way + off),
        sigma,
        none + heading_sigma,
        np.tile(told, (COUNT, 1)),
    )


def findings(at: AtReference, document: dict[str, Any] = DOCUMENT) -> list[str]:
    parameters = build(FilterParameters, RIGHT)
    found = pose.of_pose(pose.against_reference(at), document, parameters)
    return [finding.name for finding in found]


def test_a_heading_and_a_position_that_are_off_by_many_sigmas_are_findings() -> None:
    assert findings(against()) == []
    assert findings(against(heading=math.pi - 0.1)) == ["heading_error"]
    assert findings(against(beside=np.linspace(0.0, 100.0, COUNT))) == ["position_error"]
    jumped = DOCUMENT | {"counts": {"odom_resets": 1}}
    assert findings(against(beside=np.linspace(0.0, 100.0, COUNT)), jumped) == []
    first_fix_off = np.where(np.arange(COUNT) == 0, 30.0, 0.0)
    assert findings(against(beside=first_fix_off)) == []
    both = against(heading=1.0, beside=np.linspace(0.0, 100.0, COUNT))
    first, second = pose.of_pose(
        pose.against_reference(both), DOCUMENT, build(FilterParameters, RIGHT)
    )
    assert first.text == (
        "the heading is 57.3 deg off the reference (RMSE), and the filter says a sigma of 2.9 deg"
    )
    assert second.name == "position_error" and second.remedy == "it follows from the heading"


def test_what_is_no_contradiction_is_no_finding() -> None:
    # Within its sigmas, and beyond them by less than what is installed with care leaves.
    assert findings(against(heading=0.2)) == []
    assert findings(against(heading=0.01, heading_sigma=1e-4)) == []
    assert findings(against(beside=np.linspace(0.0, 5.0, COUNT), position_sigma=0.01)) == []
    # The filter says that it does not know the heading, or did not when it was wrong.
    assert findings(against(heading=2.0, heading_sigma=1.7)) == []
    unknown = np.arange(COUNT) < 300
    late = against(heading=2.0 * unknown, heading_sigma=np.where(unknown, 1.7, 0.05))
    assert findings(late) == []
    # Another origin, a reference that does not know the heading, and one that never tells it.
    assert findings(against(offset=1e4)) == []
    assert findings(against(heading=2.0, told=(3.0, 0.0))) == []
    assert findings(against(heading=2.0, has_attitude=False)) == []
    # A few wrong ones.
    assert findings(against(heading=2.0 * (np.arange(COUNT) < 20))) == []


def test_errors_that_are_all_alike_are_a_finding_in_one_run_of_a_thousand_at_most() -> None:
    """The worst case: one number is the error of a whole run, in its sigmas."""
    rng = np.random.default_rng(1)
    alike = np.abs(rng.standard_normal(200_000)) > pose.BOUND
    assert np.mean(alike) <= CHANCE
    # The other: errors whose values are independent are beyond it for a share that is far smaller.
    runs = np.abs(rng.standard_normal((2000, 100))) > pose.BOUND
    assert not (runs.mean(axis=1) > pose.SHARE).any()


def test_a_filter_with_a_wrong_heading_is_called_wrong_and_nothing_before_it() -> None:
    mission = flown(11, duration=110.0)
    yaw = float(rpy_from_rotation(mission.truth.C_n_b[:1])[0, 2])
    found, _ = judged(
        mission,
        initial__mode="parameters",
        initial__rpy=(0.0, 0.0, math.pi / 2.0 - yaw + 1.0),  # from east, to the left
        initial__tilt_std=0.1,
        initial__heading_std=0.02,
        dvl__noise_std=(0.2,) * 3,
    )
    assert found.judgement.startswith("NOT RIGHT: the heading is 5"), found.judgement
    assert found.findings[0].name == "heading_error"
    assert "dvl_noise" in [finding.name for finding in found.findings]


def test_the_distance_is_that_of_the_vehicle_while_the_heading_is_being_found() -> None:
    found, replayed = judged(flown(11, duration=110.0), initial__mode="auto")
    true = path_length(replayed.at_reference.truth.p_o)
    assert found.numbers["position"]["distance"] == pytest.approx(true, rel=0.03)


def test_the_length_of_a_path_has_no_part_in_which_nothing_was_known() -> None:
    travelled = Travelled()
    for start in (0, 100):
        travelled.begin()
        travelled.add(np.array([start, start + 1]) * NS, np.array([1.0, 2.0]))
        travelled.add(np.array([start + 3]) * NS, np.array([4.0]))
    assert travelled.length == pytest.approx(2 * (1.5 + 6.0))


def test_a_dvl_that_is_refused_comes_before_the_heading_that_it_could_not_tell() -> None:
    mission = flown(11, duration=60.0)
    without = replace(mission, v_d=np.full_like(mission.v_d, np.nan))
    found, _ = judged(without, initial__mode="auto")
    assert [finding.name for finding in found.findings][:2] == ["refused", "heading"]
    assert "100 % of the DVL was refused" in found.judgement


@pytest.mark.parametrize("dominant", [True, False])
def test_what_a_reference_says_of_its_own_error_is_read(dominant: bool) -> None:
    """By the fast decoder, and by the general one where the covariance is not plain."""
    raws = [raw for raw in record(flown(11, duration=3.0), every=100) if raw.topic == "/truth"]
    for k, raw in enumerate(raws):
        message = decode(raw._replace(topic=TOPICS["/truth"])).message
        P = np.diag([4.0, 5.0, 1.0, 0.1, 0.1, 0.25])
        P[0, 1] = P[1, 0] = 0.0 if dominant else 4.2
        message.pose.covariance = P.ravel()
        raws[k] = encode(TOPICS["/truth"], raw.time_ns, message)
    stamps_ns, _, sigma = reference_of(Listed(raws))
    assert len(stamps_ns) == len(raws)
    np.testing.assert_allclose(sigma, np.tile([0.5, 3.0], (len(raws), 1)))
