"""Parameter files: which values are for a node, what is refused, and what is warned of."""

from pathlib import Path
from typing import Any

import pytest

from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError
from insdvl.parameters.files import argument, effective, matches, read
from insdvl.parameters.sections import full_name, load, load_section, warnings
from insdvl.recordings.parameters import ReplayParameters
from insdvl.tuner.parameters import TunerParameters

FILTER = "insdvl_filter"


def write(folder: Path, *texts: str) -> list[Path]:
    paths = [folder / f"parameters_{k}.yaml" for k in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    return paths


def test_a_section_gives_its_node_its_values(tmp_path: Path) -> None:
    (path,) = write(
        tmp_path,
        """
/**:
  ros__parameters:
    imu: {rate: 200.0}
    use_sim_time: true
/**/insdvl_filter:
  ros__parameters:
    qos_overrides: {/imu/data_raw: {subscription: {reliability: reliable}}}
    max_delay: 3
    dvl: {lever_arm: [1, 0, -2]}
    gate.enabled: off
    process_noise.accelerometer_bias_walk: 1e-9
/auv/insdvl_replay:
  ros__parameters: {bag: here}
/**/other_node:
  ros__parameters: {anything: 1}
/**/insdvl_filter_2:
  ros__parameters: {max_delay: 4.0}
/**/insdvl_monitor:
  ros__parameters: {use_sim_time: true}
""",
    )
    filter_ = load_section(path, FILTER, FilterParameters, required=True)
    assert filter_.imu.rate == 200.0
    assert filter_.max_delay == 3.0
    assert filter_.dvl.lever_arm == (1.0, 0.0, -2.0)
    assert not filter_.gate.enabled
    assert filter_.process_noise.accelerometer_bias_walk == 1e-9
    assert load_section(path, "insdvl_replay", ReplayParameters) == ReplayParameters(bag="here")
    assert load_section(path, "insdvl_tuner", TunerParameters) == TunerParameters()


@pytest.mark.parametrize(
    ("section", "node", "expected"),
    [
        ("/**", "/a", True),
        ("/**", "/a/b/c", True),
        ("/*", "/a", True),
        ("/*", "/a/b", False),
        ("/**/c", "/c", True),
        ("/**/c", "/a/b/c", True),
        ("/*/c", "/c", False),
        ("/*/c", "/b/c", True),
        ("/*/c", "/a/b/c", False),
        ("/a/**", "/a/b/c", True),
        ("/a/**", "/ab/c", False),
        ("/a/*", "/a/c", True),
        ("a/c", "/a/c", True),
        ("c", "/c", True),
        ("c", "/a/c", False),
        ("/c", "/cc", False),
    ],
)
def test_wildcards(section: str, node: str, expected: bool) -> None:
    assert matches(section, node) is expected


OWN, ALL = "/**/insdvl_filter: {ros__parameters: ", "/**: {ros__parameters: "


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        ([ALL + "{max_delay: 1.0}}", OWN + "{max_delay: 2.0}}"], 2.0),
        ([OWN + "{max_delay: 2.0}}", ALL + "{max_delay: 1.0}}"], 1.0),
        # Not the order of the values: that in which the names of the sections appear first.
        ([ALL + "{max_delay: 1.0}}\n" + OWN + "{max_delay: 2.0}}", ALL + "{max_delay: 3.0}}"], 2.0),
        ([OWN + "{max_delay: 2.0}}", OWN + "{max_delay: 3.0}}"], 3.0),
    ],
)
def test_a_later_section_replaces_an_earlier_one(
    tmp_path: Path, texts: list[str], expected: float
) -> None:
    paths = write(tmp_path, *texts)
    assert load_section(paths, FILTER, FilterParameters).max_delay == expected


def test_the_namespace_is_that_of_the_sections(tmp_path: Path) -> None:
    text = "/auv: {insdvl_filter: {ros__parameters: {max_delay: 3.0}}}"
    (path,) = write(tmp_path, text)
    assert load_section(path, FILTER, FilterParameters).max_delay == 3.0
    assert load_section(path, "/insdvl_filter", FilterParameters).max_delay == 2.0
    files = read(write(tmp_path, text, "/b/insdvl_filter: {ros__parameters: {}}"))
    with pytest.raises(ParameterError, match="/auv/insdvl_filter, /b/insdvl_filter; choose"):
        full_name(files, FILTER)
    files += read(write(tmp_path, "insdvl_filter: {ros__parameters: {}}"))
    assert full_name(files, FILTER) == "/insdvl_filter"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[1, 2", "cannot read the parameter file"),
        ("- 1", "Cannot have a value before ros__parameters at line 1"),
        ("/**/insdvl_filter: 5", "Cannot have a value before ros__parameters at line 1"),
        ("/**/insdvl_filter:\n  ros__parameters:\n", "Cannot have a value before"),
        ("ros__parameters: {a: 1}", "There are no node names before ros__parameters at line 1"),
        ("//insdvl_filter: {ros__parameters: {a: 1}}", "'' is not a name"),
        ("/**x: {ros__parameters: {a: 1}}", r"'\*\*x' is not a name"),
        ("/a: {ros__parameters: {a: 1}, ros__parameters: {b: 1}}", "line 1 is not the only one"),
        ("/other: {ros__parameters: {a: }}", "No value at line 1"),
        ("/other: {ros__parameters: {'': 1}}", "No key at line 1"),
        ("/other: {ros__parameters: {a: {}, b: 1}}", "'a' in line 1 is empty"),
        ("/other: {ros__parameters: {a: [[1.0]]}}", "'a' in line 1 has lists"),
        (
            "/other:\n  ros__parameters:\n    a: [1, 2.5]\n",
            "Sequence should be of same type. Value type 'double' do not belong at line_num 3",
        ),
        ("/a/insdvl_filter: {ros__parameters: {max_dealy: 1.0}}", "unknown parameter 'max_dealy'"),
        ("/a/insdvl_filter: {ros__parameters: {dvl: {bias: 1.0}}}", "unknown .* 'dvl.bias'"),
        (OWN + "{max_delay: 3_600.0}}", "'max_delay' must be a float, got '3_600.0'"),
        (OWN + "{max_delay: ~}}", "'max_delay' must be a float, got '~'"),
        (OWN + "{max_delay: 1.0, max_delay: 2.0}}", "'max_delay' is given again, first in line 1"),
        (ALL + "{max_delay: fast}}", r"line 1, section '/\*\*': parameter 'max_delay' must be"),
    ],
)
def test_a_wrong_file_is_named_with_what_is_wrong(tmp_path: Path, text: str, expected: str) -> None:
    (path,) = write(tmp_path, text)
    with pytest.raises(ParameterError, match=expected) as error:
        load_section(path, FILTER, FilterParameters)
    assert "parameters_0.yaml" in str(error.value)
    assert "\n" not in str(error.value)


def test_all_faults_of_all_files_are_told_at_once(tmp_path: Path) -> None:
    paths = write(
        tmp_path,
        "/a: {ros__parameters: {x: [1, 2.5], y: [true, a], z: }}",
        "[1, 2",
        "/b-1: {ros__parameters: {x: 1}}",
    )
    with pytest.raises(ParameterError) as error:
        read([*paths, tmp_path / "absent.yaml"])
    lines = str(error.value).splitlines()
    assert len(lines) == 6
    for line, name in zip(lines, "000123", strict=False):
        assert (f"parameters_{name}" if name != "3" else "absent") in line


def test_all_faults_of_a_nodes_values_are_told_at_once(tmp_path: Path) -> None:
    paths = write(
        tmp_path,
        ALL + "{imu: {rate: 0.0}, foreign: 1}}",
        OWN + "{max_dealy: 1.0, gate.enabled: 3,\n odom_frame: a, odom_frame: b}}",
    )
    with pytest.raises(ParameterError) as error:
        load_section(paths, FILTER, FilterParameters)
    lines = str(error.value).splitlines()
    names = ("'odom_frame' is given again", "'imu.rate'", "'max_dealy'", "'gate.enabled'")
    for line, name in zip(lines, names, strict=True):
        assert name in line


@pytest.mark.parametrize("section", ["/**", "/*", "/auv/*", "/auv/**"])
def test_what_a_shared_section_has_for_others_is_ignored_and_told(
    tmp_path: Path, section: str
) -> None:
    namespace = "/auv" if "auv" in section else ""
    text = f"{section}: {{ros__parameters: {{foreign: {{a: 1, b: x}}, max_delay: 3.0}}}}"
    files = read(write(tmp_path, text))
    name = f"{namespace}/insdvl_filter"
    found = load(files, name, FilterParameters)
    assert found.parameters.max_delay == 3.0
    (told,) = warnings(files, [name], found.ignored)
    assert f"are ignored in section '{section}': foreign.a, foreign.b" in told


def test_an_unknown_name_in_a_section_of_the_node_is_an_error_wherever_else_it_stands(
    tmp_path: Path,
) -> None:
    for texts in ([OWN, ALL], [ALL, OWN]):
        paths = write(tmp_path, *(text + "{foreign: 1}}" for text in texts))
        with pytest.raises(ParameterError, match="unknown parameter 'foreign'"):
            load_section(paths, FILTER, FilterParameters)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "/**/insdvl_filtr: {ros__parameters: {max_delay: 3.0}}",
            r"none of the file's values reached this node, /insdvl_filter: its sections are "
            r"/\*\*/insdvl_filtr, expected /\*\*/insdvl_filter; is insdvl_filtr misspelt",
        ),
        ("/nav: {ros__parameters: {max_delay: 3.0}}", "reached this node"),
        ("/a/insdvl_filter: {ros__parameters: {max_delay: 3.0}}", "or in another namespace"),
        ("", "its sections are none"),
    ],
)
def test_a_file_that_has_nothing_for_the_node_is_told(
    tmp_path: Path, text: str, expected: str
) -> None:
    files = read(write(tmp_path, text, OWN + "{max_delay: 4.0}}"))
    found = load(files, "/insdvl_filter", FilterParameters)
    assert found.parameters.max_delay == 4.0
    (told,) = warnings(files, ["/insdvl_filter"], found.ignored)
    with pytest.raises(ParameterError, match=expected):
        raise ParameterError(told)
    with pytest.raises(ParameterError, match=expected):
        load_section(files[0].path, "/insdvl_filter", FilterParameters, required=True)


@pytest.mark.parametrize(
    ("rule", "section", "name", "value"),
    [
        ("imu.rate:=200", "/**", "imu.rate", 200),
        ("insdvl_filter:max_delay:=1e-1", "insdvl_filter", "max_delay", 0.1),
        ("topic:=/a:b", "/**", "topic", "/a:b"),
        ("dvl.mount:=[1, 2, 3]", "/**", "dvl.mount", [1, 2, 3]),
        ("dvl.mount:=[]", "/**", "dvl.mount", []),
    ],
)
def test_an_argument_is_a_file_of_one_value(rule: str, section: str, name: str, value: Any) -> None:
    (given,) = argument(rule).given
    assert (given.section, given.name, given.value) == (section, name, value)
    assert given.is_argument
    assert given.is_for_all is (section == "/**")


@pytest.mark.parametrize("rule", ["imu.rate", ":=1", "a:=", "a:=[1, 2.5]", "a:={b: 1}"])
def test_an_argument_that_is_none_is_named(rule: str) -> None:
    with pytest.raises(ParameterError, match="-p"):
        argument(rule)


def test_an_argument_for_all_may_be_for_another_node_of_the_process() -> None:
    """Such as the tuner's rate, where filter and tuner share a process."""
    general = argument("rate:=2.0")
    with pytest.raises(ParameterError, match="unknown parameter 'rate'"):
        load([general], "/insdvl_filter", FilterParameters)
    found = load([general], "/insdvl_filter", FilterParameters, others=("rate",))
    assert (found.parameters, found.ignored) == (FilterParameters(), ())
    assert load([general], "/insdvl_tuner", TunerParameters).parameters.rate == 2.0
    own = argument("insdvl_filter:rate:=2.0")
    with pytest.raises(ParameterError, match="unknown parameter 'rate'"):
        load([own], "/insdvl_filter", FilterParameters, others=("rate",))


def test_an_argument_loses_against_a_section_that_appears_after_its_own(tmp_path: Path) -> None:
    """As in rcl: -p belongs to section '/**'."""
    files = read(write(tmp_path, ALL + "{max_delay: 1.0}}\n" + OWN + "{max_delay: 3.0}}"))
    general, own = argument("max_delay:=5.0"), argument("insdvl_filter:max_delay:=5.0")
    assert effective([*files, general], "/insdvl_filter")["max_delay"].value == 3.0
    assert effective([*files, own], "/insdvl_filter")["max_delay"].value == 5.0
    assert effective([*files[:0], general], "/insdvl_filter")["max_delay"].value == 5.0


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"absent\.yaml: No such file"):
        load_section(tmp_path / "absent.yaml", FILTER, FilterParameters)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParameterError, match=r"binary\.yaml"):
        load_section(tmp_path / "binary.yaml", FILTER, FilterParameters)


def test_a_file_of_other_nodes_of_the_vehicle_is_no_mistake(tmp_path: Path) -> None:
    """One file is given to all nodes; a renamed node has no section by its old name."""
    files = read(write(tmp_path, "/**/insdvl_tuner: {ros__parameters: {rate: 2.0}}"))
    assert warnings(files, ["/auv/insdvl_filter"], []) == []
    (told,) = warnings(files, ["/auv/learner"], [])
    assert "none of the file's values reached this node, /auv/learner" in told
    files = read(write(tmp_path, "/port/insdvl_filter: {ros__parameters: {max_delay: 3.0}}"))
    (told,) = warnings(files, ["/starboard/insdvl_filter"], [])
    assert "or in another namespace" in told
