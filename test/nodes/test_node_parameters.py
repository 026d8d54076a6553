"""Parameters of a node: declared with their meaning, and refused by name when they are wrong."""

from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from starts import Start, starts

from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, declarations
from insdvl.watch.monitor_parameters import MonitorParameters
from ros_insdvl.node import InsdvlNode

WRONG = [
    (["-p", "imu.rte:=100.0"], ["imu.rte", "imu.rate"]),
    (["-p", "imu.rate:=100"], ["imu.rate", "float", "100"]),
    (["-p", "imu.rate:=-3.0"], ["imu.rate", "> 0", "-3.0"]),
    (["-p", "process_noise.adaptive_window:=1.5"], ["adaptive_window", "int", "1.5"]),
    (["-p", "gate.enabled:=1"], ["gate.enabled", "bool", "1"]),
    (["-p", "process_noise.source:=magic"], ["process_noise.source", "external", "magic"]),
    (["-p", "dvl.lever_arm:=[1.0, 2.0]"], ["dvl.lever_arm", "3 values", "[1.0, 2.0]"]),
    (["-p", "dvl.lever_arm:=[1, 2, 3]"], ["dvl.lever_arm", "list of floats"]),
    (["-p", "dvl.lever_arm:=[]"], ["dvl.lever_arm", "list of floats"]),
    (["-p", "dvl.lever_arm:=[1, 2.5, 3]"], ["dvl.lever_arm"]),
    (["-p", "output_delay:=3.0"], ["output_delay", "max_delay", "3.0"]),
    (["-p", "use_sim_time:=3"], ["use_sim_time", "BOOL", "3"]),
    (
        ["-p", "qos_overrides./imu/data_raw.subscription.reliability:=maybe"],
        ["qos_overrides./imu/data_raw.subscription.reliability", "best_effort", "maybe"],
    ),
    (
        ["-p", "qos_overrides./imu/data_raw.subscription.depth:=0"],
        ["qos_overrides./imu/data_raw.subscription.depth", "> 0", "0"],
    ),
    (
        ["-p", "qos_overrides./imu/data_raw.subscription.deadline:=1"],
        ["qos_overrides./imu/data_raw.subscription.deadline", "reliability"],
    ),
]


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    context.init()
    yield context
    context.shutdown()


def make(context: Context, group: type[Any] = FilterParameters, **values: Any) -> InsdvlNode[Any]:
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    return InsdvlNode("insdvl_filter", group, context=context, parameter_overrides=overrides)


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> list[Start]:
    """The filter, started with each of the wrong arguments, and with a wrong file."""
    file = tmp_path_factory.mktemp("wrong") / "parameters.yaml"
    file.write_text("/**/insdvl_filter:\n  ros__parameters:\n    dvl: {noise: [0.1, 0.1, 0.1]}\n")
    arguments = [arguments for arguments, _ in WRONG]
    return starts("ros_insdvl.filter", [*arguments, ["--params-file", str(file)]])


@pytest.mark.parametrize("k", range(len(WRONG)), ids=[w[0][1].split(":=")[0] for w in WRONG])
def test_wrong_parameter_ends_the_node_with_its_name(started: list[Start], k: int) -> None:
    assert started[k].code == 2
    errors = started[k].err.splitlines()
    lines = [line for line in errors if not line.startswith("[ERROR]")]
    assert len(lines) == 1
    for text in WRONG[k][1]:
        assert text in lines[0]


def test_wrong_parameter_in_a_file_is_named(started: list[Start]) -> None:
    assert started[-1].code == 2
    assert "dvl.noise" in started[-1].err


def test_nothing_is_published_by_a_node_with_a_wrong_parameter(context: Context) -> None:
    with pytest.raises(ParameterError, match=r"imu\.rate"):
        make(context, **{"imu.rate": 0.0})
    peer = Node("peer", context=context)
    names = peer.get_node_names()
    assert "peer" in names
    assert "insdvl_filter" not in names


def test_values_arrive_in_the_group(context: Context) -> None:
    node = make(context, **{"dvl.lever_arm": [1.0, 2.0, 3.0], "use_sim_time": True})
    assert node.parameters.dvl.lever_arm == (1.0, 2.0, 3.0)
    assert node.parameters.imu == FilterParameters().imu
    assert list(node.get_parameter("dvl.lever_arm").value) == [1.0, 2.0, 3.0]
    node.destroy_node()


def test_every_parameter_is_described(context: Context) -> None:
    node = make(context)
    for declaration in declarations(FilterParameters):
        found = node.describe_parameter(declaration.name)
        assert found.description.startswith(declaration.meaning)
        assert found.additional_constraints == declaration.range_text
        assert found.read_only
    assert "[Hz]" in node.describe_parameter("imu.rate").description
    (bounds,) = node.describe_parameter("dvl.gyro_average").floating_point_range
    assert (bounds.from_value, bounds.to_value) == (0.0, 10.0)
    (bounds,) = node.describe_parameter("process_noise.adaptive_window").integer_range
    assert (bounds.from_value, bounds.to_value) == (1, 50)
    node.destroy_node()


def test_change_at_run_time_is_refused_with_a_reason(context: Context) -> None:
    node = make(context)
    (result,) = node.set_parameters([Parameter("imu.rate", value=50.0)])
    assert not result.successful
    assert "imu.rate" in result.reason
    assert node.get_parameter("imu.rate").value == 100.0
    node.destroy_node()


def test_list_of_strings(context: Context) -> None:
    node = make(context, MonitorParameters, filters=["/a", "/b"])
    assert node.parameters.filters == ("/a", "/b")
    node.destroy_node()
    with pytest.raises(ParameterError, match="list of strings"):
        make(context, MonitorParameters, filters=[1.0, 2.0])
