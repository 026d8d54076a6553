"""What does not match in the graph is named, in the log and in /diagnostics, until it has gone."""

from collections.abc import Iterator
from typing import Any

import pytest
from graphs import REPORT_PERIOD, Graph, participant, reliable
from rcl_interfaces.msg import Log, ParameterType
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, NavSatFix

from insdvl.navigation.parameters import FilterParameters
from ros_insdvl.node import InsdvlNode
from ros_insdvl.status.heard import ERROR, OK, WARN

NAMESPACE, NAME = "/auv", "/auv/insdvl_filter"
SOON = round(5.0 / REPORT_PERIOD)  # reports of five seconds
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Listener(InsdvlNode[FilterParameters]):
    """A node with the filter's name and parameters, one input and one output."""

    single_inputs = ("imu/data_raw",)

    def __init__(self, **options: Any) -> None:
        super().__init__("insdvl_filter", FilterParameters, **options)
        self.advertise(Imu, "imu/bias")
        self.listen(Imu, "imu/data_raw", lambda message: None)
        self.start_diagnostics()


class ListenerGraph(Graph):
    """The listener and what it says; a test lets others come and go."""

    def __init__(self) -> None:
        super().__init__(NAMESPACE)
        self.listener = self.make(Listener, **reliable(NAMESPACE, "imu/data_raw"))
        self.log: list[str] = []
        self.peer.create_subscription(Log, "/rosout", lambda m: self.log.append(m.msg), 100)

    def until_told(self, level: int, *texts: str) -> None:
        """The status `connections` has the level and the texts, soon."""
        reports = self.diagnostics.report

        def told() -> bool:
            status = self.status(NAME, "connections")
            return status.level == level and all(text in status.message for text in texts)

        before = reports(NAME).count
        self.until(told, f"{texts}")
        assert reports(NAME).count - before <= SOON

    def until_logged(self, *texts: str) -> None:
        self.until(lambda: any(all(t in line for t in texts) for line in self.log), f"{texts}")


@pytest.fixture(scope="module")
def graph() -> Iterator[ListenerGraph]:
    made = ListenerGraph()
    made.until_told(OK)
    yield made
    made.close()


def test_publisher_of_another_quality_of_service_is_named_until_it_goes(
    graph: ListenerGraph,
) -> None:
    with participant("driver", NAMESPACE) as driver:
        driver.create_publisher(Imu, "imu/data_raw", BEST_EFFORT)
        expected = (
            "publisher /auv/driver of imu/data_raw does not match",
            "Best effort publisher and reliable subscription",
            "qos_overrides./auv/imu/data_raw.subscription",
        )
        graph.until_told(ERROR, *expected)
        graph.until_logged("connections: ", *expected)
    graph.until_told(OK)
    graph.until_logged("connections: ok again")


@pytest.mark.parametrize(
    ("qos", "reason"),
    [
        (LATCHED, "Volatile publisher and transient local subscription"),
        (QoSProfile(depth=5, deadline=Duration(seconds=1)), "deadline"),
    ],
)
def test_subscription_of_another_quality_of_service_is_named(
    graph: ListenerGraph, qos: QoSProfile, reason: str
) -> None:
    with participant("consumer", NAMESPACE) as consumer:
        consumer.create_subscription(Imu, "imu/bias", lambda m: None, qos)
        what = "subscription /auv/consumer of imu/bias does not match"
        graph.until_told(WARN, what, reason)
    graph.until_told(OK)


def test_publisher_of_another_type_is_named(graph: ListenerGraph) -> None:
    with participant("driver", NAMESPACE) as driver:
        driver.create_publisher(NavSatFix, "imu/data_raw", 10)
        what = "has type sensor_msgs/msg/NavSatFix, expected sensor_msgs/msg/Imu"
        graph.until_told(ERROR, "/auv/driver", what)
    graph.until_told(OK)


def test_a_second_publisher_is_named_on_inputs_and_on_outputs(graph: ListenerGraph) -> None:
    with participant("one", NAMESPACE) as one, participant("two", NAMESPACE) as two:
        for driver in (one, two):
            driver.create_publisher(Imu, "imu/data_raw", 10)
        graph.until_told(WARN, "2 publishers of imu/data_raw (/auv/one, /auv/two)")
        one.create_publisher(Imu, "imu/bias", 10)
        graph.until_told(ERROR, "imu/bias is also published by /auv/one")
    graph.until_told(OK)


def test_two_nodes_of_one_name_are_named(
    graph: ListenerGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    with participant("insdvl_filter", NAMESPACE):
        graph.until_told(WARN, f"2 nodes are named {NAME}")
        graph.until_logged("2 nodes are named")
        monkeypatch.setattr("ros_insdvl.status.connections.LEASE", 0.1)
        graph.until_told(ERROR, f"2 nodes are named {NAME}")
    graph.until_told(OK)


def changed(graph: ListenerGraph, kind: Any, service: str, name: str, **value: Any) -> Any:
    message = ParameterMessage(name=name)
    for field, content in value.items():
        setattr(message.value, field, content)
    response = graph.call(kind, f"{NAME}/{service}", kind.Request(parameters=[message]))
    return response.result if kind is SetParametersAtomically else response.results[0]


@pytest.mark.parametrize(
    ("kind", "service"),
    [
        (SetParameters, "set_parameters"),
        (SetParametersAtomically, "set_parameters_atomically"),
    ],
)
def test_parameters_are_fixed_while_the_node_runs(
    graph: ListenerGraph, kind: Any, service: str
) -> None:
    for name, value, before in (
        ("imu.rate", {"type": ParameterType.PARAMETER_DOUBLE, "double_value": 50.0}, 100.0),
        ("earth_rate", {"type": ParameterType.PARAMETER_BOOL, "bool_value": False}, True),
        ("imu.rate", {"type": ParameterType.PARAMETER_STRING, "string_value": "x"}, 100.0),
        ("imu.rate", {"type": ParameterType.PARAMETER_NOT_SET}, 100.0),
    ):
        result = changed(graph, kind, service, name, **value)
        assert not result.successful
        assert "read-only" in result.reason and name in result.reason
        assert graph.listener.get_parameter(name).value == before
    result = changed(graph, kind, service, "imu.rte", type=ParameterType.PARAMETER_DOUBLE)
    assert not result.successful
    assert "unknown parameter 'imu.rte'" in result.reason
    qos = "qos_overrides./auv/imu/data_raw.subscription.reliability"
    result = changed(
        graph, kind, service, qos, type=ParameterType.PARAMETER_STRING, string_value="best_effort"
    )
    assert not result.successful


def test_sim_time_is_applied_and_of_a_wrong_type_refused(graph: ListenerGraph) -> None:
    def set_to(**value: Any) -> Any:
        return changed(graph, SetParameters, "set_parameters", "use_sim_time", **value)

    assert not set_to(type=ParameterType.PARAMETER_INTEGER, integer_value=1).successful
    for value in (True, False):
        assert set_to(type=ParameterType.PARAMETER_BOOL, bool_value=value).successful
