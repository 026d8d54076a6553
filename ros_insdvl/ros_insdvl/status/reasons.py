"""What to do about refused messages, by the reason."""

from collections.abc import Mapping
from types import MappingProxyType

from insdvl.messages.topics import IMU
from insdvl.navigation.parameters import SENSORS

#: Reasons that concern the stamp and not the content of a message.
OF_TIME = ("no_stamp", "bad_stamp", "too_late", "far_ahead")
#: Those of them for which a message is kept a while: at a time jump or behind a gap it is used.
KEPT = ("too_late", "far_ahead")
#: Reasons that concern the frame of a message.
OF_FRAMES = ("wrong_frame",)

REMEDIES: Mapping[str, str] = MappingProxyType(
    {
        "bad_covariance": "the sender's covariance is not finite, not symmetric or negative",
        "bad_quaternion": "the sender's attitude is not a unit quaternion",
        "bad_stamp": "the sender's stamps are negative or have too many nanoseconds",
        "duplicate": "two senders on one topic, or a network that duplicates messages",
        "far_ahead": "the sender's clock is ahead of the IMU's",
        "gate": "the measurements do not fit: check the sensor, its mount and noise, and the IMU",
        "no_data": "the sender marks its data as not measured",
        "no_extrinsics": "mounts and lever arms are not known yet, see the status extrinsics",
        "no_stamp": "the driver does not stamp its messages",
        "not_finite": "the sender sends NaN or infinity",
        "out_of_range": "the values are physically impossible, or no place where the filter "
        "navigates: check the sender's units",
        "too_late": "they arrive more than max_delay after the IMU: shorten the delay or raise "
        "max_delay",
        "wrong_frame": "another sensor publishes there, or the expected frame_id is wrong: set it",
        **{
            reason: remedy
            for group in SENSORS.values()
            for reason, remedy in group.REMEDIES.items()
        },
    }
)

#: The same of the IMU, whose own stamps are the time that the filter knows.
REMEDIES_OF_IMU: Mapping[str, str] = MappingProxyType(
    {
        "too_late": "their stamps are behind the newest one by more than max_delay: check the "
        "IMU's clock and that only one sender publishes there; raise max_delay only where the "
        "network delays them as long",
        "far_ahead": "their stamps are far ahead of the one before: check the IMU's clock",
    }
)


def remedy_of(topic: str, reason: str) -> str | None:
    """What to do about messages of a topic that were refused for a reason."""
    of_imu = REMEDIES_OF_IMU.get(reason) if topic == IMU else None
    return of_imu or REMEDIES.get(reason)
