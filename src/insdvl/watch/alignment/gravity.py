"""Gravity in the axes of the vehicle: the specific force of an upright vehicle points up."""

from collections import deque

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import CONVENTIONS, rotation_from_vector, rpy_from_rotation

GRAVITY = 9.81  # m/s^2, accurate enough for a sign
BLOCK_NS = 10 * NS  # length of a block with a mean specific force
BLOCKS = 6  # number of blocks that must agree: no manoeuvre lasts as long
FEWEST_BLOCKS = 2
UPSIDE_DOWN = -0.5  # share of the specific force that points up
ASIDE = 0.94  # share of it along another axis: 20 deg
WRONG_SIZE = 0.3  # relative difference from gravity


_UP = np.array([0.0, 0.0, -1.0])


class GravityCheck:
    """Watches the mean specific force.

    Args:
        convention: Of the streams.
        C_b_i: (3, 3) IMU to body, as the parameters tell it.
    """

    def __init__(self, convention: str, C_b_i: Array) -> None:
        self._convention = convention
        self._axes = CONVENTIONS[convention].body
        self._C_b_i = C_b_i
        self._block = np.zeros(3)
        self._size = 0
        self._end_ns: int | None = None
        self._forces: deque[Array] = deque(maxlen=BLOCKS)

    def add(self, stamps_ns: Stamps, f_b: Array) -> None:
        """Take samples, stamps (N,) and specific forces (N, 3), in the order of their stamps."""
        first = 0
        while first < len(stamps_ns):
            if self._end_ns is None:
                self._end_ns = int(stamps_ns[first]) + BLOCK_NS
            last = first + int(np.searchsorted(stamps_ns[first:], self._end_ns))
            part = f_b[first : last + 1]
            self._block += part.sum(axis=0)
            self._size += len(part)
            if last < len(stamps_ns):
                self._forces.append(self._C_b_i @ self._block / self._size)
                self._block[:] = 0.0
                self._size, self._end_ns = 0, int(stamps_ns[last]) + BLOCK_NS
            first = last + 1

    @property
    def mean(self) -> Array | None:
        """(3,) mean specific force in body axes, of the last minute [m/s^2]; None without any."""
        return np.mean(self._forces, axis=0) if self._forces else None

    def findings(self) -> list[str]:
        """The contradiction that was found, in one sentence."""
        if len(self._forces) < FEWEST_BLOCKS:
            return []
        forces = np.array(self._forces)
        sizes = np.linalg.norm(forces, axis=1)
        mean = self._axes @ forces.mean(axis=0)
        seconds = len(forces) * BLOCK_NS // NS
        if (np.abs(sizes / GRAVITY - 1.0) > WRONG_SIZE).all():
            return [
                f"the mean specific force has been {sizes.mean():.2f} m/s^2 for {seconds} s, but "
                f"gravity alone is {GRAVITY}: wrong unit, or gravity was removed"
            ]
        up = self._axes[2, 2] * GRAVITY * -1.0  # along z of base_link, in the stream's axes
        if (-forces[:, 2] / sizes < UPSIDE_DOWN).all():
            other = next(name for name in CONVENTIONS if name != self._convention)
            return [
                f"gravity has the wrong sign along z: the specific force of base_link has been "
                f"{mean[2]:+.2f} m/s^2 for {seconds} s, but must be {up:+.2f} when upright with "
                f"frame_convention {self._convention!r}; frame_convention {other!r} would fit, or "
                "an imu.mount rotated by pi"
            ]
        for axis in range(2):
            if (np.abs(forces[:, axis]) / sizes > ASIDE).all():
                mount = ", ".join(f"{x:.2f}" for x in self.upright_mount())
                return [
                    f"gravity is along {'xy'[axis]} of base_link, not along z: the specific force "
                    f"along it has been {mean[axis]:+.2f} m/s^2 for {seconds} s; imu.mount is "
                    f"wrong, or the vehicle is not upright: imu.mount [{mount}] rad "
                    "would make it upright"
                ]
        return []

    def upright_mount(self) -> tuple[float, ...]:
        """The parameter imu.mount [rad] after the smallest turn that makes the vehicle upright.

        Of an IMU whose mean force is neither zero nor exactly reversed.
        """
        f = np.mean(self._forces, axis=0)
        axis = np.cross(f, _UP)
        angle = np.arctan2(np.linalg.norm(axis), f @ _UP)
        turn = rotation_from_vector(angle * axis / np.linalg.norm(axis))
        rpy = rpy_from_rotation(self._axes @ turn @ self._C_b_i @ self._axes)
        return tuple(round(float(x), 2) for x in rpy + 0.0)
