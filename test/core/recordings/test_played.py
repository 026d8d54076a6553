"""Which recorded topics are played: by the replay's parameters, by the filter's, and by name."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insdvl.messages import topics
from insdvl.messages.convert import ODOMETRY
from insdvl.messages.topics import TRUTH, taken
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import BagError, encode
from insdvl.recordings.messages import imu_message, odometry_message, twist_message
from insdvl.recordings.parameters import ReplayParameters
from insdvl.recordings.played import played


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BagReader]:
    path: Path = tmp_path_factory.mktemp("bags") / "bag"
    zeros = np.zeros(3)
    odometry = odometry_message(1, ("odom", "base_link"), zeros, [0, 0, 0, 1], zeros, zeros)
    with BagWriter(path) as writer:
        writer.write(encode("/imu/data_raw", 1, imu_message(1, "imu", zeros, zeros)))
        writer.write(encode("/dvl/velocity", 2, twist_message(1, "dvl", zeros)))
        writer.write(encode("/auv/start", 3, odometry))
        writer.write(encode("/other", 4, twist_message(1, "x", zeros)))
    with BagReader(path) as reader:
        yield reader


SENSORS = {"/imu/data_raw": "imu/data_raw", "/dvl/velocity": "dvl/velocity"}


def test_what_no_parameter_names_is_not_played(bag: BagReader) -> None:
    assert played(bag, ReplayParameters()) == SENSORS


@pytest.mark.parametrize("name", ["auv/start", "/auv/start"])
def test_a_topic_that_a_parameter_of_the_filter_names_is_played(bag: BagReader, name: str) -> None:
    filter_ = build(FilterParameters, {"initial.mode": "topic", "initial.topic": name})
    expected = SENSORS | {"/auv/start": "auv/start"}
    assert played(bag, ReplayParameters(), taken(filter_)) == expected


def test_the_replays_own_parameter_comes_first(bag: BagReader) -> None:
    filter_ = build(FilterParameters, {"initial.mode": "topic"})
    parameters = replace(ReplayParameters(), ground_truth_topic="/auv/start")
    assert played(bag, parameters, taken(filter_)) == SENSORS | {"/auv/start": TRUTH}
    filter_ = build(FilterParameters, {"initial.mode": "topic", "initial.topic": "/auv/start"})
    with pytest.raises(BagError, match=f"initial.topic '/auv/start' is already played on {TRUTH}"):
        played(bag, parameters, taken(filter_))


def test_the_type_is_one_that_the_table_accepts(
    bag: BagReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    filter_ = build(FilterParameters, {"initial.mode": "topic", "initial.topic": "/other"})
    with pytest.raises(BagError, match=f"/other .* has type .*TwistStamped, expected {ODOMETRY}"):
        played(bag, ReplayParameters(), taken(filter_))
    twist = bag.topics["/other"].type
    several = replace(topics.BY_NAME[TRUTH], types=(ODOMETRY, twist))
    rows = tuple(several if topic.name == TRUTH else topic for topic in topics.TOPICS)
    monkeypatch.setattr(topics, "TOPICS", rows)
    assert played(bag, ReplayParameters(), taken(filter_))["/other"] == "other"


def test_further_topics_are_played_under_their_own_names(bag: BagReader) -> None:
    parameters = replace(ReplayParameters(), further_topics=("/other", "absent", ""))
    assert played(bag, parameters) == SENSORS | {"/other": "other"}
    parameters = replace(ReplayParameters(), further_topics=("/dvl/velocity",))
    assert played(bag, parameters) == SENSORS
