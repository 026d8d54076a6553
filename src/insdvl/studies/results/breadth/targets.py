"""The targets of the study, set before the measurement."""

from collections.abc import Callable, Mapping
from typing import Any

from insdvl.studies.evaluation.approaches import BANDS, BANDS_WITH_FACTOR, BEST_CONSTANT, ORACLE
from insdvl.studies.report.markdown import interval, number
from insdvl.studies.results.breadth.study import BOTH_LEARNED, LENGTH, SCENARIOS
from insdvl.studies.results.breadth.tables import configuration, ratio, row_of
from insdvl.studies.results.targets import Documents, Target

#: Of a row in a comparison: its text, and by how much it misses or meets its target.
Judged = tuple[str, float]
_Judge = Callable[[Mapping[str, Any]], Judged | None]


def _everywhere(
    scenario: str, words: str, judge: _Judge, *, bound: _Judge | None = None, outage: float = 0.0
) -> Target:
    """A target of all comparisons of a scenario with outages of a length, or without.

    Args:
        scenario: Its name.
        words: The target.
        judge: Of the row.
        bound: Of the oracle by the same target, which tells what is possible in so few runs.
        outage: Length of the outages [s].
    """

    def measured(documents: Documents) -> tuple[str, bool] | None:
        comparisons = [
            one
            for one in documents.get("breadth", {"comparisons": []})["comparisons"]
            if one["scenario"] == scenario and one["outage"] == outage
        ]
        found = [(configuration(one), judge(one)) for one in comparisons]
        if not found:
            return None
        # A row that is missing or has failed meets no target.
        excess = {name: float("inf") if j is None else j[1] for name, j in found}
        texts = {name: "failed" if j is None else j[0] for name, j in found}
        worst, met = max(excess, key=excess.__getitem__), sum(x <= 0.0 for x in excess.values())
        text = f"{met} of {len(found)}; worst {texts[worst]} ({worst})"
        if bound is not None:
            of_oracle = [j is not None and j[1] <= 0.0 for j in map(bound, comparisons)]
            text += f"; oracle {sum(of_oracle)} of {len(found)}"
        return text, met == len(found)

    return Target(f"`{scenario}`: {words}", measured)


def _at_most(row_: str, reference: str, metric: str, limit: float) -> _Judge:
    def judge(comparison: Mapping[str, Any]) -> Judged | None:
        found = ratio(comparison, row_, reference, metric)
        return None if found is None else (interval(found), found[2] - limit)

    return judge


def _within(row_: str, block: str, low: float, high: float) -> _Judge:
    def judge(comparison: Mapping[str, Any]) -> Judged | None:
        found = row_of(comparison, row_)
        if not found:
            return None
        value = found["nees_per_dof"][block]
        return number(value, 2), max(low - value, value - high)

    return judge


def _of_breadth(scenario: str, row_: str) -> tuple[Target, ...]:
    low, high = (0.85, 1.15) if scenario == "coloured" else (0.9, 1.1)
    return (
        _everywhere(
            scenario,
            f"body velocity, `{row_}` / best constant, at most 1, with all IMUs and DVLs",
            _at_most(row_, BEST_CONSTANT, "body_rmse", 1.0),
            bound=_at_most(ORACLE, BEST_CONSTANT, "body_rmse", 1.0),
        ),
        _everywhere(
            scenario,
            f"NEES of the velocity, `{row_}`, in [{low:g}, {high:g}], with all IMUs and DVLs",
            _within(row_, "velocity", low, high),
            bound=_within(ORACLE, "velocity", low, high),
        ),
        _everywhere(
            scenario,
            f"drift after 60 s, `{row_}` / oracle, at most 1.05, with all IMUs",
            _at_most(row_, ORACLE, "outage_drift", 1.05),
            outage=LENGTH,
        ),
        _everywhere(
            scenario,
            f"NEES of the horizontal position after 60 s, `{row_}`, in [0.8, 1.25], with all IMUs",
            _within(row_, "outage_position", 0.8, 1.25),
            bound=_within(ORACLE, "outage_position", 0.8, 1.25),
            outage=LENGTH,
        ),
    )


#: Of the page on other IMUs, rates and outages.
OF_BREADTH = (
    *(
        target
        for scenario in SCENARIOS
        for row_ in (BANDS, BANDS_WITH_FACTOR)
        for target in _of_breadth(scenario, row_)
    ),
    *(target for row_ in BOTH_LEARNED for target in _of_breadth("realistic", row_)),
)
