"""The soak's graph: filter and tuner as long as it lives, and a simulator for every leg."""

import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from insdvl.arrays import Array
from insdvl.messages.topics import BY_NAME, DVL, IMU, PROCESS_NOISE, TRUTH
from insdvl.navigation.events import NS
from insdvl.studies.faults import soak
from ros_insdvl_sim.trials.names import (
    FILTER,
    FILTER_NODE,
    INNOVATION,
    ODOMETRY,
    SIMULATOR,
    TUNER,
    TUNER_NODE,
)
from ros_insdvl_sim.trials.processes import Processes, lossless, sent_by
from ros_insdvl_sim.trials.witness import Witness, stamp_of

CONSUMERS = {"filter": FILTER_NODE, "tuner": TUNER_NODE}
LOOK_PERIOD = 2.0  # s of the wall between two looks at the memory
LONG_LEG = 600.0  # s of mission; in a shorter one the looks are more frequent
PARTS = 6  # of a leg, for the drift within it


class Recorder:
    """Keeps the numbers of a leg from what the witness hears.

    Attributes:
        stamps_ns: Of the odometry.
        latencies: From the truth of each stamp to its odometry [s].
        nis: Of the DVL measurements.
        errors: Squared errors of the body velocity, at whole seconds [m^2/s^2].
    """

    def __init__(self, witness: Witness) -> None:
        self._witness = witness
        self.clear()
        witness.hear(Odometry, TRUTH, self._on_truth)
        witness.hear(Odometry, ODOMETRY, self._on_odometry)
        witness.hear(TwistWithCovarianceStamped, INNOVATION, self._on_innovation)
        witness.hear(Imu, PROCESS_NOISE, lambda data: None)

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
        """Speed of the mission against real time, from the first message to the last."""
        stamp_ns, now = np.subtract(self._last, self._first)
        return float(stamp_ns / NS / now) if now else 0.0

    def _on_odometry(self, data: bytes) -> None:
        """The truth of a stamp is sent with the sample: the rest is the filter's latency."""
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
    """Filter and tuner, which live as long as this, and a simulator for every leg.

    Attributes:
        legs: Number of legs that were flown.
    """

    def __init__(self, processes: Processes, witness: Witness, rate_factor: float) -> None:
        self.processes = processes
        self.rate_factor = rate_factor
        self.witness = witness
        self.recorder = Recorder(self.witness)
        self.began = time.monotonic()
        self.legs = 0
        processes.start("tuner", TUNER, lossless(f"/{IMU}"))
        parameters = {
            **soak.start_parameters(),
            "process_noise.source": "external",
            "max_delay": 10.0,
            "dvl.type": BY_NAME[DVL].types[0],  # subscribed before there is a publisher
            **lossless(f"/{IMU}", f"/{DVL}"),
        }
        processes.start("filter", FILTER, parameters)

        def ready() -> bool:
            processes.check(*CONSUMERS)
            return all(witness.diagnostics.report(node).count for node in CONSUMERS.values())

        witness.until(ready, "the start of filter and tuner")

    def fly(self, number: int, duration: float) -> dict[str, Any]:
        """Fly a leg; its numbers.

        Raises:
            TrialError: A process ended.
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
            witness.spin(LOOK_PERIOD if duration > LONG_LEG else 0.2)
            self.processes.check(*CONSUMERS)
            if recorder.latencies:
                looks.append((time.monotonic(), *(self._memory(n) for n in CONSUMERS)))
        sent = sent_by(self.processes.text(name))
        messages = self._collect(sent, before)
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
            "messages": messages,
            "memory": self._memory_of(np.array(looks)),
            "latency": self._latency(number, duration),
            "nis": _mean(recorder.nis),
            "body_velocity_rmse": _root(_mean(recorder.errors)),
        }

    def _collect(self, sent: dict[str, int], before: dict[str, int]) -> list[dict[str, Any]]:
        """Wait for the last messages, as long as new ones arrive; those sent and received."""

        def messages() -> list[dict[str, Any]]:
            counts = {key: count - before[key] for key, count in self._counts().items()}
            return self._messages(sent, counts)

        self.witness.until_settled(
            messages,
            *CONSUMERS.values(),
            done=lambda: all(row["sent"] == row["received"] for row in messages()),
        )
        return messages()

    def _memory(self, name: str) -> float:
        return soak.memory(self.processes.process(name).pid)

    def _counts(self) -> dict[str, int]:
        value, heard = self.witness.diagnostics.count, self.witness.counts
        return {
            "filter imu": value(FILTER_NODE, f"received {IMU}"),
            "filter dvl": value(FILTER_NODE, f"received {DVL}"),
            "filter q": value(FILTER_NODE, f"received {PROCESS_NOISE}"),
            "tuner imu": value(TUNER_NODE, f"received {IMU}"),
            "tuner q": value(TUNER_NODE, f"sent {PROCESS_NOISE}"),
            "filter odometry": value(FILTER_NODE, f"sent {ODOMETRY}"),
            "heard odometry": heard[ODOMETRY],
            "heard truth": heard[TRUTH],
        }

    def _messages(self, sent: dict[str, int], counts: dict[str, int]) -> list[dict[str, Any]]:
        """Messages sent and received, by topic and consumer; each sample gives one odometry."""
        rows = [
            ("filter", IMU, sent[IMU], counts["filter imu"]),
            ("filter", DVL, sent[DVL], counts["filter dvl"]),
            ("filter", PROCESS_NOISE, counts["tuner q"], counts["filter q"]),
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
        """Memory of each process: first, last and largest [MB], and the slope.

        The slope is that of a line through the second half [MB per hour of mission]. None if the
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
        """Median and 99th percentile of each part of the leg [ms], None without output."""
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
    """A graph at a speed against real time."""
    with (
        tempfile.TemporaryDirectory(prefix="insdvl-soak-") as logs,
        Processes(Path(logs), {"ROS_LOG_DIR": logs}) as processes,
        closing(Witness()) as witness,
    ):
        yield Graph(processes, witness, rate_factor)
