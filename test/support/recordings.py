"""Recordings of simulated missions, as a driver would make them."""

from collections.abc import Iterable
from pathlib import Path

from insdvl.messages.topics import DEPTH, HEADING
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw, encode
from insdvl.recordings.messages import message_of
from insdvl.recordings.parameters import ReplayParameters
from insdvl.simulation.messages import (
    StreamFormat,
    Timed,
    depth_messages,
    dvl_messages,
    heading_messages,
    imu_messages,
    process_noise_messages,
    truth_messages,
)
from insdvl.simulation.mission import Mission

REPLAY = ReplayParameters(
    imu_topic="/imu",
    dvl_topic="/dvl",
    ground_truth_topic="/truth",
    true_process_noise_topic="/true_q",
)
FORM = StreamFormat(imu="imu", dvl="dvl")


def record(mission: Mission, *, every: int = 1) -> list[Raw]:
    """The mission as it would be recorded, with the truth at every so many stamps of the IMU."""
    start, *truth = truth_messages(mission, message_of, FORM, every=every)
    streams: list[tuple[str, int, Iterable[Timed]]] = [
        ("/truth", 0, [start]),
        ("/imu", 0, imu_messages(mission, message_of, FORM)),
        ("/truth", 1, truth),
        ("/dvl", 2, dvl_messages(mission, message_of, FORM)),
        (f"/{DEPTH}", 2, depth_messages(mission, message_of, FORM)),
        (f"/{HEADING}", 2, heading_messages(mission, message_of, FORM)),
        ("/true_q", 3, process_noise_messages(mission, message_of, FORM)),
    ]
    raws = [
        encode(topic, timed.time_ns + later_ns, timed.message)
        for topic, later_ns, stream in streams
        for timed in stream
    ]
    return sorted(raws, key=lambda raw: raw.time_ns)


def save(path: Path, raws: list[Raw]) -> Path:
    with BagWriter(path) as bag:
        for raw in raws:
            bag.write(raw)
    return path
