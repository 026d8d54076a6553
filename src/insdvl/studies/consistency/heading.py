"""A heading sensor with a slow error: how good the heading becomes, and is its sigma right?"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.simulation.grades import GRADES
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.studies.consistency.errors import (
    ALL,
    BLOCKS,
    band,
    heading_deg,
    heading_sigma_deg,
    nees,
)
from insdvl.studies.consistency.flights import Case, flown
from insdvl.studies.consistency.mission import PATROL
from insdvl.studies.consistency.study import Extent, Study, seeds
from insdvl.studies.evaluation import statistics
from insdvl.studies.report.markdown import interval, number, table

#: White noise of 2 deg, and a Gauss-Markov error of 1 deg over 300 s, once a second.
SENSOR = HeadingModel(rate=1.0)
FIRST = 600  # s; heading and velocity are judged from here on
HEADING_STD = 10.0  # deg, at the start
#: What the heading's rms may be in units of its sigma with the true parameters, and what the error
#: of the velocity may be in units of that without a sensor.
WORST_HEADING, WORST_VELOCITY = 1.1, 0.5
#: What the NEES per degree of freedom of each block should be within.
TARGET = (0.8, 1.25)

_RUNS, _BOOTSTRAP = 3011, 3012  # keys of the random streams
_MEMS = GRADES["mems"]


def rows() -> dict[str, Case]:
    """The same mission with the sensor and without."""
    without = Case(_MEMS, HEADING_STD, duration=PATROL.duration, trajectory=PATROL)
    return {"with the sensor": replace(without, heading=SENSOR), "without": without}


def reduced_sigma_deg(case: Case) -> Array:
    """One sigma (K,) of the heading at every full second without any other state [deg].

    A Kalman filter of heading, gyroscope bias about the vertical and error of the sensor, with
    their true parameters:

        h' = -b - w,  b' = 0,  e' = -e / tau + u,  z = h + e + noise

    The whole filter is a little better, since motion and DVL tell something of the bias.
    """
    grade, sensor = case.grade, case.heading
    decay = math.exp(-1.0 / sensor.error_time_constant)
    Phi = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, decay]])
    Q = np.diag([grade.gyroscope_noise**2, 0.0, sensor.error_std**2 * (1.0 - decay**2)])
    H = np.array([[1.0, 0.0, 1.0]])
    start = math.radians(case.heading_std_deg), grade.gyroscope_bias, sensor.error_std
    P, found = np.diag(np.square(start)), []
    for _ in range(round(case.duration)):
        P = Phi @ P @ Phi.T + Q
        S = H @ P @ H.T + sensor.noise_std**2
        P = P - P @ H.T @ H @ P / S
        found.append(math.degrees(math.sqrt(P[0, 0])))
    return np.array(found)


def heading_run(case: Case, seed: int) -> dict[str, Array]:
    """A run of a case.

    Returns:
        ``nees`` (B,) mean over the run per degree of freedom, in the order of `ALL`; ``heading``,
        ``sigma`` () [deg^2] and ``velocity`` () [(m/s)^2], mean squares from `FIRST` on.
    """
    run = flown(case, seed)
    found, behind = nees(run), slice(FIRST - 1, None)
    velocity = run.truth.v_n - run.states["nav"]["v_n"]
    return {
        "nees": np.array([np.mean(found[name]) for name in ALL]),
        "heading": np.mean(heading_deg(run)[behind] ** 2),
        "sigma": np.mean(heading_sigma_deg(run)[behind] ** 2),
        "velocity": np.mean(np.sum(velocity[behind] ** 2, axis=1)),
    }


def study_heading(extent: Extent, pool: Pool, store: Store | None = None) -> dict[str, Any]:
    """The numbers; both rows have the same runs."""
    rng = np.random.default_rng(np.random.SeedSequence(extent.seed, spawn_key=(_BOOTSTRAP,)))
    draws = statistics.resamples(np.arange(extent.runs), rng)
    tasks, found = seeds(extent.seed, extent.runs, _RUNS), []
    for name, case in rows().items():
        results = pool.compute(
            heading_run, tasks, shared=case, store=store, label=f"heading: {name}"
        )
        of_runs = {key: np.array([result[key] for result in results]) for key in results[0]}
        squares = {key: of_runs[key] for key in ("heading", "sigma", "velocity")}
        found.append(
            {
                "row": name,
                "nees": {
                    block: list(statistics.mean(of_runs["nees"][:, k], draws))
                    for k, block in enumerate(ALL)
                },
                "rms": {
                    key: np.sqrt(statistics.mean(square, draws)).tolist()
                    for key, square in squares.items()
                },
                "of_runs": {key: np.round(square, 6).tolist() for key, square in squares.items()},
            }
        )
    reduced = reduced_sigma_deg(rows()["with the sensor"])[FIRST - 1 :]
    return {
        "runs": extent.runs,
        "seed": extent.seed,
        "seeds": list(tasks.values()),
        "duration": PATROL.duration,
        "first": FIRST,
        "heading_std_deg": HEADING_STD,
        "noise_deg": math.degrees(SENSOR.noise_std),
        "error_deg": math.degrees(SENSOR.error_std),
        "time_constant": SENSOR.error_time_constant,
        "reduced_sigma_deg": float(np.sqrt(np.mean(reduced**2))),
        "rows": found,
    }


def outside(document: Mapping[str, Any], within: tuple[float, float] = TARGET) -> list[str]:
    """The means of the blocks, with the sensor, that are not within some limits."""
    low, high = within
    blocks = document["rows"][0]["nees"]
    return [f"{b} {blocks[b][0]:.2f}" for b in BLOCKS if not low <= blocks[b][0] <= high]


def ratios(document: Mapping[str, Any]) -> tuple[float, float]:
    """Heading's rms over its sigma, and velocity error over that without the sensor."""
    sensor, without = (row["rms"] for row in document["rows"])
    return (
        sensor["heading"][0] / sensor["sigma"][0],
        sensor["velocity"][0] / without["velocity"][0],
    )


def _section(document: Mapping[str, Any]) -> str:
    of_heading, of_velocity = ratios(document)
    beyond = outside(document)
    met = of_heading <= WORST_HEADING and of_velocity <= WORST_VELOCITY and not beyond
    body = [
        [
            row["row"],
            interval(row["rms"]["heading"], 3),
            number(row["rms"]["sigma"][0], 3),
            interval(row["rms"]["velocity"], 3),
            *(interval(row["nees"][block], 2) for block in BLOCKS),
        ]
        for row in document["rows"]
    ]
    head = ["", "heading, rms [deg]", "its sigma [deg]", "velocity, NED, rms [m/s]", *BLOCKS]
    text = _TEXT.format(
        **document,
        minutes=document["duration"] / 60.0,
        of_heading=of_heading,
        of_velocity=of_velocity,
        worst_heading=WORST_HEADING,
        worst_velocity=WORST_VELOCITY,
        three="{:.2f} to {:.2f}".format(*band("velocity", document["runs"])),
        target="{} to {}".format(*TARGET),
        outside="; ".join(beyond) or "none",
        met="yes" if met else "**no**",
    )
    return text + "\n" + table(head, body)


_TEXT = """## A heading sensor

The missions of the first table with a MEMS, {minutes:g} minutes, DVL 1 Hz, the heading drawn with
{heading_std_deg:g} deg; {runs} runs of each row, seed {seed}, the same random numbers in both. The
sensor tells a heading once a second, with a white noise of {noise_deg:g} deg and a Gauss-Markov
error of {error_deg:g} deg over {time_constant:g} s. The filter knows all sigmas
([heading.md](../explanation/heading.md)). Heading and velocity are rms from {first} s on; NEES per
degree of freedom is the mean of the whole run. Brackets hold 95 % intervals of a bootstrap over
runs.

- The heading's rms is {of_heading:.2f} times its sigma with the true parameters; target: at most
  {worst_heading:g}. A Kalman filter of heading, gyroscope bias and sensor error alone has a sigma
  of {reduced_sigma_deg:.3f} deg over the same time.
- The velocity error in NED is {of_velocity:.3f} times that without the sensor; target: at most
  {worst_velocity:g}.
- Target of the NEES of each block with the sensor: {target}. Outside: {outside}. An error that
  nothing observes is one draw per run: the mean of a consistent filter is then within {three} in
  99.7 % of all cases.
- Met: {met}.
"""

HEADING_STUDY = Study("heading", Path(__file__), study_heading, _section)
