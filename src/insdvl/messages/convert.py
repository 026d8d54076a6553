"""Standard ROS messages to events, without ROS.

A message is anything with the fields of the standard type: an rclpy message, or one read from a
recording. Nodes and `insdvl replay` use the same functions, so both get the same numbers.

Covariances follow REP-145: a first element of -1 means that the quantity is not measured, zeros
mean that the covariance is unknown. A single zero on the diagonal means that this variance is
unknown, since nothing is known perfectly; see `completed`. The velocity of a DVL has rules of its
own, see `velocity_covariance` and dvl.py.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Stamps
from insdvl.messages.cdr import imu_bytes
from insdvl.messages.cdr.imu_bytes import ImuColumns
from insdvl.navigation.events import (
    MAX_ACCELERATION,
    MAX_RATE,
    MAX_VARIANCE,
    NS,
    Imu,
    Initial,
    Orientation,
    Origin,
    ProcessNoise,
    SensorNoise,
)
from insdvl.navigation.geometry.earth import MAX_LATITUDE_DEG
from insdvl.navigation.geometry.frames import Convention, rotation_from_quaternion
from insdvl.navigation.geometry.odom import MAX_FROM_ORIGIN

#: Message types that are converted here.
IMU = "sensor_msgs/msg/Imu"
FIX = "sensor_msgs/msg/NavSatFix"
TWIST = "geometry_msgs/msg/TwistStamped"
TWIST_WITH_COVARIANCE = "geometry_msgs/msg/TwistWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"


#: The sigma of a DVL's component that stands for none [m/s]: it is the fill value of a figure of
#: merit, and no DVL that is this unsure tells anything. ROS's drivers write huge variances for what
#: is not measured, too.
FILL_SIGMA = 10.0
#: Asymmetry and negative eigenvalues of a covariance, relative to its largest element, that come
#: from rounding to single precision.
ROUNDING = 1e-6


class RejectedMessage(ValueError):
    """A message cannot be used.

    Attributes:
        reason: The word under which it is counted, see `insdvl.messages.refusals`.
        measurement: Which of its events cannot be used, where the others can; empty for all.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason
        self.measurement = ""


def stamp_ns(header: Any) -> int:
    """Stamp of a header in integer nanoseconds.

    Raises:
        RejectedMessage: ``bad_stamp`` (negative seconds, or nanoseconds beyond a second).
    """
    seconds, nanoseconds = int(header.stamp.sec), int(header.stamp.nanosec)
    if seconds < 0 or not 0 <= nanoseconds < NS:
        raise RejectedMessage("bad_stamp", f"stamp is {seconds} s and {nanoseconds} ns")
    return seconds * NS + nanoseconds


def sensor_stamp_ns(header: Any) -> int:
    """As `stamp_ns`, of a sensor: there zero means that the driver has not set the stamp.

    Raises:
        RejectedMessage: ``bad_stamp`` or ``no_stamp``.
    """
    stamp = stamp_ns(header)
    if stamp == 0:
        raise RejectedMessage("no_stamp", "stamp is 0")
    return stamp


def vector(field: Any, name: str, measured: Sequence[bool] = (True, True, True)) -> Array:
    """A Vector3 or Point as (3,), with 0 for what was not measured.

    Raises:
        RejectedMessage: ``not_finite``.
    """
    numbers = [float(field.x), float(field.y), float(field.z)]
    if math.isfinite(numbers[0] + numbers[1] + numbers[2]) and all(measured):
        return np.array(numbers)
    if not all(math.isfinite(x) for x, known in zip(numbers, measured, strict=True) if known):
        raise RejectedMessage("not_finite", f"{name} is {numbers}")
    return np.array([x if known else 0.0 for x, known in zip(numbers, measured, strict=True)])


def square(field: Any, size: int, name: str) -> Array:
    """A row-major field of size^2 numbers as (size, size).

    Raises:
        RejectedMessage: ``bad_covariance``: the number of elements is wrong.
    """
    value = np.asarray(field, dtype=float).ravel()
    if value.size != size * size:
        raise RejectedMessage("bad_covariance", f"{name} has {value.size} elements")
    return value.reshape(size, size)


def covariance(field: Any, size: int, name: str) -> Array | None:
    """A row-major covariance field as (size, size); None where it is unknown (zeros).

    What rounding to single precision does is mended: it is made symmetric, and a slightly negative
    eigenvalue zero.

    Raises:
        RejectedMessage: ``no_data`` (first element -1), ``bad_covariance`` (wrong size, not finite,
            not symmetric, or not positive semidefinite).
    """
    matrix = square(field, size, name)
    if matrix[0, 0] == -1.0:
        raise RejectedMessage("no_data", f"{name}[0] is -1")
    if not matrix.any():
        return None
    if not np.isfinite(matrix).all():
        raise RejectedMessage("bad_covariance", f"{name} is not finite: {matrix.tolist()}")
    scale = np.abs(matrix).max()
    if scale > MAX_VARIANCE:
        raise RejectedMessage("bad_covariance", f"{name} has an element of size {scale:g}")
    if np.abs(matrix - matrix.T).max() > ROUNDING * scale:
        raise RejectedMessage("bad_covariance", f"{name} is not symmetric: {matrix.tolist()}")
    matrix = (matrix + matrix.T) / 2
    smallest = np.linalg.eigvalsh(matrix)[0]
    if smallest < -ROUNDING * scale:
        raise RejectedMessage("bad_covariance", f"{name} has a negative eigenvalue")
    return matrix if smallest >= -1e-9 * scale else _without_negative(matrix)


def _without_negative(matrix: Array) -> Array:
    """The nearest positive semidefinite matrix (n, n)."""
    values, vectors = np.linalg.eigh(matrix)
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return (nearest + nearest.T) / 2


def velocity_covariance(
    field: Any, name: str, rows: int
) -> tuple[Array | None, tuple[bool, bool, bool]]:
    """Covariance (3, 3) of a velocity, or of a twist's linear one, and what was measured.

    Drivers of DVLs write -1 for a variance that they do not know: it becomes zero, as all of its
    correlations. One of `FILL_SIGMA`^2 or more, also infinity, means that the component was not
    measured: it becomes zero too.

    Args:
        field: Row-major covariance.
        name: Of the field.
        rows: Number of its rows: 3, or 6 of a twist.

    Raises:
        RejectedMessage: ``no_data`` (all variances are infinite), ``invalid`` (no component was
            measured), ``bad_covariance``.
    """
    matrix = square(field, rows, name)[:3, :3]
    variances = np.diagonal(matrix)
    measured = ~(variances >= FILL_SIGMA**2)  # nan is not, and is refused below
    if (variances == np.inf).all():
        raise RejectedMessage("no_data", f"all variances of {name} are infinite")
    if not measured.any():
        raise RejectedMessage(
            "invalid",
            f"all sigmas of {name} are {FILL_SIGMA:g} m/s or more, which stands for no velocity: "
            f"{np.sqrt(variances).tolist()}",
        )
    told = measured & (variances != -1.0)
    x, y, z = measured.tolist()
    return covariance(np.where(told[:, None] & told, matrix, 0.0), 3, name), (x, y, z)


def completed(P: Array | None, sigmas: Sequence[float]) -> Array | None:
    """A covariance (3, 3) with these sigmas in place of unknown variances (zeros).

    The components filled in are independent of the others. None (all unknown) stays None.
    """
    if P is None or np.diagonal(P).all():
        return P
    unknown = np.diagonal(P) == 0.0
    known = np.where(unknown[:, None] | unknown, 0.0, P)
    return known + np.diag(np.where(unknown, np.square(sigmas), 0.0))


def _not_measured(field: Any) -> bool:
    """Whether a covariance field, of any size, begins with REP-145's -1."""
    return len(field) > 0 and float(field[0]) == -1.0


def imu(message: Any, convention: Convention) -> Imu:
    """The sample of a sensor_msgs/Imu.

    Raises:
        RejectedMessage: ``bad_stamp``, ``no_stamp``, ``not_finite``, or ``no_data`` where a triad
            is marked as not measured.
    """
    for name in ("linear_acceleration", "angular_velocity"):
        if _not_measured(getattr(message, name + "_covariance")):
            raise RejectedMessage("no_data", f"{name}_covariance[0] is -1")
    return Imu(
        stamp_ns=sensor_stamp_ns(message.header),
        f_b=_in_body(vector(message.linear_acceleration, "linear_acceleration"), convention),
        w_ib_b=_in_body(vector(message.angular_velocity, "angular_velocity"), convention),
    )


def _in_body(vectors: Array, convention: Convention) -> Array:
    """Vectors (..., 3) of the stream, forward-right-down; the same bits for any number of them.

    The axes differ in signs only. The sum makes zero of minus zero.
    """
    return convention.signs * vectors + 0.0


class ImuSamples(NamedTuple):
    """The samples of N messages, as `imu` gives one.

    Attributes:
        frame_ids: Those that occur, with their numbers.
        frames: (N,) number of each message's frame_id.
        stamps_ns: (N,) stamps.
        f_b: (N, 3) specific force [m/s^2].
        w_ib_b: (N, 3) angular rate [rad/s].
        usable: (N,) whether a message is a sample that `imu` converts and `events.refusal` lets
            pass. What is wrong with the others, these two tell.
        oriented: (N,) whether `orientation` may find one in a message.
    """

    frame_ids: dict[str, int]
    frames: NDArray[np.intp]
    stamps_ns: Stamps
    f_b: Array
    w_ib_b: Array
    usable: NDArray[np.bool_]
    oriented: NDArray[np.bool_]


def imu_samples(messages: ImuColumns, convention: Convention, heading_std: float) -> ImuSamples:
    """The samples of many messages.

    Args:
        messages: The messages.
        convention: Of their axes.
        heading_std: See `orientation`.
    """
    stamps_ns = messages.seconds.astype(np.int64) * NS + messages.nanoseconds
    usable = messages.fits & (messages.seconds >= 0) & (messages.nanoseconds < NS)
    usable &= stamps_ns > 0
    f = messages.numbers[:, imu_bytes.LINEAR_ACCELERATION]
    w = messages.numbers[:, imu_bytes.ANGULAR_VELOCITY]
    for triad, limit in (f, MAX_ACCELERATION), (w, MAX_RATE):
        usable &= (np.abs(triad) <= limit).all(axis=1)  # nan is not
    for columns in imu_bytes.LINEAR_ACCELERATION_COVARIANCE, imu_bytes.ANGULAR_VELOCITY_COVARIANCE:
        usable &= messages.numbers[:, columns.start] != -1.0
    variances = messages.numbers[:, imu_bytes.ORIENTATION_COVARIANCE]
    oriented = ~(variances[:, 0] < 0.0) & ((variances[:, 8] != 0.0) | (heading_std != 0.0))
    f_b, w_ib_b = (_in_body(triad, convention) for triad in (f, w))
    frames = messages.frame_ids, messages.frames
    return ImuSamples(*frames, stamps_ns, f_b, w_ib_b, usable, oriented)


def orientation(message: Any, convention: Convention, heading_std: float) -> Orientation | None:
    """The attitude in a sensor_msgs/Imu; None where it is not measured, or not a rotation.

    Args:
        message: The sample.
        convention: Of its axes.
        heading_std: One sigma of the heading [rad] where the covariance is unknown (zeros); 0 takes
            such an orientation for one that is not measured.
    """
    q = message.orientation
    q_xyzw = np.array([q.x, q.y, q.z, q.w], dtype=float)
    field = np.asarray(message.orientation_covariance, dtype=float).ravel()
    if field.size != 9 or not abs(np.hypot.reduce(q_xyzw) - 1.0) < 1e-2:
        return None
    if field[0] < 0.0 or not (np.isfinite(field[8]) and field[8] >= 0.0):
        return None
    # As in `completed`, a variance of zero is an unknown one.
    sigma = math.sqrt(field[8]) or heading_std
    if not 0.0 < sigma < math.pi:
        return None
    return Orientation(
        stamp_ns=sensor_stamp_ns(message.header),
        C_n_i=convention.attitude(rotation_from_quaternion(q_xyzw)),
        heading_std=sigma,
    )


def process_noise(message: Any, convention: Convention) -> ProcessNoise:
    """The per-sample covariances of a sensor_msgs/Imu.

    Raises:
        RejectedMessage: ``bad_stamp`` or ``bad_covariance``.
    """

    def rotated(name: str) -> Array | None:
        field = getattr(message, name)
        if _not_measured(field):
            return None
        Q = covariance(field, 3, name)
        return None if Q is None else convention.body @ Q @ convention.body.T

    return ProcessNoise(
        stamp_ns=stamp_ns(message.header),
        Q_f=rotated("linear_acceleration_covariance"),
        Q_w=rotated("angular_velocity_covariance"),
    )


def measurement_noise(message: Any, convention: Convention, of: str) -> SensorNoise:
    """The covariance of the linear part of a geometry_msgs/TwistWithCovarianceStamped.

    Args:
        message: The message; its twist tells nothing.
        convention: Of its axes.
        of: Name of the measurements whose noise it is.

    Raises:
        RejectedMessage: ``bad_stamp``, ``no_data`` (-1 or zeros: unknown) or ``bad_covariance``,
            which one that is not positive definite is too.
    """
    name = "twist.covariance"
    R = covariance(square(message.twist.covariance, 6, name)[:3, :3], 3, name)
    if R is None:
        raise RejectedMessage("no_data", f"{name} is unknown (zeros)")
    values = np.linalg.eigvalsh(R)
    if values[0] <= ROUNDING * values[-1]:
        raise RejectedMessage("bad_covariance", f"{name} is singular: {R.tolist()}")
    return SensorNoise(stamp_ns(message.header), of, convention.body @ R @ convention.body.T)


def initial(message: Any, convention: Convention, *, once: bool) -> Initial:
    """The state of a nav_msgs/Odometry: pose in odom, twist in body axes (REP-105).

    Raises:
        RejectedMessage: ``bad_stamp``, ``not_finite``, ``bad_quaternion``, ``no_data``,
            ``bad_covariance``, or ``out_of_range`` for a position too far from the origin.
    """
    q = message.pose.pose.orientation
    q_xyzw = np.array([q.x, q.y, q.z, q.w], dtype=float)
    if not abs(np.linalg.norm(q_xyzw) - 1.0) < 1e-2:
        raise RejectedMessage("bad_quaternion", f"orientation is {q_xyzw.tolist()}")
    pose = covariance(message.pose.covariance, 6, "pose.covariance")
    twist = covariance(message.twist.covariance, 6, "twist.covariance")
    nav, body = convention.nav, convention.body
    position = vector(message.pose.pose.position, "position")
    distance = np.hypot(position[0], position[1])
    if distance > MAX_FROM_ORIGIN:
        raise RejectedMessage(
            "out_of_range",
            f"position is {distance / 1e3:.0f} km from the origin, at most "
            f"{MAX_FROM_ORIGIN / 1e3:g} km are possible",
        )

    def block(P: Array | None, rows: slice, rotation: Array) -> Array | None:
        if P is None or not P[rows, rows].any():
            return None
        return rotation @ P[rows, rows] @ rotation.T

    return Initial(
        stamp_ns=stamp_ns(message.header),
        C_o_b=convention.attitude(rotation_from_quaternion(q_xyzw)),
        p_o=nav @ position,
        v=body @ vector(message.twist.twist.linear, "twist.linear"),
        velocity_frame="body",
        P_v=block(twist, slice(0, 3), body),
        P_psi=block(pose, slice(3, 6), nav),
        P_p=block(pose, slice(0, 3), nav),
        once=once,
    )


def origin(message: Any, height: float) -> Origin:
    """The position of a sensor_msgs/NavSatFix.

    Args:
        message: The fix.
        height: Used where the fix has no altitude (NaN) [m].

    Raises:
        RejectedMessage: ``bad_stamp``, ``no_data`` (status below 0), ``not_finite`` or
            ``out_of_range`` (the latitude; the fold checks the height).
    """
    if message.status.status < 0:
        raise RejectedMessage("no_data", f"status is {message.status.status}")
    altitude = height if math.isnan(message.altitude) else message.altitude
    fix = np.array([message.latitude, message.longitude, altitude], dtype=float)
    if not np.isfinite(fix).all():
        raise RejectedMessage("not_finite", f"fix is {fix.tolist()}")
    if abs(fix[0]) > MAX_LATITUDE_DEG:
        raise RejectedMessage(
            "out_of_range",
            f"latitude is {fix[0]} deg, the filter navigates within +-{MAX_LATITUDE_DEG:g} deg",
        )
    return Origin(
        stamp_ns=stamp_ns(message.header),
        lat=float(np.radians(fix[0])),
        lon=float(np.radians(fix[1])),
        h=float(fix[2]),
    )
