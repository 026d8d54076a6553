"""Digests of the numbers of a dozen missions, to show that a change of the code changes no bit.

    python benchmarks/fingerprint.py --save before.json     # on one commit
    python benchmarks/fingerprint.py --compare before.json  # on another, on the same machine

Compiled results differ between processors and between versions of numba, so a digest means nothing
on its own: only two commits on one machine can be compared. What is hashed are values by name
(nominal state, P, Q, counters, what was done with each measurement), never the bytes of a record,
whose layout may change.
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from insdvl.navigation.events import NS, Event, Imu, Initial, Origin, ProcessNoise
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build, flatten
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS, constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import trajectory_named
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 20_261
DURATION = 120.0  # s

NAV = ("C_n_b", "v_n", "llh", "b_f", "b_w", "w_nb_b")
NOISE = ("Q_f", "Q_w")


def fly(
    settings: dict[str, object],
    *,
    change: Callable[[Mission, np.ndarray], Iterable[Event]] | None = None,
    scenario: str = "varying",
    dvl: DvlModel | None = None,
) -> FoldResult:
    """Fold a mission, whose readings (N, 6) and events `change` may alter."""
    mission = simulate(
        trajectory_named("auv"),
        SCENARIOS[scenario],
        seed=SEED,
        duration=DURATION,
        dvl=dvl or DvlModel(noise_std=(0.02,) * 3),
        start_ns=100 * NS,
    )
    z = np.hstack([mission.f_b, mission.w_ib_b])
    events: list[Event] = [start_of(mission)]
    pings = zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
    events += [Dvl(stamp + 3_000_000, v_d.copy()) for stamp, v_d in pings]
    if change is not None:
        events = list(change(mission, z) or events) if change is not None else events
    kept = np.isfinite(z).all(axis=1)
    told = flatten(P_0, "initial.") | {"initial.mode": "set_odometry"}
    values = {"frame_convention": "ned", **told, **settings}
    return fold_arrays(
        build(FilterParameters, values),
        mission.stamps_ns[kept],
        np.ascontiguousarray(z[kept, :3]),
        np.ascontiguousarray(z[kept, 3:]),
        events,
    )


def start_of(mission: Mission) -> Initial:
    """The true state at the start, with the parameters' sigmas."""
    truth = mission.initial
    C = truth.C_n_b[0]
    return Initial(mission.start_ns, C, truth.p_o[0], C.T @ truth.v_n[0], "body")


def pings_of(mission: Mission) -> list[Event]:
    return [
        start_of(mission),
        *(
            Dvl(stamp, v_d.copy())
            for stamp, v_d in zip(mission.dvl_stamps_ns.tolist(), mission.v_d, strict=True)
        ),
    ]


def bad_channels(mission: Mission, z: np.ndarray) -> list[Event]:
    """Saturated, and frozen."""
    z[2000:2100, 1] = 20.0
    z[3000:3060, 5] = -2.0
    z[5000:5400, 0] = z[5000, 0]
    z[7000:7300, 3:] = z[7000, 3:]
    return pings_of(mission)


def gap(mission: Mission, z: np.ndarray) -> list[Event]:
    z[4000:4250] = np.nan
    return pings_of(mission)


def bad_pings(mission: Mission, z: np.ndarray) -> list[Event]:
    """Outliers, repeats, zeros, and a bias that goes on until the filter gives in."""
    events = pings_of(mission)
    pings = [event for event in events if isinstance(event, Dvl)]
    rng = np.random.default_rng(SEED)
    for k, ping in enumerate(pings):
        v_d = ping.v_d.copy()
        if k in (20, 27):
            v_d += 3.0 * rng.standard_normal(3)
        if k == 33:
            v_d = pings[32].v_d.copy()
        if k == 36:
            v_d[:] = 0.0
        if 50 <= k < 110:
            v_d[1] += 1.5
        pings[k] = replace(ping, v_d=v_d, R=np.diag([4e-4, 9e-4, 1e-4]) if k % 7 == 3 else None)
    return [events[0], *pings]


def told_noise(mission: Mission, z: np.ndarray) -> list[Event]:
    """A learned Q that comes, goes beyond its bounds, is unknown, and stays away."""
    events = pings_of(mission)
    for stamp, q in zip(*mission.process_noise(), strict=True):
        if stamp < mission.start_ns + 60 * NS or stamp > mission.start_ns + 80 * NS:
            k = (int(stamp) // NS) % 10
            Q_f = None if k == 3 else np.diag(q[:3]) * (1e9 if k == 5 else 1.0)
            events.append(ProcessNoise(int(stamp), Q_f, np.diag(q[3:]) * (1e-12 if k == 7 else 1)))
    return events


def levelled(mission: Mission, z: np.ndarray) -> list[Event]:
    """The first 2 s are at rest."""
    z[:200] = np.array([0.2, -0.1, -9.79, 0.0, 0.0, 7e-5])
    z[:200] += 1e-4 * np.random.default_rng(SEED).standard_normal((200, 6))
    return pings_of(mission)[1:]


def interleaved() -> FoldResult:
    """One event at a time, out of order, over a time jump, read as it goes."""
    mission = simulate(
        trajectory_named("auv"), constant(np.full(6, 1e-4)), seed=SEED, duration=30.0
    )
    told = flatten(P_0, "initial.") | {"initial.mode": "set_odometry"}
    values = {"frame_convention": "ned", **told, "max_delay": 0.5}
    fold = Fold(build(FilterParameters, values))
    rng = np.random.default_rng(SEED)
    for shift in (100 * NS, 5000 * NS):
        events: list[Event] = [
            Imu(stamp + shift, f, w)
            for stamp, f, w in zip(
                mission.stamps_ns.tolist(), mission.f_b, mission.w_ib_b, strict=True
            )
        ]
        events += [replace(event, stamp_ns=event.stamp_ns + shift) for event in pings_of(mission)]
        events.append(Origin(shift, 0.5, 0.5, -5.0))
        late = [event.stamp_ns + int(rng.uniform(0.0, 0.4) * NS) for event in events]
        for k in np.argsort(late, kind="stable"):
            fold.add(events[k])
            if k % 40 == 0:
                fold.take()
    states = fold.states
    return FoldResult(fold.filter, states, fold.track, fold.updates, fold.counts, {})


MISSIONS: dict[str, Callable[[], FoldResult]] = {
    "invariant": lambda: fly({"dvl.lever_arm": (0.5, 0.1, 0.3), "imu.lever_arm": (0.2, 0.0, -0.1)}),
    "ned": lambda: fly({"error_state": "ned", "dvl.mount": (0.02, 0.0, 0.7)}),
    "mounted imu": lambda: fly({"imu.mount": (0.1, -0.05, 0.3)}),
    "channels": lambda: fly(
        {"imu.acceleration_range": 19.5, "imu.rate_range": 1.9, "imu.frozen_samples": 50},
        change=bad_channels,
    ),
    "gap": lambda: fly({}, change=gap),
    "dvl error": lambda: fly(
        {"dvl.bias_model": "gauss_markov", "dvl.bias_std": (0.05, 0.05, 0.05)},
        dvl=DvlModel(noise_std=(0.02,) * 3, bias_std=0.05),
    ),
    "dvl error ned": lambda: fly({"dvl.bias_model": "gauss_markov", "error_state": "ned"}),
    "bad pings": lambda: fly({"gate.max_rejection_time": 15.0}, change=bad_pings),
    "too sure": lambda: fly(
        {
            "process_noise.accelerometer_variance": (1e-8,) * 3,
            "process_noise.gyroscope_variance": (1e-10,) * 3,
        }
    ),
    "adaptive floored": lambda: fly({"process_noise.source": "adaptive"}),
    "adaptive literal": lambda: fly(
        {
            "process_noise.source": "adaptive",
            "process_noise.adaptive_form": "literal",
            "process_noise.adaptive_window": 3,
            "gate.enabled": False,
            "error_state": "ned",
        }
    ),
    "adaptive variational": lambda: fly(
        {"process_noise.source": "adaptive", "process_noise.adaptive_form": "variational"}
    ),
    "received Q": lambda: fly({"process_noise.source": "external"}, change=told_noise),
    "levelling": lambda: fly({"initial.mode": "levelling"}, change=levelled),
    "paper": lambda: fly(
        {
            "error_state": "ned",
            "process_noise.convention": "density",
            "process_noise.accelerometer_bias_walk": 1e-3,
            "process_noise.gyroscope_bias_walk": 1e-3,
            "gate.enabled": False,
        },
        scenario="constant",
    ),
    "interleaved": interleaved,
}


def digest(result: FoldResult) -> str:
    """Of the values, by their names."""
    sha = hashlib.sha256()

    def put(name: str, value: object) -> None:
        sha.update(name.encode())
        sha.update(np.ascontiguousarray(value).tobytes())

    s = result.states
    for name in NAV:
        put(name, s["nav"][name])
    for name in NOISE:
        put(name, s["noise"][name])
    n = result.filter.n
    if n > 15:
        put("b_d", s["nav"]["optional"][:, :3])
    put("P", s["nav"]["P"][:, :n, :n])
    for name, count in sorted(result.counts.items()):
        put(name, count)
    for update in result.updates:
        report = update.report
        put("stamp", update.stamp_ns)
        put("innovation", report.innovation)
        put("S", report.S)
        put("nis", report.nis)
        put(report.reason, report.accepted)
    for k in range(0, len(s), 500):
        if s[k]["nav"]["initialised"]:
            output = odometry(result.filter, s, k)
            put("pose_covariance", output.pose_covariance)
            put("twist_covariance", output.twist_covariance)
            put("quaternion", output.quaternion_xyzw)
    return sha.hexdigest()[:16]


def main() -> int:
    """Exit code 1 where a digest differs from the saved one."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the digests to a file")
    parser.add_argument("--compare", type=Path, metavar="FILE", help="digests to compare with")
    arguments = parser.parse_args()
    kept = json.loads(arguments.compare.read_text()) if arguments.compare else {}
    found, different = {}, 0
    for name, mission in MISSIONS.items():
        result = mission()
        found[name] = digest(result)
        counted = {key: count for key, count in result.counts.items() if count}
        rejected = sum(not update.report.accepted for update in result.updates)
        verdict = ""
        if kept:
            same = kept.get(name) == found[name]
            different += not same
            verdict = "equal" if same else "DIFFERENT"
        print(f"{name:22s} {found[name]} {verdict:9s} {rejected:3d} rejected, {counted}")
    if arguments.save:
        arguments.save.write_text(json.dumps(found, indent=1) + "\n")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
