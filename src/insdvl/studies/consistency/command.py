"""The command `insdvl consistency`: the numbers of docs/results/consistency.md, and the page."""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from insdvl.files import check_writable, json_text, read_parts, write
from insdvl.jobs.options import workers_from
from insdvl.jobs.pool import Pool, TaskError, open_pool
from insdvl.jobs.store import Store, environment
from insdvl.studies.arguments.consistency import NAME, QUICK_RUNS, RUNS
from insdvl.studies.consistency.page import STUDIES, consistency_page
from insdvl.studies.consistency.study import Extent, Study


def run(arguments: argparse.Namespace) -> int:
    """Compute the studies and write the page; the exit code is 2 for invalid input."""
    try:
        extent, asked = _asked(arguments)
        folder = arguments.out
        folder.mkdir(parents=True, exist_ok=True)
        for ending in ("md", "json"):
            check_writable(folder / f"{NAME}.{ending}", "--out")
        studies = documents(folder)
        if asked:
            with open_pool(workers_from(arguments)) as pool:
                stores = [_compute(study, extent, folder, pool, studies) for study in asked]
            for store in stores:  # kept until now, so that an interrupted command resumes
                store.clear()
        write(folder / f"{NAME}.md", consistency_page(studies).encode())
    except TaskError as error:
        print(f"insdvl {NAME}: {error}", file=sys.stderr)
        return 1
    except (ValueError, OSError) as error:
        print(f"insdvl {NAME}: {error}", file=sys.stderr)
        return 2
    print(folder / f"{NAME}.md")
    return 0


def _asked(arguments: argparse.Namespace) -> tuple[Extent, list[Study]]:
    runs = arguments.runs
    if runs is None:
        runs = QUICK_RUNS if arguments.quick else RUNS
    names = [study.name for study in STUDIES]
    if arguments.studies is not None:
        names = [] if arguments.studies == "none" else arguments.studies.split(",")
    extent = Extent(runs, arguments.seed, arguments.quick)
    return extent, [study for study in STUDIES if study.name in names]


def _compute(
    study: Study, extent: Extent, folder: Path, pool: Pool, studies: dict[str, Any]
) -> Store:
    """Compute a study and write the numbers of all; its store is not cleared."""
    store = Store(folder / f".{NAME}-{study.name}.work", asdict(extent), study.source)
    document = study.compute(extent, pool, store)
    document["environment"] = environment(study.source)
    studies[study.name] = document
    write(folder / f"{NAME}.json", json_text({"studies": studies}).encode())
    return store


def documents(folder: Path) -> dict[str, Any]:
    """Numbers of the studies that are in a folder, by name.

    Raises:
        ValueError: The file cannot be read, is damaged or incomplete; the message names it.
    """
    found = read_parts(folder, [NAME], lambda parts: consistency_page(parts[NAME]["studies"]))
    return dict(found[NAME]["studies"]) if found else {}
