"""The soak: hours of mission through simulator, filter and tuner as processes, in legs.

A leg is an hour of mission: a level circle that closes, so that leg follows leg without a seam and
one filter navigates all of them. What every leg took is written to a file when it is over; another
call adds legs to what is there. A leg that was interrupted is not in the file, and is run again.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from insdvl.files import check_writable, finite, json_text, write
from insdvl.jobs.parallel import environment
from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.studies.evaluation.tables import number as shown
from insdvl.studies.faults import page, soak
from insdvl.studies.faults.verdicts import STOLEN, Verdict, lost, verdicts
from ros_insdvl_sim.harness import (
    DVL,
    FILTER,
    IMU,
    INNOVATION,
    ODOMETRY,
    SIMULATOR,
    TRUTH,
    TUNER,
    HarnessError,
    Processes,
    Q,
    Witness,
    guarded,
    isolate,
    lossless,
    sent_by,
    stamp_of,
)

Array = NDArray[np.float64]

CONSUMERS = {"filter": "/insdvl_filter", "tuner": "/insdvl_tuner"}

#: The search for the speed: from the first factor on each is so much more than the one before, and
#: holds when nothing is lost, the mission takes the time that it should, and no queue grows: at the
#: end of a trial half of the outputs come within the latency.
FIRST_FACTOR, STEP, LAST_FACTOR = 4.0, 1.25, 40.0
TRIAL_TIME = 30.0  # s of the wall
HELD = 0.97
LATENCY = 100.0  # ms
DISTURBED = 3  # hours in a row that the host of a virtual machine may spoil
LOOK_PERIOD = 2.0  # s of the wall between two looks at the memory
PARTS = 6  # of a leg, for the drift within it


class Recorder:
    """Takes what the witness hears during a leg, and keeps little of it."""

    def __init__(self, witness: Witness) -> None:
        self._witness = witness
        self.clear()
        witness.listen(Odometry, TRUTH, self._on_truth)
        witness.listen(Odometry, ODOMETRY, self._on_odometry)
        witness.listen(TwistWithCovarianceStamped, INNOVATION, self._on_innovation)
        witness.listen(Imu, Q, lambda data: None)

    def clear(self) -> None:
        """Begin a leg."""
        self._heard: dict[int, float] = {}
        self._truth: dict[int, bytes] = {}
        self._first = self._last = (0, 0.0)  # stamp and time of the wall
        self.stamps_ns: list[int] = []
        self.latencies: list[float] = []
        self.nis: list[float] = []
        self.errors: list[float] = []

    def _on_truth(self, data: bytes) -> None:
        stamp_ns, now = stamp_of(data), time.monotonic()
        self._heard[stamp_ns], self._last = now, (stamp_ns, now)
        if not self._first[0]:
            self._first = self._last
        if stamp_ns % NS == 0:
            self._truth[stamp_ns] = data

    def speed(self) -> float:
        """Of the mission against real time, from the first message to the last."""
        stamp_ns, now = np.subtract(self._last, self._first)
        return float(stamp_ns / NS / now) if now else 0.0

    def _on_odometry(self, data: bytes) -> None:
        """The truth of a stamp is sent with the sample: the rest is what the filter took."""
        now, stamp_ns = time.monotonic(), stamp_of(data)
        heard = self._heard.pop(stamp_ns, None)
        if heard is not None:
            self.stamps_ns.append(stamp_ns)
            self.latencies.append(now - heard)
        if stamp_ns in self._truth:
            v, true_v = (
                deserialize_message(message, Odometry).twist.twist.linear
                for message in (data, self._truth.pop(stamp_ns))
            )
            self.errors.append(
                (v.x - true_v.x) ** 2 + (v.y - true_v.y) ** 2 + (v.z - true_v.z) ** 2
            )

    def _on_innovation(self, data: bytes) -> None:
        twist = deserialize_message(data, TwistWithCovarianceStamped).twist
        v = twist.twist.linear
        nu, S = np.array([v.x, v.y, v.z]), twist.covariance.reshape(6, 6)[:3, :3]
        self.nis.append(float(nu @ np.linalg.solve(S, nu)))


class Graph:
    """Filter and tuner, which live as long as this, and a simulator for every leg."""

    def __init__(self, processes: Processes, witness: Witness, rate_factor: float) -> None:
        self.processes = processes
        self.rate_factor = rate_factor
        self.witness = witness
        self.recorder = Recorder(self.witness)
        self.began = time.monotonic()
        self.legs = 0
        processes.start("tuner", TUNER, lossless("/imu/data_raw"))
        processes.start(
            "filter",
            FILTER,
            {
                **soak.start_parameters(),
                "process_noise.source": "external",
                "max_delay": 10.0,
                **lossless("/imu/data_raw", "/dvl/velocity"),
            },
        )

        def ready() -> bool:
            processes.check(*CONSUMERS)
            return set(CONSUMERS.values()) <= witness.values.keys()

        witness.until(ready, "filter and tuner")

    def fly(self, number: int, duration: float) -> dict[str, Any]:
        """Fly a leg; its numbers.

        Raises:
            HarnessError: A process died, or the messages did not arrive.
        """
        witness, recorder = self.witness, self.recorder
        recorder.clear()
        before, processors = self._counts(), soak.processor_time()
        begin = time.monotonic()
        name = f"simulator {number}"
        self.processes.start(
            name,
            SIMULATOR,
            {
                "trajectory": "loop",
                "duration": float(duration),
                "seed": number + 1,
                "rate_factor": self.rate_factor,
                "start_stamp": float(number * duration),
                "min_subscribers": 2,
                "imu.accelerometer_bias_std": 0.0,
                "imu.gyroscope_bias_std": 0.0,
                "imu.accelerometer_bias_walk": 0.0,
                "imu.gyroscope_bias_walk": 0.0,
            },
        )
        looks: list[tuple[float, ...]] = []
        while not self.processes.finished(name):
            witness.spin(LOOK_PERIOD if duration > 600.0 else 0.2)
            self.processes.check("filter", "tuner")
            if recorder.latencies:
                looks.append((time.monotonic(), *(self._memory(n) for n in CONSUMERS)))
        sent = sent_by(self.processes.text(name))
        witness.settle(self._counts)
        counts = {key: count - before[key] for key, count in self._counts().items()}
        whole, stolen = np.subtract(soak.processor_time(), processors)
        self.legs += 1
        return {
            "leg": number,
            "mission": duration,
            "rate_factor": self.rate_factor,
            "held": recorder.speed() / self.rate_factor,
            "wall": round(time.monotonic() - begin, 1),
            "stolen": float(stolen / whole),
            "life_of_filter": round(time.monotonic() - self.began, 1),
            "legs_of_filter": self.legs,
            "messages": self._messages(sent, counts),
            "memory": self._memory_of(np.array(looks)),
            "latency": self._latency(number, duration),
            "nis": _mean(recorder.nis),
            "body_velocity_rmse": _root(_mean(recorder.errors)),
        }

    def _memory(self, name: str) -> float:
        return soak.memory(self.processes.process(name).pid)

    def _counts(self) -> dict[str, int]:
        value, heard = self.witness.value, self.witness.counts
        filter_, tuner = CONSUMERS["filter"], CONSUMERS["tuner"]
        return {
            "filter imu": value(filter_, f"received {IMU}"),
            "filter dvl": value(filter_, f"received {DVL}"),
            "filter q": value(filter_, f"received {Q}"),
            "tuner imu": value(tuner, f"received {IMU}"),
            "tuner q": value(tuner, f"sent {Q}"),
            "filter odometry": value(filter_, f"sent {ODOMETRY}"),
            "heard odometry": heard[ODOMETRY],
            "heard truth": heard[TRUTH],
        }

    def _messages(self, sent: dict[str, int], counts: dict[str, int]) -> list[dict[str, Any]]:
        """Sent and received, of every topic and consumer; each odometry is of a sample."""
        rows = [
            ("filter", IMU, sent[IMU], counts["filter imu"]),
            ("filter", DVL, sent[DVL], counts["filter dvl"]),
            ("filter", Q, counts["tuner q"], counts["filter q"]),
            ("tuner", IMU, sent[IMU], counts["tuner imu"]),
            ("witness", ODOMETRY, counts["filter odometry"], counts["heard odometry"]),
            ("witness", TRUTH, sent[TRUTH], counts["heard truth"]),
            ("odometry per sample", ODOMETRY, sent[IMU], counts["filter odometry"]),
        ]
        return [
            {"consumer": consumer, "topic": topic, "sent": n, "received": received}
            for consumer, topic, n, received in rows
        ]

    def _memory_of(self, looks: Array) -> dict[str, dict[str, float]] | None:
        """Of each process: at the beginning, the end and the most [MB], and the slope.

        The slope is of a line through the second half [MB per hour of mission]. None where the
        filter published nothing.
        """
        if not looks.size:
            return None
        result = {}
        for column, name in enumerate(CONSUMERS, start=1):
            values = looks[:, column]
            half = len(looks) // 2
            t = (looks[half:, 0] - looks[0, 0]) * self.rate_factor / 3600.0
            slope = float(np.polyfit(t, values[half:], 1)[0]) if len(t) > 2 else 0.0
            result[name] = {
                "begin": float(values[0]),
                "end": float(values[-1]),
                "most": float(values.max()),
                "slope": slope,
            }
        return result

    def _latency(self, number: int, duration: float) -> list[dict[str, float | None]]:
        """Median and 99th percentile of each part of the leg [ms], None where nothing came."""
        stamps = np.array(self.recorder.stamps_ns) / NS - number * duration
        latencies = 1e3 * np.array(self.recorder.latencies)
        edges = np.linspace(0.0, duration, PARTS + 1)
        parts = []
        for k in range(PARTS):
            inside = latencies[(stamps > edges[k]) & (stamps <= edges[k + 1])]
            p50, p99 = np.percentile(inside, [50, 99]).tolist() if inside.size else (None, None)
            parts.append({"p50": p50, "p99": p99})
        return parts


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _root(value: float | None) -> float | None:
    return None if value is None else float(np.sqrt(value))


@contextmanager
def graph(rate_factor: float) -> Iterator[Graph]:
    """Processes and the witness."""
    with (
        tempfile.TemporaryDirectory(prefix="insdvl-soak-") as logs,
        Processes(Path(logs), {"ROS_LOG_DIR": logs}) as processes,
        closing(Witness()) as witness,
    ):
        yield Graph(processes, witness, rate_factor)


def search() -> tuple[float, list[dict[str, Any]]]:
    """The highest factor that holds and loses nothing, and what was tried.

    Raises:
        HarnessError: Not even the first does.
    """
    tried, best, factor = [], 0.0, FIRST_FACTOR
    while factor <= LAST_FACTOR:
        with graph(factor) as flown:
            leg = flown.fly(0, round(TRIAL_TIME * factor))
        trial = _trial(leg)
        tried.append(trial)
        print(
            f"{factor:g} times real time: held {trial['held']:.3f}, lost {trial['lost']}, latency "
            f"{shown(trial['latency'], 1)} ms",
            flush=True,
        )
        latency = trial["latency"]
        if trial["lost"] or trial["held"] < HELD or latency is None or latency > LATENCY:
            break
        best, factor = factor, round(factor * STEP, 1)
    if not best:
        raise HarnessError(f"messages are lost or late at {FIRST_FACTOR:g} times real time already")
    return best, tried


def add_legs(
    document: dict[str, Any], count: int, duration: float, keep: Callable[[], None]
) -> None:
    """Add legs to the document, and keep each.

    Where the speed was searched for, one at which a leg loses something is one more trial that
    failed, and the next leg is a step slower; but not where the host had taken the machine away.

    Raises:
        HarnessError: No speed is left, the host takes too much, or a process died.
    """
    done = disturbed = 0
    while done < count:
        rate_factor = document["rate_factor"]
        if document["search"] and rate_factor < FIRST_FACTOR:
            raise HarnessError(f"messages are lost at {FIRST_FACTOR:g} times real time already")
        with graph(rate_factor) as flown:
            failed = False
            while done < count and not failed:
                leg = flown.fly(len(document["legs"]), duration)
                failed = bool(document["search"]) and lost(leg) > 0
                disturbed = disturbed + 1 if failed and leg["stolen"] > STOLEN else 0
                if failed:
                    document["search"].append(_trial(leg))
                    if not disturbed:
                        document["rate_factor"] = round(rate_factor / STEP, 1)
                else:
                    document["legs"].append(leg)
                    done += 1
                keep()
                print(
                    f"leg {leg['leg'] + 1}: {rate_factor:g} times real time, {leg['wall']:.0f} s, "
                    f"lost {lost(leg)}, NIS {shown(leg['nis'], 3)}, the host took "
                    f"{100.0 * leg['stolen']:.1f} % of the processors",
                    flush=True,
                )
        if disturbed == DISTURBED:
            raise HarnessError(
                f"{DISTURBED} hours in a row lost messages while the host took more than "
                f"{100.0 * STOLEN:g} % of the processors: use a quieter machine"
            )


def _trial(leg: dict[str, Any]) -> dict[str, Any]:
    """What the page tells of a trial of a speed."""
    return {
        "rate_factor": leg["rate_factor"],
        "mission": leg["mission"],
        "held": leg["held"],
        "lost": lost(leg),
        "latency": leg["latency"][-1]["p50"],
        "stolen": leg["stolen"],
    }


def run(options: argparse.Namespace) -> int:
    """Add hours to what is there, and write the page; the exit code."""
    isolate()
    folder: Path = options.out / "reliability"
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "soak.json"
    check_writable(file, "--out")
    document: dict[str, Any] = {
        "search": [],
        "rate_factor": None,
        "legs": [],
        "core": [],
        "steps": {},
    }
    document |= page.documents(folder).get(page.SOAK, {})

    def keep() -> None:
        document["environment"] = environment() | {"cores": len(os.sched_getaffinity(0))}
        write(file, json_text(document).encode())
        write(options.out / "reliability.md", page.markdown(page.documents(folder)).encode())

    if options.core_hours:
        document["core"] = []
        for number, hour in enumerate(soak.flown_hours(options.core_hours, options.leg)):
            document["core"].append(finite(asdict(hour)) | {"hour": number})
            print(f"core, hour {number + 1}: {hour.seconds:.1f} s", flush=True)
            keep()
    if options.steps:
        document["steps"] = {}
        for name, values in soak.STEPPED.items():
            parameters = build(FilterParameters, values)
            health = soak.steps(parameters, options.steps, seed=1)
            document["steps"][name] = [finite(asdict(million)) for million in health]
            print(f"{options.steps} million steps, {name}", flush=True)
    keep()
    if options.hours:
        if options.rate_factor:
            document["rate_factor"], document["search"] = options.rate_factor, []
        elif document["rate_factor"] is None:
            document["rate_factor"], document["search"] = search()
            keep()
        add_legs(document, options.hours, options.leg, keep)
    return _told(verdicts(document))


def _told(judged: list[Verdict]) -> int:
    """Say what holds; the exit code."""
    words = {True: "holds", False: "FAILS", None: "not judged"}
    for verdict in judged:
        print(f"{words[verdict.holds]:12}{verdict.expected}: {verdict.seen}", flush=True)
    return 1 if any(verdict.holds is False for verdict in judged) else 0


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="soak", description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=int, default=1, help="of mission to add (default: 1)")
    parser.add_argument(
        "--core-hours", type=int, default=0, help="of mission through the core alone, anew"
    )
    parser.add_argument("--steps", type=int, default=0, help="millions of the filter's steps, anew")
    parser.add_argument(
        "--rate-factor",
        type=float,
        default=0.0,
        help="speed; 0 takes the one of the file, or searches for the highest",
    )
    parser.add_argument(
        "--leg", type=float, default=soak.LEG, help="seconds of a leg, shorter for a trial"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("docs"), metavar="DIR", help="folder (default: ./docs)"
    )
    options = parser.parse_args(arguments)
    for name in ("hours", "core_hours", "steps"):
        if getattr(options, name) < 0:
            parser.error(f"--{name.replace('_', '-')} must be >= 0, got {getattr(options, name)}")
    if not 10.0 <= options.leg <= soak.LEG:
        parser.error(f"--leg must be from 10 to {soak.LEG:g} s, got {options.leg:g}")
    if not 0.0 <= options.rate_factor <= 1000.0:
        parser.error(f"--rate-factor must be from 0 to 1000, got {options.rate_factor:g}")
    return options


def main() -> int:
    """Run the soak from the command line."""
    options = parse(None)
    return guarded("soak", lambda: run(options), failed=2)


if __name__ == "__main__":
    sys.exit(main())
