"""A filter that starts from gravity must see gravity."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl.navigation.events import NS, Imu
from insdvl.navigation.geometry.earth import EARTH_RATE, gravity
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import (
    FilterParameters,
    ImuParameters,
    OriginParameters,
)
from insdvl.simulation.initial_errors import P_0
from insdvl.timeline.fold import Fold

STEP = NS // 100
LATITUDE = 32.0
G = np.array([0.0, 0.0, gravity(np.radians(LATITUDE), 0.0)])
C_N_B = rotation_from_rpy(np.array([0.02, -0.03, 0.0]))
AT_REST = -C_N_B.T @ G
W_IB_B = C_N_B.T @ (
    EARTH_RATE * np.array([np.cos(np.radians(LATITUDE)), 0.0, -np.sin(np.radians(LATITUDE))])
)


def started(f_b: np.ndarray, stamps_ns: np.ndarray, bias=(0.0, 0.0, 0.0)) -> Fold:
    """A filter that levels for a second and has seen these samples (N, 3)."""
    fold = Fold(
        FilterParameters(
            frame_convention="ned",
            imu=ImuParameters(frozen_samples=0),  # no noise here
            initial=replace(P_0, mode="levelling", accelerometer_bias=bias),
            origin=OriginParameters(latitude_deg=LATITUDE),
        )
    )
    for stamp_ns, f in zip(stamps_ns.tolist(), f_b, strict=True):
        assert fold.add(Imu(stamp_ns, f, W_IB_B)) is None
    return fold


def first_output(fold: Fold) -> int:
    return next(output.stamp_ns for output in fold.take() if isinstance(output, Odometry))


def tilt(fold: Fold) -> np.ndarray:
    """(2,) error of the attitude about north and east [rad]."""
    E = fold.latest["nav"]["C_n_b"] @ C_N_B.T
    return np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0]]) / 2


STAMPS = NS + np.arange(300) * STEP


def test_levelling_finds_roll_and_pitch() -> None:
    fold = started(np.tile(AT_REST, (300, 1)), STAMPS)
    assert first_output(fold) == NS + 100 * STEP
    np.testing.assert_allclose(tilt(fold), 0.0, atol=1e-6)
    assert fold.counts["not_level"] == 0


@pytest.mark.parametrize("factor", [0.0, 1 / 9.81, 2.0], ids=["zeros", "in g", "double"])
def test_what_is_not_gravity_is_not_levelled(factor: float) -> None:
    """Zeros while the driver starts would turn the vehicle upside down."""
    f_b = np.tile(AT_REST, (400, 1))
    f_b[:150] *= factor
    fold = started(f_b, NS + np.arange(400) * STEP)
    assert first_output(fold) > NS + 200 * STEP
    assert fold.counts["no_data" if factor == 0.0 else "not_level"] >= 1
    np.testing.assert_allclose(tilt(fold), 0.0, atol=1e-6)


def test_nothing_but_zeros_never_starts() -> None:
    fold = started(np.zeros((300, 3)), STAMPS)
    assert not fold.latest or not fold.latest["nav"]["initialised"]
    assert fold.counts["no_data"] == 300
    assert fold.counts["not_level"] == 0  # no sample was levelled


def test_a_declared_bias_is_no_tilt() -> None:
    bias = np.array([0.1, -0.05, 0.02])
    fold = started(np.tile(AT_REST + bias, (300, 1)), STAMPS, tuple(bias.tolist()))
    np.testing.assert_allclose(tilt(fold), 0.0, atol=1e-6)
    np.testing.assert_allclose(fold.latest["nav"]["v_n"], 0.0, atol=1e-3)


def test_levelling_begins_anew_behind_a_gap() -> None:
    stamps_ns = STAMPS.copy()
    stamps_ns[50:] += NS // 2
    fold = started(np.tile(AT_REST, (300, 1)), stamps_ns)
    assert first_output(fold) == stamps_ns[150]
    assert fold.counts["not_level"] == 1
