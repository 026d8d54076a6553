"""The arguments of `insdvl evaluate`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from insdvl.commands import Names, examples, unknown_names
from insdvl.jobs.arguments import add_worker_options, worker_faults

#: The names that the modules of the study define; a test holds that they are the same.
SCENARIOS = (
    *("constant", "constant-tableI", "varying", "wide"),
    *("vibrating", "coloured", "waves", "realistic", "bottom-fog", "bottom-tactical"),
)
#: Those of them that may have an IMU of a grade.
GRADED = ("vibrating", "coloured", "waves", "realistic")
GRADES = ("fog", "tactical", "mems")
PRESETS = ("calibrated", "paper", "paper-no-walk")
ROWS = (
    "constant 0.01/0.001",
    "constant 0.2/0.02",
    "adaptive xi=1 literal",
    "adaptive xi=5 literal",
    "adaptive xi=1 floored",
    "adaptive xi=5 floored",
    "adaptive best xi",
    "adaptive variational",
    "adaptive sage-husa Q",
    "adaptive sage-husa Q and R",
    "dnn",
    "dnn default",
    "hcf paper",
    "hcf default",
    "bands",
    "bands with factor",
    "best constant",
    "best constant for SRMSE",
    "closed form",
    "single band",
    "least band",
    "median of spectrum",
    "oracle",
    "matched",
    "zero velocity",
    "perfect heading",
)
#: Rows that are not among all, and have to be asked for.
TRUE_FACTOR_ROWS = ("bands with true factor", "bands with true factors")
TAUGHT = "taught"
R_ROWS = (
    "R nominal",
    "R adaptive",
    "R learned",
    "R adaptive received",
    "R learned received",
    "R oracle",
    "R nominal with factor",
    "R adaptive with factor",
    "bands with R adaptive",
    "bands with R adaptive and DVL error",
    "bands with factor and R adaptive",
    "bands with factor and R adaptive and DVL error",
)
ERROR_STATES = ("invariant", "ned")
MIN_DURATION, DURATION = 10, 330  # s
MIN_RUNS = 2  # fewer give no interval
CONVERGENCE = 90  # s, before the first outage
_RANGES = {
    "--dvl-std": (1e-3, 10.0, " m/s"),
    "--dvl-rate": (0.1, 20.0, ""),
    "--outliers": (0.0, 0.5, ""),
    "--q-factor": (1e-6, 1e6, ""),
    "--outage": (0.0, DURATION - CONVERGENCE, " s"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "evaluate --scenario varying --json varying.json --plot varying.png",
        "evaluate --scenario wide --rows 'hcf default,oracle' --runs 20 --json wide.json",
    )
    parser.set_defaults(faults=_faults)
    parser.add_argument(
        "--scenario",
        default="varying",
        choices=Names(SCENARIOS),
        metavar="NAME",
        help=f"noise and motion: {', '.join(SCENARIOS)} (default: varying)",
    )
    parser.add_argument(
        "--preset",
        default="calibrated",
        choices=Names(PRESETS),
        metavar="NAME",
        help=f"parameters of the filters: {', '.join(PRESETS)} (default: calibrated)",
    )
    parser.add_argument(
        "--error-state",
        default="",
        choices=Names(ERROR_STATES),
        metavar="NAME",
        help=f"{' or '.join(ERROR_STATES)} (default: that of the preset)",
    )
    parser.add_argument(
        "--dvl-std",
        type=float,
        default=0.1,
        metavar="M/S",
        help="noise of the DVL, one sigma (default: 0.1)",
    )
    parser.add_argument(
        "--dvl-rate", type=float, default=1.0, metavar="HZ", help="pings per second (default: 1)"
    )
    parser.add_argument(
        "--imu-grade",
        default="",
        choices=Names(GRADES),
        metavar="NAME",
        help=f"noise and biases of an IMU of a grade in {', '.join(GRADED)}: {', '.join(GRADES)} "
        "(default: those of the scenario)",
    )
    parser.add_argument(
        "--outage",
        type=float,
        default=0.0,
        metavar="S",
        help="length of the outages of the DVL, as many as a mission has room for; errors at their "
        "ends are told (default: 0, none)",
    )
    parser.add_argument(
        "--outliers",
        type=float,
        default=0.0,
        metavar="P",
        help="probability that a ping is off by 1 m/s (default: 0)",
    )
    parser.add_argument(
        "--q-factor",
        type=float,
        default=1.0,
        metavar="F",
        help="factor on the Q that the rows of R are told, to see what a wrong Q does (default: 1)",
    )
    parser.add_argument("--gate", action="store_true", help="use the chi-square gate")
    parser.add_argument(
        "--rows",
        metavar="NAME,NAME",
        help=f"approaches to compare, separated by commas (default: all): {', '.join(ROWS)}; "
        f"{' and '.join(TRUE_FACTOR_ROWS)}, one and one for each channel, which take the level "
        f"of Q from the truth; {TAUGHT}, whose vehicle learns on other missions; "
        f"and those that differ in the noise of the DVL: {', '.join(R_ROWS)}",
    )
    parser.add_argument(
        "--model",
        metavar="FILE",
        help="also evaluate your own model (card next to the file)",
    )
    parser.add_argument(
        "--estimator",
        metavar="PACKAGE.MODULE:FUNCTION",
        help="also evaluate your own estimator, see docs/how-to/estimator.md",
    )
    parser.add_argument(
        "--runs", type=int, default=100, metavar="N", help="number of paired runs (default: 100)"
    )
    parser.add_argument(
        "--tuning-runs",
        type=int,
        default=20,
        metavar="N",
        help="number of runs, with other seeds, that choose the best constant and the best "
        "adaptive filters (default: 20)",
    )
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: 1)")
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help=f"length of the missions (default: {DURATION})",
    )
    parser.add_argument("--json", type=Path, required=True, metavar="FILE", help="JSON output file")
    parser.add_argument(
        "--markdown",
        type=Path,
        metavar="FILE",
        help="Markdown output file of the tables",
    )
    parser.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        help="output file of errors over time: .png, .pdf or .svg",
    )
    add_worker_options(parser)


def _faults(arguments: argparse.Namespace) -> Iterator[str]:
    yield from unknown_names("--scenario", [arguments.scenario], SCENARIOS)
    yield from unknown_names("--preset", [arguments.preset], PRESETS)
    if arguments.error_state:
        yield from unknown_names("--error-state", [arguments.error_state], ERROR_STATES)
    if arguments.imu_grade:
        yield from unknown_names("--imu-grade", [arguments.imu_grade], GRADES)
        if arguments.imu_grade in GRADES and arguments.scenario not in GRADED:
            yield (
                f"--imu-grade needs --scenario {', '.join(GRADED[:-1])} or {GRADED[-1]}, "
                f"got {arguments.scenario}"
            )
    if arguments.rows is not None:
        every = (*ROWS, *TRUE_FACTOR_ROWS, TAUGHT, *R_ROWS)
        yield from unknown_names("--rows", arguments.rows.split(","), every)
    yield from run_faults(arguments)
    for option, (low, high, unit) in _RANGES.items():
        value = getattr(arguments, option.removeprefix("--").replace("-", "_"))
        if not low <= value <= high:
            yield f"{option} must be within {low:g} to {high:g}{unit}, got {value:g}"
    if arguments.duration is not None:
        yield from _duration_faults(arguments.duration, arguments.outage)
    yield from worker_faults(arguments)


def _duration_faults(duration: float, outage: float) -> Iterator[str]:
    if not MIN_DURATION <= duration <= DURATION:
        limits = f"{MIN_DURATION} to {DURATION} s"
        yield f"--duration must be within {limits}, got {duration:g}"
    elif outage > 0.0 and duration < CONVERGENCE + outage:
        yield (
            f"--duration must be at least {CONVERGENCE} s and an outage of {outage:g} s, "
            f"got {duration:g}"
        )


def run_faults(arguments: argparse.Namespace) -> Iterator[str]:
    """What is wrong with --runs, --tuning-runs and --seed."""
    for option, value in ("--runs", arguments.runs), ("--tuning-runs", arguments.tuning_runs):
        if value is not None and value < MIN_RUNS:
            yield f"{option} must be >= {MIN_RUNS}, got {value}"
    if arguments.seed < 0:
        yield f"--seed must be >= 0, got {arguments.seed}"
