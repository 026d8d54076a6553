"""Errors of every block of the state against what the filter says of them; the page about it.

A mean over runs is held to the chi-square distribution with the degrees of freedom of all its runs:
that of errors which stay throughout a run. Seeds were chosen before the first run.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from insdvl.cli import main
from insdvl.navigation import coordinates
from insdvl.navigation.events import Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import DvlParameters
from insdvl.simulation.motion import Truth
from insdvl.studies.consistency import (
    gyrocompassing,
    heading,
    outage,
    position,
    sensitivity,
    table,
)
from insdvl.studies.consistency.command import documents
from insdvl.studies.consistency.errors import ALL, BLOCKS, Flown, band, errors, nees
from insdvl.studies.consistency.flights import flown, parameters
from insdvl.studies.consistency.mission import PATROL
from insdvl.studies.consistency.page import STUDIES, consistency_page
from insdvl.studies.consistency.study import seeds
from insdvl.studies.consistency.table import LEVELS, Cell, block_run, cells

RESULTS = Path(__file__).parents[3] / "docs" / "results"
SEED = 96_000
RUNS = 4
FALSE_ALARM = 1e-3  # of all limits of a test together
SHORT = (Cell("fog", 75.0, 1.0), Cell("tactical", 45.0, 1.0), Cell("mems", 0.0, 1.0))


def judge(flown_cells: Sequence[Cell], duration: float) -> None:
    """Every block of every cell, and every block of all cells together."""
    flights = [
        [
            block_run(replace(cell.case(), duration=duration), seed)
            for seed in seeds(SEED, RUNS, *cell.key).values()
        ]
        for cell in flown_cells
    ]
    of_runs = np.array([[run["nees"] for run in of_cell] for of_cell in flights])
    inside = np.array([[run["inside"] for run in of_cell] for of_cell in flights])
    runs = len(flown_cells) * RUNS
    chance = FALSE_ALARM / (len(ALL) * (len(flown_cells) + 1 + len(LEVELS)))
    wrong = []
    for i, block in enumerate(ALL):
        of_cells = of_runs[..., i].mean(axis=1).tolist()
        means = {cell.name: (mean, RUNS) for cell, mean in zip(flown_cells, of_cells, strict=True)}
        means["all cells"] = float(of_runs[..., i].mean()), runs
        for name, (mean, count) in means.items():
            low, high = band(block, count, 1.0 - chance)
            if not low <= mean <= high:
                wrong.append(f"{name}: {block} {mean:.2f}, not within {low:.2f} to {high:.2f}")
        for k, level in enumerate(LEVELS):
            covered, least = float(inside[..., i, k].mean()), binom.ppf(chance, runs, level) / runs
            if covered < least:
                wrong.append(f"{block}: {covered:.3f} inside {level}, less than {least:.3f}")
    print(np.round(of_runs.mean(axis=1), 2))
    assert wrong == []


@pytest.mark.long
def test_every_block_is_as_good_as_it_says() -> None:
    judge(SHORT, 600.0)


@pytest.mark.long
def test_every_cell_of_the_table_is_as_good_as_it_says() -> None:
    judge(cells(), PATROL.duration)


def test_a_filter_that_is_told_too_little_noise_is_found_out() -> None:
    """A quarter of the DVL's sigma: the velocity is outside of the limits above."""
    cell, of_runs = SHORT[0], []
    case = replace(cell.case(), duration=300.0)
    told = DvlParameters(noise_std=(case.dvl_std / 4.0,) * 3)
    for seed in seeds(SEED, RUNS, *cell.key).values():
        run = flown(case, seed, settings=replace(parameters(case), dvl=told))
        of_runs.append(np.mean(nees(run)["velocity"]))
    assert np.mean(of_runs) > band("velocity", RUNS, 1.0 - FALSE_ALARM / 100.0)[1]


@pytest.mark.parametrize("form", ["invariant", "ned"])
def test_errors_are_those_that_inject_adds(form: str) -> None:
    """Exact for large errors too: the truth is a state into which they were injected."""
    case = replace(SHORT[0].case(), error_state=form)
    filter_ = Filter(parameters(case))
    state = filter_.empty()
    C_n_b = Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix()
    initial = Initial(0, C_n_b, np.array([40.0, -50.0, 11.0]), np.array([1.8, 0.1, -0.2]), "body")
    filter_.initialise(state, initial, 0, np.zeros(3))
    x = np.random.default_rng(SEED).uniform(-0.5, 0.5, 15)
    true = state.copy()
    coordinates.inject(true[0], filter_.constants[0], x)
    nav, nothing = true["nav"], np.zeros((1, 3))
    truth = Truth(
        t=np.zeros(1),
        llh=nav["llh"],
        p_o=nothing,
        gamma=np.zeros(1),
        v_n=nav["v_n"],
        a_n=nothing,
        C_n_b=nav["C_n_b"],
        f_b=nothing,
        w_ib_b=nothing,
        w_nb_b=nothing,
    )
    run = Flown(filter_, state, truth, np.hstack([nav["b_f"], nav["b_w"]]))
    np.testing.assert_allclose(errors(run)[0], x, atol=1e-8)  # of metres: a place has 1e-9


def test_runs_belong_to_their_row_and_number() -> None:
    """More runs keep those that were there; another row, or another seed, has others."""
    first = seeds(1, 3, 5, 7)
    assert list(seeds(1, 5, 5, 7).values())[:3] == list(first.values())
    others = [seeds(1, 3, 5, 8), seeds(2, 3, 5, 7)]
    assert all(set(first.values()).isdisjoint(other.values()) for other in others)
    assert len({cell.key for cell in cells()}) == len(cells())


def test_the_band_narrows_with_the_runs() -> None:
    (low, high), (least, most) = band("heading", 100), band("heading", 4)
    assert least < low < 1.0 < high < most
    # Means of 100 squares of normal numbers have a sigma of sqrt(2 / 100).
    assert high - low == pytest.approx(2 * 2.97 * np.sqrt(0.02), rel=0.03)


# ------------------------------------------------------------------ the page


def test_the_page_in_docs_is_the_one_of_its_numbers() -> None:
    found = documents(RESULTS)
    assert set(found) == {study.name for study in STUDIES}
    assert (RESULTS / "consistency.md").read_text() == consistency_page(found)
    assert len(found["blocks"]["cells"]) == len(cells())
    assert len(found["position"]["rows"]) == len(position.ROWS)
    assert len(found["outage"]["rows"]) == len(outage.HEADINGS)
    rows = [row["row"] for row in found["gyrocompassing"]["rows"]]
    assert rows == list(gyrocompassing.rows())
    assert [row["row"] for row in found["heading"]["rows"]] == list(heading.rows())


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies of one cell, one pair of rows and missions of some seconds."""
    monkeypatch.setattr(table, "PATROL", replace(table.PATROL, duration=12.0))
    monkeypatch.setattr(table, "cells", lambda *, quick=False: [Cell("fog", 45.0, 1.0)])
    rows = [position.ROWS[0], position.ROWS[3]]
    short = [replace(row, case=replace(row.case, duration=12.0)) for row in rows]
    monkeypatch.setattr(position, "ROWS", tuple(short))
    monkeypatch.setattr(position, "FIRST", 5)
    monkeypatch.setattr(outage, "BEGIN", 4.0)
    monkeypatch.setattr(outage, "END", 6.0)
    monkeypatch.setattr(outage, "AFTER", 4.0)
    left = {name: replace(case, duration=62.0) for name, case in gyrocompassing.rows().items()}
    pair = dict([*left.items()][:3:2])  # the heading is found in one of them
    monkeypatch.setattr(gyrocompassing, "rows", lambda *, quick=False: pair)
    monkeypatch.setattr(heading, "PATROL", replace(heading.PATROL, duration=12.0))
    monkeypatch.setattr(heading, "FIRST", 5)
    grades = {"fog": table.GRADES["fog"]}
    monkeypatch.setattr(sensitivity, "GRADES", grades)
    monkeypatch.setattr(sensitivity, "DURATION", 3.0)


def consistency(folder: Path, *options: str) -> int:
    return main(["consistency", "--out", str(folder), "--jobs", "1", "--runs", "2", *options])


@pytest.mark.usefixtures("small")
def test_the_command_writes_page_and_numbers(tmp_path: Path) -> None:
    assert consistency(tmp_path / "a") == 0
    page, numbers = ((tmp_path / "a" / f"consistency.{e}").read_text() for e in ("md", "json"))
    studies = json.loads(numbers)["studies"]
    assert page == consistency_page(studies)
    (cell,) = studies["blocks"]["cells"]
    for block in BLOCKS:
        of_runs = cell["blocks"][block]["nees_of_runs"]
        assert cell["blocks"][block]["nees"][0] == pytest.approx(np.mean(of_runs), abs=1e-4)
        assert cell["blocks"][block]["worst_nees"] == pytest.approx(max(of_runs), abs=1e-4)
    first, second = studies["position"]["rows"]
    assert first["ratio"] == [1.0, 1.0, 1.0] and second["ratio"][0] > 0.0
    for row in studies["outage"]["rows"]:
        velocity = row["blocks"]["velocity"]
        assert len(velocity["nees_of_seconds"]) == 5
        assert velocity["nees"][0] == pytest.approx(np.mean(velocity["nees_of_seconds"]), abs=1e-4)
        assert velocity["largest"] == pytest.approx(max(velocity["nees_of_seconds"]), abs=1e-4)
    still, moved = studies["gyrocompassing"]["rows"]
    assert (still["found"], moved["found"]) == (2, 0)
    assert still["heading_sigma_deg"] < 0.2 < moved["heading_sigma_deg"]
    told, without = studies["heading"]["rows"]
    assert told["rms"]["sigma"][0] < 2.0 < 9.0 < without["rms"]["sigma"][0]
    assert studies["heading"]["reduced_sigma_deg"] == pytest.approx(1.3, rel=0.2)
    assert [path.name for path in (tmp_path / "a").iterdir() if path.is_dir()] == []

    # The same seed gives the same numbers; a single study keeps those of the others.
    assert consistency(tmp_path / "b", "--studies", "blocks") == 0
    text = (tmp_path / "b" / "consistency.md").read_text()
    others = [study.name for study in STUDIES if study.name != "blocks"]
    assert all(f"Not computed: {name}." in text for name in others)
    assert consistency(tmp_path / "b", "--studies", ",".join(others)) == 0
    assert (tmp_path / "b" / "consistency.json").read_text() == numbers
    assert consistency(tmp_path / "b", "--studies", "none") == 0
    assert (tmp_path / "b" / "consistency.md").read_text() == page


@pytest.mark.parametrize(
    "options, sentence",
    [
        (("--studies", "blocks,moon"), "--studies: unknown name 'moon'; known are blocks, "),
        (("--runs", "1"), "--runs must be >= 2, got 1"),
        (("--seed", "-3"), "--seed must be >= 0, got -3"),
    ],
)
def test_what_is_refused(
    options: tuple[str, ...], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert consistency(tmp_path / "out", *options) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"insdvl consistency: {sentence}") and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_targets_are_judged_by_the_numbers() -> None:
    def document(*means: float) -> dict:
        block = {"inside": [0.95, 0.997], "worst_run": 0, "worst_nees": 2.0, "nees_of_runs": []}
        fine = {name: block | {"nees": [1.0, 0.9, 1.1]} for name in ALL}
        flown_cells = [
            {"cell": f"c{k}", "blocks": fine | {"velocity": block | {"nees": [mean, mean, mean]}}}
            for k, mean in enumerate(means)
        ]
        head = {"runs": 4, "seed": 1, "duration": 60.0, "heading_std_deg": 1.0, "dvl_std": 0.02}
        return head | {"levels": list(LEVELS), "cells": flown_cells}

    def met(*means: float) -> bool:
        text = " ".join(consistency_page({"blocks": document(*means)}).split())
        assert ("Met: yes" in text) != ("Met: **no**" in text)
        return "Met: yes" in text

    assert met(1.0, 1.0, 1.0, 1.0) and met(1.3, 0.75, 1.0)
    assert not met(1.3, 0.75, 1.3) and not met(1.45) and not met(0.65)
