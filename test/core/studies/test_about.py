"""What the software says of itself."""

import json
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from insdvl import cli, kernels
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import declarations
from insdvl.studies.about import doctor
from insdvl.studies.report.parameter_page import SECTIONS
from insdvl.tuner.models import shipped_cards

PINS = """\
numpy==2.2.6; python_version < "3.11"
numpy==2.4.6; python_version >= "3.11"
ros-rclpy==7.1.6
# scipy==1.0
"""


def output(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    assert cli.main(list(words)) == code
    return capsys.readouterr().out


def test_every_shipped_model_has_its_row(capsys: pytest.CaptureFixture[str]) -> None:
    cards = {card["name"]: card for card in shipped_cards()}
    assert cards.keys() == {"bands", "default", "paper", "dnn", "dnn-default"}
    rows = {line.split()[0]: line for line in output(capsys, "models").splitlines() if line}
    for name, card in cards.items():
        if name == "bands":
            error = f"{card['metrics']['test_rms_log_q']['learned']['all']:.2f} in log"
        else:
            error = f"{card['metrics']['trajectory_split']['relative_rmse']:.1%}"
        assert error in rows[name]
        assert (rows[name].endswith("onnx")) == (card["kind"] == "network")
    for words in (["--json"], ["--json", "-"]):
        assert json.loads(output(capsys, "models", *words)) == cards


def test_a_parameter_is_found_by_its_name_and_by_its_meaning(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = output(capsys, "params", "max_speed", "--node", "insdvl_filter")
    assert text.splitlines()[:2] == ["insdvl_filter:", "  dvl.max_speed: 10.0 m/s"]
    assert "> 0 and <= 1000" in text
    assert "dvl.max_speed" in output(capsys, "params", "too_fast")  # a word of its meaning
    assert "dvl.max_speed" in output(capsys, "params", "TOO_FAST")


def test_without_a_word_all_parameters_are_told_in_80_columns(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = output(capsys, "params")
    names = [d.name for group in SECTIONS.values() for d in declarations(group)]
    assert [name for name in names if f"  {name}: " not in text] == []
    assert len(re.findall(r"^  \S+: ", text, re.MULTILINE)) == len(names)


def test_a_word_that_no_parameter_has_is_told_with_the_nearest(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["params", "dvl.levr_arm"]) == 1
    assert "did you mean dvl.lever_arm?" in capsys.readouterr().err
    assert cli.main(["params", "--node", "insdvl_filtr"]) == 2
    assert "did you mean insdvl_filter?" in capsys.readouterr().err
    assert any(d.name == "dvl.lever_arm" for d in declarations(FilterParameters))


def test_parameters_are_told_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    told = json.loads(output(capsys, "params", "--json", "-"))
    assert {node: set(of_node) for node, of_node in told.items()} == {
        node: {d.name for d in declarations(group)} for node, group in SECTIONS.items()
    }
    (of_node,) = json.loads(output(capsys, "params", "dvl.max_speed", "--json", "-")).values()
    speed = of_node["dvl.max_speed"]
    assert (speed["default"], speed["unit"], speed["type"]) == (10.0, "m/s", "float")
    assert speed["range"] == "> 0 and <= 1000" and "too_fast" in speed["meaning"]
    assert output(capsys, "params", "no such word", "--json", "-", code=1) == ""


def test_beside_a_file_of_json_the_text_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in (["models"], ["params", "lever_arm"], ["doctor"]):
        file = tmp_path / f"{command[0]}.json"
        assert output(capsys, *command, "--json", str(file)) == output(capsys, *command)
        assert json.loads(file.read_text()) == json.loads(output(capsys, *command, "--json", "-"))
        no_folder = tmp_path / "no" / "folder.json"
        assert cli.main([*command, "--json", str(no_folder)]) == 2
        told = capsys.readouterr()
        assert told.out == ""
        assert told.err.startswith(f"insdvl {command[0]}: --json {no_folder}: ")


def test_citation_has_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    text = output(capsys, "cite")
    assert f"version = {{{metadata.version('insdvl')}}}" in text
    assert len(re.findall(r"^@\w+\{\w+,$", text, re.MULTILINE)) == 2
    assert text.count("{") == text.count("}")


# ---------------------------------------------------------------- doctor


def test_a_right_installation_has_no_fault(capsys: pytest.CaptureFixture[str]) -> None:
    text = output(capsys, "doctor")
    assert "WRONG" not in text
    for word in ("Python", "numba", "numpy", "extra bags", "compiled functions", "models", "ROS 2"):
        assert re.search(rf"^(ok|absent) +{re.escape(word)}", text, re.MULTILINE), word


def test_pins_are_those_of_this_python() -> None:
    assert doctor.pins(PINS, (3, 10)) == {"numpy": "2.2.6", "ros-rclpy": "7.1.6"}
    assert doctor.pins(PINS, (3, 12)) == {"numpy": "2.4.6", "ros-rclpy": "7.1.6"}


def test_faults_are_named_and_end_with_1(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pins = tmp_path / "constraints.txt"
    pins.write_text("numpy==1.0\n")
    monkeypatch.setattr(doctor, "PINS", pins)
    monkeypatch.setattr(doctor, "PYTHONS", ((3, 2), (3, 3)))
    monkeypatch.setattr(kernels, "cache_dir", lambda source: None)
    monkeypatch.setattr(doctor, "find_spec", lambda name: None)
    text = output(capsys, "doctor", code=1)
    wrong = re.findall(r"^WRONG +(.*)$", text, re.MULTILINE)
    assert "3.2 to 3.3 are known to work" in wrong[0]
    assert wrong[1].startswith("numpy ")
    assert wrong[1].endswith("constraints.txt has 1.0")
    assert "INSDVL_CACHE_DIR" in wrong[2]
    assert len(wrong) == 3
    assert re.search(r"^absent +ROS 2", text, re.MULTILINE)
    told = json.loads(output(capsys, "doctor", "--json", "-", code=1))
    assert told["right"] is False
    assert [r["text"] for r in told["results"] if r["mark"] == "WRONG"] == wrong


def test_missing_packages_are_told_with_their_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    installed = metadata.version

    def version(name: str) -> str:
        if name in ("scipy", "rosbags"):
            raise metadata.PackageNotFoundError(name)
        return installed(name)

    monkeypatch.setattr(doctor.metadata, "version", version)
    text = output(capsys, "doctor", code=1)
    assert re.search(r"^WRONG +scipy is not installed", text, re.MULTILINE)
    assert re.search(r"^absent +extra bags lacks rosbags: install insdvl\[bags\]", text, re.M)


# ---------------------------------------------------------------- completion


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_completion_script_knows_commands_and_options(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("shtab")
    text = output(capsys, "completion", shell)
    for word in ("check", "replay", "--inject-noise", "--scenario", "dnn-default"):
        assert word in text


def test_bash_takes_the_completion_script(tmp_path: Path) -> None:
    pytest.importorskip("shtab")
    code = "import sys; from insdvl.cli import main; sys.exit(main(['completion', 'bash']))"
    script = subprocess.run([sys.executable, "-c", code], capture_output=True, cwd=tmp_path)
    assert script.returncode == 0
    taken = subprocess.run(["bash", "-n"], input=script.stdout, capture_output=True)
    assert (taken.returncode, taken.stderr) == (0, b"")
