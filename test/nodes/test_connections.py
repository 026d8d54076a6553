"""What does not match in the graph is named, in the log and in /diagnostics, until it has gone."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log, ParameterType
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, NavSatFix

from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from ros_insdvl.node import InsdvlNode

DEADLINE_NS = 60 * NS  # far beyond what any of these waits takes
SOON_NS = 5 * NS
NAME = "/auv/insdvl_filter"
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Listener(InsdvlNode[FilterParameters]):
    """A node with the filter's name and parameters, one input and one output."""

    single_inputs = ("imu/data_raw",)

    def __init__(self, context: Context) -> None:
        reliable = "qos_overrides./auv/imu/data_raw.subscription.reliability"
        super().__init__(
            "insdvl_filter",
            FilterParameters,
            namespace="/auv",
            context=context,
            parameter_overrides=[Parameter(reliable, value="reliable")],
        )
        self.advertise(Imu, "imu/bias")
        self.listen(Imu, "imu/data_raw", lambda message: None)
        self.start_diagnostics()


class Graph:
    """The listener and what it tells; one executor turns it and those who look."""

    def __init__(self) -> None:
        self.context = Context()
        self.context.init()
        self.node = Listener(self.context)
        self.peer = Node("peer", namespace="/auv", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.told: DiagnosticStatus | None = None
        self.log: list[str] = []
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self._keep, 100)
        self.peer.create_subscription(Log, "/rosout", lambda m: self.log.append(m.msg), 100)

    def _keep(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{NAME}: connections":
                self.told = status

    def until(self, condition: Callable[[], Any], within_ns: int = DEADLINE_NS) -> None:
        clock = self.peer.get_clock()
        start = clock.now()
        while not condition():
            assert (clock.now() - start).nanoseconds < within_ns
            self.executor.spin_once(timeout_sec=0.1)

    def until_told(self, level: bytes, *texts: str) -> None:
        def told() -> bool:
            status = self.told
            return (
                status is not None
                and status.level == level
                and all(text in status.message for text in texts)
            )

        self.until(told, SOON_NS)

    def until_logged(self, *texts: str) -> None:
        self.until(lambda: any(all(t in line for t in texts) for line in self.log), SOON_NS)

    def close(self) -> None:
        self.executor.shutdown()
        self.peer.destroy_node()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture(scope="module")
def graph() -> Iterator[Graph]:
    made = Graph()
    made.until_told(DiagnosticStatus.OK)
    yield made
    made.close()


@contextmanager
def participant(name: str) -> Iterator[Node]:
    """A node in the graph, as if it were another process."""
    context = Context()
    context.init(initialize_logging=False)
    node = Node(name, namespace="/auv", context=context, enable_rosout=False)
    yield node
    node.destroy_node()
    context.shutdown()


def test_publisher_of_another_quality_of_service_is_named_until_it_goes(graph: Graph) -> None:
    with participant("driver") as driver:
        driver.create_publisher(Imu, "imu/data_raw", BEST_EFFORT)
        expected = (
            "publisher /auv/driver of imu/data_raw does not match",
            "Best effort publisher and reliable subscription",
            "qos_overrides./auv/imu/data_raw.subscription",
        )
        graph.until_told(DiagnosticStatus.ERROR, *expected)
        graph.until_logged("connections: ", *expected)
    graph.until_told(DiagnosticStatus.OK)
    graph.until_logged("connections: ok again")


@pytest.mark.parametrize(
    ("qos", "reason"),
    [
        (LATCHED, "Volatile publisher and transient local subscription"),
        (QoSProfile(depth=5, deadline=Duration(seconds=1)), "deadline"),
    ],
)
def test_subscription_of_another_quality_of_service_is_named(
    graph: Graph, qos: QoSProfile, reason: str
) -> None:
    with participant("consumer") as consumer:
        consumer.create_subscription(Imu, "imu/bias", lambda m: None, qos)
        what = "subscription /auv/consumer of imu/bias does not match"
        graph.until_told(DiagnosticStatus.WARN, what, reason)
    graph.until_told(DiagnosticStatus.OK)


def test_publisher_of_another_type_is_named(graph: Graph) -> None:
    with participant("driver") as driver:
        driver.create_publisher(NavSatFix, "imu/data_raw", 10)
        what = "has the type sensor_msgs/msg/NavSatFix and not sensor_msgs/msg/Imu"
        graph.until_told(DiagnosticStatus.ERROR, "/auv/driver", what)
    graph.until_told(DiagnosticStatus.OK)


def test_a_second_publisher_is_named_on_inputs_and_on_outputs(graph: Graph) -> None:
    with participant("one") as one, participant("two") as two:
        for driver in (one, two):
            driver.create_publisher(Imu, "imu/data_raw", 10)
        graph.until_told(DiagnosticStatus.WARN, "2 publishers of imu/data_raw (/auv/one, /auv/two)")
        one.create_publisher(Imu, "imu/bias", 10)
        graph.until_told(DiagnosticStatus.ERROR, "imu/bias is published by /auv/one as well")
    graph.until_told(DiagnosticStatus.OK)


def test_two_nodes_of_one_name_are_named(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    with participant("insdvl_filter"):
        graph.until_told(DiagnosticStatus.WARN, f"2 nodes are named {NAME}")
        graph.until_logged("2 nodes are named")
        monkeypatch.setattr("ros_insdvl.connections.LEASE", 0.1)
        graph.until_told(DiagnosticStatus.ERROR, f"2 nodes are named {NAME}")
    graph.until_told(DiagnosticStatus.OK)


def changed(graph: Graph, kind: Any, service: str, name: str, **value: Any) -> Any:
    client = graph.peer.create_client(kind, f"{NAME}/{service}")
    graph.until(client.service_is_ready)
    message = ParameterMessage(name=name)
    for field, content in value.items():
        setattr(message.value, field, content)
    future = client.call_async(kind.Request(parameters=[message]))
    graph.until(future.done)
    response = future.result()
    graph.peer.destroy_client(client)
    return response.result if kind is SetParametersAtomically else response.results[0]


@pytest.mark.parametrize(
    ("kind", "service"),
    [
        (SetParameters, "set_parameters"),
        (SetParametersAtomically, "set_parameters_atomically"),
    ],
)
def test_parameters_are_fixed_while_the_node_runs(graph: Graph, kind: Any, service: str) -> None:
    for name, value, before in (
        ("imu.rate", {"type": ParameterType.PARAMETER_DOUBLE, "double_value": 50.0}, 100.0),
        ("gate.enabled", {"type": ParameterType.PARAMETER_BOOL, "bool_value": False}, True),
        ("imu.rate", {"type": ParameterType.PARAMETER_STRING, "string_value": "x"}, 100.0),
        ("imu.rate", {"type": ParameterType.PARAMETER_NOT_SET}, 100.0),
    ):
        result = changed(graph, kind, service, name, **value)
        assert not result.successful
        assert "read-only" in result.reason and name in result.reason
        assert graph.node.get_parameter(name).value == before
    result = changed(graph, kind, service, "imu.rte", type=ParameterType.PARAMETER_DOUBLE)
    assert not result.successful
    assert "unknown parameter 'imu.rte'" in result.reason
    qos = "qos_overrides./auv/imu/data_raw.subscription.reliability"
    result = changed(
        graph, kind, service, qos, type=ParameterType.PARAMETER_STRING, string_value="best_effort"
    )
    assert not result.successful


def test_sim_time_is_applied_and_of_a_wrong_type_refused(graph: Graph) -> None:
    def set_to(**value: Any) -> Any:
        return changed(graph, SetParameters, "set_parameters", "use_sim_time", **value)

    assert not set_to(type=ParameterType.PARAMETER_INTEGER, integer_value=1).successful
    for value in (True, False):
        assert set_to(type=ParameterType.PARAMETER_BOOL, bool_value=value).successful
