"""What the pages say of the learned noise of the DVL, held against the numbers of the study."""

import re
from collections.abc import Callable, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from claims import check, one_line, unclaimed

from insdvl.files import read_json
from insdvl.studies.results.dvl_noise.tables import row_of
from insdvl.studies.results.dvl_noise.targets import OF_DVL_NOISE
from insdvl.studies.results.dvl_noise.text import CONCLUSION
from insdvl.studies.results.page import pages

DOCS = Path(__file__).parents[3] / "docs"
TACTICAL, FOG = VEHICLES = ("bottom-tactical", "bottom-fog")
PLAIN, GATE = "gate off", "gate on"
OUTLIERS, LEFT_OUT = "gate on, outliers", "gate on, outliers left out"
SMALL_Q, LARGE_Q = "a hundredth of Q", "a hundred times Q"
LEARNED = ("R learned", "R adaptive", "R adaptive with factor")


@cache
def committed() -> dict[str, Any]:
    return read_json(DOCS / "results" / "dvl-noise.json", 2**22)


def numbers(vehicle: str, condition: str, row: str) -> dict[str, Any]:
    found = row_of(committed(), vehicle, condition, row)
    assert found is not None
    return dict(found)


def ratio(vehicle: str, condition: str, row: str, reference: str) -> float:
    return float(numbers(vehicle, condition, row)["ratio_to"][reference][0])


def both(condition: str, row: str, reference: str) -> list[float]:
    """Of the two vehicles."""
    return [ratio(vehicle, condition, row, reference) for vehicle in VEHICLES]


def error(vehicle: str, condition: str, row: str) -> float:
    """Mean over the missions."""
    for one in committed()["comparisons"]:
        if (one["scenario"], one["condition"]) == (vehicle, condition):
            return float(np.mean(one["per_run"][row]))
    raise KeyError(vehicle, condition)


def more(
    row: str, than: str, conditions: Sequence[str], vehicles: Sequence[str] = VEHICLES
) -> list[float]:
    """By how many per cent a row is worse than another, in all of these comparisons."""
    pairs = product(vehicles, conditions)
    return [100.0 * (error(*pair, row) / error(*pair, than) - 1.0) for pair in pairs]


def rmse(condition: str) -> list[float]:
    """Of the nominal row of the two vehicles, where no row fails."""
    return [float(numbers(vehicle, condition, "R nominal")["body_rmse"]) for vehicle in VEHICLES]


def medians() -> list[float]:
    """Of the nominal row with the gate on and off, of the two vehicles; a failure is no number."""
    found = {(one["scenario"], one["condition"]): one for one in committed()["comparisons"]}
    errors = (
        found[vehicle, condition]["per_run"]["R nominal"]
        for condition in (GATE, PLAIN)
        for vehicle in VEHICLES
    )
    return [float(np.median([np.inf if x is None else x for x in one])) for one in errors]


def of_the_gate() -> float:
    """Largest change by the gate, of the rows that learn R [%]."""
    return max(100.0 * abs(value - 1.0) for row in LEARNED for value in both(GATE, row, PLAIN))


def cost(row: str) -> list[float]:
    """Of outliers, on both vehicles [%]."""
    return [100.0 * (value - 1.0) for value in both(OUTLIERS, row, LEFT_OUT)]


def of_missions(vehicle: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the adaptive row in each mission, with outliers and without those pings."""
    found = {
        one["condition"]: np.array(one["per_run"]["R adaptive"])
        for one in committed()["comparisons"]
        if one["scenario"] == vehicle
    }
    return found[OUTLIERS], found[LEFT_OUT]


def median_costs() -> list[float]:
    """Of outliers, in the median mission of both vehicles [%]."""
    pairs = [of_missions(vehicle) for vehicle in VEHICLES]
    return [100.0 * float(np.median(with_ / without) - 1.0) for with_, without in pairs]


def without_the_worst() -> float:
    """The ratio at 5 Hz without the one mission that makes its interval wide."""
    with_, without = of_missions(TACTICAL)
    others = with_ / without < 1.5
    assert others.sum() == len(others) - 1
    return float(with_[others].sum() / without[others].sum())


def upper_end() -> float:
    """Of the ratio at 5 Hz."""
    return float(numbers(TACTICAL, OUTLIERS, "R adaptive")["ratio_to"][LEFT_OUT][2])


def won(vehicle: str) -> float:
    """Of what the oracle gains on the nominal R, how much the adaptive one gains [%]."""
    nominal, adaptive = (
        ratio(vehicle, PLAIN, row, "R oracle") for row in ("R nominal", LEARNED[1])
    )
    return 100.0 * (nominal - adaptive) / (nominal - 1.0)


#: Parts of the conclusion, N for each number, and what the numbers are.
CONCLUDED: dict[str, Callable[[], Sequence[float]]] = {
    "`R adaptive` has N of the oracle's error at 5 Hz and N at 1 Hz": lambda: both(
        PLAIN, "R adaptive", "R oracle"
    ),
    "where `R nominal` has N and N.": lambda: both(PLAIN, "R nominal", "R oracle"),
    "`R learned` has N and N, and misses both": lambda: both(PLAIN, "R learned", "R oracle"),
    "The gate changes the error of these rows by N % at most": lambda: [of_the_gate()],
    "bottom: it has N and N m/s,": lambda: rmse(GATE),
    "in place of N and N m/s with the gate off": lambda: rmse(PLAIN),
    "the medians are N and N m/s, in place of N and N m/s.": medians,
    "With outliers `R adaptive` has N and N of its error without those pings,": lambda: both(
        OUTLIERS, "R adaptive", LEFT_OUT
    ),
    "and the oracle N and N.": lambda: both(OUTLIERS, "R oracle", LEFT_OUT),
    "The target of N is met at 1 Hz,": lambda: [1.05],
    "by the end of the interval, N.": lambda: [upper_end()],
    "without it the ratio is N.": lambda: [without_the_worst()],
    "the outliers cost more: N and N.": lambda: both(OUTLIERS, "R adaptive", PLAIN),
    "hundredth of Q at 5 Hz it has N of the error of `R nominal`, and N with the factor": lambda: [
        ratio(TACTICAL, SMALL_Q, row, "R nominal") for row in LEARNED[1:]
    ],
    "There `R learned` has N, and misses it": lambda: [
        ratio(TACTICAL, SMALL_Q, "R learned", "R nominal")
    ],
}

#: The same of the explanations.
_FACTORS = (PLAIN, SMALL_Q, LARGE_Q)
_RECEIVING = (PLAIN, OUTLIERS, LEFT_OUT)
EXPLAINED: dict[str, dict[str, Callable[[], Sequence[float]]]] = {
    "measurement-noise": {
        "wins N % of what there is to win at 5 Hz, and N % at 1 Hz": lambda: [
            won(vehicle) for vehicle in VEHICLES
        ],
        "bad bottom: the RMSE is N and N m/s, in place of N and N m/s": lambda: [
            *rmse(GATE),
            *rmse(PLAIN),
        ],
        "With the estimate it is that without a gate, to N %": lambda: [of_the_gate()],
        "cost the adaptive estimate N and N % over the same": lambda: cost("R adaptive"),
        "and the oracle N and N %.": lambda: cost("R oracle"),
        "in the median mission N and N %,": lambda: median_costs(),
        "by the end of the interval, N %.": lambda: [100.0 * (upper_end() - 1.0)],
        "the estimate has N and N, without those pings N and N.": lambda: [
            *both(OUTLIERS, "R adaptive", "R oracle"),
            *both(LEFT_OUT, "R adaptive", "R oracle"),
        ],
        "`adaptive` has N, `learned` N, which misses": lambda: [
            ratio(TACTICAL, SMALL_Q, row, "R nominal") for row in ("R adaptive", "R learned")
        ],
        "Even the true R has N,": lambda: [ratio(TACTICAL, SMALL_Q, "R oracle", "R nominal")],
        "Q is mended as well, and it is N.": lambda: [
            ratio(TACTICAL, SMALL_Q, "R adaptive with factor", "R nominal")
        ],
        "With a hundred times Q it is N without the factor and N with it,": lambda: [
            ratio(TACTICAL, LARGE_Q, row, "R nominal") for row in LEARNED[1:]
        ],
        "at 1 Hz at most N (": lambda: [
            max(
                ratio(FOG, condition, row, "R nominal")
                for condition in (SMALL_Q, LARGE_Q)
                for row in LEARNED[1:]
            )
        ],
        "it is as good, to N %;": lambda: [
            max(map(abs, more("R adaptive received", "R adaptive", _RECEIVING)))
        ],
        "alone it is N to N % worse": lambda: [
            end(more("R learned received", "R learned", _RECEIVING)) for end in (min, max)
        ],
    },
    "process-noise-factor": {
        "the factor costs at most N % here": lambda: [
            max(more("R adaptive with factor", "R adaptive", _FACTORS))
        ],
        "it wins N % at 5 Hz and N % at 1 Hz": lambda: [
            -x for x in more("R adaptive with factor", "R adaptive", [LARGE_Q])
        ],
        "which is wrong here, it costs up to N %.": lambda: [
            max(more("R nominal with factor", "R nominal", _FACTORS))
        ],
    },
}


def section(page: str, title: str) -> str:
    """The text of an explanation behind a title, up to the next one."""
    text = (DOCS / "explanation" / f"{page}.md").read_text()
    return re.split(r"^## ", text.partition(f"{title}\n")[2], flags=re.MULTILINE)[0]


@pytest.mark.parametrize("claim", CONCLUDED)
def test_the_conclusion_has_the_numbers_of_the_study(claim: str) -> None:
    check(claim, CONCLUSION, CONCLUDED[claim]())


def test_no_number_of_the_conclusion_is_without_a_claim() -> None:
    """The rates, which name the vehicles, are none."""

    def nameless(words: str) -> str:
        return re.sub(r"\b[15] Hz", "Hz", one_line(words))

    assert not unclaimed(nameless(CONCLUSION), map(nameless, CONCLUDED))


@pytest.mark.parametrize(
    ("page", "claim"), [(page, claim) for page, claims in EXPLAINED.items() for claim in claims]
)
def test_an_explanation_has_the_numbers_of_the_study(page: str, claim: str) -> None:
    title = {"measurement-noise": "## 9. Measured", "process-noise-factor": "## 6. Measured"}[page]
    check(claim, section(page, title), EXPLAINED[page][claim]())


def lines_of(text: str) -> list[list[str]]:
    """The cells of the lines of all tables."""
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def test_the_table_of_measurement_noise_has_the_numbers_of_the_study() -> None:
    lines = lines_of(section("measurement-noise", "## 9. Measured").partition("**Gate.**")[0])
    assert [cells[0].strip("`") for cells in lines[1:]] == [
        *("R nominal", "R learned", "R learned received", "R adaptive", "R adaptive received"),
        *("R adaptive with factor", "R oracle"),
    ]
    for row, *cells in lines[1:]:
        expected = []
        for vehicle in VEHICLES:
            found = numbers(vehicle, PLAIN, row.strip("`"))
            middle, low, high = found["ratio_to"]["R oracle"]
            ends = f"{middle:.3f} [{low:.3f}, {high:.3f}]"
            expected += ["1" if "oracle" in row else ends, f"{found['nees_velocity']:.2f}"]
        assert cells == expected, row


def test_the_table_of_a_wrong_q_has_the_numbers_of_the_study() -> None:
    text = section("process-noise-factor", "## 6. Measured")
    text = text.partition("**A wrong Q.**")[2].partition("**A real vehicle.**")[0]
    rows = ("R nominal", "R nominal with factor", *LEARNED[1:], "R oracle")
    expected = [
        [f"{numbers(vehicle, condition, row)['body_rmse']:.4f}" for row in rows]
        for vehicle, condition in product(VEHICLES, (SMALL_Q, PLAIN, LARGE_Q))
    ]
    assert [cells[2:] for cells in lines_of(text)[1:]] == expected


def missed(row: str) -> list[str]:
    """The targets of a row that it misses, without their limits."""
    found = []
    for target in OF_DVL_NOISE:
        judged, words = target.measured({"dvl-noise": committed()}), f": `{row}` over "
        assert judged is not None
        if words in target.text and not judged[1]:
            found.append(target.text.replace(words, ": over ").partition(", at most")[0])
    return sorted(found)


def test_the_words_of_the_conclusion_hold() -> None:
    """Which targets are missed, without a number."""
    lost = [f"`{TACTICAL}`, {OUTLIERS}: over itself with {LEFT_OUT}"]
    small_q = [f"`{TACTICAL}`, {SMALL_Q}: over `R nominal`"]
    assert missed("R adaptive") == missed("R adaptive with factor") == lost
    plain = [f"`{vehicle}`, {PLAIN}: over `R oracle`" for vehicle in VEHICLES]
    assert missed("R learned") == sorted([*lost, *small_q, *plain])


def test_other_missions_have_no_conclusion() -> None:
    found = committed()
    assert "**Conclusion.** Told the true Q" in pages({"dvl-noise": found})["dvl-noise"]
    for change in ({"seed": 2}, {"runs": 7}):
        assert "**Conclusion.**" not in pages({"dvl-noise": found | change})["dvl-noise"]
