"""What may be wrong with the sensors of a vehicle, and how probable that is beforehand.

The probability model is in docs/explanation/alignment.md.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from insdvl.arrays import Array
from insdvl.watch.alignment.estimation import Prior
from insdvl.watch.alignment.rows import (
    ACCELEROMETER,
    ARM,
    DELAY,
    GYROSCOPE,
    GYROSCOPE_SCALE,
    MOUNT,
    SCALE,
    SIZE,
    YAW,
)

#: Metres per second in the units that a DVL's driver may give.
UNITS = {"cm/s": 0.01, "mm/s": 0.001, "knots": 1852.0 / 3600.0, "ft/s": 0.3048}

#: Probability that a parameter was not set, or that a sensor's driver is wrong.
WRONG = 1e-2

#: Probability that the axes of a wrong DVL or IMU are left-handed: a driver's error, not a mount.
LEFT_HANDED = 0.1

UPRIGHT = 0.5  # cosine of the largest angle between the axis of gravity and the vertical

#: One sigma of a parameter that was set with care, and of one that was not set.
BLOCKS: Mapping[str, tuple[int | slice, float, float]] = {
    "mount": (MOUNT, math.radians(1.0), 1.0),  # rad
    "yaw": (YAW, math.radians(1.0), 1.5),  # rad; a mount that is level
    "scale": (SCALE, 0.01, 0.3),
    "arm": (ARM, 0.1, 2.0),  # m
    "delay": (DELAY, 0.02, 0.2),  # s
    "gyroscope scale": (GYROSCOPE_SCALE, 0.01, 0.1),
}
TURNS = frozenset(["mount", "yaw"])
SCALES = frozenset(["scale", "gyroscope scale"])
#: Probability that a block was not set, where it is another than `WRONG`: the default of the lever
#: arm is none, and nearly every vehicle has one.
UNSET = {"arm": 0.1}
UNIT_SCALE = 0.03  # one sigma of the scale of a DVL in another unit


@dataclass(frozen=True)
class Cause:
    """One or more blocks of unknowns whose parameters were not set.

    Attributes:
        blocks: Names in `BLOCKS`.
        unit: Of the DVL's velocities; empty for m/s.
    """

    blocks: frozenset[str] = frozenset()
    unit: str = ""

    @property
    def size(self) -> int:
        """Number of things that are wrong."""
        return len(self.blocks) + bool(self.unit)

    @property
    def penalty(self) -> float:
        """-2 ln of the probability beforehand."""
        wrong = [UNSET.get(block, WRONG) for block in self.blocks] + [WRONG] * bool(self.unit)
        return -2.0 * sum(math.log(p) for p in wrong)

    @property
    def kappa(self) -> float:
        """The inverse of the scale that is expected."""
        return 1.0 / UNITS[self.unit] if self.unit else 1.0

    @property
    def less_turned(self) -> list["Cause"]:
        """The causes with which a turn of the DVL is compared: with a level mount, and without."""
        if not self.blocks & TURNS:
            return []
        rest = self.blocks - TURNS
        level = [Cause(rest | {"yaw"}, self.unit)] if "mount" in self.blocks else []
        return [Cause(rest, self.unit), *level]

    @property
    def less_scaled(self) -> list["Cause"]:
        """The causes with which another scale is compared: with none."""
        if not (self.unit or self.blocks & SCALES):
            return []
        return [Cause(self.blocks - SCALES)]

    def more(self) -> Iterator["Cause"]:
        """The causes with one more thing wrong."""
        for block in BLOCKS:
            turned_already = block in TURNS and self.blocks & TURNS
            scaled_already = block == "scale" and self.unit
            if block not in self.blocks and not turned_already and not scaled_already:
                yield Cause(self.blocks | {block}, self.unit)
        if not self.unit and "scale" not in self.blocks:
            for unit in UNITS:
                yield Cause(self.blocks, unit)

    def prior(self, accelerometer_bias: float, gyroscope_bias: float) -> Prior:
        """Of the unknowns.

        Args:
            accelerometer_bias: One sigma [m/s^2].
            gyroscope_bias: One sigma [rad/s].
        """
        mean, sigma = np.zeros(SIZE), np.empty(SIZE)
        sigma[ACCELEROMETER], sigma[GYROSCOPE] = accelerometer_bias, gyroscope_bias
        for columns, careful, _ in BLOCKS.values():
            sigma[columns] = careful
        for name in self.blocks:
            columns, _, wide = BLOCKS[name]
            sigma[columns] = wide
        if self.unit:
            mean[SCALE], sigma[SCALE] = math.log(self.kappa), UNIT_SCALE
        return Prior(mean, sigma)


NOTHING = Cause()


@dataclass(frozen=True, eq=False)
class Miswired:
    """A sensor whose readings x are not the vehicle's, which are `matrix` x.

    Attributes:
        sensor: "gyroscope", "accelerometer", "IMU" or "DVL".
        matrix: (3, 3) of a signed permutation, or of a factor.
        probability: Beforehand.
        factor: Of the readings against the true values; 1 for wrong axes.
    """

    sensor: str
    matrix: Array
    probability: float
    factor: float = 1.0

    @property
    def penalty(self) -> float:
        """-2 ln of the probability beforehand."""
        return -2.0 * math.log(self.probability)

    @property
    def less_turned(self) -> list[Cause]:
        """See `Cause.less_turned`."""
        return [NOTHING, Cause(frozenset(["yaw"]))] if self.sensor == "DVL" else []

    @property
    def less_scaled(self) -> list[Cause]:
        """See `Cause.less_scaled`."""
        return [NOTHING] if self.factor != 1.0 else []

    @property
    def accelerometer(self) -> Array:
        """(3, 3) of its readings."""
        return self.matrix if self.sensor in ("accelerometer", "IMU") else np.eye(3)

    @property
    def gyroscope(self) -> Array:
        """(3, 3) of its readings."""
        return self.matrix if self.sensor in ("gyroscope", "IMU") else np.eye(3)

    @property
    def dvl(self) -> Array:
        """(3, 3) of its readings."""
        return self.matrix if self.sensor == "DVL" else np.eye(3)

    def prior(self, accelerometer_bias: float, gyroscope_bias: float) -> Prior:
        """Of the unknowns, see `Cause.prior`."""
        blocks = frozenset(["gyroscope scale"] if self.factor != 1.0 else [])
        return Cause(blocks).prior(accelerometer_bias, gyroscope_bias)


def signed_permutations() -> list[Array]:
    """The 48 matrices (3, 3) that exchange and reverse axes; the first is the identity."""
    eye = np.eye(3)
    return [
        np.array(signs)[:, None] * eye[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]


#: Factors of a gyroscope that are tried; between them its scale is estimated.
FACTORS = [2.0 ** (k / 4) for k in range(-8, 9) if k]
DEGREES = math.degrees(1.0)


def miswired(C_b_i: Array) -> list[Miswired]:
    """All that are tried.

    An IMU that is turned as a whole is not among them: to the DVL it is a turned DVL, and the
    vertical tells the two apart. The vertical also leaves few axes for an accelerometer.

    Args:
        C_b_i: (3, 3) IMU to body, as the parameters tell it.
    """
    eye, down = np.eye(3), np.array([0.0, 0.0, 1.0])
    axes = signed_permutations()[1:]
    reversals = [not (m - np.diag(np.diag(m))).any() for m in axes]
    shares = [WRONG / 14.0 if reversal else WRONG / 80.0 for reversal in reversals]
    of_imu = [C_b_i @ m @ C_b_i.T for m in axes]
    level = [m for m in of_imu if (m @ down) @ down > UPRIGHT]
    mirrored = [m for m in level if np.linalg.det(m) < 0.0]
    factors = [*FACTORS, DEGREES, 1.0 / DEGREES]
    turned = [m for m in axes if np.linalg.det(m) > 0.0]
    reversed_ = [np.diag(s) for s in product((1.0, -1.0), repeat=3) if np.prod(s) < 0.0]
    return [
        *(Miswired("gyroscope", m, p) for m, p in zip(of_imu, shares, strict=True)),
        *(Miswired("gyroscope", eye / f, WRONG / len(factors), f) for f in factors),
        *(Miswired("accelerometer", m, WRONG / len(level)) for m in level),
        *(Miswired("IMU", m, LEFT_HANDED * WRONG / len(mirrored)) for m in mirrored),
        *(Miswired("DVL", m, WRONG / len(turned)) for m in turned),
        *(Miswired("DVL", m, LEFT_HANDED * WRONG / len(reversed_)) for m in reversed_),
    ]
