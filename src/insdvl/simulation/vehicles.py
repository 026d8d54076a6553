"""Vehicles that are not those of the training: motion, IMU, DVL, and the noise of the IMU.

The training has the four baseline trajectories, IMUs of 100 Hz, and the noise of
`drawn.scenarios`. These have other motions, and most have white noise of the level of a data sheet.
The numbers were fixed before the study that uses them was run.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from insdvl.simulation.drawn.motions import (
    car,
    deep_auv,
    rov,
    shaken_car,
    shallow_auv,
    smooth_auv,
    vessel,
)
from insdvl.simulation.drawn.scenarios import DRAWN, Scenario
from insdvl.simulation.grades import GRADES, Grade
from insdvl.simulation.motion import Trajectory
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel


@dataclass(frozen=True)
class Vehicle:
    """A kind of vehicle with its sensors.

    Attributes:
        motion: Draws the trajectory of a mission of a duration [s].
        duration: Of a mission [s].
        noise: Of the IMU: variances per sample of white noise, of f_b and of w_ib_b; or what a
            scenario draws.
        imu: The IMU without its noise.
        dvl: The DVL; on a car, another sensor of the velocity over ground.
    """

    motion: Callable[[np.random.Generator, float], Trajectory]
    duration: float
    noise: tuple[float, float] | Scenario
    imu: ImuModel
    dvl: DvlModel


def _dvl(rate: float, std: float) -> DvlModel:
    return DvlModel(rate=rate, noise_std=(std,) * 3)


def _white(grade: Grade, rate: float = 100.0) -> tuple[float, float]:
    f, w = grade.variances(rate)[[0, 3]].tolist()
    return f, w


#: The IMU of a telephone.
_PHONE = ImuModel(
    accelerometer_bias_std=0.02,
    gyroscope_bias_std=5e-4,
    accelerometer_bias_walk=0.0,
    gyroscope_bias_walk=0.0,
)
_PHONE_NOISE = 0.02**2, 0.002**2
_FOG, _TACTICAL, _MEMS = (GRADES[name] for name in ("fog", "tactical", "mems"))
_SMOOTH = Vehicle(smooth_auv, 400.0, (3e-3, 1e-6), ImuModel(), _dvl(1.0, 0.05))
_CAR = Vehicle(car, 400.0, _PHONE_NOISE, _PHONE, _dvl(5.0, 0.05))
_VESSEL = Vehicle(vessel, 400.0, _white(_TACTICAL), _TACTICAL.imu(), _dvl(4.0, 0.02))

#: The vehicles by name.
VEHICLES: Mapping[str, Vehicle] = MappingProxyType(
    {
        "AUV, FOG of 200 Hz": Vehicle(
            deep_auv, 400.0, _white(_FOG, 200.0), _FOG.imu(200.0), _dvl(1.0, 0.02)
        ),
        "AUV, MEMS of 62.5 Hz with low-pass": Vehicle(
            shallow_auv,
            500.0,
            _white(_MEMS, 62.5),
            replace(_MEMS.imu(62.5), bandwidth=6.0),
            _dvl(1.0, 0.03),
        ),
        "AUV, little noise": replace(_SMOOTH, noise=(1e-4, 1e-8)),
        "AUV, medium noise": _SMOOTH,
        "AUV, much noise": replace(_SMOOTH, noise=(3e-2, 1e-4)),
        "ROV": Vehicle(rov, 400.0, _white(_MEMS), _MEMS.imu(), _dvl(5.0, 0.02)),
        "vessel": _VESSEL,
        "vessel, coloured noise": replace(_VESSEL, noise=DRAWN["coloured"]),
        "car, 5 Hz": _CAR,
        "car, 1 Hz": replace(_CAR, dvl=_dvl(1.0, 0.1)),
        "car, engine": replace(_CAR, motion=shaken_car),
        "car, coloured noise": replace(_CAR, noise=DRAWN["coloured"]),
    }
)
