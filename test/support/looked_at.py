"""Simulated recordings, in memory and on disk, as `insdvl check` and `insdvl init` look at them."""

from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from recordings import record

from insdvl.recordings.bag_reader import RecordedTopic
from insdvl.recordings.base import Raw
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.motion import Trajectory
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV

START_NS = 1_700_000_000 * 10**9
#: Forward-right-down after a turn of the instrument by 90 deg to starboard.
TURNED = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def flown(duration: float, trajectory: Trajectory = AUV, **changes: Any) -> Mission:
    """A vehicle with a tactical IMU and a good DVL."""
    grade = GRADES["tactical"]
    mission = simulate(
        trajectory,
        constant(grade.variances()),
        seed=1,
        duration=duration,
        imu=grade.imu(),
        dvl=DvlModel(noise_std=np.full(3, 0.02)),
        start_ns=START_NS,
    )
    return replace(mission, **changes)


def raws_of(mission: Mission) -> list[Raw]:
    """The sensors' messages, with a truth every second."""
    return [raw for raw in record(mission, every=100) if raw.topic != "/true_q"]


class Memory:
    """What of a `BagReader` is looked at."""

    def __init__(self, raws: list[Raw]) -> None:
        self._raws = raws
        self.remarks: list[str] = []
        sizes: dict[str, int] = {}
        for raw in raws:
            sizes[raw.topic] = sizes.get(raw.topic, 0) + 1
        types = {raw.topic: raw.type for raw in raws}
        self.topics = {name: RecordedTopic(types[name], size) for name, size in sizes.items()}

    def raw(self, topics: Collection[str]) -> Iterator[Raw]:
        return (raw for raw in self._raws if raw.topic in topics)
