"""Parameters that change while the filter node runs, by the services of `ros2 param`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from graphs import RELIABLE, Graph, reliable
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter
from ros_messages import sensor_messages, stamp_of
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger
from told import TOLD

from insdvl.messages import convert
from insdvl.messages.dvl import dvl
from insdvl.navigation.events import NS, Event
from insdvl.navigation.geometry.frames import ENU
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.settings import SETTINGS, Settings
from insdvl.parameters.declaration import build, changed
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import trajectory_named
from insdvl.timeline.recorded import fold_arrays
from ros_insdvl.filter import FilterNode

START_NS = 1_700_000_000_250_000_000
#: The filter starts at the first sample.
STARTED = {n: v for n, v in TOLD.items() if n == "initial.mode" or n.endswith("_std")}
TOPICS = {"imu/data_raw": Imu, "dvl/velocity": TwistStamped}


class FilterGraph(Graph):
    """The filter, its publishers, and a peer that sets its parameters."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__()
        options = {**reliable("", *TOPICS), **STARTED, **parameters}
        self.filter = self.make(FilterNode, **options)
        self.odometry = self.keep(Odometry, "odometry/filtered")
        self.events = self.keep(ParameterEvent, "/parameter_events")
        self.publishers = {
            topic: self.peer.create_publisher(kind, topic, RELIABLE)
            for topic, kind in TOPICS.items()
        }
        self.until(lambda: all(topic in self.filter.inputs for topic in TOPICS))
        self.until(lambda: all(p.get_subscription_count() for p in self.publishers.values()))
        self.until(lambda: self.filter.outputs["odometry/filtered"].listeners)

    def send(self, items: list[tuple[str, Any]]) -> None:
        """Publish one by one, each when the last has been handled."""
        for topic, message in items:
            target = self.filter.received[topic] + 1
            self.publishers[topic].publish(message)
            self.until(lambda t=topic, n=target: self.filter.received[t] == n)

    def set(self, **values: Any) -> list[str]:
        """The reasons for which values are refused, empty where they are not."""
        request = SetParameters.Request()
        request.parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        response = self.call(SetParameters, "insdvl_filter/set_parameters", request)
        assert all(result.successful is not bool(result.reason) for result in response.results)
        return [result.reason for result in response.results]

    def get(self, name: str) -> Any:
        request = GetParameters.Request(names=[name])
        (value,) = self.call(GetParameters, "insdvl_filter/get_parameters", request).values
        if value.type == ParameterType.PARAMETER_DOUBLE_ARRAY:
            return list(value.double_array_value)
        return (
            value.bool_value if value.type == ParameterType.PARAMETER_BOOL else (value.double_value)
        )


@pytest.fixture
def graph(managed: Any) -> Callable[..., FilterGraph]:
    return lambda **parameters: managed(FilterGraph(**parameters))


def mission(duration: float) -> list[tuple[str, Any]]:
    m = simulate(
        trajectory_named("auv"), SCENARIOS["varying"], seed=5, duration=duration, start_ns=START_NS
    )
    items = sorted(sensor_messages(m, -3_000_000), key=lambda item: item[0])
    return [(topic, message) for _, topic, message in items]


def offline(sent: list[tuple[str, Any]], changes: list[tuple[int, dict[str, Any]]]) -> list[Any]:
    """Odometry at every IMU stamp, by the filter without ROS, with changes at stamps."""
    parameters = build(FilterParameters, TOLD)
    events: list[Event] = [dvl(message, ENU) for topic, message in sent if topic == "dvl/velocity"]
    now = parameters
    for number, (stamp_ns, values) in enumerate(changes):
        now = changed(now, values)
        events.append(Settings(stamp_ns, now, number))
    samples = [convert.imu(message, ENU) for topic, message in sent if topic == "imu/data_raw"]
    result = fold_arrays(
        parameters,
        np.array([s.stamp_ns for s in samples]),
        np.array([s.f_b for s in samples]),
        np.array([s.w_ib_b for s in samples]),
        events,
    )
    return [odometry(result.filter, result.states, k) for k in range(len(samples))]


def covariances(received: list[Odometry]) -> list[bytes]:
    return [bytes(np.array(message.twist.covariance)) for message in received]


def test_a_change_is_in_force_from_the_newest_stamp_on(
    graph: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    g, sent = graph(), mission(4.0)
    changes: list[tuple[int, dict[str, Any]]] = []
    for k, values in enumerate(({"dvl.noise_std": 0.05}, {"gate.enabled": False})):
        g.send(sent[130 * k : 130 * (k + 1)])
        newest_ns = max(stamp_of(m) for topic, m in sent[: 130 * (k + 1)] if "imu" in topic)
        assert g.set(**values) == [""]
        changes.append((newest_ns, values))
    g.send(sent[260:])
    expected = offline(sent, changes)
    g.until(lambda: len(g.odometry) == len(expected))
    assert covariances(g.odometry) == [bytes(o.twist_covariance.ravel()) for o in expected]
    without = [bytes(o.twist_covariance.ravel()) for o in offline(sent, [])]
    assert covariances(g.odometry) != without
    assert g.get("dvl.noise_std") == [0.05] * 3
    assert g.get("gate.enabled") is False
    log = capfd.readouterr().err
    stamp = changes[0][0] / NS
    assert "dvl.noise_std changed from (0.1, 0.1, 0.1) to (0.05, 0.05, 0.05), in force" in log
    assert f"in force from stamp {stamp:.3f} s on" in log
    assert "gate.enabled changed from True to False" in log
    told = [p.name for event in g.events for p in event.changed_parameters]
    assert told == ["dvl.noise_std", "gate.enabled"]


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("gate.probability", 0.2, ("gate.probability", "> 0.5 and <= 0.999999999999", "got 0.2")),
        ("gate.probability", 1.0, ("gate.probability", "<= 0.999999999999", "got 1.0")),
        ("gate.probability", 2.0, ("gate.probability", "> 0.5 and <= 0.999999999999", "got 2.0")),
        ("gate.enabled", "yes", ("gate.enabled", "a bool", "got 'yes'")),
        ("dvl.noise_std", -0.1, ("dvl.noise_std", "3 values", "got [-0.1, -0.1, -0.1]")),
        ("dvl.noise_std", [0.1, 0.2], ("dvl.noise_std", "3 values", "got [0.1, 0.2]")),
        ("dvl.noise_std", None, ("dvl.noise_std", "a list of floats", "got None")),
        ("dvl.covariance", "mine", ("dvl.covariance", "one of largest", "got 'mine'")),
        ("imu.rate", 50.0, ("read-only", "imu.rate")),
        ("dvl.lever_arm", [1.0, 0.0, 0.0], ("read-only", "dvl.lever_arm")),
        ("gate.probabilty", 0.9, ("unknown parameter", "gate.probabilty")),
    ],
)
def test_what_is_refused_is_named_with_value_and_range(
    shared: FilterGraph, name: str, value: Any, expected: tuple[str, ...]
) -> None:
    before = shared.filter.parameters
    (reason,) = shared.set(**{name: value})
    for text in expected:
        assert text in reason
    assert shared.filter.parameters is before


@pytest.fixture(scope="module")
def shared() -> Any:
    g = FilterGraph()
    yield g
    g.close()


def test_integers_serve_as_floats(shared: FilterGraph) -> None:
    assert shared.set(**{"gate.max_rejection_time": 30, "dvl.noise_std": [1, 2, 3]}) == ["", ""]
    assert shared.get("gate.max_rejection_time") == 30.0
    assert shared.get("dvl.noise_std") == [1.0, 2.0, 3.0]
    assert shared.filter.parameters.dvl.noise_std == (1.0, 2.0, 3.0)


def test_several_are_set_together_or_not_at_all(shared: FilterGraph) -> None:
    service = "insdvl_filter/set_parameters_atomically"

    def together(**values: Any) -> Any:
        request = SetParametersAtomically.Request()
        request.parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        return shared.call(SetParametersAtomically, service, request).result

    before = shared.filter.parameters
    for wrong in ({"gate.probability": 0.1}, {"imu.rate": 50.0}, {"imu.rte": 50.0}):
        result = together(**{"dvl.max_speed": 3.0, "dvl.noise_floor": 0.02}, **wrong)
        assert not result.successful
        assert next(iter(wrong)) in result.reason
        assert shared.filter.parameters is before
    assert together(**{"dvl.max_speed": 3.0, "dvl.noise_floor": 0.02}).successful
    assert shared.filter.parameters.dvl.max_speed == 3.0
    assert shared.get("dvl.noise_floor") == 0.02


def test_descriptions_say_which_may_change(shared: FilterGraph) -> None:
    names = [*SETTINGS, "imu.rate", "dvl.mount"]
    request = DescribeParameters.Request(names=names)
    response = shared.call(DescribeParameters, "insdvl_filter/describe_parameters", request)
    found = [descriptor.read_only for descriptor in response.descriptors]
    assert found == [False] * len(SETTINGS) + [True, True]


def test_settings_outlast_a_reset_and_a_restart(graph: Any, tmp_path: Path) -> None:
    state = {"state_file": str(tmp_path / "state"), "state_period": 0.1}
    sent = mission(2.0)
    first = graph(**state)
    first.send(sent[:60])
    assert first.set(**{"dvl.noise_std": 0.05}) == [""]
    first.call(Trigger, "insdvl_filter/reset", Trigger.Request())
    assert first.get("dvl.noise_std") == [0.05] * 3
    first.send(sent[60:120])
    assert first.filter._fold.filter.parameters.dvl.noise_std == (0.05,) * 3
    first.close()
    second = graph(**state)
    assert second.get("dvl.noise_std") == [0.05] * 3
    second.send(sent[120:])
    assert second.filter._fold.filter.parameters.dvl.noise_std == (0.05,) * 3
    second.close()
    # What is started with another value is what the operator wants now.
    third = graph(**state, **{"dvl.noise_std": [0.2, 0.2, 0.2]})
    assert third.get("dvl.noise_std") == [0.2] * 3
