"""A DVL that is silent for two minutes: what the first measurements behind it leave.

An IMU of the MEMS grade drifts by tens of metres per second meanwhile, so the first measurement
corrects velocity, tilt and heading far beyond where h is linear.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.simulation.grades import GRADES
from insdvl.studies.consistency.errors import band, nees
from insdvl.studies.consistency.flights import Case, flown
from insdvl.studies.consistency.study import Extent, Study, seeds
from insdvl.studies.evaluation import statistics
from insdvl.studies.report.markdown import interval, number, table

#: Silence of the DVL, and how long the errors are followed behind it [s].
BEGIN, END, AFTER = 240.0, 360.0, 60.0
#: One sigma of the initial heading in each row [deg].
HEADINGS = (5.0, 30.0)
SHOWN = ("attitude", "heading", "velocity")

_RUNS, _BOOTSTRAP = 3005, 3006  # keys of the random streams


def outage_run(case: Case, seed: int) -> dict[str, Array]:
    """NEES (K,) of each block, per degree of freedom, in a run of a case.

    They are right behind the first measurement after the outage and at each second from there on.
    Duration and silence of the case are those of the study.
    """
    case = replace(case, duration=END + AFTER, silence=(BEGIN, END))
    return {name: of_time[round(END) - 1 :] for name, of_time in nees(flown(case, seed)).items()}


def study_outage(extent: Extent, pool: Pool, store: Store | None = None) -> dict[str, Any]:
    """The numbers; all rows have the same runs."""
    rng = np.random.default_rng(np.random.SeedSequence(extent.seed, spawn_key=(_BOOTSTRAP,)))
    draws = statistics.resamples(np.arange(extent.runs), rng)
    tasks, rows = seeds(extent.seed, extent.runs, _RUNS), []
    for heading in HEADINGS[-1:] if extent.quick else HEADINGS:
        name = f"MEMS, {heading:g} deg"
        case = Case(GRADES["mems"], heading)
        results = pool.compute(outage_run, tasks, shared=case, store=store, label=f"outage: {name}")
        blocks = {}
        for block in SHOWN:
            found = np.array([result[block] for result in results])
            of_runs, of_seconds = found.mean(axis=1), found.mean(axis=0)
            blocks[block] = {
                "nees": list(statistics.mean(of_runs, draws)),
                "largest": float(of_seconds.max()),
                "largest_at": int(of_seconds.argmax()),
                "worst_run": int(of_runs.argmax()),
                "worst_nees": float(of_runs.max()),
                "nees_of_runs": np.round(of_runs, 4).tolist(),
                "nees_of_seconds": np.round(of_seconds, 4).tolist(),
            }
        rows.append({"row": name, "blocks": blocks})
    return {
        "runs": extent.runs,
        "seed": extent.seed,
        "seeds": list(tasks.values()),
        "begin": BEGIN,
        "end": END,
        "after": AFTER,
        "rows": rows,
    }


def _section(document: Mapping[str, Any]) -> str:
    head = ["IMU, sigma of the heading"]
    head += [title for b in SHOWN for title in (b, "largest (at)", "worst run")]
    body = []
    for row in document["rows"]:
        cells = [row["row"]]
        for block in (row["blocks"][name] for name in SHOWN):
            cells += [
                interval(block["nees"], 2),
                f"{number(block['largest'], 2)} ({block['largest_at']} s)",
                f"{number(block['worst_nees'], 1)} ({block['worst_run']})",
            ]
        body.append(cells)
    text = _TEXT.format(
        **document,
        silence=document["end"] - document["begin"],
        three="{:.2f} to {:.2f}".format(*band("velocity", document["runs"])),
        one="{:.2f} to {:.2f}".format(*band("heading", document["runs"])),
    )
    return text + "\n" + table(head, body)


_TEXT = """## Behind an outage of the DVL

The DVL, 1 Hz, is silent from {begin:g} to {end:g} s; {runs} runs of each row, seed {seed}, the same
random numbers in all rows. In {silence:g} s the velocity of a MEMS drifts by tens of metres per
second, and the first measurement corrects it at once
([error-state.md](../explanation/error-state.md)). NEES per degree of freedom of the {after:g} s
behind the outage: the mean over time and runs with the 95 % interval of a bootstrap over runs; the
largest mean over runs at an instant, and how long behind the first measurement that is; the run
with the largest mean over time.

The mean of a consistent filter over {runs} runs at a given instant is, in 99.7 % of all cases,
within {three} for attitude and velocity and within {one} for the heading. The largest of 61
instants is outside more often.
"""

OUTAGE_STUDY = Study("outage", Path(__file__), study_outage, _section)
