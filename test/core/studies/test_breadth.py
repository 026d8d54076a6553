"""The study of other IMUs, rates and outages: what is planned, its page and its targets."""

from copy import deepcopy
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.jobs.store import Store
from insdvl.studies.evaluation import comparison
from insdvl.studies.results.breadth import study as breadth
from insdvl.studies.results.breadth.tables import ratio
from insdvl.studies.results.page import pages


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Lines of two IMUs and of a better DVL: short missions, and a search among two constants."""
    search, folder = comparison.constants, tmp_path_factory.mktemp("store")
    short = [
        replace(
            plan, duration=155.0, rows=("best constant", "bands", "bands with factor", "oracle")
        )
        for plan in breadth.plans()
        if plan.scenario == "coloured"
        and plan.setting.sensors.imu_grade in ("fog", "mems")
        and plan.setting.sensors.dvl_rate != 5.0
        and (plan.setting.sensors.dvl_std == 0.1 or plan.setting.sensors.imu_grade == "mems")
    ]
    planned = breadth.with_runs(short, runs=2, tuning_runs=2, seed=4)
    with pytest.MonkeyPatch.context() as patch, open_pool(Workers(jobs=1)) as pool:
        patch.setattr(comparison, "constants", lambda *given: search(*given)[:2])
        store = Store(folder, {}, Path(breadth.__file__))
        return breadth.study_breadth(planned, pool, store) | {"environment": {}}


def page_of(document: dict) -> str:
    return pages({"breadth": document})["breadth"]


def comparison_of(document: dict, grade: str, rate: float, outage: float, std: float = 0.1) -> dict:
    names = ("imu_grade", "dvl_rate", "outage", "dvl_std")
    (found,) = [
        one
        for one in document["comparisons"]
        if tuple(one[name] for name in names) == (grade, rate, outage, std)
    ]
    return found


def row_of(found: dict, approach: str = "bands") -> dict:
    return next(row for row in found["rows"] if row["approach"] == approach)


def test_each_grade_meets_each_rate_and_outages() -> None:
    planned = breadth.plans()
    grades = {"fog", "tactical", "mems"}
    vehicles = [(plan.scenario, plan.setting.sensors) for plan in planned]
    found = {(name, one.imu_grade, one.dvl_rate, one.dvl_std, one.outage) for name, one in vehicles}
    assert found == {
        *product(breadth.SCENARIOS, grades, (5.0, 1.0, 0.2), (0.1,), (0.0,)),
        *product(breadth.SCENARIOS, grades, (1.0,), (0.02,), (0.0,)),
        *product(breadth.SCENARIOS, grades, (1.0,), (0.1,), (60.0,)),
        *product(("realistic",), grades, (1.0,), (0.1,), (30.0, 120.0)),
    }
    # The store keeps the runs by the label, and the searches by the vehicle.
    assert len({plan.label for plan in planned}) == len(planned) == len(found)
    assert len({plan.vehicle for plan in planned}) == 48
    for name in (
        "bands with factor and R adaptive",
        "bands with factor and R adaptive and DVL error",
    ):
        assert {plan.scenario for plan in planned if name in plan.rows} == {"realistic"}


def test_the_constant_is_searched_without_outages(document: dict) -> None:
    for grade in ("fog", "mems"):
        constants = [comparison_of(document, grade, 1.0, x)["best_constant"] for x in (0.0, 60.0)]
        assert constants[0] == constants[1]
        own = [
            row_of(comparison_of(document, grade, 1.0, outage))["body_rmse"]
            for outage in (0.0, 60.0)
        ]
        assert own[0] < own[1]


def line_of(text: str, *words: str) -> str:
    (line,) = [x for x in text.splitlines() if all(word in x for word in words)]
    return line


def test_the_page_has_the_numbers_of_the_document(document: dict) -> None:
    text = page_of(document)
    oracle = row_of(comparison_of(document, "fog", 1.0, 60.0), "oracle")
    lines = [x for x in text.splitlines() if x.startswith("| `coloured`, fog, 60 s |")]
    assert f"| {oracle['outage_drift']:.3f} |" in lines[0]
    assert f"| {oracle['outage_velocity']:.3f} |" in lines[1]
    nees = oracle["nees_per_dof"]
    blocks = [f"{nees[f'outage_{name}']:.2f}" for name in ("velocity", "position", "depth")]
    assert ", ".join(blocks) in lines[3]
    slow = comparison_of(document, "mems", 0.2, 0.0)
    lines = [x for x in text.splitlines() if x.startswith("| `coloured`, mems, 0.2 Hz |")]
    ratios = [
        ratio(slow, name, "best constant", "body_rmse") for name in ("bands", "bands with factor")
    ]
    cells = [f"{middle:.3f} [{low:.3f}, {high:.3f}]" for middle, low, high in ratios]
    assert lines[0].endswith(f"| {' | '.join(cells)} |")
    assert "Runs of each line: 2; seed 4." in text


def test_a_target_is_met_when_every_line_meets_it(document: dict) -> None:
    changed = deepcopy(document)
    for one in changed["comparisons"]:
        for name in ("bands", "oracle"):
            row = row_of(one, name)
            row["ratio_to"]["best constant"]["body_rmse"] = [0.97, 0.96, 0.99]
            row["nees_per_dof"]["velocity"] = 1.0
    row_of(comparison_of(changed, "fog", 0.2, 0.0), "oracle")["nees_per_dof"]["velocity"] = 1.16
    slow = row_of(comparison_of(changed, "mems", 0.2, 0.0))
    slow["ratio_to"]["best constant"]["body_rmse"] = [0.98, 0.97, 1.0]
    words = "`coloured`: body velocity, `bands` / best constant"
    assert line_of(page_of(changed), words).endswith(
        "| 5 of 5; worst 0.980 [0.970, 1.000] (mems, 0.2 Hz); oracle 5 of 5 | yes |"
    )
    slow["ratio_to"]["best constant"]["body_rmse"][2] = 1.001
    row_of(comparison_of(changed, "fog", 1.0, 0.0))["nees_per_dof"]["velocity"] = 0.84
    text = page_of(changed)
    assert line_of(text, words).endswith(
        "| 4 of 5; worst 0.980 [0.970, 1.001] (mems, 0.2 Hz); oracle 5 of 5 | **no** |"
    )
    line = line_of(text, "`coloured`: NEES of the velocity, `bands`,")
    assert line.endswith("| 4 of 5; worst 0.84 (fog, 1 Hz); oracle 4 of 5 | **no** |")


def test_a_row_that_has_failed_meets_no_target(document: dict) -> None:
    changed = deepcopy(document)
    row_of(comparison_of(changed, "mems", 1.0, 60.0))["ratio_to"] = {}
    line = line_of(page_of(changed), "`coloured`: drift after 60 s, `bands` /")
    assert line.endswith("; worst failed (mems, 60 s) | **no** |")


def test_an_outage_of_another_length_is_not_judged(document: dict) -> None:
    changed = deepcopy(document)
    for grade in ("fog", "mems"):
        comparison_of(changed, grade, 1.0, 60.0)["outage"] = 120.0
    line = line_of(page_of(changed), "`coloured`: drift after 60 s, `bands` /")
    assert line.endswith("| not computed |  |")
