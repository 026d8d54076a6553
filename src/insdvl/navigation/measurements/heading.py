"""The heading against true north, from a compass, a gyrocompass or the attitude that an IMU tells.

    z = chi + e + noise,    chi = atan2(C_n_b[1, 0], C_n_b[0, 0])

chi is the yaw of base_link in the level axes at the vehicle: from local true north, not from odom's
axes. e is the slowly varying error of the sensor, an optional error state: soft iron, a wrong
declination, a filter inside the sensor. With ``heading.roll_pitch`` the whole attitude is measured.

Derivation: docs/explanation/heading.md.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation import coordinates
from insdvl.navigation.coordinates import attitude_error
from insdvl.navigation.error_state import ATTITUDE, GYROSCOPE_BIAS, POSITION, VELOCITY
from insdvl.navigation.events import MAX_VARIANCE, NS, Limits, Measurement
from insdvl.navigation.geometry.frames import rotation_from_rpy, rotation_from_vector
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.measurements import claims, noise
from insdvl.navigation.measurements.base import (
    Block,
    Linearised,
    Past,
    SensorModel,
    SensorParameters,
    Turn,
    Vehicle,
)
from insdvl.navigation.state.fields import State
from insdvl.parameters.declaration import mount, parameter, time_offset

_HEADING = ATTITUDE.stop - 1
_DOWN = 2
_LARGEST_TANGENT = 1e6


@dataclass(frozen=True, slots=True)
class Heading(Measurement):
    """Attitude of base_link as a heading sensor tells it, against true north and the vertical.

    Attributes:
        C_n_b: (3, 3) attitude. Of a sensor that tells the yaw only it has no roll and pitch.
        P_psi: (3, 3) covariance of its error about north, east and down [rad^2] as the sender tells
            it, with zeros for a component of unknown variance; None where it tells nothing.
    """

    C_n_b: Array
    P_psi: Array | None = None

    name = "heading"
    kind = Measurement.FIRST + 2

    def payload(self) -> bytes:
        """Attitude and covariance."""
        return self.C_n_b.tobytes() + (b"" if self.P_psi is None else self.P_psi.tobytes())

    def limits(self) -> Limits:
        """A rotation, and what no variance is."""
        return (self.C_n_b, 1.0 + 1e-9), (self.P_psi, MAX_VARIANCE)


@dataclass(frozen=True)
class HeadingParameters(SensorParameters):
    """The heading sensor: a compass, or an attitude that has the heading."""

    topic: str = parameter(
        "",
        "Topic of the heading sensor, with whichever type is found on it: the orientation of "
        "sensor_msgs/Imu where its covariance says that it is measured, of geometry_msgs/"
        "PoseWithCovarianceStamped or of geometry_msgs/QuaternionStamped. It may be that of the "
        "IMU, imu/data_raw. Empty for none.",
    )
    frame_id: str = parameter(
        "",
        "A measurement of any other frame_id is refused as 'wrong_frame'; empty for any. On the "
        "topic of the IMU imu.frame_id holds.",
    )
    mount: tuple[float, ...] = mount("heading sensor")
    time_offset: float = time_offset("heading sensor")
    roll_pitch: bool = parameter(
        False,
        "Use roll and pitch as well. An attitude sensor that is accelerated is wrong in them by "
        "degrees; the filter finds them by itself.",
    )
    declination: float = parameter(
        0.0,
        "Magnetic declination: added to the bearing of a sensor that tells magnetic north. "
        "Positive where magnetic north is east of true north, in every frame_convention.",
        unit="rad",
        low=-math.pi,
        high=math.pi,
    )
    covariance: str = parameter(
        "largest",
        "Whose noise a measurement has: that of the message with at least noise_floor, that of the "
        "message as it is, or always noise_std and roll_pitch_std. They hold where the message "
        "tells none.",
        choices=noise.CHOICES,
        changeable=True,
    )
    noise_std: float = parameter(
        math.radians(2.0),
        "White noise of the heading, one sigma, where heading.covariance takes it.",
        unit="rad",
        low=1e-6,
        high=math.pi,
        changeable=True,
    )
    roll_pitch_std: float = parameter(
        math.radians(1.0),
        "Noise of the sensor's roll and pitch, one sigma. Without roll_pitch it matters to a "
        "pitched vehicle, whose yaw they tilt.",
        unit="rad",
        low=1e-6,
        high=math.pi,
        changeable=True,
    )
    noise_floor: float = parameter(
        math.radians(0.5),
        "With covariance 'largest', the smallest sigma that a message may tell.",
        unit="rad",
        low=0.0,
        high=math.pi,
        changeable=True,
    )
    error_std: float = parameter(
        math.radians(1.0),
        "Stationary sigma of the slowly varying error of the heading, one more state; 0 for a "
        "sensor without.",
        unit="rad",
        low=0.0,
        high=math.pi,
    )
    error_time_constant: float = parameter(
        300.0,
        "Correlation time of that error, first-order Gauss-Markov.",
        unit="s",
        above=0.0,
    )
    interval: float = parameter(
        0.5,
        "A measurement that follows the last used one sooner than this is left out: the noise of "
        "an attitude at the rate of an IMU is not white. 0 uses all.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    frozen_samples: int = parameter(
        20,
        "After this many exactly equal attitudes in a row, further ones are refused as 'frozen'; "
        "so is the repetition of one that the gate has rejected. 0 disables the check.",
        low=0,
        high=1_000_000,
        changeable=True,
    )

    EVENT = Heading
    ROOM: ClassVar[Mapping[str, int]] = {"heading_error": 1}

    def blocks(self) -> tuple[Block, ...]:
        """The slowly varying error, where there is a sensor that has one."""
        if not self.topic or self.error_std == 0.0:
            return ()
        return (Block("heading_error", (self.error_std,), self.error_time_constant),)

    def model(self, vehicle: Vehicle) -> "HeadingModel":
        """The sensor in a vehicle."""
        return (AttitudeModel if self.roll_pitch else HeadingModel)(self, vehicle)


class HeadingModel(SensorModel[Heading]):
    """Predicts the yaw that a heading sensor tells.

    Args:
        parameters: Of the sensor.
        vehicle: That carries it.
    """

    label = "heading sensor"
    rows = 1
    absolute = True
    angles = True

    def __init__(self, parameters: HeadingParameters, vehicle: Vehicle) -> None:
        self._parameters = parameters
        self._vehicle = vehicle
        self._error = vehicle.blocks.get("heading_error")
        tilt, yaw = parameters.roll_pitch_std**2, parameters.noise_std**2
        self._R = np.diag([tilt, tilt, yaw])
        self.interval_ns = round(parameters.interval * NS)

    def reading(self, event: Heading) -> Array:
        """The yaw."""
        return np.array([_yaw(event.C_n_b)])

    def refusal(self, event: Heading, past: Past) -> str:
        """``frozen``, see `claims.is_frozen`."""
        return "frozen" if claims.is_frozen(past, self._parameters.frozen_samples) else ""

    def attitude(self, event: Heading) -> tuple[Array, float]:
        """The attitude, and the sigma of its heading with the sensor's slow error."""
        return event.C_n_b, math.hypot(
            math.sqrt(self.noise(event)[_DOWN, _DOWN]), self._parameters.error_std
        )

    def noise(self, event: Heading) -> Array:
        """Covariance (3, 3) of its white noise about north, east and down [rad^2]."""
        parameters = self._parameters
        floor, whose = parameters.noise_floor, parameters.covariance
        return noise.chosen(event.P_psi, self._R, floor, whose)

    def linearise(self, state: Records, event: Heading, turn: Turn) -> Linearised:
        """Innovation, H = [0, A, 0, 0, 0 | 1] and R of the rows that are measured.

        A psi is what an error of the attitude makes of the prediction, and 1 belongs to the slow
        error e. It is the same for both kinds of error state.
        """
        nav = state[0]["nav"]
        A, error = self._rows(nav["C_n_b"]), 0.0
        H = np.zeros((self.rows, self._vehicle.n))
        H[:, ATTITUDE] = A
        if self._error is not None:
            H[-1, self._error] = 1.0
            error = float(nav["optional"][self._vehicle.optional("heading_error")][0])
        z_minus_h = self._innovation(event.C_n_b, nav["C_n_b"], error)
        return Linearised(z_minus_h, H, self._of_noise(A, self.noise(event)))

    def _rows(self, C_n_b: Array) -> Array:
        """A (1, 3): d chi = psi_D + tan(pitch) (cos chi psi_N + sin chi psi_E).

        The tangent is bounded. Where the nose is vertical R is so large that nothing is told.
        """
        chi, level = _yaw(C_n_b), math.hypot(C_n_b[0, 0], C_n_b[1, 0])
        tangent = -C_n_b[_DOWN, 0] / max(level, 1.0 / _LARGEST_TANGENT)
        return np.array([[tangent * math.cos(chi), tangent * math.sin(chi), 1.0]])

    def _of_noise(self, A: Array, P_psi: Array) -> Array:
        """R (1, 1): a sensor with an error of its tilt tells another yaw of a pitched vehicle.

        What the sender says of the tilt does not count: it may not measure it.
        """
        tilt = self._R[0, 0] * (A[0, :_DOWN] @ A[0, :_DOWN])
        return np.array([[P_psi[_DOWN, _DOWN] + tilt]])

    def _innovation(self, measured: Array, C_n_b: Array, error: float) -> Array:
        """Measured minus predicted (1,), within (-pi, pi]."""
        return np.array([wrapped(_yaw(measured) - _yaw(C_n_b) - error)])

    def in_stream(self, innovation: Array, S: Array) -> tuple[Array, Array]:
        """Turns about the axes of the stream: with east, north, up a yaw counts the other way."""
        nav = self._vehicle.axes.nav[-self.rows :, -self.rows :]
        return nav @ innovation, nav @ S @ nav.T

    def drift(self, s: State, seconds: float) -> Array:
        """Drift of the attitude by bias and noise of the gyroscope, and of the sensor's error."""
        nav, constants = s["nav"], self._vehicle.constants[0]
        P, C = nav["P"], nav["C_n_b"]
        turn = seconds**2 * P[GYROSCOPE_BIAS, GYROSCOPE_BIAS]
        turn = turn + seconds * constants["density"] * s["noise"]["Q_w"]
        J = self._rows(C) @ C
        drift = J @ turn @ J.T
        if self._error is not None:
            parameters = self._parameters
            decay = math.exp(-seconds / parameters.error_time_constant)
            drift[-1, -1] += 2.0 * parameters.error_std**2 * (1.0 - decay)
        return np.asarray(drift)

    def inflate(self, s: State, innovation: Array, seconds: float | None) -> None:
        """Doubt the attitude by the innovation, and the gyroscope bias that may have turned it.

        The bias becomes no more uncertain than it was at the start: a compass that passes steel
        would make one of degrees per second, which tilts the vehicle when it turns. The velocity in
        body axes, which a DVL tells, and the position in metres stay as they are.
        """
        vehicle, nav = self._vehicle, s["nav"]
        n, psi = vehicle.n, self._turn(innovation)
        a = np.zeros(n)
        a[ATTITUDE] = psi
        if not vehicle.invariant:
            a[VELOCITY] = -cross_matrix(nav["v_n"]) @ psi
        a[POSITION] = coordinates.turns_position(s, invariant=vehicle.invariant) @ psi
        if seconds is not None:
            size = float(np.linalg.norm(psi))
            axis = nav["C_n_b"].T @ psi / size
            known = float(axis @ nav["P"][GYROSCOPE_BIAS, GYROSCOPE_BIAS] @ axis)
            room = max(vehicle.gyroscope_bias_std**2 - known, 0.0)
            a[GYROSCOPE_BIAS] = -min(size / seconds, math.sqrt(room)) * axis
        nav["P"][:n, :n] += np.outer(a, a)

    def restart(self, s: State, innovation: Array, R: Array) -> None:
        """The attitude becomes the measured one, independent of all but the sensor's error.

        It is as uncertain as the two are apart, since one of them is wrong. The vehicle keeps its
        velocity in body axes. It stays where it is, in doubt by what the turn makes of its path.
        """
        vehicle, nav = self._vehicle, s["nav"]
        n, invariant, psi = vehicle.n, vehicle.invariant, self._turn(innovation)
        rows = np.arange(ATTITUDE.stop - self.rows, ATTITUDE.stop)
        to_body = np.linalg.inv(self._from_body(s))
        P = to_body @ nav["P"][:n, :n] @ to_body.T
        R_h = _about_down(psi[_DOWN])
        turn = rotation_from_vector(np.array([*psi[:_DOWN], 0.0]) if invariant else psi)
        if invariant:
            turn = R_h @ turn
        nav["C_n_b"] = turn @ nav["C_n_b"]
        nav["v_n"] = turn @ nav["v_n"]
        T = np.eye(n)  # the tilt is known in the axes of the vehicle, which turn
        T[ATTITUDE, ATTITUDE] = R_h
        P = T @ P @ T.T
        P[rows, :], P[:, rows] = 0.0, 0.0
        if self._error is not None:  # an error of the sensor is now one of the heading
            of_error = -P[self._error.start, :]
            P[_HEADING, :], P[:, _HEADING] = of_error, of_error
            P[_HEADING, _HEADING] = -of_error[self._error.start]
        P[np.ix_(rows, rows)] += R + np.outer(innovation, innovation)
        lever = cross_matrix(coordinates.from_reference(nav)) @ psi
        P[POSITION, POSITION] += np.outer(lever, lever)
        T = self._from_body(s)
        P = T @ P @ T.T
        nav["P"][:n, :n] = (P + P.T) / 2

    def _turn(self, innovation: Array) -> Array:
        """The innovation (m,) as a turn (3,) about north, east and down."""
        psi = np.zeros(3)
        psi[3 - self.rows :] = innovation
        return psi

    def _from_body(self, s: State) -> Array:
        """Jacobian (n, n) of the error state by errors of body velocity and of metres."""
        nav, vehicle = s["nav"], self._vehicle
        return coordinates.from_ordinary_errors(
            nav["C_n_b"],
            nav["v_n"],
            coordinates.from_reference(nav),
            invariant=vehicle.invariant,
            velocity_frame="body",
            n=vehicle.n,
        )


class AttitudeModel(HeadingModel):
    """Predicts roll, pitch and yaw together: the turn psi from the estimate to what is measured."""

    label = "attitude sensor"
    rows = 3

    def reading(self, event: Heading) -> Array:
        """Yaw, and where down is in the vehicle."""
        return np.array([_yaw(event.C_n_b), *event.C_n_b[_DOWN, :2]])

    def _rows(self, C_n_b: Array) -> Array:
        """The identity, exactly."""
        return np.eye(3)

    def _of_noise(self, A: Array, P_psi: Array) -> Array:
        """As it is."""
        return P_psi

    def _innovation(self, measured: Array, C_n_b: Array, error: float) -> Array:
        """The turn (3,) to what is measured, less its error; as the error state has turns."""
        nav, measured = {"C_n_b": C_n_b}, _about_down(-error) @ measured
        psi = attitude_error(nav, measured, invariant=self._vehicle.invariant)
        psi[_DOWN] = wrapped(psi[_DOWN])
        return psi


def wrapped(angle: float) -> float:
    """An angle [rad] within (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def _about_down(angle: float) -> Array:
    return rotation_from_rpy(np.array([0.0, 0.0, angle]))


def _yaw(C_n_b: Array) -> float:
    return math.atan2(C_n_b[1, 0], C_n_b[0, 0])
