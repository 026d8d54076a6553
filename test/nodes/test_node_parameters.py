"""Parameters of a node: declared with their meaning, and refused by name when they are wrong."""

from collections.abc import Iterator
from typing import Any

import pytest
from rcl_interfaces.msg import ParameterType
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
    (["-p", "imu.rate:=true"], ["imu.rate", "float", "True"]),
    (["-p", "imu.rate:=-3.0"], ["imu.rate", "> 0", "-3.0"]),
    (["-p", "process_noise.adaptive_window:=1.5"], ["adaptive_window", "int", "1.5"]),
    (["-p", "gate.enabled:=1"], ["gate.enabled", "bool", "1"]),
    (["-p", "process_noise.source:=magic"], ["process_noise.source", "external", "magic"]),
    (["-p", "dvl.lever_arm:=[1.0, 2.0]"], ["dvl.lever_arm", "3 values", "[1.0, 2.0]"]),
    (["-p", "dvl.lever_arm:=[a, b, c]"], ["dvl.lever_arm", "list of floats"]),
    (["-p", "dvl.lever_arm:=[]"], ["dvl.lever_arm", "list of floats"]),
    (
        ["-p", "dvl.lever_arm:=[1, 2.5, 3]"],
        ["dvl.lever_arm", "Sequence should be of same type. Value type 'double' do not belong at"],
    ),
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


FILES = (
    "/**/insdvl_filter:\n  ros__parameters:\n    dvl: {noise: [0.1, 0.1, 0.1]}\n",
    "/**:\n  ros__parameters: {a: [1, 2.5], b: }\n",
)


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> list[Start]:
    """The filter, started with each of the wrong arguments, and with wrong files."""
    arguments, given = [arguments for arguments, _ in WRONG], []
    for k, text in enumerate(FILES):
        file = tmp_path_factory.mktemp("wrong") / f"parameters_{k}.yaml"
        file.write_text(text)
        given += ["--params-file", str(file)]
    several = ["-p", "imu.rate:=0", "-p", "gate.enabled:=1", "-p", "qos_overrides./a.b.depth:=0"]
    return starts("ros_insdvl.filter", [*arguments, given[:2], given, several])


@pytest.mark.parametrize("k", range(len(WRONG)), ids=[w[0][1].split(":=")[0] for w in WRONG])
def test_wrong_parameter_ends_the_node_with_its_name(started: list[Start], k: int) -> None:
    assert started[k].code == 2
    errors = started[k].err.splitlines()
    lines = [line for line in errors if not line.startswith("[ERROR]")]
    assert len(lines) == 1
    for text in WRONG[k][1]:
        assert text in lines[0]


def test_wrong_parameter_in_a_file_is_named_with_its_place(started: list[Start]) -> None:
    assert started[-3].code == 2
    assert "parameters_0.yaml, line 3, section '/**/insdvl_filter': unknown" in started[-3].err
    assert "dvl.noise" in started[-3].err


def test_all_faults_of_files_and_of_arguments_are_told_at_once(started: list[Start]) -> None:
    assert started[-2].code == started[-1].code == 2
    assert len(started[-2].err.splitlines()) == 2
    assert "line_num 2" in started[-2].err
    assert "No value at line 2" in started[-2].err
    assert len(started[-1].err.splitlines()) == 3
    for name in ("imu.rate", "gate.enabled", "qos_overrides./a.b.depth"):
        assert f"'{name}'" in started[-1].err


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
        assert found.read_only is not declaration.changeable
        is_float = "float" in declaration.type_name
        assert found.dynamic_typing is is_float
        if is_float:
            lists = ParameterType.PARAMETER_DOUBLE_ARRAY
            one = ParameterType.PARAMETER_DOUBLE
            assert found.type == (lists if declaration.length else one)
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


def test_an_integer_serves_as_a_float(context: Context) -> None:
    node = make(context, **{"imu.rate": 200, "dvl.lever_arm": [1, 2, 3], "dvl.noise_std": 1})
    assert node.parameters.imu.rate == 200.0
    for name, value in (
        ("imu.rate", 200.0),
        ("dvl.lever_arm", [1.0, 2.0, 3.0]),
        ("dvl.noise_std", [1.0, 1.0, 1.0]),
    ):
        found = node.get_parameter(name)
        assert found.type_ in (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY)
        assert found.value == value or list(found.value) == value
    node.destroy_node()


def test_list_of_strings(context: Context) -> None:
    node = make(context, MonitorParameters, filters=["/a", "/b"])
    assert node.parameters.filters == ("/a", "/b")
    node.destroy_node()
    with pytest.raises(ParameterError, match="list of strings"):
        make(context, MonitorParameters, filters=[1.0, 2.0])
