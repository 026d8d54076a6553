"""What the filter node tells an operator: one status per cause (see `ros_insdvl.diagnostics`)."""

from collections import Counter, deque
from math import inf

import numpy as np

from insdvl.messages.inputs import Inputs
from insdvl.messages.topics import Q_TOPICS
from insdvl.navigation.events import NS, Event, Imu
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state import NEVER
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import TimeJump
from insdvl.timeline.output import AppliedUpdate
from insdvl.timeline.state_file import StateFile
from insdvl.watch.alignment import FrameCheck
from insdvl.watch.sample_count import ExpectedSamples
from ros_insdvl.diagnostics import ERROR, OF_FRAMES, OF_TIME, RECENT, SILENT, WARN, Status, View

#: Stamps and clock that differ by more than this are not of one time: no latency is told.
CLOCK_AGREEMENT_NS = 10 * NS
#: Output that is later than this, beyond its delay, is worth a warning.
LATE_NS = NS
#: Stamps without an accepted DVL measurement for longer than this are worth a warning; for longer
#: than the second, the velocity is no more known from the DVL.
DVL_OUTAGE_NS, DVL_LOST_NS = 5 * NS, 60 * NS
#: Largest relative difference between imu.rate and the rate of the stamps.
RATE_TOLERANCE = 0.05
#: Share of the IMU samples that are missing from which on it is told. Jitter of the stamps is taken
#: for less than that.
MISSING_SHARE = 0.005
#: Rejections by the gate that are no chance any more.
GATE_REJECTIONS = 2

#: Median of so many NIS above which a filter is too sure: twice that of chi-square with 3 degrees.
NIS_COUNT, NIS_MEDIAN = 50, 4.73

#: Parameters that decide which channels are not believed.
_DECLARED = {"saturated": "acceleration_range and imu.rate_range", "frozen": "frozen_samples"}

IMU = "imu/data_raw"
DVL = ("dvl/velocity", "dvl/velocity_cov")
#: Where the updates are counted that were not made.
UPDATES = "dvl"
ODOMETRY = "odometry/filtered"


class FilterWatch:
    """Remembers what a filter node saw and did lately, and tells what it means.

    Args:
        parameters: Of the filter.
        inputs: Of the filter.
        fold: Of the filter.
        state_file: Where its state is kept, None for nowhere.
    """

    def __init__(
        self,
        parameters: FilterParameters,
        inputs: Inputs,
        fold: Fold,
        state_file: StateFile | None = None,
    ) -> None:
        self._parameters = parameters
        self._inputs = inputs
        self._fold = fold
        self._state_file = state_file
        self._updates: Counter[str] = Counter()
        self._jump: TimeJump | None = None  # the last one
        self._samples = ExpectedSamples(parameters)
        self.reset()

    @property
    def counts(self) -> Counter[str]:
        """What is counted here and in the fold, see `View`."""
        counts = Counter(self._fold.counts)
        counts.update({f"DVL updates {name}": n for name, n in self._updates.items()})
        changes = self._inputs.frame_changes.items()
        counts.update({f"frame_id changes {topic}": n for topic, n in changes})
        counts.update(
            {"samples expected": self._samples.expected, "samples arrived": self._samples.arrived}
        )
        return counts

    def reset(self) -> None:
        """A new time: what was remembered by stamps is forgotten."""
        self._frame_check = FrameCheck(self._parameters)
        self._samples.restart()
        self._nis: deque[float] = deque(maxlen=100)
        self._imu_stamps: deque[int] = deque(maxlen=200)
        self._latencies_ns: deque[int] = deque(maxlen=10_000)
        self._clocks_agree = False  # those of the stamps and of the node
        self._started_ns: int | None = None  # stamp of the first output
        self._output: Odometry | None = None

    # ---------------------------------------------------------------- what happens

    def jumped(self, jump: TimeJump) -> None:
        """The fold has followed the samples into another time."""
        self._jump = jump

    def took(self, event: Event) -> None:
        """The fold took an event."""
        self._frame_check.add(event)
        if isinstance(event, Imu):
            self._imu_stamps.append(event.stamp_ns)
            self._samples.add(event.stamp_ns)

    def updated(self, update: AppliedUpdate) -> None:
        """A DVL measurement was used, or not."""
        report = update.report
        self._updates["accepted" if report.accepted else "rejected"] += 1
        if report.corrected:
            self._nis.append(report.nis)

    def published(self, output: Odometry, now_ns: int) -> None:
        """Odometry was published at a time of the node's clock."""
        if self._started_ns is None:
            self._started_ns = output.stamp_ns
        self._output = output
        self._latencies_ns.append(now_ns - output.stamp_ns)

    # ---------------------------------------------------------------- what it means

    def causes(self, view: View) -> list[Status]:
        """All statuses."""
        return [
            self._initialisation(view),
            self._imu(view),
            self._dvl(view),
            self._process_noise(view),
            self._time(view),
            self._frames(view),
            self._odometry(view),
            self._kept(),
        ]

    @property
    def _waits_for(self) -> str:
        """What an uninitialised filter waits for."""
        initial = self._parameters.initial
        waits_for = {
            "parameters": "the first IMU sample",
            "levelling": f"{initial.levelling_time:g} s of IMU samples at rest",
            "topic": f"a message on {initial.topic}",
            "set_odometry": "a message on set_odometry",
        }[initial.mode]
        if self._parameters.origin.source == "topic":
            waits_for += " and a fix on gps/fix"
        return waits_for

    def _initialisation(self, view: View) -> Status:
        status = Status("initialisation", "initialised")
        told = ["set_odometry"]
        if self._inputs.initial_topic is not None:
            told.append(self._inputs.initial_topic)
        if "gps/fix" in self._inputs.topics:
            told.append("gps/fix")
        if self._fold.latest is None:
            status.complain(WARN, "waits", f"not initialised, waits for {self._waits_for}")
        elif self._started_ns is not None:
            status.summary = f"initialised, first output at stamp {self._started_ns / NS:.3f} s"
        if count := view.recent["without_origin"]:
            status.complain(
                WARN,
                "without origin",
                f"{count} initial states in the last {RECENT:.0f} s came before the origin and "
                "are not used: send them again after the fix",
            )
        if count := view.recent["too_old"]:
            status.complain(
                WARN,
                "too old",
                f"{count} initial states in the last {RECENT:.0f} s were of a time long before the "
                "first IMU sample and are not used: look at the sender's clock",
            )
        if count := view.recent["not_level"]:
            status.complain(
                WARN,
                "not level",
                f"levelling began anew {count} times in the last {RECENT:.0f} s, for the specific "
                "force was not as large as gravity or samples were missing: keep the vehicle "
                "still, look at the IMU and its unit",
            )
        view.show(status, *told)
        view.refused(status, told)
        self._show_counters(status, "without_origin", "too_old", "not_level")
        return status

    def _imu(self, view: View) -> Status:
        status = Status("imu")
        imu = self._parameters.imu
        view.quiet(status, IMU, ERROR, "look at the IMU's driver, its topic and the connections")
        view.refused(status, [IMU])
        prefix = f"rejected {IMU}: "
        refused = sum(n for key, n in view.recent.items() if key.startswith(prefix))
        taken = view.recent[f"sent {ODOMETRY}"]
        if 0 < view.recent[f"received {IMU}"] <= refused and not taken:
            status.complain(
                ERROR,
                "all refused",
                f"all {refused} messages of the last {RECENT:.0f} s were refused: there is no "
                "navigation until that is mended",
            )
        if count := view.recent["gaps"]:
            status.complain(
                WARN,
                "gaps",
                f"{count} gaps of more than {imu.max_gap:g} s in the last {RECENT:.0f} s: samples "
                "are lost, look at the driver and the network; sigma grows by what was not seen",
            )
        for name in ("saturated", "frozen"):
            if count := view.recent[name]:
                status.complain(
                    WARN,
                    name,
                    f"{count} samples had a {name} channel in the last {RECENT:.0f} s, which is "
                    f"not believed: look at the IMU, or at imu.{_DECLARED[name]}; sigma grows by "
                    "what is not seen",
                )
        view.show(status, IMU)
        if len(self._imu_stamps) >= 10:
            steps = np.diff(np.sort(np.array(self._imu_stamps)))
            rate = NS / float(np.median(steps)) if np.median(steps) > 0.0 else inf
            status.summary = f"{rate:.1f} Hz"
            status.values["IMU rate of the stamps [Hz]"] = f"{rate:.2f}"
            if abs(rate / imu.rate - 1.0) > RATE_TOLERANCE:
                status.complain(
                    WARN,
                    "rate",
                    f"imu.rate is {imu.rate:g} Hz, the stamps say {rate:.1f} Hz: set imu.rate, "
                    "which scales the process noise",
                )
            else:
                self._tell_missing(status, view)
        self._show_counters(status, "gaps", "saturated", "frozen")
        return status

    def _tell_missing(self, status: Status, view: View) -> None:
        """Complain of lost samples; the rate of the stamps must be the declared one."""
        expected = view.recent["samples expected"]
        missing = expected - view.recent["samples arrived"]
        status.values["samples missing"] = max(self._samples.expected - self._samples.arrived, 0)
        share = missing / expected if expected else 0.0
        status.values["samples missing lately [%]"] = f"{100.0 * max(share, 0.0):.2f}"
        if share >= MISSING_SHARE:
            status.complain(
                WARN,
                "missing",
                f"{100.0 * share:.1f} % of the samples are missing by their stamps, {missing} of "
                f"{expected} in the last {RECENT:.0f} s: look at the driver, the network and the "
                "machine's load, or ask for reliable delivery on both sides (qos_overrides.*)",
            )

    def _dvl(self, view: View) -> Status:
        status = Status("dvl")
        prefix = f"rejected {UPDATES}: "
        reasons = [key.removeprefix(prefix) for key in view.total if key.startswith(prefix)]
        # One measurement in a thousand fails the gate by chance, and none is used before the start.
        chance = view.recent[f"{prefix}gate"] < GATE_REJECTIONS
        unworthy = ("not_initialised", "gate") if chance else ("not_initialised",)
        view.refused(status, [UPDATES], [r for r in reasons if r not in unworthy])
        view.refused(status, [topic for topic in DVL if topic in view.silence])
        self._tell_outage(status, view)
        for name, what in (
            ("inflations", "was let grow after rejections"),
            ("restarts", "was started again from the DVL after rejections"),
        ):
            if count := view.recent[name]:
                status.complain(
                    WARN,
                    name,
                    f"the velocity {what}, {count} times in the last {RECENT:.0f} s: look for "
                    "what was wrong before, the DVL or the IMU",
                )
        view.show(status, *DVL)
        for name in ("accepted", "rejected"):
            status.values[f"DVL updates {name}"] = self._updates[name]
        for reason in reasons:
            status.values[prefix + reason] = view.total[prefix + reason]
        if self._nis:
            nis = float(np.mean(self._nis))
            status.values[f"NIS, mean of {len(self._nis)}"] = f"{nis:.3f}"
            status.summary = f"mean NIS {nis:.2f} (3 is expected)"
            if len(self._nis) >= NIS_COUNT and float(np.median(self._nis)) > NIS_MEDIAN:
                status.complain(
                    WARN,
                    "too sure",
                    f"the mean NIS of {len(self._nis)} measurements is {nis:.1f}, 3 is expected: "
                    "the filter is too sure of itself, its process noise or the DVL's noise_std is "
                    "too small",
                )
        self._show_counters(status, "inflations", "restarts")
        return status

    def _tell_outage(self, status: Status, view: View) -> None:
        """Complain where no measurement was used for long, in the time of the stamps."""
        state = self._fold.latest
        if state is None or self._started_ns is None:
            return
        accepted_ns = int(state["gate"]["dvl"]["accepted_ns"])
        since_ns = self._started_ns if accepted_ns == NEVER else accepted_ns
        outage_ns = int(state["nav"]["time_ns"]) - since_ns
        if outage_ns <= DVL_OUTAGE_NS:
            return
        received = sum(view.recent[f"received {topic}"] for topic in DVL)
        why = (
            f"{received} were received in the last {RECENT:.0f} s, see what was refused"
            if received
            else "none is received, look at the DVL's driver, its topic and the connections"
        )
        status.complain(
            ERROR if outage_ns > DVL_LOST_NS else WARN,
            "outage",
            f"no DVL measurement used for {outage_ns / NS:.0f} s: {why}; the velocity's sigma is "
            f"{self._velocity_sigma:.2f} m/s",
        )

    def _process_noise(self, view: View) -> Status:
        noise = self._parameters.process_noise
        status = Status("process noise", f"{noise.source}")
        topic = Q_TOPICS.get(noise.source)
        state = self._fold.latest
        if state is not None:
            sigma_f, sigma_w = (np.sqrt(np.diag(state["noise"][name])) for name in ("Q_f", "Q_w"))
            for axis, f, w in zip("xyz", sigma_f, sigma_w, strict=True):
                status.values[f"Q sigma f_{axis} [m/s^2]"] = f"{f:.6g}"
                status.values[f"Q sigma w_{axis} [rad/s]"] = f"{w:.6g}"
            told = topic is not None or noise.source == "message"
            if told and int(state["noise"]["q_ns"]) == NEVER:
                status.values["Q age [s]"] = "nominal"
                remedy = f"look at who publishes {topic or IMU}" + (
                    ", the tuner" if noise.source == "external" else ""
                )
                status.complain(
                    WARN,
                    "nominal",
                    f"no process noise for more than {self._parameters.q_timeout:g} s or none yet, "
                    f"Q is nominal: {remedy}",
                )
            elif told:
                age = (int(state["nav"]["time_ns"]) - int(state["noise"]["q_ns"])) / NS
                status.values["Q age [s]"] = f"{age:.3f}"
                status.summary = f"{noise.source}, {age:.1f} s old"
        if topic is not None:
            view.refused(status, [topic])
            view.show(status, topic)
        for name, limit, sensor in (("floors", "below", "good"), ("ceilings", "above", "bad")):
            if count := view.recent[name]:
                status.complain(
                    WARN,
                    name,
                    f"{count} times in the last {RECENT:.0f} s a Q {limit} the {name[:-1]} was "
                    f"brought to it: look at its sender, or set process_noise.*_{name[:-1]} if the "
                    f"sensor is that {sensor}",
                )
        self._show_counters(status, "q_timeouts", "floors", "ceilings")
        return status

    def _time(self, view: View) -> Status:
        status = Status("time", "stamps are in order")
        view.refused(status, [*view.silence], OF_TIME)
        held = self._fold.held
        if held is not None:
            status.complain(
                ERROR,
                "held",
                f"the IMU's stamps went from {held.from_ns / NS:.3f} to {held.to_ns / NS:.3f} s, "
                "and jump_action is 'hold': correct the clock, or call ~/reset to go on there",
            )
        if view.recent["time_jumps"] and self._jump is not None:
            status.complain(
                WARN,
                "jump",
                f"the IMU's stamps went from {self._jump.from_ns / NS:.3f} to "
                f"{self._jump.to_ns / NS:.3f} s, the filter has started again: look at the clocks, "
                "and tell it where it is, if it cannot know",
            )
        if count := view.recent["given_up"]:
            status.complain(
                WARN,
                "given up",
                f"{count} messages in the last {RECENT:.0f} s waited for IMU samples of their time "
                "until there were too many: look at the IMU and at the senders' clocks",
            )
        status.values["newest IMU stamp [s]"] = (
            "none" if self._fold.newest_ns == NEVER else f"{self._fold.newest_ns / NS:.3f}"
        )
        self._show_counters(status, "time_jumps", "recovered", "given_up")
        return status

    def _frames(self, view: View) -> Status:
        status = Status("frames", "nothing contradicts")
        view.refused(status, [*view.silence], OF_FRAMES)
        for finding in self._frame_check.findings():
            status.complain(ERROR, "axes", finding)
        for topic, frame_id in self._inputs.frame_ids.items():
            status.values[f"frame_id {topic}"] = frame_id
            if count := view.recent[f"frame_id changes {topic}"]:
                status.complain(
                    WARN,
                    f"changes {topic}",
                    f"the frame_id of {topic} changed {count} times in the last {RECENT:.0f} s, it "
                    f"is now '{frame_id}': two sensors on one topic? the *.frame_id parameters "
                    "take one only",
                )
        return status

    def _odometry(self, view: View) -> Status:
        status = Status("output", "nothing yet")
        view.show(status, ODOMETRY, "imu/bias", "dvl/innovation")
        if self._output is None:
            return status
        status.values["velocity sigma [m/s]"] = f"{self._velocity_sigma:.4g}"
        heading = float(np.degrees(np.sqrt(self._output.pose_covariance[5, 5])))
        status.values["heading sigma [deg]"] = f"{heading:.4g}"
        position = float(np.sqrt(np.diag(self._output.pose_covariance)[:2].max()))
        status.values["position sigma, horizontal [m]"] = f"{position:.4g}"
        status.summary = (
            f"{view.rates[ODOMETRY]:.1f} Hz, velocity sigma {self._velocity_sigma:.3f} m/s"
        )
        samples = view.recent[f"received {IMU}"]
        if samples and not view.recent[f"sent {ODOMETRY}"] and view.silence[IMU] < SILENT:
            status.complain(
                ERROR,
                "stopped",
                f"no odometry in the last {RECENT:.0f} s in spite of {samples} IMU messages: see "
                "the other statuses, then call ~/reset",
            )
        self._tell_latency(status)
        return status

    def _tell_latency(self, status: Status) -> None:
        """How old the stamps are when they are published, where stamps and clock agree at all."""
        if not self._latencies_ns:
            return
        p50, p99 = np.percentile(self._latencies_ns, [50, 99])
        self._latencies_ns.clear()
        self._clocks_agree |= bool(abs(p50) < CLOCK_AGREEMENT_NS)
        if not self._clocks_agree:
            return
        status.values["latency p50 [ms]"] = f"{p50 / 1e6:.2f}"
        status.values["latency p99 [ms]"] = f"{p99 / 1e6:.2f}"
        if p50 - self._parameters.output_delay * NS > LATE_NS:
            status.complain(
                WARN,
                "late",
                f"odometry is published {p50 / NS:.1f} s after its stamp: the machine or the "
                "network is too slow, or two clocks differ",
            )

    def _kept(self) -> Status:
        status = Status("state file", "off: the parameter state_file is empty")
        file = self._state_file
        if file is None:
            return status
        status.summary = "not yet written"
        if file.stamp_ns is not None:
            status.summary = f"has the state at stamp {file.stamp_ns / NS:.3f} s"
        if file.error is not None:
            status.complain(
                WARN,
                "writing",
                f"the state cannot be written to {file.path}: {file.error}; free the disk or "
                "correct the folder, it is tried again; a filter that is started now does not go "
                "on from here",
            )
        if file.unused is not None:
            status.complain(
                WARN,
                "unused",
                f"{file.path} was not used, {file.unused}: tell the filter where it is, if it "
                "cannot know",
            )
        status.values["state file"] = file.path
        status.values["state file writes"] = file.writes
        status.values["state file failures"] = file.failures
        return status

    @property
    def _velocity_sigma(self) -> float:
        """Largest sigma of the velocity's axes in the last output [m/s]."""
        if self._output is None:
            return inf
        return float(np.sqrt(np.diag(self._output.twist_covariance)[:3].max()))

    def _show_counters(self, status: Status, *names: str) -> None:
        counts = self._fold.counts
        for name in names:
            status.values[name] = counts[name]
