"""The command `insdvl evaluate`: the comparison of all approaches in one scenario."""

import argparse
import sys
from pathlib import Path

from insdvl.files import check_writable, json_text, write
from insdvl.jobs.options import workers_from
from insdvl.jobs.pool import TaskError, open_pool
from insdvl.jobs.store import Store
from insdvl.studies.evaluation import comparison, tables
from insdvl.studies.evaluation.approaches import (
    OWN_ESTIMATOR,
    OWN_MODEL,
    R_SOURCES,
    ROWS,
    TAUGHT,
    TRUE_FACTOR,
    TRUE_FACTORS,
    Setting,
    fingerprint,
)
from insdvl.studies.evaluation.comparison import Plan, compare
from insdvl.studies.evaluation.sensors import Sensors
from insdvl.tuner.models import load_model
from insdvl.tuner.own import OwnEstimator


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; the exit code is 2 for invalid input, and then nothing is written."""
    try:
        plan = _plan(arguments)
        _check_places(arguments)
        with open_pool(workers_from(arguments)) as pool:
            store = Store(
                arguments.json.with_name(arguments.json.name + ".work"),
                {"plan": plan.document(), "models": fingerprint(plan.rows)},
                Path(comparison.__file__),
            )
            compared = compare(plan, pool, store)
        text = tables.comparison_tables(compared.document)
        write(arguments.json, json_text(compared.document).encode())
        if arguments.markdown is not None:
            write(arguments.markdown, text.encode())
        if arguments.plot is not None:
            from insdvl.studies.report.plots import draw_errors_over_time

            draw_errors_over_time(arguments.plot, plan.scenario, compared.series)
        store.clear()
    except TaskError as error:
        print(f"insdvl evaluate: {error}", file=sys.stderr)
        return 1
    except (ValueError, OSError) as error:
        for line in str(error).splitlines():
            print(f"insdvl evaluate: {line}", file=sys.stderr)
        return 2
    print(text)
    return 0


def _check_places(arguments: argparse.Namespace) -> None:
    """Check before the long computation that the results can be written.

    Raises:
        ValueError: A line for each that cannot.
    """
    faults = []
    for option in ("json", "markdown", "plot"):
        file = getattr(arguments, option)
        try:
            if file is not None:
                check_writable(file, f"--{option}")
            if option == "plot" and file is not None:
                from insdvl.studies.report.plots import format_of

                format_of(file)
        except ValueError as error:
            faults.append(str(error))
    if faults:
        raise ValueError("\n".join(faults))


def _plan(arguments: argparse.Namespace) -> Plan:
    rows = ROWS if arguments.rows is None else tuple(arguments.rows.split(","))
    every = (*ROWS, TRUE_FACTOR, TRUE_FACTORS, TAUGHT, *R_SOURCES)
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
            arguments.q_factor,
            Sensors(
                dvl_std=arguments.dvl_std,
                dvl_rate=arguments.dvl_rate,
                outliers=arguments.outliers,
                imu_grade=arguments.imu_grade,
                outage=arguments.outage,
            ),
        ),
        runs=arguments.runs,
        tuning_runs=arguments.tuning_runs,
        seed=arguments.seed,
        rows=rows,
        duration=arguments.duration,
    )
