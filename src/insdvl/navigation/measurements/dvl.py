"""The Doppler velocity log: velocity over ground, in the axes of the instrument."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, isnan, pi
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records
from insdvl.navigation import coordinates
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.events import MAX_SPEED, MAX_VARIANCE, NS, Limits, Measurement
from insdvl.navigation.geometry.frames import rotation_from_rpy
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
from insdvl.navigation.measurements.dvl_jacobian import ABSENT, linearise
from insdvl.navigation.measurements.dvl_ordinary import take_in
from insdvl.navigation.start.automatic import UNKNOWN_SPEED
from insdvl.navigation.state.fields import State
from insdvl.parameters.declaration import lever_arm, parameter, time_offset

#: Most tilt, one sigma [rad], that an inflation takes for possible.
LARGEST_TILT_DOUBT = 0.5

#: Message types of DVLs that are understood; messages/drivers.py has the fields of each.
TYPES = (
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
    "marine_acoustic_msgs/msg/Dvl",
    "dvl_msgs/msg/DVL",
    "stonefish_ros2/msg/DVL",
    "dave_interfaces/msg/DVL",
    "interfaces/msg/BottomTrack",
    "interfaces/msg/WaterTrack",
)


@dataclass(frozen=True, slots=True)
class Dvl(Measurement):
    """Velocity over ground at the DVL, in DVL axes.

    Attributes:
        v_d: (3,) velocity [m/s]; 0 for a component that was not measured.
        R: (3, 3) covariance [(m/s)^2] as the sender tells it, with zeros for a component of unknown
            variance; None where it tells nothing.
        measured: Which components were measured.
    """

    v_d: Array
    R: Array | None = None
    measured: tuple[bool, bool, bool] = (True, True, True)

    name = "dvl"
    kind = Measurement.FIRST

    def payload(self) -> bytes:
        """Velocity, which of it was measured, and covariance."""
        R = b"" if self.R is None else self.R.tobytes()
        return self.v_d.tobytes() + bytes(self.measured) + R

    def limits(self) -> Limits:
        """What no vehicle does."""
        return (self.v_d, MAX_SPEED), (self.R, MAX_VARIANCE)


@dataclass(frozen=True)
class DvlParameters(SensorParameters):
    """The real DVL and the error that is modelled of it."""

    type: str = parameter(
        "auto",
        "Message type on dvl/velocity. With auto it is that of the first publisher, whenever it "
        "appears, and in a replay that of the recording.",
        choices=("auto", *TYPES),
    )
    stamp: str = parameter(
        "message",
        "Whose time a measurement has: that of the message, or the stamp of the newest IMU sample "
        "at its arrival, for a device whose clock is not set. The state then depends on the order "
        "of arrival; set time_offset to minus the time that the message takes to arrive.",
        choices=("message", "arrival"),
    )
    frame_id: str = parameter(
        "",
        "A measurement of any other frame_id is refused as 'wrong_frame'; empty for any. Of an "
        "odometry it is the child_frame_id. A message without a header has none.",
    )
    mount: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        "How the DVL is turned in base_link, as roll, pitch, yaw in the axes of frame_convention, "
        "whatever axes its messages have; zeros for one that looks down, its x axis forwards.",
        unit="rad",
        low=-2 * pi,
        high=2 * pi,
        length=3,
    )
    lever_arm: tuple[float, ...] = lever_arm("DVL")
    time_offset: float = time_offset("DVL")
    covariance: str = parameter(
        "largest",
        "Whose noise a measurement has: that of the message with at least noise_floor in each "
        "component, that of the message as it is, or always noise_std. Where the message tells no "
        "covariance, or -1 or 0 for a component, it is noise_std.",
        choices=noise.CHOICES,
        changeable=True,
    )
    noise_std: tuple[float, ...] = parameter(
        (0.1, 0.1, 0.1),
        "Noise of each velocity component, one sigma, where dvl.covariance takes it.",
        unit="m/s",
        low=1e-6,
        length=3,
        one_for_all=True,
        changeable=True,
    )
    noise_source: str = parameter(
        "nominal",
        "Where the noise comes from: as dvl.covariance says; or that times a factor from the "
        "innovations, guarded by the pings and the IMU between them (adaptive), or from those "
        "alone (learned). The tuner's measurement_noise takes the place of the latter. With oracle "
        "the simulator's ground_truth/measurement_noise does.",
        choices=("nominal", "adaptive", "learned", "oracle"),
    )
    noise_floor: float = parameter(
        0.01,
        "The smallest sigma of a component that a message may tell with covariance 'largest', and "
        "that a noise_source may reach. Drivers tell the spread within one ping, or nothing that "
        "means anything; real errors are rarely smaller.",
        unit="m/s",
        low=0.0,
        high=10.0,
        changeable=True,
    )
    max_speed: float = parameter(
        10.0,
        "A velocity whose norm is larger is refused as 'too_fast'. Set it for a faster vehicle.",
        unit="m/s",
        above=0.0,
        high=MAX_SPEED,
        changeable=True,
    )
    lock_check: bool = parameter(
        True,
        "Refuse a velocity of exactly zero ('no_lock'), and one that exactly repeats one of the "
        "last eight where resolution and noise make that unlikely by chance ('repeated').",
        changeable=True,
    )
    gyro_average: float = parameter(
        0.25,
        "The turn rate for the lever arm is the value at the stamp of a line fitted to the samples "
        "of this time, which ends at the stamp; 0 takes one sample.",
        unit="s",
        low=0.0,
        high=10.0,
    )
    bias_model: str = parameter(
        "none",
        "Model of the slowly varying DVL error, three more states in DVL axes when it is on.",
        choices=("none", "gauss_markov"),
    )
    bias_std: tuple[float, ...] = parameter(
        (0.01, 0.01, 0.01),
        "Stationary sigma of the first-order Gauss-Markov error of each axis, 0 for one without. "
        "A vertical error carries the depth away where no depth sensor holds it.",
        unit="m/s",
        low=0.0,
        length=3,
    )
    bias_time_constant: float = parameter(
        10.0, "Correlation time of the first-order Gauss-Markov error.", unit="s", above=0.0
    )

    mount_std: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        "How well dvl.mount is known: one sigma of a constant rotation about each DVL axis, three "
        "more states; zeros where it is known.",
        unit="rad",
        low=0.0,
        high=0.5,
        length=3,
    )

    EVENT = Dvl
    ROOM: ClassVar[Mapping[str, int]] = {"dvl_error": 3, "dvl_mount": 3}
    REMEDIES: ClassVar[Mapping[str, str]] = {
        "invalid": "the driver marks them as invalid, or fills in numbers that stand for none, "
        "such as a sigma of 10 m/s or more: wait for bottom lock, or correct the driver's "
        "covariance",
        "no_bottom": "altitude below zero, or fewer than three beams: the DVL has no bottom lock",
        "no_lock": "the DVL sends exact zeros: it has no bottom lock",
        "repeated": "the DVL repeats an earlier measurement: no bottom lock, or two publishers",
        "through_water": "they are of the water and not of the bottom: turn water track off, or "
        "give it a topic of its own",
        "too_fast": "they are faster than dvl.max_speed: fill values of a DVL without bottom lock, "
        "the DVL is in cm/s or mm/s, or dvl.max_speed is too small",
    }

    def blocks(self) -> tuple[Block, ...]:
        """The DVL's error and its mount, where they are modelled.

        Real errors are correlated over seconds; a mount is constant.
        """
        blocks = []
        if self.bias_model != "none":
            blocks.append(Block("dvl_error", self.bias_std, self.bias_time_constant))
        if any(self.mount_std):
            blocks.append(Block("dvl_mount", self.mount_std))
        return tuple(blocks)

    def model(self, vehicle: Vehicle) -> "DvlModel":
        """The DVL in a vehicle."""
        return DvlModel(self, vehicle)


class DvlModel(SensorModel[Dvl]):
    """Predicts what the DVL measures.

    Args:
        parameters: Of the DVL.
        vehicle: That carries it.
    """

    label = "DVL"
    rows = 3
    tells_velocity = True

    def __init__(self, parameters: DvlParameters, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        axes = vehicle.axes
        self._C_b_d = axes.body_rotation(rotation_from_rpy(np.array(parameters.mount)))
        self._C_d_b = np.ascontiguousarray(self._C_b_d.T)
        self._l_b = vehicle.lever_arm(parameters.lever_arm)
        self._parameters = parameters
        self._R = np.diag(np.square(parameters.noise_std))
        # Of the first of the optional error states, for the kernel.
        self._error_at, self._mount_at = (
            vehicle.blocks[block].start if block in vehicle.blocks else ABSENT
            for block in ("dvl_error", "dvl_mount")
        )
        self.turn_window_ns = round(parameters.gyro_average * NS)
        self.noise_source, self.noise_floor = parameters.noise_source, parameters.noise_floor

    def reading(self, event: Dvl) -> Array:
        """The velocity."""
        return event.v_d

    def refusal(self, event: Dvl, past: Past) -> str:
        """``too_fast``, ``no_lock`` or ``repeated``: what a DVL without bottom lock reports."""
        speed = hypot(*event.v_d)
        if speed > self._parameters.max_speed:
            return "too_fast"
        if not self._parameters.lock_check:
            return ""
        if speed == 0.0:
            return "no_lock"
        if not past.equal:
            return ""
        sigma = np.sqrt(np.abs(np.diagonal(self.noise(event))))
        known = np.array(event.measured)  # the others are zeros, whose equality tells nothing
        chance = claims.repeat_chance(event.v_d[known], past.readings[:, known], sigma[known])
        return "repeated" if chance < claims.LEAST_CHANCE else ""

    def noise(self, event: Dvl) -> Array:
        """Covariance (3, 3) of one measurement's noise, as ``dvl.covariance`` has it [(m/s)^2]."""
        parameters = self._parameters
        return noise.chosen(event.R, self._R, parameters.noise_floor, parameters.covariance)

    def claims_rest(self, event: Dvl) -> bool:
        """Exact zeros: no bottom lock, or a vehicle at rest."""
        return not event.v_d.any()

    def velocity(self, event: Dvl, turn: Turn) -> tuple[Array, Array] | None:
        """v_b = C_b_d v_d - w x l with the arm l from base_link.

        A component that was not measured is 0, with `UNKNOWN_SPEED` as its sigma; None without any.
        """
        if not any(event.measured):
            return None
        missing = ~np.array(event.measured)
        R = np.where(missing[:, None] | missing, 0.0, self.noise(event))
        R[missing, missing] = UNKNOWN_SPEED**2
        l_x = cross_matrix(self._l_b + self._vehicle.l_b_imu)
        P = self._C_b_d @ R @ self._C_d_b + l_x @ turn.covariance @ l_x.T
        return self._C_b_d @ event.v_d + l_x @ turn.w_ib_b, (P + P.T) / 2

    def linearise(self, state: Records, event: Dvl, turn: Turn) -> Linearised:
        """h = C_d_b (C_b_n v_n + w_nb_b x l) + b_d,  w_nb_b = w_ib_b - b_w - C_b_n w_in_n.

        H = C_d_b [ C_b_n | C_b_n [v x] (ned) or 0 (invariant) | 0 | [l x] | 0 ], the identity in
        the block of the DVL's error, [h x] J in that of its mount, and [l x] C_b_n [w_in x] in the
        attitude column, from the Earth rate in w_nb (docs/explanation/error-state.md). The turn
        rate is measured too: R has its share [l x] Cov(w) [l x]^T.
        """
        vehicle = self._vehicle
        z_minus_h, H, R = np.array(event.v_d), np.zeros((3, vehicle.n)), np.empty((3, 3))
        linearise(
            state,
            vehicle.workspace,
            vehicle.constants,
            self._C_d_b,
            self._l_b,
            self._error_at,
            self._mount_at,
            self.noise(event),
            turn.w_ib_b,
            turn.covariance,
            z_minus_h,
            H,
            R,
        )
        if not all(event.measured):
            _leave_out(~np.array(event.measured), state[0]["nav"]["P"], z_minus_h, H, R)
        return Linearised(z_minus_h, H, R)

    def take_in(
        self,
        state: Records,
        memory: Records,
        event: Dvl,
        w_ib_b: Array,
        share: Array,
        limits: Array,
        patience_ns: int,
    ) -> tuple[Array, Array, float] | None:
        """In one kernel, where all components were measured."""
        if not all(event.measured):
            return None
        vehicle, innovation, S = self._vehicle, np.empty(3), np.empty((3, 3))
        nis = take_in(
            state,
            memory,
            vehicle.workspace,
            vehicle.constants,
            self._C_d_b,
            self._l_b,
            self._error_at,
            self._mount_at,
            self.noise(event),
            event.v_d,
            w_ib_b,
            share,
            limits,
            event.stamp_ns,
            patience_ns,
            innovation,
            S,
        )
        return None if isnan(nis) else (innovation, S, nis)

    def in_stream(self, innovation: Array, S: Array) -> tuple[Array, Array]:
        """Velocities, in the body axes of the stream's convention."""
        signs = self._vehicle.axes.signs  # a rotation would make nan of infinity
        return signs * innovation, signs[:, None] * S * signs

    def drift(self, s: State, seconds: float) -> Array:
        """Drift of the velocity in DVL axes by tilt, accelerometer bias and the samples' noise."""
        workspace, constants = self._vehicle.workspace[0], self._vehicle.constants[0]
        C, P, Q_f = s["nav"]["C_n_b"], s["nav"]["P"], s["noise"]["Q_f"]
        g_x = cross_matrix(workspace["g_n"])
        acceleration = g_x @ P[ATTITUDE, ATTITUDE] @ g_x.T
        acceleration += C @ P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] @ C.T
        drift = seconds**2 * acceleration + seconds * constants["density"] * (C @ Q_f @ C.T)
        C_n_d = C @ self._C_b_d
        return C_n_d.T @ drift @ C_n_d

    def inflate(self, s: State, innovation: Array, seconds: float | None) -> None:
        """Doubt the velocity, and the tilt that may have led it astray since it last fitted.

        A tilt error psi drives the velocity by [g x] psi, which is level; the one that makes the
        level part of the innovation in the time that has passed is one sigma.
        """
        n = self._vehicle.n
        P, level = s["nav"]["P"][:n, :n], (s["nav"]["C_n_b"] @ self._C_b_d @ innovation)[:2]
        variance = float(innovation @ innovation)
        P[VELOCITY, VELOCITY] += np.eye(3) * variance
        if seconds is not None:
            g_n = self._vehicle.workspace[0]["g_n"]
            sigma = np.linalg.norm(level) / (np.linalg.norm(g_n) * seconds)
            sigma = min(float(sigma), LARGEST_TILT_DOUBT)
            A = np.zeros((n, 2))  # of the turns about north and east
            A[ATTITUDE] = np.eye(3)[:, :2]
            A[VELOCITY] = seconds * cross_matrix(g_n)[:, :2]
            turned = coordinates.turns_position(s, invariant=self._vehicle.invariant)
            A[POSITION] = turned[:, :2]  # in metres the position stays
            P += sigma**2 * (A @ A.T)

    def restart(self, s: State, innovation: Array, R: Array) -> None:
        """The velocity becomes the measured one, independent of all else.

        It is as uncertain as the two are apart, since one of them is wrong.
        """
        vehicle, nav = self._vehicle, s["nav"]
        n = vehicle.n
        nav["v_n"] += nav["C_n_b"] @ self._C_b_d @ innovation
        P = nav["P"][:n, :n]
        P[VELOCITY, :] = 0.0
        P[:, VELOCITY] = 0.0
        T = coordinates.from_ordinary_errors(
            nav["C_n_b"],
            nav["v_n"],
            np.zeros(3),  # the position is in the coordinates of the model already
            invariant=vehicle.invariant,
            velocity_frame="body",
            n=n,
        )
        doubt = R + np.outer(innovation, innovation)
        P[VELOCITY, VELOCITY] = self._C_b_d @ doubt @ self._C_b_d.T
        P[:] = T @ P @ T.T
        P[:] = (P + P.T) / 2


def _leave_out(rows: NDArray[np.bool_], P: Array, z_minus_h: Array, H: Array, R: Array) -> None:
    """Make components (m,) of a linearised measurement tell nothing, in place.

    Their noise becomes as large as the filter's own sigma, so that S is as with a measurement, and
    a restart of the state, which goes by R, leaves them as uncertain as they are.
    """
    n = H.shape[1]
    variance = np.diagonal(H @ P[:n, :n] @ H.T + R)[rows]
    z_minus_h[rows], H[rows], R[rows], R[:, rows] = 0.0, 0.0, 0.0, 0.0
    R[rows, rows] = variance
