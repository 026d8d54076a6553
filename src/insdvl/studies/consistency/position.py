"""The rows on position: it is as good as it says, whatever the heading was at the start."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.simulation.grades import GRADES
from insdvl.studies.consistency.flights import ELLIPSE, Case, fly
from insdvl.studies.consistency.study import Extent, Study, seeds
from insdvl.studies.evaluation import statistics
from insdvl.studies.report.markdown import interval, number, table

FIRST = 300  # s; NEES and coverage are of the time from here on

_RUNS, _BOOTSTRAP = 3002, 3003  # keys of the random streams


@dataclass(frozen=True)
class Row:
    """A case, and whether it is compared with the first row.

    Attributes:
        name: For people and files.
        case: What is flown.
        paired: Whether it differs from the first row in its initial state only.
    """

    name: str
    case: Case
    paired: bool = True


_FOG = GRADES["fog"]
ROWS = (
    Row("FOG, 1 deg", Case(_FOG, 1.0)),
    Row("FOG, 5 deg", Case(_FOG, 5.0)),
    Row("FOG, 30 deg", Case(_FOG, 30.0)),
    Row("FOG, 60 deg", Case(_FOG, 60.0)),
    Row("FOG, any heading, told as 100 deg", Case(_FOG, 100.0, uniform_heading=True)),
    Row("FOG, 60 deg, start at 5 km", Case(_FOG, 60.0, start=(4000.0, 3000.0, 0.0)), paired=False),
    Row("MEMS, 5 deg", Case(GRADES["mems"], 5.0), paired=False),
)


def position_run(row: Row, seed: int) -> dict[str, Array]:
    """A run of a row.

    Returns:
        ``nees`` and ``inside`` (), means from `FIRST` on; at the end of the run the error of the
        position, ``end`` () [m], that of the heading, ``heading_deg`` (), and its ``sigma_deg`` ().
    """
    flight = fly(row.case, seed)
    return {
        "nees": np.mean(flight.nees[FIRST - 1 :]),
        "inside": np.mean(flight.inside[FIRST - 1 :]),
        "end": flight.error[-1],
        "heading_deg": flight.heading_deg[-1],
        "sigma_deg": flight.heading_sigma_deg[-1],
    }


def study_position(extent: Extent, pool: Pool, store: Store | None = None) -> dict[str, Any]:
    """The numbers of the rows; all rows have the same runs."""
    rng = np.random.default_rng(np.random.SeedSequence(extent.seed, spawn_key=(_BOOTSTRAP,)))
    draws = statistics.resamples(np.arange(extent.runs), rng)
    tasks = seeds(extent.seed, extent.runs, _RUNS)
    found: list[dict[str, Any]] = []
    first: Array | None = None
    for row in ROWS[::3] if extent.quick else ROWS:
        label = f"position: {row.name}"
        results = pool.compute(position_run, tasks, shared=row, store=store, label=label)
        of_runs = {name: np.array([float(r[name]) for r in results]) for name in results[0]}
        square = of_runs["end"] ** 2
        first = square if first is None else first
        ratio = statistics.ratio_of_means(square, first, draws) if row.paired else None
        found.append(
            {
                "row": row.name,
                "nees": list(statistics.mean(of_runs["nees"], draws)),
                "inside": list(statistics.mean(of_runs["inside"], draws)),
                "end_rms": np.sqrt(statistics.mean(square, draws)).tolist(),
                "ratio": None if ratio is None else np.sqrt(ratio).tolist(),
                "heading_rms_deg": _rms(of_runs["heading_deg"]),
                "heading_sigma_deg": _rms(of_runs["sigma_deg"]),
                "worst_run": int(np.argmax(of_runs["nees"])),
                "worst_nees": float(np.max(of_runs["nees"])),
                "of_runs": {name: np.round(a, 4).tolist() for name, a in of_runs.items()},
            }
        )
    return {
        "runs": extent.runs,
        "seed": extent.seed,
        "seeds": list(tasks.values()),
        "first": FIRST,
        "duration": ROWS[0].case.duration,
        "ellipse": ELLIPSE,
        "rows": found,
    }


def _rms(a: Array) -> float:
    return float(np.sqrt(np.mean(a**2)))


def _section(document: Mapping[str, Any]) -> str:
    body = [
        [
            row["row"],
            interval(row["nees"], 2),
            interval([100.0 * p for p in row["inside"]], 1),
            interval(row["end_rms"], 2),
            interval(row["ratio"], 2),
            f"{number(row['heading_rms_deg'], 3)} / {number(row['heading_sigma_deg'], 3)}",
            f"{number(row['worst_nees'], 1)} ({row['worst_run']})",
        ]
        for row in document["rows"]
    ]
    head = [
        "IMU, sigma of the heading",
        "NEES",
        f"inside {100 * document['ellipse']:g} % [%]",
        "end, rms [m]",
        "end / first row",
        "heading at the end, rms / sigma [deg]",
        "worst NEES (run)",
    ]
    return _TEXT.format(**document) + "\n" + table(head, body)


_TEXT = """## Horizontal position, whatever the heading was

Missions of {duration:g} s with the DVL at 1 Hz; {runs} runs of each row, seed {seed}, the same
random numbers in all rows. NEES per degree of freedom and the published ellipse are of the time
from {first} s on. Brackets hold 95 % intervals of a bootstrap over runs; the ratio of the errors at
the end is of paired runs, where a row differs from the first in its heading only. The last but one
column is the heading at the end, rms over the runs of its error and of what the filter says of it.
"""

POSITION_STUDY = Study("position", Path(__file__), study_position, _section)
