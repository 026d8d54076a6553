"""Quality of service of the topics; each may be overridden by parameters (`qos_overrides.*`)."""

from math import ceil

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

#: A node that does nothing for 10 s loses no sample: those that come until it has caught up wait as
#: well [s].
QUEUE = 12.0
#: Rate of an IMU where it is not known [Hz]: hardly one is faster.
HIGH_RATE = 1000.0


def publisher_qos() -> QoSProfile:
    """Reliable and deep: a reliable subscriber loses nothing in a stall of seconds."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=2000, reliability=ReliabilityPolicy.RELIABLE
    )


def sensor_qos(rate: float = 0.0) -> QoSProfile:
    """Subscription to a sensor: best effort, which matches every driver's publisher.

    Args:
        rate: Of the messages, if they are many [Hz]; `QUEUE` seconds of them may wait.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(2000, ceil(QUEUE * rate)),
        reliability=ReliabilityPolicy.BEST_EFFORT,
    )


def command_qos() -> QoSProfile:
    """Subscription to single messages that must arrive; any reliable publisher matches."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE
    )


def latched_qos() -> QoSProfile:
    """Publisher whose last messages reach subscribers that start later."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=10,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def latched_command_qos() -> QoSProfile:
    """What was published before, as /tf_static is, for its subscriber and its publisher."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=100,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def overridable() -> QoSOverridingOptions:
    """What parameters may change."""
    return QoSOverridingOptions(
        (
            QoSPolicyKind.HISTORY,
            QoSPolicyKind.DEPTH,
            QoSPolicyKind.RELIABILITY,
            QoSPolicyKind.DURABILITY,
        )
    )
