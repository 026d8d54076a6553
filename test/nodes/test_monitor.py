"""The monitor: the numbers in its table, for a terminal and for a log."""

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from graphs import RELIABLE, Graph, reliable
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

from insdvl.messages.make import flat_covariance, set_vector
from insdvl.navigation.events import NS
from ros_insdvl.conversions import time_of
from ros_insdvl.monitor import Monitor
from ros_insdvl.odometry_series import OdometrySeries


def odometry(stamp_ns: int, v_b: Any) -> Odometry:
    message = Odometry()
    message.header.stamp = time_of(stamp_ns)
    set_vector(message.twist.twist.linear, v_b)
    message.pose.pose.position.y = 5.0
    message.pose.covariance = flat_covariance(np.diag(np.arange(1.0, 7.0)), 6)
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
def graph(managed: Any) -> MonitorGraph:
    return managed(MonitorGraph())


def test_table_says_that_nothing_is_there(graph: MonitorGraph) -> None:
    assert "no odometry yet" in graph.monitor.line()
    assert len(graph.monitor.table()) == 8


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
    row = next(line for line in graph.monitor.table() if line.startswith("/a "))
    assert row.split()[1:4] == ["0.500", "0.500", "0.900"]
    assert "/a velocity error 0.500 m/s" in graph.monitor.line()


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
        "rejected imu/data_raw: duplicate": "4",
    }
    dvl = DiagnosticStatus(
        name="b/insdvl_filter: dvl",
        level=DiagnosticStatus.WARN,
        message="no DVL for 7 s",
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    imu = DiagnosticStatus(name="b/insdvl_filter: imu", values=[KeyValue(key="gaps", value="2")])
    other = DiagnosticStatus(name="c/insdvl_filter: imu", level=DiagnosticStatus.ERROR)
    graph.send("/diagnostics", [DiagnosticArray(status=[imu, dvl, other])])
    assert graph.monitor.heard.report("/b/insdvl_filter").values == {**values, "gaps": "2"}
    learned = Imu()
    learned.linear_acceleration_covariance = flat_covariance(np.diag([0.01, 0.04, 0.09]), 3)
    graph.send("process_noise", [learned])
    lines = graph.monitor.table()
    row = next(line for line in lines if line.startswith("/b "))
    assert "2.950" in row
    assert "99.9" in row
    assert " 7 " in row
    assert row.endswith("warn: dvl: no DVL for 7 s")
    noise = next(line for line in lines if line.startswith("learned"))
    assert noise.split() == ["learned", "0.1000", "0.2000", "0.3000", "-", "-", "-"]


def test_series_sorts_by_stamp_and_keeps_the_newest() -> None:
    series = OdometrySeries(keep=3)
    for stamp in (1, 5, 3, 4):
        series.add(odometry(stamp, (float(stamp), 0.0, 0.0)))
    stamps, rows = series.arrays()
    assert stamps.tolist() == [3, 4, 5]
    assert rows[:, OdometrySeries.VELOCITY][:, 0].tolist() == [3.0, 4.0, 5.0]
    assert rows[0, OdometrySeries.POSITION].tolist() == [0.0, 5.0, 0.0]
    assert rows[0, OdometrySeries.POSE_VARIANCE].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert rows[0, OdometrySeries.VELOCITY_VARIANCE].tolist() == [0.01, 0.04, 0.04]
    assert series.arrays(count=1)[0].tolist() == [4]
