"""The numbers of docs/results/README.md, held against the studies.

They are written by hand; another seed or another number of runs would leave them standing.
"""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from claims import check

from insdvl.studies.results.breadth import tables as breadth
from insdvl.studies.results.command import documents
from insdvl.studies.results.targets import row

DOCS = Path(__file__).parents[3] / "docs"
DRAWN = ("vibrating", "coloured", "waves", "realistic")
WHITE = ("varying", "wide")


@cache
def numbers() -> dict[str, Any]:
    return documents(DOCS / "results")


def of(scenario: str, approach: str) -> dict[str, Any]:
    found = row(numbers()[f"{scenario}-spectrum"], approach)
    assert found is not None
    return found


def ratio(scenario: str, approach: str, reference: str = "oracle") -> list[float]:
    """Middle and ends."""
    return list(of(scenario, approach)["ratio_to"][reference]["body_rmse"])


def nees(scenario: str, approach: str, block: str = "velocity") -> float:
    return float(of(scenario, approach)["nees_per_dof"][block])


def percent(value: float) -> float:
    return 100.0 * (value - 1.0)


def gain(scenario: str, approach: str) -> float:
    """Of the error of the best constant [%]."""
    return -percent(ratio(scenario, approach, "best constant")[0])


def share(approach: str) -> float:
    """Of the gap from the best constant to the oracle in `realistic` [%]."""
    return 100.0 * gain("realistic", approach) / gain("realistic", "oracle")


def vehicles(approach: str, value: str, named: str = "") -> list[float]:
    found = numbers()["other-vehicles"]["vehicles"]
    chosen = [row(one, approach) for one in found if named in one["vehicle"]]
    values = [one[value] for one in chosen if one is not None]
    return [x[0] if isinstance(x, list) else x for x in values]


def span(values: Sequence[float]) -> tuple[float, float]:
    return min(values), max(values)


def injected(name: str, reference: str, approach: str) -> float:
    """Of the error of a row on recordings with noise."""
    ratios = numbers()["vehicle"]["injections"][name]["ratio_to"][reference]
    return float(ratios[approach]["body_velocity_rmse"][0])


def of_recorded(metric: str, approach: str, recording: str) -> float:
    """Ratio to hand-set noise on a recording as it is."""
    rows = numbers()["vehicle"]["as_recorded"]["rows"]
    return float(rows[approach][metric][recording] / rows["hand-set"][metric][recording])


def ends_of_hand_set(metric: str) -> tuple[float, float]:
    """On the recordings as they are."""
    found = numbers()["vehicle"]["as_recorded"]["rows"]["hand-set"][metric]
    values = [value for name, value in found.items() if name != "mean"]
    return min(values), max(values)


def further_off(approach: str) -> float:
    """In depth at the end than hand-set noise, on the worst recording as it is [m]."""
    rows = numbers()["vehicle"]["as_recorded"]["rows"]
    learned, hand_set = (rows[name]["depth_error_end"] for name in (approach, "hand-set"))
    return max(abs(learned[name]) - abs(hand_set[name]) for name in learned if name != "mean")


def lost_by_the_gate(approach: str) -> float:
    """With noise of the published range, in percent of the body velocity error."""
    rows = numbers()["vehicle"]["injections"]["published"]["rows"]
    errors = (rows[f"{approach}{gate}"]["body_velocity_rmse"]["mean"] for gate in (", gate on", ""))
    return 100.0 * (next(errors) / next(errors) - 1.0)


def ends_lost_by_the_gate(*approaches: str) -> tuple[float, float]:
    lost = [lost_by_the_gate(approach) for approach in approaches]
    return min(lost), max(lost)


def predicted(approach: str) -> tuple[float, ...]:
    """Ratios of the errors after 10, 30 and 60 s without the DVL to those of hand-set noise."""
    found = numbers()["withheld"]["against_hand_set"][approach]
    return tuple(found[f"{seconds} s"]["error"][0] for seconds in (10, 30, 60))


def lines(
    *scenarios: str, grades: Sequence[str] = ("fog", "tactical", "mems"), outage: float = 0.0
) -> list[dict[str, Any]]:
    """Of the study of other IMUs."""
    return [
        one
        for one in numbers()["breadth"]["comparisons"]
        if one["scenario"] in scenarios and one["imu_grade"] in grades and one["outage"] == outage
    ]


def over(found: Sequence[dict[str, Any]], approach: str, reference: str = "oracle") -> list[float]:
    """Means of the ratios of the body velocity, or of the drift in an outage."""
    metrics = ["outage_drift" if one["outage"] else "body_rmse" for one in found]
    ratios = [
        breadth.ratio(one, approach, reference, metric)
        for one, metric in zip(found, metrics, strict=True)
    ]
    return [x[0] for x in ratios if x is not None]


def nees_of(found: Sequence[dict[str, Any]], approach: str, block: str = "velocity") -> list[float]:
    return [float(breadth.row_of(one, approach)["nees_per_dof"][block]) for one in found]


def drift(approach: str) -> float:
    """Of MEMS in `realistic` after a minute [m]."""
    (line,) = lines("realistic", grades=("mems",), outage=60.0)
    return float(breadth.row_of(line, approach)["outage_drift"])


def at_5_hz(approach: str, grade: str) -> float:
    found = [x for x in lines("realistic", grades=(grade,)) if x["dvl_rate"] == 5.0]
    return over(found, approach)[0]


CALM, OTHERS = ("vibrating", "waves"), ("tactical", "mems")
R_LEARNED, FACTOR_R = "bands with R adaptive", "bands with factor and R adaptive"
WITH_ERROR = "bands with factor and R adaptive and DVL error"

#: Parts of sentences, N for each number, and what the numbers are.
CLAIMS: dict[str, Callable[[], Sequence[float]]] = {
    "The model `bands` is within N % of the oracle in all of them and in the white ones": lambda: [
        max(percent(ratio(name, "bands")[0]) for name in (*DRAWN, *WHITE))
    ],
    "it gains N % in `vibrating` and `waves`, and nothing": lambda: [gain("vibrating", "bands")],
    "is overconfident (NEES N to N) and takes the error there from N to N of": lambda: [
        *(nees("coloured", name) for name in ("bands", "bands with factor")),
        *(ratio("coloured", name)[0] for name in ("bands", "bands with factor")),
    ],
    "it makes the error N % larger than the best": lambda: [
        -gain("realistic", "bands with factor")
    ],
    "the oracle itself has N to N of the error of the best constant": lambda: span(
        [ratio(name, "oracle", "best constant")[0] for name in DRAWN]
    ),
    "learning R beside Q: N % of the error, N % of what the oracle gains": lambda: [
        gain("realistic", R_LEARNED),
        share(R_LEARNED),
    ],
    "and with the factor N %, N % in the mean": lambda: [
        gain("realistic", FACTOR_R),
        share(FACTOR_R),
    ],
    "NEES of the velocity N in place of N, of the position N in place of N": lambda: [
        nees("realistic", name, block)
        for block in ("velocity", "position")
        for name in (WITH_ERROR, FACTOR_R)
    ],
    "where the slow error of the DVL makes N %": lambda: [
        percent(ratio("realistic", "oracle", "matched")[0])
    ],
    "0.9 of the closed form: the oracle itself has N [N, N]": lambda: ratio(
        "vibrating", "oracle", "closed form"
    ),
    "takes for granted that the noise is white, has N [N, N] and N [N, N]": lambda: [
        *ratio("varying", "closed form"),
        *ratio("wide", "closed form"),
    ],
    "does not know that the noise is white, and has N and N": lambda: [
        ratio(name, "bands")[0] for name in WHITE
    ],
    "75 % of the gap at the upper end of the interval: the gap is N %": lambda: [
        gain("realistic", "oracle")
    ],
    "`bands with factor` has N [N, N] of the oracle's error where 1.02 was asked": lambda: ratio(
        "coloured", "bands with factor"
    ),
    "N [N, N] of the closed form's where 0.9 was": lambda: ratio(
        "coloured", "bands with factor", "closed form"
    ),
    "and a NEES of N where 1.15 was": lambda: [nees("coloured", "bands with factor")],
    "and `bands` costs up to N %": lambda: [
        max(
            percent(x)
            for x in vehicles("bands", "over_best_constant")
            if x not in vehicles("bands", "over_best_constant", "coloured")
        )
    ],
    "that is within N % of the best constant on all twelve": lambda: [
        percent(max(vehicles("bands with factor", "over_best_constant")))
    ],
    "Its NEES of the velocity is N to N": lambda: span(
        vehicles("bands with factor", "nees_velocity")
    ),
    "on T06 it has N and N": lambda: (
        of_recorded("body_velocity_rmse", "bands", "T06"),
        of_recorded("position_rmse_horizontal", "bands", "T06"),
    ),
    "`bands` has up to N (T08), with the factor up to N (T01)": lambda: (
        of_recorded("tilt_rmse_deg", "bands", "T08"),
        of_recorded("tilt_rmse_deg", "bands with factor", "T01"),
    ),
    "The depth at the end is at most N m further off": lambda: [
        max(further_off(name) for name in ("bands", "bands with factor"))
    ],
    "Its NIS is N to N": lambda: ends_of_hand_set("nis_mean"),
    "from one ping to the next is N to N": lambda: ends_of_hand_set("innovation_autocorrelation"),
    "`bands` has N of it with noise of the sensor and N with the published noise": lambda: (
        injected("sensor", "told", "bands"),
        injected("published", "told", "bands"),
    ),
    "with the factor N and N. With vibrating": lambda: (
        injected("sensor", "told", "bands with factor"),
        injected("published", "told", "bands with factor"),
    ),
    "beside the hand-set one has N and N": lambda: (
        injected("vibrating", "best constant", "told with hand-set"),
        injected("coloured", "best constant", "told with hand-set"),
    ),
    "`bands` has N, N and N of the error": lambda: predicted("bands"),
    "with the factor N, N and N": lambda: predicted("bands with factor"),
    "and after 10 s it is N": lambda: (
        numbers()["withheld"]["against_hand_set"]["taught, no floor"]["10 s"]["error"][2],
    ),
    "`default`, `paper` and the closed form lose N to N %": lambda: ends_lost_by_the_gate(
        "hcf default", "hcf paper", "closed form"
    ),
    "`bands` with the factor N % and `bands` N %": lambda: (
        lost_by_the_gate("bands with factor"),
        lost_by_the_gate("bands"),
    ),
    "has N runs of each line": lambda: sorted(
        {one["runs"] for one in numbers()["breadth"]["comparisons"]}
    ),
    "In `vibrating` and `waves` `bands` is within N % of the oracle with a FOG": lambda: [
        percent(max(over(lines(*CALM), "bands")))
    ],
    "noise of the IMU: at most N % with a FOG, N to N % with MEMS": lambda: [
        -percent(min(over(lines(*CALM, grades=("fog",)), "bands", "best constant"))),
        *(
            -percent(x)
            for x in span(over(lines(*CALM, grades=("mems",)), "bands", "best constant"))[::-1]
        ),
    ],
    "it is up to N % behind the oracle and up to N % behind the best constant; with the "
    "factor N and N %": lambda: [
        percent(max(over(lines("coloured"), approach, reference)))
        for approach in ("bands", "bands with factor")
        for reference in ("oracle", "best constant")
    ],
    "and the NEES of the velocity is N to N in place of N to N": lambda: [
        *span(nees_of(lines("coloured"), "bands with factor")),
        *span(nees_of(lines("coloured"), "bands")),
    ],
    "`bands` has N to N of the oracle's error, the best constant N to N": lambda: [
        *span(over(lines("realistic", grades=("fog",)), "bands")),
        *span(over(lines("realistic", grades=("fog",)), "best constant")),
    ],
    "With the other two IMUs `bands` is N to N % behind": lambda: [
        percent(x) for x in span(over(lines("realistic", grades=OTHERS), "bands"))
    ],
    "in `vibrating` and `waves`, N to N of it": lambda: span(
        over(lines(*CALM, outage=60.0), "bands")
    ),
    "In `coloured` it is up to N % more, with the factor up to N %": lambda: [
        percent(max(over(lines("coloured", outage=60.0), name)))
        for name in ("bands", "bands with factor")
    ],
    "it is N % more, N m in place of N m, and with the factor and the adaptive R N %": lambda: [
        percent(drift("bands") / drift("oracle")),
        drift("bands"),
        drift("oracle"),
        percent(drift(FACTOR_R) / drift("oracle")),
    ],
    "is N to N in all lines, without them N to N": lambda: [
        *span(nees_of(lines("realistic"), WITH_ERROR)),
        *span(nees_of(lines("realistic"), FACTOR_R)),
    ],
    "The error is N to N of the oracle's with them, N to N without": lambda: [
        *span(over(lines("realistic"), WITH_ERROR)),
        *span(over(lines("realistic"), FACTOR_R)),
    ],
    "with a tactical IMU N and N, with a FOG N and N": lambda: [
        at_5_hz(name, grade) for grade in ("tactical", "fog") for name in (WITH_ERROR, FACTOR_R)
    ],
    "of its position is N in `realistic` with a FOG": lambda: [
        nees_of(lines("realistic", grades=("fog",), outage=60.0), "oracle", "outage_position")[0]
    ],
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_a_sentence_has_the_numbers_of_the_study(claim: str) -> None:
    check(claim, (DOCS / "results" / "README.md").read_text(), CLAIMS[claim]())


def test_only_what_the_dvl_taught_without_floors_predicts_it_better() -> None:
    better = {
        name
        for name, lengths in numbers()["withheld"]["against_hand_set"].items()
        if all(of["error"][0] < 1.0 and of["log_likelihood"][0] > 0.0 for of in lengths.values())
    }
    assert better == {"taught, no floor", "taught constant, no floor"}
