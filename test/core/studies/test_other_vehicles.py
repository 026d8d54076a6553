"""The study of vehicles that are not those of the training: its numbers, its page, its targets."""

import json
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from claims import check, unclaimed

from insdvl.cli import main
from insdvl.files import read_json
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.simulation.vehicles import VEHICLES
from insdvl.studies.evaluation.monte_carlo import assess
from insdvl.studies.results.others import flights, study
from insdvl.studies.results.others.tables import row_of
from insdvl.studies.results.others.text import CONCLUSION
from insdvl.studies.results.page import pages

DOCS = Path(__file__).parents[3] / "docs"
NAMES = ("AUV, medium noise", "car, coloured noise")
SMALL = {name: replace(VEHICLES[name], duration=20.0) for name in NAMES}
RUNS, SEED = 2, 4


def computed(jobs: int, names: tuple[str, ...] = NAMES) -> dict[str, Any]:
    with open_pool(Workers(jobs=jobs)) as pool:
        return study.study_others(RUNS, SEED, pool, vehicles={name: SMALL[name] for name in names})


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return computed(1) | {"environment": {}}


def page_of(document: dict[str, Any]) -> str:
    return pages({"other-vehicles": document})["other-vehicles"]


def line_of(text: str, *words: str) -> str:
    (line,) = [x for x in text.splitlines() if all(word in x for word in words)]
    return line


@pytest.mark.long
def test_the_numbers_depend_on_neither_the_workers_nor_the_other_vehicles(
    document: dict[str, Any],
) -> None:
    assert computed(2, NAMES[::-1])["vehicles"] == document["vehicles"][::-1]


def error_of(name: str, constant: tuple[float, float]) -> float:
    """Mean over the missions of the RMSE of the body velocity."""
    found = []
    for number in range(RUNS):
        flight = flights.flight_of(name, SMALL[name], SEED, number)
        fold = flights.by_constant(SMALL[name], flight, constant)
        found.append(assess(fold, flight)[0][0])
    return float(np.mean(found))


@pytest.mark.parametrize("name", NAMES)
def test_no_neighbour_of_the_best_constant_is_better(document: dict[str, Any], name: str) -> None:
    """On the missions that are reported."""
    found = document["vehicles"][NAMES.index(name)]
    f, w = found["best_constant"]
    best, step = error_of(name, (f, w)), 10.0**0.25
    assert best == row_of(found, "best constant")["body_rmse"]
    for near in ((step, 1.0), (1.0 / step, 1.0), (1.0, step), (1.0, 1.0 / step)):
        assert error_of(name, (f * near[0], w * near[1])) > 0.9998 * best


def test_the_oracle_of_constant_noise_is_the_filter_with_that_constant() -> None:
    name = NAMES[0]
    vehicle = SMALL[name]
    flight = flights.flight_of(name, vehicle, SEED, 0)
    told = flights.told_by("oracle", flight)
    oracle = flights.by_row(vehicle, flight, "oracle", told)
    constant = flights.by_constant(vehicle, flight, vehicle.noise)
    np.testing.assert_allclose(oracle.track["v_n"], constant.track["v_n"], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", VEHICLES)
def test_the_filter_knows_the_data_sheets(name: str) -> None:
    """It takes every ping, also of a fast car."""
    vehicle = replace(VEHICLES[name], duration=16.0)
    flight = flights.flight_of(name, vehicle, 1, 0)
    assert flight.mission.stamps_ns.size == 16.0 * vehicle.imu.rate
    fold = flights.by_row(vehicle, flight, "oracle", flights.told_by("oracle", flight))
    assert len(fold.updates) == 16.0 * vehicle.dvl.rate
    assert all(update.report.corrected for update in fold.updates)


def test_the_page_has_the_numbers_of_the_document(document: dict[str, Any]) -> None:
    text = page_of(document)
    assert f"{RUNS} missions of each vehicle, seed {SEED}." in text
    for found in document["vehicles"]:
        error, nees, nis, told, sensors = (
            line.split(" | ")
            for line in text.splitlines()
            if line.startswith(f"| {found['vehicle']} |")
        )
        rows = found["rows"]
        assert error[1] == f"{rows[0]['body_rmse']:.4f}"
        for cell, row in zip(error[2:], rows[1:], strict=True):
            middle, low, high = row["over_best_constant"]
            assert low <= middle <= high <= row["worst"]
            expected = f"{middle:.3f} [{low:.3f}, {high:.3f}]; {row['worst']:.3f}"
            assert cell.removesuffix(" |") == expected
        for cells, metric, scale in ((nees, "nees_velocity", 1.0), (nis, "nis", 3.0)):
            numbers = [cell.removesuffix(" |") for cell in cells[1:]]
            assert numbers == [f"{row[metric] / scale:.2f}" for row in rows]
        f, w = found["told_over_effective"]["bands"]
        assert f"{f:.2g} / {w:.2g}" in told
        assert sensors[1:3] == ["100", f"{found['dvl_rate']:g}"]


def test_a_target_names_the_vehicles_that_miss_it(document: dict[str, Any]) -> None:
    changed = deepcopy(document)
    auv, car_ = changed["vehicles"]
    words = "`bands with factor` / best constant"
    for found in (auv, car_):
        row_of(found, "bands with factor")["over_best_constant"] = [1.03, 1.0, 1.2]
    assert line_of(page_of(changed), words).endswith("| 2 of 2 | yes |")
    row_of(car_, "bands with factor")["over_best_constant"][0] = 1.0301
    line = line_of(page_of(changed), words)
    assert line.endswith("| 1 of 2; not `car, coloured noise` (1.030) | **no** |")


def test_a_row_that_has_failed_meets_no_target(document: dict[str, Any]) -> None:
    values = np.ones((len(flights.ROWS), RUNS, 30))
    values[flights.ROWS.index("bands"), 1] = np.nan
    values[:, :, study.METRICS.index("failed")] = 0.0
    values[flights.ROWS.index("bands"), 1, study.METRICS.index("failed")] = 1.0
    draws = study.statistics.resamples(np.arange(RUNS), np.random.default_rng(1))
    changed = deepcopy(document)
    changed["vehicles"][0]["rows"] = study._rows(values, draws)
    json.dumps(changed, allow_nan=False)
    text = page_of(changed)
    assert "| failed in 1 |" in text
    assert "; not `AUV, medium noise` (failed)" in line_of(text, "`bands` / best constant")


def test_the_command_computes_the_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, document: dict[str, Any]
) -> None:
    small = partial(study.study_others, vehicles=SMALL)
    monkeypatch.setattr(study, "study_others", small)
    options = ("--runs", str(RUNS), "--seed", str(SEED), "--jobs", "1", "--out", str(tmp_path))
    assert main(["results", "--parts", "other-vehicles", *options]) == 0
    found = json.loads((tmp_path / "results" / "other-vehicles.json").read_text())
    assert found["vehicles"] == document["vehicles"]
    text = (tmp_path / "results" / "other-vehicles.md").read_text()
    assert text == page_of(found)


# ---------------------------------------------------------------- the conclusion


def committed() -> dict[str, Any]:
    return read_json(DOCS / "results" / "other-vehicles.json", 2**22)


def kind(coloured: bool) -> list[dict[str, Any]]:
    return [one for one in committed()["vehicles"] if ("coloured" in one["vehicle"]) == coloured]


def ratios(row: str, vehicles: list[dict[str, Any]]) -> list[float]:
    return [row_of(one, row)["over_best_constant"][0] for one in vehicles]


def span(values: list[float]) -> tuple[float, float]:
    return min(values), max(values)


def told_by_bands() -> list[float]:
    return [x for one in kind(coloured=False) for x in one["told_over_effective"]["bands"]]


def default_ratios() -> list[float]:
    return sorted(ratios("hcf default", committed()["vehicles"]))


#: Parts of the conclusion, N for each number, and what the numbers are.
CLAIMS: dict[str, Callable[[], Sequence[float]]] = {
    "On the ten vehicles with white noise `bands` has N to N of the error": lambda: span(
        ratios("bands", kind(coloured=False))
    ),
    "it tells N to N times the variance": lambda: span(told_by_bands()),
    "with the factor on Q it has N to N.": lambda: span(
        ratios("bands with factor", kind(coloured=False))
    ),
    "On the two with coloured noise it has N and N without the factor": lambda: ratios(
        "bands", kind(coloured=True)
    ),
    ", and N and N with it, so it misses the target on one vehicle": lambda: ratios(
        "bands with factor", kind(coloured=True)
    ),
    "at the level of the truth `bands` has N.": lambda: ratios(
        "bands with true factor", kind(coloured=True)[:1]
    ),
    "two vehicles miss the target, with N and N.": lambda: [
        x for x in ratios("bands with factor and R adaptive", committed()["vehicles"]) if x > 1.03
    ],
    "`least band` is better where the noise is white, at most N,": lambda: [
        max(ratios("least band", kind(coloured=False)))
    ],
    "where it is coloured it has N and N,": lambda: ratios("least band", kind(coloured=True)),
    "and a NEES of N and N.": lambda: [
        row_of(one, "least band")["nees_velocity"] for one in kind(coloured=True)
    ],
    "`default` has at most N on eight vehicles": lambda: default_ratios()[7:8],
    "and N to N behind the low-pass, with the engine and in coloured noise": lambda: span(
        default_ratios()[8:]
    ),
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_the_conclusion_has_the_numbers_of_the_study(claim: str) -> None:
    check(claim, CONCLUSION, CLAIMS[claim]())


def test_no_number_of_the_conclusion_is_without_a_claim() -> None:
    assert not unclaimed(CONCLUSION, CLAIMS)


def test_the_words_of_the_conclusion_hold() -> None:
    assert (len(kind(coloured=False)), len(kind(coloured=True))) == (10, 2)
    text = page_of(committed())
    assert "| 11 of 12; not `vessel, coloured noise` (" in line_of(text, "`bands with factor` / ")
    assert line_of(text, "`bands with factor and R adaptive` / ").startswith("| body velocity")
    assert "| 10 of 12; not " in line_of(text, "`bands with factor and R adaptive` / ")
    assert kind(coloured=True)[0]["vehicle"] == "vessel, coloured noise"
    worse = [one for one in committed()["vehicles"] if ratios("hcf default", [one])[0] > 1.05]
    assert {one["vehicle"] for one in worse} == {
        "AUV, MEMS of 62.5 Hz with low-pass",
        "car, engine",
        *(one["vehicle"] for one in kind(coloured=True)),
    }
    white = kind(coloured=False)
    both = zip(ratios("least band", white), ratios("bands with factor", white), strict=True)
    assert all(least < factor for least, factor in both)


def test_other_missions_have_no_conclusion() -> None:
    found = committed()
    assert "**Conclusion.** On the ten vehicles" in page_of(found)
    for change in ({"seed": 2}, {"runs": 7}):
        assert "**Conclusion.**" not in page_of(found | change)
