"""A recording in arrays: the same bits as one message after the other, whatever is in it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from recordings import record
from records import fields
from whole import fold_whole

from insdvl.messages.feed import Feed
from insdvl.messages.topics import IMU
from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.base import Raw, typestore
from insdvl.recordings.played import Listed
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import AUV
from insdvl.studies.replay.fold import feed_recording

TOPICS = {"/imu": IMU, "/dvl": "dvl/velocity", "/truth": "ground_truth/odometry"}
START_NS = 1_700_000_000 * NS
DURATION = 32.0
Change = Callable[[Any], None]


@pytest.fixture(scope="module")
def mission() -> Mission:
    return simulate(AUV, SCENARIOS["varying"], seed=3, duration=DURATION, start_ns=START_NS)


@pytest.fixture(scope="module")
def clean(mission: Mission) -> list[Raw]:
    raws = record(mission, every=100)
    return [raw._replace(topic=TOPICS[raw.topic]) for raw in raws if raw.topic in TOPICS]


def changed(raw: Raw, change: Change, *, little_endian: bool = True) -> Raw:
    """A message with something changed."""
    message = typestore().deserialize_cdr(raw.data, raw.type)
    change(message)
    data = typestore().serialize_cdr(message, raw.type, little_endian=little_endian)
    return raw._replace(data=bytes(data))


def later(seconds: float) -> Change:
    """With another stamp."""

    def change(message: Any) -> None:
        stamp = message.header.stamp
        stamp_ns = stamp.sec * NS + stamp.nanosec + round(seconds * NS)
        stamp.sec, stamp.nanosec = divmod(stamp_ns, NS)

    return change


def setting(path: str, value: Any) -> Change:
    """With another value of a field."""

    def change(message: Any) -> None:
        *names, last = path.split(".")
        for name in names:
            message = getattr(message, name)
        setattr(message, last, value)

    return change


def oriented(message: Any) -> None:
    """With an orientation whose variance is known."""
    message.orientation.w, message.orientation.x = 0.8, 0.6
    message.orientation_covariance = np.diag([1e-4, 1e-4, 1e-2]).ravel()


def unmeasured(message: Any) -> None:
    """Without specific force, by REP-145."""
    message.linear_acceleration_covariance = np.array([-1.0, *np.zeros(8)])


def faulty(clean: list[Raw]) -> list[Raw]:
    """A recording in which all goes wrong that may."""
    raws = list(clean)
    imu = [k for k, raw in enumerate(raws) if raw.topic == IMU]
    single: dict[int, Change] = {
        300: setting("linear_acceleration.x", 400.0),  # a glitch
        301: setting("angular_velocity.z", float("nan")),
        302: setting("linear_acceleration.y", 2e4),
        303: unmeasured,
        304: setting("header.stamp.sec", 0),
        305: setting("header.stamp.nanosec", 2 * NS),
        306: setting("header.stamp.sec", -5),
        320: later(100.0),
        321: later(-100.0),
        330: setting("header.frame_id", "other"),
        331: setting("header.frame_id", "a frame with a longer name"),
    }
    for n, change in single.items():
        raws[imu[n]] = changed(raws[imu[n]], change)
    for n in range(400, 420):  # big-endian
        raws[imu[n]] = changed(raws[imu[n]], lambda message: None, little_endian=False)
    for n in range(500, 700):  # of another frame
        raws[imu[n]] = changed(raws[imu[n]], setting("header.frame_id", "second"))
    for n in (800, 811, 822):  # in another order
        raws[imu[n]], raws[imu[n + 7]] = raws[imu[n + 7]], raws[imu[n]]
    # Repeated: as it is, and with other readings of the same stamp.
    raws[imu[900]] = raws[imu[899]]
    raws[imu[910]] = changed(raws[imu[909]], setting("linear_acceleration.x", -0.3))
    for n in range(1300, len(imu)):  # a gap that is longer than max_delay
        raws[imu[n]] = changed(raws[imu[n]], later(3.5))
    for n in range(2000, len(imu)):  # the clock is set back
        raws[imu[n]] = changed(raws[imu[n]], later(-600.0))
    for n in range(3000, 3030):  # the last reading again and again
        raws[imu[n]] = changed(raws[imu[3000]], later(0.01 * (n - 3000)))
    dvl = [k for k, raw in enumerate(raws) if raw.topic == "dvl/velocity"]
    raws[dvl[5]] = raws[dvl[5]]._replace(data=raws[dvl[4]].data)
    for k in dvl[14:20]:
        raws[k] = changed(raws[k], later(3.5))
    for k in dvl[20:]:
        raws[k] = changed(raws[k], later(3.5 - 600.0))
    late = raws.pop(dvl[8])
    raws.insert(imu[980], late)
    return raws


def as_it_is(clean: list[Raw]) -> list[Raw]:
    return clean


def turned(clean: list[Raw]) -> list[Raw]:
    """The IMU tells its orientation, for some time."""
    imu = [k for k, raw in enumerate(clean) if raw.topic == IMU]
    raws = list(clean)
    for k in imu[100:400]:
        raws[k] = changed(raws[k], oriented)
    return raws


MODES: dict[str, dict[str, Any]] = {
    "topic": {"initial.mode": "topic"},
    "auto": {},
    "offset": {"initial.mode": "topic", "imu.time_offset": 0.25, "imu.frame_id": "imu"},
}


@pytest.mark.parametrize(
    ("recorded", "mode"),
    [(as_it_is, "topic"), (turned, "auto"), *((faulty, mode) for mode in MODES)],
)
def test_arrays_and_single_messages_give_the_same_bits(
    clean: list[Raw],
    recorded: Callable[[list[Raw]], list[Raw]],
    mode: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = recorded(clean)
    parameters = build(FilterParameters, MODES[mode] | {"origin.height": -5.0})
    feed = Feed(parameters)
    for _ in feed_recording(Listed(recording), feed):
        pass
    expected = [*feed.fold.left, feed.fold]

    single: list[str] = []
    give = Feed.give

    def counted(self: Feed, topic: str, message: Any) -> Any:
        single.append(topic)
        return give(self, topic, message)

    monkeypatch.setattr(Feed, "give", counted)
    replayed, _, parts = fold_whole(recording, parameters)

    assert len(parts) == len(expected) == (2 if recorded is faulty else 1)
    for states, part, one in zip(parts, replayed.parts, expected, strict=True):
        assert len(states) == len(one.states)
        for (name, found), (_, value) in zip(fields(states), fields(one.states), strict=True):
            np.testing.assert_array_equal(found, value, err_msg=name)
        assert [u.stamp_ns for u in part.updates] == [u.stamp_ns for u in one.updates]
        for found, told in zip(part.updates, one.updates, strict=True):
            assert found.report.reason == told.report.reason
            np.testing.assert_array_equal(found.report.innovation, told.report.innovation)
            np.testing.assert_array_equal(found.report.S, told.report.S)
    recovered = replayed.fold.counts["recovered"]
    assert replayed.refused.total() == feed.refused.total() - recovered
    assert set(replayed.refused) <= set(feed.refused)
    assert replayed.fold.counts == feed.fold.counts
    assert single.count(IMU) < 0.4 * sum(raw.topic == IMU for raw in recording)
