"""The node `insdvl_monitor`: a live table of how well filters do, for a terminal or a log."""

import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import Imu

from insdvl.arrays import Array
from insdvl.messages.cdr.odometry_bytes import decode_odometry
from insdvl.messages.convert import stamp_ns
from insdvl.messages.topics import PROCESS_NOISE, TRUE_PROCESS_NOISE, TRUTH
from insdvl.navigation.events import NS
from insdvl.watch.monitor_parameters import MonitorParameters
from ros_insdvl.node import InsdvlNode
from ros_insdvl.odometry_series import OdometrySeries
from ros_insdvl.process.arguments import Help
from ros_insdvl.process.execution import run_node
from ros_insdvl.qos import command_qos, publisher_qos
from ros_insdvl.status.diagnostics import nis_key
from ros_insdvl.status.heard import ERROR, OK, STALE, WARN, HeardDiagnostics, Report

HELP = Help(
    package="ros_insdvl",
    executable="monitor",
    node="/insdvl_monitor",
    about="""
The monitor prints how well filters do: a live table in a terminal, else a line a second.

subscribes  odometry/filtered of each filter, process_noise, /diagnostics, and the truth where
            there is one: ground_truth/odometry, ground_truth/process_noise
""",
    examples=("-p window:=20.0", "-p 'filters:=[/port, /starboard]'"),
)

STALE_TIME = 5.0  # s of the wall; every node reports once a second
_LEVELS = {OK: "ok", WARN: "warn", ERROR: "ERROR", STALE: "stale"}


class Noise(NamedTuple):
    """A process noise: its stamp and per-sample variances (6,), f_b then w_ib_b."""

    stamp_ns: int
    variances: Array


@dataclass
class Watched:
    """A filter, and what is known of it.

    Attributes:
        label: Its namespace.
        node: Its full name.
        series: Its odometry.
        heard: The diagnostics of all nodes.
    """

    label: str
    node: str
    series: OdometrySeries
    heard: HeardDiagnostics

    @property
    def report(self) -> Report:
        """Its last diagnostics."""
        return self.heard.report(self.node)

    def condition(self) -> tuple[str, str]:
        """The worst level of its statuses, and the worst message with its cause."""
        report = self.report
        if not report.count:
            return "-", ""
        silence = time.monotonic() - report.at
        if silence > STALE_TIME:
            return _LEVELS[STALE], f"no diagnostics for {silence:.0f} s, it may have ended"
        cause, worst = max(report.statuses.items(), key=lambda item: item[1].level)
        level = _LEVELS.get(worst.level, "?")
        wrong = sum(status.level != OK for status in report.statuses.values())
        if not wrong:
            return level, "all is well"
        more = f" (and {wrong - 1} more)" if wrong > 1 else ""
        return level, f"{cause}: {worst.message}{more}"

    def value(self, key: str) -> str:
        """A value of its last diagnostics, `-` where there is none."""
        return self.report.values.get(key, "-")

    @property
    def rejected(self) -> int:
        """Number of messages and updates that it did not use."""
        counts = (v for key, v in self.report.values.items() if key.startswith("rejected "))
        return sum(int(v) for v in counts if v.isdecimal())  # another node may report anything

    @property
    def nis(self) -> str:
        """The mean normalised innovation squared of its DVL."""
        values, begin = self.report.values, nis_key("dvl")
        return next((v for key, v in values.items() if key.startswith(begin)), "-")


class Monitor(InsdvlNode[MonitorParameters]):
    """Listens to filters, and to the truth if there is one, and prints a table.

    Attributes:
        truth: The true odometry.
        filters: The filters, in the order of the parameter.
        learned_q: The messages of process_noise.
        true_q: The messages of ground_truth/process_noise.
        heard: The diagnostics of every node.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("insdvl_monitor", MonitorParameters, **options)
        keep = self.parameters.keep
        self.truth = OdometrySeries(keep)
        self.listen(Odometry, TRUTH, self.truth.add, decode=decode_odometry)
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
            topic = f"{prefix}odometry/filtered"
            self.listen(Odometry, topic, watched.series.add, decode=decode_odometry)
        self.learned_q: deque[Noise] = deque(maxlen=keep)
        self.true_q: deque[Noise] = deque(maxlen=keep)
        for topic, kept in ((PROCESS_NOISE, self.learned_q), (TRUE_PROCESS_NOISE, self.true_q)):
            self.listen(Imu, topic, _keep_variances(kept), command_qos())
        self.listen(DiagnosticArray, "/diagnostics", self.heard.add, publisher_qos())
        self._lines_above = 0
        self._last_line = ""
        self.create_timer(
            self.parameters.period, self._print, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def velocity_error(self, watched: Watched) -> tuple[Array, Array]:
        """Body velocity errors (N, 3) over the last window, and their sigmas (N, 3) [m/s].

        The truth is interpolated to the stamps of the filter; N is 0 if they do not overlap.
        """
        none = np.empty((0, 3)), np.empty((0, 3))
        newest = watched.series.newest_ns
        if newest is None or len(self.truth) == 0:
            return none
        stamps, rows = watched.series.arrays(count=5000)
        true_stamps, true_rows = self.truth.arrays(count=10_000)
        begin = max(newest - self.parameters.window * NS, true_stamps[0])
        inside = (stamps >= begin) & (stamps <= true_stamps[-1])
        if not inside.any():
            return none
        t, true_t = (s.astype(float) - begin for s in (stamps[inside], true_stamps))
        truth = np.stack([np.interp(t, true_t, v) for v in true_rows[:, self.truth.VELOCITY].T], 1)
        error = rows[inside][:, OdometrySeries.VELOCITY] - truth
        return error, np.sqrt(rows[inside][:, OdometrySeries.VELOCITY_VARIANCE])

    def _print(self) -> None:
        if sys.stdout.isatty():
            lines = self.table()
            above = f"\x1b[{self._lines_above}A\x1b[J" if self._lines_above else ""
            print(above + "\n".join(lines), flush=True)
            self._lines_above = len(lines)
        elif (line := self.line()) != self._last_line:
            print(line, flush=True)
            self._last_line = line

    def _time(self) -> str:
        newest = [w.series.newest_ns for w in self.filters if w.series.newest_ns is not None]
        return f"{max(newest) / NS:.1f} s" if newest else "no odometry yet"

    def table(self) -> list[str]:
        """The table's lines."""
        window = f"RMS {self.parameters.window:g} s"
        lines = [
            f"stamp {self._time()}",
            f"{'':12}{'body velocity error [m/s]':^30}{'':8}{'IMU':>8}{'odometry':>10}",
            f"{'filter':12}{'now':>8}{window:>11}{'3 sigma':>11}{'NIS':>8}"
            f"{'Hz':>8}{'Hz':>10}{'rejected':>10}  status",
        ]
        for watched in self.filters:
            error, sigma = self.velocity_error(watched)
            now = rms = bound = "-"
            if len(error):
                now = f"{np.linalg.norm(error[-1]):.3f}"
                rms = f"{_rms(error):.3f}"
                bound = f"{3.0 * np.linalg.norm(sigma[-1]):.3f}"
            level, message = watched.condition()
            lines.append(
                f"{watched.label:12}{now:>8}{rms:>11}{bound:>11}{watched.nis:>8}"
                f"{watched.value('rate imu/data_raw [Hz]'):>8}"
                f"{watched.value('rate odometry/filtered [Hz]'):>10}{watched.rejected:>10}"
                f"  {level}: {message}"
            )
        channels = [f"{triad}_{axis}" for triad in "fw" for axis in "xyz"]
        lines.append(
            f"{'noise sigma':12}"
            + "".join(f"{channel:>9}" for channel in channels)
            + "  [m/s^2, rad/s per sample]"
        )
        for label, kept in (("true", self.true_q), ("learned", self.learned_q)):
            lines.append(f"{label:12}" + "".join(f"{text:>9}" for text in _sigmas(kept)))
        return lines

    def line(self) -> str:
        """The essence of the table in one line."""
        parts = [f"stamp {self._time()}"]
        for watched in self.filters:
            error, _ = self.velocity_error(watched)
            rms = f"{_rms(error):.3f}" if len(error) else "-"
            parts.append(
                f"{watched.label} velocity error {rms} m/s, NIS {watched.nis}, "
                f"{watched.value('rate imu/data_raw [Hz]')} Hz, rejected {watched.rejected}, "
                f"{watched.condition()[0]}"
            )
        if self.learned_q:
            parts.append(f"sigma learned {' '.join(_sigmas(self.learned_q))}")
        if self.true_q:
            parts.append(f"true {' '.join(_sigmas(self.true_q))}")
        return " | ".join(parts)


def _keep_variances(kept: deque[Noise]) -> Callable[[Imu], None]:
    def keep(message: Imu) -> None:
        variances = np.concatenate(
            [message.linear_acceleration_covariance[::4], message.angular_velocity_covariance[::4]]
        )
        kept.append(Noise(stamp_ns(message.header), variances))

    return keep


def _rms(error: Array) -> float:
    """RMS of the length of errors (N, 3)."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def _sigmas(kept: Sequence[Noise]) -> list[str]:
    if not kept:
        return ["-"] * 6
    # Zero and -1 mean that a variance is unknown (REP-145).
    return [
        f"{np.sqrt(variance):.4f}" if variance > 0.0 else "-" for variance in kept[-1].variances
    ]


def main() -> int:
    """Run the node until it is interrupted."""
    return run_node(Monitor, HELP)


if __name__ == "__main__":
    sys.exit(main())
