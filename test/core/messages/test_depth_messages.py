"""Messages of a depth: pressure, and the height in a pose or an odometry."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from told import TOLD

from insdvl.messages.convert import RejectedMessage
from insdvl.messages.depth import ODOMETRY, POSE, PRESSURE, TYPES, depth
from insdvl.messages.feed import Feed
from insdvl.messages.make import fill_imu, fill_pressure
from insdvl.messages.refusals import Refused
from insdvl.messages.topics import BY_NAME, DEPTH, IMU
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU, NED
from insdvl.navigation.measurements.depth import STANDARD_GRAVITY, DepthParameters
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.base import new_message

STAMP = 5 * NS
WEIGHT = 1025.0 * STANDARD_GRAVITY
ATMOSPHERE = 101_325.0


def pressure(value: float, variance: float = 0.0, stamp_ns: int = STAMP) -> Any:
    message = new_message(PRESSURE)
    fill_pressure(message, stamp_ns, value, variance)
    return message


def height(kind: str, z: float, variance: float = 0.0) -> Any:
    message = new_message(kind)
    message.header.stamp.sec = 5
    message.pose.pose.position.z = z
    message.pose.covariance = np.zeros(36)
    message.pose.covariance[14] = variance
    return message


def test_an_absolute_pressure_is_the_depth_below_the_surface() -> None:
    found = depth(pressure(ATMOSPHERE + 20.0 * WEIGHT), ENU, DepthParameters())
    assert (found.stamp_ns, found.from_pressure, found.variance) == (STAMP, True, None)
    assert found.depth == pytest.approx(20.0)


def test_a_gauge_does_not_measure_the_atmosphere() -> None:
    gauge = DepthParameters(atmospheric_pressure=0.0)
    assert depth(pressure(20.0 * WEIGHT), ENU, gauge).depth == pytest.approx(20.0)


def test_fresh_water_is_deeper_at_the_same_pressure() -> None:
    lake = DepthParameters(water_density=998.0)
    found = depth(pressure(ATMOSPHERE + 20.0 * WEIGHT), ENU, lake)
    assert found.depth == pytest.approx(20.0 * 1025.0 / 998.0)


@pytest.mark.parametrize(
    ("told", "expected"), [(WEIGHT**2 * 4e-4, 4e-4), (0.0, None), (-1.0, None)]
)
def test_the_variance_is_that_of_the_message_where_it_knows_one(
    told: float, expected: float | None
) -> None:
    found = depth(pressure(ATMOSPHERE + 5.0 * WEIGHT, told), ENU, DepthParameters())
    assert found.variance == (None if expected is None else pytest.approx(expected))


@pytest.mark.parametrize("kind", [POSE, ODOMETRY])
def test_a_height_is_up_in_enu_and_down_in_ned(kind: str) -> None:
    up = depth(height(kind, -12.0, 0.01), ENU, DepthParameters())
    down = depth(height(kind, 12.0), NED, DepthParameters())
    assert up.depth == down.depth == 12.0
    assert (up.variance, down.variance) == (0.01, None)
    assert not up.from_pressure


IN_AIR = [
    ("on deck", ATMOSPHERE, "out of the water"),
    ("in hPa, at 20 m", (ATMOSPHERE + 20.0 * WEIGHT) / 100.0, r"as hPa it would be 20\.0 m"),
    ("in hPa, at 300 m", (ATMOSPHERE + 300.0 * WEIGHT) / 100.0, r"as hPa it would be 300\.0 m"),
    ("in bar", 3.0, "the unit is not Pa"),
]


@pytest.mark.parametrize(("value", "text"), [row[1:] for row in IN_AIR], ids=[r[0] for r in IN_AIR])
def test_air_and_another_unit_are_refused_and_said(value: float, text: str) -> None:
    with pytest.raises(RejectedMessage, match=text) as refused:
        depth(pressure(value), ENU, DepthParameters())
    assert refused.value.reason == "in_air"


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (pressure(0.0), "no_data"),
        (pressure(-5.0), "out_of_range"),
        (pressure(float("nan")), "not_finite"),
        (pressure(float("inf")), "not_finite"),
        (pressure(2e5, float("nan")), "bad_covariance"),
        (pressure(2e5, stamp_ns=0), "no_stamp"),
        (height(POSE, float("nan")), "not_finite"),
        (height(ODOMETRY, 1.0, float("inf")), "bad_covariance"),
    ],
)
def test_what_cannot_be_a_depth_is_refused_by_name(message: Any, reason: str) -> None:
    with pytest.raises(RejectedMessage) as refused:
        depth(message, ENU, DepthParameters())
    assert refused.value.reason == reason
    assert reason in BY_NAME[DEPTH].refusals


def test_the_table_has_its_types() -> None:
    assert BY_NAME[DEPTH].types == TYPES == (PRESSURE, POSE, ODOMETRY)


# ------------------------------------------------------------------ through the filter


def feed(**changes: Any) -> Feed:
    values = {"depth.topic": "sensors/depth", "initial.mode": "parameters", **changes}
    return Feed(build(FilterParameters, TOLD | values))


def at_rest(k: int) -> Any:
    message = new_message(IMU_TYPE)
    fill_imu(message, STAMP + k * NS // 100, (0.0, 0.0, 9.8), np.zeros(3))
    return message


IMU_TYPE = BY_NAME[IMU].types[0]


def test_the_filter_takes_the_topic_that_its_parameter_names() -> None:
    assert "sensors/depth" not in Feed(build(FilterParameters, TOLD)).inputs.topics
    found = feed()
    for k in range(20):
        found.give(IMU, at_rest(k))
        stamp = STAMP + k * NS // 100
        found.give("sensors/depth", pressure(ATMOSPHERE + (9.0 + 1e-3 * k) * WEIGHT, 0.0, stamp))
    reports = [update.report for update in found.fold.updates]
    assert [r.measurement for r in reports] == ["depth"] * 20
    assert all(r.accepted and r.innovation.shape == (1,) for r in reports)
    assert not found.refused


def test_refusals_are_counted_under_the_topic() -> None:
    found = feed()
    found.give(IMU, at_rest(0))
    found.give("sensors/depth", pressure(0.0))
    found.give("sensors/depth", pressure(ATMOSPHERE))
    assert found.refused == {
        Refused("sensors/depth", "no_data"): 1,
        Refused("sensors/depth", "in_air"): 1,
    }


def test_a_late_stamp_is_corrected() -> None:
    found = feed(**{"depth.time_offset": -0.5})
    found.give(IMU, at_rest(0))
    for message in (
        pressure(ATMOSPHERE + 9.0 * WEIGHT),
        height(POSE, -9.0),
        height(ODOMETRY, -9.0),
    ):
        (fed,) = found.give("sensors/depth", message)
        assert fed.event.stamp_ns == STAMP - NS // 2


def test_any_object_with_the_fields_will_do() -> None:
    """A message of rclpy, of a recording, or of a test."""
    stamp = SimpleNamespace(sec=5, nanosec=0)
    header = SimpleNamespace(stamp=stamp, frame_id="")
    message = SimpleNamespace(header=header, fluid_pressure=3e5, variance=0.0)
    assert depth(message, ENU, DepthParameters()).depth > 19.0
