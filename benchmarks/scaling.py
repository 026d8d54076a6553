"""How the cost grows: with states, rows, window, trees, rate, length, runs and workers.

    make bench-scaling                      # docs/explanation/performance.png and .json; 3 minutes

Each cost is CPU time of this process (wall time for workers), the least of some repeats, since a
shared machine only adds to it. The exponent is the slope in logarithms over the larger half of the
values: 1 is linear growth, and where a fixed part is large it is less.
"""

import argparse
import gc
import json
import os
import sys
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from speed import EVERY, RATE, SEED, SETTINGS, SIGMA, Subject

from insdvl.arrays import Array
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.navigation.events import NS, Event, Initial
from insdvl.navigation.kalman import innovate
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.prediction.kept import Kept
from insdvl.parameters.declaration import build
from insdvl.studies.evaluation import approaches
from insdvl.studies.evaluation.monte_carlo import Study, evaluate_run, numbered
from insdvl.studies.training.ensemble import joined
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.features.handcrafted import features
from insdvl.tuner.forest import LEAF, Forest
from insdvl.tuner.models import load_model

#: Filters of 15, 18, 21 and 22 error states.
STATES: Sequence[dict[str, Any]] = (
    {},
    {"dvl.bias_model": "gauss_markov"},
    {"dvl.bias_model": "gauss_markov", "dvl.mount_std": [0.01] * 3},
    {
        "dvl.bias_model": "gauss_markov",
        "dvl.mount_std": [0.01] * 3,
        "depth.topic": "depth",
        "depth.surface_std": 0.1,
    },
)
ROWS = (1, 2, 3, 6, 12, 24)
WINDOWS = (50, 100, 200, 400, 800, 1600)
TREES = (4, 8, 15, 30, 60, 120)
RATES = (50, 100, 200, 500, 1000)
LENGTHS = (30, 120, 480, 1920)  # s
RUNS = (1, 2, 4, 8)
RUN = 60.0  # s
TASKS = 8  # runs that the workers share


@dataclass
class Growth:
    """How one cost grows.

    Attributes:
        along: What grows, with its unit.
        cost: What it costs, with its unit.
        values: The sizes.
        costs: The cost of each.
    """

    along: str
    cost: str
    values: list[float]
    costs: list[float] = field(default_factory=list)

    @property
    def exponent(self) -> float:
        """Slope of the logarithms over the larger half of the values."""
        half = len(self.values) // 2
        x, y = np.log(self.values[half - 1 :]), np.log(self.costs[half - 1 :])
        return float(np.polyfit(x, y, 1)[0])


def cpu(call: Callable[[], object], repeats: int, count: int = 1) -> float:
    """The least CPU time [s] of a call that does a thing `count` times, for one of them."""
    call()
    gc.collect()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times) / count


def of_states() -> Growth:
    """The prediction by the number of error states."""
    found = Growth("error states", "prediction, us per sample", [])
    for settings in STATES:
        subject = Subject(settings)
        m, states = subject.mission, subject.states
        readings, state = np.hstack([m.f_b, m.w_ib_b]), states[:1].copy()
        kept = Kept(RATE, states.dtype, EVERY)

        def predict(
            subject: Subject = subject,
            state: Any = state,
            readings: Array = readings,
            kept: Kept = kept,
        ) -> None:
            part = slice(RATE + 1, None)
            m = subject.mission
            arrays = m.stamps_ns[part], m.f_b[part], m.w_ib_b[part], readings[part]
            state[0] = subject.states[RATE]
            subject.filter.predict_samples(state, *arrays, 0, RATE - 2, kept)

        found.values.append(int(subject.filter.constants[0]["n"]))
        found.costs.append(1e6 * cpu(predict, 100, RATE - 2))
    return found


def of_rows() -> Growth:
    """Innovation covariance, gain and NIS by the number of rows, for 15 states."""
    rng = np.random.default_rng(SEED)
    A = rng.standard_normal((15, 15))
    P = A @ A.T
    found = Growth("rows of a measurement", "gain, us", list(ROWS))
    for m in ROWS:
        H, R, nu = rng.standard_normal((m, 15)), np.eye(m), rng.standard_normal(m)

        def gain(H: Array = H, R: Array = R, nu: Array = nu) -> None:
            for _ in range(1000):
                innovate(P, nu, H, R)

        found.costs.append(1e6 * cpu(gain, 10, 1000))
    return found


def of_window() -> Growth:
    """The published features by the number of samples."""
    rng = np.random.default_rng(SEED)
    found = Growth("samples of a window", "24 features, us per channel", list(WINDOWS))
    for n in WINDOWS:
        windows = rng.standard_normal((100, n))
        found.costs.append(1e6 * cpu(partial(features, windows), 10, 100))
    return found


def of_trees() -> Growth:
    """The prediction of the shipped model with fewer or more trees."""
    found = Growth("trees", "prediction of the model, us per channel", list(TREES))
    forest = load_model("default").regressor
    assert isinstance(forest, Forest)
    trees = [_tree(forest, number) for number in range(forest.n_trees)]
    rng = np.random.default_rng(SEED)
    X = rng.standard_normal((1000, forest.n_features))
    for n in TREES:
        chosen = Forest(joined([trees[k % len(trees)] for k in range(n)]))
        found.costs.append(1e6 * cpu(partial(chosen.predict, X), 10, 1000))
    return found


def _tree(forest: Forest, number: int) -> dict[str, Any]:
    """The arrays of one tree."""
    arrays = forest.arrays
    feature = arrays["feature"]
    ends = [*arrays["roots"].tolist(), feature.size]
    part = slice(ends[number], ends[number + 1])
    splits = np.r_[0, np.cumsum(feature != LEAF)]
    of_splits = slice(splits[part.start], splits[part.stop])
    of_leaves = slice(part.start - of_splits.start, part.stop - of_splits.stop)
    return {
        "feature": feature[part],
        "threshold": arrays["threshold"][of_splits],
        "value": arrays["value"][of_leaves],
        "roots": np.zeros(1, np.int32),
        "n_features": arrays["n_features"],
    }


def at_rest(seconds: int, rate: int) -> Callable[[], Any]:
    """A call that folds a recording of a vehicle at rest, with a ping each second."""
    rng = np.random.default_rng(SEED)
    n = seconds * rate
    stamps_ns = np.arange(1, n + 1) * (NS // rate)
    f_b = rng.normal([0.0, 0.0, -9.79], 0.01, (n, 3))
    w_ib_b = rng.normal(0.0, 0.001, (n, 3))
    v_d = rng.normal(0.0, SIGMA, (seconds, 3))
    events: list[Event] = [Initial(0, np.eye(3), np.zeros(3), np.zeros(3), "body")]
    events += [Dvl(second * NS, v) for second, v in enumerate(v_d, 1)]
    parameters = build(FilterParameters, SETTINGS | {"imu.rate": float(rate)})
    return partial(fold_arrays, parameters, stamps_ns, f_b, w_ib_b, events, EVERY)


def of_rate() -> Growth:
    """The fold of a minute by the rate of the IMU."""
    costs = [1e3 * cpu(at_rest(60, rate), 3, 60) for rate in RATES]
    return Growth("rate of the IMU, Hz", "fold, ms per second of a mission", list(RATES), costs)


def of_length() -> list[Growth]:
    """Time and memory of the fold by the length of a recording."""
    found = Growth("length of a recording, s", "fold, s", list(LENGTHS))
    kept = Growth("length of a recording, s", "memory of the fold, MB", list(LENGTHS))
    for seconds in LENGTHS:
        fold = at_rest(seconds, RATE)
        found.costs.append(cpu(fold, 2))
        tracemalloc.start()
        fold()
        kept.costs.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    return [found, kept]


def of_runs() -> list[Growth]:
    """An evaluation by its runs, and by the workers that share them."""
    setting = approaches.Setting("calibrated")
    rows = tuple(
        approaches.approach(name, setting)
        for name in (approaches.FIRST_CONSTANT, approaches.CLOSED_FORM, approaches.ORACLE)
    )
    shared = Study("varying", SEED, RUN), rows

    def evaluate(runs: int) -> None:
        for number in range(runs):
            evaluate_run(shared, number)

    costs = [cpu(partial(evaluate, runs), 2) for runs in RUNS]
    found = Growth("runs", "evaluation of 3 rows, 60 s each, s", list(RUNS), costs)
    workers = [w for w in (1, 2, 4, 8, 16) if w <= (os.cpu_count() or 1)]
    shares = Growth("workers", f"the same with {TASKS} runs, s of wall time", list(workers))
    for jobs in workers:
        with open_pool(Workers("loky", jobs)) as pool:
            pool.compute(evaluate_run, numbered(jobs), shared, label="warm")  # starts them
            times = []
            for _ in range(3):
                start = time.monotonic()
                pool.compute(evaluate_run, numbered(TASKS), shared, label="runs")
                times.append(time.monotonic() - start)
        shares.costs.append(min(times))
    return [found, shares]


def drawn(growths: Sequence[Growth], file: Path) -> None:
    """One panel for each, in logarithms, with the line of linear growth."""
    figure = Figure((11.0, 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, growth in zip(figure.subplots(3, 3).flat, growths, strict=True):
        x, y = np.array(growth.values, float), np.array(growth.costs)
        linear = 1.0 if growth.along != "workers" else -1.0
        axes.loglog(x, y[-1] * (x / x[-1]) ** linear, "--", color="#999999", label="linear")
        axes.loglog(x, y, "o-", color="#0072b2", label=f"measured: exponent {growth.exponent:.2f}")
        axes.set_xticks(x, [f"{value:g}" for value in x])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.set_xlabel(growth.along)
        axes.set_title(growth.cost, fontsize=10)
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


def main() -> int:
    """Measure, print, draw and write."""
    parser = argparse.ArgumentParser(description="How the cost grows.")
    parser.add_argument("--out", type=Path, default=Path("docs/explanation"), metavar="FOLDER")
    folder = parser.parse_args().out
    growths: list[Growth] = []
    measured = (of_states, of_rows, of_window, of_trees, of_rate, of_length, of_runs)
    for measure in measured:
        found = measure()
        for growth in found if isinstance(found, list) else [found]:
            growths.append(growth)
            values = "  ".join(
                f"{v:g}: {c:.3g}" for v, c in zip(growth.values, growth.costs, strict=True)
            )
            print(f"{growth.cost} by {growth.along}: {values}; exponent {growth.exponent:.2f}")
            sys.stdout.flush()
    drawn(growths, folder / "performance.png")
    document = [vars(growth) | {"exponent": round(growth.exponent, 2)} for growth in growths]
    (folder / "performance.json").write_text(json.dumps(document, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
