"""What a microsecond does: the stamps of one stream shifted, and the change of the velocity."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.navigation.events import Event
from insdvl.navigation.measurements.depth import STANDARD_GRAVITY, Depth, DepthParameters
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.simulation.grades import GRADES
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.depth import DepthModel
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.studies.consistency.flights import (
    RATE,
    Case,
    initial_state,
    parameters,
    trajectory_from,
)
from insdvl.studies.consistency.study import Extent, Study, seeds
from insdvl.studies.report.markdown import table
from insdvl.timeline.recorded import fold_arrays

STREAMS = ("imu", "dvl", "depth")
SHIFTS_NS = (-1000, 1000)
#: What the velocity may change by [m/s].
LIMIT = 1e-5
#: Changes are largest at the start, where the corrections are.
DURATION = 120.0  # s
MAX_RUNS = 2

_RUNS = 3004  # key of the random streams
#: Pings between two samples and at one, and arms that turn with the vehicle.
_DVL = DvlModel(rate=8.0, noise_std=(0.02,) * 3, lever_arm=(0.8, 0.1, 0.4))
_DEPTH = DepthModel(rate=5.0, lever_arm=(-0.5, 0.0, 0.2))


def mission_of(case: Case, seed: int) -> Mission:
    """The mission, with all streams."""
    return simulate(
        trajectory_from(case),
        constant(case.grade.variances(RATE)),
        seed=seed,
        duration=case.duration,
        imu=case.grade.imu(RATE),
        dvl=_DVL,
        depth=_DEPTH,
        earth_rate=case.earth_rate,
    )


def velocities(
    case: Case,
    seed: int,
    mission: Mission,
    shifts_ns: Mapping[str, int] | None = None,
    *,
    together: bool = False,
) -> Array:
    """Velocity (N, 3) [m/s] behind every sample, with the stamps of some streams shifted.

    Args:
        case: What is flown.
        seed: Of the mission.
        mission: The mission.
        shifts_ns: Added to the stamps of a stream.
        together: Whether the depths at the stamp of a ping are used. A microsecond decides which of
            the two is used first, and two corrections commute only as far as they are linear.
    """
    shift = dict.fromkeys(STREAMS, 0) | dict(shifts_ns or {})
    settings = replace(
        parameters(case),
        dvl=replace(parameters(case).dvl, lever_arm=_DVL.lever_arm),
        depth=DepthParameters(topic="depth", lever_arm=_DEPTH.lever_arm),
    )
    rng = np.random.default_rng([seed, 1])
    depth = (mission.pressure - _DEPTH.atmospheric_pressure) / (
        _DEPTH.water_density * STANDARD_GRAVITY
    )
    dvl_ns, depth_ns = mission.dvl_stamps_ns.tolist(), mission.depth_stamps_ns.tolist()
    pings_ns = set(dvl_ns)
    events: list[Event] = [initial_state(case, mission.initial, rng)]
    events += [Dvl(t + shift["dvl"], v_d) for t, v_d in zip(dvl_ns, mission.v_d, strict=True)]
    events += [
        Depth(t + shift["depth"], d, from_pressure=True)
        for t, d in zip(depth_ns, depth.tolist(), strict=True)
        if together or t not in pings_ns
    ]
    stamps_ns = mission.stamps_ns + shift["imu"]
    result = fold_arrays(settings, stamps_ns, mission.f_b, mission.w_ib_b, events)
    return result.states["nav"]["v_n"].copy()


def change(mission: Mission, before: Array, after: Array) -> float:
    """Largest change of the velocity (N, 3) [m/s], at the samples without a measurement.

    A measurement at the stamp of a sample belongs to it, and a microsecond later to the next one.
    """
    measured: Stamps = np.concatenate([mission.dvl_stamps_ns, mission.depth_stamps_ns])
    quiet = ~np.isin(mission.stamps_ns, measured)
    return float(np.abs(after - before)[quiet].max())


def sensitivity_run(case: Case, seed: int) -> dict[str, Array]:
    """``change`` (len(STREAMS), len(SHIFTS_NS)) [m/s] in a run.

    ``order`` () is what it changes to use depths before the pings of the same stamp.
    """
    mission = mission_of(case, seed)
    before = velocities(case, seed, mission)
    pings_first = velocities(case, seed, mission, together=True)
    depths_first = velocities(case, seed, mission, {"depth": SHIFTS_NS[0]}, together=True)
    found = [
        [change(mission, before, velocities(case, seed, mission, {name: ns})) for ns in SHIFTS_NS]
        for name in STREAMS
    ]
    order = change(mission, pings_first, depths_first)
    return {"change": np.array(found), "order": np.array(order)}


def study_sensitivity(extent: Extent, pool: Pool, store: Store | None = None) -> dict[str, Any]:
    """The numbers: the worst of a few runs of each grade."""
    runs, rows = min(extent.runs, MAX_RUNS), []
    for i, (name, grade) in enumerate(GRADES.items()):
        case = Case(grade, 1.0, duration=DURATION, dvl_rate=_DVL.rate)
        tasks = seeds(extent.seed, runs, _RUNS, i)
        label = f"sensitivity: {name}"
        results = pool.compute(sensitivity_run, tasks, shared=case, store=store, label=label)
        worst = np.max([result["change"] for result in results], axis=0)
        order = max(float(result["order"]) for result in results)
        rows.append(
            {
                "grade": name,
                "change": worst.tolist(),
                "order": order,
                "seeds": list(tasks.values()),
            }
        )
    return {
        "runs": runs,
        "seed": extent.seed,
        "streams": list(STREAMS),
        "shifts_ns": list(SHIFTS_NS),
        "limit": LIMIT,
        "duration": DURATION,
        "rows": rows,
    }


def _section(document: Mapping[str, Any]) -> str:
    columns = [
        f"{stream}, {ns / 1000:+g} us"
        for stream in document["streams"]
        for ns in document["shifts_ns"]
    ]
    body = [
        [
            row["grade"],
            *(f"{value:.1e}" for values in row["change"] for value in values),
            f"{row['order']:.1e}",
        ]
        for row in document["rows"]
    ]
    largest = max(value for row in document["rows"] for values in row["change"] for value in values)
    text = _TEXT.format(
        **document, largest=largest, met="yes" if largest < document["limit"] else "**no**"
    )
    return text + "\n" + table(["IMU", *columns, "order"], body)


_TEXT = """## A microsecond

All stamps of one stream are shifted by a microsecond: IMU at 100 Hz, DVL at 8 Hz on an arm of
0.8 m, depth at 5 Hz; gate off, {runs} runs of {duration:g} s, seed {seed}. Largest change of a
velocity component at a sample [m/s]; those with a measurement at their own stamp are left out,
since a microsecond later it belongs to the next one. It has to be less than {limit:g}. Largest:
{largest:.1e}. Met: {met}.

No depth has the stamp of a ping in these columns. The last one has such depths, and shows what it
changes to use them before the pings: two corrections commute only as far as they are linear, and a
heading that nothing observes keeps the difference.
"""

SENSITIVITY_STUDY = Study("sensitivity", Path(__file__), study_sensitivity, _section)
