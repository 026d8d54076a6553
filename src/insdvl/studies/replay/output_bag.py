"""The recording of `insdvl replay --out`: the inputs, and what the filter node publishes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from insdvl.messages.convert import FIX, TWIST_WITH_COVARIANCE
from insdvl.messages.inputs import frame_id_of
from insdvl.messages.make import fill_fix, fill_innovation
from insdvl.messages.topics import GLOBAL_ODOMETRY, GLOBAL_POSITION, IMU, ODOMETRY, taken
from insdvl.messages.transforms import TF, Transforms
from insdvl.navigation.events import NS
from insdvl.navigation.odometry import Odometry, Pose, biases, odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw, decode, encode, new_message
from insdvl.recordings.messages import imu_message, odometry_message
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
    in_map = parameters.map_frame, parameters.base_frame
    in_odom = parameters.odom_frame, parameters.base_frame
    frame_ids = {raw.topic: frame_id_of(decode(raw).message) for raw in _firsts(recording)}
    sensors = {
        topic.measurement: frame_ids[name.lstrip("/")]
        for name, topic in reversed(taken(parameters).items())
        if name.lstrip("/") in frame_ids
    }
    transforms = Transforms(new_message, parameters, has_map=replayed.has_map)
    second = None
    initialised = [
        (part, int(k))
        for part in replayed.parts
        for k in np.flatnonzero(part.states["nav"]["initialised"])
    ]
    for part, k in initialised:
        state = odometry(part.filter, part.states, k)
        bag.write(encode(f"/{ODOMETRY}", state.stamp_ns, _message(state, in_odom, state.in_odom)))
        if parameters.publish_tf:
            bag.write(encode(TF, state.stamp_ns, transforms.of(state)))
        if replayed.has_map:
            message = _message(state, in_map, state.in_map)
            bag.write(encode(f"/{GLOBAL_ODOMETRY}", state.stamp_ns, message))
        if state.stamp_ns // NS != second:
            second = state.stamp_ns // NS
            message = new_message(FIX)
            message.header.frame_id = parameters.base_frame
            fill_fix(message, state.stamp_ns, state.place, state.place_covariance)
            bag.write(encode(f"/{GLOBAL_POSITION}", state.stamp_ns, message))
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
        report = update.report
        message = new_message(TWIST_WITH_COVARIANCE)
        message.header.frame_id = sensors[report.measurement]
        model = replayed.fold.filter.models[report.measurement]
        nu, S = model.in_stream(report.innovation, report.S)
        fill_innovation(message, update.stamp_ns, nu, S, angles=model.angles)
        bag.write(encode(f"/{report.measurement}/innovation", update.stamp_ns, message))


def _message(state: Odometry, frames: tuple[str, str], pose: Pose) -> Any:
    """The nav_msgs/Odometry of a state, with its pose in a frame."""
    return odometry_message(
        state.stamp_ns,
        frames,
        pose.position,
        pose.quaternion_xyzw,
        state.twist_linear,
        state.twist_angular,
        pose.covariance,
        state.twist_covariance,
    )


def _firsts(recording: Sequence[Raw]) -> list[Raw]:
    """The first message of each topic."""
    return list({raw.topic: raw for raw in reversed(recording)}.values())
