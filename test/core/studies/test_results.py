"""`insdvl results`: the pages say what their numbers say, and what it refuses."""

import json
import re
from pathlib import Path

import pytest

from insdvl.cli import main
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.simulation.noise import SCENARIOS
from insdvl.studies.evaluation.approaches import Setting
from insdvl.studies.evaluation.comparison import Plan, compare
from insdvl.studies.results.command import PARTS, documents
from insdvl.studies.results.page import PAGES, pages
from insdvl.studies.results.pictures.draw import draw
from insdvl.studies.results.pictures.forests import forests
from insdvl.studies.results.pictures.over_time import over_time
from insdvl.studies.results.targets import row

DOCS = Path(__file__).parents[3] / "docs"


def results(folder: Path, *options: str) -> int:
    return main(["results", "--out", str(folder), "--jobs", "1", *options])


def test_the_pages_in_docs_are_those_of_their_numbers() -> None:
    found = documents(DOCS / "results")
    assert set(found) == set(PARTS)
    for name, text in pages(found).items():
        assert (DOCS / "results" / f"{name}.md").read_text() == text, name


def test_the_page_of_targets_counts_those_of_the_studies() -> None:
    text = (DOCS / "results" / "targets.md").read_text()
    counted = re.findall(r"\| \[([a-z-]+)\]\(\1\.md#targets\) \| (\d+) \| (\d+) \|", text)
    assert {name for name, _, _ in counted} >= {"spectrum", "breadth", "other-vehicles"}
    for name, met, measured in counted:
        page = (DOCS / "results" / f"{name}.md").read_text()
        table = page.partition("## Targets\n")[2].partition("\n## ")[0]
        yes, no = table.count("| yes |"), table.count("| **no** |")
        assert (yes, yes + no) == (int(met), int(measured)), name
        assert yes + no > 0


def test_pictures_of_the_pages_are_there_and_no_others() -> None:
    shown = {"forest.png"}  # on the page of all results
    for name in PAGES:
        text = (DOCS / "results" / f"{name}.md").read_text()
        pictures = [part.partition(")")[0] for part in text.split("](")[1:] if ".png)" in part]
        assert all((DOCS / "results" / picture).is_file() for picture in pictures)
        assert pictures or name in ("targets", "variance", "error-state-and-gate", "window"), name
        shown |= set(pictures)
    assert {file.name for file in (DOCS / "results").glob("*.png")} == shown


def written(folder: Path) -> str:
    return "".join((folder / "results" / f"{name}.md").read_text() for name in PAGES)


def test_pages_without_numbers_say_so(tmp_path: Path) -> None:
    assert results(tmp_path, "--parts", "none") == 0
    text = written(tmp_path)
    for part in PARTS:
        assert f"Not computed: {part}." in text, part
    assert not list((tmp_path / "results").glob("*.png"))


def test_the_picture_has_the_ratios_of_the_tables() -> None:
    """A group for each comparison that has an oracle, whatever rows it has."""
    found = documents(DOCS / "results")
    drawn = forests(found)["forest"].groups
    learned = row(found["wide-calibrated"], "hcf default")
    assert learned is not None
    ratios = drawn["wide, simulated"]
    assert ratios["hcf default"] == tuple(learned["ratio_to"]["oracle"]["body_rmse"])
    assert all(low <= middle <= high for middle, low, high in ratios.values())
    bands = row(found["realistic-spectrum"], "bands")
    assert bands is not None
    of_oracle = tuple(bands["ratio_to"]["oracle"]["body_rmse"])
    assert drawn["realistic, simulated"]["bands"] == of_oracle
    assert not forests({})


NUMBER = r"\d+\.\d+"


def test_the_title_of_a_picture_has_its_numbers(tmp_path: Path) -> None:
    found = documents(DOCS / "results")
    drawn = forests(found)

    def middles(name: str, row_: str) -> list[float]:
        return [x[row_][0] for x in drawn[name].groups.values() if row_ in x]

    def percent(ratio: float) -> str:
        return f"{100.0 * (ratio - 1.0):.1f}"

    spectrum = percent(max(middles("spectrum", "bands")))
    white = max(
        drawn["forest"].groups[f"{name}, simulated"]["hcf default"][0] for name in SCENARIOS
    )
    assert {name: re.findall(NUMBER, one.title) for name, one in drawn.items()} == {
        "forest": [percent(white), spectrum],
        "spectrum": [spectrum],
        "breadth": [f"{x(middles('breadth', 'bands')):.2f}" for x in (min, max)],
        "other-vehicles": [
            percent(max(middles("other-vehicles", row_))) for row_ in ("bands", "bands with factor")
        ],
        "dvl-noise": [percent(max(middles("dvl-noise", "R adaptive")))],
        "withheld": [f"{drawn['withheld'].groups['30 s']['taught, no floor'][0]:.2f}"],
        "vehicle": [
            f"{drawn['vehicle'].groups['body velocity']['bands with factor'][0]:.3f}",
            f"{drawn['vehicle'].groups['tilt']['bands with factor'][0]:.2f}",
        ],
    }
    draw(tmp_path / "one.png", drawn["vehicle"])
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")


def test_the_title_of_a_plot_over_time_has_its_numbers() -> None:
    found = documents(DOCS / "results")

    def numbers(part: str, name: str) -> dict:
        (one,) = [one for one in found[part]["rows"] if one["approach"] == name]
        return one

    def over_told(part: str, name: str) -> float:
        return numbers(part, name)["body_rmse"] / numbers(part, "oracle")["body_rmse"]

    def heading(part: str, name: str) -> str:
        return f"{numbers(part, name)['heading_rmse_deg']:.1f}"

    titles = over_time(found)
    for part in ("varying-calibrated", "wide-calibrated"):
        assert re.findall(NUMBER, titles.pop(part)) == [
            f"{over_told(part, 'hcf default'):.3f}",
            f"{over_told(part, 'constant 0.01/0.001'):.2f}",
        ]
    for part in ("constant-paper", "constant-paper-no-walk"):
        names = ("hcf default", "oracle", "best constant")
        assert re.findall(NUMBER, titles.pop(part)) == [heading(part, name) for name in names]
    assert not titles and not over_time({})


def test_no_plot_over_time_where_a_filter_failed_in_many_runs() -> None:
    found = documents(DOCS / "results")
    one = row(found["constant-paper"], "oracle")
    failed = {**(one or {}), "ratio_to": {}, "heading_rmse_deg": None}
    rows = [failed if r is one else r for r in found["constant-paper"]["rows"]]
    assert not over_time({"constant-paper": found["constant-paper"] | {"rows": rows}})


@pytest.fixture(scope="module")
def document() -> dict:
    rows = ("constant 0.01/0.001", "hcf default", "oracle")
    plan = Plan("varying", Setting("calibrated"), runs=2, seed=4, rows=rows, duration=15.0)
    with open_pool(Workers(jobs=1)) as pool:
        return compare(plan, pool).document | {"environment": {}}


def test_targets_are_judged_by_the_numbers(document: dict) -> None:
    def judged(upper_end: float) -> str:
        learned = row(document, "hcf default")
        assert learned is not None
        learned["ratio_to"]["oracle"]["body_rmse"] = [1.0, 0.9, upper_end]
        text = pages({"varying-calibrated": document})["targets"]
        (line,) = [
            x for x in text.splitlines() if "`varying`: body velocity, learned / oracle" in x
        ]
        return line

    assert judged(1.01).endswith("| 1.000 [0.900, 1.010] | yes |")
    assert judged(1.011).endswith("| 1.000 [0.900, 1.011] | **no** |")


@pytest.mark.parametrize(
    "of_bands, best, verdict",
    [
        (
            (0.96, 0.95, 0.97),
            0.95,
            "0.960 [0.950, 0.970], 80 % (oracle 0.950 [0.940, 0.960]) | **no** |",
        ),
        ((0.96, 0.95, 0.9624), 0.95, "| yes |"),  # 75.2 % at the upper end
        ((0.84, 0.83, 0.849), 0.95, "| yes |"),
        # Few runs may leave no gap: to be far worse than the constant is not to close it.
        ((1.05, 1.04, 1.06), 1.02, "| **no** |"),
        ((1.05, 1.04, 1.06), 1.0, "| **no** |"),
    ],
)
def test_learned_q_and_r_have_to_close_the_gap_at_the_upper_end(of_bands, best, verdict) -> None:
    name = "bands with R adaptive and DVL error"
    found = documents(DOCS / "results")
    for approach, ratio in ((name, of_bands), ("oracle", (best, best - 0.01, best + 0.01))):
        changed = row(found["realistic-spectrum"], approach)
        assert changed is not None
        changed["ratio_to"]["best constant"]["body_rmse"] = list(ratio)
    text = pages(found)["spectrum"]
    (line,) = [x for x in text.splitlines() if f"body velocity, `{name}` / best constant" in x]
    assert line.endswith(verdict)


def test_the_tables_have_the_numbers_of_the_document(document: dict, tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    file = tmp_path / "results" / "varying-calibrated.json"
    file.write_text(json.dumps(document))
    assert results(tmp_path, "--parts", "none") == 0
    text = written(tmp_path)
    oracle = row(document, "oracle")
    assert oracle is not None
    assert f"| oracle | {oracle['body_rmse']:.4f} [" in text
    assert "Not computed: varying-calibrated." not in text


@pytest.mark.parametrize(
    "options, sentence",
    [
        (("--parts", "q-accuracy,moon"), "--parts: unknown name 'moon'; known are q-accuracy, "),
        (("--parts", "vehicle"), "--parts vehicle needs --recordings and --config"),
        (("--runs", "1"), "--runs must be >= 2, got 1"),
        (("--tuning-runs", "1"), "--tuning-runs must be >= 2, got 1"),
        (("--seed", "-3"), "--seed must be >= 0, got -3"),
    ],
)
def test_what_is_refused(
    options: tuple[str, ...], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert results(tmp_path / "out", *options) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"insdvl results: {sentence}") and error.count("\n") == 1
    assert not (tmp_path / "out").exists()
