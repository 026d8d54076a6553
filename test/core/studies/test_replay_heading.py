"""A recording with a heading: from a topic of its own, and in the messages of the IMU."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import FORM, REPLAY, record, save
from told import TOLD
from whole import States

from insdvl.messages.feed import Feed
from insdvl.messages.topics import HEADING, IMU
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import BagError, Raw, decode, encode
from insdvl.recordings.messages import message_of
from insdvl.simulation.messages import heading_messages, imu_messages
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.simulation.trajectories import AUV
from insdvl.studies.replay.consumer import Consumer
from insdvl.studies.replay.fold import fold_recording, read
from insdvl.studies.replay.output_bag import OutputBag
from insdvl.studies.replay.scores import report


@pytest.fixture(scope="module")
def mission() -> Mission:
    variances = [1e-4] * 3 + [1e-6] * 3
    return simulate(
        AUV, constant(variances), seed=11, duration=10.0, heading=HeadingModel(rate=100.0)
    )


class Written(Consumer):
    """Writes the messages."""

    def __init__(self, bag: BagWriter, parameters: FilterParameters) -> None:
        self._bag, self._parameters = bag, parameters

    def begin(self, feed: Feed) -> None:
        self.output = OutputBag(self._bag, self._parameters, feed)

    def messages(self, raws: Sequence[Raw]) -> None:
        self.output.messages(raws)


def settings(topic: str) -> FilterParameters:
    values: dict[str, Any] = {
        "heading.topic": topic,
        "initial.mode": "topic",
        "initial.heading_std": 0.5,
        "origin.height": float(AUV.h_0),
    }
    return build(FilterParameters, TOLD | values)


def test_a_heading_is_read_from_its_topic_and_from_the_messages_of_the_imu(
    mission: Mission, tmp_path: Path
) -> None:
    """Both give the same bits: the attitude is that of the same stamps."""
    raws, turns = record(mission), list(heading_messages(mission, message_of, FORM))
    apart = save(tmp_path / "apart", raws)
    together = [raw for raw in raws if raw.topic not in ("/imu", f"/{HEADING}")]
    for (_, _, turn), timed in zip(turns, imu_messages(mission, message_of, FORM), strict=True):
        timed.message.orientation = turn.orientation
        timed.message.orientation_covariance = turn.orientation_covariance
        together.append(encode("/imu", timed.time_ns, timed.message))
    together.sort(key=lambda raw: raw.time_ns)
    found = []
    for path, topic in ((apart, HEADING), (save(tmp_path / "together", together), IMU)):
        parameters = settings(topic)
        recording = read(path, REPLAY, parameters)
        states = States()
        with BagWriter(tmp_path / f"{path.name}-out") as bag:
            written = Written(bag, parameters)
            replayed = fold_recording(recording, parameters, [states, written])
            written.output.updates(replayed.fold.filter, replayed.updates)
        numbers = report(replayed)
        assert numbers["heading_accepted"] == 20  # at most two a second
        assert numbers["heading_rejected"] == 0
        assert 0.3 < numbers["heading_nis_mean"] < 2.0
        assert numbers["heading_rmse_deg"] < 3.0
        found.append(states.parts[-1])
        with BagReader(tmp_path / f"{path.name}-out") as bag:
            innovations = [
                decode(raw._replace(topic=raw.topic)).message
                for raw in bag.raw({"/heading/innovation": "heading/innovation"})
            ]
        assert len(innovations) == 20
        nu = [u.report.innovation[0] for u in replayed.updates if u.report.rows == 1]
        np.testing.assert_allclose([m.twist.twist.angular.z for m in innovations], -np.array(nu))
    a, b = (states["nav"] for states in found)
    np.testing.assert_array_equal(a["C_n_b"], b["C_n_b"])
    np.testing.assert_array_equal(a["P"], b["P"])


def test_an_imu_without_orientation_is_named(mission: Mission, tmp_path: Path) -> None:
    raws = [raw for raw in record(mission) if raw.topic != f"/{HEADING}"]
    path = save(tmp_path / "bag", raws)
    parameters = settings(IMU)
    recording = read(path, REPLAY, parameters)
    numbers = report(fold_recording(recording, parameters))
    assert numbers["heading_rejected_by_reason"] == {"no_data": 1000}
    assert numbers["rejected"] == {"heading: no_data": 1000}
    assert numbers["imu_samples"] == 1000


def test_the_imus_topic_is_named_as_the_nodes_know_it(mission: Mission, tmp_path: Path) -> None:
    path = save(tmp_path / "bag", record(mission))
    with pytest.raises(BagError) as caught:
        read(path, REPLAY, settings("/imu"))
    assert str(caught.value) == (
        "heading.topic '/imu' is already played on imu/data_raw: set heading.topic to "
        "imu/data_raw, whose messages have both"
    )
