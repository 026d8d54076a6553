"""Parameters: strict types, ranges, names; YAML sections; the generated files are up to date."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from insdvl.navigation.events import Imu, ProcessNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import (
    ParameterError,
    build,
    changed,
    declarations,
    flatten,
    parameter,
)
from insdvl.parameters.sections import NODES, load_section
from insdvl.simulation.parameters import SimulatorParameters
from insdvl.studies.faults.link import RelayParameters
from insdvl.studies.report import parameter_page
from insdvl.studies.report.parameter_page import SECTIONS
from insdvl.timeline.fold import Fold

ROOT = Path(__file__).parents[3]


@dataclass(frozen=True)
class Inner:
    gain: float = parameter(0.5, "A gain.", unit="1/s", low=0.0, high=1.0)
    triple: tuple[float, ...] = parameter((1.0, 2.0, 3.0), "Three.", above=0.0, length=3)
    same: tuple[float, ...] = parameter(
        (1.0, 1.0), "Two.", above=0.0, length=2, one_for_all=True, changeable=True
    )


@dataclass(frozen=True)
class Group:
    on: bool = parameter(True, "A switch.")
    count: int = parameter(3, "A number.", low=1, high=9)
    mode: str = parameter("fast", "A choice.", choices=("fast", "slow"))
    inner: Inner = field(default_factory=Inner)


def test_what_is_given_replaces_the_default_and_nothing_else() -> None:
    assert build(Group, {}) == Group()
    given = {"on": False, "count": 9, "mode": "slow", "inner.gain": 0.0, "inner.triple": [1.5] * 3}
    assert build(Group, given) == Group(False, 9, "slow", Inner(0.0, (1.5, 1.5, 1.5)))
    assert build(Group, {"inner.gain": 1.0}) == Group(inner=Inner(gain=1.0))


@pytest.mark.parametrize(
    ("limit", "text"),
    [
        (1.0 - 1e-12, ">= 1 and <= 0.999999999999"),
        (0.5 + 1e-9, ">= 0.500000001 and <= 0.5"),
        (2.0 * math.pi, ">= 6.28319 and <= 6.283185"),
        (1e-13, ">= 1e-13 and <= 1e-13"),
        (1e6, ">= 1e+06 and <= 1e+06"),
    ],
)
def test_a_limit_is_not_rounded_to_a_value_that_is_refused(limit: float, text: str) -> None:
    @dataclass(frozen=True)
    class Limited:
        at_least: float = parameter(limit, "A number.", low=limit)
        at_most: float = parameter(limit, "A number.", high=limit)

    least, most = declarations(Limited)
    assert f"{least.range_text} and {most.range_text}" == text
    for declaration in (least, most):
        declaration.check(float(declaration.range_text.split()[-1]))


def test_integers_serve_as_floats_and_one_value_for_all() -> None:
    group = build(Group, {"inner.gain": 1, "inner.triple": [1, 2, 3], "inner.same": 2})
    assert group == Group(inner=Inner(1.0, (1.0, 2.0, 3.0), (2.0, 2.0)))
    values = [group.inner.gain, *group.inner.triple, *group.inner.same]
    assert {type(value) for value in values} == {float}
    assert build(Group, {"inner.same": 0.5}).inner.same == (0.5, 0.5)


def test_all_faults_are_told_at_once() -> None:
    wrong = {"count": 0, "cuont": 1, "on": "x", "inner.gain": 2.0, "mode": "slow"}
    with pytest.raises(ParameterError) as error:
        build(Group, wrong)
    lines = str(error.value).splitlines()
    assert len(lines) == 4
    for line, name in zip(lines, ("'count'", "'cuont'", "'on'", "'inner.gain'"), strict=True):
        assert name in line


def test_contradictions_in_several_groups_are_told_at_once() -> None:
    values = {
        "process_noise.gyroscope_floor": 1e-3,
        "process_noise.gyroscope_ceiling": 1e-4,
        "initial.topic": "a b",
    }
    with pytest.raises(ParameterError, match=r"gyroscope_floor'[^\n]*\n.*'initial.topic'"):
        build(FilterParameters, values)


def test_contradictions_of_one_group_are_told_at_once() -> None:
    values = {"output_delay": 3.0, "imu.max_gap": 0.001, "base_frame": "odom"}
    with pytest.raises(ParameterError) as error:
        build(FilterParameters, values)
    lines = str(error.value).splitlines()
    for line, name in zip(lines, ("'output_delay'", "'imu.max_gap'", "'base_frame'"), strict=True):
        assert name in line


def test_a_running_group_changes_only_where_it_may() -> None:
    assert changed(Group(), {"inner.same": 2}) == Group(inner=Inner(same=(2.0, 2.0)))
    with pytest.raises(ParameterError, match="'on' is read-only\nparameter 'count' is read-only"):
        changed(Group(), {"on": False, "count": 2, "inner.same": 2.0})
    with pytest.raises(ParameterError, match="'inner.same' must be 2 values"):
        changed(Group(), {"inner.same": 0.0})


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("count", 0, "'count' must be >= 1 and <= 9, got 0"),
        ("count", 10, "'count' must be >= 1 and <= 9, got 10"),
        ("count", 3.0, "'count' must be an int, got 3.0"),
        ("count", True, "'count' must be an int, got True"),
        ("on", 1, "'on' must be a bool, got 1"),
        ("on", "true", "'on' must be a bool, got 'true'"),
        ("mode", "quick", "'mode' must be one of fast, slow, got 'quick'"),
        ("mode", 1, "'mode' must be a string, got 1"),
        ("inner.gain", True, "'inner.gain' must be a float, got True"),
        ("inner.gain", 2, "'inner.gain' must be >= 0 and <= 1, got 2"),
        ("inner.gain", 10**400, "'inner.gain' must be >= 0 and <= 1, got 10"),
        ("inner.gain", -0.1, "'inner.gain' must be >= 0 and <= 1, got -0.1"),
        ("inner.gain", math.nan, "'inner.gain' must be .* got nan"),
        ("inner.gain", math.inf, "'inner.gain' must be .* got inf"),
        ("inner.triple", [1.0, 2.0], "'inner.triple' must be 3 values, each > 0, got"),
        ("inner.triple", [1.0, 2.0, 0.0], "'inner.triple' must be 3 values, each > 0, got"),
        ("inner.triple", [1.0, 2, 3.0], "'inner.triple' must be a list of floats, got"),
        ("inner.triple", [True] * 3, "'inner.triple' must be a list of floats, got"),
        ("inner.triple", [1, 2, 0], "'inner.triple' must be 3 values, each > 0, got"),
        ("inner.triple", [], "'inner.triple' must be 3 values, .* empty list, not a list of fl"),
        ("inner.triple", "1.0", "'inner.triple' must be a list of floats, got"),
        ("inner.same", True, "'inner.same' must be a list of floats, got True"),
        ("inner.same", -1.0, "'inner.same' must be 2 values, each > 0, got"),
        (
            "inner.triple",
            1.0,
            r"'inner.triple' must be a list of floats, got 1.0 \(float\): give 3 ",
        ),
        ("inner.gian", 0.5, "unknown parameter 'inner.gian'"),
        ("inner", 0.5, "unknown parameter 'inner'"),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(name: str, value: Any, expected: str) -> None:
    with pytest.raises(ParameterError, match=expected):
        build(Group, {name: value})


CONTRADICTIONS = [
    *(
        (
            FilterParameters,
            {f"{sensor}.time_offset": -2.5},
            f"'{sensor}.time_offset' must be at least imu.time_offset - max_delay",
        )
        for sensor in ("dvl", "depth", "heading")
    ),
    (FilterParameters, {"output_delay": 3.0, "max_delay": 2.0}, "'output_delay' must be at most"),
    (
        FilterParameters,
        {"jump_limit": 1.5, "max_delay": 2.0},
        "'jump_limit' must be at least max_d",
    ),
    (FilterParameters, {"jump_limit": 2.0, "imu.max_gap": 3.0}, "must be at least imu.max_gap"),
    (FilterParameters, {"imu.rate": 10.0}, r"'imu.max_gap' must be longer than .* \(0.1 s\)"),
    (FilterParameters, {"imu.max_gap": 0.01}, "'imu.max_gap' must be longer than the interval"),
    (FilterParameters, {"odom_frame": ""}, "'odom_frame' must not be empty"),
    (FilterParameters, {"base_frame": ""}, "'base_frame' must not be empty"),
    (FilterParameters, {"base_frame": "odom"}, "'base_frame' must differ from odom_frame"),
    (FilterParameters, {"initial.topic": ""}, "'initial.topic' must be a topic"),
    (FilterParameters, {"initial.topic": "a b"}, "'initial.topic' must be a topic"),
    (FilterParameters, {"initial.topic": "imu/data_raw"}, "none of imu/data_raw"),
    (FilterParameters, {"initial.topic": "/odometry/filtered"}, "got '/odometry/filtered'"),
    (FilterParameters, {"initial.topic": "set_odometry"}, "got 'set_odometry'"),
    (
        FilterParameters,
        {"state_file": "state", "state_period": 31.0},
        r"'state_period' must be at most jump_limit \(30 s\) .*, got 31.0",
    ),
    (
        FilterParameters,
        {"process_noise.source": "external", "process_noise.accelerometer_floor": 0.011},
        r"'process_noise.accelerometer_variance' must be within .* \(0.011 to 100\) .* got 0.01",
    ),
    (
        FilterParameters,
        {
            "process_noise.source": "message",
            "process_noise.gyroscope_floor": 1e-4,
            "process_noise.gyroscope_variance": [1e-3, 1e-5, 1e-3],
        },
        r"'process_noise.gyroscope_variance' must be within .* 'message', got 1e-05",
    ),
    (
        FilterParameters,
        {"process_noise.source": "external", "process_noise.gyroscope_ceiling": 1e-4},
        r"'process_noise.gyroscope_variance' must be within .* to 0.0001\) .*, got 0.001",
    ),
    (
        FilterParameters,
        {"process_noise.gyroscope_floor": 1e-3, "process_noise.gyroscope_ceiling": 1e-4},
        "'process_noise.gyroscope_floor' must be at most gyroscope_ceiling",
    ),
    (FilterParameters, {"imu.acceleration_range": 9.8}, "must be 0 or more than gravity"),
    (SimulatorParameters, {"base_frame": "odom"}, "'base_frame' must differ from odom_frame"),
    (SimulatorParameters, {"noise.profile": "file"}, "'noise.file' must name a file if"),
    (SimulatorParameters, {"noise.file": "a.csv"}, "and only then; got 'a.csv'"),
    (SimulatorParameters, {"dvl.outages": [1.0, 2.0, 3.0]}, "'dvl.outages' must be pairs"),
    (SimulatorParameters, {"dvl.outages": [2.0, 1.0]}, "'dvl.outages' must be pairs"),
    (RelayParameters, {"prefix": ""}, "'prefix' must not be empty"),
]


@pytest.mark.parametrize(("group", "values", "expected"), CONTRADICTIONS)
def test_a_contradiction_is_refused(group: Any, values: dict[str, Any], expected: str) -> None:
    with pytest.raises(ParameterError, match=expected):
        build(group, values)


def test_what_only_seems_to_contradict_is_taken() -> None:
    told = {"process_noise.source": "external", "process_noise.accelerometer_floor": 0.01}
    for values in (
        told,
        {"process_noise.accelerometer_floor": 1.0},  # nothing is told, and no floor holds
        {"imu.rate": 5.0, "imu.max_gap": 0.5},
        {"output_delay": 2.0},
        {"initial.topic": "/auv/odometry"},
        {"state_file": "state", "state_period": 30.0},
        {"state_period": 31.0},  # nothing is written
    ):
        build(FilterParameters, values)


@pytest.mark.parametrize("node", SECTIONS)
def test_every_default_is_allowed_and_described(node: str) -> None:
    group = SECTIONS[node]
    assert build(group, flatten(group())) == group()
    for declaration in declarations(group):
        assert declaration.check(declaration.default) == declaration.default
        assert declaration.meaning.endswith((".", ")")), declaration.name


@pytest.mark.parametrize("node", SECTIONS)
def test_every_number_has_a_range(node: str) -> None:
    for declaration in declarations(SECTIONS[node]):
        if "float" in declaration.type_name:
            assert declaration.low is not None or declaration.above is not None, declaration.name
            assert declaration.high is not None, declaration.name


def ends_of_ranges() -> Iterator[tuple[str, Any]]:
    for declaration in declarations(FilterParameters):
        if declaration.type_name in ("int", "float", "list of floats"):
            kind = int if declaration.type_name == "int" else float
            for end in declaration.low, declaration.above, declaration.high:
                if end is not None:
                    value = kind(end)
                    if end == declaration.above:
                        value = end + 1e-6
                    length = declaration.length
                    yield declaration.name, [value] * length if length else value


def test_the_ends_of_every_range_give_a_finite_state() -> None:
    """Each parameter alone at its smallest and its largest value, where nothing contradicts it."""
    tried = 0
    for name, value in ends_of_ranges():
        try:
            fold = Fold(build(FilterParameters, {name: value, "process_noise.source": "external"}))
        except ParameterError:
            continue
        f, w = np.array([0.1, -0.2, -9.8]), np.array([0.01, 0.02, -0.03])
        for k in range(60):
            fold.add(Imu(k * 10_000_000, f + 1e-3 * k, w + 1e-4 * k))
            if k % 20 == 10:
                fold.add(ProcessNoise(k * 10_000_000, 0.01 * np.eye(3), 0.001 * np.eye(3)))
                fold.add(Dvl(k * 10_000_000 + 1, np.array([0.5, 0.1, 0.01 * k])))
        state = fold.states[-1]
        for field_ in state.dtype.names:
            if state.dtype[field_].base.kind == "f":
                assert np.isfinite(state[field_]).all(), (name, value, field_)
        tried += 1
    assert tried > 60


# ---------------------------------------------------------------- generated files


def test_the_generated_files_are_up_to_date() -> None:
    for path, content in parameter_page.files():
        assert (ROOT / path).read_text(encoding="utf-8") == content, path


def test_the_ten_to_set_are_parameters_of_the_filter_with_a_reason() -> None:
    assert len(parameter_page.TO_SET) == 10
    assert parameter_page.TO_SET.keys() <= {d.name for d in declarations(FilterParameters)}
    assert all(why.endswith(".") for why in parameter_page.TO_SET.values())
    headings = [line for line in parameter_page.markdown().splitlines() if line.startswith("## ")]
    assert headings == ["## The ten that you set", *(f"## {node}" for node in SECTIONS)]


def test_every_node_of_ours_has_its_parameters_on_the_page() -> None:
    assert SECTIONS.keys() == set(NODES)


@pytest.mark.parametrize("node", SECTIONS)
def test_an_example_gives_the_defaults(node: str) -> None:
    path = ROOT / parameter_page.EXAMPLES[node]
    assert load_section(path, node, SECTIONS[node], required=True) == SECTIONS[node]()
    given = yaml.safe_load(path.read_text())[f"/**/{node}"]["ros__parameters"]
    names = [d.name for d in declarations(SECTIONS[node]) if d.default != ()]
    found = []
    for name in names:
        values = given
        for part in name.split("."):
            values = values[part]
        found.append(values)
    assert len(found) == len(names)


@pytest.mark.parametrize("value", [1e-05, 1.0, 1e22, 2.5e-13, -0.1, 3, True, "a b", (1e-09, 2.0)])
def test_a_value_keeps_its_type_in_yaml(value: Any) -> None:
    loaded = yaml.safe_load(parameter_page.yaml_value(value))
    assert loaded == (list(value) if isinstance(value, tuple) else value)
    assert type(loaded) is (list if isinstance(value, tuple) else type(value))


def test_the_shipped_configurations_are_valid() -> None:
    for path in sorted((ROOT / "ros_insdvl" / "config").glob("*.yaml")):
        for node, group in SECTIONS.items():
            load_section(path, node, group)
