"""A measurement of the yaw, m = 1, for tests; it takes the place of the depth sensor."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation.error_state import ATTITUDE
from insdvl.navigation.events import Limits, Measurement
from insdvl.navigation.measurements.base import (
    Block,
    Linearised,
    Past,
    SensorModel,
    SensorParameters,
    Vehicle,
)
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state import State


@dataclass(frozen=True, slots=True)
class Compass(Measurement):
    """Yaw against north [rad], and one sigma."""

    yaw: float
    std: float

    name = Depth.name
    kind = Depth.kind

    def payload(self) -> bytes:
        return np.array([self.yaw, self.std]).tobytes()

    def limits(self) -> Limits:
        return ((np.array([self.yaw]), 2.0 * math.pi),)


@dataclass(frozen=True)
class CompassParameters(SensorParameters):
    """The sensor; with ``clones`` it brings constants that nothing drives, for a test to use."""

    topic: str = ""
    frame_id: str = ""
    clones: int = 0

    EVENT = Compass
    REMEDIES: ClassVar[Mapping[str, str]] = {}

    def blocks(self) -> tuple[Block, ...]:
        return (Block("clone", (1.0,) * self.clones),) if self.clones else ()

    def model(self, vehicle: Vehicle) -> "CompassModel":
        return CompassModel(vehicle)


class CompassModel(SensorModel[Compass]):
    """z - h within +-pi; the nose n moves by psi x n, seen from above."""

    label = "compass"
    rows = 1
    absolute = True

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle

    def reading(self, event: Compass) -> Array:
        return np.array([event.yaw])

    def refusal(self, event: Compass, past: Past) -> str:
        return ""

    def linearise(self, state: Records, event: Compass, turn: object) -> Linearised:
        nose = state[0]["nav"]["C_n_b"][:, 0]
        z_minus_h = math.remainder(event.yaw - math.atan2(nose[1], nose[0]), 2.0 * math.pi)
        level = nose[:2] @ nose[:2]
        H = np.zeros((1, self._vehicle.n))
        H[0, ATTITUDE] = np.cross(nose, [-nose[1], nose[0], 0.0]) / level
        return Linearised(np.array([z_minus_h]), H, np.array([[event.std**2]]))

    def drift(self, s: State, seconds: float) -> Array:
        return np.zeros((1, 1))

    def inflate(self, s: State, innovation: Array, seconds: float | None) -> None:
        raise NotImplementedError

    def restart(self, s: State, innovation: Array, R: Array) -> None:
        raise NotImplementedError


def with_compass(parameters: FilterParameters, clones: int = 0) -> FilterParameters:
    """The same filter, which takes the yaw."""
    return replace(parameters, depth=CompassParameters(clones=clones))  # type: ignore[arg-type]
