"""What is done in a row, step by step."""

import signal
import time
from collections.abc import Callable, Mapping
from typing import Any

from insdvl.messages.topics import DVL, IMU
from insdvl.navigation.events import NS
from ros_insdvl_sim.trials.process_rows.flight import START_S, LiveFlight, Restart, Step


def start_filter(name: str = "filter", environment: Mapping[str, str] | None = None) -> Step:
    """Start a filter with the parameters of the row."""
    return lambda flight: flight.start_filter(name, environment)


def start_tuner(name: str = "tuner", **parameters: Any) -> Step:
    """Start a tuner."""
    return lambda flight: flight.start_tuner(name, parameters)


def start_relay(**parameters: Any) -> Step:
    """Start a relay; the simulator's sensors reach the filter through it."""
    return lambda flight: flight.start_relay(parameters)


def start_simulator(
    subscribers: int = 1,
    name: str = "simulator",
    remaps: Mapping[str, str] | None = None,
    **parameters: Any,
) -> Step:
    """Start the simulator; it plays when so many subscribers of its IMU are there."""
    return lambda flight: flight.start_simulator(subscribers, name, parameters, remaps)


#: Remaps of the simulator by which its sensors go through the relay.
THROUGH_RELAY = {topic: f"sent/{topic}" for topic in (IMU, DVL)}


def at(seconds: float) -> Step:
    """Wait for a time of the mission [s]."""
    return lambda flight: flight.until_stamp(seconds)


def paused(*steps: Step) -> Step:
    """Do steps while the mission stands still."""

    def step(flight: LiveFlight) -> None:
        with flight.pause():
            for each in steps:
                each(flight)

    return step


def the_fault_begins(flight: LiveFlight) -> None:
    """Complaints count from now on."""
    flight.since = time.monotonic()


def kill(name: str) -> Step:
    """Kill a process: the fault begins."""

    def step(flight: LiveFlight) -> None:
        flight.processes.end(name, signal.SIGKILL)
        the_fault_begins(flight)

    return step


def end(name: str, *signals: int, gap: float = 0.0, label: str | None = None) -> Step:
    """End a process by signals, with a time in between [s], and keep its exit code."""

    def step(flight: LiveFlight) -> None:
        *first, last = signals
        for number in first:
            flight.processes.process(name).send_signal(number)
            time.sleep(gap)  # the next one meets another stage of the end
        flight.codes[label or name] = flight.processes.end(name, last)

    return step


def wait_for_end(name: str) -> Step:
    """Wait until a process ends by itself, and keep its exit code."""

    def step(flight: LiveFlight) -> None:
        process = flight.processes.process(name)
        flight.witness.until(lambda: process.poll() is not None, f"the end of {name}")
        flight.codes[name] = process.returncode

    return step


def complaint(cause: str) -> Step:
    """Wait until the filter complains of a cause."""
    return lambda flight: flight.until_complaint(cause)


def recovery(cause: str) -> Step:
    """Wait until the filter's status of a cause is well."""
    return lambda flight: flight.until_recovered(cause)


def finish(name: str = "simulator") -> Step:
    """Wait until a simulator has sent its mission, and all of it has arrived."""
    return lambda flight: flight.finish(name)


def note(name: str, see: Callable[[LiveFlight], Any]) -> Step:
    """Keep what is seen now."""

    def step(flight: LiveFlight) -> None:
        flight.notes[name] = see(flight)

    return step


def restart_filter(killed_at: float, started_at: float) -> Step:
    """Kill the filter at a time of the mission, and start it again at another [s]."""

    def step(flight: LiveFlight) -> None:
        flight.until_stamp(killed_at)
        kill("filter")(flight)
        last_ns = flight.odometry[-1][0]
        flight.until_stamp(started_at)
        with flight.pause():
            index = len(flight.odometry)
            flight.start_filter("filter again")
        flight.witness.until(lambda: len(flight.odometry) > index, "odometry of the second filter")
        first_ns = flight.odometry[index][0]
        flight.restart = Restart(last_ns / NS - START_S, first_ns / NS - START_S, index)

    return step
