"""The missions of the comparison.

A run has its own random streams, made from the seed of the study, the split and the number of the
run: for the noise profile, noise and biases of the mission, and for the initial error, which is
drawn from the filter's P_0. Searches use runs of the split `TUNING`, reports those of `TEST`;
training draws from other streams.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from insdvl.navigation.events import Initial
from insdvl.simulation.drawn.scenarios import DRAWN, Scenario
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS, ProfileFactory, segments
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.studies.evaluation.outages import Outage, outages_in, silence
from insdvl.studies.evaluation.sensors import Sensors

#: Splits: first keys of the random streams.
TEST, TUNING = 2000, 2001
_INITIAL = 2002

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
        sensors: Of the vehicle.
    """

    scenario: str
    seed: int
    duration: float | None = None
    sensors: Sensors = field(default_factory=Sensors)

    @property
    def noise(self) -> ProfileFactory | Scenario:
        """Of the IMU, and what else is drawn."""
        found, grade = PROFILES[self.scenario], self.sensors.grade
        if grade is None:
            return found
        if not isinstance(found, Scenario):
            raise ValueError(
                f"an IMU of a grade needs a scenario with drawn noise, got {self.scenario!r}"
            )
        return grade.of_scenario(found)

    @property
    def outages(self) -> tuple[Outage, ...]:
        """Of the DVL."""
        return outages_in(self.duration or AUV.duration, self.sensors.outage)

    @property
    def dvl(self) -> DvlModel:
        """The DVL with its outages."""
        return replace(self.sensors.dvl, outages=silence(self.outages))


def mission_of_run(study: Study, split: int, run: int) -> Mission:
    """The mission of a run, the same for all approaches."""
    mission = simulate(
        AUV,
        study.noise,
        seed=stream_of_run(study, split, run),
        duration=study.duration,
        imu=study.sensors.imu,
        dvl=study.dvl,
    )
    return mission.without_outliers() if study.sensors.outliers_missing else mission


def stream_of_run(study: Study, split: int, run: int) -> np.random.SeedSequence:
    """The seed of the mission of a run."""
    return np.random.SeedSequence(study.seed, spawn_key=(split, run))


def initial_of_run(mission: Mission, study: Study, split: int, run: int) -> Initial:
    """Initial state of the filters in a run: the truth with an error drawn from P_0."""
    stream = np.random.SeedSequence(study.seed, spawn_key=(_INITIAL, split, run))
    rng = np.random.default_rng(stream)
    return drawn_initial(mission.initial, P_0, rng, stamp_ns=mission.start_ns)
