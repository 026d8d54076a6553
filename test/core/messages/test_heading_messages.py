"""Messages of a heading: orientation of an IMU, of a pose, or a quaternion alone."""

import math
from typing import Any

import numpy as np
import pytest
from told import TOLD

from insdvl.messages.convert import IMU as IMU_TYPE
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.feed import Feed
from insdvl.messages.heading import POSE, QUATERNION, REFUSALS, TYPES, heading
from insdvl.messages.make import fill_imu, fill_orientation, set_quaternion
from insdvl.messages.refusals import Refused
from insdvl.messages.topics import BY_NAME, HEADING, IMU
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import (
    CONVENTIONS,
    quaternion_from_rotation,
    rotation_from_rpy,
)
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, build
from insdvl.recordings.base import new_message
from insdvl.simulation.messages import StreamFormat, heading_messages, topics_of
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.simulation.trajectories import AUV

STAMP = 5 * NS
NONE = (0.0, 0.0, 0.0)


def settings(**changes: Any) -> FilterParameters:
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    return build(FilterParameters, TOLD | changes)


def message_of(
    kind: str, q_xyzw: Any = (0.0, 0.0, 0.0, 1.0), P: Any = None, stamp_ns: int = STAMP
) -> Any:
    message = new_message(kind)
    covariance = np.zeros((3, 3)) if P is None else np.asarray(P, dtype=float)
    if kind == IMU_TYPE:
        fill_orientation(message, stamp_ns, q_xyzw, covariance)
        return message
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
    if kind == QUATERNION:
        set_quaternion(message.quaternion, q_xyzw)
        return message
    set_quaternion(message.pose.pose.orientation, q_xyzw)
    pose = np.zeros((6, 6))
    pose[3:, 3:] = covariance
    message.pose.covariance = pose.ravel()
    return message


def yaw(C: Any) -> float:
    return math.degrees(math.atan2(C[1, 0], C[0, 0]))


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize(
    ("convention", "told", "bearing"),
    [("enu", 0.0, 90.0), ("enu", 90.0, 0.0), ("enu", -135.0, -135.0), ("ned", 30.0, 30.0)],
)
def test_a_yaw_is_from_east_in_enu_and_from_north_in_ned(
    kind: str, convention: str, told: float, bearing: float
) -> None:
    q = quaternion_from_rotation(rotation_from_rpy(np.array([0.0, 0.0, math.radians(told)])))
    found = heading(message_of(kind, q), settings(frame_convention=convention), NONE)
    assert found.stamp_ns == STAMP
    assert yaw(found.C_n_b) == pytest.approx(bearing)
    assert found.P_psi is None


def test_a_declination_is_added_to_the_bearing() -> None:
    """5 deg east: a compass that points to magnetic north bears 5 deg."""
    for convention, q in (
        ("enu", (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))),
        ("ned", (0, 0, 0, 1)),
    ):
        told = settings(frame_convention=convention, heading__declination=math.radians(5.0))
        assert yaw(heading(message_of(QUATERNION, q), told, NONE).C_n_b) == pytest.approx(5.0)


@pytest.mark.parametrize("convention", ["enu", "ned"])
def test_the_attitude_is_that_of_base_link(convention: str) -> None:
    """A sensor that is turned in the vehicle tells its own attitude, C_n_s = C_n_b C_b_s."""
    axes = CONVENTIONS[convention]
    C_n_b, mount = rotation_from_rpy(np.array([0.1, -0.3, 2.0])), (0.2, -0.4, 3.0)
    C_w_s = axes.attitude(C_n_b) @ rotation_from_rpy(np.array(mount))  # all in the stream's axes
    message = message_of(IMU_TYPE, quaternion_from_rotation(C_w_s))
    found = heading(message, settings(frame_convention=convention), mount)
    np.testing.assert_allclose(found.C_n_b, C_n_b, atol=1e-12)


@pytest.mark.parametrize("kind", [IMU_TYPE, POSE])
def test_the_covariance_is_about_north_east_and_down(kind: str) -> None:
    P = np.array([[1.0, 0.2, 0.1], [0.2, 2.0, 0.3], [0.1, 0.3, 4.0]]) * 1e-3
    found = heading(message_of(kind, P=P), settings(), NONE).P_psi
    expected = np.array([[2.0, 0.2, -0.3], [0.2, 1.0, -0.1], [-0.3, -0.1, 4.0]]) * 1e-3
    np.testing.assert_allclose(found, expected)


NAN = math.nan
REFUSED = [
    ("bad_quaternion", {"q_xyzw": (0.0, 0.0, 0.0, 0.0)}, TYPES),
    ("bad_quaternion", {"q_xyzw": (0.0, 0.0, 0.0, 1.1)}, TYPES),
    ("not_finite", {"q_xyzw": (0.0, NAN, 0.0, 1.0)}, TYPES),
    ("no_stamp", {"stamp_ns": 0}, TYPES),
    ("no_data", {"P": np.diag([-1.0, 0.0, 0.0])}, (IMU_TYPE, POSE)),
    ("bad_covariance", {"P": np.diag([1.0, 1.0, -1.0])}, (IMU_TYPE, POSE)),
    ("bad_covariance", {"P": np.full((3, 3), NAN)}, (IMU_TYPE, POSE)),
]


@pytest.mark.parametrize(
    ("reason", "values", "kind"),
    [(reason, values, kind) for reason, values, kinds in REFUSED for kind in kinds],
)
def test_what_cannot_be_a_heading_is_refused_by_name(
    reason: str, values: dict[str, Any], kind: str
) -> None:
    with pytest.raises(RejectedMessage) as refused:
        heading(message_of(kind, **values), settings(), NONE)
    assert refused.value.reason == reason
    assert reason in REFUSALS


def test_the_table_has_its_types() -> None:
    assert BY_NAME[HEADING].types == TYPES == (IMU_TYPE, POSE, QUATERNION)
    assert BY_NAME[HEADING].refusals == REFUSALS


# ------------------------------------------------------------------ through the filter


def feed(**changes: Any) -> Feed:
    return Feed(settings(**{"initial__mode": "parameters", "heading__interval": 0.0, **changes}))


def sample(k: int, yaw_enu: float | None = None) -> Any:
    """A sample at rest, with an orientation where a yaw is given [rad]."""
    message = new_message(IMU_TYPE)
    stamp_ns = STAMP + k * NS // 100
    fill_imu(message, stamp_ns, (0.0, 0.0, 9.8), np.zeros(3))
    if yaw_enu is not None:
        q = quaternion_from_rotation(rotation_from_rpy(np.array([0.0, 0.0, yaw_enu])))
        set_quaternion(message.orientation, q)
        message.orientation_covariance = np.diag([1e-4, 1e-4, 1e-3]).ravel()
    return message


@pytest.mark.parametrize("kind", TYPES)
def test_the_filter_takes_the_topic_that_its_parameter_names(kind: str) -> None:
    found = feed(heading__topic="compass/heading")
    assert "compass/heading" not in feed().inputs.topics
    rng = np.random.default_rng(1)
    for k in range(20):
        found.give(IMU, sample(k))
        q = quaternion_from_rotation(rotation_from_rpy(np.array([0, 0, rng.normal(0.0, 0.03)])))
        found.give("compass/heading", message_of(kind, q, stamp_ns=STAMP + k * NS // 100))
    reports = [update.report for update in found.fold.updates]
    assert [r.measurement for r in reports] == ["heading"] * 20
    assert all(r.innovation.shape == (1,) and r.judged for r in reports)
    assert not found.refused


@pytest.mark.parametrize("topic", ["imu/data_raw", "/imu/data_raw"])
def test_one_message_of_the_imu_has_the_sample_and_the_heading(topic: str) -> None:
    """Turned by imu.mount as the sample is; `heading/innovation` is a measurement of its own."""
    found = feed(heading__topic=topic, imu__mount=(0.0, 0.0, 0.5), initial__rpy=(0.0, 0.0, 1.0))
    assert set(found.inputs.topics) == set(feed().inputs.topics)
    assert found.inputs.measured["heading"] == [IMU]
    for k in range(20):
        kinds = [type(fed.event).__name__ for fed in found.give(IMU, sample(k, 1.5 + 1e-3 * k))]
        assert kinds == ["Imu", "Heading"]
    reports = [update.report for update in found.fold.updates]
    assert [r.measurement for r in reports] == ["heading"] * 20
    assert abs(reports[0].innovation[0]) < 1e-9
    assert len(found.fold.states) == 20 and not found.refused


def test_an_orientation_that_is_not_measured_loses_no_sample() -> None:
    """REP-145: the first element of the covariance is -1. It is refused under its own name."""
    found = feed(heading__topic=IMU)
    for k in range(20):
        found.give(IMU, sample(k))
    assert found.refused == {Refused("heading", "no_data"): 20}
    assert found.fold.latest is not None and len(found.fold.states) == 20


def test_what_the_fold_refuses_of_a_message_is_counted_once_for_each() -> None:
    found = feed(heading__topic=IMU)
    for k in (0, 1, 1):
        found.give(IMU, sample(k, 0.0))
    assert found.refused == {Refused(IMU, "duplicate"): 1, Refused("heading", "duplicate"): 1}


def test_no_other_topic_may_be_shared() -> None:
    for values in (
        {"heading__topic": "dvl/velocity"},
        {"heading__topic": "x", "depth__topic": "/x"},
        {"depth__topic": "imu/data_raw"},
    ):
        with pytest.raises(ParameterError, match="must be a topic of its own"):
            feed(**values)


def test_a_late_stamp_is_corrected() -> None:
    found = feed(heading__topic="compass", heading__time_offset=-0.25)
    found.give(IMU, sample(0))
    (fed,) = found.give("compass", message_of(QUATERNION, stamp_ns=STAMP + NS))
    assert fed.event.stamp_ns == STAMP + 3 * NS // 4


@pytest.mark.parametrize("convention", ["enu", "ned"])
def test_the_simulated_sensor_comes_back_as_it_was_drawn(convention: str) -> None:
    model = HeadingModel(rate=2.0)
    mission = simulate(AUV, SCENARIOS["constant"], seed=3, duration=5.0, heading=model)
    assert HEADING in topics_of(mission)
    form = StreamFormat(CONVENTIONS[convention])
    told = settings(frame_convention=convention)
    timed = list(heading_messages(mission, lambda topic: new_message(IMU_TYPE), form))
    assert [t.time_ns for t in timed] == [k * NS // 2 for k in range(1, 11)]
    for k, (_, topic, message) in enumerate(timed):
        found = heading(message, told, NONE)
        assert topic == HEADING
        np.testing.assert_allclose(found.C_n_b, mission.attitude[k], atol=1e-12)
        np.testing.assert_allclose(found.P_psi, np.diag(model.variances), atol=1e-18)
