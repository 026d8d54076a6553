"""The tables of the study, and its targets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from insdvl.studies.evaluation.approaches import (
    R_ADAPTIVE,
    R_ADAPTIVE_WITH_FACTOR,
    R_LEARNED,
    R_NOMINAL,
    R_ORACLE,
)
from insdvl.studies.report.markdown import interval, number, table
from insdvl.studies.results.dvl_noise.study import (
    CONDITIONS,
    FOG,
    GATE,
    LARGE_Q,
    OUTLIERS,
    PLAIN,
    RATES,
    ROWS,
    SMALL_Q,
    TACTICAL,
)

#: The rows that the targets judge.
JUDGED = (R_LEARNED, R_ADAPTIVE, R_ADAPTIVE_WITH_FACTOR)


@dataclass(frozen=True)
class Target:
    """A target, set before the measurement: the upper end of the interval of a ratio.

    Attributes:
        scenario: Of the comparison.
        condition: Of the comparison.
        reference: What the error is compared with: a row of the same comparison, or the
            condition `PLAIN` of the own row.
        limit: At most this.
    """

    scenario: str
    condition: str
    reference: str
    limit: float


TARGETS = (
    Target(TACTICAL, PLAIN, R_ORACLE, 1.03),
    Target(FOG, PLAIN, R_ORACLE, 1.10),
    *(Target(scenario, GATE, PLAIN, 1.02) for scenario in RATES),
    *(
        Target(scenario, OUTLIERS, reference, 1.05)
        for scenario in RATES
        for reference in (R_ORACLE, PLAIN)
    ),
    *(
        Target(scenario, condition, R_NOMINAL, 1.02)
        for scenario in RATES
        for condition in (SMALL_Q, LARGE_Q)
    ),
)


def row_of(
    document: Mapping[str, Any], scenario: str, condition: str, approach: str
) -> Mapping[str, Any] | None:
    """A row of a comparison; None where the comparison does not have it."""
    for comparison in document["comparisons"]:
        if (comparison["scenario"], comparison["condition"]) == (scenario, condition):
            for row in comparison["rows"]:
                if row["approach"] == approach:
                    found: Mapping[str, Any] = row
                    return found
    return None


def ratio(
    document: Mapping[str, Any], scenario: str, condition: str, approach: str, reference: str
) -> Sequence[float] | None:
    """Middle and ends of a ratio; None where a row is missing or has failed in a mission."""
    row = row_of(document, scenario, condition, approach)
    return None if row is None else row["ratio_to"][reference]


def met(document: Mapping[str, Any], target: Target, approach: str) -> bool:
    """Whether a row meets a target; one that has failed meets none."""
    found = _measured(document, target, approach)
    return found is not None and found[2] <= target.limit


def _measured(document: Mapping[str, Any], target: Target, approach: str) -> Sequence[float] | None:
    return ratio(document, target.scenario, target.condition, approach, target.reference)


def targets_table(document: Mapping[str, Any]) -> str:
    """A line for each target: the verdict on each judged row, and what the oracle has."""
    return table(
        ["target", *(f"`{approach}`" for approach in JUDGED), f"`{R_ORACLE}`"],
        [
            [
                _words(target),
                *(_judged(document, target, approach) for approach in JUDGED),
                interval(_measured(document, target, R_ORACLE)),
            ]
            for target in TARGETS
        ],
    )


def _words(target: Target) -> str:
    own = target.reference == PLAIN
    reference = f"the same row with {PLAIN}" if own else f"`{target.reference}`"
    return f"`{target.scenario}`, {target.condition}: over {reference}, at most {target.limit:.2f}"


def _judged(document: Mapping[str, Any], target: Target, approach: str) -> str:
    verdict = "yes" if met(document, target, approach) else "**no**"
    return f"{interval(_measured(document, target, approach))}: {verdict}"


_Cell = Callable[[Mapping[str, Any]], str]


def noise_tables(document: Mapping[str, Any]) -> str:
    """The tables of both vehicles."""
    parts = [f"{document['runs']} missions of each vehicle, seed {document['seed']}.\n"]
    for scenario, rate in RATES.items():
        parts += [
            f"## `{scenario}`, {rate:g} Hz\n",
            "RMSE of the body velocity [m/s].\n",
            _lines(document, scenario, _error),
            f"Over that of `{R_ORACLE}`.\n",
            _lines(document, scenario, _to(R_ORACLE), without=(R_ORACLE,)),
            f"Over that of `{R_NOMINAL}`.\n",
            _lines(document, scenario, _to(R_NOMINAL), without=(R_NOMINAL,)),
            f"Over that of the same row with {PLAIN}.\n",
            _lines(document, scenario, _to(PLAIN), conditions=tuple(CONDITIONS)[1:]),
            "NEES of the velocity per degree of freedom; 1 for a filter that is right about "
            "itself, above 1 for one that is overconfident.\n",
            _lines(document, scenario, lambda row: number(row["nees_velocity"], 2)),
        ]
    lines = [
        f"`{one['scenario']}`, {one['condition']}: {one['paired_runs']} missions in which no row "
        "failed."
        for one in document["comparisons"]
        if one["paired_runs"] < document["runs"]
    ]
    return "\n".join([*parts, *lines])


def _error(row: Mapping[str, Any]) -> str:
    text = number(row["body_rmse"])
    return f"{text} (failed in {row['failures']})" if row["failures"] else text


def _to(reference: str) -> _Cell:
    return lambda row: interval(row["ratio_to"][reference])


def _lines(
    document: Mapping[str, Any],
    scenario: str,
    cell: _Cell,
    *,
    conditions: Sequence[str] = tuple(CONDITIONS),
    without: Sequence[str] = (),
) -> str:
    """A table with a line for each row, and a column for each condition."""
    body = []
    for approach in ROWS:
        if approach not in without:
            found = [row_of(document, scenario, one, approach) for one in conditions]
            body.append([f"`{approach}`", *("–" if row is None else cell(row) for row in found)])
    return table(["row", *conditions], body)
