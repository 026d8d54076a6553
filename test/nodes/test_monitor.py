"""The monitor: what it knows of filters, its table, and its process in a terminal."""

import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from graphs import RELIABLE, Graph, overrides, reliable
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from ros_messages import dvl_message, imu_message
from sensor_msgs.msg import Imu
from starts import starts
from terminal import Emulator, Terminal

from insdvl.messages.convert import TWIST, RejectedMessage
from insdvl.messages.make import flat_covariance, set_vector
from insdvl.navigation.events import NS
from insdvl.watch.consistency import nis_interval
from insdvl.watch.table.layout import blocks, line, told
from insdvl.watch.table.numbers import WARN
from ros_insdvl.conversions import time_of
from ros_insdvl.filter import FilterNode
from ros_insdvl.monitor import Monitor
from ros_insdvl.odometry_series import OdometrySeries


def odometry(stamp_ns: int, v_b: Any) -> Odometry:
    message = Odometry()
    message.header.stamp = time_of(stamp_ns)
    set_vector(message.twist.twist.linear, v_b)
    message.pose.pose.position.y = 5.0
    message.pose.covariance = flat_covariance(np.diag(np.arange(1.0, 7.0)), 6)
    message.pose.pose.orientation.w = 1.0
    message.twist.covariance = flat_covariance(np.diag([0.01, 0.04, 0.04, 1.0, 1.0, 1.0]), 6)
    return message


class MonitorGraph(Graph):
    """A monitor of /a and /b, and a peer that talks to it."""

    def __init__(self) -> None:
        super().__init__()
        topics = ("ground_truth/odometry", "a/odometry/filtered", "b/odometry/filtered")
        parameters = {"filters": ["/a", "/b"], "period": 3600.0}
        self.monitor = self.make(Monitor, **reliable("", *topics), **parameters)

    def send(self, topic: str, messages: list[Any]) -> None:
        publisher = self.peer.create_publisher(type(messages[0]), topic, RELIABLE)
        listeners = self.peer.count_subscribers(topic)
        self.until(lambda: publisher.get_subscription_count() >= max(listeners, 1))
        target = self.monitor.received[topic] + len(messages)
        for message in messages:
            publisher.publish(message)
        self.until(lambda: self.monitor.received[topic] == target)


@pytest.fixture
def peer(managed: Any) -> Graph:
    return managed(Graph())


@pytest.fixture
def graph(managed: Any) -> MonitorGraph:
    return managed(MonitorGraph())


def rows(monitor: Monitor) -> dict[str, list[str]]:
    """The cells of each row of the table, by the row's label."""
    found = [row for block in blocks(monitor.shown(), 80) for row in block.rows]
    return {label: list(cells) for label, *cells in found}


def test_it_says_what_it_waits_for(graph: MonitorGraph) -> None:
    assert "no odometry yet" in line(graph.monitor.shown())
    lines = [one.text for one in told(graph.monitor.shown())]
    assert [text.split(":")[0] for text in lines if text.startswith("waits")] == [
        "waits for /a/insdvl_filter",
        "waits for /b/insdvl_filter",
    ]
    assert rows(graph.monitor)["state"] == ["not heard of yet"] * 2


def test_error_is_against_the_truth_at_the_same_time(graph: MonitorGraph) -> None:
    # The truth comes at 2 Hz and speeds up; the filter comes at 10 Hz, 0.3 and 0.4 m/s off.
    truth = [odometry(k * NS // 2, (0.5 * k, 0.0, 0.0)) for k in range(9)]
    wrong = [odometry(k * NS // 10, (0.1 * k + 0.3, 0.4, 0.0)) for k in range(41)]
    graph.send("ground_truth/odometry", truth)
    graph.send("/a/odometry/filtered", wrong)
    first, second = graph.monitor.filters
    error, sigma = graph.monitor.velocity_error(first)
    np.testing.assert_allclose(error, np.tile([0.3, 0.4, 0.0], (41, 1)), atol=1e-12)
    np.testing.assert_allclose(sigma, np.tile([0.1, 0.2, 0.2], (41, 1)))
    assert len(graph.monitor.velocity_error(second)[0]) == 0
    shown, other = graph.monitor.shown()
    assert shown.error == pytest.approx((0.5, 0.5, 0.9)) and other.error is None
    assert "velocity error 0.5 m/s" in line(graph.monitor.shown())


def test_the_state_is_in_the_axes_of_a_navigator(graph: MonitorGraph) -> None:
    """East, north, up and forward, left, up become north, east, depth, compass heading."""
    message = odometry(NS, (1.0, 0.2, 0.1))
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y, position.z = 10.0, 20.0, -5.0
    orientation.z = np.sin(np.radians(30.0) / 2)  # 30 deg from east to north
    orientation.w = np.cos(np.radians(30.0) / 2)
    graph.send("/a/odometry/filtered", [message])
    pose = graph.monitor.shown()[0].pose
    assert pose.position == pytest.approx([20.0, 10.0, 5.0])
    assert pose.position_sigma == pytest.approx(np.sqrt([2.0, 1.0, 3.0]))
    assert pose.rpy_deg == pytest.approx([0.0, 0.0, 60.0])
    assert pose.rpy_sigma_deg == pytest.approx(np.degrees(np.sqrt([5.0, 5.0, 6.0])))
    assert pose.velocity == pytest.approx([1.0, -0.2, -0.1])
    assert pose.velocity_sigma == pytest.approx([0.1, 0.2, 0.2])
    assert rows(graph.monitor)["depth [m]"] == ["5.0 ± 1.7", "-"]


def test_biases_are_in_the_axes_of_the_state(graph: MonitorGraph) -> None:
    message = Imu()
    set_vector(message.linear_acceleration, (0.001, 0.002, 0.003))
    message.linear_acceleration_covariance = flat_covariance(np.diag([1e-6] * 3), 3)
    graph.send("/a/imu/bias", [message])
    assert rows(graph.monitor)["bias f [mm/s^2]"] == ["1.0 -2.0 -3.0 ± 1.0", "-"]


def test_it_tells_how_long_there_was_no_odometry(
    graph: MonitorGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert graph.monitor.shown()[0].still is None
    graph.send("/a/odometry/filtered", [odometry(NS, (0.0, 0.0, 0.0))])
    now = time.monotonic()
    monkeypatch.setattr("ros_insdvl.monitoring.watched.time.monotonic", lambda: now + 30.0)
    assert graph.monitor.shown()[0].still == pytest.approx(30.0, abs=5.0)


def test_a_wrong_parameter_ends_it_with_one_line() -> None:
    (wrong,) = starts("ros_insdvl.monitor", [["-p", "window:=-1.0"]])
    assert wrong.code == 2
    assert wrong.err.splitlines() == ["parameter 'window' must be >= 1 and <= 600, got -1.0"]


def test_window_leaves_out_what_is_old(graph: MonitorGraph) -> None:
    graph.send("ground_truth/odometry", [odometry(k * NS, (0.0, 0.0, 0.0)) for k in range(31)])
    late = [odometry(k * NS, (9.0 if k < 15 else 1.0, 0.0, 0.0)) for k in range(31)]
    graph.send("/a/odometry/filtered", late)
    error, _ = graph.monitor.velocity_error(graph.monitor.filters[0])
    assert error[:, 0].tolist() == [1.0] * 11


def test_diagnostics_and_noise_are_shown(graph: MonitorGraph) -> None:
    values = {
        "NIS dvl, mean of 9": "2.950",
        "rate imu/data_raw [Hz]": "99.9",
        "rejected dvl: gate": "3",
        "DVL updates accepted": "9",
        "DVL age [s]": "0.40",
    }
    dvl = DiagnosticStatus(
        name="b/insdvl_filter: dvl",
        level=DiagnosticStatus.WARN,
        message="no DVL for 7 s",
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    of_imu = {"gaps": "2", "rejected imu/data_raw: duplicate": "4"}
    imu = DiagnosticStatus(
        name="b/insdvl_filter: imu",
        values=[KeyValue(key=key, value=value) for key, value in of_imu.items()],
    )
    other = DiagnosticStatus(name="c/insdvl_filter: imu", level=DiagnosticStatus.ERROR)
    graph.send("/diagnostics", [DiagnosticArray(status=[imu, dvl, other])])
    assert graph.monitor.heard.report("/b/insdvl_filter").values == values | of_imu
    learned = Imu()
    learned.linear_acceleration_covariance = flat_covariance(np.diag([0.01, 0.04, 0.09]), 3)
    graph.send("process_noise", [learned])
    assert graph.monitor.learned_q[0].variances[:3].tolist() == [0.01, 0.04, 0.09]
    shown = rows(graph.monitor)
    low, high = nis_interval(3, 9, 0.9)
    assert shown["NIS of the DVL"] == ["-", f"2.95 {low:.2f} to {high:.2f}"]
    assert shown["rates [Hz]"] == ["-", "IMU 99.9, odometry -"]
    assert shown["DVL"] == ["-", "0.4 s ago, 75.0 % of 12 used"]
    assert graph.monitor.filters[1].rejected == 7
    assert ("/b WARN dvl: no DVL for 7 s", WARN) in list(told(graph.monitor.shown()))


def test_a_filter_tells_all_that_the_table_shows(graph: MonitorGraph) -> None:
    """The keys in its diagnostics are those that the monitor reads."""
    told = {
        "initial.mode": "parameters",
        "frame_convention": "ned",
        "dvl.type": TWIST,  # subscribed to before there is a publisher
    }
    tested = graph.add(
        FilterNode(
            namespace="a",
            context=graph.context,
            parameter_overrides=overrides(told),
        )
    )
    for k in range(120):
        tested._handlers["imu/data_raw"](imu_message(NS + k * NS // 100, (0.0, 0.0, -9.8)))
    tested._handlers["dvl/velocity"](dvl_message(2 * NS, (0.001, 0.002, 0.003)))
    graph.until(lambda: graph.monitor.shown()[0].nis is not None)
    shown = graph.monitor.shown()[0]
    assert shown.measured[0].label == "DVL" and shown.measured[0].used == 1
    assert shown.measured[0].age == pytest.approx(0.19, abs=0.011)
    assert shown.nis_count == 1 and shown.noise_source == "constant"
    assert shown.noise is not None and shown.nominal is not None
    np.testing.assert_allclose(shown.noise.f, shown.nominal.f, rtol=1e-5)
    assert shown.bias is not None and shown.imu_rate is not None
    assert graph.monitor.heard.report("/a/insdvl_filter").values["frame_convention"] == "ned"
    assert shown.pose is not None and shown.pose.stamp_s == pytest.approx(2.19)


def test_it_draws_in_a_terminal(peer: Graph) -> None:
    """Started as a process, in 80 and 120 columns; it gives the terminal back at SIGINT."""
    program = Path(get_package_prefix("ros_insdvl")) / "lib/ros_insdvl/monitor"
    arguments = ["--ros-args", "-r", "__ns:=/auv", "-p", "period:=0.1"]
    publisher = peer.node.create_publisher(Odometry, "/auv/odometry/filtered", RELIABLE)

    def publish() -> None:
        publisher.publish(odometry(NS, (0.5, 0.0, 0.0)))

    def waits(screen: Emulator) -> bool:
        return any("waits for /auv/insdvl_filter" in text for text in screen.lines)

    def shows(screen: Emulator) -> bool:
        return waits(screen) and any(text.endswith("0.50 ± 0.10") for text in screen.lines)

    terminal = Terminal([str(program), *arguments], 80, 40)
    try:
        terminal.until(waits)
        terminal.until(shows, publish)
        assert terminal.screen.scrolled == 0 and terminal.screen.alternate
        terminal.resize(120, 30)
        terminal.until(shows)
        assert terminal.screen.scrolled == 0
        terminal.process.send_signal(signal.SIGINT)
        assert terminal.end() == 0
    finally:
        terminal.close()
    assert not terminal.screen.alternate and terminal.screen.cursor_shown
    (said,) = [text for text in terminal.screen.lines if text.startswith("stamp")]
    assert said.startswith("stamp 1.0 s | /auv, depth 0.0 ± 1.7")


def test_without_rich_it_prints_the_table_as_text() -> None:
    code = "import sys; sys.modules['rich'] = None; from ros_insdvl.monitor import main; main()"
    arguments = ["--ros-args", "-r", "__ns:=/auv", "-p", "period:=0.1"]
    terminal = Terminal([sys.executable, "-c", code, *arguments], 80, 40)
    try:
        terminal.until(
            lambda screen: any("waits for /auv/insdvl_filter" in text for text in screen.lines)
        )
        assert any(text.startswith("DVL  ") for text in terminal.screen.lines)
        assert not terminal.screen.alternate
        terminal.process.send_signal(signal.SIGINT)
        assert terminal.end() == 0
    finally:
        terminal.close()


def test_series_sorts_by_stamp_and_keeps_the_newest() -> None:
    series = OdometrySeries(keep=3)
    for stamp in (1, 5, 3, 4):
        series.add(serialize_message(odometry(stamp, (float(stamp), 0.0, 0.0))))
    stamps, rows = series.arrays()
    assert stamps.tolist() == [3, 4, 5]
    assert rows[:, OdometrySeries.VELOCITY][:, 0].tolist() == [3.0, 4.0, 5.0]
    assert rows[0, OdometrySeries.POSITION].tolist() == [0.0, 5.0, 0.0]
    assert rows[0, OdometrySeries.POSE_VARIANCE].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert rows[0, OdometrySeries.VELOCITY_VARIANCE].tolist() == [0.01, 0.04, 0.04]
    assert series.arrays(count=1)[0].tolist() == [4]


def test_a_series_refuses_what_is_no_odometry() -> None:
    series = OdometrySeries(keep=3)
    data = serialize_message(odometry(NS, (0.0, 0.0, 0.0)))
    for odd in (b"", data[:600], bytes([data[0], 0]) + data[2:]):
        with pytest.raises(RejectedMessage):
            series.add(odd)
    assert len(series) == 0
