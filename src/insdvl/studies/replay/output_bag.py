"""The recording of `insdvl replay --out`: the inputs, and what the filter node publishes.

Covariances are rounded to single precision: the last digits of a double are as good as random, and
do not compress.
"""

from collections.abc import Sequence

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.cdr.odometry_bytes import OdometryColumns, encode_odometries
from insdvl.messages.convert import FIX, TWIST_WITH_COVARIANCE
from insdvl.messages.convert import ODOMETRY as ODOMETRY_TYPE
from insdvl.messages.feed import Feed
from insdvl.messages.inputs import frame_id_of
from insdvl.messages.make import fill_fix, fill_innovation
from insdvl.messages.topics import (
    GLOBAL_ODOMETRY,
    GLOBAL_POSITION,
    IMU,
    INNOVATION,
    ODOMETRY,
    taken,
)
from insdvl.messages.transforms import TF, Transforms
from insdvl.navigation.events import NS
from insdvl.navigation.filter import Filter
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw, decode, encode, new_message
from insdvl.recordings.messages import imu_message
from insdvl.studies.replay.track import TrackColumns
from insdvl.timeline.output import AppliedUpdate


class OutputBag:
    """Writes what is folded, and what the filter node would publish, as it comes.

    Args:
        bag: The new recording.
        parameters: Of the filter.
        feed: The filter.
    """

    def __init__(self, bag: BagWriter, parameters: FilterParameters, feed: Feed) -> None:
        self._bag, self._parameters, self._has_map = bag, parameters, feed.has_map
        self._transforms = Transforms(new_message, parameters, has_map=feed.has_map)
        self._frame_ids: dict[str, str] = {}  # of the first message of each topic
        self._second = -1

    def messages(self, raws: Sequence[Raw]) -> None:
        """Inputs, in the recorded order.

        Raises:
            BagError: The disk cannot be written.
        """
        for raw in raws:
            if raw.topic not in self._frame_ids:
                self._frame_ids[raw.topic] = frame_id_of(decode(raw).message)
            self._bag.write(raw._replace(topic="/" + raw.topic))

    def track(self, track: TrackColumns) -> None:
        """States, in the order of their stamps.

        Raises:
            BagError: The disk cannot be written.
        """
        parameters, bag = self._parameters, self._bag
        in_map = parameters.map_frame, parameters.base_frame
        in_odom = parameters.odom_frame, parameters.base_frame
        self._odometries(f"/{ODOMETRY}", in_odom, track.in_odom)
        if self._has_map:
            self._odometries(f"/{GLOBAL_ODOMETRY}", in_map, track.in_map)
        if parameters.publish_tf:
            for k, stamp_ns in enumerate(track.stamps_ns.tolist()):
                bag.write(encode(TF, stamp_ns, self._transforms.of(track.odometry(k))))
        seconds = np.diff(track.stamps_ns // NS, prepend=self._second)
        self._second = int(track.stamps_ns[-1] // NS)
        for k in np.flatnonzero(seconds).tolist():
            self._each_second(track, k)

    def _odometries(self, topic: str, frames: tuple[str, str], columns: OdometryColumns) -> None:
        """Write the odometries of a topic, recorded at their stamps."""
        rounded = columns._replace(
            pose_covariance=_rounded(columns.pose_covariance),
            twist_covariance=_rounded(columns.twist_covariance),
        )
        messages = encode_odometries(frames, rounded)
        for time_ns, data in zip(columns.stamps_ns.tolist(), messages, strict=True):
            self._bag.write(Raw(topic, ODOMETRY_TYPE, time_ns, data))

    def _each_second(self, track: TrackColumns, k: int) -> None:
        stamp_ns = int(track.stamps_ns[k])
        message = new_message(FIX)
        message.header.frame_id = self._parameters.base_frame
        fill_fix(message, stamp_ns, track.place[k], _rounded(track.place_covariance[k]))
        self._bag.write(encode(f"/{GLOBAL_POSITION}", stamp_ns, message))
        message = imu_message(
            stamp_ns,
            self._frame_ids[IMU],
            track.accelerometer_bias[k],
            track.gyroscope_bias[k],
            _rounded(track.accelerometer_bias_covariance[k]),
            _rounded(track.gyroscope_bias_covariance[k]),
        )
        self._bag.write(encode("/imu/bias", stamp_ns, message))

    def updates(self, filter_: Filter, updates: Sequence[AppliedUpdate]) -> None:
        """All measurements.

        Raises:
            BagError: The disk cannot be written.
        """
        sensors = {
            topic.measurement: self._frame_ids[name.lstrip("/")]
            for name, topic in reversed(taken(self._parameters).items())
            if name.lstrip("/") in self._frame_ids
        }
        for update in updates:
            if not np.isfinite(update.report.nis):
                continue  # refused before it was compared with a prediction
            report = update.report
            message = new_message(TWIST_WITH_COVARIANCE)
            message.header.frame_id = sensors[report.measurement]
            model = filter_.models[report.measurement]
            nu, S = model.in_stream(report.innovation, report.S)
            fill_innovation(message, update.stamp_ns, nu, _rounded(S), angles=model.angles)
            self._bag.write(encode(f"/{report.measurement}{INNOVATION}", update.stamp_ns, message))


def _rounded(covariance: Array) -> Array:
    """To the 24 bits of a single, about 7 digits, as doubles."""
    return covariance.astype(np.float32).astype(float)
