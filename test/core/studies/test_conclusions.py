"""The sentences of docs/results.md, held against the numbers.

They are written by hand. Each number in the answers of results.md belongs to a claim here.
"""

import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from claims import check, one_line, unclaimed

from insdvl.studies.results.command import documents
from insdvl.studies.results.targets import row

DOCS = Path(__file__).parents[3] / "docs"


@cache
def numbers() -> dict[str, Any]:
    return documents(DOCS / "results")


def ratio(scenario: str, approach: str, reference: str, metric: str = "body_rmse") -> float:
    found = row(numbers()[f"{scenario}-calibrated"], approach)
    assert found is not None
    return float(found["ratio_to"][reference][metric][0])


def spectrum(scenario: str, approach: str) -> float:
    found = row(numbers()[f"{scenario}-spectrum"], approach)
    assert found is not None
    return float(found["ratio_to"]["best constant"]["body_rmse"][0])


def closed_form_ratios() -> list[float]:
    return [
        spectrum(name, "closed form") for name in ("vibrating", "coloured", "waves", "realistic")
    ]


def gain(scenario: str, approach: str) -> float:
    return 100.0 * (1.0 - ratio(scenario, approach, "best constant"))


def calibration(scenario: str) -> float:
    first = ratio(scenario, "hcf default", "first constant")
    return 100.0 * (1.0 - first / ratio(scenario, "hcf default", "best constant"))


def injected(name: str, reference: str, approach: str = "hcf default") -> float:
    ratios = numbers()["vehicle"]["injections"][name]["ratio_to"][reference]
    return float(ratios[approach]["body_velocity_rmse"][0])


def as_recorded(metric: str) -> float:
    ratios = numbers()["vehicle"]["as_recorded"]["ratio_to"]["hand-set"]
    return float(ratios["hcf default"][metric][0])


def worst_vehicle(approach: str) -> float:
    """Largest mean ratio to the best constant of a vehicle."""
    vehicles = numbers()["other-vehicles"]["vehicles"]
    assert len(vehicles) == 12
    found = [row(vehicle, approach) for vehicle in vehicles]
    return max(float(one["over_best_constant"][0]) for one in found if one is not None)


def taught_prediction() -> float:
    """RMS of the error of all predictions after 30 s, over that of the hand-set constant."""
    squares = {
        name: sum(one["error 30 s"] ** 2 * one["count 30 s"] for one in rows.values())
        for name, rows in numbers()["withheld"]["rows"].items()
    }
    return float((squares["taught, no floor"] / squares["hand-set"]) ** 0.5)


def heading_lost_after() -> float:
    """Seconds until sqrt(eps t^3 / 3) is one radian, with eps = 0.001."""
    return (3.0 / 0.001) ** (1.0 / 3.0)


#: Sentences of the answers, N for each number, and what the numbers are.
ANSWERS = {
    "is N % below that of the best constant in `varying` and N % in `wide`": lambda: (
        gain("varying", "hcf default"),
        gain("wide", "hcf default"),
    ),
    "that is told the noise gains N % and N %": lambda: (
        gain("varying", "oracle"),
        gain("wide", "oracle"),
    ),
    "the learned error over its error is N in `varying` and N in `wide`": lambda: (
        ratio("varying", "hcf default", "closed form"),
        ratio("wide", "hcf default", "closed form"),
    ),
    "the body velocity error falls by N % in `varying`": lambda: (
        100.0 * (1.0 - ratio("varying", "hcf default", "first constant")),
    ),
    "Of that, N % is calibration": lambda: (calibration("varying"),),
    "from spectra has N of the error of the best constant where the vehicle vibrates, "
    "N where it meets waves, N in coloured noise and N with everything together": lambda: (
        spectrum("vibrating", "bands"),
        spectrum("waves", "bands"),
        spectrum("coloured", "bands"),
        spectrum("realistic", "bands"),
    ),
    "or N where the noise of the DVL is learned as well": lambda: (
        spectrum("realistic", "bands with R adaptive"),
    ),
    "On twelve other vehicles the model has up to N of it": lambda: (worst_vehicle("bands"),),
    "up to N with a factor on Q": lambda: (worst_vehicle("bands with factor"),),
    "and up to N if R is learned beside that": lambda: (
        worst_vehicle("bands with factor and R adaptive"),
    ),
    "worse than the best constant in all four, by N to N %": lambda: (
        100.0 * (min(closed_form_ratios()) - 1.0),
        100.0 * (max(closed_form_ratios()) - 1.0),
    ),
    "the body velocity error is N of that of a hand-set constant as they are": lambda: (
        as_recorded("body_velocity_rmse"),
    ),
    "and N of that of the best constant with noise injected": lambda: (
        injected("sensor", "best constant"),
    ),
    "without it with N of the error of the hand-set one": lambda: (taught_prediction(),),
    "drift by one radian in N s": lambda: (heading_lost_after(),),
}


def answers() -> str:
    text = (DOCS / "results.md").read_text()
    found = re.search(r"^1\. .*?(?=^!\[)", text, re.DOTALL | re.MULTILINE)
    assert found
    return one_line(re.sub(r"^\d\. ", "", found.group(), flags=re.MULTILINE))


@pytest.mark.parametrize("sentence", ANSWERS)
def test_an_answer_has_the_number_of_the_study(sentence: str) -> None:
    check(sentence, answers(), ANSWERS[sentence]())


def test_no_number_of_the_answers_is_without_a_claim() -> None:
    assert not unclaimed(answers(), ANSWERS)


def test_every_page_is_linked_and_there() -> None:
    text = (DOCS / "results.md").read_text()
    for page in re.findall(r"\]\(([^)#]+)\)", text):
        assert (DOCS / page).exists(), page
    pages = {f"results/{page.name}" for page in (DOCS / "results").glob("*.md")}
    assert pages <= set(re.findall(r"\]\(([^)#]+)\)", text))


def test_the_answer_fits_on_a_screen() -> None:
    """Up to the picture, in lines of 100 characters."""
    assert len((DOCS / "results.md").read_text().partition("![")[0].splitlines()) <= 25
