"""`insdvl replay` of what a filter cannot navigate ends with a result that says so."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from looked_at import START_NS, flown, raws_of
from recordings import save
from test_gyroscope_bias import phone, recorded

from insdvl import cli
from insdvl.navigation.events import NS
from insdvl.recordings.base import Raw, decode, encode
from insdvl.simulation.trajectories import BASELINE

#: The largest walks that may be told: their variances overflow again and again.
DIVERGING = (
    "process_noise.source=constant",
    "process_noise.gyroscope_bias_walk=1e6",
    "process_noise.accelerometer_bias_walk=1e8",
)


def replayed(bag: Path, *changes: str) -> dict[str, Any]:
    """The numbers of a result with the parameters of `insdvl init`, beside the recording."""
    parameters, out = bag.parent / "my.yaml", bag.parent / "run"
    assert cli.main(["init", str(bag), "-o", str(parameters)]) == 0
    sets = [word for change in changes for word in ("--set", change)]
    assert cli.main(["replay", str(bag), "-c", str(parameters), "--out", str(out), *sets]) == 0
    document: dict[str, Any] = json.loads((out / "numbers.json").read_text())
    return document


def table(path: Path) -> np.ndarray:
    with path.open() as file:
        return np.array([[float(x or "nan") for x in row] for row in list(csv.reader(file))[1:]])


@pytest.fixture(scope="module")
def diverged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    bag = save(tmp_path_factory.mktemp("diverged") / "dive", raws_of(flown(80.0)))
    return bag.parent / "run", replayed(bag, *DIVERGING)


def test_a_filter_that_diverges_is_told_with_its_times(
    diverged: tuple[Path, dict[str, Any]],
) -> None:
    _, document = diverged
    count = document["counts"]["diverged"]
    assert count >= 2
    found = [i for i in document["incidents"] if i["name"] == "diverged"]
    assert sum(incident["count"] for incident in found) == count
    assert all(START_NS / NS < incident["begin"] < START_NS / NS + 80.0 for incident in found)
    finding = document["verdict"]["findings"][0]
    assert finding["name"] == "diverged" and f"diverged {count}" in finding["text"]
    assert document["verdict"]["judgement"].startswith("NOT RIGHT: the filter has diverged")


def test_the_result_has_no_states_of_the_time_without_one(
    diverged: tuple[Path, dict[str, Any]],
) -> None:
    out, document = diverged
    track = table(out / "track.csv")
    assert len(track) > 10 and np.isfinite(track).all()
    stamps = track[:, 0]
    for incident in document["incidents"]:
        if incident["name"] == "diverged":
            assert not ((stamps >= incident["begin"]) & (stamps < incident["begin"] + 0.5)).any()
    reference = table(out / "reference.csv")
    assert np.isfinite(reference).all()
    assert len(reference) == document["reference_stamps"] < 80
    assert (out / "report.html").exists()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_reference_that_is_not_finite_is_left_out(bad: float, tmp_path: Path) -> None:
    def spoilt(raw: Raw, at: int) -> Raw:
        message = decode(raw).message
        if at % 3 == 0:
            message.pose.pose.position.x = bad
        elif at % 3 == 1:
            message.pose.pose.orientation.w = bad
        else:
            message.twist.twist.linear.y = bad
        return encode("/truth", raw.time_ns, message)

    raws = raws_of(flown(30.0))
    truths = [k for k, raw in enumerate(raws) if raw.topic == "/truth"]
    for number, k in enumerate(truths[1::2]):
        raws[k] = spoilt(raws[k], number)
    document = replayed(save(tmp_path / "dive", raws))
    assert 0 < document["reference_stamps"] <= len(truths) - len(truths[1::2])
    assert document["body_velocity_rmse"] < 0.1


def test_without_a_reference_that_is_finite_there_are_no_errors(tmp_path: Path) -> None:
    raws = []
    for raw in raws_of(flown(30.0)):
        if raw.topic == "/truth":
            message = decode(raw).message
            message.pose.pose.orientation.x = np.nan
            raw = encode("/truth", raw.time_ns, message)
        raws.append(raw)
    document = replayed(save(tmp_path / "dive", raws))
    assert document["reference_stamps"] == 0 and document["body_velocity_rmse"] is None


@pytest.mark.long
def test_a_roll_that_nothing_holds_is_navigated_to_the_end(tmp_path: Path) -> None:
    """A phone with a speed along x, started under way: large sigmas, and no infinity."""
    bag = recorded(tmp_path / "drive", phone(BASELINE["straight"], 150.0, 1, rate=10.0))
    document = replayed(bag, "initial.gyroscope_bias_std=0.005")
    assert document["counts"]["diverged"] == 0
    assert document["tilt_rmse_deg"] is not None
    assert np.isfinite(table(tmp_path / "run" / "track.csv")).all()
