"""Rotation kernels against matrix exponentials and scipy's rotations."""

import numpy as np
import pytest
from oracle import skew, turned
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from insdvl.navigation.geometry import rotation
from insdvl.navigation.geometry.frames import quaternion_from_rotation, rotation_from_quaternion

# The series and the closed form meet at 0.01 rad.
ANGLES = [0.0, 1e-12, 1e-6, 1e-4, 9.999e-3, 1.0001e-2, 0.02, 0.3, 1.0, 3.0, 3.1415, 6.0]


def directions():
    rng = np.random.default_rng(20)
    axes = rng.standard_normal((4, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return [*np.eye(3), *axes]


@pytest.mark.parametrize("angle", ANGLES)
def test_exponential_and_its_mean(angle):
    R, mean = np.empty((3, 3)), np.empty((3, 3))
    for axis in directions():
        phi = angle * axis
        rotation.exponential(R, mean, *phi)
        exact, exact_mean = turned(phi)
        np.testing.assert_allclose(R, exact, atol=4e-15)
        np.testing.assert_allclose(mean, exact_mean, atol=4e-14)


def test_exponential_does_not_jump_where_the_series_ends():
    """Across the switch the result changes by no more than the angle does."""
    below, above, mean_below, mean_above = np.empty((4, 3, 3))
    axis = np.array([0.6, 0.0, 0.8])
    rotation.exponential(below, mean_below, *(0.01 * (1 - 1e-12) * axis))
    rotation.exponential(above, mean_above, *(0.01 * (1 + 1e-12) * axis))
    np.testing.assert_allclose(above, below, atol=1e-13)
    np.testing.assert_allclose(mean_above, mean_below, atol=1e-13)


def test_vector_and_matrix_products():
    rng = np.random.default_rng(21)
    A, B = rng.standard_normal((2, 3, 3))
    x, y = rng.standard_normal((2, 3))
    vector, matrix = np.full(3, np.nan), np.full((3, 3), np.nan)
    for kernel, arguments, expected in [
        (rotation.rotate, (A, x), A @ x),
        (rotation.rotate_back, (A, x), A.T @ x),
        (rotation.cross, (x, y), np.cross(x, y)),
    ]:
        kernel(vector, *arguments)
        np.testing.assert_allclose(vector, expected, atol=1e-14)
    for kernel, arguments, expected in [
        (rotation.product, (A, B), A @ B),
        (rotation.product_transposed, (A, B), A @ B.T),
        (rotation.skew, (x,), skew(x)),
    ]:
        kernel(matrix, *arguments)
        np.testing.assert_allclose(matrix, expected, atol=1e-14)


def test_orthonormalise_squares_the_distance_and_does_not_turn():
    rng = np.random.default_rng(22)
    scratch = np.empty((3, 3))
    for _ in range(20):
        exact = Rotation.random(random_state=rng.integers(2**31)).as_matrix()
        stretch = rng.standard_normal((3, 3)) * 1e-5
        C = exact @ (np.eye(3) + stretch + stretch.T)
        rotation.orthonormalise(C, scratch)
        np.testing.assert_allclose(C.T @ C, np.eye(3), atol=1e-8)
        np.testing.assert_allclose(C, exact, atol=1e-8)
        rotation.orthonormalise(C, scratch)
        np.testing.assert_allclose(C.T @ C, np.eye(3), atol=1e-15)


def rotations():
    half_turns = [expm(np.pi * skew(axis)) for axis in directions()]
    rng = np.random.default_rng(23)
    any_turns = [expm(skew(phi)) for phi in rng.uniform(-3.0, 3.0, (50, 3))]
    near_half_turns = [expm((np.pi - 1e-9) * skew(axis)) for axis in directions()]
    return np.array([np.eye(3), *half_turns, *near_half_turns, *any_turns])


def test_quaternions_round_trip():
    C = rotations()
    q_xyzw = quaternion_from_rotation(C)
    np.testing.assert_allclose(np.linalg.norm(q_xyzw, axis=1), 1.0, atol=1e-15)
    assert (q_xyzw[:, 3] >= 0.0).all()
    for k in range(len(C)):
        np.testing.assert_allclose(rotation_from_quaternion(q_xyzw[k]), C[k], atol=4e-15)


def test_quaternions_are_scipys():
    C = rotations()
    expected = Rotation.from_matrix(C).as_quat()
    alignment = np.abs(np.sum(expected * quaternion_from_rotation(C), axis=1))
    np.testing.assert_allclose(alignment, 1.0, atol=1e-14)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_quaternions_keep_the_shape(shape):
    C = np.broadcast_to(rotations()[20], (*shape, 3, 3))
    assert quaternion_from_rotation(C).shape == (*shape, 4)
