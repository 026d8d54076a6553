"""The node `insdvl_filter`: IMU, DVL and process noise in, odometry out.

Data driven: each message becomes events, and what the fold of all events makes publishable is
published. No number depends on a timer or on the clock.
"""

import sys
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, NavSatFix
from std_srvs.srv import Trigger

from insdvl.messages.cdr.imu_bytes import decode_imu
from insdvl.messages.cdr.odometry_bytes import OdometryEncoder
from insdvl.messages.convert import IMU as IMU_TYPE
from insdvl.messages.extrinsics import Extrinsics
from insdvl.messages.feed import Feed
from insdvl.messages.inputs import frame_id_of
from insdvl.messages.make import fill_fix, fill_imu, fill_innovation
from insdvl.messages.topics import (
    BIAS,
    GLOBAL_ODOMETRY,
    GLOBAL_POSITION,
    IMU,
    INNOVATION,
    ODOMETRY,
    Topic,
    taken,
)
from insdvl.messages.transforms import TF, TF_MESSAGE, TF_STATIC, Transforms
from insdvl.navigation.events import NS, Measurement
from insdvl.navigation.events import Imu as ImuSample
from insdvl.navigation.odometry import Odometry as FilterOdometry
from insdvl.navigation.odometry import Pose, biases
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.settings import differences
from insdvl.navigation.state.fields import State
from insdvl.parameters.declaration import ParameterError
from insdvl.timeline.compilation import compile_fold
from insdvl.timeline.jumps import TimeJump
from insdvl.timeline.output import AppliedUpdate
from insdvl.timeline.state_file import StateFile
from insdvl.watch.alignment.check import compile_check
from insdvl.watch.start import DIVERGED, heading_news, is_heading_known, report_of_start
from ros_insdvl.conversions import message_class, new_message
from ros_insdvl.discovery import Discovery
from ros_insdvl.endpoints import Output
from ros_insdvl.node import InsdvlNode
from ros_insdvl.parameters import plain
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.qos import command_qos, latched_command_qos, sensor_qos
from ros_insdvl.status.diagnostics import Status, View
from ros_insdvl.status.filter.watch import FilterWatch
from ros_insdvl.waiting import Waiting

HELP = Help(
    package="ros_insdvl",
    executable="filter",
    node="/insdvl_filter",
    about="""
The filter of the INS/DVL navigation: IMU and DVL in, odometry out.

subscribes  imu/data_raw, dvl/velocity (of any type that dvl.type allows), dvl/velocity_cov,
            process_noise, measurement_noise, set_odometry, gps/fix, and topics that parameters
            name, such as depth.topic and heading.topic
publishes   odometry/filtered, imu/bias, gps/filtered, dvl/innovation, /diagnostics; with a
            heading sensor odometry/global; with publish_tf /tf
services    ~/reset (std_srvs/Trigger): start again as initial.mode says
""",
    examples=(
        "--params-file vehicle.yaml",
        "-p frame_convention:=ned -p imu.rate:=200.0",
        "-r imu/data_raw:=/xsens/imu -r dvl/velocity:=/dvl/twist",
    ),
)


class FilterNode(InsdvlNode[FilterParameters]):
    """The filter as a node."""

    def __init__(self, **options: Any) -> None:
        super().__init__("insdvl_filter", FilterParameters, **options)
        try:
            self._set_up(self.parameters)
        except ParameterError:
            self.destroy_node()
            raise

    def _set_up(self, parameters: FilterParameters) -> None:
        """Make the filter, its publishers and its subscriptions.

        Raises:
            ParameterError: Parameters do not go with the topics, or a message type is missing.
        """
        self._check_topics()
        with self.compiling():
            compile_fold(parameters)
            compile_check(parameters)
        self._waiting: Waiting | None = None  # for the extrinsics
        self._make_feed()
        if parameters.extrinsics == "tf":
            self._waiting = Waiting(Extrinsics(parameters, self._inputs.topics))
        self._begin(None if self._waiting is None else self._waiting.extrinsics)

        self._odometry = self.advertise(Odometry, ODOMETRY)
        self._global: Output | None = None
        if self._feed.has_map:
            self._global = self.advertise(Odometry, GLOBAL_ODOMETRY)
        self._tf: Output | None = None
        if parameters.publish_tf:
            self._tf = self.advertise(message_class(TF_MESSAGE), TF)
            self._transforms = Transforms(new_message, parameters, has_map=self._feed.has_map)
        self._bias = self.advertise(Imu, BIAS)
        self._fix = self.advertise(NavSatFix, GLOBAL_POSITION)
        self._innovations = {
            name: self.advertise(TwistWithCovarianceStamped, f"{name}{INNOVATION}")
            for name in self._inputs.measured
        }
        self._in_odom = OdometryEncoder(parameters.odom_frame, parameters.base_frame)
        self._in_map = OdometryEncoder(parameters.map_frame, parameters.base_frame)
        # A message is serialised when it is sent, so one of each kind serves for ever.
        self._fix_message = NavSatFix()
        self._fix_message.header.frame_id = parameters.base_frame
        self._bias_message = Imu()
        self._innovation_messages = {
            name: TwistWithCovarianceStamped() for name in self._innovations
        }

        self._slow_second: int | None = None
        self._start_told = self._heading_unknown = False
        self.create_service(Trigger, "~/reset", self._reset)
        self._discovery = Discovery(self, self._subscribe)
        self._listen()
        if self._waiting is not None:
            kind, qos = message_class(TF_MESSAGE), latched_command_qos()
            self.listen(kind, TF_STATIC, self._receive_transforms, qos)
        self.start_diagnostics()

    def _check_topics(self) -> None:
        """A topic whose messages the IMU's may have as well has the IMU's name or is another one.

        Raises:
            ParameterError: It does.
        """
        for name, topic in taken(self.parameters).items():
            resolved = self.resolve_topic_name(name)
            if topic.joins and resolved == self.resolve_topic_name(topic.joins):
                raise ParameterError(
                    f"parameter '{topic.parameter}' must be '{topic.joins}', got {name!r}: to "
                    f"ROS both are {resolved}, whose messages have both"
                )

    def _make_feed(self) -> None:
        """Make the filter, with the parameters as they are now."""
        self._feed = Feed(self.parameters, on_refused=self.reject)
        self._fold, self._inputs = self._feed.fold, self._feed.inputs
        topics = self._inputs.topics
        self.single_inputs = tuple(name for name, topic in topics.items() if topic.single)

    def _begin(self, extrinsics: Extrinsics | None) -> None:
        """Watch the filter; where it waits for nothing, go on from the state file."""
        self._state_file = self._resume() if self._waiting is None else None
        self._watch = FilterWatch(
            self.parameters, self._inputs, self._fold, self._state_file, extrinsics
        )

    def _receive_transforms(self, message: Any) -> None:
        """Take what /tf_static says, until the filter is made from it."""
        if self._waiting is not None:
            self._waiting.extrinsics.add(message)
            self._go_on()

    def _wait(self, waiting: Waiting, topic: str, message: Any) -> None:
        """Keep a message until the extrinsics are known."""
        if (given_up := waiting.keep(topic, message)) is not None:
            self.reject(given_up, "no_extrinsics", "no_extrinsics: too many messages wait")
        self._go_on()

    def _go_on(self) -> None:
        """Where the extrinsics are known, make the filter with them and give it what has waited."""
        waiting = self._waiting
        if waiting is None or waiting.extrinsics.missing():
            return
        extrinsics = waiting.extrinsics
        self.parameters = extrinsics.applied(self.parameters)
        self._waiting = None
        self.get_logger().info(f"extrinsics: {extrinsics.text}")
        self._make_feed()
        self._begin(extrinsics)
        for topic, message in waiting.kept:
            self._receive(topic, message)

    def _resume(self) -> StateFile | None:
        """Go on from the state file, where there is one that fits."""
        if not self.parameters.state_file:
            return None
        state_file = StateFile(Path(self.parameters.state_file), self._fold.filter)
        log = self.get_logger()
        record = state_file.load()
        if state_file.unused is not None:
            log.warning(f"{state_file.path} is not used, {state_file.unused}; {self._starts_anew}")
        elif record is None:
            log.info(f"{state_file.path} does not exist yet; {self._starts_anew}")
        else:
            self._fold.resume(record, state_file.settings)
            stamp = record[0]["channels"]["imu_ns"] / NS
            log.info(f"goes on from the state at stamp {stamp:.3f} s in {state_file.path}")
            self._take_over(state_file.settings)
        return state_file

    @property
    def _starts_anew(self) -> str:
        return f"the filter starts as initial.mode says, '{self.parameters.initial.mode}'"

    def _listen(self) -> None:
        """Subscribe to the inputs; one that may have several types when its type is known."""
        for name, topic in self._inputs.topics.items():
            if name in self.inputs:
                continue
            if len(topic.types) > 1:
                self.received.setdefault(name, 0)
                self._discovery.seek(name, topic)
            else:
                self._subscribe(name, topic, topic.types[0])
        self._discovery.look()

    def _subscribe(self, name: str, topic: Topic, kind: str) -> None:
        rate = self.parameters.imu.rate if name == IMU else 0.0
        qos = command_qos() if topic.command else sensor_qos(rate)
        decode = decode_imu if kind == IMU_TYPE else None
        self.listen(message_class(kind), name, partial(self._receive, name), qos, decode=decode)

    def _receive(self, topic: str, message: Any) -> None:
        if self._waiting is not None:
            self._wait(self._waiting, topic, message)
            return
        try:
            for event, refusal in self._feed.give(topic, message):
                if refusal is not None:
                    continue
                self._watch.took(event)
                if isinstance(event, ImuSample):
                    self._bias_message.header.frame_id = message.header.frame_id
                elif isinstance(event, Measurement):
                    innovation = self._innovation_messages[event.name]
                    innovation.header.frame_id = frame_id_of(message)
        finally:
            self._publish()
        if self._state_file is not None and (state := self._fold.latest) is not None:
            self._state_file.offer(state)
        is_over = topic == self._inputs.initial_topic and self._inputs.initial_done
        if is_over and topic in self.inputs:  # of those that have waited several come
            self.ignore(topic)

    # Outputs

    def _publish(self) -> None:
        outputs = self._fold.take()
        now_ns = self.get_clock().now().nanoseconds if outputs else 0
        for output in outputs:
            if isinstance(output, AppliedUpdate):
                self._publish_update(output)
            elif isinstance(output, TimeJump):
                self._follow(output)
            else:
                self._publish_state(output, now_ns)
        if self._start_told and not outputs and self._fold.latest is None:
            self._start_again()

    def _start_again(self) -> None:
        """The fold has given up a state that has diverged; so is what came from it."""
        self._begin_time()
        if self._state_file is not None:
            self._state_file.remove()
        log = self.get_logger()
        log.error(f"the filter diverged and gave up its state: {DIVERGED}; {self._starts_anew}")

    def _publish_state(self, output: FilterOdometry, now_ns: int) -> None:
        self._odometry.send(_encoded(self._in_odom, output, output.in_odom))
        if self._global is not None:
            self._global.send(_encoded(self._in_map, output, output.in_map))
        if self._tf is not None:
            self._tf.send(self._transforms.of(output))
        self._watch.published(output, now_ns)
        if not self._start_told and (latest := self._fold.latest) is not None:
            self._start_told = True
            if text := report_of_start(self._fold.filter, latest).text:
                self.get_logger().info(f"started: {text}")
        second = output.stamp_ns // NS
        if second == self._slow_second:
            return
        # There is no state where the output is the last of a time that was left.
        if (state := self._fold.latest) is not None:
            self._slow_second = second
            self._tell_heading(state)
            fill_fix(self._fix_message, output.stamp_ns, output.place, output.place_covariance)
            self._fix.send(self._fix_message)
            bias = biases(self._fold.filter, state)
            fill_imu(
                self._bias_message,
                bias.stamp_ns,
                bias.accelerometer,
                bias.gyroscope,
                bias.accelerometer_covariance,
                bias.gyroscope_covariance,
            )
            self._bias.send(self._bias_message)

    def _tell_heading(self, state: State) -> None:
        """One line when the heading is known that was not; the status says so while it is not."""
        known = is_heading_known(state)
        if known and self._heading_unknown:
            self.get_logger().info(heading_news(state))
        self._heading_unknown = not known

    def _follow(self, jump: TimeJump) -> None:
        """The fold has begun again in another time; so does what is kept here per time."""
        self._begin_time()
        if self._state_file is not None and self._state_file.left_at(jump.from_ns, jump.to_ns):
            line = f"{self._state_file.path} is not used, {self._state_file.unused}"
            self.get_logger().warning(f"{line}; {self._starts_anew}")
            self._take_over(self._state_file.parameters)
        else:
            self._watch.jumped(jump)

    def _begin_time(self) -> None:
        """Forget what is kept here by stamps."""
        self._slow_second = None
        self._start_told = self._heading_unknown = False
        self._watch.reset()
        self._listen()

    def _publish_update(self, update: AppliedUpdate) -> None:
        report, name = update.report, update.report.measurement
        if not np.isfinite(report.nis):  # nothing was predicted to compare it with
            self.reject(name, report.reason, f"{report.reason}: stamp {update.stamp_ns} ns")
            return
        self._watch.updated(update)
        if not report.accepted:
            self.reject(name, report.reason, f"{report.reason}: NIS {report.nis:.1f}")
        model, message = self._fold.filter.models[name], self._innovation_messages[name]
        nu, S = model.in_stream(report.innovation, report.S)
        fill_innovation(message, update.stamp_ns, nu, S, angles=model.angles)
        self._innovations[name].send(message)

    def _take_over(self, settings: FilterParameters) -> None:
        """Give the node's parameters the settings of a state that was, or was not, used."""
        values = differences(self.parameters, settings)
        if values:
            self.set_parameters_atomically(
                [Parameter(name, value=plain(value)) for name, (_, value) in values.items()]
            )

    def settings_changed(self, before: FilterParameters) -> None:
        """The fold takes them from its newest stamp on."""
        stamp_ns = self._fold.change(self.parameters)
        since = "the first stamp" if stamp_ns is None else f"stamp {stamp_ns / NS:.3f} s"
        for name, (old, new) in differences(before, self.parameters).items():
            self.get_logger().info(f"{name} changed from {old} to {new}, in force from {since} on")

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        is_kept = self._feed.reset()
        self._begin_time()
        state_file = self._state_file
        if state_file is None and self.parameters.state_file:  # it waits for the extrinsics
            state_file = StateFile(Path(self.parameters.state_file), self._fold.filter)
        if state_file is not None:
            state_file.remove()
        kept = "are kept, with their covariance" if is_kept else "are not kept"
        response.success = True
        response.message = f"uninitialised; initial.mode is {self.parameters.initial.mode}"
        response.message += f"; heading and position {kept}"
        self.get_logger().info(f"reset: {response.message}; odom's origin stays as it is")
        return response

    # Diagnostics

    def counts(self) -> Counter[str]:
        """Those of every node, and of the filter."""
        counts = super().counts()
        counts.update(self._watch.counts)
        return counts

    def causes(self, view: View) -> list[Status]:
        """One status per cause, see `FilterWatch`."""
        return self._watch.causes(view)


def _encoded(encoder: OdometryEncoder, output: FilterOdometry, pose: Pose) -> bytes:
    """An output as a message, with its pose in the frame of the encoder."""
    return encoder.encode(
        output.stamp_ns,
        pose.position,
        pose.quaternion_xyzw,
        pose.covariance,
        output.twist_linear,
        output.twist_angular,
        output.twist_covariance,
    )


def main() -> int:
    """Run the node until it is interrupted."""
    return run_node(FilterNode, HELP)


if __name__ == "__main__":
    sys.exit(main())
