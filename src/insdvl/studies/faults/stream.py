"""A mission as the messages that reach the filter, in the order of their arrival."""

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from heapq import merge
from typing import Any, NamedTuple

import numpy as np

from insdvl.messages.convert import RejectedMessage
from insdvl.messages.topics import PROCESS_NOISE
from insdvl.navigation.events import NS
from insdvl.recordings.messages import message_of
from insdvl.simulation.messages import (
    depth_messages,
    dvl_messages,
    heading_messages,
    imu_messages,
    process_noise_messages,
)
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.depth import DepthModel
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.simulation.trajectories import AUV
from insdvl.tuner.republish import set_learned, tune
from insdvl.tuner.tuner import Tuner


class Arrival(NamedTuple):
    """A message when it arrives.

    Attributes:
        time_ns: When, on a clock that no fault changes; the mission starts at `Mission.start_ns`.
        topic: Its topic.
        message: The message.
        valid: Whether its content and stamp are true: a filter that refuses it has lost it.
    """

    time_ns: int
    topic: str
    message: Any
    valid: bool = True


@dataclass(frozen=True)
class Epoch:
    """How stamps relate to times of arrival from a time on, until the next epoch.

    Attributes:
        begin_ns: Time of arrival from which it holds.
        stamp_ns: Stamp minus time of arrival.
        truth_ns: Time of the mission that the messages describe, minus time of arrival; not 0 for a
            recording that is played again.
    """

    begin_ns: int
    stamp_ns: int = 0
    truth_ns: int = 0


@dataclass(frozen=True)
class Stream:
    """Messages in the order of their arrival, and the truth.

    Attributes:
        arrivals: The messages.
        mission: The truth.
        epochs: In the order of their beginning.
    """

    arrivals: tuple[Arrival, ...]
    mission: Mission
    epochs: tuple[Epoch, ...]

    def changed(self, change: Callable[[Arrival], Iterable[Arrival]]) -> "Stream":
        """The stream with each message replaced by none, one or several, at their own times."""
        return self.reordered(new for old in self.arrivals for new in change(old))

    def reordered(self, arrivals: Iterable[Arrival]) -> "Stream":
        """The stream with other messages, sorted by time of arrival (a stable order)."""
        return replace(self, arrivals=tuple(sorted(arrivals, key=lambda arrival: arrival.time_ns)))

    def seconds(self, arrival: Arrival) -> float:
        """Time of arrival from the start of the mission [s]."""
        return (arrival.time_ns - self.mission.start_ns) / NS

    def epoch_of(self, stamp_ns: int, now_ns: int) -> int | None:
        """Number of the epoch of a stamp that is published at a time; None where there is none."""
        for k in reversed(range(len(self.epochs))):
            epoch = self.epochs[k]
            if epoch.begin_ns <= stamp_ns - epoch.stamp_ns <= now_ns:
                return k
        return None


#: Variances per sample at 100 Hz of specific force [(m/s^2)^2] and angular rate [(rad/s)^2]: those
#: of the evaluation's scenarios `constant` and `constant-tableI`.
IMUS = {"noisy": (1e-2, 1e-3), "good": (1e-4, 1e-6)}


@dataclass(frozen=True)
class Sensors:
    """What navigates.

    Attributes:
        imu: One of `IMUS`.
        rate: Rate of the IMU [Hz]; the density of its noise is the same at every rate.
        start_ns: Stamp of the start.
        learned: Whether the process noise is learned by a tuner; else the true one is published.
        depth_rate: Rate of the depth sensor [Hz]; 0 for none.
        heading_rate: Rate of the heading sensor [Hz]; 0 for none.
        dvl_rate: Rate of the DVL [Hz].
        dvl_noise: Its noise, one sigma [m/s].
    """

    imu: str = "noisy"
    rate: float = 100.0
    start_ns: int = 1000 * NS
    learned: bool = False
    depth_rate: float = 0.0
    heading_rate: float = 0.0
    dvl_rate: float = 1.0
    dvl_noise: float = 0.1

    @property
    def variances(self) -> tuple[float, float]:
        """Variance of a sample of specific force and of angular rate."""
        force, turn = IMUS[self.imu]
        return force * self.rate / 100.0, turn * self.rate / 100.0


@lru_cache(maxsize=4)
def stream_of(sensors: Sensors, seed: int, duration: float) -> Stream:
    """The messages of an AUV; with its true process noise once a second where none is learned.

    Args:
        sensors: What navigates.
        seed: Random seed.
        duration: Duration of the mission [s].
    """
    mission = simulate(
        AUV,
        constant(np.repeat(sensors.variances, 3)),
        seed=seed,
        duration=duration,
        imu=ImuModel(rate=sensors.rate),
        dvl=DvlModel(rate=sensors.dvl_rate, noise_std=(sensors.dvl_noise,) * 3),
        depth=DepthModel(rate=sensors.depth_rate),
        heading=HeadingModel(rate=sensors.heading_rate),
        start_ns=sensors.start_ns,
    )
    arrivals = list(sensor_arrivals(mission))
    if not sensors.learned:
        arrivals += [
            Arrival(timed.time_ns, PROCESS_NOISE, timed.message)
            for timed in process_noise_messages(mission, message_of)
        ]
    arrivals.sort(key=lambda arrival: arrival.time_ns)
    return Stream(tuple(arrivals), mission, (Epoch(sensors.start_ns),))


def sensor_arrivals(mission: Mission) -> Iterable[Arrival]:
    """The messages of IMU, DVL, depth and heading sensor, at their stamps, made one at a time."""
    made_by = imu_messages, dvl_messages, depth_messages, heading_messages
    sensors = (made(mission, message_of) for made in made_by)
    return (Arrival(*timed) for timed in merge(*sensors, key=lambda timed: timed.time_ns))


def learned_from(arrival: Arrival, tuner: Tuner) -> Arrival | None:
    """What the tuner's node publishes after an IMU message; None where it publishes nothing."""
    try:
        tuned = tune(tuner, arrival.message)
    except RejectedMessage:
        return None
    if tuned is None:
        return None
    message = copy.copy(arrival.message)
    set_learned(message, tuned)
    return Arrival(arrival.time_ns, PROCESS_NOISE, message)
