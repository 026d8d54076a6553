"""The table of topics: it is whole, and what else names topics agrees with it."""

from collections import defaultdict
from dataclasses import fields, replace
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
from adversary import Adversary

from insdvl.messages import topics
from insdvl.messages.convert import ODOMETRY
from insdvl.messages.drivers import DRIVERS
from insdvl.messages.feed import Feed
from insdvl.messages.inputs import Inputs
from insdvl.messages.topics import (
    BY_NAME,
    DEPTH,
    DVL,
    HEADING,
    IMU,
    TOPICS,
    TRUTH,
    ZeroStamp,
    taken,
)
from insdvl.navigation.measurements.base import SensorParameters
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start.parameters import _NO_INITIAL_TOPIC
from insdvl.parameters.declaration import ParameterError, build
from insdvl.recordings.parameters import ReplayParameters

ALL = {
    "initial.mode": "topic",
    "origin.source": "topic",
    "imu.frame_id": "imu_link",
    "depth.topic": DEPTH,
    "heading.topic": HEADING,
    "dvl.noise_source": "adaptive",
}


def test_names_are_unique_and_are_found() -> None:
    assert len({topic.name for topic in TOPICS}) == len(TOPICS)
    assert list(BY_NAME.values()) == list(TOPICS)


def test_every_measurement_has_its_parameters_and_its_topic() -> None:
    groups = {
        item.name
        for item in fields(FilterParameters)
        if isinstance(getattr(FilterParameters(), item.name), SensorParameters)
    }
    assert {topic.measurement for topic in TOPICS} - {""} == groups


def test_every_parameter_that_a_row_names_is_there() -> None:
    parameters = FilterParameters()
    for topic in TOPICS:
        for name in (*topic.frames.values(), *([topic.parameter] if topic.parameter else [])):
            assert isinstance(attrgetter(name)(parameters), str)


def test_every_topic_of_the_replay_is_a_row() -> None:
    named = {item.name for item in fields(ReplayParameters) if item.name.endswith("_topic")}
    assert {topic.replay_parameter for topic in TOPICS if topic.replay_parameter} == named


def test_the_initial_topic_is_none_that_has_another_use() -> None:
    """The list of the lower room, which cannot read the table."""
    others = {topic.name for topic in TOPICS if not topic.parameter}
    assert set(_NO_INITIAL_TOPIC) == others | {"odometry/filtered", "gps/filtered"}


@pytest.mark.parametrize(
    ("values", "more"),
    [
        ({}, set()),
        ({"initial.mode": "topic"}, {TRUTH}),
        ({"initial.mode": "topic", "initial.topic": "/auv/start"}, {"/auv/start"}),
        ({"process_noise.source": "external"}, {topics.PROCESS_NOISE}),
        ({"process_noise.source": "oracle"}, {topics.TRUE_PROCESS_NOISE}),
        ({"process_noise.source": "message"}, set()),
        ({"dvl.noise_source": "learned"}, {topics.MEASUREMENT_NOISE}),
        ({"dvl.noise_source": "oracle"}, {topics.TRUE_MEASUREMENT_NOISE}),
        ({"origin.source": "topic"}, {topics.FIX}),
        ({"depth.topic": "bar30/pressure"}, {"bar30/pressure"}),
        ({"heading.topic": "compass/heading"}, {"compass/heading"}),
        ({"heading.topic": "/imu/data_raw"}, set()),
    ],
)
def test_what_is_taken_follows_from_the_parameters(values: dict[str, Any], more: set[str]) -> None:
    always = {IMU, DVL, topics.DVL_WITH_COVARIANCE, topics.SET_ODOMETRY}
    inputs = Inputs(build(FilterParameters, values))
    assert set(inputs.topics) == always | more
    not_required = {"bar30/pressure", "compass/heading", topics.MEASUREMENT_NOISE}
    assert set(inputs.required) == more - not_required
    assert inputs.initial_topic == next((name for name in more if "mode" in str(values)), None)


def test_two_parameters_cannot_name_one_topic(monkeypatch: pytest.MonkeyPatch) -> None:
    second = replace(BY_NAME[TRUTH], name="other", parameter="odom_frame")
    monkeypatch.setattr(topics, "TOPICS", (*TOPICS, second))
    parameters = build(
        FilterParameters, {"initial.mode": "topic", "initial.topic": "/x", "odom_frame": "x"}
    )
    with pytest.raises(ParameterError, match="'odom_frame' .* got 'x'.* used as initial.topic"):
        taken(parameters)


def test_a_row_refuses_for_its_reasons_and_no_others() -> None:
    """An adversary finds every reason of the table, and beside it those of fold and inputs."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    of_driver: defaultdict[str, set[str]] = defaultdict(set)
    for seed, source in enumerate(("external", "oracle", "message")):
        values = ALL | {"process_noise.source": source}
        values |= {"dvl.noise_source": "oracle"} if source == "oracle" else {}
        parameters = build(FilterParameters, values)
        for name, topic in Inputs(parameters).topics.items():
            for kind in topic.types if name == DVL and seed == 0 else topic.types[:1]:
                feed = Feed(parameters)  # of one: none is refused for the stamps of another one
                adversary = Adversary(np.random.default_rng(seed), odd=0.3)
                for _, message in adversary.messages({name: kind}, 500):
                    feed.give(name, message)
                reasons = {reason for _, reason in feed.refused}
                found[name] |= reasons
                if kind in DRIVERS and topic.measurement == "dvl":
                    of_driver[kind] |= reasons
    assert set(found) == set(BY_NAME)
    of_fold = {"not_finite", "out_of_range", "duplicate", "too_late", "far_ahead"}
    for name, topic in BY_NAME.items():
        others = of_fold | ({"wrong_frame"} if topic.frames else set())
        others |= {"no_stamp"} if topic.zero_stamp is ZeroStamp.BEGINNING else set()
        assert set(topic.refusals) <= found[name] <= {*topic.refusals, *others}, name
    for kind, driver in DRIVERS.items():
        assert of_driver[kind] <= {*driver.refusals, *of_fold, "wrong_frame"}, kind
        assert set(driver.refusals) <= of_driver[kind] | {"no_data"}, kind


def test_our_own_nodes_publish_a_type_that_is_accepted() -> None:
    assert all(topic.types for topic in TOPICS)
    assert BY_NAME[TRUTH].types == (ODOMETRY,)
