"""`insdvl check`: what is wrong with a recording is named, with what mends it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from looked_at import START_NS, TURNED, Memory, flown, raws_of
from recordings import save

from insdvl import cli
from insdvl.messages import topics
from insdvl.messages.convert import FIX
from insdvl.messages.depth import PRESSURE
from insdvl.messages.drivers import DVL_MSGS, MARINE_ACOUSTIC, NUCLEUS_BOTTOM
from insdvl.messages.heading import QUATERNION
from insdvl.navigation.events import NS
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import Raw, decode, encode, new_message, stamp_ns, typestore
from insdvl.recordings.drivers import dvl_message, dvl_raw
from insdvl.recordings.messages import twist_message
from insdvl.recordings.parameters import ReplayParameters
from insdvl.simulation.mission import Mission
from insdvl.simulation.trajectories import STATIC
from insdvl.studies.check.answers import answers
from insdvl.studies.check.dvl import DvlLog
from insdvl.studies.check.findings import (
    AXES,
    FIT,
    HEADING,
    NEEDED,
    PINGS,
    SAMPLES,
    STAMPS,
    START,
    Finding,
    is_usable,
    settings_of,
)
from insdvl.studies.check.inspection import Inspection, inspect
from insdvl.studies.check.stamps import StampLog
from insdvl.studies.check.text import text_of

SHORT, BRIEF = 25.0, 12.0  # s, with two blocks of gravity, and with one
NOISE = {
    "process_noise.accelerometer_variance": (9.6e-05,) * 3,
    "process_noise.gyroscope_variance": (8.5e-08,) * 3,
}
TOPICS = ReplayParameters(imu_topic="/imu", dvl_topic="/dvl")


def looked_at(raws: list[Raw], *, adapt: bool = True, **parameters: Any) -> Inspection:
    filter_ = build(FilterParameters, NOISE | parameters)
    return inspect(cast(BagReader, Memory(raws)), filter_, TOPICS, adapt=adapt)


def said(raws: list[Raw], **options: Any) -> list[Finding]:
    return answers(looked_at(raws, **options))


def texts(found: list[Finding], question: str) -> str:
    return " ".join(finding.text for finding in found if finding.question == question)


def wrong(found: list[Finding]) -> list[str]:
    return [finding.text for finding in found if finding.wrong]


@pytest.fixture(scope="module")
def mission() -> Mission:
    return flown(SHORT)


@pytest.fixture(scope="module")
def raws(mission: Mission) -> list[Raw]:
    return raws_of(mission)


@pytest.fixture(scope="module")
def brief() -> Mission:
    return flown(BRIEF)


# ---------------------------------------------------------------- a good one


def test_nothing_is_wrong_with_a_good_recording(raws: list[Raw]) -> None:
    seen = looked_at(raws)
    found = answers(seen)
    assert wrong(found) == []
    assert is_usable(found)
    assert settings_of(found) == {}
    assert "100 Hz without gaps" in texts(found, STAMPS)
    assert "+9.7" in texts(found, AXES)
    assert texts(found, START).startswith("Yes, the DVL reads 1.0")
    assert "unknown until the motion shows it" in texts(found, HEADING)
    assert "5 stretches of 20 s" in texts(found, FIT)  # it is too short for the alignment
    sigma = np.sqrt([*NOISE["process_noise.accelerometer_variance"], *[8.5e-08] * 3])
    assert seen.imu is not None
    np.testing.assert_allclose(np.sqrt(seen.imu.variance), sigma, rtol=0.1)


def test_the_text_has_80_columns_and_every_question(raws: list[Raw]) -> None:
    long = [raw._replace(topic="/vehicle/sensors/inertial/raw") for raw in raws[:9]]
    seen = looked_at([*raws[:500], *long])
    found = answers(seen)
    lines = text_of("dive", seen, found).splitlines()
    assert max(map(len, lines)) <= 80
    assert {finding.question for finding in found} <= set(lines)
    assert lines[-1].strip() == "Yes."


def test_what_the_reader_remarks_is_said(raws: list[Raw]) -> None:
    memory = Memory(raws[:100])
    memory.remarks.append("topic /tool is left out")
    seen = inspect(cast(BagReader, memory), FilterParameters(), TOPICS, adapt=True)
    assert "Topic /tool is left out." in texts(answers(seen), NEEDED)


def test_sensors_on_other_topics_are_found_by_their_types(raws: list[Raw]) -> None:
    names = {"/imu": "/auv/imu/raw", "/dvl": "/auv/dvl/twist"}
    moved = [raw._replace(topic=names.get(raw.topic, raw.topic)) for raw in raws]
    command = [raw._replace(topic="/cmd_vel") for raw in raws if raw.topic == "/dvl"]
    found = said(moved + command + command)
    assert settings_of(found) == {
        "insdvl_replay": {"imu_topic": "/auv/imu/raw", "dvl_topic": "/auv/dvl/twist"}
    }
    assert is_usable(found)


@pytest.mark.parametrize("kind", [MARINE_ACOUSTIC, DVL_MSGS, NUCLEUS_BOTTOM])
def test_a_dvl_of_a_drivers_own_type_is_found(kind: str, mission: Mission, raws: list[Raw]) -> None:
    """By its definition in the recording; its stamps are known, whether or not it has a header."""
    pings = [
        dvl_raw("/bottom", stamp, dvl_message(kind, stamp, v))
        for stamp, v in zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    ]
    seen = looked_at([*pings, *(raw for raw in raws[:600] if raw.topic != "/dvl")])
    assert seen.sensors.dvl == "/bottom"
    assert seen.dvl is not None
    assert (seen.dvl.count, seen.dvl.refused) == (25, {})
    assert seen.stamps["/bottom"].rate == pytest.approx(1.0, rel=1e-3)
    assert settings_of(answers(seen)) == {"insdvl_replay": {"dvl_topic": "/bottom"}}


# ---------------------------------------------------------------- what no parameter mends


def test_without_a_dvl_it_is_not_usable(raws: list[Raw]) -> None:
    found = said([raw for raw in raws if raw.topic != "/dvl"])
    assert not is_usable(found)
    assert "No topic has a type of a DVL" in texts(found, NEEDED)


OURS = [
    *(row.name for row in topics.TOPICS if not row.measurement and row.name != topics.IMU),
    *(topics.ODOMETRY, topics.GLOBAL_ODOMETRY, topics.GLOBAL_POSITION, topics.BIAS),
    *(f"{row.measurement}{topics.INNOVATION}" for row in topics.TOPICS if row.measurement),
]


@pytest.mark.parametrize("name", OURS)
def test_a_topic_of_our_nodes_is_no_dvl(name: str, raws: list[Raw]) -> None:
    """Its noise, its truth and its innovations have the types of its velocity."""
    few = raws[:600]
    pings = [raw for raw in telling(few, 0.02) if raw.topic == "/dvl"]
    truths = {topics.TRUTH, topics.FIX}
    for above in ("", "/auv"):
        ours = [raw._replace(topic=f"{above}/{name}") for raw in pings]
        if name not in truths:
            found = said([*(raw for raw in few if raw.topic != "/dvl"), *ours])
            assert not is_usable(found)
            assert "No topic has a type of a DVL" in texts(found, NEEDED)
        assert looked_at([*few, *ours]).sensors.dvl == "/dvl"


def test_without_an_imu_it_is_not_usable(raws: list[Raw]) -> None:
    found = said([raw for raw in raws if raw.topic != "/imu"])
    assert not is_usable(found)
    assert "needs an IMU" in texts(found, NEEDED)


def test_a_dvl_in_millimetres_is_named(brief: Mission) -> None:
    found = said(raws_of(replace(brief, v_d=1000.0 * brief.v_d)))
    assert not is_usable(found)
    assert "the unit is mm/s" in texts(found, PINGS)


@pytest.mark.parametrize("factor", [1 / 9.81, 0.0])
def test_accelerometers_in_g_or_without_gravity_are_not_usable(
    mission: Mission, factor: float
) -> None:
    rng = np.random.default_rng(2)
    f = factor * mission.f_b + 0.01 * rng.standard_normal(mission.f_b.shape)
    found = said(raws_of(replace(mission, f_b=f)))
    assert not is_usable(found)
    assert "frame_convention" not in str(settings_of(found))
    assert "wrong unit, or gravity was removed" in texts(found, AXES)


@pytest.mark.long
def test_a_gyroscope_in_degrees_is_named() -> None:
    mission = flown(125.0)
    found = said(raws_of(replace(mission, w_ib_b=np.degrees(mission.w_ib_b))))
    assert not is_usable(found)
    assert "the gyroscope is in deg/s" in texts(found, FIT)


def test_clocks_that_do_not_meet_are_named(raws: list[Raw]) -> None:
    later = []
    for raw in raws:
        if raw.topic == "/dvl":
            message = decode(raw).message
            message.header.stamp.sec += 3600
            raw = encode(raw.topic, raw.time_ns, message)
        later.append(raw)
    found = said(later)
    assert not is_usable(found)
    assert "other clocks" in texts(found, STAMPS)


# ---------------------------------------------------------------- what a parameter mends


@pytest.mark.long
def test_a_turned_dvl_is_named_with_its_mount(tmp_path: Path) -> None:
    """Forward is to port of the instrument; in a recording on disk, by the command itself."""
    mission = flown(125.0)
    bag = save(tmp_path / "turned", raws_of(replace(mission, v_d=mission.v_d @ TURNED.T)))
    out = tmp_path / "check.json"
    assert cli.main(["check", str(bag), "--json", str(out)]) == 0
    document = json.loads(out.read_text())
    assert document["usable"]
    roll, pitch, yaw = document["set"]["insdvl_filter"]["dvl.mount"]
    assert np.hypot(roll, pitch) < 0.2
    # In forward-left-up the instrument that was turned to starboard has a negative yaw. Two
    # minutes tell it to 7 deg, one sigma.
    assert yaw == pytest.approx(-np.pi / 2, abs=np.radians(21.0))
    fit, angles = [f["text"] for f in document["findings"] if f["question"] == FIT]
    assert "the DVL is turned about z" in fit
    assert "dvl.mount is [0.0, 0.0, -1.5708]" in angles


def test_the_other_frame_convention_is_told(mission: Mission) -> None:
    """As it comes it is taken from gravity; where a file tells the wrong one, that is said."""
    flip = np.diag([1.0, -1.0, -1.0])
    ned = replace(
        mission, f_b=mission.f_b @ flip, w_ib_b=mission.w_ib_b @ flip, v_d=mission.v_d @ flip
    )
    found = said(raws_of(ned))
    assert is_usable(found)
    assert settings_of(found) == {"insdvl_filter": {"frame_convention": "ned"}}
    told = said(raws_of(ned), adapt=False)
    assert "gravity has the wrong sign along z" in texts(told, AXES)
    assert settings_of(told) == {"insdvl_filter": {"frame_convention": "ned"}}


def test_an_imu_on_its_side_is_told_with_its_mount(brief: Mission) -> None:
    C_b_i = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    side = replace(brief, f_b=brief.f_b @ C_b_i, w_ib_b=brief.w_ib_b @ C_b_i)
    settings = settings_of(said(raws_of(side)))["insdvl_filter"]
    roll, pitch, yaw = settings["imu.mount"]
    assert abs(roll) == pytest.approx(np.pi / 2, abs=0.15)
    assert abs(pitch) < 0.15
    assert abs(yaw) < 0.15


def telling(raws: list[Raw], sigma: float) -> list[Raw]:
    """The recording of a DVL whose messages tell this sigma."""
    told = []
    for raw in raws:
        if raw.topic == "/dvl":
            v = decode(raw).message.twist.linear
            told_of = twist_message(stamp_ns(raw), "dvl", (v.x, v.y, v.z), sigma**2 * np.eye(3))
            raw = encode(raw.topic, raw.time_ns, told_of)
        told.append(raw)
    return told


def test_a_sigma_of_the_messages_that_is_far_too_large_is_not_to_be_taken(
    raws: list[Raw],
) -> None:
    for sigma, settings in (
        (2.0, {"insdvl_filter": {"dvl.covariance": "parameters"}}),
        (0.03, {}),
    ):
        found = said(told := telling(raws, sigma))
        assert f"The messages tell a sigma of {sigma:g} m/s." in texts(found, PINGS)
        assert settings_of(found) == settings
        assert settings_of(said(told, **{"dvl.covariance": "parameters"})) == {}


def test_a_sigma_of_the_messages_that_stands_for_none_makes_a_recording_useless() -> None:
    found = said(telling(raws_of(flown(3.0, STATIC)), 1000.0))
    assert not is_usable(found)
    assert texts(found, START).startswith("Not told: ")  # it may move steadily
    assert "Most measurements cannot be used: " in texts(found, PINGS)
    assert " invalid." in texts(found, PINGS)


def test_a_dvl_without_a_component_tells_that_the_vehicle_moves() -> None:
    """At a constant speed the samples look like those at rest."""
    steady = []
    for raw in raws_of(flown(3.0, STATIC)):
        if raw.topic == "/dvl":
            R = np.diag([1e-4, 1e-4, np.inf])
            raw = encode(
                raw.topic, raw.time_ns, twist_message(stamp_ns(raw), "dvl", (1.0, 0.0, 0.0), R)
            )
        steady.append(raw)
    found = texts(said(steady), START)
    assert found.startswith("Yes, the DVL reads 1.00 m/s: the filter starts under way")


def test_a_fix_a_pressure_and_a_compass_are_found(raws: list[Raw]) -> None:
    fix, pressure = new_message(FIX), new_message(PRESSURE)
    fix.latitude, fix.longitude = 59.9, 10.7
    pressure.fluid_pressure = 2e5
    for message in (fix, pressure):
        message.header.stamp.sec = START_NS // NS
    compass = new_message(QUATERNION)
    compass.header.stamp.sec = START_NS // NS
    others = [encode("/fix", START_NS, fix), encode("/ctd/pressure", START_NS, pressure)]
    found = said([*others, encode("/compass", START_NS, compass), *raws[:100]])
    assert "/compass may tell it: heading.topic: compass." in texts(found, HEADING)
    assert settings_of(found) == {
        "insdvl_filter": {"depth.topic": "ctd/pressure", "origin.latitude_deg": 59.9}
    }


# ---------------------------------------------------------------- sensors that stop


def lasting(raws: list[Raw], topic: str, begin: float, end: float) -> list[Raw]:
    """The recording with a topic from one time to another [s] only."""
    return [
        raw for raw in raws if raw.topic != topic or begin <= (raw.time_ns - START_NS) / NS <= end
    ]


@pytest.mark.parametrize(
    ("topic", "begin", "end", "text"),
    [
        ("/imu", 0.0, 20.0, "IMU: nothing in the last 5.0 s, from 20.0 of 25.0 s on."),
        ("/imu", 4.0, 25.0, "IMU: nothing in the first 4.0 of 25.0 s."),
        ("/dvl", 0.0, 18.5, "DVL: nothing in the last 7.0 s, from 18.0 of 25.0 s on."),
        ("/dvl", 5.5, 25.0, "DVL: nothing in the first 6.0 of 25.0 s."),
    ],
)
def test_a_sensor_that_starts_late_or_stops_is_told_with_times(
    topic: str, begin: float, end: float, text: str, raws: list[Raw]
) -> None:
    found = said(lasting(raws, topic, begin, end))
    assert text in [finding.text for finding in found if finding.wrong]
    assert is_usable(found)


@pytest.mark.parametrize(("topic", "use"), [("/imu", "IMU"), ("/dvl", "DVL")])
def test_a_sensor_that_is_missing_for_most_of_a_recording_makes_it_useless(
    topic: str, use: str, raws: list[Raw]
) -> None:
    """At its end, or within it."""
    for part in (
        lasting(raws, topic, 0.0, 8.0),
        [r for r in raws if r.topic != topic or not 4.5 < (r.time_ns - START_NS) / NS < 20.0],
    ):
        found = said(part)
        assert not is_usable(found)
        assert f"The {use} is missing for 1" in texts(found, STAMPS)


def test_a_depth_sensor_that_stops_is_told(raws: list[Raw]) -> None:
    pressures = []
    for k in range(10):
        pressure = new_message(PRESSURE)
        pressure.header.stamp.sec, pressure.fluid_pressure = START_NS // NS + k, 2e5
        pressures.append(encode("/ctd/pressure", START_NS + k * NS, pressure))
    found = said(sorted([*raws, *pressures], key=lambda raw: raw.time_ns))
    assert "depth: nothing in the last 16.0 s, from 9.0 of 25.0 s on." in wrong(found)
    assert is_usable(found)


def test_what_a_recorder_or_a_slow_dvl_leaves_at_the_ends_is_no_fault() -> None:
    """Topics are found one after the other, and a ping every 5 s is not there at every second."""
    begin_ns, end_ns = 100 * NS, 200 * NS
    for step, first, last, expected in (
        (0.01, 100.9, 199.2, (0.0, 0.0)),
        (0.01, 101.2, 198.0, (1.2, 2.0)),
        (5.0, 113.0, 188.0, (0.0, 0.0)),
        (5.0, 116.0, 181.0, (16.0, 19.0)),
    ):
        log = StampLog()
        for t in np.arange(first, last + 1e-6, step):
            log.add(round(t * NS), round(t * NS))
        found = log.facts().missing_at_ends(begin_ns, end_ns)
        np.testing.assert_allclose(found, expected, atol=0.02)


def test_an_imu_that_ends_before_the_dvl_begins_is_not_a_matter_of_clocks(raws: list[Raw]) -> None:
    parts = lasting(lasting(raws, "/imu", 0.0, 10.0), "/dvl", 12.0, 25.0)
    assert "they were not recorded at the same time" in texts(said(parts), STAMPS)


# ---------------------------------------------------------------- start and heading


def test_a_rest_at_the_start_is_told() -> None:
    still = flown(3.0, STATIC)
    assert texts(said(raws_of(still)), START).startswith("No, the DVL reads 0.0")
    rng = np.random.default_rng(1)
    shaken = still.f_b + np.repeat(rng.normal(0.0, 0.3, (100, 3)), 3, axis=0)[: len(still.f_b)]
    found = said(raws_of(replace(still, f_b=shaken)))
    assert texts(found, START).startswith("It stays, but vibrates")


@pytest.mark.parametrize(("shaking", "shown"), [(0.0, "no motion"), (0.3, "that it vibrates")])
def test_whether_it_stays_is_not_told_without_a_dvl(shaking: float, shown: str) -> None:
    """At a constant speed the samples are those at rest, with and without vibration."""
    still = flown(3.0, STATIC)
    rng = np.random.default_rng(1)
    shaken = still.f_b + np.repeat(rng.normal(0.0, shaking, (100, 3)), 3, axis=0)[: len(still.f_b)]
    raws = [raw for raw in raws_of(replace(still, f_b=shaken)) if raw.topic != "/dvl"]
    assert texts(said(raws), START).startswith(f"Not told: the samples show {shown}, and no DVL")


# ---------------------------------------------------------------- scatter of the DVL


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_the_scatter_is_that_of_normal_noise_with_and_without_outliers(share: float) -> None:
    rng = np.random.default_rng(8)
    log = DvlLog(10.0, np.eye(3))
    for k in range(6000):
        off = rng.choice([-3.0, 3.0], 3) * (rng.random() < share)
        log.add(Dvl((k + 1) * NS, 1.0 + 0.1 * rng.standard_normal(3) + off))
    scatter = log.facts().scatter
    assert scatter is not None
    np.testing.assert_allclose(scatter, 0.1, rtol=0.1)


# ---------------------------------------------------------------- two vehicles, two sensors


def on_topics(raws: list[Raw], imus: dict[str, int], dvls: dict[str, int]) -> list[Raw]:
    """The recording with the messages of each sensor on other topics, one in so many of them."""
    copies = {"/imu": imus, "/dvl": dvls}
    counts = dict.fromkeys(copies, 0)
    moved = []
    for raw in raws:
        if raw.topic not in copies:
            moved.append(raw)
            continue
        counts[raw.topic] += 1
        moved += [
            raw._replace(topic=name)
            for name, every in copies[raw.topic].items()
            if counts[raw.topic] % every == 0
        ]
    return moved


@pytest.mark.parametrize(
    ("imus", "dvls", "chosen"),
    [
        # Two vehicles: never one sensor of each, whichever has more messages.
        (
            {"/port/imu/data_raw": 1, "/stbd/imu/data_raw": 1},
            {"/port/dvl/velocity": 1, "/stbd/dvl/velocity": 1},
            ("/stbd/imu/data_raw", "/stbd/dvl/velocity"),
        ),
        (
            {"/port/imu/data_raw": 1, "/stbd/imu/data_raw": 2},
            {"/port/dvl/velocity": 2, "/stbd/dvl/velocity": 1},
            ("/port/imu/data_raw", "/port/dvl/velocity"),
        ),
        # Of one vehicle alone there is a DVL.
        (
            {"/port/xsens": 4, "/stbd/imu/data_raw": 1},
            {"/port/dvl/velocity": 1},
            ("/port/xsens", "/port/dvl/velocity"),
        ),
        # The namespace of a sensor is none of a vehicle.
        (
            {"/imu/data_raw": 1, "/dvl/imu": 4},
            {"/dvl/twist": 1},
            ("/imu/data_raw", "/dvl/twist"),
        ),
    ],
)
def test_imu_and_dvl_are_of_one_vehicle(
    imus: dict[str, int], dvls: dict[str, int], chosen: tuple[str, str], raws: list[Raw]
) -> None:
    seen = inspect(
        cast(BagReader, Memory(on_topics(raws[:800], imus, dvls))),
        FilterParameters(),
        ReplayParameters(imu_topic="/none", dvl_topic="/none"),
        adapt=True,
    )
    assert (seen.sensors.imu, seen.sensors.dvl) == chosen
    said_of = texts(answers(seen), NEEDED)
    for use, names, name in (("IMU", imus, chosen[0]), ("DVL", dvls, chosen[1])):
        others = ", ".join(other for other in names if other != name)
        text = f"CHECK that {name} is the {use} of this vehicle: {others} could be"
        assert (text in said_of) == bool(others)


def test_the_dvl_of_the_vehicle_whose_imu_is_named_is_taken(raws: list[Raw]) -> None:
    names = ("/port", "/stbd")
    topics_of = on_topics(
        raws[:400], {f"{n}/imu": 1 for n in names}, {f"{n}/dvl": 1 for n in names}
    )
    for name in names:
        replay = ReplayParameters(imu_topic=f"{name}/imu")
        memory = cast(BagReader, Memory(topics_of))
        assert inspect(memory, FilterParameters(), replay, adapt=True).sensors.dvl == f"{name}/dvl"


@pytest.mark.parametrize(
    ("quaternion", "variance", "text"),
    [
        ((0.0, 0.0, 0.0, 1.0), 0.0004, "From the orientation of the IMU, one sigma 1.1 deg."),
        ((0.0, 0.0, 0.0, 1.0), 0.0, "The IMU has an orientation of unknown covariance."),
        ((0.71, 0.0, 0.0, 0.71), 0.0004, "in other axes than its force: not used."),
        ((0.0, 0.0, 0.0, 1.0), -1.0, "No sensor is known to tell it"),
    ],
)
def test_an_orientation_tells_the_heading_where_it_can(
    raws: list[Raw], quaternion: tuple[float, ...], variance: float, text: str
) -> None:
    told = []
    for raw in raws[:200]:
        if raw.topic == "/imu":
            message = typestore().deserialize_cdr(raw.data, raw.type)
            q = message.orientation
            q.x, q.y, q.z, q.w = quaternion
            message.orientation_covariance = np.diag([variance] * 3).ravel()
            raw = encode(raw.topic, raw.time_ns, message)
        told.append(raw)
    assert text in texts(said(told), HEADING)


# ---------------------------------------------------------------- samples and stamps


def test_gaps_are_counted(raws: list[Raw]) -> None:
    def is_lost(raw: Raw) -> bool:
        since = (raw.time_ns - START_NS) / NS
        return raw.topic == "/imu" and (5.0 < since < 6.0 or 12.0 < since < 12.5)

    found = said([raw for raw in raws if not is_lost(raw)])
    assert "2 gaps, 1.5 s together, the longest 1 s" in texts(found, STAMPS)
    assert is_usable(found)


def test_another_rate_is_told(raws: list[Raw]) -> None:
    """8 Hz, at which the default of imu.max_gap would make a gap of each interval."""
    few = [raw for k, raw in enumerate(raws) if raw.topic != "/imu" or k % 12 == 0]
    steps = np.diff([raw.time_ns for raw in few if raw.topic == "/imu"])
    rate = float(f"{NS / np.median(steps):.3g}")
    settings = settings_of(said(few))["insdvl_filter"]
    assert settings["imu.rate"] == rate
    assert settings["imu.max_gap"] == pytest.approx(5.0 / rate, rel=0.05)
    told = settings_of(said(raws, adapt=False, **{"imu.rate": 200.0}))
    assert told == {"insdvl_filter": {"imu.rate": 100.0}}


def test_stamps_that_repeat_go_back_or_are_unset_are_counted() -> None:
    log = StampLog()
    for stamp in (10, 20, 20, 15, 0, 30):
        log.add(stamp * NS // 10, 5 * NS)
    facts = log.facts()
    assert (facts.count, facts.unset, facts.repeated, facts.backward) == (6, 1, 1, 1)
    assert StampLog().facts().rate is None


def test_latency_is_the_time_of_recording_less_the_stamp(raws: list[Raw]) -> None:
    raws = raws[:200]
    late = [raw._replace(time_ns=raw.time_ns + 12_000_000) for raw in raws]
    assert "recorded 12.0 ms after its stamps" in texts(said(late), STAMPS)
    early = [raw._replace(time_ns=raw.time_ns - 12_000_000) for raw in raws]
    assert "the clock of the sensor is ahead" in texts(said(early), STAMPS)


def test_a_saturated_channel_is_named_with_its_range(brief: Mission) -> None:
    f = brief.f_b.copy()
    f[500:520, 0] += 40.0
    found = said(raws_of(replace(brief, f_b=np.minimum(f, 19.6))))
    assert "f_x is saturated: it stands at 19.6 m/s^2" in texts(found, SAMPLES)
    assert settings_of(found)["insdvl_filter"]["imu.acceleration_range"] == 19.6
    assert is_usable(found)


def test_glitches_zeros_and_frozen_channels_are_counted(brief: Mission) -> None:
    f, w = brief.f_b.copy(), brief.w_ib_b.copy()
    f[700, 2] += 60.0
    f[900], w[900] = 0.0, 0.0
    w[300:600, 1] = w[300, 1]
    found = texts(said(raws_of(replace(brief, f_b=f, w_ib_b=w))), SAMPLES)
    assert "1 of 1200 samples with a specific force of exactly zero" in found
    assert "1 of 1200 samples with a reading that leaves its neighbours" in found
    assert "201 of 1200 samples with a frozen channel" in found


def test_the_scatter_of_the_dvl_is_its_noise() -> None:
    """In a turn that takes a minute; one sigma of the median of 500 is 6 %."""
    log, rng = DvlLog(10.0, np.eye(3)), np.random.default_rng(3)
    for k in range(500):
        v = np.array([1.0, 0.1 * np.sin(k / 10.0), 0.0]) + 0.02 * rng.standard_normal(3)
        log.add(Dvl((k + 1) * NS, v))
    scatter = log.facts().scatter
    assert scatter is not None
    np.testing.assert_allclose(scatter, 0.02, rtol=0.2)


def test_a_lost_lock_is_counted(brief: Mission) -> None:
    v = brief.v_d.copy()
    v[4:8] = 0.0
    v[9:] = v[9]
    found = texts(said(raws_of(replace(brief, v_d=v))), PINGS)
    assert "4 of 12 are exactly zero" in found
    assert "2 of 12 repeat the one before" in found


# ---------------------------------------------------------------- the command


def test_exit_codes_and_json_on_the_terminal(
    raws: list[Raw], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = save(tmp_path / "no_dvl", [raw for raw in raws[:500] if raw.topic != "/dvl"])
    assert cli.main(["check", str(bag), "--json", "-"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["usable"]
    assert document["topics"]["/imu"]["use"] == "IMU"
    assert cli.main(["check", str(tmp_path / "none")]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_a_velocity_along_one_axis_has_a_speed_and_a_scatter() -> None:
    log, rng = DvlLog(10.0, np.eye(3)), np.random.default_rng(3)
    for k in range(400):
        v = np.array([1.5 + 0.01 * k + 0.05 * rng.standard_normal(), 0.0, 0.0])
        log.add(Dvl(k * NS, v, measured=(True, False, False)))
    facts = log.facts()
    assert facts.speed is not None and facts.speed[0] == pytest.approx(3.5, abs=0.1)
    assert (facts.count, facts.partial, facts.zeros) == (400, 400, 0)
    assert facts.scatter is not None and facts.scatter[0] == pytest.approx(0.05, rel=0.2)
    assert np.isnan(facts.scatter[1:]).all()


def test_a_component_that_every_second_ping_has_shows_its_scatter() -> None:
    log, rng = DvlLog(10.0, np.eye(3)), np.random.default_rng(4)
    for k in range(400):
        v = 1.5 + 0.05 * rng.standard_normal(3)
        log.add(Dvl(k * NS, v * (1.0, 1.0, k % 2), measured=(True, True, bool(k % 2))))
    np.testing.assert_allclose(log.facts().scatter, 0.05, rtol=0.2)
