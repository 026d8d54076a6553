"""The launch files start what is installed, with arguments that the nodes know."""

import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from graphs import Graph
from launch_stand_in import DeclareLaunchArgument, Process, description_of, launched
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import GetParameters
from recordings import record, save

from insdvl.messages.topics import BY_NAME
from insdvl.simulation.mission import mission_of
from insdvl.simulation.parameters import SimulatorParameters
from insdvl.studies.report.parameter_page import SECTIONS

FILES = {
    "navigator": Path(get_package_share_directory("ros_insdvl"), "launch/navigator.launch.py"),
    "demo": Path(get_package_share_directory("ros_insdvl_sim"), "launch/demo.launch.py"),
    "replay": Path(get_package_share_directory("ros_insdvl_sim"), "launch/replay.launch.py"),
}
#: Arguments that a file must have.
REQUIRED = {"navigator": {}, "demo": {}, "replay": {"bag": "dive"}}
#: Values that are not the defaults.
OTHER = {
    "bag": "other",
    "namespace": "auv",
    "imu_topic": "/imu/data",
    "dvl_topic": "/dvl/twist",
    "one_process": "false",
    "use_sim_time": "true",
    "log_level": "warn",
    "scenario": "wide",
    "seed": "3",
    "duration": "20",
    "rate_factor": "2.5",
}


def said(processes: list[Process]) -> list[Any]:
    """The command lines, with the content of the parameter files in the place of their names."""
    contents = [[path.read_text() for path in process.files] for process in processes]
    names = {str(path) for process in processes for path in process.files}
    return [
        (contents[k], [part for part in process.command if part not in names])
        for k, process in enumerate(processes)
    ]


def arguments_of(name: str) -> list[DeclareLaunchArgument]:
    entities = description_of(FILES[name]).entities
    return [entity for entity in entities if isinstance(entity, DeclareLaunchArgument)]


@pytest.mark.parametrize("name", FILES)
def test_it_starts_what_is_installed(name: str, tmp_path: Path) -> None:
    processes = launched(FILES[name], tmp_path, **REQUIRED[name])
    started = [process.executable for process in processes]
    assert (
        started
        == {
            "navigator": ["navigator"],
            "demo": ["navigator", "monitor", "simulator"],
            "replay": ["navigator", "monitor", "replay"],
        }[name]
    )
    for process in processes:
        assert Path(process.command[0]).is_file()
        assert process.ends_all == (process.executable in ("simulator", "replay"))
        assert process.remaps.keys() <= BY_NAME.keys()
        for path in process.files:
            assert path.is_file()
            document = yaml.safe_load(path.read_text())
            assert {key.rpartition("/")[2] for key in document} <= {"**", *SECTIONS}


@pytest.mark.parametrize("name", FILES)
def test_every_argument_is_described_and_changes_something(name: str, tmp_path: Path) -> None:
    before = said(launched(FILES[name], tmp_path, **REQUIRED[name]))
    (tmp_path / "other.yaml").write_text("/**/insdvl_filter: {ros__parameters: {max_delay: 3.0}}")
    other = {**OTHER, "config": str(tmp_path / "other.yaml")}
    for argument in arguments_of(name):
        assert argument.description
        value = {argument.name: other[argument.name]}
        assert said(launched(FILES[name], tmp_path, **REQUIRED[name] | value)) != before, value


def test_two_processes_are_the_filter_and_the_tuner(tmp_path: Path) -> None:
    processes = launched(FILES["navigator"], tmp_path, one_process="false")
    assert [process.executable for process in processes] == ["filter", "tuner"]


def test_a_file_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    """Launch itself warns, and starts a vehicle with the defaults."""
    with pytest.raises(RuntimeError, match="'config' must be a file, got 'vehicel.yaml'"):
        launched(FILES["navigator"], tmp_path, config="vehicel.yaml")


def test_a_recording_must_be_named(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match='"bag" was not provided'):
        launched(FILES["replay"], tmp_path)


def test_the_vehicles_file_reaches_both_nodes_and_takes_precedence(
    managed: Any, tmp_path: Path
) -> None:
    config = tmp_path / "vehicle.yaml"
    config.write_text(
        "/**/insdvl_filter: {ros__parameters: {max_delay: 3.0}}\n"
        "/**/insdvl_tuner: {ros__parameters: {rate: 2.0}}\n"
    )
    arguments = {"config": str(config), "namespace": "auv", "imu_topic": "/imu/data"}
    (process,) = launched(FILES["navigator"], tmp_path, **arguments)
    graph = managed(Graph())
    with subprocess.Popen(process.command, stderr=subprocess.PIPE) as running:
        try:
            nodes = {"/auv/insdvl_filter", "/auv/insdvl_tuner"}
            graph.until_reported(*nodes)
            assert nodes <= graph.node_names()
            assert parameter(graph, "/auv/insdvl_filter", "max_delay").double_value == 3.0
            source = parameter(graph, "/auv/insdvl_filter", "process_noise.source")
            assert source.string_value == "external"
            assert parameter(graph, "/auv/insdvl_tuner", "rate").double_value == 2.0
            assert graph.peer.count_subscribers("/imu/data") == 1
        finally:
            running.terminate()
    assert running.returncode == 0


def parameter(graph: Graph, node: str, name: str) -> Any:
    request = GetParameters.Request(names=[name])
    (value,) = graph.call(GetParameters, f"{node}/get_parameters", request).values
    return value


def fly(graph: Graph, processes: list[Process]) -> list[Odometry]:
    """The odometry until the process has ended that ends all; every one ends well."""
    received = graph.keep(Odometry, "odometry/filtered")
    running = {p.executable: subprocess.Popen(p.command) for p in processes}
    try:
        (last,) = (running[process.executable] for process in processes if process.ends_all)
        graph.until(lambda: last.poll() is not None)
        graph.until_settled(lambda: len(received), "/insdvl_filter")
    finally:
        for process in running.values():
            process.terminate()
    assert {name: process.wait() for name, process in running.items()} == dict.fromkeys(running, 0)
    return received


@pytest.mark.long
def test_the_demo_flies(managed: Any, tmp_path: Path) -> None:
    arguments = {"duration": "6", "rate_factor": "2", "scenario": "constant"}
    received = fly(managed(Graph()), launched(FILES["demo"], tmp_path, **arguments))
    assert len(received) > 500


@pytest.mark.long
def test_a_recording_is_navigated(managed: Any, tmp_path: Path) -> None:
    save(tmp_path / "dive", record(mission_of(SimulatorParameters(duration=6.0))))
    config = tmp_path / "vehicle.yaml"
    config.write_text(
        "/**/insdvl_filter: {ros__parameters: {process_noise: {source: external}}}\n"
        "/**/insdvl_tuner: {ros__parameters: {model: default}}\n"
        "/**/insdvl_replay: {ros__parameters: {imu_topic: /imu, dvl_topic: /dvl}}\n"
    )
    arguments = {"bag": str(tmp_path / "dive"), "config": str(config), "rate_factor": "2"}
    received = fly(managed(Graph()), launched(FILES["replay"], tmp_path, **arguments))
    assert len(received) > 300  # without an initial state it starts with the first DVL and motion
