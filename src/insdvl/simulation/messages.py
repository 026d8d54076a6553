"""A mission as the messages of its sensors and of its truth, without ROS.

The simulator node, the fault flights and the recordings of the tests all take them from here.
"""

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from insdvl.messages.make import (
    fill_imu,
    fill_odometry,
    fill_orientation,
    fill_pressure,
    fill_twist,
    fill_variances,
)
from insdvl.messages.topics import (
    DEPTH,
    DVL,
    HEADING,
    IMU,
    TRUE_MEASUREMENT_NOISE,
    TRUE_PROCESS_NOISE,
    TRUTH,
)
from insdvl.navigation.geometry.frames import ENU, Convention, quaternion_from_rotation
from insdvl.simulation.mission import Mission
from insdvl.simulation.motion import Truth

#: The topics of every mission.
PUBLISHED = (IMU, DVL, TRUTH, TRUE_PROCESS_NOISE, TRUE_MEASUREMENT_NOISE)

#: Makes a message for a topic of the table. Each message is yielded before the next one of its
#: topic is made, so a message that is serialised at once may be used again.
NewMessage = Callable[[str], Any]


class Timed(NamedTuple):
    """A message and its time.

    Attributes:
        time_ns: Its stamp.
        topic: Its topic.
        message: The message.
    """

    time_ns: int
    topic: str
    message: Any


@dataclass(frozen=True)
class StreamFormat:
    """Axes and frames of the messages.

    Attributes:
        convention: Axes of all vectors.
        imu: frame_id of the IMU.
        dvl: frame_id of the DVL.
        depth: frame_id of the depth sensor.
        odom: frame_id of the truth.
        base: child_frame_id of the truth, and frame_id of the heading sensor.
        start_ns: Added to all stamps.
        with_variances: Whether each sample of the IMU has its true variances; else zeros (unknown).
    """

    convention: Convention = ENU
    imu: str = "imu_link"
    dvl: str = "dvl_link"
    depth: str = "depth_link"
    odom: str = "odom"
    base: str = "base_link"
    start_ns: int = 0
    with_variances: bool = False


DEFAULT = StreamFormat()


def topics_of(mission: Mission) -> tuple[str, ...]:
    """The topics of a mission; those of depth and heading only where there is a sensor."""
    sensors = ((DEPTH, mission.depth_stamps_ns), (HEADING, mission.heading_stamps_ns))
    return (*PUBLISHED, *(topic for topic, stamps_ns in sensors if stamps_ns.size))


def mission_messages(
    mission: Mission, new: NewMessage, form: StreamFormat = DEFAULT
) -> Iterator[Timed]:
    """All messages by their stamps; of one stamp in the order in which they stand here."""
    return heapq.merge(
        imu_messages(mission, new, form),
        truth_messages(mission, new, form),
        process_noise_messages(mission, new, form),
        measurement_noise_messages(mission, new, form),
        dvl_messages(mission, new, form),
        depth_messages(mission, new, form),
        heading_messages(mission, new, form),
        key=lambda timed: timed.time_ns,
    )


def imu_messages(
    mission: Mission, new: NewMessage, form: StreamFormat = DEFAULT
) -> Iterator[Timed]:
    """The samples of the IMU."""
    body = form.convention.body
    rows = zip(
        (mission.stamps_ns + form.start_ns).tolist(),
        mission.f_b @ body.T,
        mission.w_ib_b @ body.T,
        mission.q,
        strict=True,
    )
    for stamp_ns, f, w, q in rows:
        message = new(IMU)
        message.header.frame_id = form.imu
        fill_imu(message, stamp_ns, f, w)
        if form.with_variances:  # they do not depend on the sign of an axis
            fill_variances(message, q)
        yield Timed(stamp_ns, IMU, message)


def dvl_messages(
    mission: Mission, new: NewMessage, form: StreamFormat = DEFAULT
) -> Iterator[Timed]:
    """The measurements of the DVL."""
    v_d = mission.v_d @ form.convention.body.T
    stamps = (mission.dvl_stamps_ns + form.start_ns).tolist()
    for stamp_ns, v in zip(stamps, v_d, strict=True):
        message = new(DVL)
        message.header.frame_id = form.dvl
        fill_twist(message, stamp_ns, v)
        yield Timed(stamp_ns, DVL, message)


def depth_messages(
    mission: Mission, new: NewMessage, form: StreamFormat = DEFAULT
) -> Iterator[Timed]:
    """The measurements of the depth sensor, whose variance is unknown."""
    stamps = (mission.depth_stamps_ns + form.start_ns).tolist()
    for stamp_ns, pressure in zip(stamps, mission.pressure.tolist(), strict=True):
        message = new(DEPTH)
        message.header.frame_id = form.depth
        fill_pressure(message, stamp_ns, pressure)
        yield Timed(stamp_ns, DEPTH, message)


def heading_messages(
    mission: Mission, new: NewMessage, form: StreamFormat = DEFAULT
) -> Iterator[Timed]:
    """The measurements of the heading sensor, in its own axes those of base_link."""
    nav = form.convention.nav
    covariance = nav @ np.diag(mission.heading.variances) @ nav.T
    stamps = (mission.heading_stamps_ns + form.start_ns).tolist()
    quaternions = quaternion_from_rotation(form.convention.attitude(mission.attitude))
    for stamp_ns, q_xyzw in zip(stamps, quaternions, strict=True):
        message = new(HEADING)
        message.header.frame_id = form.base
        fill_orientation(message, stamp_ns, q_xyzw, covariance)
        yield Timed(stamp_ns, HEADING, message)


def truth_messages(
    mission: Mission, new: NewMessage, form: StreamFormat = DEFAULT, *, every: int = 1
) -> Iterator[Timed]:
    """The true state at the start and at each of so many stamps of the IMU."""
    start_ns = np.array([mission.start_ns])
    yield from _states(start_ns, mission.initial, new, form, 1)
    yield from _states(mission.stamps_ns, mission.truth, new, form, every)


def _states(
    stamps_ns: Any, truth: Truth, new: NewMessage, form: StreamFormat, every: int
) -> Iterator[Timed]:
    nav, body = form.convention.nav, form.convention.body
    C_n_b, C_o_b = truth.C_n_b[::every], truth.C_o_b[::every]
    rows = zip(
        (stamps_ns[::every] + form.start_ns).tolist(),
        truth.p_o[::every] @ nav.T,
        quaternion_from_rotation(form.convention.attitude(C_o_b)),
        np.einsum("kji,kj->ki", C_n_b, truth.v_n[::every]) @ body.T,
        truth.w_nb_b[::every] @ body.T,
        strict=True,
    )
    for stamp_ns, p, q_xyzw, v, w in rows:
        message = new(TRUTH)
        message.header.frame_id, message.child_frame_id = form.odom, form.base
        fill_odometry(message, stamp_ns, p, q_xyzw, v, w)
        yield Timed(stamp_ns, TRUTH, message)


def process_noise_messages(
    mission: Mission, new: NewMessage, form: StreamFormat = DEFAULT
) -> Iterator[Timed]:
    """The variances that hold from each stamp on, with the true force and rate at the stamp."""
    body = form.convention.body
    f_b, w_ib_b = (
        np.concatenate([getattr(mission.initial, name), getattr(mission.truth, name)]) @ body.T
        for name in ("f_b", "w_ib_b")
    )
    stamps, variances = mission.process_noise()
    rows = np.searchsorted(mission.stamps_ns, stamps, side="right")
    for elapsed_ns, row, q in zip(stamps.tolist(), rows, variances, strict=True):
        stamp_ns = elapsed_ns + form.start_ns
        message = new(TRUE_PROCESS_NOISE)
        message.header.frame_id = form.imu
        fill_imu(message, stamp_ns, f_b[row], w_ib_b[row])
        fill_variances(message, q)
        yield Timed(stamp_ns, TRUE_PROCESS_NOISE, message)


def measurement_noise_messages(
    mission: Mission, new: NewMessage, form: StreamFormat = DEFAULT
) -> Iterator[Timed]:
    """The covariance of each ping's noise; the twist is zero, and tells nothing."""
    stamps = (mission.dvl_stamps_ns + form.start_ns).tolist()
    for stamp_ns, r in zip(stamps, mission.r, strict=True):
        message = new(TRUE_MEASUREMENT_NOISE)
        message.header.frame_id = form.dvl
        fill_twist(message, stamp_ns, np.zeros(3), np.diag(r))  # in any signs of the axes
        yield Timed(stamp_ns, TRUE_MEASUREMENT_NOISE, message)
