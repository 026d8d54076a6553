"""Rows of the tuner: it dies, comes late, cannot start, floods."""

from insdvl.messages.topics import PROCESS_NOISE
from insdvl.studies.faults.expectation import Check
from ros_insdvl.status.heard import WARN
from ros_insdvl_sim.trials.names import FILTER_NODE, TUNER, TUNER_NODE
from ros_insdvl_sim.trials.process_rows.checks import counted, error_below, lost_of_all_sent
from ros_insdvl_sim.trials.process_rows.flight import DURATION, LiveFlight
from ros_insdvl_sim.trials.process_rows.judgement import Flown
from ros_insdvl_sim.trials.process_rows.row import AFTER, PROCESSES, LiveRow
from ros_insdvl_sim.trials.process_rows.steps import (
    at,
    complaint,
    finish,
    kill,
    note,
    paused,
    recovery,
    start_filter,
    start_simulator,
    start_tuner,
    wait_for_end,
)
from ros_insdvl_sim.trials.processes import lossless

EXTERNAL = {"process_noise.source": "external"}
CAUSE = "process noise"


def _start_with_a_wrong_model(flight: LiveFlight) -> None:
    model = flight.folder / "model.npz"
    model.write_bytes(b"PK\x03\x04 not a model")
    flight.processes.start("tuner", TUNER, {"model": str(model)})


def _warned_before(flown: Flown) -> tuple[str, bool]:
    status = flown.flight.notes["before"]
    seen = f"level {status.level}: {status.message}"
    return seen, status.level == WARN and "nominal" in status.message


def _ended_with_a_line(flown: Flown) -> tuple[str, bool]:
    code = flown.flight.codes["tuner"]
    text = flown.flight.processes.text("tuner").strip()
    clear = "model" in text and "Traceback" not in text
    return f"ended with {code}; {'a clear line' if clear else text[-200:]}", code == 1 and clear


def _every_q_is_used(flown: Flown) -> tuple[str, bool]:
    flight = flown.flight
    sent, arrived = (
        flight.count(f"sent {PROCESS_NOISE}", TUNER_NODE),
        flight.count(f"received {PROCESS_NOISE}"),
    )
    values = flight.witness.diagnostics.report(FILTER_NODE).values
    prefix = f"rejected {PROCESS_NOISE}: "
    refused = sum(int(value) for key, value in values.items() if key.startswith(prefix))
    seen = f"{arrived} of {sent} arrived, {refused} were refused"
    return seen, arrived == sent > 5000 and not refused


ROWS = (
    LiveRow(
        PROCESSES,
        "the tuner is killed at 20 s and started again at 35 s",
        (
            start_tuner(),
            start_filter(),
            start_simulator(subscribers=2),
            at(20.0),
            kill("tuner"),
            at(35.0),
            paused(complaint(CAUSE), start_tuner("tuner again")),
            recovery(CAUSE),
            finish(),
        ),
        (
            counted(
                "Q nominal after q_timeout, a warning, and recovered with the new tuner",
                "q_timeouts",
                1,
                "time-outs {count}, warned and recovered",
            ),
            error_below(1.0, AFTER),
        ),
        begin=20.0,
        end=40.0,
        lost=lost_of_all_sent,
        parameters=EXTERNAL,
    ),
    LiveRow(
        PROCESSES,
        "the tuner starts 20 s late",
        (
            start_filter(),
            start_simulator(),
            at(20.0),
            paused(
                note("before", lambda flight: flight.witness.status(FILTER_NODE, CAUSE)),
                start_tuner(),
            ),
            recovery(CAUSE),
            finish(),
        ),
        (
            Check("until then a warning and the nominal Q", _warned_before),
            error_below(1.0, AFTER),
        ),
        begin=0.0,
        end=20.0,
        lost=lost_of_all_sent,
        parameters=EXTERNAL,
    ),
    LiveRow(
        PROCESSES,
        "the tuner has a wrong model",
        (_start_with_a_wrong_model, wait_for_end("tuner")),
        (Check("it ends with 1 and a line that names the model", _ended_with_a_line),),
    ),
    LiveRow(
        PROCESSES,
        "the tuner floods: a Q with every sample",
        (start_tuner(rate=100.0), start_filter(), start_simulator(subscribers=2), finish()),
        (
            Check("every Q arrives and is used, and no sample is lost for it", _every_q_is_used),
            error_below(1.0, AFTER),
        ),
        begin=5.0,
        end=DURATION - AFTER - 5.0,
        lost=lost_of_all_sent,
        parameters={**EXTERNAL, **lossless(f"/{PROCESS_NOISE}")},
    ),
)
