"""ENU/FLU and NED/FRD on motions that one can picture."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.navigation.geometry import frames
from insdvl.navigation.geometry.frames import (
    CONVENTIONS,
    ENU,
    NED,
    rotation_from_quaternion,
    rotation_from_rpy,
    rotation_from_vector,
    rpy_from_rotation,
    vector_from_rotation,
)

FORWARD = np.array([1.0, 0.0, 0.0])


def test_axes_of_the_navigation_frame():
    north_east_down = [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(ENU.nav @ north_east_down, [2.0, 1.0, -3.0])


def test_axes_of_the_body():
    np.testing.assert_array_equal(ENU.body @ [1.0, 2.0, 3.0], [1.0, -2.0, -3.0])


@pytest.mark.parametrize("convention", CONVENTIONS.values())
def test_changes_of_axes_are_rotations_and_their_own_inverse(convention):
    for C in (convention.nav, convention.body):
        np.testing.assert_array_equal(C @ C, np.eye(3))
        assert np.linalg.det(C) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("yaw_enu_deg", "heading_deg"), [(90.0, 0.0), (0.0, 90.0), (-90.0, 180.0), (180.0, -90.0)]
)
def test_level_and_facing_the_points_of_the_compass(yaw_enu_deg, heading_deg):
    """REP-103's yaw counts from east to the left, heading counts from north to the right."""
    C_enu_flu = Rotation.from_euler("z", yaw_enu_deg, degrees=True).as_matrix()
    C_n_b = ENU.attitude(C_enu_flu)
    expected = Rotation.from_euler("z", heading_deg, degrees=True).as_matrix()
    np.testing.assert_allclose(C_n_b, expected, atol=1e-15)
    np.testing.assert_allclose(ENU.attitude(C_n_b), C_enu_flu, atol=1e-15)


def test_nose_up_is_positive_pitch_in_ned_and_negative_in_flu():
    """Facing north, nose 10 deg up: forward has a part upwards in both conventions."""
    C_n_b = rotation_from_rpy(np.radians([0.0, 10.0, 0.0]))
    assert C_n_b[2, 0] < 0.0  # forward points against down
    C_enu_flu = ENU.attitude(C_n_b)
    assert C_enu_flu[2, 0] == pytest.approx(np.sin(np.radians(10.0)))
    np.testing.assert_allclose(
        np.degrees(rpy_from_rotation(C_enu_flu)), [0.0, -10.0, 90.0], atol=1e-12
    )


def test_right_wing_down_is_positive_roll_in_both():
    C_n_b = rotation_from_rpy(np.radians([20.0, 0.0, 0.0]))
    assert C_n_b[2, 1] > 0.0  # right points down
    np.testing.assert_allclose(
        np.degrees(rpy_from_rotation(ENU.attitude(C_n_b))), [20.0, 0.0, 90.0], atol=1e-12
    )


def test_mounts_are_the_same_rotation_in_other_axes():
    """A sensor turned by 30 deg to the left is turned by -30 deg about down."""
    C = ENU.body_rotation(rotation_from_rpy(np.radians([0.0, 0.0, 30.0])))
    np.testing.assert_allclose(C, rotation_from_rpy(np.radians([0.0, 0.0, -30.0])), atol=1e-15)
    forward_of_sensor_in_flu = rotation_from_rpy(np.radians([0.0, 0.0, 30.0])) @ FORWARD
    np.testing.assert_allclose(C @ FORWARD, ENU.body @ forward_of_sensor_in_flu, atol=1e-15)


def test_ned_streams_pass_unchanged():
    C = rotation_from_rpy(np.array([0.1, -0.2, 0.3]))
    np.testing.assert_array_equal(NED.attitude(C), C)
    np.testing.assert_array_equal(NED.body_rotation(C), C)


def test_rpy_is_yaw_times_pitch_times_roll():
    roll, pitch, yaw = 0.3, -0.4, 2.0
    expected = (
        Rotation.from_rotvec([0.0, 0.0, yaw])
        * Rotation.from_rotvec([0.0, pitch, 0.0])
        * Rotation.from_rotvec([roll, 0.0, 0.0])
    ).as_matrix()
    np.testing.assert_allclose(
        rotation_from_rpy(np.array([roll, pitch, yaw])), expected, atol=1e-15
    )


def test_rpy_round_trip():
    rng = np.random.default_rng(30)
    rpy = rng.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (100, 3))
    C = np.array([rotation_from_rpy(angles) for angles in rpy])
    np.testing.assert_allclose(rpy_from_rotation(C), rpy, atol=1e-13)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_rpy_is_finite_straight_up_and_down(pitch):
    rpy = rpy_from_rotation(rotation_from_rpy(np.array([0.0, pitch, 0.4])))
    assert np.isfinite(rpy).all()
    assert rpy[1] == pytest.approx(pitch, abs=1e-7)


def test_zero_quaternion_is_an_error():
    with pytest.raises(ValueError, match="zero norm"):
        frames.rotation_from_quaternion(np.zeros(4))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1e-3, 0.7, 3.0, np.pi])
def test_rotations_and_their_vectors_are_those_of_scipy(angle):
    rng = np.random.default_rng(4)
    axes = rng.standard_normal((20, 3))
    phi = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    C = Rotation.from_rotvec(phi).as_matrix()
    np.testing.assert_allclose(rotation_from_vector(phi), C, rtol=0.0, atol=1e-14)
    back = vector_from_rotation(C)
    np.testing.assert_allclose(rotation_from_vector(back), C, rtol=0.0, atol=1e-14)
    if angle < 3.1:  # at pi both directions of the axis are right
        np.testing.assert_allclose(back, phi, rtol=1e-12, atol=1e-15)


def test_a_quaternion_is_normalised_and_zero_is_refused():
    q = np.random.default_rng(5).standard_normal((20, 4))
    for one in q:
        expected = Rotation.from_quat(one).as_matrix()
        np.testing.assert_allclose(rotation_from_quaternion(one), expected, rtol=0.0, atol=1e-14)
    with pytest.raises(ValueError, match="zero norm"):
        rotation_from_quaternion(np.zeros(4))


def test_roll_pitch_and_yaw_are_those_of_scipy():
    for rpy in np.random.default_rng(6).uniform(-4.0, 4.0, (20, 3)):
        expected = Rotation.from_euler("xyz", rpy).as_matrix()
        np.testing.assert_allclose(rotation_from_rpy(rpy), expected, rtol=0.0, atol=1e-14)
