"""The row `taught`: the vehicle of a run teaches itself on other missions, without any truth.

The other missions are on the trajectories of the training, with noise, waves and a bottom of their
own. What stays is the vehicle: its vibration, the time constants of its noise, its IMU.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.simulation.drawn.scenarios import Scenario
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import DEFAULT_IMU, simulate
from insdvl.simulation.noise import ProfileFactory
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.teaching.lesson import Lesson, lesson_of
from insdvl.studies.teaching.teach import TeachingError, constant_of, fits_of, teach
from insdvl.tuner.features.bands import WINDOW
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.models import Model
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.weights import Weights

#: Missions of each of the trajectories of the training, and their length [s].
MISSIONS, DURATION = 2, 330.0


def lessons_of(
    noise: ProfileFactory | Scenario,
    dvl: DvlModel,
    parameters: FilterParameters,
    vehicle: np.random.SeedSequence,
    seed: np.random.SeedSequence,
    missions: int = MISSIONS,
    imu: ImuModel = DEFAULT_IMU,
) -> list[Lesson]:
    """Missions of a vehicle as lessons.

    Args:
        noise: Of the run.
        dvl: Of the run.
        parameters: Of the filter that finds attitude and biases of the lessons.
        vehicle: Seed of the mission that the vehicle was drawn for.
        seed: Of the missions.
        missions: Of each trajectory.
        imu: Of the run.
    """
    source = replace(parameters.process_noise, source="constant")
    parameters = replace(parameters, process_noise=source)
    lessons = []
    for number, own in enumerate(seed.spawn(missions * len(BASELINE))):
        drawn, of_initial = own.spawn(2)
        name, trajectory = list(BASELINE.items())[number % len(BASELINE)]
        mission = simulate(
            trajectory, noise, seed=drawn, duration=DURATION, imu=imu, dvl=dvl, vehicle=vehicle
        )
        rng = np.random.default_rng(of_initial)
        start = drawn_initial(mission.initial, P_0, rng, stamp_ns=mission.start_ns)
        pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
        lessons.append(
            lesson_of(
                f"{name} {number}",
                parameters,
                TunerParameters(),
                mission.stamps_ns,
                np.hstack([mission.f_b, mission.w_ib_b]),
                [start, *(Dvl(stamp_ns, v_d) for stamp_ns, v_d in pings)],
            )
        )
    return lessons


def taught_model(lessons: list[Lesson]) -> Model:
    """The model that they teach; the best constant by likelihood where it is refused."""
    try:
        regressor = teach(fits_of(lessons)).regressor
    except TeachingError:
        regressor = constant_of(lessons)
    return model_of(regressor)


def model_of(regressor: Weights) -> Model:
    """A model without a file."""
    return Model(Path(), {}, WINDOW, SCHEMAS["taught"], regressor)
