"""The tables of the study."""

from collections.abc import Callable, Mapping
from math import sqrt
from typing import Any

from insdvl.studies.evaluation.approaches import BEST_CONSTANT, ORACLE
from insdvl.studies.report.markdown import interval, number, table
from insdvl.studies.results.others.flights import ROWS
from insdvl.studies.results.others.study import sources

_COMPONENTS = 3  # of a ping


def row_of(vehicle: Mapping[str, Any], approach: str) -> Mapping[str, Any]:
    """A row of a vehicle."""
    found: Mapping[str, Any] = next(r for r in vehicle["rows"] if r["approach"] == approach)
    return found


def others_tables(document: Mapping[str, Any]) -> str:
    """The tables of the study."""
    return "\n".join(
        [
            f"{document['runs']} missions of each vehicle, seed {document['seed']}.\n",
            "## Error of the body velocity\n",
            "RMSE of the best constant; then RMSE over that of the best constant: the mean over "
            "the missions with its 95 % interval, and the worst mission.\n",
            _lines(
                document,
                {
                    f"{BEST_CONSTANT} [m/s]": lambda one: number(
                        row_of(one, BEST_CONSTANT)["body_rmse"]
                    ),
                    **{row: _ratio(row) for row in ROWS if row != BEST_CONSTANT},
                },
            ),
            "## NEES of the velocity\n",
            "Per degree of freedom; 1 for a filter that is right about itself, above 1 for one "
            "that is overconfident.\n",
            _lines(document, {row: _value(row, "nees_velocity") for row in ROWS}),
            "## NIS\n",
            "Per component of a ping; 1 for innovations of the size that the filter expects.\n",
            _lines(document, {row: _per_component(row) for row in ROWS}),
            "## What the sources tell\n",
            "Variance that a source tells over the effective one, accelerometers / gyroscopes, "
            "geometric means over time, axes and missions; in the last column the best constant, "
            "over the geometric mean of the effective variances.\n",
            _lines(
                document,
                {
                    **{source: _told(source) for source in sources() if source != ORACLE},
                    BEST_CONSTANT: _constant,
                },
            ),
            "## The sensors\n",
            "Rates; sigma of a component of a ping; effective sigma of a sample of the IMU, the "
            "root of the geometric mean of the variances.\n",
            _lines(
                document,
                {
                    "IMU [Hz]": lambda one: f"{one['imu_rate']:g}",
                    "DVL [Hz]": lambda one: f"{one['dvl_rate']:g}",
                    "DVL [m/s]": lambda one: f"{one['dvl_std']:g}",
                    "accelerometers [m/s^2]": lambda one: f"{sqrt(one['effective'][0]):.2g}",
                    "gyroscopes [rad/s]": lambda one: f"{sqrt(one['effective'][1]):.2g}",
                },
            ),
        ]
    )


_Cell = Callable[[Mapping[str, Any]], str]


def _lines(document: Mapping[str, Any], columns: Mapping[str, _Cell]) -> str:
    """A table with one line for each vehicle."""
    body = [
        [one["vehicle"], *(cell(one) for cell in columns.values())] for one in document["vehicles"]
    ]
    return table(["vehicle", *columns], body)


def _ratio(row: str) -> _Cell:
    def cell(vehicle: Mapping[str, Any]) -> str:
        found = row_of(vehicle, row)
        if found["over_best_constant"] is None:
            return f"failed in {found['failures']}"
        return f"{interval(found['over_best_constant'])}; {number(found['worst'], 3)}"

    return cell


def _value(row: str, name: str) -> _Cell:
    return lambda vehicle: number(row_of(vehicle, row)[name], 2)


def _per_component(row: str) -> _Cell:
    def cell(vehicle: Mapping[str, Any]) -> str:
        nis = row_of(vehicle, row)["nis"]
        return number(None if nis is None else nis / _COMPONENTS, 2)

    return cell


def _told(source: str) -> _Cell:
    return lambda vehicle: " / ".join(
        f"{value:.2g}" for value in vehicle["told_over_effective"][source]
    )


def _constant(vehicle: Mapping[str, Any]) -> str:
    pairs = zip(vehicle["best_constant"], vehicle["effective"], strict=True)
    return " / ".join(f"{best / effective:.2g}" for best, effective in pairs)
