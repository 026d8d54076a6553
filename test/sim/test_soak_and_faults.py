"""The commands behind `make faults` and `make soak`, in their short forms."""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from insdvl.navigation.events import NS
from insdvl.studies.faults import page
from insdvl.studies.faults.verdicts import lost
from ros_insdvl_sim.trials import faults, soak, soak_search
from ros_insdvl_sim.trials.environment import TrialError
from ros_insdvl_sim.trials.process_rows.flight import START_S
from ros_insdvl_sim.trials.process_rows.judgement import samples_without_output
from ros_insdvl_sim.trials.process_rows.rows import ROWS


@pytest.mark.long  # the soak below flies the same processes
def test_a_fault_row_of_the_network_is_met(tmp_path: Path) -> None:
    options = faults.parse(["--short", "--parts", "processes", "--out", str(tmp_path)])
    assert faults.fly_matrix(options) == 0
    document = json.loads((tmp_path / "reliability" / "processes.json").read_text())
    (row,) = document["rows"]
    assert row["met"] and row["lost"] == 0
    assert row["fault"] in (tmp_path / "reliability.md").read_text()


@pytest.mark.parametrize(
    ("published", "lives", "output_delay", "lost"),
    [
        (range(1, 101), (), 0.0, 0),
        (range(1, 91), (), 0.0, 10),  # it died before the end
        (range(1, 91), (), 0.1, 0),  # it holds them back
        ([k for k in range(1, 101) if k != 50], (), 0.0, 1),
        ([*range(1, 31), *range(61, 101)], (0.6,), 0.0, 0),  # nobody was there in between
        ([*range(1, 31), *range(61, 91)], (0.6,), 0.0, 10),
    ],
)
def test_a_sample_without_output_is_lost(
    published: Sequence[int], lives: Sequence[float], output_delay: float, lost: int
) -> None:
    def stamps(numbers: Sequence[int]) -> list[int]:
        return [round(START_S * NS) + k * NS // 100 for k in numbers]

    found = samples_without_output(stamps(range(101)), stamps(published), lives, output_delay)
    assert found == lost


def test_the_short_form_has_the_rows_that_it_names() -> None:
    assert {row.name for row in faults.short_rows()} == set(faults.SHORT)
    assert sum(row.short for row in ROWS) == 1


def test_the_rows_are_those_of_the_committed_results() -> None:
    (file,) = (Path(__file__).parents[2] / "docs").rglob("processes.json")
    committed = [(row["group"], row["fault"]) for row in json.loads(file.read_text())["rows"]]
    assert [(row.group, row.name) for row in ROWS] == committed


@pytest.mark.long
def test_legs_of_a_soak_add_up(tmp_path: Path) -> None:
    options = ["--leg", "10", "--rate-factor", "4", "--out", str(tmp_path)]
    assert soak.soak_and_judge(soak.parse([*options, "--hours", "2"])) == 0
    file = tmp_path / "reliability" / "soak.json"
    first = json.loads(file.read_text())["legs"]
    assert [leg["leg"] for leg in first] == [0, 1]
    for leg in first:
        assert lost(leg) == 0
        assert {row["sent"] for row in leg["messages"] if row["topic"] == "imu/data_raw"} == {1000}
        assert leg["nis"] < 8.0 and leg["body_velocity_rmse"] < 0.5
        assert leg["memory"]["filter"]["end"] > 10.0
    # What is there is kept, and the page is of it.
    assert soak.soak_and_judge(soak.parse([*options, "--hours", "0"])) == 0
    assert json.loads(file.read_text())["legs"] == first
    found = page.documents(tmp_path / "reliability")
    assert soak.soak_and_judge(soak.parse([*options, "--hours", "0", "--core-hours", "1"])) == 0
    assert (tmp_path / "reliability.md").read_text() != page.markdown(found)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--hours", "-1"], "--hours must be >= 0, got -1"),
        (["--leg", "5"], "--leg must be from 10 to 3600 s, got 5"),
        (["--rate-factor", "nan"], "--rate-factor must be from 0 to 1000, got nan"),
    ],
)
def test_what_the_soak_refuses(
    options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        soak.parse(options)
    assert sentence in capsys.readouterr().err


def test_what_the_faults_refuse(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        faults.parse(["--parts", "moon"])
    assert (
        "--parts must be one or more of messages,processes, got 'moon'" in capsys.readouterr().err
    )


# ---------------------------------------------------------------- without processes


class Flown:
    """A graph without processes, which flies in no time.

    Attributes:
        speeds: Of each graph that was started.
        missions: Number, length and speed of each leg.
    """

    def __init__(self, **numbers: Callable[[float], Any]) -> None:
        """Of the legs: numbers beside those of a good one, each by the speed."""
        self._numbers = numbers
        self.speeds: list[float] = []
        self.missions: list[tuple[int, float, float]] = []

    @contextmanager
    def graph(self, rate_factor: float) -> Iterator["Flown"]:
        self.speeds.append(rate_factor)
        self._legs = 0
        yield self

    def fly(self, number: int, duration: float) -> dict[str, Any]:
        rate_factor = self.speeds[-1]
        self.missions.append((number, duration, rate_factor))
        self._legs += 1
        numbers = {name: of_speed(rate_factor) for name, of_speed in self._numbers.items()}
        size, latency = numbers.get("memory", 200.0), numbers.get("latency", 10.0)
        return {
            "leg": number,
            "mission": duration,
            "rate_factor": rate_factor,
            "held": numbers.get("held", 1.0),
            "wall": duration / rate_factor,
            "stolen": numbers.get("stolen", 0.0),
            "legs_of_filter": self._legs,
            "messages": [{"sent": 1000, "received": 1000 - numbers.get("lost", 0)}],
            "memory": {name: {"end": size, "slope": 0.0} for name in ("filter", "tuner")},
            "latency": [{"p50": 5.0, "p99": 9.0}, {"p50": latency, "p99": 20.0}],
            "nis": 3.0,
            "body_velocity_rmse": 0.2,
        }


@pytest.fixture
def fly(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Flown]:
    """The soak flies a graph without processes, with such numbers."""

    def fly(**numbers: Callable[[float], Any]) -> Flown:
        flown = Flown(**numbers)
        monkeypatch.setattr(soak_search, "graph", flown.graph)
        monkeypatch.setattr(soak, "isolate", lambda: None)
        return flown

    return fly


def add(folder: Path, *options: str) -> int:
    return soak.soak_and_judge(soak.parse(["--out", str(folder), *options]))


def recorded(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "reliability" / "soak.json").read_text())


TOO_FAST = 7.0
BAD = {
    "lost": lambda speed: int(speed > TOO_FAST),
    "held": lambda speed: 0.9 if speed > TOO_FAST else 1.0,
    "latency": lambda speed: 150.0 if speed > TOO_FAST else 5.0,
}


@pytest.mark.parametrize("number", BAD)
def test_the_highest_speed_at_which_all_is_well_is_found(
    number: str, fly: Callable[..., Flown]
) -> None:
    flown = fly(**{number: BAD[number]})
    best, tried = soak_search.search_speed()
    assert best == 6.2
    assert flown.speeds == [trial["rate_factor"] for trial in tried] == [4.0, 5.0, 6.2, 7.8]
    assert [trial["mission"] for trial in tried] == [30.0 * speed for speed in flown.speeds]
    assert [trial[number] for trial in tried] == [BAD[number](speed) for speed in flown.speeds]


def test_silence_is_no_speed(fly: Callable[..., Flown]) -> None:
    fly(latency=lambda speed: None if speed > TOO_FAST else 5.0)
    assert soak_search.search_speed()[0] == 6.2


def test_the_search_has_an_end(fly: Callable[..., Flown]) -> None:
    flown = fly()
    best, tried = soak_search.search_speed()
    assert best == flown.speeds[-1] <= soak_search.LAST_FACTOR < best * soak_search.STEP
    assert len(tried) == len(flown.speeds)


def test_a_machine_that_is_too_slow_is_told(fly: Callable[..., Flown]) -> None:
    flown = fly(lost=lambda speed: 1)
    with pytest.raises(TrialError, match="lost or late even at 4 times real time"):
        soak_search.search_speed()
    assert flown.speeds == [4.0]


def test_a_speed_that_loses_something_in_an_hour_is_left(
    tmp_path: Path, fly: Callable[..., Flown]
) -> None:
    """The trials are too short to see the loss."""
    losses = iter([0] * 8 + [0, 3, 0, 0])  # of the trials, then of the hours
    flown = fly(lost=lambda speed: next(losses), held=lambda speed: float(speed < 16.0))
    assert add(tmp_path, "--hours", "3") == 0
    document = recorded(tmp_path)
    assert document["rate_factor"] == 12.2
    assert document["search"][-1] == {
        "rate_factor": 15.2,
        "mission": 3600.0,
        "held": 1.0,
        "lost": 3,
        "latency": 10.0,
        "stolen": 0.0,
    }
    # The hour is flown again, by another filter, and is in the file once.
    hours = [(number, speed) for number, duration, speed in flown.missions if duration == 3600.0]
    assert hours == [(0, 15.2), (1, 15.2), (1, 12.2), (2, 12.2)]
    found = [(leg["leg"], leg["rate_factor"], leg["legs_of_filter"]) for leg in document["legs"]]
    assert found == [(0, 15.2, 1), (1, 12.2, 1), (2, 12.2, 2)]


def test_an_hour_that_the_host_spoilt_is_flown_again_at_its_speed(
    tmp_path: Path, fly: Callable[..., Flown]
) -> None:
    losses = iter([0] * 4 + [3, 0])  # of the trials, then of the hours
    stolen = iter([0.0] * 4 + [0.2, 0.2])
    flown = fly(
        lost=lambda speed: next(losses),
        stolen=lambda speed: next(stolen),
        held=lambda speed: float(speed < TOO_FAST),
    )
    assert add(tmp_path, "--hours", "1") == 0
    assert [(number, speed) for number, _, speed in flown.missions[4:]] == [(0, 6.2), (0, 6.2)]
    document = recorded(tmp_path)
    assert document["search"][-1]["stolen"] == 0.2
    assert document["rate_factor"] == 6.2
    assert [leg["leg"] for leg in document["legs"]] == [0]


def test_a_host_that_never_lets_go_is_told(tmp_path: Path, fly: Callable[..., Flown]) -> None:
    losses = iter([0] * 4 + [1] * soak_search.DISTURBED)
    flown = fly(
        lost=lambda speed: next(losses),
        stolen=lambda speed: 0.2,
        held=lambda speed: float(speed < TOO_FAST),
    )
    with pytest.raises(TrialError, match="host took more than 5 % of the processors"):
        add(tmp_path)
    assert len(flown.missions) == 4 + soak_search.DISTURBED


def test_below_the_first_speed_there_is_none(tmp_path: Path, fly: Callable[..., Flown]) -> None:
    losses = iter([0, 0, 1])  # of the trials, then of the hour
    fly(lost=lambda speed: next(losses), held=lambda speed: float(speed < 4.5))
    with pytest.raises(TrialError, match="lost even at 4 times real time"):
        add(tmp_path)
    document = recorded(tmp_path)
    assert document["legs"] == [] and document["search"][-1]["lost"] == 1


def test_another_call_adds_to_the_file(tmp_path: Path, fly: Callable[..., Flown]) -> None:
    flown = fly(held=lambda speed: float(speed < TOO_FAST))
    assert add(tmp_path, "--hours", "1") == 0
    first = recorded(tmp_path)
    searched = len(flown.missions)
    assert add(tmp_path, "--hours", "1") == 0
    document = recorded(tmp_path)
    # The speed is not searched for again.
    assert flown.missions[searched:] == [(1, 3600.0, 6.2)]
    assert document["search"] == first["search"]
    assert document["legs"][:1] == first["legs"]
    assert [leg["leg"] for leg in document["legs"]] == [0, 1]
    assert "**2 mission hours in" in (tmp_path / "reliability.md").read_text()


def test_an_hour_that_is_interrupted_is_flown_again(
    tmp_path: Path, fly: Callable[..., Flown]
) -> None:
    def lost_by(speed: float) -> int:
        if len(flown.missions) == 2:
            raise KeyboardInterrupt
        return 0

    flown = fly(lost=lost_by)
    with pytest.raises(KeyboardInterrupt):
        add(tmp_path, "--hours", "2", "--rate-factor", "5")
    assert [leg["leg"] for leg in recorded(tmp_path)["legs"]] == [0]
    assert add(tmp_path, "--hours", "1") == 0
    assert [leg["leg"] for leg in recorded(tmp_path)["legs"]] == [0, 1]
    assert flown.missions[1:] == [(1, 3600.0, 5.0)] * 2


def test_a_loss_at_a_given_speed_fails(tmp_path: Path, fly: Callable[..., Flown]) -> None:
    fly(lost=lambda speed: 1)
    assert add(tmp_path, "--hours", "1", "--rate-factor", "5") == 1
    assert len(recorded(tmp_path)["legs"]) == 1


@pytest.mark.parametrize(
    ("number", "after", "what"),
    [
        ("memory", lambda hours: 5.0 * hours, "memory of the tuner"),
        ("latency", lambda hours: 10.0 * 2.0**hours, "the median latency"),
    ],
)
def test_growth_fails(
    number: str,
    after: Callable[[int], float],
    what: str,
    tmp_path: Path,
    fly: Callable[..., Flown],
    capsys: pytest.CaptureFixture[str],
) -> None:
    flown = fly(**{number: lambda speed: after(len(flown.missions))})
    # A filter of one hour cannot tell.
    assert add(tmp_path, "--hours", "1", "--rate-factor", "5") == 0
    assert "FAILS" not in capsys.readouterr().out
    assert add(tmp_path, "--hours", "3") == 1
    assert f"FAILS       {what}" in capsys.readouterr().out
    assert "| **no** |" in (tmp_path / "reliability.md").read_text()


def test_numbers_that_are_not_finite_are_kept_as_such(
    tmp_path: Path, fly: Callable[..., Flown], monkeypatch: pytest.MonkeyPatch
) -> None:
    fly()
    bad = soak.soak.Health(float("nan"), float("nan"), float("nan"))
    hour = soak.soak.Hour(100, 100, 1.0, 200.0, float("nan"), 0.1, bad)
    monkeypatch.setattr(soak.soak, "flown_hours", lambda hours, duration: iter([hour]))
    assert add(tmp_path, "--hours", "0", "--core-hours", "1") == 1
    (core,) = recorded(tmp_path)["core"]
    assert core["nis"] is core["health"]["asymmetry"] is None
    assert "a state is not finite" in (tmp_path / "reliability.md").read_text()


def test_a_damaged_file_is_named_and_stays(tmp_path: Path, fly: Callable[..., Flown]) -> None:
    flown = fly()
    file = tmp_path / "reliability" / "soak.json"
    file.parent.mkdir()
    for content, expected in (
        ("{", "is not valid JSON"),
        ('{"legs": [{}]}', "does not have the content that the page needs"),
    ):
        file.write_text(content)
        with pytest.raises(ValueError, match=f"{file} {expected}"):
            add(tmp_path)
        assert file.read_text() == content
    assert flown.missions == []
