"""The command line of every executable: its help, and what it does not know."""

import re
import sys
from importlib import import_module
from typing import Any

import pytest
import rclpy

from insdvl.messages.topics import taken
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import declarations
from insdvl.studies.report.parameter_page import SECTIONS
from ros_insdvl.filter import HELP as FILTER_HELP
from ros_insdvl.process.arguments import split

NODES = {
    "ros_insdvl.filter": "insdvl_filter",
    "ros_insdvl.navigator": "insdvl_filter",
    "ros_insdvl.tuner": "insdvl_tuner",
    "ros_insdvl.monitor": "insdvl_monitor",
    "ros_insdvl_sim.simulator": "insdvl_simulator",
    "ros_insdvl_sim.replay": "insdvl_replay",
    "ros_insdvl_sim.relay": "insdvl_relay",
}
TRIALS = (
    "ros_insdvl_sim.trials.demo",
    "ros_insdvl_sim.trials.faults",
    "ros_insdvl_sim.trials.soak",
)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Exit code of an executable that must not start ROS."""

    def refuse(*arguments: Any, **options: Any) -> None:
        raise AssertionError("ROS was started")

    def run(module: str, *arguments: str) -> Any:
        main = import_module(module).main
        monkeypatch.setattr(sys, "argv", [module.rpartition(".")[2], *arguments])
        try:
            return main()
        except SystemExit as end:
            return end.code

    monkeypatch.setattr(rclpy, "init", refuse)
    return run


@pytest.mark.parametrize("module", [*NODES, *TRIALS])
@pytest.mark.parametrize("option", ["--help", "-h"])
def test_help_starts_nothing(
    run: Any, module: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(module, option) == 0
    out, err = capsys.readouterr()
    assert out.startswith("usage: ")
    assert err == ""


@pytest.mark.parametrize("module", NODES)
def test_help_of_a_node(run: Any, module: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(module, "--help", "--ros-args", "-p", "imu.rate:=3") == 0
    text = capsys.readouterr().out
    package, executable = module.split(".")
    assert f"ros2 run {package} {executable} --ros-args " in text
    assert f"ros2 param describe /{NODES[module]} NAME" in text
    assert "docs/reference/parameters.md" in text
    assert "docs/reference/diagnostics.md" in text
    assert max(map(len, text.splitlines())) <= 100
    examples = re.findall(r"-p '?([\w.]+):=", text.partition("examples")[2])
    nodes = ("insdvl_filter", "insdvl_tuner") if "navigator" in module else (NODES[module],)
    assert set(examples) <= {d.name for node in nodes for d in declarations(SECTIONS[node])}


@pytest.mark.parametrize("module", NODES)
@pytest.mark.parametrize("argument", ["imu.rate:=100.0", "--rate", "bag"])
def test_what_stands_before_ros_args_is_refused(
    run: Any, module: str, argument: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(module, argument, "--ros-args", "-p", "a:=1") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"unknown argument '{argument}'" in line
    assert "--help" in line


def test_the_filters_help_has_its_topics() -> None:
    words = set(re.findall(r"[\w/]+", FILTER_HELP.about))
    assert set(taken(FilterParameters())) <= words
    assert {"odometry/filtered", "imu/bias", "gps/filtered", "dvl/innovation"} <= words


def test_ros_has_its_own_part_of_a_command_line() -> None:
    own, options = split(
        ["a", "--ros-args", "-p", "x:=1", "--params-file", "f", "--disable-rosout-logs", "--", "b"]
    )
    assert own == ["a", "b"]
    assert options == [("-p", "x:=1"), ("--params-file", "f"), ("--disable-rosout-logs", "")]
