"""The targets of the studies on recordings of a real vehicle, for each learned row."""

from collections.abc import Mapping, Sequence
from typing import Any

from insdvl.studies.evaluation.approaches import BANDS, BANDS_WITH_FACTOR, FACTOR_WITH_R
from insdvl.studies.judgement.withheld import WINDOWS
from insdvl.studies.report.markdown import interval, number
from insdvl.studies.results.targets import Documents, Target, drawn, harmless
from insdvl.studies.results.vehicle_runs import HAND_SET, TOLD
from insdvl.studies.results.withheld import FREE, TAUGHT, TAUGHT_CONSTANT

_CLEAN = "recordings as they are"
#: Rows that learn from the samples or from the DVL, of the study without a reference.
PREDICTING = (
    BANDS,
    *(row + floor for row in (BANDS_WITH_FACTOR, TAUGHT, TAUGHT_CONSTANT) for floor in ("", FREE)),
)


def _of_each(documents: Documents, row: str, metric: str) -> dict[str, float] | None:
    """A number of a row by recording; None where it is missing."""
    rows = documents.get("vehicle", {"as_recorded": {"rows": {}}})["as_recorded"]["rows"]
    found: Mapping[str, float] = rows.get(row, {}).get(metric, {})
    return {name: value for name, value in found.items() if name != "mean"} or None


def _depth(row: str, limit: float) -> Target:
    def measured(documents: Documents) -> tuple[str, bool] | None:
        learned, hand_set = (
            _of_each(documents, name, "depth_error_end") for name in (row, HAND_SET)
        )
        if learned is None or hand_set is None:
            return None
        further = {name: abs(learned[name]) - abs(hand_set[name]) for name in learned}
        worst = max(further, key=further.__getitem__)
        return f"largest {further[worst]:+.3f} m ({worst})", further[worst] <= limit

    return Target(
        f"{_CLEAN}: depth at the end, `{row}`, at most {limit:g} m further off than "
        f"{HAND_SET} on each",
        measured,
    )


def _within(row: str, metric: str, words: str, low: float, high: float) -> Target:
    """A number in a range on each recording, with that of hand-set noise beside it."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        learned, hand_set = (_of_each(documents, name, metric) for name in (row, HAND_SET))
        if learned is None or hand_set is None:
            return None
        least, most = min(learned.values()), max(learned.values())
        text = f"{_range(least, most)} ({HAND_SET} {_range(*_ends(hand_set))})"
        return text, low <= least and most <= high

    limits = f"at least {low:g}" if high == 1.0 else f"in [{low:g}, {high:g}]"
    return Target(f"{_CLEAN}: {words}, `{row}`, {limits} on each", measured)


def _ends(found: Mapping[str, float]) -> tuple[float, float]:
    return min(found.values()), max(found.values())


def _range(low: float, high: float) -> str:
    return f"{number(low, 3)} to {number(high, 3)}"


def _to_told(name: str, row: str) -> Target:
    def measured(documents: Documents) -> tuple[str, bool] | None:
        found = documents.get("vehicle", {"injections": {}})["injections"].get(name)
        if found is None or row not in found["ratio_to"][TOLD]:
            return None
        ratio = found["ratio_to"][TOLD][row]["body_velocity_rmse"]
        return interval(ratio), ratio[0] <= 1.0

    return Target(
        f"recordings with `{name}` noise injected: body velocity, `{row}` / {TOLD}, paired mean at "
        "most 1.00",
        measured,
    )


def _as_they_are(row: str) -> tuple[Target, ...]:
    called = f"`{row}`"
    return (
        harmless("body_velocity_rmse", "body velocity", row, called),
        harmless("position_rmse_horizontal", "horizontal position", row, called),
        harmless("tilt_rmse_deg", "tilt", row, called, (1.2, 1.2)),
        _depth(row, 0.1),
        _within(row, "nis_mean", "NIS", 0.8, 3.5),
        _within(
            row,
            "innovation_autocorrelation",
            "autocorrelation of the innovations at lag 1",
            -0.2,
            0.2,
        ),
        _within(row, "body_velocity_inside_3_sigma", "velocity inside 3 sigma", 0.98, 1.0),
    )


def _with_noise(row: str) -> tuple[Target, ...]:
    return (
        *(_to_told(name, row) for name in ("sensor", "published")),
        *(drawn(name, row) for name in ("vibrating", "coloured")),
    )


#: Of the page on recordings. What is injected is no noise of the DVL.
OF_VEHICLE = (
    *(target for row in (BANDS, BANDS_WITH_FACTOR, FACTOR_WITH_R) for target in _as_they_are(row)),
    *(target for row in (BANDS, BANDS_WITH_FACTOR) for target in _with_noise(row)),
)


def _compared(documents: Documents, row: str, name: str) -> list[Sequence[float]] | None:
    """Intervals of a row against hand-set noise, by length of the windows; None where missing."""
    rows: Mapping[str, Any] = documents.get("withheld", {}).get("against_hand_set", {})
    return [rows[row][f"{w:g} s"][name] for w in WINDOWS] if row in rows else None


def _predicted(row: str) -> tuple[Target, ...]:
    """Of a row in the study without a reference; the end of each interval has to meet it."""

    def error(documents: Documents) -> tuple[str, bool] | None:
        found = _compared(documents, row, "error")
        if found is None:
            return None
        return "; ".join(map(interval, found)), all(x[2] <= 1.0 for x in found)

    def likelihood(documents: Documents) -> tuple[str, bool] | None:
        found = _compared(documents, row, "log_likelihood")
        if found is None:
            return None
        return "; ".join(map(interval, found)), all(x[1] > 0.0 for x in found)

    lengths = ", ".join(f"{w:g}" for w in WINDOWS)
    return (
        Target(f"error after {lengths} s, `{row}` / {HAND_SET}, at most 1.00", error),
        Target(
            f"log likelihood after {lengths} s, `{row}` less that of {HAND_SET}, above 0",
            likelihood,
        ),
    )


#: Of the page without a reference.
OF_WITHHELD = tuple(target for row in PREDICTING for target in _predicted(row))
