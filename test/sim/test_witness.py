"""Waiting for what happens in a graph: for an event, with a limit for a hang."""

from typing import Any

import pytest
from graphs import Graph
from sensor_msgs.msg import Imu

from insdvl.tuner.parameters import TunerParameters
from ros_insdvl.node import InsdvlNode
from ros_insdvl_sim.trials import witness
from ros_insdvl_sim.trials.environment import TrialError

NODE = "/reporting"


class Reporting(InsdvlNode[TunerParameters]):
    """A node that only reports."""

    def __init__(self, **options: Any) -> None:
        super().__init__("reporting", TunerParameters, **options)
        self.start_diagnostics()


@pytest.fixture
def graph(managed: Any) -> Graph:
    return managed(Graph())


def test_what_does_not_happen_is_named(graph: Graph) -> None:
    with pytest.raises(TrialError, match=r"the tide did not happen within 0\.1 s"):
        graph.until(lambda: False, "the tide", patience=0.1)


def test_it_is_settled_when_reports_come_and_nothing_else(graph: Graph) -> None:
    graph.make(Reporting)
    states = iter(range(30))  # which end before the reports do
    graph.until_settled(lambda: next(states, 30), NODE)
    assert next(states, 30) == 30
    assert graph.diagnostics.report(NODE).count >= 3


def test_it_is_settled_at_once_when_all_is_there_or_nobody_reports(graph: Graph) -> None:
    graph.until_settled(lambda: 0, NODE, done=lambda: True)
    graph.until_settled(lambda: 0)


def test_a_node_that_does_not_report_is_named(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(witness, "PATIENCE", 0.1)
    with pytest.raises(TrialError, match=f"{NODE} did not report for 0.1 s"):
        graph.until_settled(lambda: 0, NODE)


def test_only_the_changes_of_a_status_are_kept(graph: Graph) -> None:
    graph.make(Reporting)
    graph.until_reported(NODE, times=3)
    before = len(graph.diagnostics.changes)
    graph.until_reported(NODE, times=3)
    assert len(graph.diagnostics.changes) == before
    causes = [change.cause for change in graph.diagnostics.changes if change.node == NODE]
    assert causes == ["connections", "unexpected errors"]


def test_bytes_are_heard_with_their_stamp(graph: Graph) -> None:
    heard: list[int] = []
    graph.hear(Imu, "imu", lambda data: heard.append(witness.stamp_of(data)))
    publisher = graph.peer.create_publisher(Imu, "imu", 10)
    graph.until(lambda: publisher.get_subscription_count() == 1)
    message = Imu()
    message.header.stamp.sec, message.header.stamp.nanosec = 1000, 5
    publisher.publish(message)
    graph.until(lambda: heard)
    assert heard == [1_000_000_000_005]
    assert graph.counts["imu"] == 1
