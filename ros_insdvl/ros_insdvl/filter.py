"""The node `insdvl_filter`: IMU, DVL and process noise in, odometry out.

Data driven: each message becomes an event, and what the fold of all events makes publishable is
published. Nothing numerical depends on a timer or on the clock.
"""

import sys
from collections import Counter, deque
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu, NavSatFix
from std_srvs.srv import Trigger

from insdvl import inputs
from insdvl.events import NS, Dvl, ProcessNoise
from insdvl.events import Imu as ImuSample
from insdvl.fold import AppliedUpdate, Fold, TimeJump
from insdvl.frames import CONVENTIONS
from insdvl.inputs import Q_TOPICS, Inputs
from insdvl.odometry import Odometry as FilterOdometry
from insdvl.odometry import biases
from insdvl.parameters import FilterParameters
from insdvl.state import NEVER
from ros_insdvl.conversions import fill_bias, fill_innovation, fill_odometry
from ros_insdvl.node import ERROR, WARN, Health, InsdvlNode, command_qos, run, sensor_qos

#: Stamps and clock that differ by more than this are not of one time: no latency is told.
CLOCK_AGREEMENT_NS = 10 * NS
#: Stamps without a DVL update for longer than this are worth a warning.
DVL_OUTAGE_NS = 5 * NS
#: Largest relative difference between imu.rate and the rate of the stamps.
RATE_TOLERANCE = 0.05

#: Message class of each type that is taken.
TYPES = {
    inputs.IMU: Imu,
    inputs.FIX: NavSatFix,
    inputs.TWIST: TwistStamped,
    inputs.TWIST_WITH_COVARIANCE: TwistWithCovarianceStamped,
    inputs.ODOMETRY: Odometry,
}
#: Topics on which single messages have to arrive.
COMMANDS = ("set_odometry", *Q_TOPICS.values())


def compile_kernels(parameters: FilterParameters) -> None:
    """Run a filter for a moment, so that no message ever waits for a compilation."""
    fold = Fold(
        replace(
            parameters,
            initial=replace(parameters.initial, mode="parameters"),
            origin=replace(parameters.origin, source="parameters"),
            output_delay=0.0,
        )
    )
    step = round(NS / parameters.imu.rate)
    for k in range(1, 5):
        fold.add(ImuSample(k * step, np.array([0.0, 0.0, -9.8]), np.zeros(3)))
    fold.add(ProcessNoise(2 * step, np.eye(3), np.eye(3)))
    fold.add(Dvl(3 * step, np.full(3, 0.01)))
    fold.take()


class FilterNode(InsdvlNode[FilterParameters]):
    """The filter as a node."""

    def __init__(self, **options: Any) -> None:
        super().__init__("insdvl_filter", FilterParameters, **options)
        parameters = self.parameters
        compile_kernels(parameters)
        self._fold = Fold(parameters)
        self._inputs = Inputs(parameters)
        self._convention = CONVENTIONS[parameters.frame_convention]

        self._odometry = self.advertise(Odometry, "odometry/filtered")
        self._bias = self.advertise(Imu, "imu/bias")
        self._innovation = self.advertise(TwistWithCovarianceStamped, "dvl/innovation")
        # A message is serialised when it is sent, so one of each kind serves for ever.
        self._odometry_message = Odometry(child_frame_id=parameters.base_frame)
        self._odometry_message.header.frame_id = parameters.odom_frame
        self._bias_message = Imu()
        self._innovation_message = TwistWithCovarianceStamped()

        self._bias_second: int | None = None
        self._subscriptions_by_topic: dict[str, Subscription] = {}
        self._updates: Counter[str] = Counter()
        self._nis: deque[float] = deque(maxlen=100)
        self._imu_stamps: deque[int] = deque(maxlen=200)
        self._latencies_ns: list[int] = []

        self.create_service(Trigger, "~/reset", self._reset)
        self._listen()
        self.start_diagnostics()

    def _listen(self) -> None:
        for topic, kind in self._inputs.topics.items():
            if topic not in self._subscriptions_by_topic:
                self._subscriptions_by_topic[topic] = self.listen(
                    TYPES[kind],
                    topic,
                    partial(self._receive, topic),
                    command_qos() if topic in COMMANDS else sensor_qos(),
                )

    def _receive(self, topic: str, message: Any) -> None:
        if topic == "imu/data_raw":
            self._bias_message.header.frame_id = message.header.frame_id
        elif topic.startswith("dvl/"):
            self._innovation_message.header.frame_id = message.header.frame_id
        try:
            for event in self._inputs.events(topic, message, self._fold.newest_ns):
                refusal = self._fold.add(event)
                if refusal is not None:
                    self.reject(topic, refusal, f"{refusal}: stamp {event.stamp_ns} ns")
                elif isinstance(event, ImuSample):
                    self._imu_stamps.append(event.stamp_ns)
        finally:
            self._publish()
        if topic == self._inputs.initial_topic and self._inputs.initial_done:
            self.destroy_subscription(self._subscriptions_by_topic.pop(topic))

    # Outputs

    def _publish(self) -> None:
        for output in self._fold.take():
            if isinstance(output, AppliedUpdate):
                self._publish_update(output)
            elif isinstance(output, TimeJump):
                self._follow(output)
            else:
                self._publish_state(output)

    def _publish_state(self, output: FilterOdometry) -> None:
        fill_odometry(self._odometry_message, output)
        self._odometry.send(self._odometry_message)
        self._latencies_ns.append(self.get_clock().now().nanoseconds - output.stamp_ns)
        second = output.stamp_ns // NS
        if second != self._bias_second:
            self._bias_second = second
            state = self._fold.latest
            assert state is not None  # there is an output, so it is initialised
            fill_bias(self._bias_message, biases(self._fold.filter, state))
            self._bias.send(self._bias_message)

    def _follow(self, jump: TimeJump) -> None:
        """The fold has begun again in another time; so does what is kept here per time."""
        self.get_logger().warning(
            f"time jump from {jump.from_ns / NS:.3f} to {jump.to_ns / NS:.3f} s: "
            "the filter starts again"
        )
        self._begin_time()

    def _begin_time(self) -> None:
        self._bias_second = None
        self._nis.clear()
        self._imu_stamps.clear()
        self._inputs.reset()
        self._listen()

    def _publish_update(self, update: AppliedUpdate) -> None:
        report = update.report
        if not np.isfinite(report.nis):  # nothing was predicted to compare it with
            self.reject("dvl", report.reason, f"{report.reason}: stamp {update.stamp_ns} ns")
            return
        if report.accepted:
            self._updates["accepted"] += 1
        else:
            self._updates["rejected"] += 1
            self.reject("dvl", report.reason, f"{report.reason}: NIS {report.nis:.1f}")
        self._nis.append(report.nis)
        axes = self._convention.body
        fill_innovation(
            self._innovation_message,
            update.stamp_ns,
            axes @ report.innovation,
            axes @ report.S @ axes.T,
        )
        self._innovation.send(self._innovation_message)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._fold.reset()
        self._begin_time()
        self.get_logger().info("reset: the filter is uninitialised")
        response.success = True
        response.message = f"uninitialised; initial.mode is {self.parameters.initial.mode}"
        return response

    # Diagnostics

    def health(self) -> Health:
        """Updates, NIS, Q and its age, IMU rate, latency and the fold's counters."""
        health = Health()
        health.values["DVL updates accepted"] = self._updates["accepted"]
        health.values["DVL updates rejected"] = self._updates["rejected"]
        if self._nis:
            health.values[f"NIS, mean of {len(self._nis)}"] = f"{np.mean(self._nis):.3f}"
        self._tell_state(health)
        self._tell_imu_rate(health)
        self._tell_latency(health)
        for name, count in self._fold.counts.items():
            health.values[name] = count
        return health

    def _tell_state(self, health: Health) -> None:
        state = self._fold.latest
        if state is None:
            initial = self.parameters.initial
            waits_for = initial.topic if initial.mode == "topic" else initial.mode
            if self.parameters.origin.source == "topic":
                waits_for += " and gps/fix"
            health.complain(WARN, f"not initialised, waits for {waits_for}")
            return
        sigma_f = np.sqrt(np.diag(state["Q_f"]))
        sigma_w = np.sqrt(np.diag(state["Q_w"]))
        for axis, f, w in zip("xyz", sigma_f, sigma_w, strict=True):
            health.values[f"Q sigma f_{axis} [m/s^2]"] = f"{f:.6g}"
            health.values[f"Q sigma w_{axis} [rad/s]"] = f"{w:.6g}"
        time_ns, q_ns = int(state["time_ns"]), int(state["q_ns"])
        if q_ns != NEVER:
            health.values["Q age [s]"] = f"{(time_ns - q_ns) / NS:.3f}"
        elif self.parameters.process_noise.source in (*Q_TOPICS, "message"):
            health.values["Q age [s]"] = "nominal"
            health.complain(WARN, "no process noise received, Q is nominal")
        dvl_ns = int(state["dvl_ns"])
        if dvl_ns != NEVER and time_ns - dvl_ns > DVL_OUTAGE_NS:
            health.complain(WARN, f"no DVL for {(time_ns - dvl_ns) / NS:.0f} s")

    def _tell_imu_rate(self, health: Health) -> None:
        if self.received["imu/data_raw"] == 0:
            health.complain(ERROR, "no imu/data_raw received")
        if len(self._imu_stamps) < 10:
            return
        rate = NS / float(np.median(np.diff(np.sort(np.array(self._imu_stamps)))))
        health.values["IMU rate of the stamps [Hz]"] = f"{rate:.2f}"
        if abs(rate / self.parameters.imu.rate - 1.0) > RATE_TOLERANCE:
            health.complain(
                WARN, f"imu.rate is {self.parameters.imu.rate:g} Hz, the stamps say {rate:.1f} Hz"
            )

    def _tell_latency(self, health: Health) -> None:
        if not self._latencies_ns:
            return
        p50, p99 = np.percentile(self._latencies_ns, [50, 99])
        self._latencies_ns.clear()
        if abs(p50) < CLOCK_AGREEMENT_NS:
            health.values["latency p50 [ms]"] = f"{p50 / 1e6:.2f}"
            health.values["latency p99 [ms]"] = f"{p99 / 1e6:.2f}"


def main() -> int:
    """Run the node until it is interrupted."""
    return run(FilterNode)


if __name__ == "__main__":
    sys.exit(main())
