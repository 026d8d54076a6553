"""The demo's graph: its processes, and the node that listens to them.

Simulator, tuner and two filters run as separate processes. `/constant/insdvl_filter` keeps its
nominal process noise, `/learned/insdvl_filter` takes it from the tuner.
"""

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rclpy.parameter import Parameter

from insdvl import files
from insdvl.messages import convert
from insdvl.messages.topics import (
    BY_NAME,
    DVL,
    DVL_WITH_COVARIANCE,
    IMU,
    PROCESS_NOISE,
    TRUE_PROCESS_NOISE,
    TRUTH,
)
from insdvl.navigation.geometry.frames import ENU, rpy_from_rotation
from insdvl.parameters.declaration import flatten
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.trajectories import trajectory_named
from ros_insdvl.conversions import message_class
from ros_insdvl.monitor import Monitor
from ros_insdvl_sim.trials.environment import TrialError
from ros_insdvl_sim.trials.names import (
    BIAS,
    FILTER,
    INNOVATION,
    ODOMETRY,
    SIMULATOR,
    TUNER,
    TUNER_NODE,
)
from ros_insdvl_sim.trials.processes import Processes, lossless, sent_by
from ros_insdvl_sim.trials.witness import Witness

TRAJECTORY = "auv"
IMU_RATE = 100.0  # Hz
FILTERS = ("/constant", "/learned")
FILTER_NODES = {namespace: f"{namespace}/insdvl_filter" for namespace in FILTERS}
CONSUMERS = ("tuner", "constant", "learned")  # processes
CONSUMER_NODES = (TUNER_NODE, *FILTER_NODES.values())

OUTPUT_DELAY = 2.0  # s, of the filters' odometry
QUIET_REPORTS = 6  # of each node without any new message, after which the rest is lost

#: Type of each recorded topic.
RECORDED = {
    **{
        f"/{topic}": BY_NAME[topic].types[0]
        for topic in (IMU, DVL, PROCESS_NOISE, TRUTH, TRUE_PROCESS_NOISE)
    },
    **{
        f"{namespace}/{topic}": kind
        for namespace in FILTERS
        for topic, kind in (
            (ODOMETRY, convert.ODOMETRY),
            (BIAS, convert.IMU),
            (INNOVATION, convert.TWIST_WITH_COVARIANCE),
        )
    },
}


@dataclass(frozen=True)
class Count:
    """Messages of a topic that a node sent, and those that one consumer received."""

    consumer: str
    topic: str
    sent: int
    received: int


def initial_parameters(seed: int) -> dict[str, Any]:
    """Parameters of the initial state: the truth at the first IMU stamp with an error from P_0."""
    trajectory = trajectory_named(TRAJECTORY)
    truth = trajectory.truth(np.array([1.0 / IMU_RATE]))
    drawn = drawn_initial(truth, P_0, np.random.default_rng([seed, 1]))
    return {
        "initial": {
            **{name: value for name, value in flatten(P_0).items() if name.endswith("_std")},
            "mode": "parameters",
            "position": (ENU.nav @ drawn.p_o).tolist(),
            "rpy": rpy_from_rotation(ENU.attitude(drawn.C_o_b)).tolist(),
            "velocity": (ENU.body @ drawn.v).tolist(),
            "velocity_frame": drawn.velocity_frame,
        },
        "origin": {
            "latitude_deg": float(np.degrees(trajectory.lat_0)),
            "longitude_deg": float(np.degrees(trajectory.lon_0)),
            "height": float(trajectory.h_0),
        },
    }


def start_consumers(processes: Processes, out: Path, initial: Mapping[str, Any]) -> None:
    """Start the tuner and both filters; their parameters are saved for `insdvl replay`."""
    processes.start("tuner", TUNER, lossless(f"/{IMU}"))
    shared = (IMU, DVL, DVL_WITH_COVARIANCE, PROCESS_NOISE)
    remaps = {topic: f"/{topic}" for topic in shared}
    for namespace, source in zip(FILTERS, ("constant", "external"), strict=True):
        name = namespace.strip("/")
        parameters = out / f"{name}.yaml"
        # As in the evaluation: with the gate, a wrong Q would mostly cost rejected measurements.
        section = {
            **initial,
            "gate": {"enabled": False},
            # The output waits for the DVL and for Q, so the seed alone decides the result; a tuner
            # that is held up does not make its Q too late.
            "output_delay": OUTPUT_DELAY,
            "max_delay": 10.0,
            "process_noise": {"source": source},
            "dvl": {"type": BY_NAME[DVL].types[0]},  # subscribed before there is a publisher
        }
        document = {"/**/insdvl_filter": {"ros__parameters": section}}
        files.write(parameters, yaml.safe_dump(document, sort_keys=False).encode())
        processes.start(
            name,
            FILTER,
            lossless(f"/{IMU}", f"/{DVL}"),
            {"__ns": namespace, **remaps},
            parameter_file=parameters,
        )


def start_simulator(
    processes: Processes,
    *,
    duration: float,
    seed: int,
    scenario: str,
    rate_factor: float,
    subscribers: int,
) -> None:
    """Start the simulator; it plays when so many subscribers of the IMU are there."""
    values = {
        "trajectory": TRAJECTORY,
        "duration": duration,
        "seed": seed,
        "rate_factor": rate_factor,
        "noise.profile": scenario,
        "min_subscribers": subscribers,
    }
    processes.start("simulator", SIMULATOR, values)


class Listener:
    """The monitor, which keeps everything, and a recorder if wanted.

    Args:
        witness: Turns the monitor.
        writer: Of the recording, None for none.

    Attributes:
        monitor: The monitor.
        recorded: Recorded messages by topic.
    """

    def __init__(self, witness: Witness, writer: BagWriter | None) -> None:
        self._witness = witness
        topics = [f"/{TRUTH}", *(f"{name}/{ODOMETRY}" for name in FILTERS)]
        overrides = {"filters": list(FILTERS), "keep": 10_000_000, **lossless(*topics)}
        self.monitor = witness.add(
            Monitor(
                context=witness.context,
                parameter_overrides=[Parameter(name, value=v) for name, v in overrides.items()],
            )
        )
        self.recorded: Counter[str] = Counter()
        if writer is not None:
            for topic, kind in RECORDED.items():
                self.recorded[topic] = 0
                self._record(writer, topic, kind)

    def _record(self, writer: BagWriter, topic: str, kind: str) -> None:
        def write(data: bytes) -> None:
            writer.write(Raw(topic, kind, time.time_ns(), data))
            self.recorded[topic] += 1

        self._witness.hear(message_class(kind), topic, write)

    def counts(self, sent: Mapping[str, int]) -> list[Count]:
        """Messages sent and received.

        Args:
            sent: By the simulator, per topic.
        """
        return list(self._counts(sent))

    def _counts(self, sent: Mapping[str, int]) -> Iterator[Count]:
        reported = self._witness.diagnostics.count
        q_sent = reported(TUNER_NODE, f"sent {PROCESS_NOISE}")
        yield Count("tuner", IMU, sent[IMU], reported(TUNER_NODE, f"received {IMU}"))
        for name, node in FILTER_NODES.items():
            for topic in (IMU, DVL):
                yield Count(
                    f"{name} filter", topic, sent[topic], reported(node, f"received {topic}")
                )
        learned = reported(FILTER_NODES["/learned"], f"received {PROCESS_NOISE}")
        yield Count("/learned filter", PROCESS_NOISE, q_sent, learned)
        received = self.monitor.received
        for topic in (TRUTH, TRUE_PROCESS_NOISE):
            yield Count("demo", topic, sent[topic], received[topic])
        yield Count("demo", PROCESS_NOISE, q_sent, received[PROCESS_NOISE])
        for name, node in FILTER_NODES.items():
            topic = f"{name}/{ODOMETRY}"
            yield Count("demo", topic, reported(node, f"sent {ODOMETRY}"), received[topic])
        for topic, recorded in self.recorded.items():
            owner = next((name for name in FILTERS if topic.startswith(name)), None)
            if owner is not None:
                of_node = topic.removeprefix(f"{owner}/")
                all_sent = reported(FILTER_NODES[owner], f"sent {of_node}")
            else:
                all_sent = q_sent if topic == f"/{PROCESS_NOISE}" else sent[topic.lstrip("/")]
            yield Count("recording", topic, all_sent, recorded)


def wait_until_ready(processes: Processes, witness: Witness) -> None:
    """Wait for the consumers, then make sure that nothing else publishes their IMU.

    Raises:
        TrialError: A process ended, they do not come up, or there is another publisher.
    """

    def ready() -> bool:
        processes.check(*CONSUMERS)
        return all(witness.diagnostics.report(node).count for node in CONSUMER_NODES)

    witness.until(ready, "the start of all nodes")
    if witness.node.count_publishers(f"/{IMU}"):
        raise TrialError(
            f"/{IMU} already has a publisher; not starting, the filters would receive both: stop "
            "it, or choose another ROS_DOMAIN_ID"
        )


def fly(processes: Processes, witness: Witness) -> dict[str, int]:
    """Let the mission run to its end; messages that the simulator sent, per topic.

    Raises:
        TrialError: A process ended.
    """
    while not processes.finished("simulator"):
        witness.spin(0.2)
        processes.check(*CONSUMERS)
    return sent_by(processes.text("simulator"))


def collect(
    processes: Processes, witness: Witness, listener: Listener, sent: Mapping[str, int]
) -> list[Count]:
    """Wait for the last messages, as long as new ones arrive; the counts.

    Raises:
        TrialError: A process ended.
    """

    def complete() -> bool:
        processes.check(*CONSUMERS)
        return all(count.sent == count.received for count in listener.counts(sent))

    witness.until_settled(
        lambda: listener.counts(sent), *CONSUMER_NODES, done=complete, reports=QUIET_REPORTS
    )
    return listener.counts(sent)
