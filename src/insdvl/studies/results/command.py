"""The command `insdvl results`: all numbers, plots and pages of docs/results/.

The pages consist of parts; the numbers of each part are a JSON file beside them. A part that is not
computed keeps its file, so the pages can be written without the recordings or after a single part.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from insdvl.files import check_writable, json_text, read_parts, write
from insdvl.jobs.options import workers_from
from insdvl.jobs.pool import Pool, TaskError, open_pool
from insdvl.jobs.store import Store, environment
from insdvl.simulation.noise import SCENARIOS
from insdvl.studies.evaluation import comparison
from insdvl.studies.evaluation.approaches import (
    BANDS,
    BANDS_WITH_FACTOR,
    BEST_CONSTANT,
    BEST_XI,
    CLOSED_FORM,
    FIRST_CONSTANT,
    LEARNED,
    LEAST_BAND,
    MATCHED,
    MEDIAN_OF_SPECTRUM,
    ORACLE,
    ROWS,
    SAGE_HUSA,
    SINGLE_BAND,
    VARIATIONAL,
    WITH_R,
    Setting,
    fingerprint,
    model_of,
)
from insdvl.studies.evaluation.comparison import Plan, compare
from insdvl.studies.report.plots import draw_errors_over_time
from insdvl.studies.results import (
    accuracy,
    page,
    recordings,
    vehicle,
    window,
    withheld,
)
from insdvl.studies.results.breadth import study as breadth
from insdvl.studies.results.dvl_noise import study as dvl_noise
from insdvl.studies.results.others import study as others
from insdvl.studies.results.pictures.draw import draw
from insdvl.studies.results.pictures.forests import forests
from insdvl.studies.results.pictures.over_time import DRAWN, over_time
from insdvl.tuner.models import load_model

#: Rows of the tables that show what an error state or the gate changes.
_FEW = (FIRST_CONSTANT, "hcf default", BEST_CONSTANT, CLOSED_FORM, ORACLE)
#: Rows of the tables on noise that is not white.
_OF_SPECTRUM = (
    *(BEST_XI, VARIATIONAL, *SAGE_HUSA, BANDS, BANDS_WITH_FACTOR, BEST_CONSTANT),
    *(CLOSED_FORM, SINGLE_BAND, LEAST_BAND, MEDIAN_OF_SPECTRUM, ORACLE, MATCHED),
)
#: Rows of the tables on white noise, of which `MATCHED` knows no more than the oracle. What is off
#: for a whole mission is the subject of the others.
_OF_WHITE = tuple(row for row in ROWS if row not in (MATCHED, BANDS_WITH_FACTOR))

#: The comparisons, by part.
PLANS: Mapping[str, Plan] = {
    **{
        f"{scenario}-{preset}": Plan(scenario, Setting(preset), rows=_OF_WHITE)
        for preset in ("calibrated", "paper")
        for scenario in SCENARIOS
    },
    "constant-paper-no-walk": Plan("constant", Setting("paper-no-walk"), rows=_FEW),
    "varying-ned": Plan("varying", Setting("calibrated", error_state="ned"), rows=_FEW),
    "varying-gate": Plan("varying", Setting("calibrated", gate=True), rows=_FEW),
    **{
        f"{scenario}-spectrum": Plan(
            scenario,
            Setting("calibrated"),
            # Elsewhere R is that of the data sheet.
            rows=(*_OF_SPECTRUM, *(WITH_R if scenario == "realistic" else ())),
        )
        for scenario in page.SPECTRUM
    },
}
#: Rows with a model of the studies on recordings.
_ON_RECORDINGS = ("hcf paper", "hcf default", BANDS)
ACCURACY, WINDOW, VEHICLE, WITHHELD = "q-accuracy", "window", "vehicle", "withheld"
BREADTH, OTHER_VEHICLES, DVL_NOISE = "breadth", "other-vehicles", "dvl-noise"
PARTS = (ACCURACY, *PLANS, BREADTH, OTHER_VEHICLES, DVL_NOISE, WINDOW, VEHICLE, WITHHELD)
_OF_RECORDINGS = (VEHICLE, WITHHELD)
_WINDOW_RUNS = 10
_RECORDING_RUNS, _RECORDING_TUNING_RUNS = 10, 3  # for each recording and injection


def run(arguments: argparse.Namespace) -> int:
    """Compute the parts and write the pages; the exit code is 2 for invalid input."""
    try:
        parts = _parts(arguments)
        folder = arguments.out / "results"
        folder.mkdir(parents=True, exist_ok=True)
        check_writable(folder / f"{page.PAGES[0]}.md", "--out")
        if parts:
            with open_pool(workers_from(arguments)) as pool:
                stores = [_compute(part, arguments, folder, pool) for part in parts]
            for store in stores:  # kept until now, so that an interrupted command resumes
                store.clear()
        found = documents(folder)
        for name, text in page.pages(found).items():
            write(folder / f"{name}.md", text.encode())
        for name, forest in forests(found).items():
            draw(folder / f"{name}.png", forest)
    except TaskError as error:
        print(f"insdvl results: {error}", file=sys.stderr)
        return 1
    except (ValueError, OSError) as error:
        print(f"insdvl results: {error}", file=sys.stderr)
        return 2
    print(folder)
    return 0


def _parts(arguments: argparse.Namespace) -> list[str]:
    """The requested parts, in their order."""
    recorded = arguments.recordings is not None and arguments.config is not None
    if arguments.parts is None:
        return [part for part in PARTS if part not in _OF_RECORDINGS or recorded]
    asked = [] if arguments.parts == "none" else arguments.parts.split(",")
    return [part for part in PARTS if part in asked]


def _compute(part: str, arguments: argparse.Namespace, folder: Path, pool: Pool) -> Store:
    """Compute a part and write its numbers and plots; its store is not cleared."""
    seed, work = arguments.seed, folder / f".{part}.work"
    models = fingerprint((*LEARNED, BANDS))
    if part in PLANS:
        plan = replace(
            PLANS[part],
            runs=arguments.runs or PLANS[part].runs,
            tuning_runs=arguments.tuning_runs,
            seed=seed,
        )
        source = Path(comparison.__file__)
        store = Store(work, {"plan": plan.document(), "models": models}, source)
        compared = compare(plan, pool, store)
        document = compared.document
        for sentence in over_time({part: document}).values():
            drawn = {row: compared.series[row] for row in DRAWN}
            draw_errors_over_time(folder / f"{part}.png", sentence, drawn)
    elif part == BREADTH:
        runs = {"runs": arguments.runs, "tuning_runs": arguments.tuning_runs, "seed": seed}
        plans = breadth.with_runs(breadth.plans(), **runs)
        source = Path(breadth.__file__)
        store = Store(
            work, {"plans": [plan.document() for plan in plans], "models": models}, source
        )
        document = breadth.study_breadth(plans, pool, store)
    elif part == OTHER_VEHICLES:
        runs_, source = arguments.runs or others.RUNS, Path(others.__file__)
        store = Store(work, {"runs": runs_, "seed": seed, "models": models}, source)
        document = others.study_others(runs_, seed, pool, store)
    elif part == DVL_NOISE:
        planned = dvl_noise.plans(arguments.runs or dvl_noise.RUNS, seed)
        source = Path(dvl_noise.__file__)
        store = Store(work, {"plans": [plan.document() for plan in planned.values()]}, source)
        document = dvl_noise.study_dvl_noise(planned, pool, store)
    elif part in _OF_RECORDINGS:
        settings = recordings.Settings.load(arguments.config)
        recorded = recordings.load_all(arguments.recordings, settings)
        learned = {row: load_model(str(model_of(row))) for row in _ON_RECORDINGS}
        source = Path(vehicle.__file__ if part == VEHICLE else withheld.__file__)
        fingerprint_ = recordings.fingerprint(recorded, settings, learned)
        store = Store(work, {"seed": seed, **fingerprint_}, source)
        if part == WITHHELD:
            document = withheld.study_withheld(
                recorded, settings, learned, seed=seed, pool=pool, store=store
            )
        else:
            document = vehicle.study_recordings(
                recorded,
                settings,
                learned,
                runs=_RECORDING_RUNS,
                tuning_runs=_RECORDING_TUNING_RUNS,
                seed=seed,
                pool=pool,
                store=store,
            )
    else:
        source = Path(accuracy.__file__ if part == ACCURACY else window.__file__)
        store = Store(work, {"seed": seed, "models": models}, source)
        if part == ACCURACY:
            document = accuracy.study_accuracy(seed, pool, store)
        else:
            document = window.study_windows(_WINDOW_RUNS, seed, pool, store)
    document["environment"] = environment(source)
    write(folder / f"{part}.json", json_text(document).encode())
    return store


def documents(folder: Path) -> dict[str, Any]:
    """The documents of the parts that are in a folder.

    Raises:
        ValueError: A file cannot be read, is damaged or incomplete; the message names it.
    """
    return read_parts(folder, PARTS, page.pages)
