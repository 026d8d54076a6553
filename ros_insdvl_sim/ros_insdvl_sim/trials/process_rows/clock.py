"""Rows of /clock: it never comes, or stops."""

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from insdvl.navigation.events import NS
from insdvl.studies.faults.expectation import Check
from ros_insdvl_sim.trials.names import FILTER_NODE
from ros_insdvl_sim.trials.process_rows.checks import (
    error_below,
    every_sample_in_the_output,
    lost_of_all_sent,
)
from ros_insdvl_sim.trials.process_rows.flight import DURATION, START_S, LiveFlight
from ros_insdvl_sim.trials.process_rows.judgement import Flown
from ros_insdvl_sim.trials.process_rows.row import AFTER, PROCESSES, LiveRow
from ros_insdvl_sim.trials.process_rows.steps import finish, start_filter, start_simulator
from ros_insdvl_sim.trials.witness import stamp_of

SIM_TIME = {"use_sim_time": True}
STOP_S = 20.0  # of the mission


def _stop_clock(flight: LiveFlight) -> None:
    """The simulator's /clock goes through the witness, which keeps back what is later."""
    clock = flight.witness.node.create_publisher(Clock, "/clock", 10)
    stop_ns = round((START_S + STOP_S) * NS)
    flight.notes.update(clock_ns=0, filter_ns=0)

    def pass_on(message: Clock) -> None:
        time_ns = message.clock.sec * NS + message.clock.nanosec
        if time_ns <= stop_ns:
            flight.notes["clock_ns"] = time_ns
            clock.publish(message)

    def look(data: bytes) -> None:
        status = deserialize_message(data, DiagnosticArray).status[0]
        if status.name.startswith(f"{FILTER_NODE.lstrip('/')}:"):
            flight.notes["filter_ns"] = stamp_of(data)

    flight.witness.node.create_subscription(Clock, "sent/clock", pass_on, 10)
    flight.witness.hear(DiagnosticArray, "/diagnostics", look)


def _filter_clock_stands(flown: Flown) -> tuple[str, bool]:
    clock_ns, filter_ns = flown.flight.notes["clock_ns"], flown.flight.notes["filter_ns"]
    clock_s, filter_s = clock_ns / NS - START_S, filter_ns / NS - START_S
    seen = f"/clock stopped at {clock_s:.2f} s, the filter's clock at {filter_s:.2f} s"
    return seen, filter_ns == clock_ns and clock_s > STOP_S - 1.0


ROWS = (
    LiveRow(
        PROCESSES,
        "use_sim_time is set and there is no /clock",
        (
            start_filter(),
            # In real time the simulator sends no /clock; its stamps follow start_stamp anyway.
            start_simulator(rate_factor=0.0, duration=10.0),
            finish(),
        ),
        (every_sample_in_the_output(),),
        parameters=SIM_TIME,
    ),
    LiveRow(
        PROCESSES,
        "use_sim_time is set and /clock stops at 20 s, the sensors go on",
        (
            _stop_clock,
            start_filter(),
            start_simulator(remaps={"/clock": "sent/clock"}),
            finish(),
        ),
        (
            Check("the filter's own clock stands still from then on", _filter_clock_stands),
            every_sample_in_the_output(),
            error_below(1.0, AFTER),
        ),
        begin=STOP_S,
        end=DURATION - AFTER - 5.0,
        lost=lost_of_all_sent,
        parameters=SIM_TIME,
    ),
)
