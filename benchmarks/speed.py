"""How fast the filter is, against the same work in C and against other filters.

    make bench                              # prints the table; ARGS="--json FILE" keeps it
    make bench ARGS="--save benchmarks/speed.json"   # the ratios become the baseline
    make bench-check                        # fails where a ratio is 20 % worse than the baseline

All figures are CPU time of this process: the least of a few repeats in each of ten rounds, of these
the median, and half the spread of their middle half. Absolute figures mean little on a shared
machine; ratios within a round do. The yardstick is yardstick/filter.c, which is first held against
the filter to 1e-12.
"""

import argparse
import ctypes
import gc
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from yardstick import peers
from yardstick.c_filter import Compiled, Noise, compiled, difference, state_of

from insdvl.arrays import Array, Records, copy_records
from insdvl.navigation.events import NS, Event, Imu, Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.prediction.kept import TRACK, Kept
from insdvl.parameters.declaration import build
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import trajectory_named
from insdvl.timeline.fold import Fold
from insdvl.timeline.recorded import fold_arrays

SEED = 7
DURATION = 120.0  # s
RATE = 100  # Hz
EVERY = 25  # of so many samples one whole state is kept, as insdvl evaluate does
SIGMA = 0.02  # of the DVL, m/s
EQUAL = 1e-12  # relative difference up to which the C is the filter's work
ROUNDS = 10
PEERS = ("plain numpy", "filterpy", "python-ins")
WORSE = 1.2  # bench-check fails beyond it
SETTINGS = {
    "frame_convention": "ned",
    "initial.mode": "set_odometry",
    "dvl.noise_std": [SIGMA] * 3,
}


@dataclass(frozen=True)
class Timed:
    """What is timed.

    Attributes:
        name: Of the row.
        per: What the time is of.
        call: Does a thing `count` times.
        count: How many.
        repeats: Of the call in a round.
    """

    name: str
    per: str
    call: Callable[[], object]
    count: int
    repeats: int


def measured(timed: list[Timed]) -> dict[str, Array]:
    """The least CPU time [us] of each thing in each of `ROUNDS` rounds, by name.

    All are timed in every round, one behind the other: what else the computer does changes within
    seconds, and a ratio within a round knows nothing of it.
    """
    for one in timed:
        one.call()
    times = {one.name: np.empty(ROUNDS) for one in timed}
    for k in range(ROUNDS):
        for one in timed:
            gc.collect()
            best = np.inf
            for _ in range(one.repeats):
                start = time.process_time()
                one.call()
                best = min(best, time.process_time() - start)
            times[one.name][k] = best / one.count * 1e6
    return times


def median_and_spread(values: Array) -> tuple[float, float]:
    """Median, and half the distance between the quartiles relative to it."""
    low, median, high = np.percentile(values, [25.0, 50.0, 75.0]).tolist()
    return median, (high - low) / 2.0 / median


class Subject:
    """A mission, the filter on it, and its states.

    Args:
        settings: Parameters besides `SETTINGS`.
    """

    def __init__(self, settings: dict[str, object]) -> None:
        self.mission: Mission = simulate(
            trajectory_named("auv"),
            SCENARIOS["constant-tableI"],
            seed=SEED,
            duration=DURATION,
            dvl=DvlModel(noise_std=(SIGMA,) * 3),
            start_ns=100 * NS,
        )
        m, truth = self.mission, self.mission.initial
        self.parameters = build(FilterParameters, SETTINGS | settings)
        C = truth.C_n_b[0]
        pings = zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)
        self.events: list[Event] = [
            Initial(m.start_ns, C, truth.p_o[0], C.T @ truth.v_n[0], "body"),
            *(Dvl(stamp, v_d.copy()) for stamp, v_d in pings),
        ]
        result = fold_arrays(self.parameters, *self.imu, self.events)
        self.filter: Filter = result.filter
        self.states: Records = result.states

    @property
    def imu(self) -> tuple[Any, Array, Array]:
        """Stamps and samples."""
        return self.mission.stamps_ns, self.mission.f_b, self.mission.w_ib_b

    @property
    def noise(self) -> Noise:
        """What the filter is told of the noise."""
        c = self.filter.constants[0]
        density = c["density"]
        q_f, q_w = c["Q_f_nominal"][0, 0], c["Q_w_nominal"][0, 0]
        return Noise(density * q_f, density * q_w, c["eps_f"], c["eps_w"])


class Yardstick:
    """The C filter on a subject's mission."""

    def __init__(self, c: Compiled, subject: Subject) -> None:
        self._c, self._subject, self._noise = c, subject, subject.noise

    def fly(self, first: int, count: int, every: int = RATE) -> Callable[[], Any]:
        """A call that flies `count` samples behind the state of sample `first`.

        A ping comes with the sample `every` behind that, and so on; it returns the state at the
        end.
        """
        m = self._subject.mission
        part = slice(first + 1, first + 1 + count)
        f_b, w_b = np.ascontiguousarray(m.f_b[part]), np.ascontiguousarray(m.w_ib_b[part])
        pings = np.ascontiguousarray(m.v_d[(first + 1) // RATE :])

        def call() -> Any:
            state, memory = state_of(self._subject.states[first : first + 1], m.w_ib_b[first])
            self._c.library.mission(
                ctypes.addressof(state),
                ctypes.addressof(self._noise),
                f_b.ctypes.data,
                w_b.ctypes.data,
                pings.ctypes.data,
                count,
                every,
                1.0 / RATE,
                SIGMA**2,
            )
            return state, memory

        return call

    def updates(self, at: int, count: int) -> Callable[[], None]:
        """A call that corrects the state of sample `at` with a ping, again and again."""
        m = self._subject.mission
        state, memory = state_of(self._subject.states[at : at + 1], m.w_ib_b[at])
        ping = np.ascontiguousarray(m.v_d[(at + 1) // RATE - 1])

        def call() -> None:
            assert memory is not None  # it holds the state
            self._c.library.updates(ctypes.addressof(state), ping.ctypes.data, SIGMA**2, count)

        return call


def disagreement(c: Compiled) -> float:
    """Largest relative difference of the C filter and ours, at the start and over the mission."""
    worst = 0.0
    for tilt in (0.01, 0.1):  # with the larger one updates are of second order
        # The gate and equal samples are no part of the yardstick.
        subject = Subject(
            {"gate.enabled": False, "imu.frozen_samples": 0, "initial.tilt_std": tilt}
        )
        yardstick = Yardstick(c, subject)
        at = RATE - 1  # the sample of the first ping
        for first, count, every in ((0, at, at), (at, 10 * RATE, RATE), (at, 100 * RATE, RATE)):
            state, _ = yardstick.fly(first, count, every)()
            worst = max(worst, difference(state, subject.states[first + count :][:1]))
    return worst


def of_the_filter(subject: Subject) -> list[Timed]:
    """What our own filter costs."""
    m, n = subject.mission, len(subject.mission.stamps_ns)
    filter_, states = subject.filter, subject.states
    readings = np.hstack([m.f_b, m.w_ib_b])
    kept = Kept(RATE, states.dtype, EVERY)
    state = states[:1].copy()

    def predict() -> None:
        copy_records(state, states[RATE:][:1])
        arrays = m.stamps_ns[RATE + 1 :], m.f_b[RATE + 1 :], m.w_ib_b[RATE + 1 :]
        filter_.predict_samples(state, *arrays, readings[RATE + 1 :], 0, RATE - 2, kept)

    def update(count: int) -> None:
        ping = Dvl(int(m.stamps_ns[51 * RATE - 1]), m.v_d[50])
        for _ in range(count):
            copy_records(state, states[51 * RATE - 2 :][:1])
            filter_.update(state, ping, m.w_ib_b[51 * RATE - 1], 1.0)

    online = Fold(subject.parameters)
    for event in subject.events:
        online.add(event)
    samples = [
        Imu(stamp, f, w) for stamp, f, w in zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True)
    ]
    at = 0

    def add(count: int) -> None:
        nonlocal at, online
        for _ in range(count):
            if at == len(samples):
                online, at = Fold(subject.parameters), 0
                for event in subject.events:
                    online.add(event)
            online.add(samples[at])
            online.take()
            at += 1

    late = Fold(subject.parameters, n + 1)
    late.add_recording(*subject.imu, subject.events)
    last = late.states[-1].copy()

    def refold() -> None:
        late._samples.outdate(n - RATE)
        assert late.states[-1]["nav"]["time_ns"] == last["nav"]["time_ns"]

    fold = partial(fold_arrays, subject.parameters, *subject.imu, subject.events, EVERY)
    return [
        Timed("predict kernel", "sample", predict, RATE - 2, 20),
        Timed("fold of a mission", "sample", fold, n, 3),
        Timed("one event at a time", "sample", partial(add, 1000), 1000, 2),
        Timed("DVL update, one call", "update", partial(update, 100), 100, 5),
        Timed("re-fold of 1 s with its DVL", "second", refold, 1, 10),
    ]


def of_c(yardstick: Yardstick) -> list[Timed]:
    """What the C costs."""
    fly, update = yardstick.fly(RATE - 1, 100 * RATE), yardstick.updates(51 * RATE - 1, 10_000)
    return [
        Timed("C", "sample", fly, 100 * RATE, 5),
        Timed("C, DVL update", "update", update, 10_000, 3),
    ]


def of_peers(subject: Subject) -> tuple[list[Timed], list[str]]:
    """What other filters cost, and which are left out."""
    m, rows, left_out = subject.mission, [], []
    c, count = subject.filter.constants[0], 300
    density = c["density"] * np.r_[c["Q_f_nominal"].diagonal(), c["Q_w_nominal"].diagonal()]
    for name, step in (
        ("plain numpy", peers.plain_numpy(density)),
        ("filterpy, the same mechanisation", peers.of_filterpy(density)),
    ):
        if isinstance(step, str):
            left_out.append(step)
            continue
        nav = subject.states[RATE]["nav"]
        s = {key: nav[key].copy() for key in ("C_n_b", "v_n", "llh")}
        s["P"] = nav["P"][:15, :15].copy()

        def fly(step: peers.Step = step, s: dict[str, Array] = s) -> None:
            for k in range(count):
                step(s, m.f_b[RATE + k], m.w_ib_b[RATE + k], 1.0 / RATE)

        rows.append(Timed(name, "sample", fly, count, 2))
    short = simulate(
        trajectory_named("auv"),
        SCENARIOS["constant-tableI"],
        seed=SEED,
        duration=5.0,
        dvl=DvlModel(noise_std=(SIGMA,) * 3),
        start_ns=0,
    )
    samples = len(short.stamps_ns)
    call = peers.of_python_ins(short)
    rows.append(Timed("python-ins, covariance at 10 Hz", "sample", call, samples, 1))
    return rows, left_out


def ratios(timed: list[Timed], times: dict[str, Array]) -> dict[str, Array]:
    """Of each figure, in each round, to that of C; of a peer's to our prediction's."""
    found = {}
    for one in timed:
        if one.name.startswith(PEERS):
            found[f"{one.name} / predict kernel"] = times[one.name] / times["predict kernel"]
        elif "C" in times and not one.name.startswith("C"):
            yardstick = "C, DVL update" if one.per == "update" else "C"
            found[f"{one.name} / {yardstick}"] = times[one.name] / times[yardstick]
    return found


def worse(now: dict[str, float], before: dict[str, float]) -> list[str]:
    """Which ratios are worse than a baseline; a peer's is worse if it is smaller."""
    found = []
    for name in now.keys() & before.keys():
        factor = now[name] / before[name]
        if name.startswith(PEERS):
            factor = 1.0 / factor
        if factor > WORSE:
            found.append(f"{name}: {now[name]:.3g}, the baseline has {before[name]:.3g}")
    return sorted(found)


def main() -> int:
    """Measure, print, and compare."""
    parser = argparse.ArgumentParser(description="How fast the filter is, against the same in C.")
    parser.add_argument(
        "--validate", action="store_true", help="only hold the C filter against ours"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures")
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the ratios as a baseline")
    parser.add_argument("--check", type=Path, metavar="FILE", help="compare with a baseline")
    arguments = parser.parse_args()
    timed: list[Timed] = []
    with tempfile.TemporaryDirectory() as folder:
        c = compiled(Path(folder))
        error = 0.0 if isinstance(c, str) else disagreement(c)
        if not error <= EQUAL:
            print(f"the C filter differs from ours by {error:.1e}", file=sys.stderr)
            return 1
        if isinstance(c, str):
            notes = [c]
        else:
            notes = [f"C: {c.how}; it differs from the filter by at most {error:.1e}"]
        if arguments.validate:
            print(notes[0])
            return 0
        subject = Subject({})
        if isinstance(c, Compiled):
            timed += of_c(Yardstick(c, subject))
        timed += of_the_filter(subject)
        others, left_out = of_peers(subject)
        timed += others
    notes += left_out
    times = measured(timed)
    of_rounds = ratios(timed, times)
    found = {name: median_and_spread(values)[0] for name, values in of_rounds.items()}
    per_sample = subject.states.itemsize / EVERY + TRACK.itemsize + 6
    print(f"{'':36}{'us':>10}{'spread':>9}   per")
    rows = []
    for one in timed:
        microseconds, spread = median_and_spread(times[one.name])
        rows.append(
            {"name": one.name, "per": one.per, "microseconds": microseconds, "spread": spread}
        )
        print(f"{one.name:36}{microseconds:10.3f}{spread:8.1%}    {one.per}")
    print()
    for name, values in of_rounds.items():
        ratio, spread = median_and_spread(values)
        print(f"{name:60}{ratio:10.1f}{spread:8.1%}")
    print(f"\nmemory kept per sample: {per_sample:.0f} bytes")
    print("\n".join(notes))
    if arguments.json:
        document = {
            "rows": rows,
            "ratios": found,
            "bytes_per_sample": per_sample,
            "notes": notes,
        }
        arguments.json.write_text(json.dumps(document, indent=1) + "\n")
    if arguments.save:
        arguments.save.write_text(json.dumps(found, indent=1) + "\n")
    if arguments.check:
        fallen = worse(found, json.loads(arguments.check.read_text()))
        for line in fallen:
            print(f"worse by more than 20 %: {line}", file=sys.stderr)
        return 1 if fallen else 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
