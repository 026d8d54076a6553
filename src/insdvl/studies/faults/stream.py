"""A mission as the messages that reach the filter, in the order in which they arrive."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl.messages import convert as messages
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU, NED
from insdvl.recordings import bags
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.trajectories import AUV
from insdvl.tuner.tuner import Tuner

Array = NDArray[np.float64]

IMU, DVL, Q = "imu/data_raw", "dvl/velocity", "process_noise"
DVL_COVARIANCE = "dvl/velocity_cov"


class Arrival(NamedTuple):
    """A message when it arrives.

    Attributes:
        time_ns: When, on a clock that nothing disturbs; the mission starts at `Mission.start_ns`.
        topic: Where.
        message: The message.
        valid: Whether it says what is true, at its time: a filter that refuses it has lost it.
    """

    time_ns: int
    topic: str
    message: Any
    valid: bool = True


@dataclass(frozen=True)
class Epoch:
    """How the stamps go from a time on, until the next epoch.

    Attributes:
        begin_ns: Time of arrival from which it holds.
        stamp_ns: What the clock of the stamps is ahead of the time of arrival.
        truth_ns: What the time that the messages tell of is ahead of it; not 0 for a recording
            that is played again.
    """

    begin_ns: int
    stamp_ns: int = 0
    truth_ns: int = 0


@dataclass(frozen=True)
class Stream:
    """Messages in the order of their arrival, and what is true.

    Attributes:
        arrivals: The messages.
        mission: What happened.
        epochs: In the order of their beginning.
    """

    arrivals: tuple[Arrival, ...]
    mission: Mission
    epochs: tuple[Epoch, ...]

    def changed(self, change: Callable[[Arrival], Iterable[Arrival]]) -> "Stream":
        """Each message becomes none, one or several; they arrive at their times."""
        return self.reordered(new for old in self.arrivals for new in change(old))

    def reordered(self, arrivals: Iterable[Arrival]) -> "Stream":
        """Other messages, sorted by their times of arrival; what is of one time keeps its order."""
        return replace(self, arrivals=tuple(sorted(arrivals, key=lambda arrival: arrival.time_ns)))

    def seconds(self, arrival: Arrival) -> float:
        """Time of arrival from the start of the mission [s]."""
        return (arrival.time_ns - self.mission.start_ns) / NS

    def epoch_of(self, stamp_ns: int, now_ns: int) -> int | None:
        """Which epoch a stamp is of that is published at a time; None where it is of none."""
        for k in reversed(range(len(self.epochs))):
            epoch = self.epochs[k]
            if epoch.begin_ns <= stamp_ns - epoch.stamp_ns <= now_ns:
                return k
        return None


#: Variances per sample at 100 Hz of specific force [(m/s^2)^2] and angular rate [(rad/s)^2]: those
#: of the evaluation's scenario `constant`, and of its `constant-tableI`.
IMUS = {"noisy": (1e-2, 1e-3), "good": (1e-4, 1e-6)}


@dataclass(frozen=True)
class Sensors:
    """What navigates.

    Attributes:
        imu: One of `IMUS`.
        rate: Of the IMU [Hz]; the density of its noise is the same at every rate.
        start_ns: Stamp of the start.
        learned: Whether a tuner tells the process noise that it learns; else the true one is told.
    """

    imu: str = "noisy"
    rate: float = 100.0
    start_ns: int = 1000 * NS
    learned: bool = False

    @property
    def variances(self) -> tuple[float, float]:
        """Variance of a sample of specific force and of angular rate."""
        force, turn = IMUS[self.imu]
        return force * self.rate / 100.0, turn * self.rate / 100.0


@lru_cache(maxsize=4)
def stream_of(sensors: Sensors, seed: int, duration: float) -> Stream:
    """An AUV, and its true process noise once a second where none is learned.

    Args:
        sensors: What navigates.
        seed: Of all that is random.
        duration: Of the mission [s].
    """
    mission = simulate(
        AUV,
        constant(np.repeat(sensors.variances, 3)),
        seed=seed,
        duration=duration,
        imu=ImuModel(rate=sensors.rate),
        start_ns=sensors.start_ns,
    )
    arrivals = [*imu_arrivals(mission), *dvl_arrivals(mission)]
    if not sensors.learned:
        arrivals += _process_noise(mission)
    arrivals.sort(key=lambda arrival: arrival.time_ns)
    return Stream(tuple(arrivals), mission, (Epoch(sensors.start_ns),))


def imu_arrivals(mission: Mission) -> Iterator[Arrival]:
    """The IMU's messages, each at its stamp."""
    rows = (mission.stamps_ns.tolist(), mission.f_b @ ENU.body, mission.w_ib_b @ ENU.body)
    for stamp_ns, f, w in zip(*rows, strict=True):
        yield Arrival(stamp_ns, IMU, bags.imu_message(stamp_ns, "imu_link", f, w))


def dvl_arrivals(mission: Mission) -> Iterator[Arrival]:
    """The DVL's messages, each at its stamp."""
    for stamp_ns, v in zip(mission.dvl_stamps_ns.tolist(), mission.v_d @ ENU.body, strict=True):
        yield Arrival(stamp_ns, DVL, bags.twist_message(stamp_ns, "dvl_link", v))


def learned_from(arrival: Arrival, tuner: Tuner) -> Arrival | None:
    """What the tuner's node sends after a message of the IMU, where it sends something."""
    try:
        sample = messages.imu(arrival.message, NED)
    except messages.RejectedMessage:
        return None
    # A channel's variance is the same whichever way the axes point: none is turned.
    tuned = tuner.add(sample.stamp_ns, np.concatenate([sample.f_b, sample.w_ib_b]))
    if tuned is None:
        return None
    message = replace(
        arrival.message,
        linear_acceleration_covariance=np.diag(tuned.variances[:3]).ravel(),
        angular_velocity_covariance=np.diag(tuned.variances[3:]).ravel(),
    )
    return Arrival(arrival.time_ns, Q, message)


def _process_noise(mission: Mission) -> Iterator[Arrival]:
    for stamp_ns, q in zip(*mission.process_noise(), strict=True):
        Q_f, Q_w = np.diag(q[:3]), np.diag(q[3:])
        message = bags.imu_message(int(stamp_ns), "imu_link", np.zeros(3), np.zeros(3), Q_f, Q_w)
        yield Arrival(int(stamp_ns), Q, message)
