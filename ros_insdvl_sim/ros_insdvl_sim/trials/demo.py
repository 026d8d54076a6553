"""The demo: a simulated AUV, navigated by two filters at once in a real graph.

This process starts the graph (see `demo_graph`), listens, shows a live table, and at the end counts
the messages, scores both filters against the truth and draws them.
"""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message

from insdvl import files
from insdvl.recordings.bag_writer import BagWriter
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import trajectory_named
from insdvl.studies.report import plots
from ros_insdvl_sim.trials.demo_graph import (
    FILTERS,
    OUTPUT_DELAY,
    TRAJECTORY,
    Count,
    Listener,
    collect,
    fly,
    initial_parameters,
    start_consumers,
    start_simulator,
    wait_until_ready,
)
from ros_insdvl_sim.trials.demo_result import Outcome, evaluate, gain, print_counts, print_scores
from ros_insdvl_sim.trials.environment import exit_code_of, graph_environment
from ros_insdvl_sim.trials.processes import Processes
from ros_insdvl_sim.trials.witness import Witness

#: Speed against real time that leaves two cores some room (idle, they lose nothing at 16), on a
#: machine that serialises and deserialises an odometry message in this time.
FULL_SPEED = 10.0
REFERENCE_MESSAGE_TIME = 90e-6  # s

RECORDING_SPEED = 0.6  # of the speed without a recorder, which takes as much as all else


def choose_rate_factor() -> float:
    """The speed that this machine can hold, from its cores and its time per message."""
    message, repeats = Odometry(), 100
    message_time = math.inf
    for _ in range(20):  # the fastest of many short runs is the machine's, not its load's
        begin = time.perf_counter()
        for _ in range(repeats):
            deserialize_message(serialize_message(message), Odometry)
        message_time = min(message_time, (time.perf_counter() - begin) / repeats)
    cores = len(os.sched_getaffinity(0))
    factor = FULL_SPEED * min(1.0, cores / 2) * min(1.0, REFERENCE_MESSAGE_TIME / message_time)
    return max(round(factor, 1), 0.5)


def second_terminal(variables: Mapping[str, str]) -> tuple[str, ...]:
    """How to look at the running graph, in lines."""
    exports = " ".join(f"{name}={value}" for name, value in variables.items())
    monitor = Path(get_package_prefix("ros_insdvl")) / "lib/ros_insdvl/monitor"
    return (
        "In a second terminal, with a full ROS 2 Jazzy:",
        f"  export {exports}",
        "  ros2 topic echo /learned/odometry/filtered --field pose.pose.position",
        "  ros2 topic echo /process_noise --field linear_acceleration_covariance",
        "  ros2 topic echo /diagnostics",
        "or, with the packages installed here:",
        f"  {exports} AMENT_PREFIX_PATH={os.environ['AMENT_PREFIX_PATH']} {monitor} "
        "--ros-args -p 'filters:=[/constant, /learned]'",
    )


@contextmanager
def recording(path: Path | None) -> Iterator[BagWriter | None]:
    """A new recording, or None."""
    if path is None:
        yield None
        return
    with BagWriter(path) as writer:
        yield writer


def fly_demo(options: argparse.Namespace) -> int:
    """Fly the demo and report it; the exit code."""
    began = time.monotonic()
    out: Path = options.out
    logs = out / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    variables = graph_environment()
    os.environ.update(variables)
    share = 1.0 if options.record is None else RECORDING_SPEED
    rate_factor = options.rate_factor or round(share * choose_rate_factor(), 1)
    duration = options.duration or trajectory_named(TRAJECTORY).duration
    print(
        f"{duration:g} s of mission, scenario {options.scenario}, seed {options.seed}, "
        f"at {rate_factor:g} times real time; gate off, as in the evaluation"
    )
    how_to_look = second_terminal(variables)
    print(*how_to_look, "", sep="\n", flush=True)

    with closing(Witness("demo")) as witness:
        with Processes(logs) as processes, recording(options.record) as writer:
            listener = Listener(witness, writer)
            listener.monitor.notes = how_to_look
            start_consumers(processes, out, initial_parameters(options.seed))
            wait_until_ready(processes, witness)
            start_simulator(
                processes,
                duration=options.duration,
                seed=options.seed,
                scenario=options.scenario,
                rate_factor=rate_factor,
                subscribers=len(FILTERS) + 1 + (writer is not None),
            )
            sent = fly(processes, witness)
            counts = collect(processes, witness, listener, sent)
        codes = processes.stop()
        outcome = evaluate(listener.monitor)
        rejected = {w.label.strip("/"): w.rejected for w in listener.monitor.filters}

    picture, summary = out / "mission.png", out / "summary.json"
    draw(picture, outcome, f"{duration:g} s AUV mission, scenario {options.scenario}", options.seed)
    print_counts(counts)
    print("rejected by the filters: " + ", ".join(f"{k} {n}" for k, n in rejected.items()))
    print_scores(outcome.scores)
    wall_time = time.monotonic() - began
    numbers = {
        "scenario": options.scenario,
        "seed": options.seed,
        "duration": duration,
        "rate_factor": rate_factor,
        "wall_time": round(wall_time, 2),
        "filters": {name: asdict(s) for name, s in outcome.scores.items()},
        "messages": [asdict(count) for count in counts],
        "rejected": rejected,
        "exit_codes": codes,
    }
    files.write(summary, (json.dumps(numbers, indent=2) + "\n").encode())
    print(f"\n{picture}\n{summary}\n{wall_time:.1f} s in all")
    if options.record is not None:
        print(f"{listener.recorded.total()} messages in {options.record}")
    return verdict(processes, codes, counts)


def draw(picture: Path, outcome: Outcome, mission: str, seed: int) -> None:
    """Draw the mission with both filters' errors."""
    title = f"{gain(outcome.scores)}\n{mission}, seed {seed}"
    plots.draw_mission(picture, title, outcome.t, outcome.truth, outcome.results, outcome.noises)


def verdict(processes: Processes, codes: Mapping[str, int], counts: list[Count]) -> int:
    """The exit code: 1 if a process failed or a message was lost, which is printed."""
    failed = {name: code for name, code in codes.items() if code != 0}
    for name, code in failed.items():
        print(f"{name} ended with exit code {code}, see {processes.log(name)}", file=sys.stderr)
    complete = all(count.sent == count.received for count in counts)
    if not complete:
        print("messages were lost", file=sys.stderr)
    return 0 if complete and not failed else 1


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", choices=tuple(SCENARIOS), default="varying")
    parser.add_argument("--seed", type=int, default=1, help="random seed")
    parser.add_argument(
        "--duration", type=float, default=0.0, help="seconds of mission; 0 flies all of it"
    )
    parser.add_argument(
        "--rate-factor",
        type=float,
        default=0.0,
        help="speed; 0 chooses what the machine holds",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("demo-output"), help="folder of the results"
    )
    parser.add_argument("--record", type=Path, metavar="BAG", help="record all topics as a rosbag2")
    options = parser.parse_args(arguments)
    shortest, longest = 2 * OUTPUT_DELAY, trajectory_named(TRAJECTORY).duration
    if options.duration and not shortest <= options.duration <= longest:
        parser.error(
            f"--duration must be 0 or from {shortest:g} to {longest:g} s, got {options.duration:g}"
        )
    if options.rate_factor < 0.0 or not math.isfinite(options.rate_factor):
        parser.error(f"--rate-factor must be 0 or above, got {options.rate_factor:g}")
    if options.seed < 0:
        parser.error(f"--seed must be 0 or above, got {options.seed}")
    return options


def main() -> int:
    """Run the demo from the command line."""
    options = parse(None)
    return exit_code_of("demo", lambda: fly_demo(options), failed=1)


if __name__ == "__main__":
    sys.exit(main())
