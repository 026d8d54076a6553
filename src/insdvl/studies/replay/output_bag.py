"""The recording of `insdvl replay --out`: the inputs, and what the filter node publishes."""

from collections.abc import Sequence

import numpy as np

from insdvl.messages.cdr.odometry_bytes import OdometryColumns, encode_odometries
from insdvl.messages.convert import FIX, TWIST_WITH_COVARIANCE
from insdvl.messages.convert import ODOMETRY as ODOMETRY_TYPE
from insdvl.messages.inputs import frame_id_of
from insdvl.messages.make import fill_fix, fill_innovation
from insdvl.messages.topics import GLOBAL_ODOMETRY, GLOBAL_POSITION, IMU, ODOMETRY, taken
from insdvl.messages.transforms import TF, Transforms
from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw, decode, encode, new_message
from insdvl.recordings.messages import imu_message
from insdvl.studies.replay.fold import Replayed
from insdvl.studies.replay.track import TrackColumns


def write_bag(
    bag: BagWriter,
    recording: Sequence[Raw],
    replayed: Replayed,
    parameters: FilterParameters,
    track: TrackColumns,
) -> None:
    """Write what was folded, and what the filter node would publish.

    Args:
        bag: The new recording.
        recording: What was folded.
        replayed: The result.
        parameters: Of the filter.
        track: The states whose odometry is written.

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
    _write_odometries(bag, f"/{ODOMETRY}", in_odom, track.in_odom)
    if replayed.has_map:
        _write_odometries(bag, f"/{GLOBAL_ODOMETRY}", in_map, track.in_map)
    if parameters.publish_tf:
        transforms = Transforms(new_message, parameters, has_map=replayed.has_map)
        for k, stamp_ns in enumerate(track.stamps_ns.tolist()):
            bag.write(encode(TF, stamp_ns, transforms.of(track.odometry(k))))
    seconds = np.diff(track.stamps_ns // NS, prepend=-1)
    for k in np.flatnonzero(seconds):
        stamp_ns = int(track.stamps_ns[k])
        message = new_message(FIX)
        message.header.frame_id = parameters.base_frame
        fill_fix(message, stamp_ns, track.place[k], track.place_covariance[k])
        bag.write(encode(f"/{GLOBAL_POSITION}", stamp_ns, message))
        message = imu_message(
            stamp_ns,
            frame_ids[IMU],
            track.accelerometer_bias[k],
            track.gyroscope_bias[k],
            track.accelerometer_bias_covariance[k],
            track.gyroscope_bias_covariance[k],
        )
        bag.write(encode("/imu/bias", stamp_ns, message))
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


def _write_odometries(
    bag: BagWriter, topic: str, frames: tuple[str, str], columns: OdometryColumns
) -> None:
    """Write the odometries of a topic, recorded at their stamps."""
    messages = encode_odometries(frames, columns)
    for time_ns, data in zip(columns.stamps_ns.tolist(), messages, strict=True):
        bag.write(Raw(topic, ODOMETRY_TYPE, time_ns, data))


def _firsts(recording: Sequence[Raw]) -> list[Raw]:
    """The first message of each topic."""
    return list({raw.topic: raw for raw in reversed(recording)}.values())
