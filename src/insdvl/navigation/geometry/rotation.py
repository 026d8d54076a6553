"""Vector and rotation kernels on (3,) and (3, 3) arrays; results go into the first argument."""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel

#: Below this squared angle the series are exact to rounding, and no sine is needed.
_SMALL_ANGLE_SQUARED = 1e-4


@kernel
def copy_vector(out: Array, a: Array) -> None:
    """out = a, of any length. An assignment of a slice compiles the texts of its errors too."""
    for i in range(out.shape[0]):
        out[i] = a[i]


@kernel
def copy_matrix(out: Array, A: Array) -> None:
    """out = A, of any shape."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = A[i, j]


@kernel
def skew(out: Array, a: Array) -> None:
    """out = [a x]."""
    out[0, 0] = 0.0
    out[0, 1] = -a[2]
    out[0, 2] = a[1]
    out[1, 0] = a[2]
    out[1, 1] = 0.0
    out[1, 2] = -a[0]
    out[2, 0] = -a[1]
    out[2, 1] = a[0]
    out[2, 2] = 0.0


def cross_matrix(a: Array) -> Array:
    """[a x] as a new (3, 3) array."""
    out = np.empty((3, 3))
    skew(out, a)
    return out


@kernel
def about_down(C: Array, angle: float) -> None:
    """C (3, 3) = exp([angle e_D x]): a turn of the heading by an angle [rad]."""
    s, c = np.sin(angle), np.cos(angle)
    C[0, 0], C[0, 1], C[0, 2] = c, -s, 0.0
    C[1, 0], C[1, 1], C[1, 2] = s, c, 0.0
    C[2, 0], C[2, 1], C[2, 2] = 0.0, 0.0, 1.0


@kernel
def cross(out: Array, a: Array, b: Array) -> None:
    """out = a x b; `out` is neither of them."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def rotate(out: Array, A: Array, x: Array) -> None:
    """out = A x; `out` is not x."""
    for i in range(3):
        out[i] = A[i, 0] * x[0] + A[i, 1] * x[1] + A[i, 2] * x[2]


@kernel
def rotate_back(out: Array, A: Array, x: Array) -> None:
    """out = A^T x; `out` is not x."""
    for i in range(3):
        out[i] = A[0, i] * x[0] + A[1, i] * x[1] + A[2, i] * x[2]


@kernel
def product(out: Array, A: Array, B: Array) -> None:
    """out = A B; `out` is neither of them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def product_transposed(out: Array, A: Array, B: Array) -> None:
    """out = A B^T; `out` is neither of them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]


@kernel
def exponential(R: Array, R_mean: Array, x: float, y: float, z: float) -> None:
    """R = exp([phi x]), and its mean over the turn, R_mean = int_0^1 exp([s phi x]) ds.

    With t = |phi|^2 (Barfoot, State Estimation for Robotics, 2017, eqs. (7.23) and (7.37)):

        R      = I + a [phi x] + b [phi x]^2,   a = sin|phi| / |phi|,  b = (1 - cos|phi|) / t
        R_mean = I + b [phi x] + c [phi x]^2,   c = (1 - a) / t

    Args:
        x, y, z: The rotation vector phi [rad].
    """
    t = x * x + y * y + z * z
    if t < _SMALL_ANGLE_SQUARED:
        a = 1.0 - t / 6.0 * (1.0 - t / 20.0)
        b = 0.5 - t / 24.0 * (1.0 - t / 30.0)
        c = 1.0 / 6.0 - t / 120.0 * (1.0 - t / 42.0)
    else:
        angle = np.sqrt(t)
        a = np.sin(angle) / angle
        b = (1.0 - np.cos(angle)) / t
        c = (1.0 - a) / t
    _polynomial(R, a, b, x, y, z)
    _polynomial(R_mean, b, c, x, y, z)


@kernel
def _polynomial(out: Array, a: float, b: float, x: float, y: float, z: float) -> None:
    """out = I + a [phi x] + b [phi x]^2."""
    out[0, 0] = 1.0 - b * (y * y + z * z)
    out[0, 1] = -a * z + b * x * y
    out[0, 2] = a * y + b * x * z
    out[1, 0] = a * z + b * x * y
    out[1, 1] = 1.0 - b * (x * x + z * z)
    out[1, 2] = -a * x + b * y * z
    out[2, 0] = -a * y + b * x * z
    out[2, 1] = a * x + b * y * z
    out[2, 2] = 1.0 - b * (x * x + y * y)


@kernel
def rotations(C: Array, phi: Array) -> None:
    """Rotations C (N, 3, 3) = exp([phi x]) of rotation vectors phi (N, 3) [rad].

    I + sin(a) / a [phi x] + 2 (sin(a / 2) / a)^2 [phi x]^2 with a = |phi|, which is exact for small
    angles too.
    """
    for k in range(phi.shape[0]):
        x, y, z = phi[k, 0], phi[k, 1], phi[k, 2]
        angle = np.sqrt(x * x + y * y + z * z)
        a, half = 1.0, 1.0
        if angle > 0.0:
            a, half = np.sin(angle) / angle, np.sin(angle / 2.0) / (angle / 2.0)
        _polynomial(C[k], a, 0.5 * half * half, x, y, z)


@kernel
def orthonormalise(C: Array, scratch: Array) -> None:
    """One Newton step towards the nearest rotation, C <- C (3 I - C^T C) / 2, in place.

    It squares the distance from orthonormality, so one step after each product keeps C at rounding.
    """
    for i in range(3):
        for j in range(3):
            dot = C[0, i] * C[0, j] + C[1, i] * C[1, j] + C[2, i] * C[2, j]
            scratch[i, j] = (1.5 if i == j else 0.0) - 0.5 * dot
    for i in range(3):
        a, b, c = C[i, 0], C[i, 1], C[i, 2]
        for j in range(3):
            C[i, j] = a * scratch[0, j] + b * scratch[1, j] + c * scratch[2, j]


@kernel
def quaternions(q_xyzw: Array, C: Array) -> None:
    """Unit quaternions (x, y, z, w), w >= 0, of rotations, each from its largest term (Shepperd).

    Source: S. W. Shepperd, Quaternion from rotation matrix, J. Guidance and Control 1(3), 1978.

    Args:
        q_xyzw: (N, 4) result.
        C: (N, 3, 3) rotations.
    """
    for k in range(C.shape[0]):
        R, q = C[k], q_xyzw[k]
        trace = R[0, 0] + R[1, 1] + R[2, 2]
        largest, value = 3, trace
        for i in range(3):
            if R[i, i] > value:
                largest, value = i, R[i, i]
        if largest == 3:
            q[3] = 1.0 + trace
            q[0] = R[2, 1] - R[1, 2]
            q[1] = R[0, 2] - R[2, 0]
            q[2] = R[1, 0] - R[0, 1]
        else:
            i, j, m = largest, (largest + 1) % 3, (largest + 2) % 3
            q[i] = 1.0 - trace + 2.0 * R[i, i]
            q[j] = R[j, i] + R[i, j]
            q[m] = R[m, i] + R[i, m]
            q[3] = R[m, j] - R[j, m]
        norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        sign = -1.0 if q[3] < 0.0 else 1.0
        for i in range(4):
            q[i] *= sign / norm


@kernel
def rotations_of_quaternions(C: Array, q_xyzw: Array) -> bool:
    """Rotations C (N, 3, 3) of quaternions (N, 4), of any norm but zero, which is False."""
    for k in range(q_xyzw.shape[0]):
        x, y, z, w = q_xyzw[k]
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        if norm == 0.0:
            return False
        x, y, z, w = x / norm, y / norm, z / norm, w / norm
        R = C[k]
        R[0, 0] = w * w + x * x - y * y - z * z
        R[0, 1] = 2.0 * (x * y - w * z)
        R[0, 2] = 2.0 * (x * z + w * y)
        R[1, 0] = 2.0 * (x * y + w * z)
        R[1, 1] = w * w - x * x + y * y - z * z
        R[1, 2] = 2.0 * (y * z - w * x)
        R[2, 0] = 2.0 * (x * z - w * y)
        R[2, 1] = 2.0 * (y * z + w * x)
        R[2, 2] = w * w - x * x - y * y + z * z
    return True
