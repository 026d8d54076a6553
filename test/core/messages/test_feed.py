"""The loop from a message to the fold: what is taken, what is refused, and time jumps."""

from typing import Any

import numpy as np
from told import TOLD

from insdvl.messages.feed import Feed
from insdvl.messages.refusals import Refused
from insdvl.messages.topics import DVL, IMU, SET_ODOMETRY
from insdvl.navigation.events import NS, Imu, Orientation, ProcessNoise
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.messages import imu_message, odometry_message, twist_message

START_NS = 1000 * NS
UP = np.array([0.0, 0.0, 9.8])


def sample(stamp_ns: int, f: Any = UP) -> Any:
    return imu_message(stamp_ns, "imu", f, np.zeros(3), np.eye(3), np.eye(3))


def odometry(stamp_ns: int) -> Any:
    zeros = np.zeros(3)
    return odometry_message(stamp_ns, ("odom", "base_link"), zeros, [0, 0, 0, 1], zeros, zeros)


def test_a_message_may_be_several_events() -> None:
    feed = Feed(build(FilterParameters, TOLD | {"process_noise.source": "message"}))
    first, second = feed.give(IMU, sample(START_NS))
    assert isinstance(first.event, Imu) and isinstance(second.event, ProcessNoise)
    assert first.refusal is second.refusal is None
    assert not feed.refused


def test_refusals_of_converter_and_fold_are_counted_alike() -> None:
    told: list[tuple[str, str, str]] = []
    feed = Feed(build(FilterParameters, TOLD), on_refused=lambda *refusal: told.append(refusal))
    feed.give(IMU, sample(START_NS))
    (fed,) = feed.give(IMU, sample(START_NS))
    assert fed.refusal == "duplicate"
    assert feed.give(IMU, sample(0)) == []
    assert feed.give(DVL, twist_message(START_NS, "dvl", [np.nan, 0.0, 0.0])) == []
    assert feed.refused == {
        Refused(IMU, "duplicate"): 1,
        Refused(IMU, "no_stamp"): 1,
        Refused(DVL, "not_finite"): 1,
    }
    assert [(topic, reason) for topic, reason, _ in told] == list(feed.refused)
    assert told[0][2] == f"duplicate: stamp {START_NS} ns"
    assert told[2][2] == "not_finite: twist.linear is [nan, 0.0, 0.0]"


def test_what_was_taken_before_a_refusal_stays_taken() -> None:
    """A sample is a sample whatever its covariance; its process noise is refused."""
    feed = Feed(build(FilterParameters, TOLD | {"process_noise.source": "message"}))
    message = sample(START_NS)
    message.linear_acceleration_covariance = -np.ones(9) / 2
    (fed,) = feed.give(IMU, message)
    assert isinstance(fed.event, Imu) and feed.fold.newest_ns == START_NS
    assert feed.refused == {Refused(IMU, "bad_covariance"): 1}


def test_after_a_time_jump_and_a_reset_the_initial_topic_is_taken_again() -> None:
    feed = Feed(build(FilterParameters, TOLD | {"initial.mode": "topic", "max_delay": 0.1}))
    topic = feed.inputs.initial_topic
    assert topic is not None

    def run(from_ns: int) -> None:
        for k in range(40):
            feed.give(topic, odometry(from_ns + k * NS // 100))
            feed.give(IMU, sample(from_ns + k * NS // 100))

    run(START_NS)
    assert feed.inputs.initial_done
    for k in range(9):
        feed.give(IMU, sample(2 * START_NS + k * NS // 100))
    assert feed.inputs.initial_done and not feed.fold.left
    feed.give(IMU, sample(2 * START_NS + 9 * NS // 100))
    assert not feed.inputs.initial_done and len(feed.fold.left) == 1
    feed.fold.take()
    run(3 * START_NS)
    assert feed.inputs.initial_done
    feed.reset()
    assert not feed.inputs.initial_done and feed.fold.latest is None


def test_a_key_of_a_refusal_has_one_text() -> None:
    assert str(Refused(DVL, "too_late")) == f"{Refused(DVL, 'too_late')}" == f"{DVL}: too_late"


def test_the_orientation_of_an_imu_is_taken_until_the_filter_has_started() -> None:
    """A measured one; set_odometry starts the filter, max_delay after that nobody needs it."""
    feed = Feed(build(FilterParameters, {"max_delay": 0.1}))
    taken = []
    for k in range(40):
        message = sample(START_NS + k * NS // 100)
        message.orientation_covariance = np.diag([0.01, 0.01, 0.04]).ravel()
        taken.append(any(isinstance(fed.event, Orientation) for fed in feed.give(IMU, message)))
        if k == 10:
            feed.give(SET_ODOMETRY, odometry(START_NS + k * NS // 100))
        feed.fold.take()
    assert all(taken[:20]) and not any(taken[25:])
    told = Feed(build(FilterParameters, TOLD))
    message.orientation_covariance = np.diag([0.01, 0.01, 0.04]).ravel()
    assert len(told.give(IMU, message)) == 1
