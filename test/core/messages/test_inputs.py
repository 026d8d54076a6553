"""What becomes of a message by its topic: frames, stamps of zero, and the first initial state."""

from collections.abc import Iterable
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from told import TOLD

from insdvl.messages.convert import RejectedMessage
from insdvl.messages.inputs import Inputs
from insdvl.navigation.events import NS, Event, Imu, Initial, Origin, ProcessNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state.fields import NEVER
from insdvl.parameters.declaration import build
from insdvl.timeline.fold import Fold

NOW = 1_700_000_000 * NS


def xyz(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Message:
    return Message(x=x, y=y, z=z)


def header(stamp_ns: int, frame_id: str) -> Message:
    return Message(stamp=Message(sec=stamp_ns // NS, nanosec=stamp_ns % NS), frame_id=frame_id)


def imu(stamp_ns: int = NOW, frame_id: str = "imu_link") -> Message:
    return Message(
        header=header(stamp_ns, frame_id),
        linear_acceleration=xyz(z=9.8),
        angular_velocity=xyz(),
        linear_acceleration_covariance=np.eye(3).ravel(),
        angular_velocity_covariance=np.eye(3).ravel(),
    )


def dvl(stamp_ns: int = NOW, frame_id: str = "dvl_link") -> Message:
    return Message(header=header(stamp_ns, frame_id), twist=Message(linear=xyz(1.0)))


def odometry(
    stamp_ns: int = NOW, frame_id: str = "odom", child_frame_id: str = "base_link"
) -> Message:
    return Message(
        header=header(stamp_ns, frame_id),
        child_frame_id=child_frame_id,
        pose=Message(
            pose=Message(position=xyz(), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0)),
            covariance=np.zeros(36),
        ),
        twist=Message(twist=Message(linear=xyz(), angular=xyz()), covariance=np.zeros(36)),
    )


def inputs(**values: Any) -> Inputs:
    return Inputs(
        build(FilterParameters, TOLD | {n.replace("__", "."): v for n, v in values.items()})
    )


def events(
    of: Inputs, topic: str, message: Any, newest_ns: int = NOW, *, started: bool = False
) -> list[Event]:
    """Those for a fold that has come so far."""
    fold: Any = Message(newest_ns=newest_ns, latest=Message() if started else None)
    return list(of.events(topic, message, fold))


def refused(of: Inputs, topic: str, message: Any, newest_ns: int = NOW) -> str:
    with pytest.raises(RejectedMessage) as caught:
        events(of, topic, message, newest_ns)
    return caught.value.reason


# ------------------------------------------------------------------ frames


def test_a_declared_frame_is_the_only_one() -> None:
    of = inputs(imu__frame_id="imu_link", dvl__frame_id="dvl_link")
    assert len(events(of, "imu/data_raw", imu())) == 1
    assert len(events(of, "dvl/velocity", dvl())) == 1
    for wrong in ("", "other", "/imu_link"):
        assert refused(of, "imu/data_raw", imu(frame_id=wrong)) == "wrong_frame"
        assert refused(of, "dvl/velocity", dvl(frame_id=wrong)) == "wrong_frame"
    with pytest.raises(RejectedMessage, match="frame_id is 'other', not 'imu_link'"):
        events(of, "imu/data_raw", imu(frame_id="other"))
    assert not of.frame_changes


def test_the_frame_of_a_sensor_that_sends_odometry_is_its_child() -> None:
    """As `extrinsics: tf` takes it: the twist is in the axes of the child."""
    of = inputs(dvl__frame_id="dvl_link")
    assert len(events(of, "dvl/velocity", odometry(child_frame_id="dvl_link"))) == 1
    assert of.frame_ids == {"dvl/velocity": "dvl_link"}
    with pytest.raises(RejectedMessage, match="child_frame_id is 'base_link', not 'dvl_link'"):
        events(of, "dvl/velocity", odometry(frame_id="dvl_link"))
    told = inputs()
    events(told, "set_odometry", odometry())
    assert told.frame_ids == {"set_odometry": "odom"}


def test_a_frame_that_changes_is_counted_and_used() -> None:
    of = inputs()
    for frame_id in ("a", "a", "b", "b", "a"):
        assert len(events(of, "imu/data_raw", imu(frame_id=frame_id))) == 1
    assert of.frame_changes == {"imu/data_raw": 2}
    assert of.frame_ids == {"imu/data_raw": "a"}


@pytest.mark.parametrize(
    ("frame_id", "child_frame_id", "fits"),
    [
        ("world", "hull", True),
        ("", "", True),
        ("world", "", True),
        ("odom", "hull", False),
        ("world", "base_link", False),
    ],
)
def test_set_odometry_is_of_the_filters_own_frames(
    frame_id: str, child_frame_id: str, fits: bool
) -> None:
    of = inputs(odom_frame="world", base_frame="hull")
    message = odometry(frame_id=frame_id, child_frame_id=child_frame_id)
    if fits:
        assert len(events(of, "set_odometry", message)) == 1
    else:
        assert refused(of, "set_odometry", message) == "wrong_frame"


# ------------------------------------------------------------------ what a message leaves open


def test_a_dvl_that_tells_two_variances_leaves_the_third_open() -> None:
    """A zero; the filter takes dvl.noise_std for it."""
    of = inputs()
    covariance = np.zeros((6, 6))
    covariance[0, 0] = covariance[1, 1] = 4.0
    twist = Message(twist=Message(linear=xyz(1.0)), covariance=covariance.ravel())
    (event,) = events(of, "dvl/velocity_cov", Message(header=header(NOW, ""), twist=twist))
    assert isinstance(event, Dvl) and event.R is not None
    np.testing.assert_array_equal(event.R, np.diag([4.0, 4.0, 0.0]))


@pytest.mark.parametrize("topic", ["set_odometry", "truth"])
def test_what_a_planar_odometry_does_not_know_is_as_declared(topic: str) -> None:
    """It has variances of x, y and yaw only; the tilt is not known perfectly for that."""
    of = inputs(
        initial__mode="topic",
        initial__topic="truth",
        initial__tilt_std=0.1,
        initial__heading_std=0.2,
        initial__position_std=5.0,
        initial__velocity_std=0.5,
    )
    message = odometry()
    message.pose.covariance = np.diag([4.0, 9.0, 0.0, 0.0, 0.0, 0.09]).ravel()
    message.twist.covariance = np.diag([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]).ravel()
    (event,) = events(of, topic, message)
    assert isinstance(event, Initial)
    for covariance, variances in (
        (event.P_p, [9.0, 4.0, 25.0]),
        (event.P_psi, [0.01, 0.01, 0.09]),
        (event.P_v, [1.0, 0.25, 0.25]),
    ):
        assert covariance is not None
        np.testing.assert_allclose(covariance, np.diag(variances))


def test_a_fix_without_a_height_has_the_declared_one() -> None:
    """A 2-D fix says NaN, which is no error."""
    of = inputs(origin__source="topic", origin__height=-5.0)
    message = fix(NOW)
    message.altitude = float("nan")
    (event,) = events(of, "gps/fix", message)
    assert isinstance(event, Origin)
    assert (event.lat, event.lon, event.h) == (np.radians(32.0), np.radians(34.0), -5.0)


# ------------------------------------------------------------------ zero


def test_zero_is_no_stamp_for_a_sensor() -> None:
    of = inputs()
    assert refused(of, "imu/data_raw", imu(0), NEVER) == "no_stamp"
    assert refused(of, "dvl/velocity", dvl(0), NEVER) == "no_stamp"


def test_zero_is_a_stamp_where_time_begins_at_zero() -> None:
    """A simulation tells its first Q and its first truth at 0."""
    of = inputs(process_noise__source="external", initial__mode="topic", initial__topic="truth")
    for newest_ns in (NEVER, 5 * NS):
        (event,) = events(of, "process_noise", imu(0), newest_ns)
        assert isinstance(event, ProcessNoise) and event.stamp_ns == 0
        assert len(events(of, "truth", odometry(0), newest_ns)) == 1
    assert refused(of, "process_noise", imu(0)) == "no_stamp"
    assert refused(of, "truth", odometry(0)) == "no_stamp"


def test_a_set_odometry_without_a_stamp_is_of_the_newest_sample() -> None:
    of = inputs()
    (event,) = events(of, "set_odometry", odometry(0))
    assert event.stamp_ns == NOW


def test_before_the_first_sample_it_waits_for_it() -> None:
    of = inputs()
    assert events(of, "set_odometry", odometry(0), NEVER) == []
    sample, initial = events(of, "imu/data_raw", imu(), NEVER)
    assert isinstance(sample, Imu) and isinstance(initial, Initial)
    assert initial.stamp_ns == sample.stamp_ns == NOW
    assert len(events(of, "imu/data_raw", imu(NOW + 1))) == 1


# ------------------------------------------------------------------ the first of a topic


def test_the_first_of_a_topic_and_what_is_late_are_given_on() -> None:
    of = inputs(initial__mode="topic", initial__topic="truth", max_delay=1.0)
    assert len(events(of, "truth", odometry(NOW))) == 1
    for newest_ns in (NOW, NOW + NS):
        assert len(events(of, "truth", odometry(NOW - 1), newest_ns, started=True)) == 1
    assert not of.initial_done
    assert events(of, "truth", odometry(NOW - 1), NOW + NS + 1, started=True) == []
    assert of.initial_done
    of.reset()
    assert len(events(of, "truth", odometry(NOW))) == 1


def test_the_first_may_be_of_another_time_than_the_samples() -> None:
    """The clock is set: whether the samples follow, the fold will see."""
    of = inputs(initial__mode="topic", initial__topic="truth", max_delay=1.0)
    assert len(events(of, "truth", odometry(NOW))) == 1
    for stamp in (NOW + 3600 * NS, NOW - 3600 * NS):
        assert len(events(of, "truth", odometry(stamp))) == 1
    assert not of.initial_done


def fix(stamp_ns: int) -> Message:
    return Message(
        header=header(stamp_ns, ""),
        status=Message(status=0),
        latitude=32.0,
        longitude=34.0,
        altitude=0.0,
    )


def told(*, origin: str, samples_from: int, truth: Iterable[tuple[int, int]], fix_at: int) -> Fold:
    """A filter that a topic starts, after four seconds.

    Args:
        origin: Where odom's origin comes from.
        samples_from: When the samples begin [steps of 0.1 s].
        truth: When each message of the topic comes [steps], and its stamp [ns].
        fix_at: When the fix comes [steps].
    """
    of = inputs(initial__mode="topic", initial__topic="truth", origin__source=origin, max_delay=0.5)
    fold = Fold(of._parameters)
    arrivals: list[tuple[int, str, Any]] = [
        (k, "imu/data_raw", imu(NOW + k * NS // 10)) for k in range(samples_from, 40)
    ]
    arrivals += [(k, "truth", odometry(stamp_ns)) for k, stamp_ns in truth]
    arrivals.append((fix_at, "gps/fix", fix(NOW + fix_at * NS // 10)))
    for _, topic, message in sorted(arrivals, key=lambda arrival: arrival[0]):
        if topic in of.topics:
            for event in of.events(topic, message, fold):
                fold.add(event)
    return fold


IN_TIME = [(k, NOW + k * NS // 10) for k in range(30)]
LATE_START = {
    "the origin comes later": ("topic", 0, IN_TIME, 20),
    "the first is too late": ("parameters", 0, [(10, NOW - 40 * NS // 10), *IN_TIME[11:]], 0),
    "the first has no stamp": ("parameters", 3, [(0, 0), *IN_TIME[4:]], 0),
}


@pytest.mark.parametrize("name", LATE_START)
def test_where_the_first_of_a_topic_starts_nothing_a_later_one_does(name: str) -> None:
    origin, samples_from, truth, fix_at = LATE_START[name]
    fold = told(origin=origin, samples_from=samples_from, truth=truth, fix_at=fix_at)
    assert fold.latest is not None


# ------------------------------------------------------------------ time offsets


def test_a_time_offset_is_added_to_the_stamps_of_its_sensor() -> None:
    of = inputs(imu__time_offset=0.02, dvl__time_offset=-0.19, process_noise__source="message")
    assert [e.stamp_ns - NOW for e in events(of, "imu/data_raw", imu())] == [20_000_000] * 2
    for topic in ("dvl/velocity", "dvl/velocity_cov"):
        message = dvl()
        if topic.endswith("cov"):
            message.twist = Message(twist=message.twist, covariance=np.zeros(36))
        assert [e.stamp_ns - NOW for e in events(of, topic, message)] == [-190_000_000]
    (start,) = events(of, "set_odometry", odometry())
    assert start.stamp_ns == NOW


def test_a_process_noise_has_the_stamps_of_its_samples() -> None:
    of = inputs(imu__time_offset=0.02, process_noise__source="external")
    assert [e.stamp_ns - NOW for e in events(of, "process_noise", imu())] == [20_000_000]
    beginning = imu(stamp_ns=0)
    assert [e.stamp_ns for e in events(of, "process_noise", beginning, NEVER)] == [0]


def test_a_stamp_before_the_beginning_of_time_is_refused() -> None:
    of = inputs(dvl__time_offset=-0.19)
    assert refused(of, "dvl/velocity", dvl(NS // 10)) == "bad_stamp"
    assert len(events(of, "dvl/velocity", dvl(NS // 5))) == 1
