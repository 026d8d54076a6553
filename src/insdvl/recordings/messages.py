"""New messages of `base.typestore`, such as a recording takes."""

from typing import Any

from numpy.typing import ArrayLike

from insdvl.messages.convert import IMU, ODOMETRY, TWIST, TWIST_WITH_COVARIANCE
from insdvl.messages.make import fill_imu, fill_odometry, fill_twist
from insdvl.messages.topics import BY_NAME
from insdvl.recordings.base import new_message


def message_of(topic: str) -> Any:
    """A message for a topic of the table, of the type that our own nodes publish."""
    return new_message(BY_NAME[topic].types[0])


def imu_message(
    stamp_ns: int,
    frame_id: str,
    f: ArrayLike,
    w: ArrayLike,
    Q_f: ArrayLike | None = None,
    Q_w: ArrayLike | None = None,
) -> Any:
    """A sensor_msgs/Imu; see `fill_imu`."""
    message = new_message(IMU)
    message.header.frame_id = frame_id
    fill_imu(message, stamp_ns, f, w, Q_f, Q_w)
    return message


def twist_message(stamp_ns: int, frame_id: str, v: ArrayLike, R: ArrayLike | None = None) -> Any:
    """A geometry_msgs/TwistStamped, with a covariance a TwistWithCovarianceStamped."""
    message = new_message(TWIST if R is None else TWIST_WITH_COVARIANCE)
    message.header.frame_id = frame_id
    fill_twist(message, stamp_ns, v, R)
    return message


def odometry_message(stamp_ns: int, frames: tuple[str, str], *numbers: ArrayLike | None) -> Any:
    """A nav_msgs/Odometry.

    Args:
        stamp_ns: Stamp [ns].
        frames: frame_id and child_frame_id.
        numbers: As `fill_odometry` takes them.
    """
    message = new_message(ODOMETRY)
    message.header.frame_id, message.child_frame_id = frames
    fill_odometry(message, stamp_ns, *numbers)  # type: ignore[arg-type]
    return message
