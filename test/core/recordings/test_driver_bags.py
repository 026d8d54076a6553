"""Recordings of drivers' own types: replayed by the definitions in them, and written again."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import REPLAY, record
from whole import Whole, fold_whole

from insdvl import cli
from insdvl.messages.convert import TWIST
from insdvl.messages.drivers import DVL_MSGS, MARINE_ACOUSTIC, NUCLEUS_BOTTOM, NUCLEUS_WATER, TYPES
from insdvl.messages.topics import DVL
from insdvl.navigation.geometry.frames import ENU, rpy_from_rotation
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import (
    MAX_DEFINITION,
    MAX_ELEMENTS,
    BagError,
    Raw,
    decode,
    new_message,
    stamp_ns,
)
from insdvl.recordings.drivers import DEFINITIONS, Told, dvl_message, dvl_raw
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.trajectories import AUV
from insdvl.studies.replay.fold import fold_recording, read

START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def mission() -> Mission:
    noise = constant(np.repeat([1e-4, 1e-6], 3))
    return simulate(AUV, noise, seed=3, duration=6.0, start_ns=START_NS)


@pytest.fixture(scope="module")
def raws(mission: Mission) -> list[Raw]:
    return record(mission)


def parameters_of(mission: Mission, **values: Any) -> FilterParameters:
    start = mission.initial
    given = {
        "initial.mode": "parameters",
        "initial.rpy": tuple(rpy_from_rotation(ENU.attitude(start.C_n_b[0])).tolist()),
        "initial.velocity": tuple((ENU.body @ start.C_n_b[0].T @ start.v_n[0]).tolist()),
        "origin.height": -5.0,
    }
    return build(
        FilterParameters,
        given | {name.replace("__", "."): value for name, value in values.items()},
    )


def as_driver(raws: list[Raw], kind: str, told: Told = Told()) -> list[Raw]:  # noqa: B008
    """The recording as it would be with another driver."""

    def changed(raw: Raw) -> Raw:
        if raw.topic != "/dvl":
            return raw
        v = decode(raw).message.twist.linear
        message = dvl_message(kind, stamp_ns(raw), ENU.body @ [v.x, v.y, v.z], told)
        return dvl_raw(raw.topic, raw.time_ns, message)

    return [changed(raw) for raw in raws]


def save(path: Path, raws: list[Raw], storage: str = "mcap") -> Path:
    with BagWriter(path, storage) as bag:
        for raw in raws:
            bag.write(raw)
    return path


@pytest.fixture(scope="module")
def plain(mission: Mission, raws: list[Raw], tmp_path_factory: pytest.TempPathFactory) -> Whole:
    """The recording of a TwistStamped."""
    path = save(tmp_path_factory.mktemp("plain") / "bag", raws)
    return fold_whole(read(path, REPLAY), parameters_of(mission))


@pytest.mark.parametrize(
    ("kind", "storage"),
    [(kind, ("mcap", "sqlite3")[k % 2]) for k, kind in enumerate(TYPES)],
)
def test_a_bag_of_each_type_is_replayed(
    tmp_path: Path, mission: Mission, raws: list[Raw], plain: Whole, kind: str, storage: str
) -> None:
    """To the state of the same velocities as a TwistStamped, without the driver's package."""
    path = save(tmp_path / "bag", as_driver(raws, kind), storage)
    with BagReader(path) as bag:
        assert bag.topics["/dvl"].type == kind
    replayed, found, _ = fold_whole(read(path, REPLAY), parameters_of(mission))
    if kind == NUCLEUS_WATER:
        assert {(r.topic, r.reason): n for r, n in replayed.refused.items()} == {
            (DVL, "through_water"): len(mission.dvl_stamps_ns)
        }
        return
    assert not replayed.refused
    states, expected = found["nav"], plain.states["nav"]
    if kind == NUCLEUS_BOTTOM:  # in single precision
        np.testing.assert_allclose(states["v_n"], expected["v_n"], atol=1e-6)
    else:
        np.testing.assert_array_equal(states["v_n"], expected["v_n"])
        np.testing.assert_array_equal(states["P"], expected["P"])
    assert len(replayed.updates) == len(plain.replayed.updates) == len(mission.dvl_stamps_ns)


CONFIG = """
/**/insdvl_filter:
  ros__parameters:
    dvl.type: {kind}
    initial.mode: levelling
    initial.velocity_std: 1.5
    initial.heading_std: 1.5
    origin.height: -5.0
/**/insdvl_replay:
  ros__parameters:
    imu_topic: {prefix}/imu{raw}
    dvl_topic: {prefix}/dvl{velocity}
"""


def replay(folder: Path, bag: Path, *options: str, kind: str, again: bool = False) -> Any:
    config = folder / "config.yaml"
    names = {"raw": "/data_raw", "velocity": "/velocity"} if again else {"raw": "", "velocity": ""}
    config.write_text(CONFIG.format(kind=kind, prefix="", **names))
    out = folder / "out.json"
    arguments = ["replay", str(bag), "--config", str(config), "--json", str(out), *options]
    assert cli.main(arguments) == 0
    return json.loads(out.read_text())


def test_the_output_of_a_replay_is_a_bag_of_that_type(tmp_path: Path, raws: list[Raw]) -> None:
    told = Told(sigma=0.1, latency_ns=190_000_000)
    bag = save(tmp_path / "bag", as_driver(raws, DVL_MSGS, told))
    first = replay(tmp_path, bag, "--out", str(tmp_path / "out"), kind="auto")
    with BagReader(tmp_path / "out") as out:
        assert out.topics["/dvl/velocity"].type == DVL_MSGS
        recorded = list(out.messages(["/dvl/velocity"]))
        innovations = list(out.messages(["/dvl/innovation"]))
    assert recorded[0].message.time_of_validity > 0
    assert innovations[0].message.header.frame_id == "dvl_link"
    second = replay(tmp_path, tmp_path / "out", kind=DVL_MSGS, again=True)
    for name in ("nis_mean", "dvl_accepted", "dvl_rejected"):
        assert first[name] == second[name]
    assert first["dvl_accepted"] > 0


def test_a_bag_of_a_type_without_a_header_is_written_too(tmp_path: Path, raws: list[Raw]) -> None:
    bag = save(tmp_path / "bag", as_driver(raws, NUCLEUS_BOTTOM))
    assert replay(tmp_path, bag, "--out", str(tmp_path / "out"), kind="auto")["dvl_accepted"] > 0
    with BagReader(tmp_path / "out") as out:
        assert out.topics["/dvl/velocity"].type == NUCLEUS_BOTTOM


def test_another_type_than_the_configured_one_is_named(
    tmp_path: Path, raws: list[Raw], mission: Mission
) -> None:
    path = save(tmp_path / "bag", as_driver(raws, DVL_MSGS))
    parameters = parameters_of(mission, dvl__type=MARINE_ACOUSTIC)
    with pytest.raises(BagError, match=f"/dvl .* has type {DVL_MSGS}, expected {MARINE_ACOUSTIC}"):
        read(path, REPLAY, parameters)


def test_two_types_on_one_topic_are_named(tmp_path: Path, raws: list[Raw]) -> None:
    other = as_driver(raws, DVL_MSGS)
    with BagWriter(tmp_path / "bag") as bag:
        bag.write(next(raw for raw in raws if raw.topic == "/dvl"))
        with pytest.raises(BagError, match=f"/dvl has type {TWIST}, cannot take {DVL_MSGS}"):
            bag.write(next(raw for raw in other if raw.topic == "/dvl"))


def test_a_recording_without_definitions_is_refused_with_what_to_do(
    tmp_path: Path, raws: list[Raw], mission: Mission
) -> None:
    path = save(tmp_path / "bag", as_driver(raws, DVL_MSGS), "sqlite3")
    (database,) = path.glob("*.db3")
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("DELETE FROM message_definitions")
    recording = read(path, REPLAY)
    with pytest.raises(BagError, match=f"topic {DVL}: {DVL_MSGS} is not a standard .* MCAP"):
        fold_recording(recording, parameters_of(mission))


DEFINITION = DEFINITIONS[DVL_MSGS]


@pytest.mark.parametrize(
    ("definition", "said"),
    [
        ("float64 x\n" * MAX_DEFINITION, "has .* characters, at most"),
        (DEFINITION + f"float64[{MAX_ELEMENTS + 1}] x\n", "arrays of .* elements, at most"),
        ("this is none", "cannot read the definition"),
        ("float64 \x00\n", "cannot read the definition"),
        ("other_msgs/Unknown x\n", "cannot read the definition"),
        (f"std_msgs/Header header\n{'=' * 80}\nMSG: std_msgs/Header\nint32 x\n", "different"),
        ("dvl_msgs/DVL again\n", "cannot read the definition|DVL"),
    ],
)
def test_a_definition_that_is_not_one_is_refused(definition: str, said: str) -> None:
    with pytest.raises(BagError, match=said):
        decode(Raw("/dvl", DVL_MSGS, 0, b"\x00\x01\x00\x00" + bytes(64), definition))


def test_bytes_of_another_version_of_a_type_are_damaged_ones() -> None:
    raw = dvl_raw("/dvl", 0, dvl_message(DVL_MSGS, START_NS, np.ones(3)))
    lines = [line for line in DEFINITION.splitlines() if line != "float64 altitude"]
    with pytest.raises(BagError, match="damaged message on topic /dvl"):
        decode(raw._replace(definition="\n".join(lines) + "\n"))


def test_each_definition_has_a_store_of_its_own() -> None:
    """Two recordings may hold two versions of one type."""
    old = DEFINITION.replace("float64 altitude\n", "")
    assert hasattr(new_message(DVL_MSGS, definition=DEFINITION), "altitude")
    assert not hasattr(new_message(DVL_MSGS, definition=old), "altitude")
    assert hasattr(new_message(DVL_MSGS, definition=DEFINITION), "altitude")
