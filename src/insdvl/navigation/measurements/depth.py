"""The depth below the water's surface, from a pressure sensor or as a height that somebody tells.

    d = h_s - (h - [C_n_b l]_D)

h_s is the height of the surface above the ellipsoid, h that of the IMU, l the arm from the IMU to
the sensor. The surface is an optional error state: with a large prior sigma it is unknown,
and the first depth tells it, to within the filter's own height; with a sigma of zero it is known.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation import coordinates
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, ATTITUDE, POSITION, VELOCITY
from insdvl.navigation.events import MAX_DISTANCE, MAX_VARIANCE, NS, Limits, Measurement
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.measurements import claims
from insdvl.navigation.measurements.base import (
    Block,
    Linearised,
    Past,
    SensorModel,
    SensorParameters,
    Turn,
    Vehicle,
)
from insdvl.navigation.state.fields import NEVER, State
from insdvl.parameters.declaration import lever_arm, parameter, time_offset

#: Gravity [m/s^2] with which a pressure is turned into a depth before the latitude is known.
STANDARD_GRAVITY = 9.80665

#: A velocity that was told so lately is known [ns], and a sensor that has borne the filter out for
#: so long as well.
_TOLD_NS = 5 * NS
_DOWN = 2


@dataclass(frozen=True, slots=True)
class Depth(Measurement):
    """Depth of a sensor below the water's surface.

    Attributes:
        depth: [m], positive below the surface.
        variance: [m^2]; None takes the parameter ``depth.noise_std``.
        from_pressure: Whether it was computed from a pressure with `STANDARD_GRAVITY`; the gravity
            of the place replaces it.
    """

    depth: float
    variance: float | None = None
    from_pressure: bool = False

    name = "depth"
    kind = Measurement.FIRST + 1

    def payload(self) -> bytes:
        """All numbers."""
        variance = np.nan if self.variance is None else self.variance
        return np.array([self.depth, variance, float(self.from_pressure)]).tobytes()

    def limits(self) -> Limits:
        """Where no vehicle is."""
        variance = None if self.variance is None else np.array([self.variance])
        return (np.array([self.depth]), MAX_DISTANCE), (variance, MAX_VARIANCE)


@dataclass(frozen=True)
class DepthParameters(SensorParameters):
    """The depth sensor: a pressure sensor, or the height in a pose or an odometry."""

    topic: str = parameter(
        "",
        "Topic of the depth sensor, with whichever type is found on it: sensor_msgs/FluidPressure, "
        "or the z of geometry_msgs/PoseWithCovarianceStamped or nav_msgs/Odometry. Empty for none.",
    )
    frame_id: str = parameter(
        "",
        "A measurement of any other frame_id is refused as 'wrong_frame'; empty for any. Of an "
        "odometry it is the child_frame_id.",
    )
    lever_arm: tuple[float, ...] = lever_arm("depth sensor")
    time_offset: float = time_offset("depth sensor")
    noise_std: float = parameter(
        0.02,
        "Noise of the depth, one sigma; a variance in the message replaces it.",
        unit="m",
        low=1e-6,
        changeable=True,
    )
    water_density: float = parameter(
        1025.0,
        "Density of the water; fresh water has 998.",
        unit="kg/m^3",
        low=900.0,
        high=1300.0,
    )
    atmospheric_pressure: float = parameter(
        101_325.0,
        "Pressure at the surface, which the sensor measures as well; 0 for a gauge that does not.",
        unit="Pa",
        low=0.0,
        high=120_000.0,
    )
    min_depth: float = parameter(
        0.3,
        "A pressure that corresponds to less depth is refused as 'in_air': the sensor is on deck, "
        "or its unit is not Pa. The weather changes the pressure by up to 0.3 m of water.",
        unit="m",
        low=-100.0,
        high=100.0,
    )
    surface_height: float = parameter(
        0.0,
        "Height of the water's surface above the ellipsoid, as origin.height.",
        unit="m",
        low=-12_000.0,
        high=100_000.0,
    )
    surface_std: float = parameter(
        10_000.0,
        "One sigma of surface_height. With the default the surface is unknown and is taken from "
        "the filter's height at the first depth; 0 if it is known.",
        unit="m",
        low=0.0,
        high=100_000.0,
    )
    frozen_samples: int = parameter(
        20,
        "After this many exactly equal depths in a row, further ones are refused as 'frozen'; so "
        "is the repetition of a depth that the gate has rejected. 0 disables the check.",
        low=0,
        high=1_000_000,
        changeable=True,
    )

    EVENT = Depth
    ROOM: ClassVar[Mapping[str, int]] = {"surface": 1}
    REMEDIES: ClassVar[Mapping[str, str]] = {
        "frozen": "the sensor repeats one reading: its driver or its cable has stopped",
        "in_air": "the pressure is that of air: the sensor is out of the water, its unit is not "
        "Pa, or depth.atmospheric_pressure is not that of the sensor (0 for a gauge)",
    }

    def blocks(self) -> tuple[Block, ...]:
        """The height of the surface, where there is a sensor and it is not known."""
        if not self.topic or self.surface_std == 0.0:
            return ()
        return (Block("surface", (self.surface_std,), initial=(self.surface_height,)),)

    def model(self, vehicle: Vehicle) -> "DepthModel":
        """The sensor in a vehicle."""
        return DepthModel(self, vehicle)


class DepthModel(SensorModel[Depth]):
    """Predicts what the depth sensor measures.

    Args:
        parameters: Of the sensor.
        vehicle: That carries it.
    """

    label = "depth sensor"
    rows = 1

    def __init__(self, parameters: DepthParameters, vehicle: Vehicle) -> None:
        self._parameters = parameters
        self._vehicle = vehicle
        self._l_b = vehicle.lever_arm(parameters.lever_arm)
        self._surface = vehicle.blocks.get("surface")

    def reading(self, event: Depth) -> Array:
        """The depth."""
        return np.array([event.depth])

    def refusal(self, event: Depth, past: Past) -> str:
        """``frozen``, see `claims.is_frozen`."""
        return "frozen" if claims.is_frozen(past, self._parameters.frozen_samples) else ""

    def linearise(self, state: Records, event: Depth, turn: Turn) -> Linearised:
        """d = h_s - h + [C_n_b l]_D, H = [0, -[a x]_D, 0, 0, e_D] and 1 for h_s.

        a = C_n_b l for `ned`; for `invariant` a = x + C_n_b l, the sensor from the reference of the
        position error. The D row of [a x] is (-a_E, a_N, 0): tilt moves the sensor, a turn about
        the vertical does not.
        """
        vehicle, nav, parameters = self._vehicle, state[0]["nav"], self._parameters
        arm = nav["C_n_b"] @ self._l_b
        surface = parameters.surface_height
        H = np.zeros((1, vehicle.n))
        turned = coordinates.turns_position(state[0], invariant=vehicle.invariant)
        H[0, ATTITUDE] = -(turned + cross_matrix(arm))[_DOWN]
        H[0, POSITION.start + _DOWN] = 1.0
        if self._surface is not None:
            H[0, self._surface] = 1.0
            surface = nav["optional"][vehicle.optional("surface")][0]
        height = nav["llh"][2] - arm[_DOWN]
        scale = 1.0
        if event.from_pressure:
            scale = STANDARD_GRAVITY / gravity(nav["llh"][0], height)
        variance = event.variance
        R = parameters.noise_std**2 if variance is None else variance * scale**2
        predicted = surface - height
        return Linearised(np.array([event.depth * scale - predicted]), H, np.array([[R]]))

    def drift(self, s: State, seconds: float) -> Array:
        """Drift of the height by the vertical velocity, and the accelerometer's bias and noise."""
        constants, nav = self._vehicle.constants[0], s["nav"]
        P, C, Q_f = nav["P"], nav["C_n_b"], s["noise"]["Q_f"]
        velocity = P[VELOCITY, VELOCITY][_DOWN, _DOWN]
        bias = (C @ P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] @ C.T)[_DOWN, _DOWN]
        noise = constants["density"] * (C @ Q_f @ C.T)[_DOWN, _DOWN]
        drift = seconds**2 * velocity + seconds**4 / 4.0 * bias + seconds**3 / 3.0 * noise
        return np.array([[drift]])

    def inflate(self, s: State, innovation: Array, seconds: float | None) -> None:
        """Doubt the height, and the vertical velocity that may have led it astray.

        Not the velocity where a DVL has just told it: then it is the sensor that lags or drifts.
        While the sensor has not borne the filter out for long, its first depth may have been wrong.
        Then the surface that was taken from it is doubted, as far as it was not told.
        """
        P, variance = s["nav"]["P"], float(innovation @ innovation)
        down, rate = POSITION.start + _DOWN, VELOCITY.start + _DOWN
        if self._surface is not None and s["gate"][Depth.name]["trusted_for"] < _TOLD_NS:
            at = self._surface.start
            of_surface = min(variance, max(self._parameters.surface_std**2 - P[at, at], 0.0))
            P[at, at] += of_surface
            variance -= of_surface
        P[down, down] += variance
        told_ns = int(s["channels"]["told_ns"])
        is_told = told_ns != NEVER and int(s["nav"]["time_ns"]) - told_ns <= _TOLD_NS
        if seconds is not None and not is_told:
            P[rate, rate] += variance / seconds**2
            P[down, rate] += variance / seconds
            P[rate, down] += variance / seconds

    def restart(self, s: State, innovation: Array, R: Array) -> None:
        """The height becomes the measured one, independent of all else.

        It is as uncertain as the two are apart, since one of them is wrong.
        """
        nav, down = s["nav"], POSITION.start + _DOWN
        P = nav["P"]
        nav["llh"][2] -= innovation[0]
        turned = coordinates.turns_position(s, invariant=self._vehicle.invariant)[_DOWN]
        P[down, :] = turned @ P[ATTITUDE, :]
        P[:, down] = P[down, :]
        P[down, down] = turned @ P[ATTITUDE, ATTITUDE] @ turned + R[0, 0] + innovation[0] ** 2
