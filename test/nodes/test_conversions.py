"""Numbers to messages: what does not fit is an error here, because rclpy would send garbage."""

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion, TwistWithCovarianceStamped, Vector3
from rclpy.serialization import deserialize_message, serialize_message

from insdvl.messages.make import fill_innovation, flat_covariance, set_quaternion, set_vector
from insdvl.messages.topics import TOPICS
from insdvl.parameters.declaration import ParameterError
from insdvl.recordings.drivers import DEFINITIONS
from ros_insdvl.conversions import message_class, time_of


@pytest.mark.parametrize(
    "value", [[1, 2, 3], np.float32([1, 2, 3]), np.arange(1.0, 7.0)[::2] / 2 + 0.5]
)
def test_vector_of_any_number_type_survives_the_wire(value: object) -> None:
    field = Vector3()
    set_vector(field, value)
    assert deserialize_message(serialize_message(field), Vector3) == Vector3(x=1.0, y=2.0, z=3.0)


@pytest.mark.parametrize("value", [[1.0, 2.0], np.zeros((3, 1)), np.zeros((1, 3)), 5.0])
def test_vector_of_another_shape_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="3 values"):
        set_vector(Vector3(), value)


def test_quaternion_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="4 values"):
        set_quaternion(Quaternion(), np.zeros(3))


def test_covariance_is_flat_whatever_its_layout() -> None:
    P = np.arange(36).reshape(6, 6)
    for given in (P, np.asfortranarray(P), P.ravel().tolist()):
        flat = flat_covariance(given, 6)
        assert flat.dtype == np.float64
        assert flat.tolist() == list(range(36))
    for given in (np.eye(3), np.zeros(35)):
        with pytest.raises(ValueError, match="36 values"):
            flat_covariance(given, 6)


@pytest.mark.parametrize("stamp_ns", [0, 999_999_999, 1_700_000_000_123_456_789])
def test_stamp_keeps_every_nanosecond(stamp_ns: int) -> None:
    stamp = time_of(stamp_ns)
    assert stamp.sec * 1_000_000_000 + stamp.nanosec == stamp_ns


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("angles", [False, True])
def test_an_innovation_is_along_or_about_the_last_axes(rows: int, angles: bool) -> None:
    message = TwistWithCovarianceStamped()
    S = np.diag(np.arange(2.0, 2.0 + rows)) + 0.5
    fill_innovation(message, 5, np.arange(1.0, 1.0 + rows), S, angles=angles)
    received = deserialize_message(serialize_message(message), TwistWithCovarianceStamped)
    twist = received.twist.twist
    numbers = [getattr(v, axis) for v in (twist.linear, twist.angular) for axis in "xyz"]
    at = slice(6 - rows, 6) if angles else slice(3 - rows, 3)
    expected, P = np.zeros(6), np.zeros((6, 6))
    expected[at], P[at, at] = np.arange(1.0, 1.0 + rows), S
    assert numbers == expected.tolist()
    assert (received.twist.covariance.reshape(6, 6) == P).all()


def test_every_type_of_the_table_is_found_by_its_name() -> None:
    for kind in {kind for topic in TOPICS for kind in topic.types} - DEFINITIONS.keys():
        found = message_class(kind)
        assert f"{found.__module__.split('.')[0]}/msg/{found.__name__}" == kind


@pytest.mark.parametrize(
    ("kind", "package"),
    [
        ("marine_acoustic_msgs/msg/Dvl", "Debian package ros-jazzy-marine-acoustic-msgs"),
        ("dvl_msgs/msg/DVL", "no Debian package has it: build paagutie/dvl_msgs"),
        ("interfaces/msg/BottomTrack", "no Debian package has it: build `interfaces`"),
    ],
)
def test_a_drivers_type_that_is_not_installed_names_its_package(kind: str, package: str) -> None:
    with pytest.raises(ParameterError, match=f"^message type {kind} is not installed: .*{package}"):
        message_class(kind)


@pytest.mark.parametrize("kind", ["no_such_driver_msgs/msg/Ping", "sensor_msgs/msg/NoSuchName"])
def test_a_type_that_is_not_installed_is_named(kind: str) -> None:
    with pytest.raises(ParameterError, match=f"{kind} is not installed: .* {kind.split('/')[0]}"):
        message_class(kind)
