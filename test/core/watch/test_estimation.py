"""The linear problem of the alignment: its derivatives against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array
from insdvl.navigation.events import NS
from insdvl.watch.alignment.rows import (
    ACCELEROMETER,
    ARM,
    DELAY,
    GYROSCOPE,
    GYROSCOPE_SCALE,
    MOUNT,
    SCALE,
    SIZE,
    Mounted,
    rows,
)
from insdvl.watch.alignment.windows import Bases, Window, integrated

RATE, SECONDS = 100, 20
KNOWN = Mounted(
    Rotation.from_euler("ZYX", [0.4, -0.1, 0.2]).as_matrix(), np.array([1.2, -0.3, 0.5])
)
STEP = 1e-6


def imu() -> tuple[Array, Array, Array]:
    """Stamps [ns], specific force and angular rate of a vehicle that turns and pitches."""
    t = np.arange(1, RATE * SECONDS + 1) / RATE
    f = np.stack([0.3 * np.sin(0.7 * t), 0.5 * np.cos(0.4 * t), -9.8 + 0.2 * np.sin(t)], axis=1)
    w = np.stack([0.05 * np.sin(t), 0.08 * np.cos(0.9 * t), 0.2 + 0.1 * np.sin(0.3 * t)], axis=1)
    return np.round(t * NS).astype(np.int64), f, w


def window(f: Array, w: Array) -> Window:
    """The window of one ping per second; its readings need not fit the IMU."""
    stamps, _, _ = imu()
    pings = np.arange(1, SECONDS) * NS
    v_d = np.random.default_rng(4).normal([1.5, 0.0, 0.0], 1.0, (len(pings), 3))
    return integrated(stamps, f, w, pings, v_d, 0.5)


def test_a_bias_of_the_imu_changes_the_integrals_by_the_columns_of_the_window() -> None:
    _, f, w = imu()
    here = window(f, w)
    rng = np.random.default_rng(5)
    b_f, b_w, scale = rng.normal(size=3), rng.normal(size=3), 0.7
    biased = window(f - STEP * b_f, w - STEP * (b_w + scale * w))
    F = here.F - STEP * (here.Phi @ b_f + here.Psi @ b_w + here.Xi * scale)
    angle = STEP * (here.Phi @ b_w + here.xi * scale)
    R = Rotation.from_rotvec(-angle).as_matrix() @ here.R
    # What is left is of second order, and of the steps of 10 ms.
    size = np.abs(biased.F - here.F).max()
    np.testing.assert_allclose(biased.F, F, atol=2e-3 * size)
    np.testing.assert_allclose(biased.R, R, atol=1e-10)


@pytest.mark.parametrize("column", range(SIZE))
def test_the_rows_are_the_derivatives_of_what_they_leave(column: int) -> None:
    _, f, w = imu()
    here = window(f, w)
    x = np.zeros(SIZE)
    x[MOUNT] = [0.1, -0.3, 0.9]
    x[SCALE] = 0.2
    x[ARM] = [0.4, 0.2, -0.6]
    x[ACCELEROMETER] = [0.02, -0.05, 0.01]
    a = rows(here, KNOWN, x)

    def y(sign: float) -> Array:
        moved = x.copy()
        if MOUNT.start <= column < MOUNT.stop:  # a turn of the mount, not of its vector
            turn = np.zeros(3)
            turn[column] = sign * STEP
            both = Rotation.from_rotvec(turn) * Rotation.from_rotvec(x[MOUNT])
            moved[MOUNT] = both.as_rotvec()
        else:
            moved[column] += sign * STEP
        return rows(here, KNOWN, moved)[:, :, -1]

    numerical = (y(1.0) - y(-1.0)) / (2.0 * STEP)
    np.testing.assert_allclose(a[:, :, column], numerical, atol=2e-7)


def test_right_values_leave_a_parabola() -> None:
    """A vehicle whose DVL reads what the unknowns say: y is constant but for gravity."""
    _, f, w = imu()
    still = window(f, w)
    x = np.zeros(SIZE)
    x[MOUNT] = [0.0, 0.1, 0.6]
    x[SCALE] = -0.1
    x[ARM] = [0.3, -0.2, 0.4]
    # v_body = R^T (v_0 + F), since what gravity adds is a part of the parabola.
    v_b = np.einsum("kji,kj->ki", still.R, np.array([1.5, 0.1, 0.0]) + still.F)
    at_dvl = v_b + np.cross(still.w, KNOWN.l_b + x[ARM])
    C = Rotation.from_rotvec(x[MOUNT]).as_matrix() @ KNOWN.C_b_d
    read = replace(still, v_d=np.exp(x[SCALE]) * at_dvl @ C)
    bases = Bases.of(read.t)

    def left(values: Array) -> float:
        y = rows(read, KNOWN, values)[:, :, -1]
        return float(np.abs(y - bases.parabola @ (bases.parabola.T @ y)).max())

    assert left(x) < 1e-9
    for column, change in ((2, 0.01), (SCALE, 0.01), (4, 0.05), (DELAY, 0.05)):
        assert left(x + change * np.eye(SIZE)[column]) > 1e-3
    for column in (GYROSCOPE.start, GYROSCOPE_SCALE):
        assert left(x + 1e-2 * np.eye(SIZE)[column]) > 1e-4
