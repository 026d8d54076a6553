"""What an explanation says: the parameter to set, and its value."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.geometry.frames import (
    CONVENTIONS,
    rotation_from_rpy,
    rotation_from_vector,
    rpy_from_rotation,
    vector_from_rotation,
)
from insdvl.navigation.parameters import FilterParameters
from insdvl.watch.alignment.causes import DEGREES, UNITS, Cause, Miswired
from insdvl.watch.alignment.estimation import Fit
from insdvl.watch.alignment.rows import ARM, DELAY, GYROSCOPE_SCALE, MOUNT, SCALE, Mounted
from insdvl.watch.alignment.search import Explanation

FORWARD = math.radians(30.0)  # a vehicle travels forward within it; two courses that differ by it
TILTED = math.radians(10.0)  # difference between two tilts that tells them apart


@dataclass(frozen=True)
class Alignment:
    """Mount of the DVL against the IMU, in the terms and axes of the filter's parameters.

    Attributes:
        mount: dvl.mount, (3,) roll, pitch, yaw [rad].
        mount_std: (3,) one sigma of a turn about each axis of base_link [rad].
        scale: Of the DVL's velocities: true velocity per velocity that is read.
        scale_std: One sigma.
        lever_arm: dvl.lever_arm (3,) [m].
        lever_arm_std: (3,) one sigma [m].
        time_offset: dvl.time_offset [s].
        time_offset_std: One sigma [s].
        windows: Number of windows of 20 s from which it is estimated.
    """

    mount: Array
    mount_std: Array
    scale: float
    scale_std: float
    lever_arm: Array
    lever_arm_std: Array
    time_offset: float
    time_offset_std: float
    windows: int


@dataclass(frozen=True)
class Remedy:
    """What is wrong, and what to do about it.

    Attributes:
        text: Both, in a sentence.
        settings: Parameters of the filter that mend it, with their values; none where the driver
            must be corrected. Where two parameters would do, that of the DVL.
    """

    text: str
    settings: Mapping[str, Any] = field(default_factory=dict)


class Terms:
    """The unknowns in the terms of the parameters.

    Args:
        parameters: Of the filter, from which the unknowns count.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        axes = CONVENTIONS[parameters.frame_convention]
        self._axes = axes.body
        self._parameters = parameters
        self.C_b_i = axes.body_rotation(rotation_from_rpy(np.array(parameters.imu.mount)))
        C_b_d = axes.body_rotation(rotation_from_rpy(np.array(parameters.dvl.mount)))
        arm = np.array(parameters.dvl.lever_arm) - np.array(parameters.imu.lever_arm)
        self.known = Mounted(C_b_d, axes.body @ arm)

    def rpy(self, C: Array) -> Array:
        """Parameter (3,) of a mount that is a rotation (3, 3) to body axes."""
        return rpy_from_rotation(self._axes @ C @ self._axes)

    def alignment(self, fit: Fit) -> Alignment:
        """The values of a fit."""
        x, sigma = fit.values, fit.sigma
        scale = math.exp(-x[SCALE])
        return Alignment(
            mount=self.rpy(rotation_from_vector(x[MOUNT]) @ self.known.C_b_d),
            mount_std=sigma[MOUNT],
            scale=scale,
            scale_std=scale * float(sigma[SCALE]),
            lever_arm=np.array(self._parameters.dvl.lever_arm) + self._axes @ x[ARM],
            lever_arm_std=sigma[ARM],
            time_offset=self._parameters.dvl.time_offset - float(x[DELAY]),
            time_offset_std=float(sigma[DELAY]),
            windows=len(fit.noise.dof),
        )

    def remedy(self, explanation: Explanation, force: Array, v_d: Array) -> Remedy:
        """What is wrong, and what to set.

        Args:
            explanation: Of the motion.
            force: (3,) mean specific force in body axes, as imu.mount tells them.
            v_d: (3,) mean velocity in DVL axes.
        """
        cause, fit = explanation.cause, explanation.fit
        if isinstance(cause, Cause):
            found = self.alignment(fit)
            parts: list[Remedy] = []
            if explanation.accuses & {"mount"}:
                turn = rotation_from_vector(fit.values[MOUNT])
                parts.append(self._turned(turn, found.mount_std, force, v_d))
            if explanation.accuses & {"scale"}:
                parts.append(Remedy(_scaled(cause.unit, found)))
            if "arm" in cause.blocks:
                text = (
                    f"the lever arm of the DVL is wrong: set dvl.lever_arm to "
                    f"{_list(found.lever_arm, 2)} m (sigma {_list(found.lever_arm_std, 2)})"
                )
                parts.append(Remedy(text, {"dvl.lever_arm": _rounded(found.lever_arm, 2)}))
            if "delay" in cause.blocks:
                behind = found.time_offset - self._parameters.dvl.time_offset
                late = "late" if behind < 0.0 else "early"
                text = (
                    f"the stamps of the DVL are {abs(behind):.2f} s {late}: set dvl.time_offset to "
                    f"{found.time_offset:.3f} s (sigma {found.time_offset_std:.3f})"
                )
                parts.append(Remedy(text, {"dvl.time_offset": round(found.time_offset, 3)}))
            if "gyroscope scale" in cause.blocks:
                parts.append(Remedy(_gyroscope_scale(1.0, fit)))
            # What the driver must correct as well is not mended by parameters alone.
            mended = all(part.settings for part in parts)
            settings = {name: v for part in parts for name, v in part.settings.items()}
            return Remedy("; and ".join(part.text for part in parts), settings if mended else {})
        if cause.factor != 1.0:
            return Remedy(_gyroscope_scale(cause.factor, fit))
        if cause.sensor == "DVL" and np.linalg.det(cause.matrix) > 0.0:
            C_b_d = self.known.C_b_d
            turn = C_b_d @ cause.matrix @ C_b_d.T
            turn = rotation_from_vector(fit.values[MOUNT]) @ turn
            return self._turned(turn, fit.sigma[MOUNT], force, v_d)
        return Remedy(self._axes_of(cause))

    def _turned(self, turn: Array, sigma: Array, force: Array, v_d: Array) -> Remedy:
        """The DVL is turned against the IMU by `turn` (3, 3): it is the one or the other.

        The vertical tells which, or the direction of travel, which is forward for most vehicles.
        """
        of_dvl, of_imu = turn @ self.known.C_b_d, turn.T @ self.C_b_i
        by = np.degrees(self._axes @ vector_from_rotation(turn))
        angle = float(np.linalg.norm(by))
        names = [f"{'xyz'[i]} by {by[i]:+.1f} deg" for i in range(3) if abs(by[i]) > 0.1 * angle]
        what = f"turned about {', '.join(names)} (sigma {_list(np.degrees(sigma), 1)} deg)"
        dvl = Remedy(
            f"the DVL is {what}: set dvl.mount to {_list(self.rpy(of_dvl), 3)} rad",
            {"dvl.mount": _rounded(self.rpy(of_dvl), 3)},
        )
        back = ", ".join(
            f"{'xyz'[i]} by {-by[i]:+.1f} deg" for i in range(3) if abs(by[i]) > 0.1 * angle
        )
        imu = Remedy(
            f"the IMU is turned about {back} (sigma {_list(np.degrees(sigma), 1)} deg): "
            f"set imu.mount to {_list(self.rpy(of_imu), 3)} rad",
            {"imu.mount": _rounded(self.rpy(of_imu), 3)},
        )
        tilt, tilt_of_imu = _tilt(force), _tilt(turn.T @ force)
        if tilt_of_imu - tilt > TILTED:
            return dvl
        if tilt - tilt_of_imu > TILTED:
            return imu
        course, course_of_dvl = _course(self.known.C_b_d @ v_d), _course(of_dvl @ v_d)
        if course_of_dvl < FORWARD and course - course_of_dvl > FORWARD:
            return dvl
        if course < FORWARD and course_of_dvl - course > FORWARD:
            return imu
        return Remedy(f"{dvl.text}; or {imu.text}", dvl.settings)

    def _axes_of(self, cause: Miswired) -> str:
        """Which axes of a sensor are exchanged or reversed, in its own axes of the stream."""
        matrix = cause.matrix
        if cause.sensor != "DVL":
            matrix = self.C_b_i.T @ matrix @ self.C_b_i
        matrix = np.rint(self._axes @ matrix @ self._axes)
        if not (matrix - np.diag(np.diag(matrix))).any():
            names = [axis for axis, sign in zip("xyz", np.diag(matrix), strict=True) if sign < 0.0]
            return f"{cause.sensor} {' and '.join(names)} has the wrong sign: correct its driver"
        order = np.argmax(np.abs(matrix), axis=1)
        signs = np.sign(matrix[range(3), order])
        names = [
            "xyz"[k] if sign > 0.0 else f"-{'xyz'[k]}" for k, sign in zip(order, signs, strict=True)
        ]
        return (
            f"{cause.sensor} axes are exchanged: x, y, z of the vehicle are its "
            f"{', '.join(names)}; correct its driver"
        )


def _tilt(force: Array) -> float:
    """Angle [rad] between a specific force and up."""
    return math.acos(max(-1.0, min(1.0, -force[2] / float(np.linalg.norm(force)))))


def _course(v_b: Array) -> float:
    """Angle [rad] between a velocity and forward."""
    return math.atan2(math.hypot(v_b[1], v_b[2]), v_b[0])


def _list(values: Array, digits: int) -> str:
    return f"[{', '.join(f'{x:.{digits}f}' for x in values + 0.0)}]"


def _rounded(values: Array, digits: int) -> tuple[float, ...]:
    return tuple(round(float(x), digits) for x in values + 0.0)


def _scaled(unit: str, found: Alignment) -> str:
    relative = found.scale_std / found.scale
    if unit:
        return (
            f"the DVL is in {unit}: multiply its velocities by {UNITS[unit]:.4g} (the motion shows "
            f"{found.scale:.4g}, sigma {relative:.1%})"
        )
    large, times = ("large", 1.0 / found.scale) if found.scale < 1.0 else ("small", found.scale)
    return (
        f"the velocities of the DVL are {times:.3f} times too {large} (sigma {relative:.1%}): "
        f"multiply them by {found.scale:.3f}"
    )


def _gyroscope_scale(factor: float, fit: Fit) -> str:
    sigma = fit.sigma[GYROSCOPE_SCALE]
    if factor == DEGREES:
        return "the gyroscope is in deg/s: give it in rad/s"
    if factor == 1.0 / DEGREES:
        return "the gyroscope is 57.3 times too small: convert its deg/s to rad/s once, not twice"
    reading = factor / (1.0 - fit.values[GYROSCOPE_SCALE])
    large, times = ("large", reading) if reading > 1.0 else ("small", 1.0 / reading)
    return (
        f"the gyroscope is {times:.2f} times too {large} (sigma {sigma:.1%}): multiply its rates "
        f"by {1.0 / reading:.3f}"
    )
