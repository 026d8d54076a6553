"""The node `insdvl_monitor`: a live table of how well filters do, for a terminal or a log."""

import sys
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from insdvl.arrays import Array
from insdvl.messages.convert import RejectedMessage, stamp_ns
from insdvl.messages.topics import ODOMETRY, PROCESS_NOISE, TRUE_PROCESS_NOISE, TRUTH
from insdvl.navigation.events import NS
from insdvl.terminal import console_of
from insdvl.watch.monitor_parameters import MonitorParameters
from insdvl.watch.table.layout import line, plain
from insdvl.watch.table.numbers import Shown, Triads, VelocityError
from insdvl.watch.table.screen import Screen
from ros_insdvl.monitoring.polled import Polled
from ros_insdvl.monitoring.watched import Watched
from ros_insdvl.node import InsdvlNode
from ros_insdvl.odometry_series import OdometrySeries
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.qos import command_qos, publisher_qos, sensor_qos
from ros_insdvl.status.heard import HeardDiagnostics

HELP = Help(
    package="ros_insdvl",
    executable="monitor",
    node="/insdvl_monitor",
    about="""
The monitor prints how well filters do: a live table in a terminal, else a line a second.

subscribes  odometry/filtered and imu/bias of each filter, process_noise, /diagnostics, and the
            truth where there is one: ground_truth/odometry, ground_truth/process_noise
""",
    examples=("-p window:=20.0", "-p 'filters:=[/port, /starboard]'"),
)

#: How often the topics are looked at [s]: what comes meanwhile waits in the middleware.
LOOK = 0.2


class Noise(NamedTuple):
    """A process noise: its stamp and per-sample variances (6,), f_b then w_ib_b."""

    stamp_ns: int
    variances: Array


class Monitor(InsdvlNode[MonitorParameters]):
    """Looks at filters, and at the truth if there is one, and draws a table.

    Attributes:
        truth: The true odometry.
        filters: The filters, in the order of the parameter.
        learned_q: The messages of process_noise.
        true_q: The messages of ground_truth/process_noise.
        heard: The diagnostics of every node.
        notes: Lines that stand below the table.
    """

    #: None where nothing is drawn, and for a node that ends because a parameter was refused.
    _screen: Screen | None = None

    def __init__(self, **options: Any) -> None:
        super().__init__("insdvl_monitor", MonitorParameters, **options)
        keep = self.parameters.keep
        self.truth = OdometrySeries(keep)
        self._polled: list[Polled] = []
        self._listen(Odometry, TRUTH, self.truth.add)
        self.heard = HeardDiagnostics()
        self.filters: list[Watched] = []
        for namespace in self.parameters.filters:
            prefix = f"{namespace}/" if namespace else ""
            watched = Watched(
                label=namespace or self.get_namespace(),
                node=self.resolve_topic_name(f"{prefix}insdvl_filter"),
                series=OdometrySeries(keep),
                heard=self.heard,
            )
            self.filters.append(watched)
            self._listen(Odometry, f"{prefix}{ODOMETRY}", watched.add_odometry)
            self._listen(Imu, f"{prefix}imu/bias", watched.biases.add)
        self.learned_q: deque[Noise] = deque(maxlen=keep)
        self.true_q: deque[Noise] = deque(maxlen=keep)
        for topic, kept in ((PROCESS_NOISE, self.learned_q), (TRUE_PROCESS_NOISE, self.true_q)):
            self._listen(Imu, topic, _keep_variances(kept), command_qos())
        self._listen(DiagnosticArray, "/diagnostics", self._hear, publisher_qos())
        self.notes: tuple[str, ...] = ()
        console = console_of(sys.stdout)
        if console is not None:
            self._screen = Screen(console)
        self._last_line = ""
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(LOOK, self._look, clock=clock)
        self.create_timer(self.parameters.period, self._print, clock=clock)

    def velocity_error(self, watched: Watched) -> tuple[Array, Array]:
        """Body velocity errors (N, 3) over the last window, and their sigmas (N, 3) [m/s].

        The truth is interpolated to the stamps of the filter; N is 0 if they do not overlap.
        """
        none = np.empty((0, 3)), np.empty((0, 3))
        newest = watched.series.newest_ns
        if newest is None or len(self.truth) == 0:
            return none
        window_ns = newest - round(self.parameters.window * NS)
        stamps, rows = watched.series.arrays(watched.series.count_since(window_ns))
        # One second more, for the truth may come less often.
        true_stamps, true_rows = self.truth.arrays(self.truth.count_since(window_ns - NS))
        if not true_stamps.size:
            return none
        begin = max(window_ns, true_stamps[0])
        inside = (stamps >= begin) & (stamps <= true_stamps[-1])
        if not inside.any():
            return none
        t, true_t = (s.astype(float) - begin for s in (stamps[inside], true_stamps))
        truth = np.stack([np.interp(t, true_t, v) for v in true_rows[:, self.truth.VELOCITY].T], 1)
        error = rows[inside][:, OdometrySeries.VELOCITY] - truth
        return error, np.sqrt(rows[inside][:, OdometrySeries.VELOCITY_VARIANCE])

    def _hear(self, data: bytes) -> None:
        self.heard.add(deserialize_message(data, DiagnosticArray))

    def shown(self) -> list[Shown]:
        """What is known of each filter."""
        true_noise = None
        if self.true_q:
            sigma = np.sqrt(np.maximum(self.true_q[-1].variances, 0.0))
            true_noise = Triads(sigma[:3], sigma[3:])
        with np.errstate(invalid="ignore", over="ignore"):  # another node may publish anything
            return [watched.shown(self._error(watched), true_noise) for watched in self.filters]

    def destroy_node(self) -> None:
        """End the node; the terminal is as it was, with the last numbers below."""
        if self._screen is not None:
            self._screen.close()
            print(line(self.shown()), flush=True)
        super().destroy_node()

    def _error(self, watched: Watched) -> VelocityError | None:
        error, sigma = self.velocity_error(watched)
        if not len(error):
            return None
        return VelocityError(
            now=float(np.linalg.norm(error[-1])),
            rms=float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
            three_sigma=3.0 * float(np.linalg.norm(sigma[-1])),
        )

    def _listen(
        self,
        message_type: type[Any],
        topic: str,
        take: Callable[[bytes], None],
        qos: QoSProfile | None = None,
    ) -> None:
        """Look at a topic every `LOOK`; counted as `InsdvlNode.listen` counts."""
        self.received[topic] = 0

        def handle(data: bytes) -> None:
            self.received[topic] += 1
            try:
                take(data)
            except RejectedMessage as rejection:
                self.reject(topic, rejection.reason, str(rejection))

        polled = Polled(self, message_type, topic, handle, qos or sensor_qos())
        self.inputs[topic] = polled.subscription
        self._polled.append(polled)

    def _look(self) -> None:
        for polled in self._polled:
            polled.look()

    def _print(self) -> None:
        if self._screen is not None:
            self._screen.draw(self.shown(), self.notes)
        elif sys.stdout.isatty():
            print(plain(self.shown(), self.notes), flush=True)
        elif (text := line(self.shown())) != self._last_line:
            print(text, flush=True)
            self._last_line = text


def _keep_variances(kept: deque[Noise]) -> Callable[[bytes], None]:
    def keep(data: bytes) -> None:
        message = deserialize_message(data, Imu)
        variances = np.concatenate(
            [message.linear_acceleration_covariance[::4], message.angular_velocity_covariance[::4]]
        )
        kept.append(Noise(stamp_ns(message.header), variances))

    return keep


def main() -> int:
    """Run the node until it is interrupted."""
    return run_node(Monitor, HELP)


if __name__ == "__main__":
    sys.exit(main())
