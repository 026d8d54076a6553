"""The tables of the study."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from insdvl.studies.evaluation.approaches import R_NOMINAL, R_ORACLE
from insdvl.studies.report.markdown import interval, number, table
from insdvl.studies.results.dvl_noise.study import (
    CONDITIONS,
    LEFT_OUT,
    OUTLIERS,
    PLAIN,
    RATES,
    ROWS,
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


_Cell = Callable[[Mapping[str, Any]], str]


def noise_tables(document: Mapping[str, Any]) -> str:
    """The tables of both vehicles."""
    parts = [f"{document['runs']} missions of each vehicle, seed {document['seed']}.\n"]
    for scenario, rate in RATES.items():
        parts += [
            f"## `{scenario}`, {rate:g} Hz\n",
            "RMSE of the body velocity [m/s] in the missions in which no row failed.\n",
            _lines(document, scenario, _error),
            f"Over that of `{R_ORACLE}` in all missions; a dash where one of the two failed.\n",
            _lines(document, scenario, _to(R_ORACLE), without=(R_ORACLE,)),
            f"Over that of `{R_NOMINAL}`.\n",
            _lines(document, scenario, _to(R_NOMINAL), without=(R_NOMINAL,)),
            f"Over that of the same row with {PLAIN}.\n",
            _lines(document, scenario, _to(PLAIN), conditions=tuple(CONDITIONS)[1:]),
            f"Over that of the same row with {LEFT_OUT}.\n",
            _lines(document, scenario, _to(LEFT_OUT), conditions=(OUTLIERS,)),
            "NEES of the velocity per degree of freedom; 1 for a filter that is right about "
            "itself, above 1 for one that is overconfident.\n",
            _lines(document, scenario, lambda row: number(row["nees_velocity"], 2)),
        ]
    lines = [
        f"`{one['scenario']}`, {one['condition']}: no row failed in {one['paired_runs']} of "
        f"{document['runs']} missions."
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
