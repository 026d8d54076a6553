"""The command `insdvl results`: every number and picture of docs/results.md, and the page itself.

The page is made of parts; the numbers of each are a JSON file beside it, from which it is written.
A part that is not computed this time keeps its file, so that the page can be written again without
the recordings, or after a part alone.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from insdvl.files import check_writable, json_text, read_parts, write
from insdvl.jobs import parallel
from insdvl.jobs.parallel import Pool, Store, TaskError
from insdvl.simulation.noise import SCENARIOS
from insdvl.studies.evaluation import accuracy, page, plots, vehicle, window
from insdvl.studies.evaluation.approaches import (
    BEST_CONSTANT,
    CLOSED_FORM,
    FIRST_CONSTANT,
    LEARNED,
    ORACLE,
    Setting,
    fingerprint,
)
from insdvl.studies.evaluation.comparison import Plan, compare
from insdvl.studies.evaluation.options import check_names, check_numbers
from insdvl.tuner.models import load_model

#: Rows of the tables that show what an error state or the gate changes.
_FEW = (FIRST_CONSTANT, "hcf default", BEST_CONSTANT, CLOSED_FORM, ORACLE)
#: Rows of the pictures over time.
_DRAWN = (FIRST_CONSTANT, BEST_CONSTANT, "hcf default", ORACLE)

#: The comparisons, by part.
PLANS: Mapping[str, Plan] = {
    **{
        f"{scenario}-{preset}": Plan(scenario, Setting(preset))
        for preset in ("calibrated", "paper")
        for scenario in SCENARIOS
    },
    "constant-paper-no-walk": Plan("constant", Setting("paper-no-walk"), rows=_FEW),
    "varying-ned": Plan("varying", Setting("calibrated", error_state="ned"), rows=_FEW),
    "varying-gate": Plan("varying", Setting("calibrated", gate=True), rows=_FEW),
}
ACCURACY, WINDOW, VEHICLE = "q-accuracy", "window", "vehicle"
PARTS = (ACCURACY, *PLANS, WINDOW, VEHICLE)
_WINDOW_RUNS = 10
_RECORDING_RUNS, _RECORDING_TUNING_RUNS = 10, 3  # of each recording and injection


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--out", type=Path, default=Path("docs"), metavar="DIR", help="folder (default: ./docs)"
    )
    parser.add_argument(
        "--parts",
        metavar="NAME,NAME",
        help="what is computed, with commas between, or 'none' to write the page again (default: "
        f"all): {', '.join(PARTS)}",
    )
    parser.add_argument(
        "--recordings", type=Path, metavar="DIR", help=f"of rosbag2 recordings; {VEHICLE} needs it"
    )
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help=f"YAML of the recordings; {VEHICLE} needs it"
    )
    parser.add_argument(
        "--runs",
        type=int,
        metavar="N",
        help="of each comparison (default: 100)",
    )
    parser.add_argument("--tuning-runs", type=int, default=5, metavar="N", help="(default: 5)")
    parser.add_argument("--seed", type=int, default=1, help="of all parts (default: 1)")
    parallel.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Compute the parts and write the page; the exit code is 2 where the input is refused."""
    try:
        parts = _parts(arguments)
        folder = arguments.out / "results"
        folder.mkdir(parents=True, exist_ok=True)
        check_writable(arguments.out / "results.md", "--out")
        if parts:
            with parallel.pool(parallel.workers_of(arguments)) as pool:
                stores = [_compute(part, arguments, folder, pool) for part in parts]
            for store in stores:  # kept until now: an interrupted command resumes
                store.clear()
        write(arguments.out / "results.md", page.markdown(documents(folder)).encode())
    except TaskError as error:
        print(f"insdvl results: {error}", file=sys.stderr)
        return 1
    except (ValueError, OSError) as error:
        print(f"insdvl results: {error}", file=sys.stderr)
        return 2
    print(arguments.out / "results.md")
    return 0


def _parts(arguments: argparse.Namespace) -> list[str]:
    """The parts that are asked for, in their order."""
    check_numbers(arguments)
    recorded = arguments.recordings is not None and arguments.config is not None
    if arguments.parts is None:
        return [part for part in PARTS if part != VEHICLE or recorded]
    asked = [] if arguments.parts == "none" else arguments.parts.split(",")
    check_names("--parts", asked, PARTS)
    if VEHICLE in asked and not recorded:
        raise ValueError(f"--parts {VEHICLE} needs --recordings and --config")
    return [part for part in PARTS if part in asked]


def _compute(part: str, arguments: argparse.Namespace, folder: Path, pool: Pool) -> Store:
    """Compute a part and write its numbers and pictures; what it keeps is still there."""
    seed, work = arguments.seed, folder / f".{part}.work"
    models = fingerprint(tuple(LEARNED))
    if part in PLANS:
        plan = replace(
            PLANS[part],
            runs=arguments.runs or PLANS[part].runs,
            tuning_runs=arguments.tuning_runs,
            seed=seed,
        )
        store = Store(work, {"plan": asdict(plan), "models": models})
        compared = compare(plan, pool, store)
        document = compared.document
        drawn = {row: compared.series[row] for row in _DRAWN if row in compared.series}
        plots.errors_over_time(folder / f"{part}.png", part, drawn)
    elif part == VEHICLE:
        settings = vehicle.Settings.load(arguments.config)
        recordings = vehicle.load_all(arguments.recordings, settings)
        learned = {row: load_model(LEARNED[row]) for row in ("hcf paper", "hcf default")}
        store = Store(work, {"seed": seed, **vehicle.fingerprint(recordings, settings, learned)})
        document = vehicle.study(
            recordings,
            settings,
            learned,
            runs=_RECORDING_RUNS,
            tuning_runs=_RECORDING_TUNING_RUNS,
            seed=seed,
            pool=pool,
            store=store,
        )
    else:
        store = Store(work, {"seed": seed, "models": models})
        if part == ACCURACY:
            document = accuracy.study(seed, pool, store)
        else:
            document = window.study(_WINDOW_RUNS, seed, pool, store)
    document["environment"] = parallel.environment()
    write(folder / f"{part}.json", json_text(document).encode())
    return store


def documents(folder: Path) -> dict[str, Any]:
    """The parts of a folder that have been computed, now or before.

    Raises:
        ValueError: A file cannot be read, is damaged or lacks a number; the message names it.
    """
    return read_parts(folder, PARTS, page.markdown)
