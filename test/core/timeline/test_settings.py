"""Settings that change while the filter runs: the state still depends on stamps alone."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from records import fields
from told import TOLD

from insdvl.navigation.events import NS, Event, Imu
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.settings import SETTINGS, Settings, differences
from insdvl.navigation.state.groups import GATE_COUNTERS
from insdvl.parameters.declaration import ParameterError, build, changed, flatten
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import trajectory_named
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.timeline.state_file import (
    StateFile,
    StateFileError,
    decode,
    decode_settings,
    encode,
)

MAX_DELAY = 0.5
PARAMETERS = build(FilterParameters, TOLD | {"max_delay": MAX_DELAY, "gate.probability": 0.99})
CHANGES: list[tuple[float, dict[str, Any]]] = [
    (2.0, {"dvl.noise_std": 0.02}),
    (4.004, {"gate.enabled": False, "dvl.noise_floor": 0.5}),
    (6.5, {"dvl.noise_std": [0.3, 0.2, 0.1], "gate.enabled": True, "gate.probability": 0.9}),
    (8.0, {"dvl.max_speed": 0.5}),
]


def fast_first(cases: Iterable[Any], fast: int = 1) -> list[Any]:
    """Cases of which only the first run with the fast tests."""
    return [
        case if k < fast else pytest.param(case, marks=pytest.mark.long)
        for k, case in enumerate(cases)
    ]


def mission() -> tuple[list[Event], int]:
    """Samples and pings in the order of stamps, and the first stamp."""
    m = simulate(trajectory_named("auv"), SCENARIOS["varying"], seed=3, duration=10.0)
    events: list[Event] = [
        Imu(*row) for row in zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True)
    ]
    for stamp_ns, v_d in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True):
        events += [Dvl(stamp_ns, v_d), Dvl(stamp_ns - 503_000_000, v_d + np.array([0.3, 0.0, 0.0]))]
    return sorted(events, key=lambda e: (e.stamp_ns, e.kind)), int(m.stamps_ns[0])


EVENTS, START = mission()
FILTER = Filter(PARAMETERS)


def settings() -> list[Settings]:
    parameters, events = PARAMETERS, []
    for number, (seconds, values) in enumerate(CHANGES, 1):
        parameters = changed(parameters, values)
        events.append(Settings(START + round(seconds * NS), parameters, number))
    return events


def offline(events: Sequence[Event]) -> FoldResult:
    samples = [e for e in events if isinstance(e, Imu)]
    return fold_arrays(
        PARAMETERS,
        np.array([e.stamp_ns for e in samples]),
        np.array([e.f_b for e in samples]),
        np.array([e.w_ib_b for e in samples]),
        [e for e in events if not isinstance(e, Imu)],
    )


def same(fold: Fold, result: FoldResult) -> bool:
    states = fold.states
    return states.tobytes() == result.states[-len(states) :].tobytes()


@pytest.fixture(scope="module")
def expected() -> FoldResult:
    return offline([*EVENTS, *settings()])


@pytest.mark.parametrize("k", fast_first(range(len(CHANGES))))
def test_each_change_changes_the_state_from_its_stamp_on(expected: FoldResult, k: int) -> None:
    event, without = settings()[k], offline([*EVENTS, *settings()[:k]]).states
    equal = [a.tobytes() == b.tobytes() for a, b in zip(without, expected.states, strict=True)]
    first = expected.states["channels"]["imu_ns"][equal.index(False)]
    assert event.stamp_ns <= first <= event.stamp_ns + 1.1 * NS


@pytest.mark.parametrize("seed", fast_first(range(5)))
def test_any_order_of_arrival_gives_the_same_bits(expected: FoldResult, seed: int) -> None:
    rng = np.random.default_rng(seed)
    events = [*EVENTS, *settings()]
    late = rng.uniform(0.0, MAX_DELAY - 0.02, len(events)) * NS
    fold = Fold(PARAMETERS, capacity=256)  # which drops what is old
    for k in np.argsort([e.stamp_ns + d for e, d in zip(events, late, strict=True)]):
        fold.add(events[k])
        if k % 7 == 0:
            fold.take()
    assert same(fold, expected)
    assert fold.settings == settings()[-1].parameters == fold.filter.parameters


def test_a_change_online_is_a_change_at_the_newest_stamp() -> None:
    """Pings that come late are older than the change, and are used with what was in force then."""
    fold, changes, waiting = Fold(PARAMETERS, capacity=256), settings(), []
    made: list[Settings] = []
    for event in EVENTS:
        if isinstance(event, Dvl):
            waiting.append(event)
            continue
        fold.add(event)
        if changes and event.stamp_ns >= changes[0].stamp_ns:
            change = changes.pop(0)
            stamp_ns = fold.change(change.parameters)
            assert stamp_ns == fold.newest_ns == event.stamp_ns
            made.append(replace(change, stamp_ns=stamp_ns))
        while waiting and event.stamp_ns - waiting[0].stamp_ns > 0.3 * NS:
            assert fold.add(waiting.pop(0)) is None
            fold.take()
    assert len(made) == len(CHANGES)
    assert same(fold, offline([*(e for e in EVENTS if e not in waiting), *made]))


def test_of_two_changes_at_one_stamp_the_last_one_counts() -> None:
    for values in ({"dvl.noise_std": 0.02}, {"dvl.noise_std": 0.5}):
        fold = Fold(PARAMETERS)
        for event in EVENTS:
            fold.add(event)
            if isinstance(event, Imu) and event.stamp_ns == START + 3 * NS:
                fold.change(changed(PARAMETERS, {"dvl.noise_std": 0.1, "dvl.max_speed": 9.0}))
                fold.change(changed(PARAMETERS, values))
        last = Settings(START + 3 * NS, changed(PARAMETERS, values))
        assert same(fold, offline([*EVENTS, last]))


def test_before_the_first_sample_a_change_is_in_force_from_the_start() -> None:
    fold, after = Fold(PARAMETERS), changed(PARAMETERS, {"dvl.noise_std": 0.02})
    assert fold.change(after) is None
    other = Fold(after)
    for event in EVENTS[:400]:
        fold.add(event)
        other.add(event)
    assert fold.states.tobytes() == other.states.tobytes()


def test_settings_outlast_a_reset_and_a_time_jump() -> None:
    fold, after = Fold(PARAMETERS), changed(PARAMETERS, {"gate.enabled": False})
    samples = [e for e in EVENTS if isinstance(e, Imu)]
    for event in samples[:50]:
        fold.add(event)
    fold.change(after)
    fold.reset()
    assert fold.settings is after
    for event in samples[:50]:
        fold.add(event)
    for event in samples[:50]:
        fold.add(replace(event, stamp_ns=event.stamp_ns + 100 * NS))
    assert fold.counts["time_jumps"] == 1
    assert fold.settings is after
    assert len(fold.states)
    assert fold.filter.parameters is after


# ---------------------------------------------------------------- the state file


def killed(values: dict[str, Any]) -> tuple[list[Event], bytes]:
    """A filter whose settings were changed is killed: the events to come, and its file."""
    fold = Fold(PARAMETERS)
    half = next(k for k, e in enumerate(EVENTS) if e.stamp_ns > START + 4.3 * NS)
    for event in EVENTS[:half]:
        fold.add(event)
        if isinstance(event, Imu) and event.stamp_ns == START + 3 * NS:
            fold.change(changed(PARAMETERS, values))
    assert fold.latest is not None
    return EVENTS[half:], encode(fold.latest, PARAMETERS, fold.filter.parameters)


def test_after_a_restart_the_settings_are_in_force_to_the_bit() -> None:
    values = {"dvl.noise_std": 0.02, "gate.probability": 0.9}
    coming, data = killed(values)
    fold = Fold(PARAMETERS)
    fold.resume(decode(data, fold.filter), decode_settings(data, PARAMETERS))
    for event in coming:
        fold.add(event)
    whole = offline([*EVENTS, Settings(START + 3 * NS, changed(PARAMETERS, values))])
    a, b = whole.states[-1], fold.states[-1]
    for (name, of_a), (_, of_b) in zip(fields(a), fields(b), strict=True):
        if not name.startswith("counters.") and name.rpartition(".")[2] not in GATE_COUNTERS:
            assert of_a.tobytes() == of_b.tobytes(), name


def test_a_setting_that_is_started_with_another_value_is_not_taken_over() -> None:
    _, data = killed({"dvl.noise_std": 0.02, "gate.probability": 0.9})
    now = changed(PARAMETERS, {"gate.probability": 0.95})
    found = decode_settings(data, now)
    assert found.dvl.noise_std == (0.02,) * 3
    assert found.gate.probability == 0.95


@pytest.mark.parametrize(
    "wrong",
    [
        5,
        [1],
        {"dvl.noise_std": 5},
        {"dvl.noise_std": [[0.1] * 3, [-1.0] * 3]},
        {"imu.rate": [100.0, 50.0]},
    ],
)
def test_damaged_settings_are_refused(wrong: Any) -> None:
    assert PARAMETERS.dvl.noise_std == (0.1,) * 3
    _, data = killed({})
    line, _, body = data.partition(b"\n")
    header = json.loads(line) | {"settings": wrong}
    with pytest.raises(StateFileError, match="settings are"):
        decode_settings(json.dumps(header).encode() + b"\n" + body, PARAMETERS)


def test_settings_are_in_the_checksum() -> None:
    _, data = killed({"dvl.noise_std": 0.02})
    for at in range(data.index(b'"settings"'), data.index(b"\n")):
        damaged = bytearray(data)
        damaged[at] ^= 1
        with pytest.raises(StateFileError, match="damaged"):
            decode(bytes(damaged), FILTER)


def test_a_file_without_changes_leaves_the_settings(tmp_path: Path) -> None:
    _, data = killed({})
    assert b"settings" not in data.partition(b"\n")[0]
    (tmp_path / "state").write_bytes(data)
    file = StateFile(tmp_path / "state", FILTER)
    assert file.load() is not None
    assert file.settings == PARAMETERS


def test_the_settings_of_a_state_of_another_time_are_not_used() -> None:
    _, data = killed({"dvl.noise_std": 0.02})
    fold = Fold(PARAMETERS)
    fold.resume(decode(data, fold.filter), decode_settings(data, PARAMETERS))
    fresh = Fold(PARAMETERS)
    for event in EVENTS[:300]:
        for one in fold, fresh:
            one.add(replace(event, stamp_ns=event.stamp_ns + 1000 * NS))
    assert fold.settings == PARAMETERS
    assert fold.states.tobytes() == fresh.states.tobytes()


# ---------------------------------------------------------------- which they are


def test_only_what_model_and_gate_use_may_change() -> None:
    assert {name.partition(".")[0] for name in SETTINGS} <= {"gate", *PARAMETERS.sensors}
    assert {"dvl.noise_std", "depth.noise_std", "gate.enabled", "gate.probability"} <= set(SETTINGS)


@pytest.mark.parametrize(
    "name", fast_first(dict.fromkeys(["dvl.noise_std", "gate.enabled", *SETTINGS]), 2)
)
def test_a_filter_with_a_changed_setting_is_a_filter_that_was_started_with_it(name: str) -> None:
    """No part keeps the old value; the rows of the kernels' constants are those of the start."""
    other = {
        "float": 0.75,
        "list of floats": [0.3, 0.4, 0.5],
        "int": 7,
        "bool": not SETTINGS[name].default,
        "string": SETTINGS[name].choices[-1] if SETTINGS[name].choices else "",
    }[SETTINGS[name].type_name]
    depth = {"depth.topic": "pressure"}
    before = changed(build(FilterParameters, flatten(PARAMETERS) | depth), {})
    after = changed(before, {name: other})
    assert differences(before, after).keys() == {name}
    fold, fresh = Fold(before), Fold(after)
    fold.change(after)
    for event in EVENTS[:400]:
        fold.add(event)
        fresh.add(event)
    assert fold.states.tobytes() == fresh.states.tobytes()
    assert fold.filter.constants.tobytes() == fresh.filter.constants.tobytes()


def test_what_may_not_change_is_named() -> None:
    with pytest.raises(
        ParameterError, match=r"'imu.rate' is read-only\n.*'dvl.mount' is read-only"
    ):
        changed(PARAMETERS, {"imu.rate": 50.0, "dvl.mount": [0.0] * 3})
    with pytest.raises(ParameterError, match=r"'gate.probability' must be > 0.5 .*, got 0.2"):
        changed(PARAMETERS, {"gate.probability": 0.2})
