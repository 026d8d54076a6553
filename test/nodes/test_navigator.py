"""Filter and tuner in one process: the same results as in two, with one subscription of the IMU."""

import json
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
import yaml
from geometry_msgs.msg import TwistStamped
from graphs import RELIABLE, Graph, reliable
from nav_msgs.msg import Odometry
from ros_messages import imu_message, sensor_messages, stamp_of
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool, Trigger
from told import TOLD

from insdvl.navigation.events import NS
from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import trajectory_named
from ros_insdvl.filter import FilterNode
from ros_insdvl.navigator import navigator_nodes
from ros_insdvl.node import InsdvlNode
from ros_insdvl.status.heard import OK
from ros_insdvl.tuner import TunerNode

SECONDS = 8.0
INPUTS = {"imu/data_raw": Imu, "dvl/velocity": TwistStamped}
OUTPUTS = {
    "odometry/filtered": Odometry,
    "process_noise": Imu,
    "imu/bias": Imu,
}
STARTED = {n: v for n, v in TOLD.items() if n == "initial.mode" or n.endswith("_std")}
FILTER = {
    **STARTED,
    "process_noise.source": "external",
    # The output waits for the Q of a tuner in another process: stamps alone decide it.
    "output_delay": 1.5,
}


class Vehicle(Graph):
    """Filter and tuner in a namespace, and what they are sent and publish."""

    def __init__(self, namespace: str) -> None:
        super().__init__(namespace)
        self.publishers = {
            topic: self.peer.create_publisher(kind, topic, RELIABLE)
            for topic, kind in INPUTS.items()
        }
        self.kept = {topic: self.keep(kind, topic) for topic, kind in OUTPUTS.items()}

    def make_apart(self, **parameters: Any) -> None:
        self.filter = self.make(FilterNode, **reliable(self.namespace, *INPUTS), **parameters)
        self.tuner = self.make(TunerNode, **reliable(self.namespace, "imu/data_raw"))

    def make_joined(self, folder: Path, cli: tuple[str, ...] = (), **parameters: Any) -> None:
        """As a process makes them, whose parameter file has a section for each."""
        sections = {
            "insdvl_filter": {**reliable(self.namespace, *INPUTS), **parameters},
            "insdvl_tuner": reliable(self.namespace, "imu/data_raw"),
        }
        file = folder / "vehicle.yaml"
        document = {f"/**/{name}": {"ros__parameters": v} for name, v in sections.items()}
        file.write_text(yaml.dump(json.loads(json.dumps(document))))
        arguments = ["--ros-args", "--params-file", str(file), *cli]
        made: list[InsdvlNode[Any]] = []
        for node in navigator_nodes(
            namespace=self.namespace or None, context=self.context, cli_args=arguments
        ):
            made.append(self.add(node))
        self.filter, self.tuner = made

    def keep_what_the_filter_is_given(self) -> None:
        """Messages as a filter that waits keeps them, and as they came."""
        self.given: list[tuple[Any, Any]] = []
        give = self.filter._feed.give

        def keep(topic: str, message: Any) -> Any:
            self.given.append((message, deepcopy(message)))
            return give(topic, message)

        self.filter._feed.give = keep

    def until_matched(self, takers: int) -> None:
        for topic, publisher in self.publishers.items():
            count = takers if topic == "imu/data_raw" else 1
            self.until(lambda p=publisher, n=count: p.get_subscription_count() == n)
        for topic in OUTPUTS:
            self.until(lambda t=topic: self.peer.count_publishers(t) == 1)

    def send(self, messages: list[tuple[int, str, Any]]) -> None:
        for _, topic, message in messages:
            self.publishers[topic].publish(message)
        count = sum(topic == "imu/data_raw" for _, topic, _ in messages)
        total = self.filter.received["imu/data_raw"] + count
        self.until(
            lambda: (
                self.filter.received["imu/data_raw"] == total
                and self.tuner.received["imu/data_raw"] == total
            )
        )
        self.until(
            lambda: (
                self.filter.received["process_noise"] == self.tuner.outputs["process_noise"].count
            )
        )
        for topic, messages_of in self.kept.items():
            sent = (self.filter.outputs | self.tuner.outputs)[topic]
            self.until(lambda s=sent, m=messages_of: len(m) == s.count)


def flight() -> list[tuple[int, str, Any]]:
    """Stamps, topics and messages of a mission whose noise changes."""
    m = simulate(
        trajectory_named("auv"), SCENARIOS["varying"], seed=3, duration=SECONDS, start_ns=100 * NS
    )
    messages = [(stamp, topic, message) for stamp, topic, message in sensor_messages(m)]
    return sorted(messages, key=lambda item: (item[0], item[1]))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Vehicle, Vehicle]]:
    """Two vehicles that were sent the same messages: one of two processes, one of one."""
    apart, joined = Vehicle("/apart"), Vehicle("/joined")
    apart.make_apart(**FILTER)
    joined.make_joined(tmp_path_factory.mktemp("joined"), **FILTER)
    apart.until_matched(2)
    joined.until_matched(1)
    joined.keep_what_the_filter_is_given()
    messages = flight()
    for vehicle in apart, joined:
        vehicle.send(messages)
    yield apart, joined
    for vehicle in apart, joined:
        vehicle.close()


@pytest.mark.parametrize("topic", OUTPUTS)
def test_outputs_are_those_of_two_processes_to_the_bit(
    flown: tuple[Vehicle, Vehicle], topic: str
) -> None:
    apart, joined = (vehicle.kept[topic] for vehicle in flown)
    assert len(apart) > 3
    assert apart == joined  # not their bytes: what is between the fields of a message is arbitrary


def test_the_learned_noise_is_used(flown: tuple[Vehicle, Vehicle]) -> None:
    _, joined = flown
    learned = joined.kept["process_noise"]
    assert joined.filter.received["process_noise"] == len(learned) > 3
    assert "process_noise" not in {refused.topic for refused in joined.filter.rejected}
    assert joined.filter._fold.latest["noise"]["q_ns"] == stamp_of(learned[-1])


def test_what_the_filter_keeps_is_not_changed_by_the_tuner(flown: tuple[Vehicle, Vehicle]) -> None:
    _, joined = flown
    assert len(joined.given) > 800
    assert all(message == before for message, before in joined.given)


def test_the_imu_has_one_subscription_and_the_wire_has_no_second_way(
    flown: tuple[Vehicle, Vehicle],
) -> None:
    for vehicle, imu, process_noise in zip(flown, (2, 1), (1, 0), strict=True):
        count = vehicle.peer.count_subscribers
        assert count("imu/data_raw") == imu
        assert count("process_noise") == process_noise + 1  # the peer's


def test_nodes_services_and_statuses_are_those_of_two_processes(
    flown: tuple[Vehicle, Vehicle],
) -> None:
    found = []
    for vehicle in flown:
        names = [f"{vehicle.namespace}/{name}" for name in ("insdvl_filter", "insdvl_tuner")]
        vehicle.until_reported(*names)
        reports = [vehicle.diagnostics.report(name) for name in names]
        for report in reports:
            assert report.statuses["connections"].level == OK
            assert report.statuses["unexpected errors"].level == OK
        found.append(
            [
                [set(report.statuses) for report in reports],
                [{k for k in report.values if k.startswith("received")} for report in reports],
                [
                    {
                        parameter
                        for parameter in node._parameters
                        if not parameter.startswith("qos_overrides")
                    }
                    for node in (vehicle.filter, vehicle.tuner)
                ],
                [
                    (name.removeprefix(vehicle.namespace), tuple(kinds))
                    for name, kinds in vehicle.peer.get_service_names_and_types()
                    if name.startswith(vehicle.namespace)
                ],
            ]
        )
        tuner = vehicle.diagnostics.report(names[1]).values
        assert tuner["received imu/data_raw"] == str(round(SECONDS * 100))
        assert tuner["publishers imu/data_raw"] == "1"
    assert found[0] == found[1]


def test_a_reset_and_a_switch_reach_their_nodes(flown: tuple[Vehicle, Vehicle]) -> None:
    _, joined = flown
    assert joined.call(Trigger, "insdvl_filter/reset", Trigger.Request()).success
    assert joined.peer.count_subscribers("process_noise") == 1  # no subscription came back
    joined.call(SetBool, "insdvl_tuner/enable", SetBool.Request(data=False))
    sent = len(joined.kept["process_noise"])
    start_ns = 200 * NS
    joined.send([(0, "imu/data_raw", imu_message(start_ns + k * NS // 100)) for k in range(250)])
    assert len(joined.kept["process_noise"]) == sent
    assert joined.filter.received["imu/data_raw"] == round(SECONDS * 100) + 250


def test_topics_that_a_remap_parts_are_not_shared(managed: Any, tmp_path: Path) -> None:
    vehicle = managed(Vehicle("/parted"))
    vehicle.make_joined(tmp_path, ("-r", "insdvl_tuner:imu/data_raw:=raw"), **FILTER)
    vehicle.until(lambda: vehicle.peer.count_subscribers("raw") == 1)
    assert vehicle.peer.count_subscribers("imu/data_raw") == 1
    assert "imu/data_raw" in vehicle.tuner.inputs
    assert vehicle.tuner.inputs["imu/data_raw"] is not vehicle.filter.inputs["imu/data_raw"]


def test_an_error_of_the_tuner_does_not_reach_the_filter(
    managed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle = managed(Vehicle("/failing"))
    vehicle.make_joined(tmp_path, **FILTER)
    vehicle.until_matched(1)

    def fail(*_: Any) -> None:
        raise RuntimeError("of the tuner")

    monkeypatch.setattr("ros_insdvl.tuner.tune", fail)
    vehicle.publishers["imu/data_raw"].publish(imu_message(100 * NS))
    vehicle.until(lambda: vehicle.tuner.received["imu/data_raw"] == 1)
    assert vehicle.tuner.counts()["unexpected errors"] == 1
    assert vehicle.filter.counts()["unexpected errors"] == 0


def test_a_parameter_of_the_command_line_names_its_node(managed: Any, tmp_path: Path) -> None:
    """As the page says, and not in a namespace."""
    vehicle = managed(Vehicle(""))
    vehicle.make_joined(tmp_path, ("-p", "insdvl_filter:max_delay:=3.0"), **FILTER)
    assert vehicle.filter.parameters.max_delay == 3.0


def test_one_name_for_both_is_refused(managed: Any, tmp_path: Path) -> None:
    vehicle = managed(Vehicle("/renamed"))
    with pytest.raises(ParameterError, match="both nodes are named /renamed/nav: rename one"):
        vehicle.make_joined(tmp_path, ("-r", "__node:=nav"))


def test_an_argument_for_all_reaches_the_node_that_knows_it(managed: Any, tmp_path: Path) -> None:
    vehicle = managed(Vehicle("/general"))
    vehicle.make_joined(tmp_path, cli=("-p", "enabled:=false", "-p", "gate.enabled:=false"))
    assert not vehicle.filter.parameters.gate.enabled
    assert not vehicle.tuner.parameters.enabled
    with pytest.raises(ParameterError, match=r"unknown parameter 'gate\.enbled'"):
        vehicle.make_joined(tmp_path, cli=("-p", "gate.enbled:=false"))
