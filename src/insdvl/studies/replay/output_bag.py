"""The recording of `insdvl replay --out`: the inputs, and what the filter node publishes."""

from collections.abc import Sequence

import numpy as np

from insdvl.messages.topics import IMU, measurement_of
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.navigation.odometry import biases, odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw, decode, encode
from insdvl.recordings.messages import imu_message, odometry_message, twist_message
from insdvl.studies.replay.fold import Replayed


def write_bag(
    bag: BagWriter, recording: Sequence[Raw], replayed: Replayed, parameters: FilterParameters
) -> None:
    """Write what was folded, and all that the filter node would publish.

    Raises:
        BagError: The disk cannot be written.
    """
    for raw in recording:
        bag.write(raw._replace(topic="/" + raw.topic))
    axes = CONVENTIONS[parameters.frame_convention].body
    frames = parameters.odom_frame, parameters.base_frame
    frame_ids = {raw.topic: decode(raw).message.header.frame_id for raw in _firsts(recording)}
    dvl_frame = next(
        (frame for topic, frame in frame_ids.items() if measurement_of(topic) == "dvl"), ""
    )
    second = None
    initialised = [
        (part, int(k))
        for part in replayed.parts
        for k in np.flatnonzero(part.states["nav"]["initialised"])
    ]
    for part, k in initialised:
        state = odometry(part.filter, part.states, k)
        message = odometry_message(
            state.stamp_ns,
            frames,
            state.position,
            state.quaternion_xyzw,
            state.twist_linear,
            state.twist_angular,
            state.pose_covariance,
            state.twist_covariance,
        )
        bag.write(encode("/odometry/filtered", state.stamp_ns, message))
        if state.stamp_ns // NS != second:
            second = state.stamp_ns // NS
            bias = biases(part.filter, part.states[k])
            message = imu_message(
                bias.stamp_ns,
                frame_ids[IMU],
                bias.accelerometer,
                bias.gyroscope,
                bias.accelerometer_covariance,
                bias.gyroscope_covariance,
            )
            bag.write(encode("/imu/bias", bias.stamp_ns, message))
    for update in replayed.updates:
        if not np.isfinite(update.report.nis):
            continue  # refused before it was compared with a prediction
        message = twist_message(
            update.stamp_ns,
            dvl_frame,
            axes @ update.report.innovation,
            axes @ update.report.S @ axes.T,
        )
        bag.write(encode("/dvl/innovation", update.stamp_ns, message))


def _firsts(recording: Sequence[Raw]) -> list[Raw]:
    """The first message of each topic."""
    return list({raw.topic: raw for raw in reversed(recording)}.values())
