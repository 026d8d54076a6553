"""The simulator node in a graph: what it sends, when it starts, and how it ends."""

import os
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from graphs import RELIABLE, Graph
from nav_msgs.msg import Odometry
from ros_messages import stamp_of
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from starts import Start, starts

from insdvl.messages import convert as messages
from insdvl.messages.dvl import dvl
from insdvl.messages.heading import heading
from insdvl.messages.topics import HEADING
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.mission import mission_of
from insdvl.simulation.parameters import SimulatorParameters
from ros_insdvl_sim import player
from ros_insdvl_sim.simulator import Simulator

TOPICS = {
    "imu/data_raw": Imu,
    "dvl/velocity": TwistStamped,
    "ground_truth/odometry": Odometry,
    "ground_truth/process_noise": Imu,
    "ground_truth/measurement_noise": TwistWithCovarianceStamped,
}
NODE = "/auv/insdvl_simulator"
DEADLINE = 300.0  # s; only a hang takes so long
FAST = {"rate_factor": 1000.0, "min_subscribers": 1, "duration": 4.0}


class SimulatorGraph(Graph):
    """A node that listens, and simulators that it makes."""

    def __init__(self) -> None:
        super().__init__("/auv")
        self.received = {topic: self.keep(kind, topic) for topic, kind in TOPICS.items()}

    def simulator(self, **parameters: Any) -> Simulator:
        return self.make(Simulator, **parameters)

    def play(self, **parameters: Any) -> Simulator:
        """Run a mission to its end, until all that was sent is here."""
        node = self.simulator(**parameters)
        self.until(node.finished.done)
        assert node.finished.result() == 0
        self.until(
            lambda: all(
                len(self.received[topic]) >= output.count for topic, output in node.outputs.items()
            )
        )
        return node

    def take(self) -> dict[str, list[Any]]:
        taken = {topic: list(messages) for topic, messages in self.received.items()}
        for topic in self.received:
            self.received[topic].clear()
        return taken


@pytest.fixture
def graph(managed):
    return managed(SimulatorGraph())


def stamps(received: list[Any]) -> list[int]:
    return [stamp_of(message) for message in received]


def content(message: Any) -> str:
    """Everything in a message but its stamp."""
    message.header.stamp.sec = message.header.stamp.nanosec = 0
    return str(message)


def test_stamps_frames_and_counts(graph):
    graph.play(**(FAST | {"duration": 12.0}), start_stamp=100.0, **{"dvl.outages": [3.0, 5.0]})
    received = graph.take()
    start = 100 * NS
    samples = [start + k * 10_000_000 for k in range(1, 1201)]
    assert stamps(received["imu/data_raw"]) == samples
    assert stamps(received["ground_truth/odometry"]) == [start, *samples]
    assert stamps(received["dvl/velocity"]) == [
        start + k * NS for k in (1, 2, 5, 6, 7, 8, 9, 10, 11, 12)
    ]
    assert stamps(received["ground_truth/measurement_noise"]) == stamps(received["dvl/velocity"])
    assert set(range(start, start + 12 * NS, NS)) <= set(
        stamps(received["ground_truth/process_noise"])
    )
    frames = {topic: {m.header.frame_id for m in received[topic]} for topic in TOPICS}
    assert frames == {
        "imu/data_raw": {"base_link"},
        "dvl/velocity": {"dvl_link"},
        "ground_truth/odometry": {"odom"},
        "ground_truth/process_noise": {"base_link"},
        "ground_truth/measurement_noise": {"dvl_link"},
    }
    assert {m.child_frame_id for m in received["ground_truth/odometry"]} == {"base_link"}


def test_a_heading_sensor_is_published_where_its_rate_asks_for_it(graph):
    graph.received[HEADING] = graph.keep(Imu, HEADING)
    graph.play(**FAST, **{"heading.rate": 2.0}, start_stamp=100.0)
    received = graph.take()[HEADING]
    assert stamps(received) == [100 * NS + k * NS // 2 for k in range(1, 9)]
    mission = mission_of(build(SimulatorParameters, {"duration": 4.0, "heading.rate": 2.0}))
    found = [heading(message, FilterParameters(), (0.0, 0.0, 0.0)).C_n_b for message in received]
    np.testing.assert_allclose(found, mission.attitude, atol=1e-12)
    assert {m.header.frame_id for m in received} == {"base_link"}
    assert {m.angular_velocity_covariance[0] for m in received} == {-1.0}


@pytest.mark.parametrize("convention", ["enu", "ned"])
def test_messages_carry_the_mission_in_the_axes_of_the_stream(graph, convention):
    parameters = {"duration": 4.0, "trajectory": "spiral_dive", "frame_convention": convention}
    graph.play(**(FAST | parameters))
    received = graph.take()
    mission = mission_of(build(SimulatorParameters, parameters))
    axes = CONVENTIONS[convention]

    samples = [messages.imu(message, axes) for message in received["imu/data_raw"]]
    np.testing.assert_array_equal([s.f_b for s in samples], mission.f_b)
    np.testing.assert_array_equal([s.w_ib_b for s in samples], mission.w_ib_b)
    pings = [dvl(message, axes) for message in received["dvl/velocity"]]
    np.testing.assert_array_equal([ping.v_d for ping in pings], mission.v_d)

    states = [messages.initial(m, axes, once=True) for m in received["ground_truth/odometry"]]
    truth = mission.truth
    np.testing.assert_array_equal(states[0].p_o, mission.initial.p_o[0])
    np.testing.assert_array_equal([s.p_o for s in states[1:]], truth.p_o)
    np.testing.assert_allclose([s.C_o_b for s in states[1:]], truth.C_o_b, atol=1e-14)
    v_b = np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n)
    np.testing.assert_allclose([s.v for s in states[1:]], v_b, atol=1e-14)
    turn = [m.twist.twist.angular for m in received["ground_truth/odometry"][1:]]
    np.testing.assert_allclose([[w.x, w.y, w.z] for w in turn], truth.w_nb_b @ axes.body)
    assert not any(m.pose.covariance.any() for m in received["ground_truth/odometry"])


def test_default_axes_are_those_of_rep_103(graph):
    """At rest, heading 30 deg from north: 60 deg from east; gravity's reaction points up."""
    graph.play(**(FAST | {"trajectory": "static", "duration": 2.0}))
    received = graph.take()
    up = np.mean([m.linear_acceleration.z for m in received["imu/data_raw"]])
    assert up == pytest.approx(9.795, abs=0.05)
    q = received["ground_truth/odometry"][0].pose.pose.orientation
    assert np.degrees(2.0 * np.arctan2(q.z, q.w)) == pytest.approx(60.0)
    assert [q.x, q.y] == pytest.approx([0.0, 0.0])


def test_a_dive_towards_north_by_east(graph):
    """10 deg east of north and slightly down: in ENU x is small, y large, z falls."""
    graph.play(**(FAST | {"trajectory": "lawn_mower", "duration": 12.0}))
    end = graph.take()["ground_truth/odometry"][-1].pose.pose.position
    assert end.x == pytest.approx(3.5, abs=0.5)
    assert end.y == pytest.approx(19.0, abs=1.0)
    assert -0.5 < end.z < -0.03


def test_covariances(graph):
    graph.play(**FAST, seed=3)
    received = graph.take()
    for message in received["imu/data_raw"]:
        assert message.orientation_covariance[0] == -1.0
        assert not message.linear_acceleration_covariance.any()
        assert not message.angular_velocity_covariance.any()
    mission = mission_of(build(SimulatorParameters, {"duration": 4.0, "seed": 3}))
    expected_stamps, variances = mission.process_noise()
    noise = received["ground_truth/process_noise"]
    assert stamps(noise) == expected_stamps.tolist()
    for message, q in zip(noise, variances, strict=True):
        assert message.orientation_covariance[0] == -1.0
        np.testing.assert_array_equal(
            message.linear_acceleration_covariance.reshape(3, 3), np.diag(q[:3])
        )
        np.testing.assert_array_equal(
            message.angular_velocity_covariance.reshape(3, 3), np.diag(q[3:])
        )


def test_the_true_noise_of_each_ping(graph):
    """It depends on the bottom and the altitude."""
    parameters = {"noise.profile": "realistic", "duration": 8.0, "seed": 3}
    graph.play(**(FAST | parameters))
    mission = mission_of(build(SimulatorParameters, parameters))
    found = graph.take()["ground_truth/measurement_noise"]
    assert len(np.unique(mission.r[:, 0])) > 1
    blocks = np.array([m.twist.covariance.reshape(6, 6) for m in found])
    np.testing.assert_array_equal(blocks[:, :3, :3], [np.diag(r) for r in mission.r])
    assert not blocks[:, 3:].any()
    assert stamps(found) == mission.dvl_stamps_ns.tolist()


def test_covariance_of_each_sample_on_demand(graph):
    parameters = {"noise.profile": "on-off", "noise.half_period": 1.0, "duration": 4.0}
    graph.play(**(FAST | parameters), publish_covariance=True)
    q = mission_of(build(SimulatorParameters, parameters)).q
    assert len(np.unique(q[:, 0])) == 2
    for message, variances in zip(graph.take()["imu/data_raw"], q, strict=True):
        np.testing.assert_array_equal(message.linear_acceleration_covariance[::4], variances[:3])
        np.testing.assert_array_equal(message.angular_velocity_covariance[::4], variances[3:])


def test_two_runs_of_a_seed_are_equal_to_the_bit(graph):
    runs = []
    for seed, start_stamp in ((5, 0.0), (5, 1000.0), (6, 0.0)):
        graph.play(**FAST, seed=seed, start_stamp=start_stamp)
        runs.append({topic: [content(m) for m in ms] for topic, ms in graph.take().items()})
    assert runs[0] == runs[1]
    assert runs[0]["imu/data_raw"] != runs[2]["imu/data_raw"]
    assert runs[0]["ground_truth/odometry"] == runs[2]["ground_truth/odometry"]


def test_order_of_the_messages_of_one_stamp(graph):
    node = graph.simulator(duration=20.0, min_subscribers=1000)
    rank = {topic: k for k, topic in enumerate(TOPICS)}
    rank["dvl/velocity"] = len(rank)  # a measurement comes after all that leads to its state
    order = [(time_ns, rank[topic]) for time_ns, topic, _ in node.timeline()]
    assert order == sorted(order)
    assert order[0] == (order[0][0], rank["ground_truth/odometry"])


@pytest.mark.parametrize(("period", "most"), [(player.CLOCK_PERIOD, 402), (1e6, 2)])
def test_clock_follows_the_stamps_and_keeps_its_period(graph, monkeypatch, period, most):
    monkeypatch.setattr(player, "CLOCK_PERIOD", period)
    clocks = graph.keep(Clock, "/clock")
    graph.play(**(FAST | {"rate_factor": 5.0}))

    def told() -> list[int]:
        return [clock.clock.sec * NS + clock.clock.nanosec for clock in clocks]

    graph.until(lambda: told()[-1:] == [4 * NS])
    assert told() == sorted(told())
    assert told()[0] == 0
    assert 2 <= len(told()) <= most


def test_clock_is_told_at_no_more_than_50_hz():
    assert player.CLOCK_PERIOD >= 1.0 / 50.0


def test_real_time_has_stamps_of_the_wall_and_no_clock(graph):
    before, begin = time.time_ns(), time.monotonic()
    node = graph.play(duration=2.0, min_subscribers=1)
    assert time.monotonic() - begin >= 2.0
    first = stamps(graph.received["ground_truth/odometry"])[0]
    assert before < first < time.time_ns() - 2 * NS
    assert stamps(graph.received["imu/data_raw"]) == [first + k * 10_000_000 for k in range(1, 201)]
    assert node.count_publishers("/clock") == 0


def test_factor_sets_the_pace(graph):
    begin = time.monotonic()
    graph.play(**(FAST | {"rate_factor": 4.0}))
    assert time.monotonic() - begin >= 1.0
    assert stamps(graph.received["imu/data_raw"])[-1] == 4 * NS


def test_waits_for_its_subscribers(graph):
    node = graph.simulator(**(FAST | {"min_subscribers": 2}))
    graph.until(lambda: node.outputs["imu/data_raw"].listeners == 1)
    begin = time.monotonic()
    graph.until(lambda: time.monotonic() - begin > 2.0 * player.SETTLE_TIME)
    assert not any(graph.received.values())
    late = graph.keep(Imu, "imu/data_raw")
    graph.until(lambda: len(late) == 400)
    assert stamps(late)[0] == 10_000_000


def test_refuses_to_start_beside_another_publisher(graph, capsys):
    graph.peer.create_publisher(Imu, "imu/data_raw", RELIABLE)
    node = graph.simulator(**FAST, exclusive_wait=60.0)
    graph.until(node.finished.done)
    assert node.finished.result() == 1
    assert "/auv/imu/data_raw already has a publisher" in capsys.readouterr().err
    assert not any(graph.received.values())


def test_starts_when_nobody_else_publishes(graph):
    graph.peer.create_publisher(Imu, "/elsewhere/imu/data_raw", RELIABLE)
    node = graph.play(**FAST, exclusive_wait=2.0)
    assert node.outputs["imu/data_raw"].count == 400


def test_tells_what_it_sent(graph, capsys):
    graph.play(**FAST)
    assert (
        "sent: imu/data_raw 400, dvl/velocity 4, ground_truth/odometry 401, "
        "ground_truth/process_noise"
    ) in capsys.readouterr().out


def test_what_did_not_arrive_is_an_error(graph, capsys, monkeypatch):
    monkeypatch.setattr("ros_insdvl.endpoints.Output.acknowledged", lambda self, timeout: False)
    monkeypatch.setattr(player, "ACKNOWLEDGE_TIME", 0.01)
    node = graph.simulator(**(FAST | {"duration": 1.0}))
    graph.until(node.finished.done)
    assert node.finished.result() == 1
    assert "not all arrived within 0.01 s on imu/data_raw" in capsys.readouterr().err


def test_a_failure_while_playing_ends_the_node(graph, capsys, monkeypatch):
    def broken(self):
        raise OSError("no timeline")

    monkeypatch.setattr(Simulator, "timeline", broken)
    node = graph.simulator(**FAST)
    graph.until(node.finished.done)
    assert node.finished.result() == 1
    assert "insdvl_simulator failed: OSError('no timeline')" in capsys.readouterr().err


def test_diagnostics(graph):
    node = graph.simulator()

    def values() -> dict[str, str]:
        return graph.diagnostics.report(NODE).values

    graph.until(lambda: int(values().get("sent imu/data_raw", 0)) > 0)
    assert next(iter(graph.diagnostics.report(NODE).statuses)) == "mission"
    assert float(values()["mission time [s]"]) > 0.0
    assert float(values()["mission duration [s]"]) == 330.0
    assert node.outputs["imu/data_raw"].count >= int(values()["sent imu/data_raw"])


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"sead": 3}, r"unknown parameter 'sead'"),
        ({"seed": 3.0}, r"'seed' must be a"),
        ({"rate_factor": -1.0}, r"'rate_factor' must be"),
        ({"dvl.outages": [3.0]}, r"'dvl\.outages' must be pairs"),
        ({"noise.profile": "file", "noise.file": "/absent"}, r"'noise\.file': cannot read"),
        ({"duration": 1e6}, r"'duration': duration must be within"),
    ],
)
def test_wrong_parameter_is_named_before_anything_is_published(graph, parameters, message):
    with pytest.raises(ParameterError, match=message):
        graph.simulator(**parameters)
    assert graph.peer.count_publishers("imu/data_raw") == 0


def start(*parameters: str) -> "subprocess.Popen[str]":
    arguments = [part for parameter in parameters for part in ("-p", parameter)]
    module = ["-m", "ros_insdvl_sim.simulator"]
    return subprocess.Popen(
        [sys.executable, *module, "--ros-args", "-r", "__ns:=/auv", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ,
    )


WRONG = [("sead:=3", "sead"), ("seed:=one", "seed"), ("imu.rate:=0.0", "imu.rate")]


@pytest.fixture(scope="module")
def started() -> list[Start]:
    """The simulator, started with each of the wrong parameters."""
    arguments = [["-p", parameter] for parameter, _ in WRONG]
    return starts("ros_insdvl_sim.simulator", arguments)


@pytest.mark.parametrize("k", range(len(WRONG)), ids=[named for _, named in WRONG])
def test_a_start_with_a_wrong_parameter(started, k):
    assert started[k].code == 2
    assert f"'{WRONG[k][1]}'" in started[k].err
    assert "Traceback" not in started[k].err
    assert started[k].out == ""


def test_process_plays_to_the_end(graph):
    process = start("duration:=5.0", "rate_factor:=100.0", "min_subscribers:=1")
    graph.until(lambda: len(graph.received["imu/data_raw"]) == 500)
    out, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 0, err
    assert "sent: imu/data_raw 500, dvl/velocity 5, ground_truth/odometry 501" in out


def test_process_ends_cleanly_on_a_double_interrupt(graph):
    process = start("min_subscribers:=1")
    graph.until(lambda: len(graph.received["imu/data_raw"]) > 20)
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 0, err
    assert "Traceback" not in err
