"""Simulator, tuner and filter in one process with one executor: the whole graph."""

from collections.abc import Iterator

import numpy as np
import pytest
from graphs import Graph, reliable
from nav_msgs.msg import Odometry
from ros_messages import stamp_of
from sensor_msgs.msg import Imu

from insdvl.navigation.events import NS
from insdvl.watch.state_summary import summary
from ros_insdvl.filter import FilterNode
from ros_insdvl.tuner import TunerNode
from ros_insdvl_sim.simulator import Simulator

NAMESPACE = "/auv"
DURATION = 6.0


class Navigation(Graph):
    """The three nodes and a listener."""

    def __init__(self) -> None:
        super().__init__(NAMESPACE)
        self.odometry = self.keep(Odometry, "odometry/filtered")
        self.truth = self.keep(Odometry, "ground_truth/odometry")
        self.noise = self.keep(Imu, "process_noise")
        self.filter = self.make(
            FilterNode,
            **reliable(NAMESPACE, "imu/data_raw", "dvl/velocity"),
            **{
                "process_noise.source": "external",
                "gate.enabled": False,
                "origin.height": -5.0,
                "initial.mode": "parameters",
            },
        )
        self.make(TunerNode, **reliable(NAMESPACE, "imu/data_raw"))
        self.simulator = self.make(
            Simulator, rate_factor=20.0, min_subscribers=2, duration=DURATION, seed=3
        )


@pytest.fixture(scope="module")
def graph() -> Iterator[Navigation]:
    made = Navigation()
    made.until(made.simulator.finished.done)
    made.until(
        lambda: (
            len(made.odometry) == 100 * DURATION
            and len(made.noise) == DURATION - 1
            and made.filter.received["process_noise"] == DURATION - 1
            and stamp_of(made.truth[-1]) == DURATION * NS
        )
    )
    yield made
    made.close()


def test_every_sample_gives_one_odometry(graph: Navigation) -> None:
    stamps = [stamp_of(message) for message in graph.odometry]
    assert stamps == [k * NS // 100 for k in range(1, int(100 * DURATION) + 1)]
    assert graph.filter.rejected == {}


def test_noise_is_learned_once_a_second_and_used(graph: Navigation) -> None:
    stamps = [stamp_of(message) for message in graph.noise]
    assert stamps == [second * NS for second in range(2, int(DURATION) + 1)]
    used, learned = summary(graph.filter._fold.latest), graph.noise[-1]
    np.testing.assert_allclose(
        used.sigma_f**2, learned.linear_acceleration_covariance[::4], rtol=1e-12
    )
    assert used.process_noise_ns == DURATION * NS
    assert learned.orientation_covariance[0] == -1.0


def test_velocity_follows_the_truth(graph: Navigation) -> None:
    truth = {stamp_of(m): m for m in graph.truth}
    error = []
    for message in graph.odometry:
        v, v_true = message.twist.twist.linear, truth[stamp_of(message)].twist.twist.linear
        error.append([v.x - v_true.x, v.y - v_true.y, v.z - v_true.z])
    # The filter starts at rest by its parameters, the vehicle at 1 m/s.
    assert np.linalg.norm(error[0]) > 0.5
    assert np.sqrt(np.mean(np.sum(np.square(error[300:]), axis=1))) < 0.5
