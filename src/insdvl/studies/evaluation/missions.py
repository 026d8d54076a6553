"""The missions of the comparison.

A run has its own random streams, made from the seed of the study, the split and the number of the
run: for the noise profile, noise and biases of the mission, and for the initial error, which is
drawn from the filter's P_0. Searches use runs of the split `TUNING`, reports those of `TEST`;
training draws from other streams.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from insdvl.navigation.events import Initial
from insdvl.simulation.drawn.scenarios import DRAWN, Scenario
from insdvl.simulation.grades import GRADES
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import DEFAULT_IMU, Mission, simulate
from insdvl.simulation.noise import SCENARIOS, ProfileFactory, segments
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import AUV
from insdvl.studies.evaluation.outages import Outage, outages_in, silence

#: Splits: first keys of the random streams.
TEST, TUNING = 2000, 2001
_INITIAL = 2002
OUTLIER = 1.0  # m/s

#: Shortest and longest time between changes [s] of the profiles of the study of window and rate.
CHANGES = MappingProxyType({"fast": (2.0, 6.0), "varying": (15.0, 45.0), "slow": (60.0, 180.0)})
#: Noise profiles: the scenarios, those of `CHANGES`, and those that are not white.
PROFILES: Mapping[str, ProfileFactory | Scenario] = MappingProxyType(
    {name: segments(1e-3, 0.05, *times) for name, times in CHANGES.items()}
    | dict(SCENARIOS)
    | dict(DRAWN)
)


@dataclass(frozen=True)
class Study:
    """Missions of the AUV that differ in their random numbers only.

    Attributes:
        scenario: Key of `PROFILES`.
        seed: Random seed of all runs.
        duration: Length [s], at most that of the trajectory; None for the whole trajectory.
        dvl_std: Noise of each component of a ping on the DVL's data sheet, one sigma [m/s].
        dvl_rate: Pings per second.
        outliers: Probability that a ping is off by `OUTLIER`.
        imu_grade: See `approaches.Setting`.
        outage: See `approaches.Setting`.
    """

    scenario: str
    seed: int
    duration: float | None = None
    dvl_std: float = 0.1
    dvl_rate: float = 1.0
    outliers: float = 0.0
    imu_grade: str = ""
    outage: float = 0.0

    @property
    def noise(self) -> ProfileFactory | Scenario:
        """Of the IMU, and what else is drawn."""
        found = PROFILES[self.scenario]
        if not self.imu_grade:
            return found
        if not isinstance(found, Scenario):
            raise ValueError(
                f"an IMU of a grade needs a scenario with drawn noise, got {self.scenario!r}"
            )
        return GRADES[self.imu_grade].of_scenario(found)

    @property
    def imu(self) -> ImuModel:
        """The IMU without its noise."""
        return GRADES[self.imu_grade].imu() if self.imu_grade else DEFAULT_IMU

    @property
    def outages(self) -> tuple[Outage, ...]:
        """Of the DVL."""
        return outages_in(self.duration or AUV.duration, self.outage)

    @property
    def dvl(self) -> DvlModel:
        """The DVL of the data sheet, with its outages."""
        return DvlModel(
            rate=self.dvl_rate,
            noise_std=(self.dvl_std,) * 3,
            outages=silence(self.outages),
            outlier_probability=self.outliers,
            outlier_size=OUTLIER,
        )


def mission_of_run(study: Study, split: int, run: int) -> Mission:
    """The mission of a run, the same for all approaches."""
    return simulate(
        AUV,
        study.noise,
        seed=stream_of_run(study, split, run),
        duration=study.duration,
        imu=study.imu,
        dvl=study.dvl,
    )


def stream_of_run(study: Study, split: int, run: int) -> np.random.SeedSequence:
    """The seed of the mission of a run."""
    return np.random.SeedSequence(study.seed, spawn_key=(split, run))


def initial_of_run(mission: Mission, study: Study, split: int, run: int) -> Initial:
    """Initial state of the filters in a run: the truth with an error drawn from P_0."""
    stream = np.random.SeedSequence(study.seed, spawn_key=(_INITIAL, split, run))
    rng = np.random.default_rng(stream)
    return drawn_initial(mission.initial, P_0, rng, stamp_ns=mission.start_ns)
