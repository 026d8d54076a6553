"""The table: NEES of every block of the state, for grades of IMU, latitudes and rates of the DVL.

Every cell has runs of its own. So what their draw adds to a mean is not that of its neighbour.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtri

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.simulation.grades import GRADES
from insdvl.studies.consistency.errors import ALL, BLOCKS, band, degrees_of_freedom, nees
from insdvl.studies.consistency.flights import Case, flown
from insdvl.studies.consistency.mission import PATROL
from insdvl.studies.consistency.study import Extent, Study, seeds
from insdvl.studies.evaluation import statistics
from insdvl.studies.report.markdown import number, table

LATITUDES = (0.0, 45.0, 75.0)  # deg
DVL_RATES = (1.0, 8.0)  # Hz
HEADING_STD = 1.0  # deg
#: Probabilities of the regions whose coverage is counted.
LEVELS = (0.95, 0.997)
#: What the NEES per degree of freedom of a block should be within, and what it must be within.
TARGET, LIMIT = (0.8, 1.25), (0.7, 1.4)
#: How many means of the table may be outside of the target.
MAX_OUTSIDE = 2

_DOF = {name: degrees_of_freedom(name) for name in ALL}
_RUNS, _BOOTSTRAP = 3000, 3001  # keys of the random streams


@dataclass(frozen=True)
class Cell:
    """What is flown in one row of the table.

    Attributes:
        grade: Of the IMU, a key of `GRADES`.
        latitude_deg: Of the start.
        dvl_rate: [Hz].
    """

    grade: str
    latitude_deg: float
    dvl_rate: float

    @property
    def name(self) -> str:
        """For people and files."""
        return f"{self.grade}, {self.latitude_deg:g} deg, {self.dvl_rate:g} Hz"

    @property
    def key(self) -> tuple[int, int, int]:
        """Of its random streams."""
        return list(GRADES).index(self.grade), round(self.latitude_deg), round(self.dvl_rate)

    def case(self) -> Case:
        """The mission."""
        return Case(
            grade=GRADES[self.grade],
            heading_std_deg=HEADING_STD,
            duration=PATROL.duration,
            dvl_rate=self.dvl_rate,
            trajectory=PATROL,
            latitude_deg=self.latitude_deg,
        )


def cells(*, quick: bool = False) -> list[Cell]:
    """All cells; the quick form has one latitude."""
    latitudes = (45.0,) if quick else LATITUDES
    return [Cell(g, lat, rate) for g in GRADES for lat in latitudes for rate in DVL_RATES]


def block_run(case: Case, seed: int) -> dict[str, Array]:
    """A run of a case.

    Returns:
        ``nees`` (B,) mean over the run per degree of freedom, in the order of `ALL`; ``inside``
        (B, len(LEVELS)) the fraction of the run in which the truth is inside the region.
    """
    found = nees(flown(case, seed))
    region = {name: [chdtri(dof, 1.0 - p) / dof for p in LEVELS] for name, dof in _DOF.items()}
    return {
        "nees": np.array([np.mean(found[name]) for name in ALL]),
        "inside": np.array([[np.mean(found[name] <= r) for r in region[name]] for name in ALL]),
    }


def study_blocks(extent: Extent, pool: Pool, store: Store | None = None) -> dict[str, Any]:
    """The numbers of the table."""
    rng = np.random.default_rng(np.random.SeedSequence(extent.seed, spawn_key=(_BOOTSTRAP,)))
    draws = statistics.resamples(np.arange(extent.runs), rng)
    found = []
    for cell in cells(quick=extent.quick):
        tasks = seeds(extent.seed, extent.runs, _RUNS, *cell.key)
        results = pool.compute(block_run, tasks, shared=cell.case(), store=store, label=cell.name)
        of_runs = np.array([result["nees"] for result in results])
        inside = np.mean([result["inside"] for result in results], axis=0)
        blocks = {}
        for i, name in enumerate(ALL):
            worst = int(np.argmax(of_runs[:, i]))
            blocks[name] = {
                "nees": list(statistics.mean(of_runs[:, i], draws)),
                "inside": inside[i].tolist(),
                "worst_run": worst,
                "worst_nees": float(of_runs[worst, i]),
                "nees_of_runs": np.round(of_runs[:, i], 4).tolist(),
            }
        found.append(
            {
                "cell": cell.name,
                "grade": cell.grade,
                "latitude_deg": cell.latitude_deg,
                "dvl_rate": cell.dvl_rate,
                "seeds": list(tasks.values()),
                "blocks": blocks,
            }
        )
    return {
        "runs": extent.runs,
        "seed": extent.seed,
        "duration": PATROL.duration,
        "heading_std_deg": HEADING_STD,
        "dvl_std": cells()[0].case().dvl_std,
        "levels": list(LEVELS),
        "cells": found,
    }


def outside(
    document: Mapping[str, Any], within: tuple[float, float], blocks: Sequence[str] = tuple(BLOCKS)
) -> list[str]:
    """The means of a document that are not within some limits."""
    low, high = within
    return [
        f"{cell['cell']}: {name} {cell['blocks'][name]['nees'][0]:.2f}"
        for cell in document["cells"]
        for name in blocks
        if not low <= cell["blocks"][name]["nees"][0] <= high
    ]


def _section(document: Mapping[str, Any]) -> str:
    runs, (level, far) = document["runs"], document["levels"]
    beyond, far_beyond = outside(document, TARGET), outside(document, LIMIT)
    met = len(beyond) <= MAX_OUTSIDE and not far_beyond
    bands = {block: band(block, runs) for block in ALL}
    unexplained = [row for block in ALL for row in outside(document, bands[block], (block,))]
    text = _TEXT.format(
        duration=document["duration"] / 60.0,
        runs=runs,
        seed=document["seed"],
        dvl=document["dvl_std"],
        heading=document["heading_std_deg"],
        three="{:.2f} to {:.2f}".format(*bands["velocity"]),
        two="{:.2f} to {:.2f}".format(*bands["tilt"]),
        one="{:.2f} to {:.2f}".format(*bands["heading"]),
        target="{} to {}".format(*TARGET),
        limit="{} to {}".format(*LIMIT),
        allowed=MAX_OUTSIDE,
        total=len(document["cells"]) * len(BLOCKS),
        met="yes" if met else "**no**",
        outside="; ".join(beyond) or "none",
        far_outside="; ".join(far_beyond) or "none",
        unexplained="; ".join(unexplained) or "none",
    )

    def rows(shown: str) -> str:
        values = {
            "nees": lambda b: number(b["nees"][0], 2),
            "inside": lambda b: " / ".join(f"{100 * p:.1f}" for p in b["inside"]),
            "worst": lambda b: f"{number(b['worst_nees'], 1)} ({b['worst_run']})",
        }[shown]
        body = [
            [cell["cell"], *(values(cell["blocks"][name]) for name in ALL)]
            for cell in document["cells"]
        ]
        return table(["IMU, latitude, DVL", *ALL], body)

    return "\n".join(
        [
            text,
            "NEES per degree of freedom, mean over time and runs:\n",
            rows("nees"),
            f"Time inside the regions of {100 * level:g} and {100 * far:g} % [%]:\n",
            rows("inside"),
            "Worst run: its mean NEES per degree of freedom, and its number:\n",
            rows("worst"),
        ]
    )


_TEXT = """## Every block of the state

Missions of {duration:g} minutes with turns, a dive and waves; {runs} runs of each row, seed {seed}.
The initial error is drawn from $P_0$, the heading with a sigma of {heading:g} deg; the biases from
the data sheet of the IMU ([grades.py](../../src/insdvl/simulation/grades.py)); the DVL has
{dvl:g} m/s in each axis. The filter knows all sigmas. Errors are exact and in the coordinates of
the error state ([error-state.md](../explanation/error-state.md)), once per second. Each row has
random numbers of its own. *All* are the 15 states with their correlations.

An error that nothing observes is one draw per run. So the mean of a consistent filter over {runs}
runs is, in 99.7 % of all cases,

- within {three} for three degrees of freedom,
- within {two} for two (tilt),
- within {one} for one (heading).

Means outside of these: {unexplained}.

Target: all means of the five blocks within {target}, at most {allowed} of {total} outside, none
outside {limit}. Met: {met}.

- Outside {target}: {outside}.
- Outside {limit}: {far_outside}.
"""

BLOCK_STUDY = Study("blocks", Path(__file__), study_blocks, _section)
