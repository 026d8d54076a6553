"""A measurement of the position, m = 3, for tests; it takes the place of the depth sensor."""

from dataclasses import dataclass, replace

import numpy as np
from places import place

from insdvl.arrays import Array, Records
from insdvl.navigation import coordinates
from insdvl.navigation.error_state import ATTITUDE, POSITION
from insdvl.navigation.events import MAX_DISTANCE, Limits, Measurement
from insdvl.navigation.geometry.earth import displacements
from insdvl.navigation.measurements.base import (
    Linearised,
    Past,
    SensorModel,
    SensorParameters,
    Vehicle,
)
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state.fields import State


@dataclass(frozen=True, slots=True)
class Fix(Measurement):
    """Position of the IMU in odom (3,), north-east-down [m], and one sigma at the vehicle."""

    p_o: Array
    std: float

    name = Depth.name
    kind = Depth.kind

    def payload(self) -> bytes:
        return self.p_o.tobytes()

    def limits(self) -> Limits:
        return ((self.p_o, MAX_DISTANCE),)


@dataclass(frozen=True)
class FixParameters(SensorParameters):
    """The sensor; it has none."""

    topic: str = ""
    time_offset: float = 0.0

    EVENT = Fix

    def model(self, vehicle: Vehicle) -> "FixModel":
        return FixModel(vehicle)


class FixModel(SensorModel[Fix]):
    """z - h in metres at the vehicle, H = [0, -[x x], 0, 0, I]."""

    rows = 3

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle

    def reading(self, event: Fix) -> Array:
        return event.p_o

    def refusal(self, event: Fix, past: Past) -> str:
        return ""

    def linearise(self, state: Records, event: Fix, turn: object) -> Linearised:
        nav = state[0]["nav"]
        z_minus_h = displacements(nav["llh"], place(nav, event.p_o))
        H = np.zeros((3, self._vehicle.n))
        H[:, POSITION] = np.eye(3)
        H[:, ATTITUDE] = -coordinates.turns_position(state[0], invariant=self._vehicle.invariant)
        return Linearised(z_minus_h, H, np.eye(3) * event.std**2)

    def drift(self, s: State, seconds: float) -> Array:
        return np.zeros((3, 3))

    def inflate(self, s: State, innovation: Array, seconds: float | None) -> None:
        raise NotImplementedError

    def restart(self, s: State, innovation: Array, R: Array) -> None:
        raise NotImplementedError


def with_fixes(parameters: FilterParameters) -> FilterParameters:
    """The same filter, which takes fixes."""
    return replace(parameters, depth=FixParameters())  # type: ignore[arg-type]
