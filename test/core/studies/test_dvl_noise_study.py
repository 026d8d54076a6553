"""The study of the learned noise of the DVL: its pairs, its page, its targets."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl.cli import main
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.studies.evaluation import statistics
from insdvl.studies.evaluation.missions import TEST, Study, initial_of_run, mission_of_run
from insdvl.studies.results.dvl_noise import study
from insdvl.studies.results.dvl_noise.targets import LIMITS, Limit
from insdvl.studies.results.page import pages

RUNS, SEED = 2, 4
PAIRED = "bottom-fog", "gate off"
LEFT_OUT = "bottom-fog", "gate on, outliers left out"


def planned() -> dict[study.Key, Any]:
    """Short missions of one vehicle in three conditions."""
    rows = ("R nominal", "R adaptive", "R adaptive with factor", "R oracle")
    return {
        key: replace(plan, duration=20.0, rows=rows)
        for key, plan in study.plans(RUNS, SEED).items()
        if key in (PAIRED, LEFT_OUT, ("bottom-fog", "a hundred times Q"))
    }


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    with open_pool(Workers(jobs=1)) as pool:
        return study.study_dvl_noise(planned(), pool) | {"environment": {}}


def page_of(document: dict[str, Any]) -> str:
    return pages({"dvl-noise": document})["dvl-noise"]


def made(value: Callable[[str, str, str, str], list[float] | None]) -> dict[str, Any]:
    """A document with all comparisons, and a ratio for each scenario, condition, row, reference."""
    references = (*study.REFERENCES, *study.OWN_REFERENCES)
    return {
        "runs": RUNS,
        "seed": SEED,
        "environment": {},
        "comparisons": [
            {
                "scenario": scenario,
                "condition": condition,
                "paired_runs": RUNS,
                "rows": [
                    {
                        "approach": row,
                        "failures": 0,
                        "body_rmse": 0.02,
                        "nees_velocity": 1.0,
                        "ratio_to": {
                            one: value(scenario, condition, row, one) for one in references
                        },
                    }
                    for row in plan.rows
                ],
                "per_run": {},
            }
            for (scenario, condition), plan in study.plans(RUNS, SEED).items()
        ],
    }


# ---------------------------------------------------------------- the comparisons


def test_each_vehicle_meets_each_condition() -> None:
    found = study.plans(RUNS, SEED)
    assert {
        (
            *(plan.scenario, plan.setting.sensors.dvl_rate, plan.setting.gate),
            *(plan.setting.sensors.outliers, plan.setting.sensors.outliers_missing),
            plan.setting.q_factor,
        )
        for plan in found.values()
    } == {
        (*vehicle, *condition)
        for vehicle in (("bottom-tactical", 5.0), ("bottom-fog", 1.0))
        for condition in (
            *((False, 0.0, False, 1.0), (True, 0.0, False, 1.0)),
            *((True, 0.05, False, 1.0), (True, 0.05, True, 1.0)),
            *((False, 0.0, False, 0.01), (False, 0.0, False, 100.0)),
        )
    }
    assert {plan.setting.sensors.dvl_std for plan in found.values()} == {0.05}
    # The store keeps the runs by the label.
    assert len({plan.label for plan in found.values()}) == len(found) == 12


def test_the_conditions_of_a_vehicle_have_the_same_missions() -> None:
    """But for what is added to the outliers, or that these are missing."""
    for scenario in study.RATES:
        missions, starts = [], []
        for (name, _), plan in study.plans(RUNS, SEED).items():
            if name == scenario:
                of = Study(scenario, plan.seed, 60.0, plan.setting.sensors)
                missions.append(mission_of_run(of, TEST, 1))
                starts.append(initial_of_run(missions[-1], of, TEST, 1))
        first = missions[0]
        assert sum(m.dvl_outlier.any() for m in missions) == 1
        (spoilt,) = [m for m in missions if m.dvl_outlier.any()]
        (left_out,) = [m for m in missions if len(m.v_d) < len(first.v_d)]
        np.testing.assert_array_equal(
            left_out.dvl_stamps_ns, first.dvl_stamps_ns[~spoilt.dvl_outlier]
        )
        for m, start in zip(missions, starts, strict=True):
            np.testing.assert_array_equal(m.f_b, first.f_b)
            np.testing.assert_array_equal(m.w_ib_b, first.w_ib_b)
            same = np.isin(first.dvl_stamps_ns, m.dvl_stamps_ns)
            for had, has in ((first.v_d, m.v_d), (first.r, m.r)):
                np.testing.assert_array_equal(has[~m.dvl_outlier], had[same][~m.dvl_outlier])
            off = np.linalg.norm((m.v_d - first.v_d[same])[m.dvl_outlier], axis=1)
            np.testing.assert_allclose(off, 1.0)
            np.testing.assert_array_equal(start.v, starts[0].v)
            np.testing.assert_array_equal(start.C_o_b, starts[0].C_o_b)


# ---------------------------------------------------------------- the ratios


def compared(**errors: list[float | None]) -> dict[str, Any]:
    """What a comparison tells of rows with these errors."""
    numbers = {"failures": 0, "body_rmse": 1.0, "nees_per_dof": {"velocity": 1.0}}
    names = {name.replace("_", " "): values for name, values in errors.items()}
    return {
        "rows": [{"approach": name} | numbers for name in names],
        "per_run": {"body_rmse": names},
    }


def ratios_of(here: dict[str, Any], own: dict[str, dict[str, Any]]) -> dict[str, Any]:
    draws = statistics.resamples(np.arange(3), np.random.default_rng(1))
    rows = study._rows(here, own, draws)
    return {row["approach"]: row["ratio_to"] for row in rows}


def test_ratios_are_paired_by_mission_also_across_conditions() -> None:
    """A row that is 10 % worse in every mission is so in every resample."""
    here = compared(R_nominal=[2.2, 1.1, 11.0], R_oracle=[2.0, 1.0, 10.0])
    plain = compared(R_nominal=[1.1, 0.55, 5.5], R_oracle=[2.0, 2.0, 2.0])
    left_out = compared(R_nominal=[0.55, 0.275, 2.75], R_oracle=[2.0, 2.0, 2.0])
    found = ratios_of(here, {"gate off": plain, "left out": left_out})
    np.testing.assert_allclose(found["R nominal"]["R oracle"], 1.1)
    np.testing.assert_allclose(found["R nominal"]["gate off"], 2.0)
    np.testing.assert_allclose(found["R nominal"]["left out"], 4.0)
    middle, low, high = found["R oracle"]["gate off"]
    assert middle == pytest.approx(13.0 / 6.0)
    assert low == pytest.approx(0.5) and high == pytest.approx(5.0)


def test_a_row_that_has_failed_has_no_ratio() -> None:
    here = compared(R_nominal=[2.2, None, 11.0], R_oracle=[2.0, 1.0, 10.0])
    plain = compared(R_nominal=[1.1, 0.55, 5.5], R_oracle=[2.0, 2.0, None])
    found = ratios_of(here, {"gate off": plain})
    assert found["R nominal"] == {"R oracle": None, "R nominal": None, "gate off": None}
    assert found["R oracle"]["R nominal"] is None
    assert found["R oracle"]["gate off"] is None
    assert found["R oracle"]["R oracle"] == [1.0, 1.0, 1.0]


def test_the_ratios_are_those_of_the_runs(document: dict[str, Any]) -> None:
    plain, left_out, large = document["comparisons"]
    for one in (plain, left_out, large):
        for row in one["rows"]:
            mean = np.mean(one["per_run"][row["approach"]])
            assert row["body_rmse"] == pytest.approx(mean, rel=1e-5)
            for reference in study.REFERENCES:
                expected = mean / np.mean(one["per_run"][reference])
                assert row["ratio_to"][reference][0] == pytest.approx(expected)
            for reference, of in (("gate off", plain), (LEFT_OUT[1], left_out)):
                own = mean / np.mean(of["per_run"][row["approach"]])
                assert row["ratio_to"][reference][0] == pytest.approx(own)


# ---------------------------------------------------------------- the page


def line_of(text: str, *words: str) -> list[str]:
    (line,) = [x for x in text.splitlines() if all(word in x for word in words)]
    return line.strip("| ").split(" | ")


def name_of(limit: Limit, row: str) -> str:
    own = limit.reference.startswith("gate")
    reference = f"itself with {limit.reference}" if own else f"`{limit.reference}`"
    where = f"`{limit.scenario}`, {limit.condition}"
    return f"{where}: `{row}` over {reference}, at most {limit.limit:.2f}"


@pytest.mark.parametrize("row", ["R learned", "R adaptive", "R adaptive with factor"])
def test_a_target_is_judged_by_its_own_ratio_at_the_upper_end(row: str) -> None:
    """All others miss theirs."""
    for limit in LIMITS:

        def judged(upper_end: float, limit: Limit = limit) -> tuple[list[str], int]:
            where = limit.scenario, limit.condition, row, limit.reference
            ratios = {where: [1.0, 0.9, upper_end]}
            text = page_of(made(lambda *key: ratios.get(key, [9.0, 9.0, 9.0])))
            return line_of(text, name_of(limit, row)), text.count("| **no** |")

        cells, misses = judged(limit.limit)
        assert cells[1].startswith(f"1.000 [0.900, {limit.limit:.3f}]")
        assert cells[2] == "yes" and misses == 3 * len(LIMITS) - 1
        cells, misses = judged(limit.limit + 0.001)
        assert cells[2] == "**no**" and misses == 3 * len(LIMITS)


def test_the_ratio_of_the_oracle_stands_beside() -> None:
    found = made(lambda *key: [3.0, 2.0, 4.0] if key[2] == "R oracle" else [1.0, 1.0, 1.0])
    for limit in LIMITS:
        (_, measured, met) = line_of(page_of(found), name_of(limit, "R adaptive"))
        assert met == "yes"
        assert ("(oracle 3.000 [2.000, 4.000])" in measured) == (limit.reference != "R oracle")


def test_the_targets_are_those_that_were_set() -> None:
    limits = {(one.scenario, one.condition, one.reference): one.limit for one in LIMITS}
    assert limits.pop(("bottom-tactical", "gate off", "R oracle")) == 1.03
    assert limits.pop(("bottom-fog", "gate off", "R oracle")) == 1.10
    for scenario in ("bottom-tactical", "bottom-fog"):
        assert limits.pop((scenario, "gate on", "gate off")) == 1.02
        assert limits.pop((scenario, "gate on, outliers", LEFT_OUT[1])) == 1.05
        for q in ("a hundredth of Q", "a hundred times Q"):
            assert limits.pop((scenario, q, "R nominal")) == 1.02
    assert limits == {}


def test_what_has_failed_meets_no_target() -> None:
    found = made(lambda *_: [1.0, 1.0, 1.0])
    assert "**no**" not in page_of(found)
    (plain,) = [
        one for one in found["comparisons"] if (one["scenario"], one["condition"]) == PAIRED
    ]
    plain["paired_runs"] = 1
    (row,) = [row for row in plain["rows"] if row["approach"] == "R adaptive"]
    row |= {"failures": 1, "ratio_to": dict.fromkeys(row["ratio_to"])}
    text = page_of(found)
    assert line_of(text, "`bottom-fog`, gate off: `R adaptive` over")[1:] == ["–", "**no**"]
    assert text.count("| **no** |") == 1
    assert "| 0.0200 (failed in 1) |" in text
    assert "`bottom-fog`, gate off: no row failed in 1 of 2 missions." in text


def test_the_page_has_the_numbers_of_the_document(document: dict[str, Any]) -> None:
    text = page_of(document)
    assert f"{RUNS} missions of each vehicle, seed {SEED}." in text
    plain, left_out, large = document["comparisons"]
    for a, c, b in zip(plain["rows"], left_out["rows"], large["rows"], strict=True):
        lines = [
            line.strip("| ").split(" | ")[1:]
            for line in text.splitlines()
            if line.startswith(f"| `{a['approach']}` |") and "–" not in line.split(" | ")[1]
        ]
        expected = [[f"{row['body_rmse']:.4f}" for row in (a, b)]]
        for reference in study.REFERENCES:
            if reference != a["approach"]:
                expected.append([ratio_text(row["ratio_to"][reference]) for row in (a, b)])
        expected.append([f"{row['nees_velocity']:.2f}" for row in (a, b)])
        assert [[cells[0], cells[-1]] for cells in lines] == expected
        own, other = (ratio_text(row["ratio_to"]["gate off"]) for row in (b, c))
        assert f"| `{a['approach']}` | – | – | {other} | – | {own} |" in text


def ratio_text(found: list[float]) -> str:
    middle, low, high = found
    assert low <= middle <= high
    return f"{middle:.3f} [{low:.3f}, {high:.3f}]"


def test_the_command_computes_the_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, document: dict[str, Any]
) -> None:
    asked = []

    small = planned()

    def plans(runs: int, seed: int) -> dict[study.Key, Any]:
        asked.append((runs, seed))
        return small

    monkeypatch.setattr(study, "plans", plans)
    options = ("--runs", str(RUNS), "--seed", str(SEED), "--jobs", "1", "--out", str(tmp_path))
    assert main(["results", "--parts", "dvl-noise", *options]) == 0
    assert asked == [(RUNS, SEED)]
    found = json.loads((tmp_path / "results" / "dvl-noise.json").read_text())
    assert found["comparisons"] == json.loads(json.dumps(document["comparisons"]))
    assert (tmp_path / "results" / "dvl-noise.md").read_text() == page_of(found)
