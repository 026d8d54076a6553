"""The command `insdvl evaluate`: the comparison of all approaches in one scenario."""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

from insdvl.files import check_writable, json_text, write
from insdvl.jobs.options import workers_from
from insdvl.jobs.pool import TaskError, open_pool
from insdvl.jobs.store import Store
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.trajectories import AUV
from insdvl.studies.arguments.evaluation import ERROR_STATES
from insdvl.studies.evaluation import comparison, tables
from insdvl.studies.evaluation.approaches import (
    OWN_ESTIMATOR,
    OWN_MODEL,
    PRESETS,
    R_SOURCES,
    ROWS,
    TAUGHT,
    Setting,
    fingerprint,
)
from insdvl.studies.evaluation.comparison import Plan, compare
from insdvl.studies.evaluation.options import check_names, check_numbers
from insdvl.tuner.models import load_model
from insdvl.tuner.own import OwnEstimator

EVALUATED = (*SCENARIOS, *DRAWN)
#: Of the options that are numbers of the rows of R.
_RANGES = {"dvl_rate": (0.1, 20.0), "outliers": (0.0, 0.5), "q_factor": (1e-6, 1e6)}


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; the exit code is 2 for invalid input, and then nothing is written."""
    try:
        plan = _plan(arguments)
        for option in ("json", "markdown", "plot"):
            file = getattr(arguments, option)
            if file is not None:
                check_writable(file, f"--{option}")
        if arguments.plot is not None:
            from insdvl.studies.report.plots import draw_errors_over_time, format_of

            format_of(arguments.plot)
        with open_pool(workers_from(arguments)) as pool:
            store = Store(
                arguments.json.with_name(arguments.json.name + ".work"),
                {"plan": asdict(plan), "models": fingerprint(plan.rows)},
                Path(comparison.__file__),
            )
            compared = compare(plan, pool, store)
        text = tables.comparison_tables(compared.document)
        write(arguments.json, json_text(compared.document).encode())
        if arguments.markdown is not None:
            write(arguments.markdown, text.encode())
        if arguments.plot is not None:
            draw_errors_over_time(arguments.plot, plan.scenario, compared.series)
        store.clear()
    except TaskError as error:
        print(f"insdvl evaluate: {error}", file=sys.stderr)
        return 1
    except (ValueError, OSError) as error:
        print(f"insdvl evaluate: {error}", file=sys.stderr)
        return 2
    print(text)
    return 0


def _plan(arguments: argparse.Namespace) -> Plan:
    rows = ROWS if arguments.rows is None else tuple(arguments.rows.split(","))
    check_names("--scenario", [arguments.scenario], EVALUATED)
    check_names("--preset", [arguments.preset], PRESETS)
    if arguments.error_state:
        check_names("--error-state", [arguments.error_state], ERROR_STATES)
    every = (*ROWS, TAUGHT, *R_SOURCES)
    check_names("--rows", rows, every)
    check_numbers(arguments)
    if not 1e-3 <= arguments.dvl_std <= 10.0:
        raise ValueError(f"--dvl-std must be within 0.001 to 10 m/s, got {arguments.dvl_std:g}")
    if arguments.duration is not None and not 10.0 <= arguments.duration <= AUV.duration:
        raise ValueError(
            f"--duration must be within 10 to {AUV.duration:g} s, got {arguments.duration:g}"
        )
    for name, (low, high) in _RANGES.items():
        value = getattr(arguments, name)
        if not low <= value <= high:
            option = "--" + name.replace("_", "-")
            raise ValueError(f"{option} must be within {low:g} to {high:g}, got {value:g}")
    rows = tuple(row for row in every if row in rows)
    if arguments.model is not None:
        load_model(arguments.model)
        rows += (f"{OWN_MODEL}{arguments.model}",)
    if arguments.estimator is not None:
        OwnEstimator(arguments.estimator)
        rows += (f"{OWN_ESTIMATOR}{arguments.estimator}",)
    return Plan(
        scenario=arguments.scenario,
        setting=Setting(
            arguments.preset,
            arguments.error_state,
            arguments.gate,
            arguments.dvl_std,
            arguments.dvl_rate,
            arguments.outliers,
            arguments.q_factor,
        ),
        runs=arguments.runs,
        tuning_runs=arguments.tuning_runs,
        seed=arguments.seed,
        rows=rows,
        duration=arguments.duration,
    )
