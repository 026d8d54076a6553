"""The rows of the fault matrix that are of processes and networks, flown as real processes."""

import os
import resource
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from insdvl.navigation.events import NS
from insdvl.parameters.declaration import flatten
from insdvl.studies.faults.flight import parameters_of
from insdvl.studies.faults.rows.base import LEVELLING
from insdvl.studies.faults.stream import Sensors, stream_of
from ros_insdvl_sim.harness import (
    DVL,
    FILTER,
    IMU,
    ODOMETRY,
    RELAY,
    SIMULATOR,
    TRUTH,
    TUNER,
    Processes,
    Q,
    Witness,
    lossless,
    sent_by,
    stamp_of,
)

Array = NDArray[np.float64]

DURATION = 60.0  # s of the missions
AFTER = 10.0  # s of the mission, behind a fault, from which its consequences should be over
GOOD = 0.5  # m/s: recovered is who stays below
BELOW = 1.0  # m/s: at no time afterwards is the error above
START_S = 1000.0  # stamp of the start
SEED = 1


@dataclass
class Outcome:
    """A row, as the page takes it.

    Attributes:
        fault: What happens, in words.
        checks: What was expected and seen.
        lost: Valid messages that are in no output.
        during: RMS velocity error during the fault [m/s].
        after: The same when its consequences should be over.
        recovery: Time of the mission from the end of the fault until the error stays below `GOOD`.
    """

    fault: str
    checks: list[dict[str, Any]] = field(default_factory=list)
    lost: int = 0
    during: float | None = None
    after: float | None = None
    recovery: float | None = None

    def expect(self, text: str, seen: str, met: bool) -> None:
        """Add a check."""
        self.checks.append({"expected": text, "seen": seen, "met": bool(met)})

    def always(self, text: str, met: bool) -> None:
        """Add a check of what holds under every fault."""
        seen = text if met else f"not: {text}"
        self.checks.append({"expected": text, "seen": seen, "met": met, "always": True})

    def document(self, group: str) -> dict[str, Any]:
        """As JSON takes it."""
        return {
            "group": group,
            "fault": self.fault,
            "error_during": self.during,
            "error_after": self.after,
            "recovery": self.recovery,
            "lost": self.lost,
            "checks": self.checks,
            "met": all(check["met"] for check in self.checks),
        }


class Sea:
    """A mission: its processes, and a witness that keeps the odometry and the truth.

    Attributes:
        odometry: Stamp and bytes of all that the filter published, in the order of arrival.
        truth: The true odometry, by stamp.
    """

    def __init__(self, processes: Processes, folder: Path, rate_factor: float) -> None:
        self.processes = processes
        self.folder = folder
        self.rate_factor = rate_factor
        self.witness = Witness()
        self.odometry: list[tuple[int, bytes]] = []
        self.truth: dict[int, bytes] = {}
        self.newest_ns = 0
        self.witness.listen(
            Odometry, ODOMETRY, lambda data: self.odometry.append((stamp_of(data), data))
        )
        self.witness.listen(Odometry, TRUTH, self._on_truth)

    def _on_truth(self, data: bytes) -> None:
        self.newest_ns = stamp_of(data)
        self.truth[self.newest_ns] = data

    def filter_parameters(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Of the filter, as the rows of messages have them."""
        sensors = Sensors(start_ns=round(START_S * NS))
        mission = stream_of(sensors, SEED, 2.0).mission
        values = flatten(parameters_of(mission, sensors, SEED, {}))
        kept = ("initial.rpy", "initial.velocity", "origin.height")
        return {
            **{name: value for name, value in values.items() if name in kept},
            **lossless(f"/{IMU}", f"/{DVL}"),
            **changes,
        }

    def start_filter(
        self,
        changes: Mapping[str, Any] | None = None,
        name: str = "filter",
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Start a filter, and wait until it is in the graph."""
        parameters = self.filter_parameters(changes or {})
        self._start(name, FILTER, "/insdvl_filter", parameters, environment)

    def start_tuner(self, name: str = "tuner", **changes: Any) -> None:
        """Start a tuner, and wait until it is in the graph."""
        self._start(name, TUNER, "/insdvl_tuner", lossless(f"/{IMU}") | changes)

    def _start(
        self,
        name: str,
        program: tuple[str, str],
        node: str,
        parameters: Mapping[str, Any],
        environment: Mapping[str, str] | None = None,
    ) -> None:
        # One that was there before has ended: what comes from now on is of the new one.
        told = self.witness.tellings[node]
        process = self.processes.start(name, program, parameters, environment=environment)
        self.witness.until(
            lambda: self.witness.tellings[node] > told or process.poll() is not None,
            f"{name} in the graph",
        )
        self.processes.check(name)

    def start_simulator(
        self,
        subscribers: int = 1,
        name: str = "simulator",
        remaps: Mapping[str, str] | None = None,
        **changes: Any,
    ) -> None:
        """Start the simulator; it plays when there are so many subscribers of its IMU."""
        parameters = {
            "duration": DURATION,
            "seed": SEED,
            "rate_factor": self.rate_factor,
            "start_stamp": START_S,
            "min_subscribers": subscribers,
            "noise.profile": "constant",
        }
        self.processes.start(name, SIMULATOR, parameters | changes, remaps)

    def at(self, seconds: float) -> None:
        """Wait until the mission is there [s]."""
        stamp_ns = round((START_S + seconds) * NS)
        self.witness.until(lambda: self.newest_ns >= stamp_ns, f"{seconds:g} s of mission")

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Hold the simulator: how long a program takes to start decides nothing then."""
        process = self.processes.process("simulator")
        process.send_signal(signal.SIGSTOP)
        self.witness.settle(lambda: len(self.odometry), quiet=0.5)
        try:
            yield
        finally:
            process.send_signal(signal.SIGCONT)

    def finish(self, name: str = "simulator") -> dict[str, int]:
        """Wait until the mission is over and all has arrived; what the simulator sent."""
        process = self.processes.process(name)
        self.witness.until(lambda: process.poll() is not None, "the end of the mission")
        self.witness.settle(lambda: (len(self.odometry), str(self.witness.values)), quiet=2.5)
        return sent_by(self.processes.text(name))

    def filter_value(self, key: str) -> int:
        """A count of the filter's diagnostics."""
        return self.witness.value("/insdvl_filter", key)

    def status(self, node: str, cause: str) -> tuple[int, str]:
        """Level and message of a status, as it was last told."""
        return self.witness.statuses.get(f"{node}: {cause}", (-1, "not told"))

    def warned(self, cause: str, since: float) -> None:
        """Wait until the filter has complained of a cause, from a time of the wall on."""
        self.witness.until(
            lambda: any(self.levels("/insdvl_filter", cause, since)), f"a complaint of {cause}"
        )

    def levels(self, node: str, cause: str, since: float) -> list[int]:
        """Levels of a status that were new since a time of the wall."""
        return [
            n for t, name, n, _ in self.witness.told if name == f"{node}: {cause}" and t >= since
        ]

    # ------------------------------------------------------------ judgement

    def judge(
        self,
        outcome: Outcome,
        begin: float,
        end: float,
        *,
        lives: Sequence[float] = (),
        all_of: int | None = None,
        output_delay: float = 0.0,
    ) -> None:
        """Errors, recovery and what always holds.

        Args:
            outcome: Gets the numbers and the checks.
            begin: Of the fault [s of the mission].
            end: Of the fault.
            lives: Where one filter ends and another begins [s]: between is nobody to lose anything.
            all_of: Samples that were sent; each must be in the output.
            output_delay: What the filter holds back at the end [s].
        """
        rows = {stamp: data for stamp, data in self.odometry if stamp in self.truth}
        stamps = np.array(sorted(rows), dtype=np.int64)
        t = stamps / NS - START_S
        error, finite = np.empty(stamps.size), True
        for k, stamp in enumerate(stamps.tolist()):
            v, covariance, ok = _velocity(rows[stamp])
            finite &= ok and bool((np.diag(covariance)[:3] > 0.0).all())
            error[k] = np.linalg.norm(v - _velocity(self.truth[stamp])[0])

        def rms(low: float, high: float) -> float | None:
            inside = (t >= low) & (t < high)
            return float(np.sqrt(np.mean(error[inside] ** 2))) if inside.any() else None

        outcome.during, outcome.after = rms(begin, end), rms(end + AFTER, DURATION + 1.0)
        behind = t >= end
        bad = np.flatnonzero(error[behind] >= GOOD)
        if behind.any() and (not bad.size or bad[-1] + 1 < behind.sum()):
            first = 0 if not bad.size else bad[-1] + 1
            outcome.recovery = max(float(t[behind][first] - end), 0.0)
        worst = float(error[t >= end + AFTER].max(initial=0.0)) if outcome.after else np.inf
        outcome.expect(
            f"error below {BELOW:g} m/s from {AFTER:g} s after it on",
            f"largest {worst:.2f} m/s",
            worst < BELOW,
        )
        published = np.array([stamp for stamp, _ in self.odometry], dtype=np.int64)
        outcome.always("output finite", finite)
        outcome.always("stamps rising", bool((np.diff(published) > 0).all()))
        if all_of is None:
            outcome.lost += self._missing(stamps, lives, output_delay)
        else:
            outcome.lost += all_of - len(published)
        outcome.always("no valid message lost", outcome.lost == 0)

    def first_error(self, index: int) -> float:
        """Largest ratio of velocity error to sigma in the second of outputs from an index on."""
        ratios = []
        for stamp, data in self.odometry[index : index + 100]:
            v, covariance, _ = _velocity(data)
            error = v - _velocity(self.truth[stamp])[0]
            ratios.append(float((np.abs(error) / np.sqrt(np.diag(covariance)[:3])).max()))
        return max(ratios)

    def _missing(
        self, stamps: NDArray[np.int64], lives: Sequence[float], output_delay: float
    ) -> int:
        """Samples without output, from the first output of each filter on.

        Of one that was ended, up to its last output; of the last one, up to the end of the mission.
        """
        sent = np.array(sorted(self.truth), dtype=np.int64)
        *ended, last = np.split(stamps, np.searchsorted(stamps / NS - START_S, lives))
        until_ns = [int(own[-1]) for own in ended]
        until_ns.append(int(sent[-1]) - round(output_delay * NS))
        return sum(
            int(((sent >= own[0]) & (sent <= end_ns)).sum()) - own.size
            for own, end_ns in zip([*ended, last], until_ns, strict=True)
        )


def _velocity(data: bytes) -> tuple[Array, Array, bool]:
    """Body velocity (3,) and its covariance (6, 6), and whether all that is in it is finite."""
    message = deserialize_message(data, Odometry)
    v, p, q = message.twist.twist.linear, message.pose.pose.position, message.pose.pose.orientation
    velocity = np.array([v.x, v.y, v.z])
    covariance = message.twist.covariance.reshape(6, 6)
    numbers = [velocity, [p.x, p.y, p.z, q.x, q.y, q.z, q.w], covariance.ravel()]
    finite = bool(np.isfinite(np.concatenate([*numbers, message.pose.covariance])).all())
    return velocity, covariance, finite


@contextmanager
def sea(rate_factor: float) -> Iterator[Sea]:
    """A graph of its own, and a folder for its files."""
    with tempfile.TemporaryDirectory(prefix="insdvl-faults-") as folder:
        logs = Path(folder) / "logs"
        logs.mkdir()
        with Processes(logs, {"ROS_LOG_DIR": str(logs)}) as processes:
            made = Sea(processes, Path(folder), rate_factor)
            try:
                yield made
            finally:
                made.witness.close()


# ---------------------------------------------------------------- processes


def tuner_killed(s: Sea) -> Outcome:
    """The tuner dies under way and is started again."""
    outcome = Outcome("the tuner is killed at 20 s and started again at 35 s")
    s.start_tuner()
    s.start_filter({"process_noise.source": "external"})
    s.start_simulator(2)
    s.at(20.0)
    s.processes.end("tuner", signal.SIGKILL)
    killed = time.monotonic()
    s.at(35.0)
    with s.pause():
        s.warned("process noise", killed)
        s.start_tuner("tuner again")
    s.witness.until(
        lambda: s.status("/insdvl_filter", "process noise")[0] == 0, "the filter's recovery"
    )
    sent = s.finish()
    timeouts = s.filter_value("q_timeouts")
    outcome.expect(
        "Q nominal after q_timeout, told as a warning, and well again with the new tuner",
        f"time-outs {timeouts}, warned and recovered",
        timeouts == 1,
    )
    s.judge(outcome, 20.0, 40.0, all_of=sent[IMU])
    return outcome


def tuner_late(s: Sea) -> Outcome:
    """The tuner comes when the mission is under way."""
    outcome = Outcome("the tuner starts 20 s late")
    s.start_filter({"process_noise.source": "external"})
    s.start_simulator(1)
    s.at(20.0)
    with s.pause():
        before = s.status("/insdvl_filter", "process noise")
        s.start_tuner()
    s.witness.until(
        lambda: s.status("/insdvl_filter", "process noise")[0] == 0, "the filter's recovery"
    )
    sent = s.finish()
    outcome.expect(
        "until then a warning and the nominal Q",
        f"level {before[0]}: {before[1]}",
        before[0] == 1 and "nominal" in before[1],
    )
    s.judge(outcome, 0.0, 20.0, all_of=sent[IMU])
    return outcome


def wrong_model(s: Sea) -> Outcome:
    """The tuner is given a model that is none."""
    outcome = Outcome("the tuner has a wrong model")
    model = s.folder / "model.npz"
    model.write_bytes(b"PK\x03\x04 no model")
    process = s.processes.start("tuner", TUNER, {"model": str(model)})
    s.witness.until(lambda: process.poll() is not None, "the tuner's end")
    text = s.processes.text("tuner").strip()
    clear = "model" in text and "Traceback" not in text
    outcome.expect(
        "it ends with 1 and a line that names the model",
        f"ended with {process.returncode}; {'a clear line' if clear else text[-200:]}",
        process.returncode == 1 and clear,
    )
    return outcome


def tuner_floods(s: Sea) -> Outcome:
    """A Q with every sample."""
    outcome = Outcome("the tuner floods: a Q with every sample")
    s.start_tuner(rate=100.0)
    s.start_filter({"process_noise.source": "external", **lossless(f"/{Q}")})
    s.start_simulator(2)
    sent = s.finish()
    told = s.witness.value("/insdvl_tuner", f"sent {Q}")
    taken = s.filter_value(f"received {Q}")
    prefix = f"rejected {Q}: "
    values = s.witness.values["/insdvl_filter"]
    refused = sum(int(value) for key, value in values.items() if key.startswith(prefix))
    outcome.expect(
        "every Q arrives and is used, and no sample is lost for them",
        f"{taken} of {told} arrived, {refused} were refused",
        taken == told > 5000 and not refused,
    )
    s.judge(outcome, 5.0, DURATION - AFTER - 5.0, all_of=sent[IMU])
    return outcome


def _fly_with_a_restart(s: Sea, parameters: Mapping[str, Any]) -> tuple[float, float, int]:
    """A mission whose filter is killed at 30 s and started again at 35 s.

    Returns:
        When its odometry ended and began again [s of the mission], and the index of the latter.
    """
    s.start_filter(parameters)
    s.start_simulator(1)
    s.at(30.0)
    s.processes.end("filter", signal.SIGKILL)
    last_s = s.odometry[-1][0] / NS - START_S
    s.at(35.0)
    with s.pause():
        count = len(s.odometry)
        s.start_filter(parameters, "filter again")
    s.witness.until(lambda: len(s.odometry) > count, "odometry of the second filter")
    first_s = s.odometry[count][0] / NS - START_S
    s.finish()
    return last_s, first_s, count


def filter_resumes(s: Sea) -> Outcome:
    """The filter is killed under way and resumes from its state file."""
    outcome = Outcome("the filter is killed at 30 s and started again, with a state file")
    last_s, first_s, count = _fly_with_a_restart(s, {"state_file": str(s.folder / "state")})
    resumed = "goes on from the state at stamp" in s.processes.text("filter again")
    outcome.expect(
        "it says that it goes on from its state",
        f"away from {last_s:.1f} to {first_s:.1f} s; {'said so' if resumed else 'said nothing'}",
        resumed,
    )
    ratio = s.first_error(count)
    outcome.expect(
        "its first errors are within 5 σ", f"largest of the first second {ratio:.1f} σ", ratio < 5.0
    )
    s.judge(outcome, last_s, first_s, lives=(first_s - 0.001,))
    return outcome


def filter_restarts(s: Sea) -> Outcome:
    """The filter is killed under way and starts anew."""
    outcome = Outcome("the filter is killed at 30 s and started again, without a state file")
    last_s, first_s, _ = _fly_with_a_restart(s, LEVELLING)
    anew = "goes on from" not in s.processes.text("filter again")
    outcome.expect(
        "it starts as initial.mode says, by levelling, which takes a second",
        f"away from {last_s:.1f} to {first_s:.1f} s, {'anew' if anew else 'from a state'}",
        anew and first_s - last_s > 5.5,
    )
    s.judge(outcome, last_s, first_s, lives=(first_s - 0.001,))
    return outcome


def simulator_restarts(s: Sea) -> Outcome:
    """The source of all stamps ends and starts again from the beginning."""
    outcome = Outcome("the simulator is killed at 45 s and started again: stamps jump back")
    s.start_filter(LEVELLING)
    s.start_simulator(1)
    s.at(45.0)
    s.processes.end("simulator", signal.SIGKILL)
    s.witness.settle(lambda: len(s.odometry), quiet=1.0)
    before = len(s.odometry)
    s.odometry.clear()
    s.truth.clear()
    s.start_simulator(1, name="simulator again")
    sent = s.finish("simulator again")
    lines = [line for line in s.processes.text("filter").splitlines() if "stamps went from" in line]
    outcome.expect(
        "one time jump, and a line that says so", f"{len(lines)} lines of it", len(lines) == 1
    )
    # Levelling takes its first second: no output then, and the next at one second exactly.
    count = sent[IMU] - 100
    outcome.expect(
        "every sample of the new time but levelling's is in the output",
        f"{len(s.odometry)} of {count}; {before} before",
        len(s.odometry) == count,
    )
    s.judge(outcome, 0.0, 5.0)
    return outcome


def two_filters(s: Sea) -> Outcome:
    """Somebody starts a second filter of the same name."""
    outcome = Outcome("a second filter of the same name for some seconds")
    s.start_filter()
    s.start_simulator(1)
    s.at(5.0)
    began = time.monotonic()
    s.processes.start("second", FILTER, s.filter_parameters({}))
    s.warned("connections", began)
    told = next(
        (t, text)
        for t, name, level, text in s.witness.told
        if name == "/insdvl_filter: connections" and level > 0 and t > began
    )
    s.processes.end("second", signal.SIGINT)
    s.witness.until(
        lambda: s.status("/insdvl_filter", "connections")[0] == 0, "the connections' recovery"
    )
    s.finish()
    outcome.expect(
        "told in the status `connections` within 10 s of its start, well again without it",
        f"after {told[0] - began:.1f} s: {told[1][:90]}; then well again",
        told[0] - began < 10.0 and "insdvl_filter" in told[1],
    )
    return outcome


def signals(s: Sea) -> Outcome:
    """The usual ways to end a node."""
    outcome = Outcome("SIGTERM, SIGINT, and SIGINT twice, under load")
    codes = {}
    s.start_filter()
    s.start_simulator(1)
    s.at(5.0)
    codes["SIGTERM"] = s.processes.end("filter", signal.SIGTERM)
    s.start_filter(name="second")
    codes["SIGINT"] = s.processes.end("second", signal.SIGINT)
    for gap_ms in (0, 5, 50):
        name = f"SIGINT twice, {gap_ms} ms apart"
        s.start_filter(name=name)
        s.processes.process(name).send_signal(signal.SIGINT)
        time.sleep(gap_ms / 1000.0)  # the second meets another stage of the end
        codes[name] = s.processes.end(name, signal.SIGINT)
    names = ("filter", "second", *(name for name in codes if "twice" in name))
    traces = [name for name in names if "Traceback" in s.processes.text(name)]
    outcome.expect(
        "ends with 0 and without a traceback",
        ", ".join(f"{name} {code}" for name, code in codes.items())
        + (f", traceback of {', '.join(traces)}" if traces else ""),
        not any(codes.values()) and not traces,
    )
    return outcome


def shared_memory(s: Sea) -> Outcome:
    """Killed processes leave their shared memory behind."""
    outcome = Outcome("three filters killed with SIGKILL, their shared memory left over")
    of_the_witness, used = _segments(os.getpid()), set()
    for k in range(3):
        s.start_filter(name=f"killed {k}")
        used |= _segments(s.processes.process(f"killed {k}").pid)
        s.processes.end(f"killed {k}", signal.SIGKILL)
    # The filters had opened those of the witness as well.
    left = sum(segment.exists() for segment in used - of_the_witness)
    outcome.expect(
        "they leave segments behind, else the row proves nothing",
        f"{left} segments left",
        left > 0,
    )
    s.start_filter()
    s.start_simulator(1)
    sent = s.finish()
    outcome.expect(
        "the next filter starts and loses nothing",
        f"odometry {len(s.odometry)} of {sent[IMU]}",
        len(s.odometry) == sent[IMU],
    )
    s.judge(outcome, 0.0, 10.0, all_of=sent[IMU])
    return outcome


def _segments(pid: int) -> set[Path]:
    """The middleware's segments of shared memory that a process has open."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {Path(line.split()[5]) for line in lines if "/dev/shm/fastrtps_" in line}


def state_folder_gone(s: Sea) -> Outcome:
    """Where the state is written goes away and comes back."""
    outcome = Outcome("the folder of the state file is gone from 15 s to 30 s")
    folder, away = s.folder / "states", s.folder / "away"
    folder.mkdir()
    return _fly_without_state(
        s, outcome, folder / "state", lambda: folder.rename(away), lambda: folder.mkdir()
    )


def disk_full(s: Sea) -> Outcome:
    """No file of the filter can grow, neither its state nor its log: what a full disk does."""
    outcome = Outcome("from 15 s to 30 s no file of the filter can grow, as on a full disk")

    def limit(size: int | None) -> None:
        pid = s.processes.process("filter").pid
        _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (most if size is None else size, most))

    return _fly_without_state(s, outcome, s.folder / "state", lambda: limit(0), lambda: limit(None))


def _fly_without_state(
    s: Sea,
    outcome: Outcome,
    file: Path,
    take_away: Callable[[], Any],
    give_back: Callable[[], Any],
) -> Outcome:
    """A mission in which the state file cannot be written from 15 s to 30 s."""
    s.start_filter({"state_file": str(file)})
    s.start_simulator(1)
    s.at(15.0)
    take_away()
    gone = time.monotonic()
    s.at(30.0)
    s.warned("state file", gone)
    _, complaint = s.status("/insdvl_filter", "state file")
    give_back()
    before = time.time()
    s.witness.until(lambda: s.status("/insdvl_filter", "state file")[0] == 0, "the recovery")
    sent = s.finish()
    written = file.is_file() and file.stat().st_mtime > before
    outcome.expect(
        "a warning, navigation goes on, the file is written again and all is well",
        f"{complaint.replace(f'{file.parent}/', '')[:60]}; then recovered, "
        f"the file {'new' if written else 'not written'}",
        written,
    )
    s.judge(outcome, 15.0, 30.0, all_of=sent[IMU])
    return outcome


def no_log_folder(s: Sea) -> Outcome:
    """The log cannot be written."""
    outcome = Outcome("the folder of the logs cannot be made")
    s.start_filter(environment={"ROS_LOG_DIR": "/dev/null/log"})
    s.start_simulator(1)
    sent = s.finish()
    line = next((x for x in s.processes.text("filter").splitlines() if "no log file" in x), "")
    outcome.expect("a line says so and navigation goes on", line[:90] or "no line", bool(line))
    s.judge(outcome, 0.0, 10.0, all_of=sent[IMU])
    return outcome


def no_clock(s: Sea) -> Outcome:
    """use_sim_time, and /clock never comes."""
    outcome = Outcome("use_sim_time is set and there is no /clock")
    s.start_filter({"use_sim_time": True})
    # In real time the simulator tells no /clock; its stamps are of start_stamp all the same.
    s.start_simulator(1, rate_factor=0.0, duration=10.0)
    sent = s.finish()
    outcome.expect(
        "every sample is in the output: nothing waits for the clock",
        f"{len(s.odometry)} of {sent[IMU]}",
        len(s.odometry) == sent[IMU],
    )
    return outcome


def clock_stops(s: Sea) -> Outcome:
    """use_sim_time, and /clock stops under way."""
    outcome = Outcome("use_sim_time is set and /clock stops at 20 s, the sensors go on")
    # The simulator's /clock goes through the witness, who keeps back what is later than 20 s.
    clock = s.witness.node.create_publisher(Clock, "/clock", 10)
    stop_ns = round((START_S + 20.0) * NS)
    newest_ns = filter_ns = 0

    def pass_on(message: Clock) -> None:
        nonlocal newest_ns
        time_ns = message.clock.sec * NS + message.clock.nanosec
        if time_ns <= stop_ns:
            newest_ns = time_ns
            clock.publish(message)

    def look(data: bytes) -> None:
        nonlocal filter_ns
        if deserialize_message(data, DiagnosticArray).status[0].name.startswith("/insdvl_filter:"):
            filter_ns = stamp_of(data)

    s.witness.node.create_subscription(Clock, "sent/clock", pass_on, 10)
    s.witness.listen(DiagnosticArray, "/diagnostics", look)
    s.start_filter({"use_sim_time": True})
    s.start_simulator(1, remaps={"/clock": "sent/clock"})
    sent = s.finish()
    told_s, filter_s = newest_ns / NS - START_S, filter_ns / NS - START_S
    outcome.expect(
        "the filter's own clock stands from then on",
        f"/clock stopped at {told_s:.2f} s, the filter's clock at {filter_s:.2f} s",
        filter_ns == newest_ns and told_s > 19.0,
    )
    outcome.expect(
        "every sample is in the output: nothing waits for the clock",
        f"{len(s.odometry)} of {sent[IMU]}",
        len(s.odometry) == sent[IMU],
    )
    s.judge(outcome, 20.0, DURATION - AFTER - 5.0, all_of=sent[IMU])
    return outcome


def wrong_quality(s: Sea) -> Outcome:
    """A publisher that the filter's subscription refuses."""
    outcome = Outcome("QoS: a best-effort IMU, and the filter asks for reliable")
    s.start_filter()
    began = time.monotonic()
    qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = s.witness.node.create_publisher(Imu, IMU, qos)
    s.warned("connections", began)
    after = time.monotonic() - began
    level, text = s.status("/insdvl_filter", "connections")
    logged = f"/{IMU}" in s.processes.text("filter")
    s.witness.node.destroy_publisher(publisher)
    s.witness.until(
        lambda: s.status("/insdvl_filter", "connections")[0] == 0, "the connections' recovery"
    )
    outcome.expect(
        "named in the log and in `connections` within 5 s, well again without it",
        f"after {after:.1f} s, {'logged' if logged else 'not logged'}: {text[:80]}",
        after < 5.0 and logged and level > 0,
    )
    return outcome


# ---------------------------------------------------------------- network


def _through_relay(
    s: Sea, relay: Mapping[str, Any], changes: Mapping[str, Any] | None = None
) -> dict[str, int]:
    """A mission whose IMU and DVL go through the relay; what the simulator sent."""
    s.processes.start("relay", RELAY, {**lossless(f"/sent/{IMU}", f"/sent/{DVL}"), **relay})
    s.start_filter(changes)
    s.start_simulator(1, remaps={topic: f"sent/{topic}" for topic in (IMU, DVL)})
    return s.finish()


def _loss(loss: float) -> Callable[[Sea], Outcome]:
    def row(s: Sea) -> Outcome:
        """Loss between the sensors and the filter."""
        outcome = Outcome(f"relay: {100.0 * loss:g} % of the messages lost")
        sent = _through_relay(s, {"loss": loss})
        lost = s.witness.value("/insdvl_relay", f"lost {IMU}")
        count = sent[IMU] - lost
        outcome.expect(
            "every sample that arrives is in the output, none is refused",
            f"lost by the relay {lost} of {sent[IMU]}, in the output {len(s.odometry)} of {count}",
            len(s.odometry) == count and s.filter_value(f"received {IMU}") == count,
        )
        s.truth = {stamp: s.truth[stamp] for stamp, _ in s.odometry}
        s.judge(outcome, 0.0, DURATION - AFTER - 5.0, all_of=count)
        return outcome

    return row


def reordered(s: Sea) -> Outcome:
    """Doubled and reordered messages give the bits of a direct flight."""
    outcome = Outcome("relay: 20 % doubled, all delayed by 20 to 120 ms of the wall and reordered")
    delays: dict[str, Any] = {"max_delay": 5.0, "output_delay": 5.0}
    relay = {"duplication": 0.2, "delay": 0.02, "jitter": 0.1}
    sent = _through_relay(s, relay, delays)
    behind = dict(s.odometry)
    doubled = s.witness.value("/insdvl_relay", f"doubled {IMU}")
    refused = s.filter_value(f"rejected {IMU}: duplicate")
    s.processes.stop()
    with sea(s.rate_factor) as direct:
        direct.start_filter(delays)
        direct.start_simulator(1)
        direct.finish()
        expected = dict(direct.odometry)
    same = sum(behind.get(stamp) == data for stamp, data in expected.items())
    outcome.expect(
        "output equal to the bit to that without the relay",
        f"{same} of {len(expected)} messages equal",
        same == len(expected) == len(behind) > 5000,
    )
    outcome.expect(
        "each second copy counted as `duplicate`", f"{refused} of {doubled}", refused == doubled > 0
    )
    outcome.lost = sent[IMU] - s.filter_value(f"received {IMU}") + doubled
    s.judge(outcome, 0.0, DURATION - AFTER - 5.0, output_delay=delays["output_delay"])
    return outcome


#: Group, whether the short form has it, and the row.
ROWS: tuple[tuple[str, bool, Callable[[Sea], Outcome]], ...] = (
    ("Processes", False, tuner_killed),
    ("Processes", False, tuner_late),
    ("Processes", False, wrong_model),
    ("Processes", False, tuner_floods),
    ("Processes", False, filter_resumes),
    ("Processes", False, filter_restarts),
    ("Processes", False, simulator_restarts),
    ("Processes", False, two_filters),
    ("Processes", False, signals),
    ("Processes", False, shared_memory),
    ("Processes", False, state_folder_gone),
    ("Processes", False, disk_full),
    ("Processes", False, no_log_folder),
    ("Processes", False, no_clock),
    ("Processes", False, clock_stops),
    ("Network", False, wrong_quality),
    ("Network", False, _loss(0.001)),
    ("Network", False, _loss(0.01)),
    ("Network", True, _loss(0.1)),
    ("Network", False, reordered),
)


def judged(group: str, row: Callable[[Sea], Outcome], rate_factor: float) -> dict[str, Any]:
    """A row, flown and judged; one that cannot go on to its end is not met, and says why."""
    with sea(rate_factor) as made:
        try:
            return row(made).document(group)
        except Exception as error:  # one row that cannot be judged must not cost the others
            outcome = Outcome(row.__doc__ or "")
            outcome.expect("flown to its end", f"{type(error).__name__}: {error}", False)
            return outcome.document(group)
