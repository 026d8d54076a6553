"""What the forest plots of the results show, and the sentence above each.

The sentence is computed from the numbers that are drawn, so that it holds for other ones too.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.noise import SCENARIOS
from insdvl.studies.evaluation.approaches import (
    BANDS,
    BANDS_WITH_FACTOR,
    BEST_CONSTANT,
    CLOSED_FORM,
    FACTOR_WITH_ERROR,
    FACTOR_WITH_R,
    LEAST_BAND,
    ORACLE,
    R_ADAPTIVE,
    R_ADAPTIVE_WITH_FACTOR,
    R_LEARNED,
    R_NOMINAL,
    R_ORACLE,
    VARIATIONAL,
)
from insdvl.studies.judgement.withheld import WINDOWS
from insdvl.studies.results.breadth import tables as breadth
from insdvl.studies.results.others import tables as others
from insdvl.studies.results.others.flights import DEFAULT
from insdvl.studies.results.targets import Documents, row
from insdvl.studies.results.vehicle_runs import HAND_SET, TOLD
from insdvl.studies.results.withheld import FREE, TAUGHT, TAUGHT_CONSTANT

#: Middle and ends of an interval.
Ratio = tuple[float, float, float]
Groups = dict[str, dict[str, Ratio]]

#: Words and colours (Okabe and Ito) of the rows, in the order of the legend.
_STYLES = {
    DEFAULT: ("learned from white noise", "#0072b2"),
    BANDS: ("learned from spectra", "#56b4e9"),
    BANDS_WITH_FACTOR: ("and a factor that the DVL tells", "#000000"),
    FACTOR_WITH_R: ("and the noise of the DVL", "#999999"),
    FACTOR_WITH_ERROR: ("and states for its slow error", "#d55e00"),
    CLOSED_FORM: ("closed form, the variance of a window", "#009e73"),
    LEAST_BAND: ("closed form, the least band", "#f0e442"),
    VARIATIONAL: ("variational Bayes, from innovations", "#cc79a7"),
    BEST_CONSTANT: ("best constant", "#e69f00"),
    "constant 0.01/0.001": ("constant 0.01/0.001, as published", "#d55e00"),
}
#: Those of the study of the DVL's noise.
_STYLES_OF_R = {
    R_NOMINAL: ("that of the data sheet", "#e69f00"),
    R_LEARNED: ("from the pings and the IMU between them", "#009e73"),
    R_ADAPTIVE: ("from the innovations too", "#0072b2"),
    R_ADAPTIVE_WITH_FACTOR: ("and a factor on Q", "#000000"),
}
#: Those of the study without a reference.
_STYLES_OF_TAUGHT = {
    BANDS: ("learned from spectra", "#56b4e9"),
    BANDS_WITH_FACTOR: ("and a factor that the DVL tells", "#000000"),
    f"{BANDS_WITH_FACTOR}{FREE}": ("with the factor, without the floor", "#999999"),
    TAUGHT: ("taught by the DVL", "#e69f00"),
    f"{TAUGHT}{FREE}": ("taught, without the floor", "#d55e00"),
    f"{TAUGHT_CONSTANT}{FREE}": ("a constant, taught, without the floor", "#009e73"),
}
_LENGTH = "30 s"  # of the outages in the title
_OVER_ORACLE = "error of the body velocity over that of a filter that is told the noise"


@dataclass(frozen=True)
class Forest:
    """A forest plot.

    Attributes:
        title: A sentence.
        axis: What the ratios are.
        rows: Words and colour of each row, by name.
        groups: Ratios by group and row.
    """

    title: str
    axis: str
    rows: Mapping[str, tuple[str, str]]
    groups: Groups


def forests(documents: Documents) -> dict[str, Forest]:
    """The plots by the names of their files; one whose numbers are missing is left out."""
    found = {name: make(documents) for name, make in _FORESTS.items()}
    return {name: one for name, one in found.items() if one is not None}


def overview(documents: Documents) -> Forest | None:
    """All comparisons, each over a filter that is told the noise."""
    rows = _styles(
        *(DEFAULT, BANDS, BANDS_WITH_FACTOR, FACTOR_WITH_R, CLOSED_FORM, VARIATIONAL),
        *(BEST_CONSTANT, "constant 0.01/0.001"),
    )
    parts = {f"{scenario}-calibrated": scenario for scenario in SCENARIOS}
    parts |= {f"{scenario}-spectrum": scenario for scenario in DRAWN}
    groups = {
        f"{scenario}, simulated": _over_oracle(documents[part], rows)
        for part, scenario in parts.items()
        if part in documents
    }
    if "vehicle" in documents:
        for name, injected in documents["vehicle"]["injections"].items():
            groups[f"recordings, noise injected: {name}"] = _of_vehicle(
                injected["ratio_to"][TOLD], "body_velocity_rmse", rows
            )
    groups = {name: ratios for name, ratios in groups.items() if ratios}
    white = _largest(_simulated(groups, SCENARIOS), DEFAULT)
    other = _largest(_simulated(groups, DRAWN), BANDS)
    if white is None or other is None:
        return None
    return Forest(
        f"In simulation a learned Q is at most {_percent(white)} behind a told one where the noise "
        f"is white, and {_percent(other)} where it is not",
        _OVER_ORACLE,
        rows,
        groups,
    )


def _simulated(groups: Groups, scenarios: Iterable[str]) -> Groups:
    names = {f"{scenario}, simulated" for scenario in scenarios}
    return {name: ratios for name, ratios in groups.items() if name in names}


def _spectrum(documents: Documents) -> Forest | None:
    rows = _styles(
        *(BANDS, BANDS_WITH_FACTOR, FACTOR_WITH_R, FACTOR_WITH_ERROR),
        *(CLOSED_FORM, LEAST_BAND, VARIATIONAL, BEST_CONSTANT),
    )
    groups = {
        part.removesuffix("-spectrum"): _over_oracle(document, rows)
        for part, document in documents.items()
        if part.endswith("-spectrum")
    }
    worst = _largest(groups, BANDS)
    if worst is None:
        return None
    return Forest(
        f"The model learned from spectra is at most {_percent(worst)} behind a filter that is told "
        "the noise",
        _OVER_ORACLE,
        rows,
        groups,
    )


def _breadth(documents: Documents) -> Forest | None:
    comparisons = [one for one in _comparisons(documents, "breadth") if not one["outage"]]
    rows = _styles(BANDS, BANDS_WITH_FACTOR, FACTOR_WITH_R, FACTOR_WITH_ERROR)
    groups: Groups = {}
    for one in comparisons:
        over = partial(breadth.ratio, one, reference=BEST_CONSTANT, metric="body_rmse")
        name = f"{one['scenario']}, {breadth.configuration(one)}"
        groups[name] = dict(_found(rows, over))
    worst, best = _largest(groups, BANDS), _smallest(groups, BANDS)
    if worst is None or best is None:
        return None
    return Forest(
        f"With other IMUs and DVLs the model learned from spectra has {best:.2f} to {worst:.2f} of "
        "the error of the best constant",
        "error of the body velocity over that of the best constant",
        rows,
        groups,
    )


def _others(documents: Documents) -> Forest | None:
    vehicles = documents.get("other-vehicles", {"vehicles": []})["vehicles"]
    rows = _styles(DEFAULT, BANDS, BANDS_WITH_FACTOR, FACTOR_WITH_R, LEAST_BAND)
    groups: Groups = {}
    for one in vehicles:
        found = {name: others.row_of(one, name)["over_best_constant"] for name in rows}
        groups[one["vehicle"]] = dict(_found(rows, found.get))
    without, worst = _largest(groups, BANDS), _largest(groups, BANDS_WITH_FACTOR)
    if without is None or worst is None:
        return None
    return Forest(
        f"A factor that the DVL tells takes the worst vehicle from {_percent(without)} to "
        f"{_percent(worst)} behind the best constant",
        "error of the body velocity over that of the best constant",
        rows,
        groups,
    )


def _vehicle(documents: Documents) -> Forest | None:
    if "vehicle" not in documents:
        return None
    rows = _styles(DEFAULT, BANDS, BANDS_WITH_FACTOR, CLOSED_FORM)
    ratios = documents["vehicle"]["as_recorded"]["ratio_to"][HAND_SET]
    metrics = {
        "body velocity": "body_velocity_rmse",
        "horizontal position": "position_rmse_horizontal",
        "tilt": "tilt_rmse_deg",
    }
    groups = {words: _of_vehicle(ratios, metric, rows) for words, metric in metrics.items()}
    velocity, tilt = (groups[name].get(BANDS_WITH_FACTOR) for name in ("body velocity", "tilt"))
    if velocity is None or tilt is None:
        return None
    return Forest(
        f"On real recordings a learned Q with the factor has {velocity[0]:.3f} of the error of the "
        f"hand-set one, and {tilt[0]:.2f} in tilt",
        "error over that of the hand-set noise, recordings as they are",
        rows,
        groups,
    )


def _dvl_noise(documents: Documents) -> Forest | None:
    groups: Groups = {}
    for one in _comparisons(documents, "dvl-noise"):
        ratios = {row["approach"]: row["ratio_to"][R_ORACLE] for row in one["rows"]}
        groups[f"{one['scenario']}, {one['condition']}"] = dict(_found(_STYLES_OF_R, ratios.get))
    worst = _largest(groups, R_ADAPTIVE)
    if worst is None:
        return None
    return Forest(
        f"A filter that learns the noise of its DVL is at most {_percent(worst)} behind one that "
        "is told it",
        "error of the body velocity over that of a filter that is told R",
        _STYLES_OF_R,
        groups,
    )


def _withheld(documents: Documents) -> Forest | None:
    against = documents.get("withheld", {}).get("against_hand_set", {})
    groups: Groups = {}
    for seconds in WINDOWS:
        over = {row: lengths[f"{seconds:g} s"]["error"] for row, lengths in against.items()}
        groups[f"{seconds:g} s"] = dict(_found(_STYLES_OF_TAUGHT, over.get))
    taught = groups[_LENGTH].get(f"{TAUGHT}{FREE}")
    if taught is None:
        return None
    return Forest(
        f"What the DVL has taught predicts it after {_LENGTH} with {taught[0]:.2f} of the error of "
        "hand-set noise",
        "error of the first ping after an outage over that with hand-set noise",
        _STYLES_OF_TAUGHT,
        groups,
    )


#: The plots, by file and page; the first is on the page of all results.
_FORESTS: Mapping[str, Callable[[Documents], Forest | None]] = {
    "forest": overview,
    "spectrum": _spectrum,
    "breadth": _breadth,
    "other-vehicles": _others,
    "dvl-noise": _dvl_noise,
    "vehicle": _vehicle,
    "withheld": _withheld,
}


def _styles(*names: str) -> dict[str, tuple[str, str]]:
    return {name: _STYLES[name] for name in names}


def _comparisons(documents: Documents, part: str) -> list[Mapping[str, Any]]:
    found: list[Mapping[str, Any]] = documents.get(part, {"comparisons": []})["comparisons"]
    return found


def _found(rows: Mapping[str, Any], ratio_of: Callable[[str], Any]) -> Iterator[tuple[str, Ratio]]:
    for name in rows:
        ratio = ratio_of(name)
        if ratio is not None:
            middle, low, high = ratio
            yield name, (middle, low, high)


def _over_oracle(document: Mapping[str, Any], rows: Mapping[str, Any]) -> dict[str, Ratio]:
    def ratio_of(name: str) -> Any:
        numbers = row(document, name)
        over = (numbers or {}).get("ratio_to") or {}
        return over.get(ORACLE, {}).get("body_rmse")

    return dict(_found(rows, ratio_of))


def _of_vehicle(
    ratios: Mapping[str, Any], metric: str, rows: Mapping[str, Any]
) -> dict[str, Ratio]:
    return dict(_found(rows, lambda name: ratios[name][metric] if name in ratios else None))


def _middles(groups: Groups, name: str) -> list[float]:
    return [ratios[name][0] for ratios in groups.values() if name in ratios]


def _largest(groups: Groups, name: str) -> float | None:
    return max(_middles(groups, name), default=None)


def _smallest(groups: Groups, name: str) -> float | None:
    return min(_middles(groups, name), default=None)


def _percent(ratio: float) -> str:
    return f"{100.0 * (ratio - 1.0):.1f} %"
