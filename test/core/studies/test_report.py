"""The folder of a result and its page: what is in them, how large they are, and that it opens."""

import base64
import csv
import gzip
import html.parser
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import record, save

from insdvl import cli
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.bag_writer import BagWriter
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import SCENARIOS
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.replay import result
from insdvl.studies.report import figures, page, sections
from insdvl.studies.report.results import ResultError, read_result

ROOT = Path(__file__).parents[3]
DURATION = 40.0
CONFIG = """
/**/insdvl_filter:
  ros__parameters: {initial: {mode: topic}, dvl.noise_std: [0.02, 0.02, 0.02]}
/**/insdvl_replay:
  ros__parameters:
    imu_topic: /imu
    dvl_topic: /dvl
    ground_truth_topic: /truth
    true_process_noise_topic: /true_q
"""
BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, a configuration, and the result of a replay."""
    path = tmp_path_factory.mktemp("report")
    dvl = DvlModel(rate=2.0, noise_std=(0.02, 0.02, 0.02), outlier_probability=0.05)
    noise = SCENARIOS["constant-tableI"]
    mission = simulate(
        BASELINE["circle"], noise, seed=4, duration=DURATION, dvl=dvl, start_ns=17 * 10**17
    )
    save(path / "mission", record(mission, every=10))
    (path / "my.yaml").write_text(CONFIG)
    assert replay(path, "--out", str(path / "out")) == 0
    return path


@pytest.fixture(scope="module")
def out(folder: Path) -> Path:
    return folder / "out"


@pytest.fixture(scope="module")
def text(out: Path) -> str:
    return (out / "report.html").read_text(encoding="utf-8")


def replay(folder: Path, *options: str) -> int:
    given = ["replay", str(folder / "mission"), "-c", str(folder / "my.yaml"), *options]
    return cli.main(given)


def drawn(text: str) -> list[dict[str, Any]]:
    (data,) = re.findall(r'<script type="application/json" id="figures">(.*?)</script>', text)
    document = json.loads(data)
    arrays = document["arrays"]
    assert len(set(arrays)) == len(arrays)

    def restored(part: dict[str, Any]) -> dict[str, Any]:
        return part | {"bdata": arrays[part["bdata"]]} if "bdata" in part else part

    found: list[dict[str, Any]] = json.loads(json.dumps(document["figures"]), object_hook=restored)
    return found


def script_of(text: str) -> str:
    """The script that the page unpacks."""
    (packed,) = re.findall(r'<script type="application/gzip" id="plotly">(.*?)</script>', text)
    return gzip.decompress(base64.b64decode(packed)).decode()


def values(packed: dict[str, str]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed["bdata"]), "<f4")


# ---------------------------------------------------------------- the folder


def test_the_folder_is_a_recording_with_its_tables(folder: Path, out: Path) -> None:
    assert {f.name for f in out.iterdir()} == {
        "metadata.yaml",
        "result.mcap",
        "report.html",
        "track.csv",
        "track.tum",
        "updates.csv",
        "reference.csv",
        "numbers.json",
    }
    with BagReader(out) as bag:
        assert bag.topics["/imu/data_raw"].size == 100 * DURATION
        assert bag.topics["/odometry/filtered"].size == pytest.approx(10 * DURATION, abs=2)
        assert bag.topics["/dvl/innovation"].size > 50
    with BagReader(folder / "mission") as bag:
        before = bag.topics["/imu"].size
    assert before == 100 * DURATION
    given = sum(f.stat().st_size for f in (folder / "mission").glob("*.mcap"))
    assert (out / "result.mcap").stat().st_size < given


def test_the_recording_is_small_and_its_covariances_have_seven_digits(
    folder: Path, out: Path, tmp_path: Path
) -> None:
    """Less than twice an input that is compressed as well."""
    with (
        BagReader(folder / "mission") as bag,
        BagWriter(tmp_path / "packed", name="mission", compressed=True) as packed,
    ):
        for raw in bag.raw(bag.topics):
            packed.write(raw)
    given = (tmp_path / "packed" / "mission.mcap").stat().st_size
    assert (out / "result.mcap").stat().st_size < 2 * given
    with BagReader(out) as bag:
        (*_, last) = (m.message for m in bag.messages(["/odometry/filtered"]))
    for covariance in (last.pose.covariance, last.twist.covariance):
        assert np.all(covariance == covariance.astype(np.float32))
        assert np.linalg.eigvalsh(covariance.reshape(6, 6)).min() > 0.0
    variances = last.pose.covariance.reshape(6, 6).diagonal()[:3]
    told = read_result(out).vector("position_sigma")[-1]
    np.testing.assert_allclose(np.sqrt(variances), told, rtol=1e-4)


def test_the_tables_agree_with_each_other_and_with_the_recording(out: Path) -> None:
    found = read_result(out)
    tum = np.loadtxt(out / "track.tum")
    assert tum.shape == (len(found.track["stamp"]), 8)
    np.testing.assert_allclose(tum[:, 1:4], found.vector("position"), rtol=0, atol=1e-9)
    np.testing.assert_allclose(tum[:, 4:], found.vector("orientation", "xyzw"), rtol=0, atol=1e-9)
    steps = np.diff(found.track["stamp"])
    assert steps.max() < 0.1001 and np.median(steps) == pytest.approx(0.1, abs=1e-6)
    with (out / "updates.csv").open() as file:
        rows = list(csv.DictReader(file))
    used = sum(row["accepted"] == "1" for row in rows)
    assert used == found.numbers["dvl_accepted"]
    assert sum(row["reason"] == "gate" for row in rows) > 0
    nis = [float(row["nis"]) for row in rows if row["nis"] != "nan"]
    assert np.mean(nis) == pytest.approx(found.numbers["nis_mean"], rel=1e-6)
    error = np.linalg.norm(found.of_reference("position_error")[:, :2], axis=1)
    rmse = found.numbers["position_rmse_horizontal"]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(rmse, rel=1e-6)
    with BagReader(out) as bag:
        last = [m.message for m in bag.messages(["/odometry/filtered"])][-1]
    assert last.pose.pose.position.x == pytest.approx(found.track["position_x"][-1], abs=1e-4)


def test_the_numbers_say_what_was_run(out: Path) -> None:
    document = json.loads((out / "numbers.json").read_text())
    assert document["changed_parameters"] == {
        "dvl.noise_std": [[0.02, 0.02, 0.02], [0.1, 0.1, 0.1]],
        "initial.mode": ["topic", "auto"],
    }
    assert {"python", "numpy", "numba"} <= document["versions"].keys()
    incidents = {incident["name"] for incident in document["incidents"]}
    assert "dvl refused: gate" in incidents


def test_every_key_of_the_numbers_is_documented(out: Path) -> None:
    reference = (ROOT / "docs" / "reference" / "replay.md").read_text()
    document = json.loads((out / "numbers.json").read_text())
    names = [*document, *document["verdict"]]
    names += [*document["verdict"]["innovations"], *document["verdict"]["withheld"][0]]
    names = [name for name in names if not name.startswith(("dvl_a", "dvl_r", "dvl_not_judged"))]
    assert [name for name in names if f"`{name}`" not in reference] == []
    for table in ("track.csv", "updates.csv", "reference.csv"):
        head = (out / table).read_text().split("\n", 1)[0].split(",")
        stems = {re.sub(r"_([xyzw]|\d)$", "", name) for name in head}
        assert [stem for stem in stems if f"`{stem}`" not in reference] == []


def test_the_command_without_options_makes_a_new_folder_and_without_plotly_no_report(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mission-replay").mkdir()
    assert replay(folder) == 0
    said = capsys.readouterr().out
    assert "mission-replay-2" in said
    assert sorted(f.name for f in tmp_path.iterdir()) == ["mission-replay", "mission-replay-2"]
    assert list((tmp_path / "mission-replay").iterdir()) == []
    assert said.strip().rsplit("\n", 1)[-1].startswith(("FITS", "NOT RIGHT", "TOO CAUTIOUS"))
    assert "left out: plotly" in said
    assert not (tmp_path / "mission-replay-2" / "report.html").exists()
    assert (tmp_path / "mission-replay-2" / result.TUM).exists()
    assert cli.main(["report", "mission-replay-2"]) == 2
    assert re.fullmatch(
        r"insdvl report: plotly[\w.]* is not installed: install insdvl\[report\]\n",
        capsys.readouterr().err,
    )


def test_strict_makes_findings_exit_with_one_and_numbers_are_alone_on_standard_output(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(CONFIG.replace("0.02, 0.02, 0.02", "0.5, 0.5, 0.5"))
    given = ["replay", str(folder / "mission"), "-c", str(wrong), "--json", "-", "--strict"]
    assert cli.main(given) == 1
    said = capsys.readouterr()
    assert json.loads(said.out)["verdict"]["findings"]
    assert "Is it right?" in said.err and "NOT RIGHT" in said.err


@pytest.mark.parametrize("rate", ["-1", "nan", "1e9"])
def test_a_rate_out_of_range_is_refused(
    folder: Path, rate: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay(folder, "--out", str(folder / "no"), "--rate", rate) == 2
    assert "--rate must be 0 or within 0.01 to 10000 Hz" in capsys.readouterr().err


# ---------------------------------------------------------------- the page


class Page(html.parser.HTMLParser):
    """Sections, headings and places of figures; everything must be closed."""

    VOID = ("meta", "br")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sections: list[str] = []
        self.places: list[int] = []
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "section":
            self.sections.append(str(given["id"]))
        if "data-figure" in given:
            self.places.append(int(str(given["data-figure"])))
        self.links += [str(given[name]) for name in ("src", "href") if name in given]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_has_a_section_for_each_question_and_needs_no_network(text: str) -> None:
    found = Page(text)
    assert found.open == []
    assert found.sections == [section.name for section in sections.SECTIONS]
    for section in sections.SECTIONS:
        assert f"<h2>{section.question}</h2>" in text
    assert found.places == list(range(len(drawn(text))))
    assert {link[0] for link in found.links} == {"#"}
    assert script_of(text).count("* plotly.js v") == 1


def test_the_page_of_four_hundred_seconds_has_at_most_three_megabytes(out: Path) -> None:
    """The size does not depend on the duration: no trace has more than so many points."""
    found = read_result(out)
    longer = {name: np.resize(column, 4000) for name, column in found.track.items()}
    longer["stamp"] = found.start + np.arange(4000) / 10.0
    many = type(found)(found.title, found.numbers, longer, found.updates, found.reference)
    made = page.page_of([many])
    assert len(made.encode()) < 3_000_000
    moved = {name: column * 1.01 for name, column in longer.items()}
    other = type(found)("other", found.numbers, moved, found.updates, found.reference)
    assert len(page.page_of([many, other]).encode()) < 3_000_000
    sizes = [
        len(values(trace[axis]))
        for figure in drawn(made)
        for trace in figure["data"]
        for axis in "xy"
        if isinstance(trace[axis], dict)
    ]
    assert max(sizes) <= figures.MOST_POINTS
    assert len(sizes) > 60


def test_figures_show_the_numbers_of_the_tables(out: Path, text: str) -> None:
    found = read_result(out)
    chart = drawn(text)[0]
    (track,) = [trace for trace in chart["data"] if trace["name"] == "filter"]
    np.testing.assert_allclose(values(track["x"]), found.track["position_x"], rtol=0, atol=1e-4)
    assert chart["layout"]["yaxis"]["scaleanchor"] == "x"
    refused = [
        len(values(trace["x"]))
        for figure in drawn(text)
        for trace in figure["data"]
        if trace.get("name") == "refused"
    ]
    assert refused == [found.numbers["dvl_rejected_by_reason"]["gate"]] * 3
    ends = {tuple(f["layout"]["xaxis"]["range"]) for f in drawn(text) if f["time"]}
    assert len(ends) == 1
    for figure in drawn(text):
        for trace in figure["data"]:
            for axis in "xy":
                if isinstance(trace[axis], dict) and trace.get("name") != "2 sigma":
                    assert np.isfinite(values(trace[axis])).all()


def test_a_noisy_trace_keeps_its_extremes() -> None:
    noise = np.random.default_rng(0).normal(size=50_000)
    noise[12_345] = 40.0
    at = figures.extremes(noise)
    assert len(at) <= figures.MOST_POINTS and 12_345 in at


def test_an_ellipse_has_two_sigma_along_its_axes() -> None:
    points = figures.ellipse(np.array([1.0, 2.0]), np.array([[9.0, 0.0], [0.0, 4.0]]))
    assert np.ptp(points[:, 0]) == pytest.approx(12.0, rel=1e-3)
    assert np.ptp(points[:, 1]) == pytest.approx(8.0, rel=1e-3)


def test_names_of_the_recording_cannot_end_the_script(out: Path) -> None:
    found = read_result(out)
    numbers = found.numbers | {"bag": "</script><b>", "process_noise": "<i>"}
    numbers["incidents"] = [{"name": "</script>", "begin": 1.0, "end": 2.0, "count": 1}]
    made = page.page_of([type(found)("<x>", numbers, found.track, found.updates, found.reference)])
    assert Page(made).open == []
    assert made.count("</script>") == 3


def test_an_outage_is_told_with_its_length(out: Path) -> None:
    """Among the incidents and among the numbers; a result of an earlier version has no outages."""
    found = read_result(out)

    def made(incidents: list[dict[str, Any]], outages: dict[str, Any] | None) -> str:
        verdict = {k: v for k, v in found.numbers["verdict"].items() if k != "dvl_outages"}
        verdict |= {"dvl_outages": outages} if outages else {}
        numbers = found.numbers | {"incidents": incidents, "verdict": verdict}
        result = type(found)("x", numbers, found.track, found.updates, found.reference)
        return page.page_of([result])

    lost = {"name": "dvl outage", "begin": 10.0, "end": 170.0, "count": 1}
    text = made([lost], {"count": 1, "seconds": 160.0, "longest": 160.0})
    assert "dvl outage: 1, 160.0 s" in text
    assert "outages of the DVL (1)" in text and "160 s, the longest 160 s" in text
    text = made([], None)
    assert "Nothing: no gap, no outage, no glitch, nothing refused, no restart." in text
    assert "outages of the DVL" not in text


# ---------------------------------------------------------------- the command


def test_two_results_stand_side_by_side(out: Path, tmp_path: Path) -> None:
    given = ["report", str(out), str(out), "-o", str(tmp_path / "both.html")]
    assert cli.main(given) == 0
    both = (tmp_path / "both.html").read_text(encoding="utf-8")
    assert len(Page(both).places) == 2 * len(Page((out / "report.html").read_text()).places)


def test_one_page_of_paper_has_the_format_of_its_option(
    out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["report", str(out), "-o", str(tmp_path / "page.html")]
    names = ("png", "pdf", "svg")
    pictures = [word for n in names for word in (f"--{n}", str(tmp_path / f"page.{n}"))]
    assert cli.main([*given, *pictures]) == 0
    assert (tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
    assert b"<svg" in (tmp_path / "page.svg").read_bytes()
    assert cli.main([*given, "--png", str(tmp_path / "page.pdf")]) == 2
    assert "the name must end in .png" in capsys.readouterr().err


def test_the_report_is_made_from_the_folder_alone(out: Path, text: str, tmp_path: Path) -> None:
    moved = shutil.copytree(out, tmp_path / "moved")
    (moved / "report.html").unlink()
    assert cli.main(["report", str(moved)]) == 0
    again = (moved / "report.html").read_text(encoding="utf-8")
    assert drawn(again) == drawn(text)


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda path: shutil.rmtree(path), "is not a folder"),
        (lambda path: (path / "numbers.json").unlink(), "it has no numbers.json"),
        (lambda path: (path / "numbers.json").write_text("{"), "is not valid JSON"),
        (lambda path: (path / "track.csv").unlink(), "track.csv: No such file"),
        (lambda path: (path / "track.csv").write_text("stamp,part\n1,x\n"), "track.csv is damaged"),
        (lambda path: (path / "updates.csv").write_text("a\n1\n"), "updates.csv is damaged"),
    ],
)
def test_what_is_no_result_is_refused_in_one_sentence(
    out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Any, expected: str
) -> None:
    path = shutil.copytree(out, tmp_path / "copy")
    damage(path)
    with pytest.raises(ResultError):
        read_result(path)
    assert cli.main(["report", str(path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("insdvl report: ") and said.count("\n") == 1
    assert expected in said


def opened(profile: Path, address: str, *further: str) -> str:
    """What a browser prints that opens a page, offline."""
    options = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--host-resolver-rules=MAP * ~NOTFOUND",
        f"--user-data-dir={profile}",
        "--window-size=1300,2400",
        "--virtual-time-budget=60000",
    ]
    done = subprocess.run(
        [str(BROWSER), *options, *further, address], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine: the page is not opened")
def test_the_page_opens_in_a_browser_and_draws_all_figures(
    out: Path, text: str, tmp_path: Path
) -> None:
    pillow = pytest.importorskip("PIL.Image")
    address, profile = (out / "report.html").as_uri(), tmp_path / "profile"
    # As an old browser.
    old = tmp_path / "old.html"
    old.write_text(
        text.replace('"use strict";', '"use strict"; delete globalThis.DecompressionStream;')
    )
    page_text = opened(profile, address, "--dump-dom")
    body = re.search(r"<body[^>]*>", page_text)
    assert body is not None and 'data-drawn="all"' in body.group()
    assert page_text.count('class="main-svg"') >= len(drawn(text))
    assert '<p id="undrawn" class="judgement unknown" hidden="">' in page_text
    assert '<p id="undrawn" class="judgement unknown">' in opened(
        profile, old.as_uri(), "--dump-dom"
    )
    opened(profile, address, f"--screenshot={tmp_path / 'page.png'}")
    image = np.asarray(pillow.open(tmp_path / "page.png").convert("RGB"), dtype=int)
    blue = np.abs(image - np.array([0x00, 0x72, 0xB2])).sum(axis=2) < 60
    assert blue[900:].sum() > 500  # the track


@pytest.mark.skipif(
    BROWSER is None or shutil.which("pdftotext") is None,
    reason="no Chromium or no pdftotext on this machine: the page is not printed",
)
def test_on_paper_the_verdict_comes_first_and_figures_have_the_width_of_the_page(
    out: Path, text: str, tmp_path: Path
) -> None:
    pdf = tmp_path / "page.pdf"
    opened(tmp_path / "profile", (out / "report.html").as_uri(), f"--print-to-pdf={pdf}")

    def words(*options: str) -> str:
        return subprocess.run(
            ["pdftotext", *options, str(pdf), "-"], check=True, capture_output=True, text=True
        ).stdout

    judgement = re.findall(r'<p class="judgement [a-z]*">([A-Z ]+)', text)[0]
    assert f"Can I trust this run? {judgement}" in " ".join(words("-l", "1").split())
    # Below each figure over time stands "time [s]", in the middle of its width and of the page.
    boxes = re.findall(r'<word xMin="([0-9.]+)"[^>]*>time</word>', words("-bbox"))
    width = float(re.findall(r'<page width="([0-9.]+)"', words("-bbox"))[0])
    timed = sum(figure["time"] for figure in drawn(text))
    assert sum(0.45 < float(x) / width < 0.55 for x in boxes) == timed


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine: the page is not opened")
def test_on_a_telephone_nothing_runs_out_of_its_box(out: Path, text: str, tmp_path: Path) -> None:
    """Chromium's window is at least 500 px wide, a frame in it is not."""
    long = "initial.heading:=parameters_" * 3
    narrow, frame = tmp_path / "narrow.html", tmp_path / "frame.html"
    narrow.write_text(
        text.replace(
            "</section>", f'<p class="judgement bad">{long}</p><ol><li>{long}</ol></section>', 1
        ).replace(
            "drawAll();",
            "const e = document.documentElement;"
            "parent.postMessage(e.scrollWidth - e.clientWidth, '*');",
        )
    )
    frame.write_text(
        "<script>onmessage = (e) => { document.title = `${e.data} px beyond`; };</script>"
        '<iframe src="narrow.html" style="width:360px;height:900px;border:0"></iframe>'
    )
    said = opened(tmp_path / "profile", frame.as_uri(), "--dump-dom")
    assert "<title>0 px beyond</title>" in said
