"""The tables of the study."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from insdvl.studies.evaluation.approaches import (
    BANDS,
    BANDS_WITH_FACTOR,
    BEST_CONSTANT,
    CLOSED_FORM,
    MATCHED,
    ORACLE,
)
from insdvl.studies.evaluation.sensors import Sensors
from insdvl.studies.report.markdown import interval, number, table
from insdvl.studies.results.breadth.study import ROWS


def row_of(comparison: Mapping[str, Any], approach: str) -> Mapping[str, Any]:
    """A row of a comparison; empty where it is missing, or has failed too often to be compared."""
    for row in comparison["rows"]:
        if row["approach"] == approach and row["ratio_to"]:
            found: Mapping[str, Any] = row
            return found
    return {}


def ratio(
    comparison: Mapping[str, Any], approach: str, reference: str, metric: str
) -> Sequence[float] | None:
    """Middle and ends of the ratio of a row to another; None where either is missing."""
    ratios: Mapping[str, Any] = row_of(comparison, approach).get("ratio_to", {})
    found: Sequence[float] | None = ratios.get(reference, {}).get(metric)
    return found


def rates_tables(document: Mapping[str, Any]) -> str:
    """The tables of the missions without outages."""
    comparisons = [one for one in document["comparisons"] if not one["outage"]]
    return "\n".join(
        [
            "Body velocity: RMSE of the oracle, and ratios of RMSE with their 95 % intervals.\n",
            _ratios(comparisons, "body_rmse"),
            "NEES of the velocity per degree of freedom, and error of the depth.\n",
            _lines(
                comparisons,
                {
                    **{
                        f"NEES, {row}": _nees(row, "velocity")
                        for row in ROWS
                        if row not in (CLOSED_FORM, MATCHED)
                    },
                    **{
                        f"depth [m], {row}": _value(row, "depth_rmse", 2)
                        for row in (BEST_CONSTANT, BANDS, ORACLE)
                    },
                },
            ),
            _notes(document, comparisons),
        ]
    )


def outages_tables(document: Mapping[str, Any]) -> str:
    """The tables of the missions with outages."""
    comparisons = [one for one in document["comparisons"] if one["outage"]]
    return "\n".join(
        [
            "Horizontal drift in an outage: RMS of the oracle, and ratios with their 95 % "
            "intervals.\n",
            _ratios(comparisons, "outage_drift", "m"),
            "Velocity at the end of an outage: RMS of the oracle, and ratios.\n",
            _ratios(comparisons, "outage_velocity"),
            "Drift of the depth [m], RMS.\n",
            _lines(comparisons, {row: _value(row, "outage_depth", 2) for row in ROWS}),
            "NEES per degree of freedom at the end of an outage: of the velocity, of the "
            "horizontal position, of the depth.\n",
            _lines(comparisons, {row: _three(row) for row in ROWS}),
            _notes(document, comparisons),
        ]
    )


_Cell = Callable[[Mapping[str, Any]], str]


def _ratios(comparisons: Sequence[Mapping[str, Any]], metric: str, unit: str = "m/s") -> str:
    def to(row: str, reference: str) -> _Cell:
        return lambda comparison: interval(ratio(comparison, row, reference, metric))

    return _lines(
        comparisons,
        {
            f"oracle [{unit}]": _value(ORACLE, metric, 3),
            **{f"{row} / oracle": to(row, ORACLE) for row in ROWS if row != ORACLE},
            **{
                f"{row} / {BEST_CONSTANT}": to(row, BEST_CONSTANT)
                for row in (BANDS, BANDS_WITH_FACTOR)
            },
        },
    )


def _value(row: str, metric: str, digits: int) -> _Cell:
    return lambda comparison: number(row_of(comparison, row).get(metric), digits)


def _nees(row: str, block: str) -> _Cell:
    return lambda comparison: number(row_of(comparison, row).get("nees_per_dof", {}).get(block), 2)


def _three(row: str) -> _Cell:
    blocks = [_nees(row, f"outage_{block}") for block in ("velocity", "position", "depth")]
    return lambda comparison: ", ".join(block(comparison) for block in blocks)


def _lines(comparisons: Sequence[Mapping[str, Any]], columns: Mapping[str, _Cell]) -> str:
    """A table with one line for each comparison."""
    body = [
        [name_of(comparison), *(cell(comparison) for cell in columns.values())]
        for comparison in comparisons
    ]
    return table(["scenario, IMU, DVL", *columns], body)


def name_of(comparison: Mapping[str, Any]) -> str:
    """Scenario, IMU and DVL of a comparison."""
    return f"`{comparison['scenario']}`, {configuration(comparison)}"


def configuration(comparison: Mapping[str, Any]) -> str:
    """IMU, and rate or outage of the DVL of a comparison, and its noise where it is another."""
    length, rate, std = (comparison[name] for name in ("outage", "dvl_rate", "dvl_std"))
    dvl = f"{length:g} s" if length else f"{rate:g} Hz"
    if std != Sensors().dvl_std:
        dvl += f", {std:g} m/s"
    return f"{comparison['imu_grade']}, {dvl}"


def _notes(document: Mapping[str, Any], comparisons: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        f"Runs of each line: {_runs(comparisons)}; seed {document['seed']}. The best constant is "
        "searched for each scenario, IMU and rate, without outages, on "
        f"{document['tuning_runs']} runs with other seeds."
    ]
    for comparison in comparisons:
        name, paired = name_of(comparison), comparison["paired_runs"]
        if paired < comparison["runs"]:
            lines.append(f"{name}: {paired} runs in which no row failed.")
        lines += [f"{name}: without {row} ({why})." for row, why in comparison["omitted"].items()]
    return "\n".join(lines) + "\n"


def _runs(comparisons: Sequence[Mapping[str, Any]]) -> str:
    """Numbers of runs, with the scenarios where they are not all the same."""
    scenarios: dict[int, dict[str, None]] = {}
    for one in comparisons:
        scenarios.setdefault(one["runs"], {})[f"`{one['scenario']}`"] = None
    if len(scenarios) == 1:
        return str(next(iter(scenarios)))
    return ", ".join(f"{runs} in {', '.join(names)}" for runs, names in scenarios.items())
