"""The node `insdvl_simulator`: the sensors of a vehicle that never was, and the truth."""

import heapq
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import CONVENTIONS, quaternion_from_rotation
from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.mission import mission_of
from insdvl.simulation.motion import Truth
from insdvl.simulation.parameters import SimulatorParameters
from ros_insdvl.conversions import (
    NOT_MEASURED,
    flat_covariance,
    set_quaternion,
    set_vector,
    time_of,
)
from ros_insdvl.execution import run_node
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl_sim.player import Player

Timeline = Iterator[tuple[int, str, Any]]


class Simulator(Player[SimulatorParameters]):
    """Simulates the whole mission, then plays it.

    The stamps are start + k dt in integer nanoseconds. Messages of one stamp are sent in the order
    IMU, odometry, process noise, DVL; each kind reuses one message, which is serialised when it is
    sent.
    """

    def __init__(self, **options: Any) -> None:
        """Simulate the mission, before anything is published.

        Raises:
            ParameterError: A parameter is wrong.
        """
        super().__init__("insdvl_simulator", SimulatorParameters, **options)
        parameters = self.parameters
        try:
            self._mission = mission_of(parameters)
        except ParameterError:
            self.destroy_node()
            raise
        self._convention = CONVENTIONS[parameters.frame_convention]
        self._start_ns = 0
        self._now_ns = 0
        self.advertise(Imu, "imu/data_raw")
        self.advertise(TwistStamped, "dvl/velocity")
        self.advertise(Odometry, "ground_truth/odometry")
        self.advertise(Imu, "ground_truth/process_noise")
        self.start_diagnostics()
        self.start_playing(
            rate_factor=parameters.rate_factor,
            min_subscribers=parameters.min_subscribers,
            exclusive_wait=parameters.exclusive_wait,
        )

    def causes(self, view: View) -> list[Status]:
        """How far the mission is."""
        elapsed, duration = (self._now_ns - self._start_ns) / NS, self._mission.stamps_ns[-1] / NS
        status = Status("mission", f"{elapsed:.0f} of {duration:.0f} s")
        status.values["mission time [s]"] = f"{elapsed:.1f}"
        status.values["mission duration [s]"] = f"{duration:.1f}"
        view.show(status, *self.outputs)
        return [status]

    def timeline(self) -> Timeline:
        """All messages of the mission, by their stamps."""
        self._start_ns = self._now_ns = self._start()
        merged = heapq.merge(
            self._imu(),
            self._odometry(),
            self._process_noise(),
            self._dvl(),
            key=lambda item: item[0],
        )
        for elapsed_ns, topic, message in merged:
            self._now_ns = self._start_ns + elapsed_ns
            message.header.stamp = time_of(self._now_ns)
            yield self._now_ns, topic, message

    def _start(self) -> int:
        if self.parameters.start_stamp or self.parameters.rate_factor:
            return round(self.parameters.start_stamp * NS)
        return time.time_ns()

    def _imu(self) -> Timeline:
        mission, body = self._mission, self._convention.body
        message = Imu(orientation_covariance=NOT_MEASURED)
        message.header.frame_id = self.parameters.base_frame
        rows = zip(
            mission.stamps_ns.tolist(),
            mission.f_b @ body.T,
            mission.w_ib_b @ body.T,
            mission.q,
            strict=True,
        )
        for stamp_ns, f_b, w_ib_b, q in rows:
            set_vector(message.linear_acceleration, f_b)
            set_vector(message.angular_velocity, w_ib_b)
            if self.parameters.publish_covariance:
                self._set_variances(message, q)
            yield stamp_ns, "imu/data_raw", message

    def _process_noise(self) -> Timeline:
        """The variances that hold from each stamp on, with the true force and rate at the stamp."""
        mission, body = self._mission, self._convention.body
        message = Imu(orientation_covariance=NOT_MEASURED)
        message.header.frame_id = self.parameters.base_frame
        f_b, w_ib_b = (
            np.concatenate([getattr(mission.initial, name), getattr(mission.truth, name)]) @ body.T
            for name in ("f_b", "w_ib_b")
        )
        stamps, variances = mission.process_noise()
        rows = np.searchsorted(mission.stamps_ns, stamps, side="right")
        for stamp_ns, row, q in zip(stamps.tolist(), rows, variances, strict=True):
            set_vector(message.linear_acceleration, f_b[row])
            set_vector(message.angular_velocity, w_ib_b[row])
            self._set_variances(message, q)
            yield stamp_ns, "ground_truth/process_noise", message

    def _set_variances(self, message: Imu, q: Any) -> None:
        # Diagonal in all of our axes: a change of signs leaves variances as they are.
        message.linear_acceleration_covariance = flat_covariance(np.diag(q[:3]), 3)
        message.angular_velocity_covariance = flat_covariance(np.diag(q[3:]), 3)

    def _dvl(self) -> Timeline:
        message = TwistStamped()
        message.header.frame_id = self.parameters.dvl_frame
        v_d = self._mission.v_d @ self._convention.body.T
        for stamp_ns, v in zip(self._mission.dvl_stamps_ns.tolist(), v_d, strict=True):
            set_vector(message.twist.linear, v)
            yield stamp_ns, "dvl/velocity", message

    def _odometry(self) -> Timeline:
        """The truth at the start and at every stamp of the IMU."""
        mission = self._mission
        stamps = mission.stamps_ns.tolist()
        yield from self._states([mission.start_ns], mission.initial)
        yield from self._states(stamps, mission.truth)

    def _states(self, stamps: list[int], truth: Truth) -> Timeline:
        nav, body = self._convention.nav, self._convention.body
        message = Odometry(child_frame_id=self.parameters.base_frame)
        message.header.frame_id = self.parameters.odom_frame
        rows = zip(
            stamps,
            truth.p_n @ nav.T,
            quaternion_from_rotation(self._convention.attitude(truth.C_n_b)),
            np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n) @ body.T,
            truth.w_nb_b @ body.T,
            strict=True,
        )
        for stamp_ns, p, q_xyzw, v, w in rows:
            set_vector(message.pose.pose.position, p)
            set_quaternion(message.pose.pose.orientation, q_xyzw)
            set_vector(message.twist.twist.linear, v)
            set_vector(message.twist.twist.angular, w)
            yield stamp_ns, "ground_truth/odometry", message


def main() -> None:
    """Run the node until the mission is over and all of it has arrived."""
    sys.exit(run_node(Simulator))


if __name__ == "__main__":
    main()
