"""`insdvl evaluate`: its numbers, identical on any number of workers, and what it refuses."""

import json
import shutil
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl.cli import main
from insdvl.studies.evaluation import approaches, comparison
from insdvl.studies.evaluation.comparison import MOST_FAILURES, summary
from insdvl.studies.evaluation.monte_carlo import METRICS, evaluate_run, tuning_run
from insdvl.studies.evaluation.sensors import Sensors

ROWS = "constant 0.01/0.001,adaptive xi=5 floored,closed form,oracle,zero velocity,perfect heading"
FAILED = METRICS.index("failed")
EXTRA = {"tables.md", "errors.png", "mine.npz", "mine.json"}
MODELS = Path(str(files("insdvl") / "models"))


def evaluate(folder: Path, *options: str) -> tuple[int, dict]:
    file = folder / "numbers.json"
    short = ("--runs", "3", "--duration", "30", "--jobs", "1", "--json", str(file))
    code = main(["evaluate", *short, *options])
    left = {entry.name for entry in folder.iterdir()} - EXTRA
    assert left == ({file.name} if code == 0 else set()), "something was left behind"
    return code, json.loads(file.read_text()) if code == 0 else {}


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict:
    code, document = evaluate(tmp_path_factory.mktemp("one"), "--rows", ROWS)
    assert code == 0
    return document


def test_the_document_has_what_is_promised(document: dict) -> None:
    rows = {row["approach"]: row for row in document["rows"]}
    assert list(rows) == ROWS.split(",")
    oracle = rows["oracle"]
    assert oracle["ratio_to"]["oracle"]["body_rmse"] == [1.0, 1.0, 1.0]
    assert set(oracle["nees_per_dof"]) == {
        "velocity",
        "attitude",
        "velocity_attitude",
        "bias",
        "position",
    }
    assert oracle["failures"] == 0 and document["paired_runs"] == 3
    assert oracle["interval"]["srmse"][0] <= oracle["srmse"] <= oracle["interval"]["srmse"][1]
    assert np.mean(document["per_run"]["srmse"]["oracle"]) == pytest.approx(
        oracle["srmse"], rel=1e-5
    )
    # The vehicle moves at about 1 m/s, so that an estimate of zero is wrong by that.
    assert rows["zero velocity"]["body_rmse"] == pytest.approx(1.0, abs=0.1)
    assert rows["zero velocity"]["nis"] is None
    assert rows["perfect heading"]["body_rmse"] == pytest.approx(oracle["body_rmse"], rel=1e-12)
    assert rows["perfect heading"]["srmse"] < oracle["srmse"]


@pytest.mark.long
def test_two_workers_give_the_same(document: dict, tmp_path: Path) -> None:
    """On Dask; that tasks have the same bits on every backend is a promise of the pool."""
    _, again = evaluate(tmp_path, "--rows", ROWS, "--jobs", "2", "--backend", "dask")
    assert again == document


def test_an_interrupted_evaluation_goes_on_where_it_was(
    document: dict,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    done: list[int] = []

    def interrupted(shared: Any, number: int) -> dict:
        if number == 2 and len(done) == 2:
            raise OSError("the power went off")
        done.append(number)
        return evaluate_run(shared, number)

    # In this process, as a worker of its own would not see the patch.
    monkeypatch.setattr(comparison, "evaluate_run", interrupted)
    file = tmp_path / "numbers.json"
    command = ("evaluate", "--rows", ROWS, "--runs", "3", "--duration", "30", "--jobs", "1")
    assert main([*command, "--json", str(file)]) == 1
    assert "task 2 failed: OSError: the power went off" in capsys.readouterr().err
    assert not file.exists()
    done.append(-1)
    assert main([*command, "--json", str(file)]) == 0
    assert done == [0, 1, -1, 2]
    assert json.loads(file.read_text()) == document
    assert [entry.name for entry in tmp_path.iterdir()] == [file.name]


def test_tables_and_picture(tmp_path: Path) -> None:
    tables, picture = tmp_path / "tables.md", tmp_path / "errors.png"
    code, document = evaluate(
        tmp_path, "--rows", "oracle", "--markdown", str(tables), "--plot", str(picture)
    )
    assert code == 0 and picture.read_bytes().startswith(b"\x89PNG")
    assert f"| oracle | {document['rows'][0]['body_rmse']:.4f} [" in tables.read_text()


def test_a_model_of_your_own_is_one_row_more(tmp_path: Path) -> None:
    for suffix in ("npz", "json"):
        shutil.copy(MODELS / f"default.{suffix}", tmp_path / f"mine.{suffix}")
    mine = str(tmp_path / "mine.npz")
    code, document = evaluate(tmp_path, "--rows", "hcf default", "--model", mine)
    assert code == 0
    shipped, own = document["rows"]
    assert own["approach"] == f"model {mine}" and own["srmse"] == shipped["srmse"]


def test_a_model_of_another_schema_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    shutil.copy(MODELS / "default.npz", tmp_path / "mine.npz")
    card = json.loads((MODELS / "default.json").read_text())
    (tmp_path / "mine.json").write_text(json.dumps(card | {"feature_schema": "paper"}))
    assert evaluate(tmp_path, "--model", str(tmp_path / "mine.npz"))[0] == 2
    error = capsys.readouterr().err
    assert error.startswith("insdvl evaluate: the model") and error.count("\n") == 1


def test_a_row_without_its_library_is_left_out_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)  # as if it were not installed
    approaches.model.cache_clear()
    code, document = evaluate(tmp_path, "--rows", "dnn,oracle")
    approaches.model.cache_clear()
    assert code == 0
    assert [row["approach"] for row in document["rows"]] == ["oracle"]
    assert "onnxruntime" in document["omitted"]["dnn"]
    assert "Left out: dnn (" in capsys.readouterr().out


def test_grades_and_outages_reach_the_missions(tmp_path: Path) -> None:
    """The other IMU is another filter, told of it; drifts are there with outages only."""
    rows = ("--scenario", "coloured", "--rows", "constant 0.01/0.001,oracle", "--duration", "130")
    _, own = evaluate(tmp_path, *rows)
    _, fog = evaluate(tmp_path, *rows, "--imu-grade", "fog", "--outage", "30")
    assert fog["plan"]["setting"]["imu_grade"] == "fog"
    of_own, of_fog = (document["rows"][1] for document in (own, fog))
    assert "outage_drift" not in of_own
    assert of_fog["outage_drift"] > 0.0
    assert of_fog["nees_per_dof"]["outage_position"] > 0.0
    low, middle, high = np.sort(fog["rows"][0]["ratio_to"]["oracle"]["outage_drift"])
    assert 0.0 < low <= middle <= high
    assert of_fog["depth_rmse"] > 0.0
    assert of_own["body_rmse"] != of_fog["body_rmse"]


def test_searched_rows_name_what_was_found(tmp_path: Path) -> None:
    rows = "adaptive variational,best constant,oracle"
    options = ("--rows", rows, "--tuning-runs", "2", "--runs", "2", "--duration", "10")
    code, document = evaluate(tmp_path, *options)
    assert code == 0
    found = document["searches"]["best constant"]
    errors = {name: values[0] for name, values in found["candidates"].items()}
    assert min(errors, key=errors.__getitem__) == found["best"]
    assert "tau=" in document["searches"]["adaptive variational"]["best"]


@pytest.mark.parametrize(
    "options, sentence",
    [
        (("--rows", "oracle,hcf"), "--rows: unknown name 'hcf'; known are constant 0.01/0.001, "),
        (("--preset", "mine"), "--preset: unknown name 'mine'; known are calibrated, paper"),
        (("--scenario", "calm"), "--scenario: unknown name 'calm'; known are constant, "),
        (("--error-state", "enu"), "--error-state: unknown name 'enu'; known are invariant, ned"),
        (("--runs", "1"), "--runs must be >= 2, got 1"),
        (("--tuning-runs", "0"), "--tuning-runs must be >= 2, got 0"),
        (("--duration", "5"), "--duration must be within 10 to 330 s, got 5"),
        (("--duration", "nan"), "--duration must be within 10 to 330 s, got nan"),
        (
            ("--imu-grade", "navy"),
            "--imu-grade: unknown name 'navy'; known are fog, tactical, mems",
        ),
        (
            ("--imu-grade", "fog"),
            "--imu-grade needs --scenario vibrating, coloured, waves or realistic, got varying",
        ),
        (("--outage", "-1"), "--outage must be within 0 to 240 s, got -1"),
        (
            ("--outage", "60", "--duration", "120"),
            "--duration must be at least 90 s and an outage of 60 s, got 120",
        ),
        (("--seed", "-1"), "--seed must be >= 0, got -1"),
        (("--jobs", "0"), "--jobs must be >= 1, got 0"),
    ],
)
def test_what_is_refused(
    options: tuple[str, ...], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert evaluate(tmp_path, *options)[0] == 2
    error = capsys.readouterr().err
    assert error.startswith(f"insdvl evaluate: {sentence}") and error.count("\n") == 1


def test_a_place_that_cannot_be_written_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert main(["evaluate", "--json", str(tmp_path / "no" / "numbers.json")]) == 2
    assert "is not a folder" in capsys.readouterr().err


def scores(failures: dict[str, list[int]], runs: int = 20) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(7)
    made = {}
    for row, failed in failures.items():
        values = rng.random((runs, len(METRICS)))
        values[:, FAILED] = 0.0
        values[failed] = np.nan
        values[failed, FAILED] = 1.0
        made[row] = values
    return made


def test_means_are_over_the_runs_in_which_no_row_failed() -> None:
    values = scores({"oracle": [], "hcf default": [3], "best constant": [3, 5]})
    numbers = summary(values, np.random.default_rng(8))
    assert numbers["paired_runs"] == 18
    whole = np.setdiff1d(np.arange(20), [3, 5])
    for row in numbers["rows"]:
        column = values[row["approach"]][:, METRICS.index("srmse")]
        assert row["srmse"] == pytest.approx(column[whole].mean())
    assert [row["failures"] for row in numbers["rows"]] == [0, 1, 2]


def test_a_row_that_fails_often_does_not_take_the_runs_from_the_others() -> None:
    often = list(range(int(MOST_FAILURES * 20) + 1))
    values = scores({"oracle": [], "xi": often})
    numbers = summary(values, np.random.default_rng(9))
    oracle, xi = numbers["rows"]
    assert numbers["paired_runs"] == 20 and oracle["srmse"] is not None
    assert xi["failures"] == len(often) and xi["srmse"] is None and xi["ratio_to"] == {}
    column = values["xi"][:, METRICS.index("srmse")]
    assert xi["median"]["srmse"] == np.sort(column)[9:11].mean()  # failures count as the worst


def test_without_a_run_in_which_no_row_failed_nothing_is_compared() -> None:
    """Each of ten rows fails once, in a run of its own."""
    values = scores({f"row {k}": [k] for k in range(10)}, runs=10)
    numbers = summary(values, np.random.default_rng(10))
    assert numbers["paired_runs"] == 0
    for k, row in enumerate(numbers["rows"]):
        assert row["failures"] == 1 and row["srmse"] is None and row["ratio_to"] == {}
        column = values[f"row {k}"][:, METRICS.index("srmse")]
        assert row["median"]["srmse"] == np.sort(column)[4:6].mean()


def test_a_ratio_is_that_of_a_row_to_its_reference() -> None:
    values = scores({"oracle": [], "xi": []})
    values["xi"][:, :FAILED] = 2.0 * values["oracle"][:, :FAILED]
    _, xi = summary(values, np.random.default_rng(11))["rows"]
    assert xi["ratio_to"]["oracle"]["body_rmse"] == pytest.approx([2.0, 2.0, 2.0])


def test_searches_have_no_outages_and_the_runs_have() -> None:
    """What is searched is the same for all lengths of outages."""
    asked = []

    class Asked:
        def compute(
            self, function: Any, tasks: dict[str, int], shared: Any, **_: Any
        ) -> list[dict]:
            study, candidates = shared
            asked.append((function, study.sensors.outage))
            size = len(candidates)
            one = {
                "errors": np.arange(2.0 * size).reshape(size, 2),
                "scores": np.tile(np.arange(len(METRICS)) != FAILED, (size, 1)).astype(float),
                "series": np.zeros((size, 1, 4)),
                "floors": np.zeros((2, len(METRICS))),
            }
            return [one] * len(tasks)

    setting = approaches.Setting("calibrated", sensors=Sensors(outage=30.0))
    plan = comparison.Plan(
        "varying", setting, runs=2, tuning_runs=2, rows=("best constant", "oracle")
    )
    comparison.compare(plan, Asked())
    assert {outage for function, outage in asked if function is tuning_run} == {0.0}
    assert [outage for function, outage in asked if function is evaluate_run] == [30.0]
