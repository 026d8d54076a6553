"""A vehicle that finds its heading at rest and then leaves, or that is rocked meanwhile."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.navigation.start.gyrocompass import FOUND
from insdvl.simulation.grades import GRADES
from insdvl.simulation.motion import Channel, Ramp, Trajectory, Wave
from insdvl.studies.consistency.errors import band, heading_deg, heading_sigma_deg, nees
from insdvl.studies.consistency.flights import TRANSIT, Case, folded, mission_of, parameters
from insdvl.studies.consistency.study import Extent, Study, seeds
from insdvl.studies.evaluation import statistics
from insdvl.studies.report.markdown import interval, number, table

#: At rest for 150 s, then out with turns, 600 s in all.
DEPARTURE = Trajectory(
    duration=600.0,
    speed=Channel(ramps=(Ramp(150.0, 170.0, 1.8),)),
    heading=Channel(
        math.radians(20.0),
        ramps=(
            Ramp(200.0, 215.0, math.radians(50.0)),
            Ramp(280.0, 295.0, math.radians(-80.0)),
            Ramp(360.0, 375.0, math.radians(100.0)),
            Ramp(440.0, 470.0, math.radians(120.0)),
            Ramp(530.0, 545.0, math.radians(-50.0)),
        ),
    ),
    pitch=Channel(math.radians(2.0)),
    roll=Channel(math.radians(-1.0)),
    bank=0.4,
    pivot=0.4,
    h_0=TRANSIT.h_0,
)

SHOWN = ("attitude", "heading", "velocity", "biases")

_INITIAL = 1  # stream of what is told, beside those of the mission
_RUNS, _BOOTSTRAP = 3007, 3008  # keys of the random streams
_ROCKING = 1.0, 6.0  # amplitude in roll [deg] and period [s]


def rocked(amplitude_deg: float, period: float) -> Trajectory:
    """The same departure, of a vehicle that is rocked, less in pitch than in roll."""
    amplitude = math.radians(amplitude_deg)
    return replace(
        DEPARTURE,
        roll=Channel(math.radians(-1.0), waves=(Wave(amplitude, period),)),
        pitch=Channel(math.radians(2.0), waves=(Wave(0.3 * amplitude, 1.3 * period, 0.5),)),
    )


@dataclass(frozen=True)
class Departure:
    """One run, at the start (K = 0) and each second behind it.

    Attributes:
        start: Stamp of the first state [s].
        compass: What became of gyrocompassing, see `insdvl.navigation.start.gyrocompass`.
        nees: NEES (K,) of each block, per degree of freedom.
        heading_deg: Error (K,) of the heading.
        heading_sigma_deg: What the filter says of it (K,).
    """

    start: float
    compass: int
    nees: Mapping[str, Array]
    heading_deg: Array
    heading_sigma_deg: Array


def depart(case: Case, seed: int) -> Departure:
    """One run; ``case.trajectory`` is at rest or rocked at first, and begins with no speed.

    The filter is told a heading that is wrong by what the case says, and finds its own.

    Args:
        case: What is flown.
        seed: Of all that is random.
    """
    mission = mission_of(case, seed)
    rng = np.random.default_rng([seed, _INITIAL])
    error = math.radians(case.heading_std_deg) * rng.standard_normal()
    if case.uniform_heading:
        error = rng.uniform(-math.pi, math.pi)
    C = mission.initial.C_n_b[0]
    heading = math.atan2(C[1, 0], C[0, 0]) - error
    told = parameters(case)
    position = case.position_std * rng.standard_normal(3)
    initial = replace(
        told.initial,
        mode="gyrocompassing",
        rpy=(0.0, 0.0, math.remainder(heading, 2.0 * math.pi)),
        position=tuple(position.tolist()),
        velocity=tuple((told.initial.velocity_std * rng.standard_normal(3)).tolist()),
    )
    run = folded(mission, replace(told, initial=initial), (), from_start=True)
    return Departure(
        start=float(run.truth.t[0]),
        compass=int(run.states["start"]["compass"][0]),
        nees=nees(run),
        heading_deg=heading_deg(run),
        heading_sigma_deg=heading_sigma_deg(run),
    )


def rows(*, quick: bool = False) -> dict[str, Case]:
    """What is flown, by name: a heading that is wrong by 45 deg, and any; quick has the first."""
    vehicles = {
        "FOG": Case(GRADES["fog"], 45.0, trajectory=DEPARTURE),
        "FOG, rocked": Case(GRADES["fog"], 45.0, trajectory=rocked(*_ROCKING)),
        "MEMS": Case(GRADES["mems"], 45.0, trajectory=DEPARTURE),
    }
    found = {}
    for name, case in vehicles.items():
        found[f"{name}, 45 deg"] = case
        if not quick:
            anything = replace(case, heading_std_deg=100.0, uniform_heading=True)
            found[f"{name}, any heading, told as 100 deg"] = anything
    return found


def departure_run(case: Case, seed: int) -> dict[str, Array]:
    """A run of a case.

    Returns:
        ``nees`` (len(SHOWN),) means over time; ``found`` () whether gyrocompassing found the
        heading; ``start`` () [s]; ``heading_deg`` () and ``heading_sigma_deg`` () at the start.
    """
    d = depart(case, seed)
    return {
        "nees": np.array([np.mean(d.nees[name]) for name in SHOWN]),
        "found": np.array(d.compass == FOUND),
        "start": np.array(d.start),
        "heading_deg": d.heading_deg[0],
        "heading_sigma_deg": d.heading_sigma_deg[0],
    }


def study_gyrocompassing(extent: Extent, pool: Pool, store: Store | None = None) -> dict[str, Any]:
    """The numbers; all rows have the same runs."""
    rng = np.random.default_rng(np.random.SeedSequence(extent.seed, spawn_key=(_BOOTSTRAP,)))
    draws = statistics.resamples(np.arange(extent.runs), rng)
    tasks, found = seeds(extent.seed, extent.runs, _RUNS), []
    for name, case in rows(quick=extent.quick).items():
        label = f"gyrocompassing: {name}"
        results = pool.compute(departure_run, tasks, shared=case, store=store, label=label)
        of_runs = {key: np.array([result[key] for result in results]) for key in results[0]}
        squares = statistics.mean(of_runs["heading_deg"] ** 2, draws)
        blocks = {}
        for block, nees_of_runs in zip(SHOWN, of_runs["nees"].T, strict=True):
            blocks[block] = {
                "nees": list(statistics.mean(nees_of_runs, draws)),
                "worst_run": int(nees_of_runs.argmax()),
                "worst_nees": float(nees_of_runs.max()),
                "nees_of_runs": np.round(nees_of_runs, 4).tolist(),
            }
        found.append(
            {
                "row": name,
                "found": int(of_runs["found"].sum()),
                "start": [float(of_runs["start"].min()), float(of_runs["start"].max())],
                "heading_rms_deg": np.sqrt(squares).tolist(),
                "heading_sigma_deg": float(np.sqrt(np.mean(of_runs["heading_sigma_deg"] ** 2))),
                "heading_of_runs_deg": np.round(of_runs["heading_deg"], 5).tolist(),
                "blocks": blocks,
            }
        )
    amplitude, period = _ROCKING
    return {
        "runs": extent.runs,
        "seed": extent.seed,
        "seeds": list(tasks.values()),
        "duration": DEPARTURE.duration,
        "rest": DEPARTURE.speed.ramps[0].start,
        "amplitude_deg": amplitude,
        "period": period,
        "rows": found,
    }


def _section(document: Mapping[str, Any]) -> str:
    head = ["IMU, what is told", "found", "start [s]", "heading at the start, rms [deg]"]
    head += ["its sigma [deg]", *SHOWN, "worst attitude", "worst biases"]
    body = []
    for row in document["rows"]:
        blocks, (first, last) = row["blocks"], row["start"]
        worst = (blocks[name] for name in ("attitude", "biases"))
        body.append(
            [
                row["row"],
                f"{row['found']} of {document['runs']}",
                f"{first:.1f}" if first == last else f"{first:.1f} to {last:.1f}",
                interval(row["heading_rms_deg"], 3),
                number(row["heading_sigma_deg"], 3),
                *(interval(blocks[name]["nees"], 2) for name in SHOWN),
                *(f"{number(b['worst_nees'], 1)} ({b['worst_run']})" for b in worst),
            ]
        )
    bands = {
        "three": band("attitude", document["runs"]),
        "six": band("biases", document["runs"]),
        "one": band("heading", document["runs"]),
    }
    words = {name: "{:.2f} to {:.2f}".format(*limits) for name, limits in bands.items()}
    return _TEXT.format(**document, **words) + "\n" + table(head, body)


_TEXT = """## Gyrocompassing

A vehicle at rest for {rest:g} s, that then leaves with turns, {duration:g} s in all; {runs} runs of
each row, seed {seed}, the same random numbers in all rows. `initial.mode` is `gyrocompassing`, and
the heading that is told is wrong by 45 deg, one sigma, or is any heading at all
([gyrocompassing.md](../explanation/gyrocompassing.md)). *Found* counts the runs in which the filter
finds its heading; in the others it starts with what it is told, as it must where a vehicle is
rocked (by {amplitude_deg:g} deg in roll, with a period of {period:g} s) or where the gyroscope is a
MEMS. NEES per degree of freedom from the start of the filter on: mean over time and runs, with the
95 % interval of a bootstrap over runs, and the run with the largest mean over time.

The mean of a consistent filter over {runs} runs is, for errors that stay throughout a run and in
99.7 % of all cases, within {three} for attitude and velocity, {one} for the heading and {six} for
the biases.
"""

GYROCOMPASSING_STUDY = Study("gyrocompassing", Path(__file__), study_gyrocompassing, _section)
