"""The filter node in a graph: what it publishes, and what it does with whatever it is sent."""

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from graphs import BEST_EFFORT, RELIABLE, Graph, reliable
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_messages import (
    STEP_NS,
    dvl_message,
    imu_message,
    odometry_message,
    sample_at_rest,
    sensor_messages,
    stamp_of,
)
from sensor_msgs.msg import Imu, NavSatFix, NavSatStatus
from std_srvs.srv import Trigger
from told import TOLD

from insdvl import files
from insdvl.messages import convert as messages
from insdvl.messages.dvl import dvl
from insdvl.messages.make import flat_covariance
from insdvl.navigation.events import NS
from insdvl.navigation.geometry import odom
from insdvl.navigation.geometry.frames import ENU
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import trajectory_named
from insdvl.timeline.recorded import fold_arrays
from ros_insdvl.conversions import time_of
from ros_insdvl.filter import FilterNode
from ros_insdvl.status.heard import OK, WARN, HeardStatus

NODE = "/auv/insdvl_filter"
START_NS = 1_700_000_000_250_000_000
Q_F, Q_W = (0.04, 0.01, 0.02), (0.002, 0.004, 0.001)

#: The filter starts at the first sample, unless a test says otherwise.
STARTED = {n: v for n, v in TOLD.items() if n == "initial.mode" or n.endswith("_std")}
INPUTS = {
    "imu/data_raw": Imu,
    "dvl/velocity": TwistStamped,
    "dvl/velocity_cov": TwistWithCovarianceStamped,
    "process_noise": Imu,
    "ground_truth/process_noise": Imu,
    "set_odometry": Odometry,
    "start": Odometry,
    "gps/fix": NavSatFix,
}
OUTPUTS = {
    "odometry/filtered": Odometry,
    "imu/bias": Imu,
    "gps/filtered": NavSatFix,
    "dvl/innovation": TwistWithCovarianceStamped,
}


@cache
def mission(duration: float = 8.0) -> Mission:
    return simulate(
        trajectory_named("auv"), SCENARIOS["varying"], seed=5, duration=duration, start_ns=START_NS
    )


def noise_message(stamp_ns: int, q_f: Any = Q_F, q_w: Any = Q_W) -> Imu:
    message = imu_message(stamp_ns)
    message.orientation_covariance[0] = -1.0
    message.linear_acceleration_covariance = flat_covariance(np.diag(q_f), 3)
    message.angular_velocity_covariance = flat_covariance(np.diag(q_w), 3)
    return message


def mission_messages(m: Mission) -> list[tuple[str, Any]]:
    """Topics and messages of a mission, by stamp, with a process noise every 1.7 s."""
    items = sensor_messages(m, -3_000_000)  # between two samples, so that the sample has to be cut
    for k, stamp in enumerate(range(START_NS + 2 * NS, int(m.stamps_ns[-1]), 17 * NS // 10)):
        message = noise_message(stamp, np.array(Q_F) / (k + 1))
        items.append((stamp, "process_noise", message))
    return [(topic, message) for _, topic, message in sorted(items, key=lambda item: item[0])]


def offline(parameters: dict[str, Any], sent: list[tuple[str, Any]]) -> list[Any]:
    """Odometry at every IMU stamp, by the filter without ROS."""
    samples = sorted(
        (messages.imu(m, ENU) for topic, m in sent if topic == "imu/data_raw"),
        key=lambda sample: sample.stamp_ns,
    )
    convert = {"dvl/velocity": dvl, "process_noise": messages.process_noise}
    events = [convert[topic](m, ENU) for topic, m in sent if topic in convert]
    result = fold_arrays(
        build(FilterParameters, TOLD | parameters),
        np.array([s.stamp_ns for s in samples]),
        np.array([s.f_b for s in samples]),
        np.array([s.w_ib_b for s in samples]),
        events,
    )
    return [odometry(result.filter, result.states, k) for k in range(len(samples))]


class FilterGraph(Graph):
    """The filter in the namespace /auv, and a peer that talks to it."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__("/auv")
        topics = ("imu/data_raw", "dvl/velocity", "dvl/velocity_cov", "start", "gps/fix")
        self.filter = self.make(
            FilterNode, **{**reliable("/auv", *topics), **STARTED, **parameters}
        )
        self.received = {topic: self.keep(kind, topic) for topic, kind in OUTPUTS.items()}
        self.publishers = {
            topic: self.peer.create_publisher(INPUTS[topic], topic, RELIABLE)
            for topic in self.filter.received
        }
        self.until(
            lambda: (
                all(p.get_subscription_count() for p in self.publishers.values())
                and all(output.listeners for output in self.filter.outputs.values())
            )
        )

    def send(self, *items: tuple[str, Any]) -> None:
        """Publish one by one, each when the last has been handled: this order and no other."""
        for topic, message in items:
            target = self.filter.received[topic] + 1
            self.publishers[topic].publish(message)
            self.until(lambda t=topic, n=target: self.filter.received[t] == n)
        self.until(
            lambda: all(
                len(self.received[topic]) == output.count
                for topic, output in self.filter.outputs.items()
            )
        )

    def statuses(self) -> tuple[dict[str, HeardStatus], dict[str, str]]:
        """The statuses by cause, as of now, and the values of all of them."""
        self.until_reported(NODE, times=2)  # the first may have been under way
        report = self.diagnostics.report(NODE)
        return report.statuses, report.values

    def odometry(self) -> list[Odometry]:
        return self.received["odometry/filtered"]


@pytest.fixture
def graph(managed: Any) -> Callable[..., FilterGraph]:
    return lambda **parameters: managed(FilterGraph(**parameters))


def numbers(message: Odometry) -> np.ndarray:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    v, w = message.twist.twist.linear, message.twist.twist.angular
    return np.concatenate(
        [
            [p.x, p.y, p.z, q.x, q.y, q.z, q.w, v.x, v.y, v.z, w.x, w.y, w.z],
            message.pose.covariance,
            message.twist.covariance,
        ]
    )


def expected_numbers(output: Any) -> np.ndarray:
    return np.concatenate(
        [
            output.position,
            output.quaternion_xyzw,
            output.twist_linear,
            output.twist_angular,
            output.pose_covariance.ravel(),
            output.twist_covariance.ravel(),
        ]
    )


def imu_run(first: int, last: int) -> list[tuple[str, Any]]:
    """Samples of a vehicle at rest, by number."""
    return [("imu/data_raw", sample_at_rest(START_NS, k)) for k in range(first, last)]


def test_one_odometry_per_sample_with_frames_and_stamps(graph: Any) -> None:
    g = graph()
    m = mission()
    g.send(*(item for item in mission_messages(m) if item[0] != "process_noise"))
    received = g.odometry()
    assert [stamp_of(message) for message in received] == m.stamps_ns.tolist()
    assert {message.header.frame_id for message in received} == {"odom"}
    assert {message.child_frame_id for message in received} == {"base_link"}
    biases = g.received["imu/bias"]
    seconds = [stamp_of(message) // NS for message in biases]
    assert seconds == sorted(set((m.stamps_ns // NS).tolist()))
    for message in biases:
        assert message.header.frame_id == "imu_link"
        assert message.orientation_covariance[0] == -1.0
        assert (message.linear_acceleration_covariance[::4] > 0.0).all()
        assert (message.angular_velocity_covariance[::4] > 0.0).all()
    innovations = g.received["dvl/innovation"]
    assert [stamp_of(i) for i in innovations] == (m.dvl_stamps_ns - 3_000_000).tolist()
    for message in innovations:
        assert message.header.frame_id == "dvl_link"
        S = message.twist.covariance.reshape(6, 6)[:3, :3]
        assert np.linalg.eigvalsh(S)[0] > 0.01  # at least the DVL's own variance


def test_velocity_and_its_covariance_are_in_body_axes(graph: Any) -> None:
    g = graph(**{"initial.mode": "set_odometry"})
    start = odometry_message(START_NS)
    start.twist.covariance[[0, 7, 14]] = [0.01, 0.04, 0.09]
    start.twist.covariance[[21, 28, 35]] = 1e-6
    start.pose.covariance[[0, 7, 14]] = [1.0, 4.0, 9.0]
    start.pose.covariance[[21, 28, 35]] = [1e-4, 4e-4, 9e-4]
    g.send(("set_odometry", start), *imu_run(0, 2))
    message = g.odometry()[0]
    twist = message.twist.twist.linear
    np.testing.assert_allclose([twist.x, twist.y, twist.z], [1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(message.twist.covariance[[0, 7, 14]], [0.01, 0.04, 0.09], rtol=1e-9)
    np.testing.assert_allclose(
        message.pose.covariance[::7], [1.0, 4.0, 9.0, 1e-4, 4e-4, 9e-4], rtol=1e-9
    )
    # Heading west: forward is -x of odom.
    assert g.odometry()[1].pose.pose.position.x == pytest.approx(-0.01, abs=1e-4)
    for message in g.odometry():
        for P in (message.pose.covariance, message.twist.covariance):
            P = P.reshape(6, 6)
            assert (P == P.T).all()
            assert np.linalg.eigvalsh(P)[0] > 0.0


@pytest.mark.parametrize("seed", [1, 2])
def test_delayed_output_is_the_offline_result_whatever_the_order(graph: Any, seed: int) -> None:
    parameters = {
        "output_delay": 0.6,
        "process_noise.source": "external",
        "gate.enabled": False,
        "dvl.lever_arm": (0.4, -0.2, 0.3),
    }
    m = mission(5.0)
    sent = mission_messages(m)
    # A message arrives up to 0.5 s late; so the order is any within that.
    rng = np.random.default_rng(seed)
    arrival = [stamp_of(message) + rng.uniform(0.0, 0.5 * NS) for _, message in sent]
    shuffled = [sent[k] for k in np.argsort(arrival)]
    assert shuffled != sent
    g = graph(**{k: list(v) if isinstance(v, tuple) else v for k, v in parameters.items()})
    g.send(*shuffled)
    expected = {output.stamp_ns: output for output in offline(parameters, sent)}
    received = g.odometry()
    assert len(received) == 5 * 100 - 60
    for message in received:
        np.testing.assert_array_equal(
            numbers(message), expected_numbers(expected[stamp_of(message)])
        )


def test_learned_noise_applies_from_its_stamp_on(graph: Any) -> None:
    parameters = {"process_noise.source": "external"}
    at = START_NS + 5 * STEP_NS
    q = ("process_noise", noise_message(at, (1.0, 1.0, 1.0)))
    g = graph(**parameters)
    g.send(*imu_run(1, 6), q, *imu_run(6, 10))
    without = offline(parameters, imu_run(1, 10))
    pairs = zip(g.odometry(), without, strict=True)
    same = [(numbers(m) == expected_numbers(o)).all() for m, o in pairs]
    assert same == [True] * 5 + [False] * 4
    # One step with 1 (m/s^2)^2 per sample adds (0.01 s)^2 to the variance of the velocity; the
    # uncertain tilt adds a little.
    before, after = (m.twist.covariance[0] for m in g.odometry()[4:6])
    assert after - before == pytest.approx(1e-4, rel=0.1)


def test_unknown_noise_is_never_zero_noise(graph: Any) -> None:
    parameters = {"process_noise.source": "external"}
    unknown = noise_message(START_NS + 2 * STEP_NS, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    g = graph(**parameters)
    g.send(*imu_run(1, 3), ("process_noise", unknown), *imu_run(3, 6))
    expected = offline(parameters, imu_run(1, 6))
    for message, output in zip(g.odometry(), expected, strict=True):
        np.testing.assert_array_equal(numbers(message), expected_numbers(output))


def test_dead_tuner_falls_back_to_nominal_and_comes_back(graph: Any) -> None:
    g = graph(**{"process_noise.source": "external", "q_timeout": 0.5})
    g.send(*imu_run(1, 3))
    status, values = g.statuses()
    assert "Q is nominal" in status["process noise"].message
    assert values["Q age [s]"] == "nominal"
    assert float(values["Q sigma f_x [m/s^2]"]) == pytest.approx(0.1)
    g.send(("process_noise", noise_message(START_NS + 2 * STEP_NS)), *imu_run(3, 20))
    status, values = g.statuses()
    assert status["process noise"].level == OK
    assert float(values["Q sigma f_x [m/s^2]"]) == pytest.approx(0.2)
    assert float(values["Q age [s]"]) == pytest.approx(0.17)
    g.send(*imu_run(20, 70))
    status, values = g.statuses()
    assert status["process noise"].level == WARN
    assert "nominal" in status["process noise"].message
    assert values["q_timeouts"] == "1"
    assert float(values["Q sigma f_x [m/s^2]"]) == pytest.approx(0.1)
    g.send(("process_noise", noise_message(START_NS + 69 * STEP_NS)), *imu_run(70, 72))
    status, values = g.statuses()
    assert float(values["Q sigma f_x [m/s^2]"]) == pytest.approx(0.2)
    assert status["process noise"].level == OK


def test_noise_from_the_imu_messages_themselves(graph: Any) -> None:
    g = graph(**{"process_noise.source": "message"})
    sent = []
    for _, message in imu_run(1, 5):
        message.linear_acceleration_covariance = flat_covariance(np.diag(Q_F), 3)
        message.angular_velocity_covariance = flat_covariance(np.diag(Q_W), 3)
        sent.append(("imu/data_raw", message))
    g.send(*sent)
    _, values = g.statuses()
    sigmas = [float(values[f"Q sigma f_{axis} [m/s^2]"]) for axis in "xyz"]
    np.testing.assert_allclose(sigmas, np.sqrt(Q_F), rtol=1e-5)


def test_true_noise_comes_from_its_own_topic(graph: Any) -> None:
    g = graph(**{"process_noise.source": "oracle"})
    q = noise_message(START_NS + STEP_NS)
    g.send(*imu_run(1, 3), ("ground_truth/process_noise", q), *imu_run(3, 5))
    _, values = g.statuses()
    assert float(values["Q sigma w_y [rad/s]"]) == pytest.approx(np.sqrt(Q_W[1]), rel=1e-5)


def bad_imu(stamp_ns: int, field: str, axis: str, value: float) -> Imu:
    message = imu_message(stamp_ns)
    setattr(getattr(message, field), axis, value)
    return message


def test_bad_messages_are_counted_by_reason_and_change_nothing(graph: Any) -> None:
    g = graph(**{"gate.enabled": False})
    good = imu_run(1, 301)
    t = START_NS + 300 * STEP_NS
    unmeasured = imu_message(t + 1)
    unmeasured.linear_acceleration_covariance[0] = -1.0
    indefinite = TwistWithCovarianceStamped()
    indefinite.header.stamp = time_of(t)
    indefinite.twist.covariance[[0, 7, 14]] = [1.0, -0.5, 1.0]
    crooked = odometry_message(t)
    crooked.pose.pose.orientation.w = 3.0
    bad = [
        ("imu/data_raw", bad_imu(t + 1, "linear_acceleration", "x", np.nan)),
        ("imu/data_raw", bad_imu(t + 2, "angular_velocity", "z", np.inf)),
        ("imu/data_raw", unmeasured),
        ("imu/data_raw", good[150][1]),
        ("imu/data_raw", imu_message(START_NS - 5 * NS)),
        ("dvl/velocity", dvl_message(t, (np.nan, 0.0, 0.0))),
        ("dvl/velocity", dvl_message(START_NS - 5 * NS)),
        ("dvl/velocity_cov", indefinite),
        ("set_odometry", crooked),
    ]
    g.send(*good)
    before = len(g.odometry())
    g.send(*bad)
    assert len(g.odometry()) == before == 300
    _, values = g.statuses()
    rejected = {key: int(n) for key, n in values.items() if key.startswith("rejected ")}
    assert rejected == {
        "rejected imu/data_raw: not_finite": 2,
        "rejected imu/data_raw: no_data": 1,
        "rejected imu/data_raw: duplicate": 1,
        "rejected imu/data_raw: too_late": 1,
        "rejected dvl/velocity: not_finite": 1,
        "rejected dvl/velocity: too_late": 1,
        "rejected dvl/velocity_cov: bad_covariance": 1,
        "rejected set_odometry: bad_quaternion": 1,
    }
    more = imu_run(301, 310)
    g.send(*more)
    expected = offline({}, good + more)
    for message, output in zip(g.odometry(), expected, strict=True):
        np.testing.assert_array_equal(numbers(message), expected_numbers(output))
        assert np.isfinite(numbers(message)).all()


def test_gated_measurement_is_counted_and_published(graph: Any) -> None:
    g = graph()
    g.send(*imu_run(1, 6), ("dvl/velocity", dvl_message(START_NS + 5 * STEP_NS, (9.0, 0.0, 0.0))))
    assert g.received["dvl/innovation"][0].twist.twist.linear.x == pytest.approx(9.0, abs=0.01)
    _, values = g.statuses()
    assert values["rejected dvl: gate"] == "1"
    assert values["DVL updates rejected"] == "1"
    assert not any(key.startswith("NIS") for key in values)  # that is of those that were used


def test_gaps_and_rate_are_told(graph: Any) -> None:
    g = graph(**{"imu.rate": 50.0})
    g.send(*imu_run(1, 21), *imu_run(60, 80))
    status, values = g.statuses()
    assert values["gaps"] == "1"
    assert float(values["IMU rate of the stamps [Hz]"]) == pytest.approx(100.0)
    assert "imu.rate is 50 Hz, the stamps have 100.0 Hz" in status["imu"].message
    assert "1 gaps of more than 0.1 s" in status["imu"].message
    assert status["imu"].level == WARN


def test_statuses_are_named_by_node_and_cause(graph: Any) -> None:
    g = graph()
    causes, values = g.statuses()
    assert list(causes) == [
        "initialisation",
        "imu",
        "dvl",
        "process noise",
        "time",
        "frames",
        "output",
        "state file",
        "connections",
        "unexpected errors",
    ]
    assert causes["imu"].level == WARN
    assert "waits for imu/data_raw" in causes["imu"].message
    assert causes["initialisation"].level == WARN
    g.send(*imu_run(1, 21))
    causes, values = g.statuses()
    assert {c: s.message for c, s in causes.items() if s.level != OK} == {}
    assert values["received imu/data_raw"] == values["sent odometry/filtered"] == "20"
    assert not [key for key in values if key.startswith("latency")]  # stamps of another year


COMPILED = """
import sys
import numpy as np
from insdvl.navigation.events import NS, Imu, Initial, ProcessNoise
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.measurements.heading import Heading
from insdvl.timeline.fold import Fold
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.timeline.compilation import compile_fold
from insdvl.watch.alignment.check import AlignmentCheck, compile_check

def signatures():
    modules = [m for name, m in sys.modules.items() if name.startswith("insdvl.")]
    kernels = {k for m in modules for k in vars(m).values() if hasattr(k, "signatures")}
    return {(k.py_func.__qualname__, str(s)) for k in kernels for s in k.signatures}

def late_compilations(values):
    parameters = build(FilterParameters, values)
    compile_fold(parameters)
    compile_check(parameters)
    compiled = signatures()
    assert compiled
    fold, check, rng = Fold(parameters), AlignmentCheck(parameters), np.random.default_rng(1)
    events = []
    if "initial.heading" not in values:  # else the filter starts by itself
        events.append(Initial(NS + 1, np.eye(3), np.zeros(3), np.zeros(3), "body"))
    for k in range(100, 3000):
        noise = 0.1 * rng.standard_normal(6)
        if 500 < k < 800:
            noise[3:] = 0.0
        events.append(Imu(k * NS // 100, np.array([0, 0, -9.8]) + noise[:3], noise[3:]))
        if k % 10 == 0:
            stamp_ns = k * NS // 100 - 3_000_000
            events.append(ProcessNoise(stamp_ns, np.eye(3), np.eye(3)))
            v_d = np.array([0.5 * (1000 < k < 1200), 0.0, 0.01 * noise[0]])
            events.append(Dvl(stamp_ns, v_d, np.eye(3) * 0.01 if k % 20 else None))
            if "depth.topic" in values:
                down = 5.0 + 0.01 * noise[1] + (k == 2000)
                events.append(Depth(stamp_ns + 1_000_000, down, 1e-4 if k % 20 else None))
            if "heading.topic" in values and k > 600:
                events.append(Heading(stamp_ns + 2_000_000, np.eye(3)))
    for event in sorted(events, key=lambda e: (e.stamp_ns, e.kind)):
        assert fold.add(event) is None
        check.add(event)
        fold.take()
    check.findings()
    assert fold.counts["frozen"] > 100
    assert fold.latest is not None
    return sorted({name for name, _ in signatures() - compiled})

# What the first filter compiles too late, and the second needs as well, is found with the first.
for values in (
    {},
    {"dvl.bias_model": "gauss_markov"},
    {"initial.heading": "unknown"},
    {"process_noise.adaptive_factor": True},
    {"depth.topic": "depth", "heading.topic": "heading"},
    {"depth.topic": "depth", "error_state": "ned"},
):
    print(values, late_compilations(values))
"""


def test_nothing_is_compiled_while_it_navigates() -> None:
    """What takes a second would be too late for a vehicle under way."""
    child = subprocess.run(
        [sys.executable, "-c", COMPILED], capture_output=True, text=True, check=False
    )
    assert child.returncode == 0, child.stderr
    assert [line.split()[-1] for line in child.stdout.splitlines()] == ["[]"] * 6, child.stdout


def test_late_set_odometry_moves_the_filter(graph: Any) -> None:
    g = graph()
    g.send(
        *imu_run(1, 5), ("set_odometry", odometry_message(START_NS + 4 * STEP_NS, (7.0, 8.0, 9.0)))
    )
    g.send(*imu_run(5, 6))
    position = g.odometry()[-1].pose.pose.position
    assert [position.x, position.y, position.z] == pytest.approx([7.0, 8.0, 9.0], abs=0.05)


def test_first_odometry_of_a_topic_initialises(graph: Any) -> None:
    g = graph(**{"initial.mode": "topic", "initial.topic": "start", "max_delay": 0.05})
    g.send(*imu_run(1, 4))
    assert g.odometry() == []
    status, _ = g.statuses()
    assert "not initialised, waits for a message on start" in status["initialisation"].message
    g.send(("start", odometry_message(START_NS + 3 * STEP_NS, (7.0, 8.0, 9.0))))
    g.send(*imu_run(4, 6))
    g.send(("start", odometry_message(START_NS + 5 * STEP_NS, (100.0, 0.0, 0.0))))
    g.send(*imu_run(6, 8))
    assert g.odometry()[-1].pose.pose.position.x == pytest.approx(7.0, abs=0.2)
    # What comes after max_delay cannot be the first any more: the filter stops listening.
    g.send(*imu_run(8, 13), ("start", odometry_message(START_NS, (100.0, 0.0, 0.0))))
    g.until(lambda: g.publishers["start"].get_subscription_count() == 0)


def test_origin_from_a_fix(graph: Any) -> None:
    g = graph(**{"origin.source": "topic"})
    g.send(*imu_run(1, 4))
    assert g.odometry() == []
    fix = NavSatFix(latitude=60.0, longitude=10.0, altitude=5.0)
    fix.status.status = NavSatStatus.STATUS_FIX
    fix.header.stamp = time_of(START_NS + 3 * STEP_NS)
    g.send(("gps/fix", fix), *imu_run(4, 8))
    assert g.odometry() != []
    assert g.filter._fold.latest["nav"]["lat_0"] == pytest.approx(np.radians(60.0))


@pytest.mark.parametrize("latitude", [90.0, -90.0, 89.6])
def test_a_fix_at_a_pole_is_refused_by_name(graph: Any, latitude: float) -> None:
    g = graph(**{"origin.source": "topic"})
    fix = NavSatFix(latitude=latitude, longitude=10.0, altitude=5.0)
    fix.status.status = NavSatStatus.STATUS_FIX
    fix.header.stamp = time_of(START_NS + STEP_NS)
    g.send(*imu_run(1, 2), ("gps/fix", fix), *imu_run(2, 8))
    assert g.odometry() == []
    status, _ = g.statuses()
    assert "out_of_range" in status["initialisation"].message


def test_the_position_on_the_earth_is_published(graph: Any) -> None:
    """A start 5 km east and 1 km north of an origin at 60 deg; once a second, as the biases."""
    g = graph(
        **{
            "initial.mode": "set_odometry",
            "origin.latitude_deg": 60.0,
            "origin.longitude_deg": 179.99,
            "origin.height": 40.0,
        }
    )
    start = odometry_message(START_NS, (5000.0, 1000.0, -30.0))
    start.pose.covariance[[0, 7, 14]] = [1.0, 4.0, 9.0]
    g.send(("set_odometry", start), *imu_run(1, 205))
    odometry = {stamp_of(message): message for message in g.odometry()}
    fixes = g.received["gps/filtered"]
    assert len({stamp_of(fix) // NS for fix in fixes}) == len(fixes) >= 2
    for fix in fixes:
        assert fix.header.frame_id == "base_link"
        assert fix.status.status == NavSatStatus.STATUS_FIX
        assert fix.position_covariance_type == NavSatFix.COVARIANCE_TYPE_KNOWN
        place = np.array([*np.radians([fix.latitude, fix.longitude]), fix.altitude])
        origin = np.array([*np.radians([60.0, 179.99]), 40.0])
        position = odometry[stamp_of(fix)].pose.pose.position
        north, east, down = odom.in_odom(place, origin)[0]
        found = [position.x, position.y, position.z]
        np.testing.assert_allclose([east, north, -down], found, atol=1e-6)
    first = fixes[0]
    assert first.longitude < -179.9  # across the date line
    assert first.altitude == pytest.approx(10.0, abs=0.01)
    covariance = first.position_covariance.reshape(3, 3)
    np.testing.assert_allclose(np.diag(covariance), [1.0, 4.0, 9.0], rtol=0.01)
    np.testing.assert_array_equal(covariance, covariance.T)


def test_reset_starts_again(graph: Any) -> None:
    g = graph(**{"initial.mode": "set_odometry"})
    start = ("set_odometry", odometry_message(START_NS + STEP_NS))
    g.send(start, *imu_run(1, 4))
    assert len(g.odometry()) == 3

    def reset() -> str:
        response = g.call(Trigger, "insdvl_filter/reset", Trigger.Request())
        assert response.success
        return str(response.message)

    assert "heading and position are not kept" in reset()
    g.send(*imu_run(4, 6))
    assert len(g.odometry()) == 3
    reset()
    g.send(start, *imu_run(1, 4))  # a recording that begins again
    first, second = g.odometry()[:3], g.odometry()[3:]
    assert [numbers(m).tolist() for m in second] == [numbers(m).tolist() for m in first]


def test_a_reset_of_the_default_mode_keeps_heading_and_position(
    graph: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    """It starts again on the next motion; the DVL says that there is one."""
    g = graph(**{"initial.mode": "auto"})
    g.send(("set_odometry", odometry_message(START_NS + STEP_NS, (7.0, 8.0, 9.0))))
    g.send(*imu_run(1, 30))
    response = g.call(Trigger, "insdvl_filter/reset", Trigger.Request())
    assert "heading and position are kept" in response.message
    g.send(("dvl/velocity", dvl_message(START_NS + 31 * STEP_NS, (1.0, 0.0, 0.0))))
    g.send(*imu_run(30, 140))
    last = g.odometry()[-1]
    assert stamp_of(last) == START_NS + 139 * STEP_NS
    position = last.pose.pose.position
    assert [position.x, position.y] == pytest.approx([7.0, 8.0], abs=1.5)  # 1 m/s since
    assert last.pose.covariance[35] < 0.05
    assert "started: heading kept over the reset" in capfd.readouterr().err


def test_it_goes_on_from_its_state_file_and_forgets_it_at_a_reset(
    graph: Any, tmp_path: Any
) -> None:
    path = tmp_path / "state"
    parameters = {"state_file": str(path), "state_period": 0.1}
    first = graph(**parameters)
    first.send(*imu_run(1, 3), ("set_odometry", odometry_message(START_NS, (7.0, 8.0, 9.0))))
    first.send(*imu_run(3, 51))
    causes, values = first.statuses()
    assert causes["state file"].level == OK
    assert values["state file writes"] == "5"
    first.close()
    second = graph(**parameters)
    # The state of the last write, at 0.41 s, is 0.09 s old.
    second.send(*imu_run(51, 61))
    assert [stamp_of(m) for m in second.odometry()] == [
        START_NS + k * STEP_NS for k in range(51, 61)
    ]
    position = second.odometry()[-1].pose.pose.position
    assert [position.x, position.y, position.z] == pytest.approx([6.4, 8.0, 9.0], abs=0.1)
    causes, _ = second.statuses()
    assert not [c for c, s in causes.items() if s.level != OK]
    second.call(Trigger, "insdvl_filter/reset", Trigger.Request())
    assert not path.exists()


@pytest.mark.parametrize(
    ("changed", "first", "told"),
    [
        ({"initial.velocity": [1.0, 0.0, 0.0]}, 51, "'initial.velocity' was [0.0, 0.0, 0.0]"),
        ({}, 4000, "not within jump_limit"),
        ({"jump_action": "hold"}, 4000, "not within jump_limit"),
    ],
)
def test_a_state_file_that_does_not_fit_is_told_until_it_is_replaced(
    graph: Any,
    tmp_path: Any,
    capfd: pytest.CaptureFixture[str],
    changed: dict[str, Any],
    first: int,
    told: str,
) -> None:
    path = tmp_path / "state"
    before = graph(state_file=str(path))
    before.send(*imu_run(1, 51))
    before.close()
    parameters = {"state_file": str(path), "state_period": 30.0} | changed
    g = graph(**parameters)
    g.send(*imu_run(first, first + 20))
    assert len(g.odometry()) == 20  # of a filter that has just started
    assert g.odometry()[0].pose.covariance[0] == pytest.approx(0.01, rel=0.01)
    assert g.filter._state_file.writes == 1
    (line,) = (text for text in capfd.readouterr().err.splitlines() if "is not used" in text)
    assert told in line
    assert "the filter starts as initial.mode says, 'parameters'" in line


def test_a_full_disk_does_not_stop_the_filter(
    graph: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Any, data: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    g = graph(state_file=str(tmp_path / "state"), state_period=0.1)
    with monkeypatch.context() as broken:
        broken.setattr(files, "write", full)
        g.send(*imu_run(1, 51))
        causes, values = g.statuses()
        assert causes["state file"].level == WARN
        assert "No space left on device" in causes["state file"].message
        assert values["state file failures"] == "5"
        assert len(g.odometry()) == 50
    g.send(*imu_run(51, 71))
    causes, values = g.statuses()
    assert causes["state file"].level == OK
    assert len(g.odometry()) == 70


def test_a_time_that_is_left_is_published_to_its_end(graph: Any) -> None:
    """The output is held back; then the clock is set, and no state is told in the new time."""
    g = graph(**{"initial.mode": "set_odometry", "output_delay": 1.0})
    old = imu_run(1, 31)
    g.send(("set_odometry", odometry_message(START_NS + STEP_NS)), *old)
    assert g.odometry() == []
    hour = 3600 * NS // STEP_NS
    new = imu_run(hour, hour + 30)
    g.send(*new)
    assert [stamp_of(m) for m in g.odometry()] == [stamp_of(m) for _, m in old]
    g.send(
        ("set_odometry", odometry_message(stamp_of(new[-1][1]))), *imu_run(hour + 30, hour + 140)
    )
    assert stamp_of(g.odometry()[-1]) == START_NS + (hour + 39) * STEP_NS


def test_sensors_may_be_best_effort_and_noise_volatile(graph: Any) -> None:
    g = graph(
        **{
            "process_noise.source": "external",
            "qos_overrides./auv/imu/data_raw.subscription.reliability": "best_effort",
        }
    )
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for topic, qos in (("imu/data_raw", BEST_EFFORT), ("process_noise", latched)):
        publisher = g.peer.create_publisher(Imu, topic, qos)
        g.until(lambda p=publisher: p.get_subscription_count() == 1)
