"""The cost of each source of the process noise, per second of mission.

    PYTHONPATH=src python benchmarks/process_noise.py

The mission of the evaluation through the filter of each row: what the row costs beyond the filter
with a constant Q, and the whole. Estimators run at 1 Hz. The rows take turns, and the least time of
each counts: what else the computer does hits all alike.
"""

import argparse
import time
from dataclasses import replace

from insdvl.studies.evaluation.approaches import (
    BANDS,
    BEST_XI,
    CLOSED_FORM,
    FIRST_CONSTANT,
    LEARNED,
    LEAST_BAND,
    MEDIAN_OF_SPECTRUM,
    SAGE_HUSA,
    SINGLE_BAND,
    VARIATIONAL,
    Approach,
    Setting,
    adaptives,
    approach,
    nominal,
    unavailable,
)
from insdvl.studies.evaluation.monte_carlo import TUNING, Run, Study

_ESTIMATED = (CLOSED_FORM, SINGLE_BAND, LEAST_BAND, MEDIAN_OF_SPECTRUM, BANDS, *LEARNED)


def rows(setting: Setting) -> list[Approach]:
    """The constant, then all sources that cost something."""
    first = approach(FIRST_CONSTANT, setting)
    with_factor = Approach("constant with factor", setting.filter(adaptive_factor=True))
    searched = adaptives(setting, nominal(first))
    of_innovations = [
        replace(searched[row][0], name=row) for row in (BEST_XI, VARIATIONAL, *SAGE_HUSA)
    ]
    missing = unavailable(_ESTIMATED)
    estimated = [approach(row, setting) for row in _ESTIMATED if row not in missing]
    return [first, with_factor, *of_innovations, *estimated]


def seconds(study: Study, every: list[Approach], rounds: int) -> list[float]:
    """Least time of processor of each for a mission, estimator included [s]."""
    best = [float("inf")] * len(every)
    for _ in range(rounds + 1):  # the first one loads and compiles
        run = Run(study, TUNING, 0)  # forgets what was estimated
        for k, one in enumerate(every):
            begin = time.process_time()
            run.fold(one)
            best[k] = min(best[k], time.process_time() - begin)
    return best


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=100.0, metavar="S")
    parser.add_argument("--rounds", type=int, default=5, metavar="N")
    arguments = parser.parse_args()
    study = Study("varying", seed=1, duration=arguments.duration)
    every = rows(Setting("calibrated"))
    costs = [1e3 * spent / arguments.duration for spent in seconds(study, every, arguments.rounds)]
    print("| source | beyond a constant Q [ms/s] | with the filter [ms/s] |")
    print("|---|--:|--:|")
    for one, cost in zip(every, costs, strict=True):
        print(f"| {one.name} | {cost - costs[0]:.3f} | {cost:.3f} |")


if __name__ == "__main__":
    main()
