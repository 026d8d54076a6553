"""The node `insdvl_monitor`: a live table of how well filters do, for a terminal or a log."""

import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import Imu

from insdvl.messages.convert import stamp_ns
from insdvl.navigation.events import NS
from insdvl.parameters.declaration import parameter
from insdvl.studies.evaluation.metrics import rmse
from ros_insdvl.diagnostics import OK
from ros_insdvl.node import InsdvlNode, command_qos, publisher_qos, run

Array = NDArray[np.float64]

TRUTH = "ground_truth/odometry"
LEARNED_Q = "process_noise"
TRUE_Q = "ground_truth/process_noise"

STALE_TIME = 5.0  # s of the wall; every node tells its diagnostics once a second
LEVELS = {
    DiagnosticStatus.OK: "ok",
    DiagnosticStatus.WARN: "warn",
    DiagnosticStatus.ERROR: "ERROR",
    DiagnosticStatus.STALE: "stale",
}


@dataclass(frozen=True)
class MonitorParameters:
    """Parameters of the monitor."""

    filters: tuple[str, ...] = parameter(
        ("",),
        "Namespaces of the filters to show, such as /constant and /learned; an empty one is the "
        "monitor's own.",
    )
    period: float = parameter(
        1.0, "Time between two tables, of the wall.", unit="s", low=0.1, high=3600.0
    )
    window: float = parameter(
        10.0,
        "The RMS of the velocity error is over this time of the stamps.",
        unit="s",
        low=1.0,
        high=600.0,
    )
    keep: int = parameter(
        20_000, "Odometry messages kept of each topic.", low=100, high=100_000_000
    )


class OdometrySeries:
    """What is kept of an odometry topic: a stamp and a row of numbers for each message.

    The columns are those of the slices below; variances are the diagonal of the covariance.
    """

    POSITION = slice(0, 3)
    QUATERNION = slice(3, 7)
    VELOCITY = slice(7, 10)
    POSE_VARIANCE = slice(10, 16)
    VELOCITY_VARIANCE = slice(16, 19)

    def __init__(self, keep: int) -> None:
        self._stamps: deque[int] = deque(maxlen=keep)
        self._rows: deque[list[float]] = deque(maxlen=keep)

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, message: Odometry) -> None:
        """Keep a message."""
        pose, twist = message.pose, message.twist
        p, q, v = pose.pose.position, pose.pose.orientation, twist.twist.linear
        self._stamps.append(stamp_ns(message.header))
        self._rows.append(
            [
                *(p.x, p.y, p.z, q.x, q.y, q.z, q.w, v.x, v.y, v.z),
                *pose.covariance[::7].tolist(),
                *twist.covariance[:15:7].tolist(),
            ]
        )

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the last message."""
        return self._stamps[-1] if self._stamps else None

    def arrays(self, count: int | None = None) -> tuple[NDArray[np.int64], Array]:
        """Stamps (N,) and rows (N, 19) of the last ``count`` messages, or of all, by stamp."""
        n = len(self) if count is None else min(count, len(self))
        stamps = np.fromiter(islice(reversed(self._stamps), n), dtype=np.int64, count=n)
        rows = np.array(list(islice(reversed(self._rows), n)), dtype=float).reshape(n, 19)
        order = np.argsort(stamps, kind="stable")
        return stamps[order], rows[order]


@dataclass
class Watched:
    """A filter, and what is known of it.

    Attributes:
        values: All values of its last diagnostics.
        level: The worst level of its statuses; stale when it has told none for `STALE_TIME`.
        message: The worst of them, with its cause.
        told_at: When it told them, on the monotonic clock [s].
    """

    label: str
    node: str
    series: OdometrySeries
    values: dict[str, str] = field(default_factory=dict)
    level: str = "-"
    message: str = ""
    told_at: float | None = None

    def look(self) -> None:
        """See whether it still tells anything."""
        if self.told_at is not None and (silence := time.monotonic() - self.told_at) > STALE_TIME:
            self.level = LEVELS[DiagnosticStatus.STALE]
            self.message = f"nothing told for {silence:.0f} s: it has ended?"

    def tell(self, statuses: list[DiagnosticStatus]) -> None:
        """Take the node's last statuses."""
        self.told_at = time.monotonic()
        self.values = {item.key: item.value for status in statuses for item in status.values}
        worst = max(statuses, key=lambda status: status.level)
        self.level = LEVELS.get(worst.level, "?")
        wrong = sum(status.level != OK for status in statuses)
        cause = worst.name.removeprefix(f"{self.node}: ")
        self.message = f"{cause}: {worst.message}" if wrong else "all is well"
        if wrong > 1:
            self.message += f" (and {wrong - 1} more)"

    def value(self, key: str) -> str:
        """A value of its last diagnostics, `-` where there is none."""
        return self.values.get(key, "-")

    @property
    def rejected(self) -> int:
        """Number of messages and updates that it did not use."""
        told = (v for key, v in self.values.items() if key.startswith("rejected "))
        return sum(int(v) for v in told if v.isdecimal())  # a stranger may tell anything

    @property
    def nis(self) -> str:
        """Its mean normalised innovation squared."""
        return next((v for key, v in self.values.items() if key.startswith("NIS")), "-")


class Monitor(InsdvlNode[MonitorParameters]):
    """Listens to filters and to the truth where there is one, and prints a table.

    Attributes:
        truth: The true odometry.
        filters: The filters, in the order of the parameter.
        learned_q: Stamps and variances (6,) of process_noise, f_b then w_ib_b.
        true_q: The same of ground_truth/process_noise.
        values: All values of the last diagnostics of every node, by its name.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("insdvl_monitor", MonitorParameters, **options)
        keep = self.parameters.keep
        self.truth = OdometrySeries(keep)
        self.listen(Odometry, TRUTH, self.truth.add)
        self.filters: list[Watched] = []
        for namespace in self.parameters.filters:
            prefix = f"{namespace}/" if namespace else ""
            watched = Watched(
                label=namespace or self.get_namespace(),
                node=self.resolve_topic_name(f"{prefix}insdvl_filter"),
                series=OdometrySeries(keep),
            )
            self.filters.append(watched)
            self.listen(Odometry, f"{prefix}odometry/filtered", watched.series.add)
        self.learned_q: deque[tuple[int, Array]] = deque(maxlen=keep)
        self.true_q: deque[tuple[int, Array]] = deque(maxlen=keep)
        for topic, kept in ((LEARNED_Q, self.learned_q), (TRUE_Q, self.true_q)):
            self.listen(Imu, topic, _keep_variances(kept), command_qos())
        self.values: dict[str, dict[str, str]] = {}
        self.listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, publisher_qos())
        self._lines_above = 0
        self._last_line = ""
        self.create_timer(
            self.parameters.period, self._print, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        by_node: dict[str, list[DiagnosticStatus]] = {}
        for status in message.status:
            by_node.setdefault(status.name.split(": ")[0], []).append(status)
        for node, statuses in by_node.items():
            self.values[node] = {item.key: item.value for s in statuses for item in s.values}
            for watched in self.filters:
                if watched.node == node:
                    watched.tell(statuses)

    def velocity_error(self, watched: Watched) -> tuple[Array, Array]:
        """Body velocity errors (N, 3) over the last window, and their sigmas (N, 3) [m/s].

        The truth is interpolated to the stamps of the filter; N is 0 where they do not overlap.
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
        for watched in self.filters:
            watched.look()
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
                rms = f"{rmse(error):.3f}"
                bound = f"{3.0 * np.linalg.norm(sigma[-1]):.3f}"
            lines.append(
                f"{watched.label:12}{now:>8}{rms:>11}{bound:>11}{watched.nis:>8}"
                f"{watched.value('rate imu/data_raw [Hz]'):>8}"
                f"{watched.value('rate odometry/filtered [Hz]'):>10}{watched.rejected:>10}"
                f"  {watched.level}: {watched.message}"
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
        """All of the table that matters in one line."""
        parts = [f"stamp {self._time()}"]
        for watched in self.filters:
            error, _ = self.velocity_error(watched)
            rms = f"{rmse(error):.3f}" if len(error) else "-"
            parts.append(
                f"{watched.label} velocity error {rms} m/s, NIS {watched.nis}, "
                f"{watched.value('rate imu/data_raw [Hz]')} Hz, rejected {watched.rejected}, "
                f"{watched.level}"
            )
        if self.learned_q:
            parts.append(f"sigma learned {' '.join(_sigmas(self.learned_q))}")
        if self.true_q:
            parts.append(f"true {' '.join(_sigmas(self.true_q))}")
        return " | ".join(parts)


def _keep_variances(kept: deque[tuple[int, Array]]) -> Any:
    def keep(message: Imu) -> None:
        variances = np.concatenate(
            [message.linear_acceleration_covariance[::4], message.angular_velocity_covariance[::4]]
        )
        kept.append((stamp_ns(message.header), variances))

    return keep


def _sigmas(kept: Sequence[tuple[int, Array]]) -> list[str]:
    if not kept:
        return ["-"] * 6
    # Zero and -1 say that a variance is unknown (REP-145).
    return [f"{np.sqrt(variance):.4f}" if variance > 0.0 else "-" for variance in kept[-1][1]]


def main() -> int:
    """Run the node until it is interrupted."""
    return run(Monitor)


if __name__ == "__main__":
    sys.exit(main())
