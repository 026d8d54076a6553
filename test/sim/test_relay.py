"""The relay in a graph: what it does to messages, and what the filter behind it makes of them."""

import time
from collections import Counter
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from graphs import RELIABLE, Graph, reliable
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from ros_messages import imu_message, sensor_messages, stamp_of
from sensor_msgs.msg import Imu

from insdvl.messages.refusals import Refused
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU
from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import trajectory_named
from insdvl.studies.faults.link import RelayParameters, links
from ros_insdvl.filter import FilterNode
from ros_insdvl_sim.relay import Relay

NUMBERS = count(1)
KINDS = {"imu/data_raw": Imu, "dvl/velocity": TwistStamped}


class RelayGraph(Graph):
    """A relay, perhaps a filter behind it, and a node at both ends."""

    def __init__(self, relay: dict[str, Any] | None, filter_: dict[str, Any] | None = None) -> None:
        # Of its own: nodes of other graphs live on, or are still listed.
        super().__init__(f"/graph_{next(NUMBERS)}")
        self.relay = None if relay is None else self.with_inputs(Relay, "sent/", relay)
        self.filter = None if filter_ is None else self.with_inputs(FilterNode, "", filter_)
        prefix = "" if relay is None else "sent/"
        self.publishers = {
            topic: self.peer.create_publisher(kind, prefix + topic, RELIABLE)
            for topic, kind in KINDS.items()
        }
        self.received: dict[str, list[Any]] = {}
        self.arrivals: list[float] = []
        for topic, kind in KINDS.items():
            self.listen(kind, topic, raw=True)
        self.listen(Odometry, "odometry/filtered")
        takers = 2 if relay is None else 1  # the peer and the filter, or the relay
        outputs = list(self.relay.outputs.values()) if self.relay else []
        if self.filter is not None:
            outputs.append(self.filter.outputs["odometry/filtered"])
        # The peer listens to all of them, the filter to what comes out of the relay.
        listeners = [1 + (self.filter is not None and o in outputs[:-1]) for o in outputs]
        self.until(
            lambda: (
                all(p.get_subscription_count() == takers for p in self.publishers.values())
                and [output.listeners for output in outputs] == listeners
            )
        )

    def with_inputs(self, kind: Any, prefix: str, parameters: dict[str, Any]) -> Any:
        inputs = reliable(self.namespace, *(prefix + topic for topic in KINDS))
        return self.make(kind, **inputs, **parameters)

    def listen(self, kind: Any, topic: str, *, raw: bool = False) -> None:
        received = self.received[topic] = []

        def keep(message: Any) -> None:
            received.append(message)
            self.arrivals.append(time.monotonic())

        self.peer.create_subscription(kind, topic, keep, RELIABLE, raw=raw)

    def send(self, items: list[tuple[str, Any]]) -> None:
        """Publish in this order, a few at a time, until all has come through."""
        expected = Counter(topic for topic, _ in items)
        for k, (topic, message) in enumerate(items):
            self.publishers[topic].publish(message)
            if k % 20 == 0:
                self.executor.spin_once(timeout_sec=0.0)
        if self.relay is None:
            self.until(lambda: all(len(self.received[t]) == n for t, n in expected.items()))
        else:
            self.until(
                lambda: all(self.relay.received["sent/" + t] == n for t, n in expected.items())
            )
            self.until(
                lambda: all(
                    output.count
                    == self.relay.received["sent/" + t] - self.relay.lost[t] + self.relay.doubled[t]
                    and len(self.received[t]) == output.count
                    for t, output in self.relay.outputs.items()
                )
            )
        if self.filter is not None:
            self.until(lambda: all(self.filter.received[t] == len(self.received[t]) for t in KINDS))
            odometry = self.filter.outputs["odometry/filtered"]
            self.until(lambda: len(self.received["odometry/filtered"]) == odometry.count)


@pytest.fixture
def graph(managed: Any) -> Callable[..., RelayGraph]:
    return lambda *arguments: managed(RelayGraph(*arguments))


def samples(count: int) -> list[tuple[str, Any]]:
    rows = np.random.default_rng(3).standard_normal((count, 6))
    return [
        ("imu/data_raw", imu_message((k + 1) * NS // 100, row[:3], row[3:]))
        for k, row in enumerate(rows)
    ]


def mission_items(mission: Mission) -> list[tuple[str, Any]]:
    """Topics and messages of a mission, by stamp."""
    items = sorted(sensor_messages(mission), key=lambda item: item[0])
    return [(topic, message) for _, topic, message in items]


def mission(duration: float) -> Mission:
    return simulate(
        trajectory_named("auv"), SCENARIOS["constant"], seed=2, duration=duration, start_ns=100 * NS
    )


FILTER = {
    "initial.mode": "parameters",
    "initial.velocity": [1.0, 0.0, 0.0],
    "initial.rpy": [0.0, 0.0, np.pi / 2],
}


@pytest.mark.parametrize(
    "settings", [{}, {"loss": 0.1}, {"duplication": 0.2, "loss": 0.01, "seed": 7}]
)
def test_what_arrives_is_what_the_seed_says_unchanged_and_in_order(
    graph: Any, settings: dict[str, Any]
) -> None:
    g = graph(settings)
    sent = samples(1000)
    g.send(sent)
    link = links(build(RelayParameters, settings))["imu/data_raw"]
    expected = [
        serialize_message(message) for _, message in sent for _ in range(len(link.delays()))
    ]
    assert g.received["imu/data_raw"] == expected


def test_jitter_reorders_and_loses_nothing(graph: Any) -> None:
    g = graph({"jitter": 0.1})
    sent = [serialize_message(message) for _, message in samples(500)]
    g.send(samples(500))
    received = g.received["imu/data_raw"]
    assert received != sent
    assert sorted(received) == sorted(sent)


def test_delay_is_waited_for(graph: Any) -> None:
    g = graph({"delay": 0.5})
    g.arrivals.clear()
    begin = time.monotonic()
    g.send(samples(3))
    assert g.arrivals[0] - begin >= 0.5


def test_diagnostics_tell_what_was_lost_and_doubled(graph: Any) -> None:
    g = graph({"loss": 0.2, "duplication": 0.2})
    g.send(samples(200))
    name = f"{g.namespace}/insdvl_relay"
    g.until_reported(name, times=2)
    told = g.diagnostics.report(name).values
    lost, doubled = g.relay.lost["imu/data_raw"], g.relay.doubled["imu/data_raw"]
    assert (told["lost imu/data_raw"], told["doubled imu/data_raw"]) == (str(lost), str(doubled))
    assert told["received sent/imu/data_raw"] == "200"
    assert told["sent imu/data_raw"] == str(200 - lost + doubled)


def by_stamp(received: list[Odometry]) -> dict[int, bytes]:
    return {stamp_of(message): serialize_message(message) for message in received}


@pytest.mark.long
def test_behind_duplication_and_reordering_the_filter_gives_the_same_bits(graph: Any) -> None:
    """The stamps of a burst are farther apart than the default max_delay: it is longer here.

    A twentieth of a second is a quarter of the burst at most, however fast the machine.
    """
    delays = {"max_delay": 14.0, "output_delay": 14.0}
    items = mission_items(mission(18.0))
    direct = graph(None, {**FILTER, **delays})
    direct.send(items)
    behind = graph({"jitter": 0.05, "delay": 0.05, "duplication": 0.3}, {**FILTER, **delays})
    behind.send(items)
    assert behind.relay.doubled["imu/data_raw"] > 200
    order = [data[4:12] for data in behind.received["imu/data_raw"]]
    assert order != sorted(order)
    expected = by_stamp(direct.received["odometry/filtered"])
    assert len(expected) == 400
    assert by_stamp(behind.received["odometry/filtered"]) == expected
    assert behind.filter.rejected == {
        Refused(topic, "duplicate"): count for topic, count in behind.relay.doubled.items()
    }


@pytest.mark.parametrize("loss", [pytest.param(0.01, marks=pytest.mark.long), 0.1])
def test_behind_loss_the_missing_samples_are_told_and_the_velocity_stays_good(
    graph: Any, loss: float
) -> None:
    flown = mission(20.0)
    g = graph({"loss": loss}, FILTER)
    g.send(mission_items(flown))

    def told() -> bool:
        return any(
            change.cause == "imu" and "% of the samples are missing" in change.status.message
            for change in g.diagnostics.changes
        )

    g.until(told)
    link = links(RelayParameters(loss=loss))["imu/data_raw"]
    arrived = np.array([bool(link.delays()) for _ in flown.stamps_ns])
    (there,) = np.nonzero(arrived)
    late_ns = flown.stamps_ns[there[-1]] - 2 * NS  # from here on a sample may still be late
    settled = there[flown.stamps_ns[there] < late_ns]
    missing = settled[-1] - settled[0] + 1 - settled.size
    assert missing > 0.5 * loss * arrived.size
    counts = g.filter.counts()
    assert counts["samples expected"] - counts["samples arrived"] == missing
    assert counts["gaps"] == 0  # what is lost by chance is shorter than imu.max_gap
    received = g.received["odometry/filtered"]
    kept = flown.stamps_ns[arrived]
    assert [stamp_of(m) for m in received] == kept.tolist()
    v = np.array([[getattr(m.twist.twist.linear, a) for a in "xyz"] for m in received])
    truth = np.einsum("kji,kj->ki", flown.truth.C_n_b, flown.truth.v_n)[arrived] @ ENU.body
    assert np.sqrt(np.mean(np.sum((v - truth) ** 2, axis=1))) < 0.3
    assert g.filter.rejected == {}


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"topics": ["imu/data"]}, "'topics' must be of imu/data_raw, .*, got imu/data$"),
        ({"topics": ["gps/fix", "gps/fix"]}, "'topics' must name a topic once"),
        ({"loss": 1.5}, "'loss' must be >= 0 and <= 1, got 1.5"),
        ({"prefix": ""}, "'prefix' must not be empty"),
    ],
)
def test_what_it_cannot_be_is_named(graph: Any, settings: dict[str, Any], expected: str) -> None:
    with pytest.raises(ParameterError, match=expected):
        graph(settings)


@pytest.mark.parametrize(("namespace", "prefix"), [("/", "/"), ("/auv", "/auv/")])
def test_a_relay_that_would_hear_itself_is_refused(namespace: str, prefix: str) -> None:
    context = Context()
    context.init()
    try:
        with pytest.raises(ParameterError, match=rf"got '{prefix}': .* on {prefix}dvl/velocity, "):
            Relay(
                namespace=namespace,
                context=context,
                parameter_overrides=[Parameter("prefix", value=prefix)],
            )
    finally:
        context.shutdown()
