"""Types of DVL drivers: what each tells, what is refused by name, what never moves the state."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from told import TOLD

from insdvl.messages.convert import ODOMETRY, TWIST, TWIST_WITH_COVARIANCE, RejectedMessage
from insdvl.messages.drivers import (
    DAVE,
    DRIVERS,
    DVL_MSGS,
    MARINE_ACOUSTIC,
    NUCLEUS_BOTTOM,
    NUCLEUS_WATER,
    REFUSALS,
    STONEFISH,
    TYPES,
    Axes,
    ping,
    type_of,
)
from insdvl.messages.dvl import FILL_VELOCITY, dvl
from insdvl.messages.feed import Feed
from insdvl.messages.refusals import Refused
from insdvl.messages.topics import BY_NAME, DVL, DVL_WITH_COVARIANCE, IMU, taken
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU, NED
from insdvl.navigation.measurements import dvl as measurement
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, build
from insdvl.recordings.base import decode, new_message
from insdvl.recordings.drivers import DEFINITIONS, Told, dvl_message, dvl_raw
from insdvl.recordings.messages import imu_message

DOCS = Path(__file__).parents[3] / "docs"
STAMP = 1_700_000_000 * NS + 123_456_000
V = np.array([1.0, 0.25, -0.125])  # forward-right-down, exact in single precision
#: Types that name their axes themselves.
OWN = [kind for kind, driver in DRIVERS.items() if driver.axes is not Axes.STREAM]
BOTTOM = [kind for kind in OWN if kind != NUCLEUS_WATER]
NAN, INF = float("nan"), float("inf")
UP = np.array([0.0, 0.0, 9.8])


def reason_of(message: Any, **options: Any) -> str:
    with pytest.raises(RejectedMessage) as rejected:
        dvl(message, ENU, **options)
    return rejected.value.reason


# ---------------------------------------------------------------- the table


def test_the_choices_of_the_parameter_are_the_types_of_the_table() -> None:
    assert measurement.TYPES == TYPES == BY_NAME[DVL].types
    assert DEFINITIONS.keys() == DRIVERS.keys() - {TWIST, TWIST_WITH_COVARIANCE, ODOMETRY}


@pytest.mark.parametrize("kind", OWN)
def test_every_field_of_the_table_is_in_the_definition(kind: str) -> None:
    driver, message = DRIVERS[kind], new_message(kind, definition=DEFINITIONS[kind])
    names = [driver.velocity, driver.covariance, driver.sigma, driver.valid, driver.altitude]
    names += [driver.good_beams, *driver.beam_flags, *(driver.times or ())]
    for name in filter(None, names):
        for axis in "xyz":
            field = message
            for part in name.format(axis=axis).split("."):
                field = getattr(field, part)  # raises where there is none
    assert hasattr(message, "header") == driver.header
    assert driver.package


def test_the_page_has_the_table() -> None:
    """Every type with the fields that are taken, its axes, and every reason."""
    page = (DOCS / "how-to" / "drivers.md").read_text()
    lines = {line.split("`")[1]: line for line in page.splitlines() if line.startswith("| `")}
    words = {Axes.STREAM: "`frame_convention`", Axes.FRD: "along", Axes.FLU: "against"}
    for kind, driver in DRIVERS.items():
        assert words[driver.axes] in lines[kind].split(" | ")[-1]
        if kind == NUCLEUS_WATER:
            continue
        names = [driver.velocity, driver.covariance, driver.sigma, driver.valid, driver.altitude]
        for name in filter(None, [*names, driver.good_beams]):
            assert name.replace("{axis}", "x") in lines[kind], name
    for reason in REFUSALS:
        assert f"`{reason}`" in page


def test_the_type_of_a_message_is_its_name() -> None:
    for kind in TYPES:
        assert type_of(dvl_message(kind, STAMP, V)) == kind


def test_a_configured_type_is_the_only_one_taken() -> None:
    assert taken(FilterParameters())[DVL].types == TYPES
    parameters = build(FilterParameters, {"dvl.type": DVL_MSGS})
    assert taken(parameters)[DVL].types == (DVL_MSGS,)
    assert taken(parameters)[DVL_WITH_COVARIANCE].types == (TWIST_WITH_COVARIANCE,)
    with pytest.raises(ParameterError, match="'dvl.type' must be one of auto, .*dvl_msgs/msg/DVL"):
        build(FilterParameters, {"dvl.type": "dvl_msgs/DVL"})


# ---------------------------------------------------------------- what is taken


@pytest.mark.parametrize("convention", [ENU, NED])
@pytest.mark.parametrize("kind", [k for k in TYPES if k != NUCLEUS_WATER])
def test_a_ping_is_the_velocity_of_the_instrument(kind: str, convention: Any) -> None:
    """Axes that a type has by itself are not those of frame_convention."""
    message = dvl_message(kind, STAMP, V, convention=convention)
    event = dvl(message, convention)
    np.testing.assert_array_equal(event.v_d, V)
    assert (event.stamp_ns, event.R, event.measured) == (STAMP, None, (True, True, True))
    if kind in OWN:
        other = ENU if convention is NED else NED
        np.testing.assert_array_equal(dvl(message, other).v_d, V)


@pytest.mark.parametrize("kind", BOTTOM)
def test_a_sigma_or_a_covariance_is_told(kind: str) -> None:
    event = dvl(dvl_message(kind, STAMP, V, Told(sigma=0.25)), ENU)
    np.testing.assert_array_equal(event.R, 0.0625 * np.eye(3))


def test_the_figure_of_merit_is_a_sigma_where_there_is_no_covariance() -> None:
    message = dvl_message(DVL_MSGS, STAMP, V)
    message.fom = 0.5
    for empty in (np.zeros(0), np.zeros(9)):
        message.covariance = empty
        np.testing.assert_array_equal(dvl(message, ENU).R, 0.25 * np.eye(3))
    message.covariance = np.diag([4.0, 9.0, 16.0]).ravel()
    np.testing.assert_array_equal(dvl(message, ENU).R, np.diag([4.0, 9.0, 16.0]))
    message.fom, message.covariance = -1.0, np.zeros(0)
    assert dvl(message, ENU).R is None


def test_axes_turn_a_covariance_too() -> None:
    P = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 0.25], [0.5, 0.25, 16.0]])
    message = dvl_message(STONEFISH, STAMP, V)
    message.velocity_covariance = P.ravel()
    np.testing.assert_array_equal(dvl(message, NED).R, P * np.outer([1, -1, -1], [1, -1, -1]))
    message = dvl_message(MARINE_ACOUSTIC, STAMP, V)
    message.velocity_covar = P.ravel()
    np.testing.assert_array_equal(dvl(message, ENU).R, P)


def test_a_covariance_that_is_not_known_is_the_parameters() -> None:
    message = dvl_message(MARINE_ACOUSTIC, STAMP, V)
    for unknown in ([-1.0] + [0.0] * 8, [-1.0] * 9, [0.0] * 9):
        message.velocity_covar = np.array(unknown)
        assert dvl(message, ENU).R is None


def test_a_bridge_that_packs_nine_numbers_into_a_twist_is_understood() -> None:
    """Variances at 0, 4 and 8, where a twist has them at 0, 7 and 14."""
    message = dvl_message(DAVE, STAMP, V)
    message.velocity.covariance = np.zeros(36)
    message.velocity.covariance[:9] = np.diag([4.0, 9.0, 16.0]).ravel()
    np.testing.assert_array_equal(dvl(message, ENU).R, np.diag([4.0, 9.0, 16.0]))


def test_components_that_a_nucleus_marks_as_invalid_are_not_measured() -> None:
    message = dvl_message(NUCLEUS_BOTTOM, STAMP, V)
    message.fom_x, message.fom_z = 0.5, 0.25
    message.y_velocity_valid, message.velocity_y, message.fom_y = False, FILL_VELOCITY, 10.0
    event = dvl(message, ENU)
    assert event.measured == (True, False, True)
    np.testing.assert_array_equal(event.v_d, [V[0], 0.0, V[2]])
    np.testing.assert_array_equal(event.R, np.diag([0.25, 0.0, 0.0625]))


def test_a_component_whose_own_sigma_stands_for_none_is_not_measured() -> None:
    message = dvl_message(NUCLEUS_BOTTOM, STAMP, V)
    message.fom_x, message.fom_y, message.fom_z = 0.5, 10.0, 0.25
    assert dvl(message, ENU).measured == (True, False, True)
    message.x_velocity_valid = message.z_velocity_valid = False
    assert reason_of(message) == "invalid"
    message = dvl_message(MARINE_ACOUSTIC, STAMP, V)
    message.velocity_covar = np.diag([0.25, 0.25, 100.0]).ravel()
    assert dvl(message, ENU).measured == (True, True, False)


def test_the_beams_of_each_type_are_read() -> None:
    for kind in (DVL_MSGS, STONEFISH, DAVE, NUCLEUS_BOTTOM):
        told = ping(dvl_message(kind, STAMP, V, Told(good_beams=2)))
        assert told.good_beams == 2, kind
        assert [beam.range for beam in told.beams if beam.good] == [22.0, 22.0]
    assert ping(dvl_message(MARINE_ACOUSTIC, STAMP, V, Told(good_beams=3))).good_beams == 3


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize("kind", [MARINE_ACOUSTIC, DVL_MSGS, STONEFISH, NUCLEUS_BOTTOM])
def test_a_ping_that_is_marked_as_invalid(kind: str) -> None:
    """Also where the numbers beside the mark are none."""
    assert reason_of(dvl_message(kind, STAMP, V, Told(valid=False))) == "invalid"
    assert reason_of(dvl_message(kind, STAMP, V * NAN, Told(valid=False))) == "invalid"


@pytest.mark.parametrize("kind", BOTTOM)
def test_a_ping_without_a_bottom(kind: str) -> None:
    if DRIVERS[kind].altitude:
        assert reason_of(dvl_message(kind, STAMP, V, Told(altitude=-1.0))) == "no_bottom"
        assert dvl(dvl_message(kind, STAMP, V, Told(altitude=NAN)), ENU).v_d is not None
    for beams in (0, 1, 2):
        message = dvl_message(kind, STAMP, V, Told(good_beams=beams))
        assert reason_of(message) == "no_bottom", beams
    three = dvl(dvl_message(kind, STAMP, V, Told(good_beams=3)), ENU)
    np.testing.assert_array_equal(three.v_d, V)


@pytest.mark.parametrize("kind", BOTTOM)
def test_a_source_that_leaves_the_beams_empty_says_nothing(kind: str) -> None:
    np.testing.assert_array_equal(dvl(dvl_message(kind, STAMP, V, Told(beams=False)), ENU).v_d, V)


def test_beams_that_are_not_filled_in_leave_the_flags_of_the_beams_unsaid() -> None:
    """Some drivers tell only the velocity; their messages are zeros and false elsewhere."""
    message = dvl_message(MARINE_ACOUSTIC, STAMP, V, Told(beams=False, valid=False))
    np.testing.assert_array_equal(dvl(message, ENU).v_d, V)
    for name, value in (("num_good_beams", 4), ("beam_ranges_valid", True)):
        filled = replace(message, **{name: value})
        assert reason_of(filled) == "invalid"


@pytest.mark.parametrize("kind", [MARINE_ACOUSTIC, DAVE, NUCLEUS_WATER])
def test_a_velocity_through_the_water(kind: str) -> None:
    message = dvl_message(kind, STAMP, V, Told(water=True, altitude=-1.0))
    assert reason_of(message) == "through_water"


@pytest.mark.parametrize("kind", BOTTOM)
def test_numbers_that_stand_for_none(kind: str) -> None:
    fill = np.array([V[0], V[1], FILL_VELOCITY])
    for v in (fill, np.full(3, FILL_VELOCITY), np.float32(fill)):
        if DRIVERS[kind].axes is Axes.FLU:
            v = ENU.body @ v
        assert reason_of(dvl_message(kind, STAMP, v)) == "invalid"
    assert reason_of(dvl_message(kind, STAMP, V, Told(sigma=10.0))) == "invalid"
    for wrong in (NAN, INF):
        assert reason_of(dvl_message(kind, STAMP, [V[0], wrong, V[2]])) == "not_finite"


def test_covariances_of_drivers_have_the_usual_rules() -> None:
    message = dvl_message(DVL_MSGS, STAMP, V)
    for wrong in (np.ones(8), np.full(9, NAN), np.diag([1.0, -0.5, 1.0]).ravel(), np.ones(36)):
        message.covariance = wrong
        assert reason_of(message) == "bad_covariance"
    message.covariance = np.diag([INF, INF, INF]).ravel()
    assert reason_of(message) == "no_data"
    message.covariance, message.fom = np.zeros(0), NAN
    assert reason_of(message) == "bad_covariance"


# ---------------------------------------------------------------- stamps


def test_the_latency_is_the_difference_of_the_devices_two_times() -> None:
    message = dvl_message(DVL_MSGS, STAMP, V, Told(latency_ns=190_000_000))
    assert dvl(message, ENU).stamp_ns == STAMP - 190_000_000
    assert dvl(message, ENU, by_arrival=True).stamp_ns == -190_000_000
    message.time_of_transmission = 0  # a simulator's bridge tells one of them
    assert dvl(message, ENU).stamp_ns == STAMP
    for wrong in (message.time_of_validity - 1, message.time_of_validity + 10_000_001):
        message.time_of_transmission = wrong
        assert reason_of(message) == "bad_stamp"


def test_a_stamp_that_the_latency_makes_negative() -> None:
    message = dvl_message(DVL_MSGS, NS // 10, V, Told(latency_ns=NS // 5))
    assert reason_of(message) == "bad_stamp"


def test_a_message_without_a_header_has_the_devices_time() -> None:
    message = dvl_message(NUCLEUS_BOTTOM, STAMP, V)
    assert dvl(message, ENU).stamp_ns == STAMP
    assert reason_of(replace(message, posix_time=False)) == "no_stamp"
    assert reason_of(replace(message, timestamp=0, microseconds=0)) == "no_stamp"
    assert reason_of(replace(message, microseconds=1_000_000)) == "bad_stamp"
    assert dvl(replace(message, posix_time=False), ENU, by_arrival=True).stamp_ns == 0


def feed_of(**values: Any) -> Feed:
    names = {name.replace("__", "."): value for name, value in values.items()}
    return Feed(build(FilterParameters, TOLD | names))


def sample(k: int) -> Any:
    noise = 1e-4 * np.random.default_rng(k).standard_normal(6)
    stamp = STAMP + k * NS // 100
    return imu_message(stamp, "imu", noise[:3] + UP, noise[3:])


@pytest.mark.parametrize("off", [-2.5, 2.5, 86_400.0])
def test_a_device_whose_clock_is_not_the_imus(off: float) -> None:
    """Within max_delay it is; else its time is not used, unless that of arrival is asked for."""
    message = dvl_message(NUCLEUS_BOTTOM, STAMP + round(off * NS), V)
    near = dvl_message(NUCLEUS_BOTTOM, STAMP - NS, V)
    feed, arrival = feed_of(), feed_of(dvl__stamp="arrival", dvl__time_offset=-0.1)
    for each in (feed, arrival):
        each.give(IMU, sample(0))
    assert feed.give(DVL, message) == []
    assert feed.refused == {Refused(DVL, "no_stamp"): 1}
    assert feed.give(DVL, near)[0].event.stamp_ns == STAMP - NS
    (fed,) = arrival.give(DVL, message)
    assert fed.event.stamp_ns == STAMP - NS // 10


def test_the_time_of_arrival_needs_a_sample() -> None:
    for kind in (TWIST, DVL_MSGS, NUCLEUS_BOTTOM):
        feed = feed_of(dvl__stamp="arrival")
        message = dvl_message(kind, STAMP - 77 * NS, V, Told(latency_ns=NS // 5))
        assert feed.give(DVL, message) == []
        assert feed.refused == {Refused(DVL, "no_stamp"): 1}
        feed.give(IMU, sample(0))
        latency_ns = NS // 5 if kind == DVL_MSGS else 0
        assert feed.give(DVL, message)[0].event.stamp_ns == STAMP - latency_ns


def test_a_message_without_a_header_has_no_frame() -> None:
    feed = feed_of(dvl__frame_id="dvl_link")
    feed.give(IMU, sample(0))
    assert feed.give(DVL, dvl_message(NUCLEUS_BOTTOM, STAMP, V))
    assert not feed.give(DVL, dvl_message(DVL_MSGS, STAMP, V, frame_id="other"))
    assert feed.refused == {Refused(DVL, "wrong_frame"): 1}


# ---------------------------------------------------------------- definitions of other versions


def test_fields_that_a_definition_lacks_say_nothing() -> None:
    """The first version of dvl_msgs had neither covariance nor the device's times."""
    lines = DEFINITIONS[DVL_MSGS].splitlines()
    gone = ("covariance", "time_of_validity", "time_of_transmission")
    old = "\n".join(line for line in lines if not line.endswith(gone)) + "\n"
    message = new_message(DVL_MSGS, definition=old)
    assert not hasattr(message, "covariance")
    message.header.stamp.sec, message.velocity_valid, message.fom = 5, True, 0.5
    message.velocity.x = 1.0
    event = dvl(message, ENU)
    np.testing.assert_array_equal(event.R, 0.25 * np.eye(3))
    assert event.stamp_ns == 5 * NS


@pytest.mark.parametrize(
    "definition",
    [
        "std_msgs/Header header\n",
        "std_msgs/Header header\nstring velocity\n",
        "std_msgs/Header header\ngeometry_msgs/Vector3 velocity\nstring altitude\n",
        "geometry_msgs/Vector3 velocity\n",
        "std_msgs/Header header\ngeometry_msgs/Vector3 velocity\nfloat64 velocity_covariance\n",
        "std_msgs/Header header\ngeometry_msgs/Vector3 velocity\nstring[] beams\n",
        "std_msgs/Header header\ngeometry_msgs/Vector3 velocity\nstring velocity_covariance\n",
    ],
)
def test_a_definition_of_another_message_is_refused_and_never_raises(definition: str) -> None:
    message = new_message(STONEFISH, definition=definition)
    feed = feed_of()
    feed.give(IMU, sample(0))
    feed.give(DVL, message)
    assert feed.refused.total() == 1
    assert {refused.reason for refused in feed.refused} <= {"no_data", "no_stamp", "bad_covariance"}


# ---------------------------------------------------------------- what never moves the state


@cache
def good_messages() -> list[tuple[str, Any]]:
    """Half a second of an IMU, with a good ping each 0.05 s."""
    messages: list[tuple[str, Any]] = []
    for k in range(1, 51):
        messages.append((IMU, sample(k)))
        if k % 5 == 0:
            v = V + 0.01 * np.random.default_rng(k).standard_normal(3)
            messages.append((DVL, dvl_message(TWIST, STAMP + k * NS // 100, v)))
    return messages


def flown(others: list[Any]) -> bytes:
    """State after the good messages, with others between them."""
    feed = feed_of(initial__velocity=(1.0, -0.25, 0.125))
    for k, (topic, message) in enumerate(good_messages()):
        assert feed.give(topic, message)
        if k < len(others):
            assert feed.give(DVL, others[k]) == []
    assert feed.refused.total() == len(others)
    assert {refused.reason for refused in feed.refused} <= set(REFUSALS)
    assert sum(update.report.accepted for update in feed.fold.updates) > 5
    return feed.fold.states[-1:].tobytes()


unmoved = cache(lambda: flown([]))


NUMBERS = st.floats(-5.0, 5.0) | st.sampled_from([NAN, INF, -INF, FILL_VELOCITY, 0.0, 1e300])


def marks_of(kind: str) -> list[Told]:
    """The ways in which a type says that a ping is none."""
    marks = []
    if kind in (MARINE_ACOUSTIC, DVL_MSGS, STONEFISH, NUCLEUS_BOTTOM):
        marks.append(Told(valid=False))
    if kind in OWN and kind != NUCLEUS_WATER:
        marks += [Told(good_beams=n) for n in (0, 1, 2)]
        marks.append(Told(sigma=10.0))
    if DRIVERS[kind].altitude:
        marks.append(Told(altitude=-1.0))
    if kind in (MARINE_ACOUSTIC, DAVE, NUCLEUS_WATER):
        marks.append(Told(water=True))
    return marks


@pytest.mark.parametrize("kind", TYPES)
@settings(max_examples=5, phases=[Phase.generate])
@given(data=st.data())
def test_a_measurement_that_is_marked_as_none_never_moves_the_state(
    kind: str, data: st.DataObject
) -> None:
    """Whatever its velocity says. ROS's own types have no mark but numbers that are none."""
    messages = []
    for k in range(data.draw(st.integers(1, 10))):
        stamp = STAMP + (2 * k + 1) * NS // 200
        v = data.draw(st.tuples(NUMBERS, NUMBERS, NUMBERS))
        if marks := marks_of(kind):
            told = data.draw(st.sampled_from(marks))
            messages.append(dvl_message(kind, stamp, v, told))
            continue
        message = dvl_message(kind, stamp, (NAN, *v[1:]))
        if kind != TWIST and data.draw(st.booleans()):
            message.twist.covariance = np.diag([INF] * 6).ravel()
        messages.append(message)
    assert flown(messages) == unmoved()


def test_a_message_survives_its_bytes() -> None:
    for kind in OWN:
        message = dvl_message(kind, STAMP, V, Told(sigma=0.5, latency_ns=1000))
        again = decode(dvl_raw("/dvl", 5, message)).message
        if kind == NUCLEUS_WATER:
            assert reason_of(again) == "through_water"
            continue
        event, expected = dvl(again, ENU), dvl(message, ENU)
        assert event.payload() == expected.payload() and event.stamp_ns == expected.stamp_ns
