"""The targets of the studies on recordings are judged by their documents."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl.studies.evaluation import statistics
from insdvl.studies.results import withheld
from insdvl.studies.results.page import pages
from insdvl.studies.results.recorded.predictions import against_hand_set

RESULTS = Path(__file__).parents[3] / "docs" / "results"
ROWS = ("bands", "bands with factor")
Change = Callable[[dict[str, Any], str], None]


def document(part: str) -> dict[str, Any]:
    return json.loads((RESULTS / f"{part}.json").read_text())


def verdict(part: str, changed: dict[str, Any], *words: str) -> str:
    """What stands in the line of a target behind its words."""
    lines = (x for x in pages({part: changed})[part].splitlines() if x.startswith("| "))
    (line,) = [x for x in lines if all(word in x.split("|")[1] for word in words)]
    return line.split("|", 2)[2].strip()


def scaled(metric: str, *, mean: float, worst: float) -> Change:
    """The ratio to hand-set noise of a row: worst on T03, and no more than 0.9 elsewhere."""

    def change(found: dict[str, Any], row: str) -> None:
        clean = found["as_recorded"]
        for name, value in clean["rows"]["hand-set"][metric].items():
            clean["rows"][row][metric][name] = value * (worst if name == "T03" else 0.9)
        clean["ratio_to"]["hand-set"][row][metric] = [mean, 0.0, 9.0]

    return change


def on_t03(metric: str, value: float, hand_set: float = 0.5) -> Change:
    """A number of a row on T03; elsewhere all is in order."""

    def change(found: dict[str, Any], row: str) -> None:
        in_order = {"nis_mean": 3.0, "body_velocity_inside_3_sigma": 1.0}.get(metric, 0.0)
        rows = found["as_recorded"]["rows"]
        for name in found["recordings"]:
            rows[row][metric][name] = value if name == "T03" else in_order
            rows["hand-set"][metric][name] = hand_set

    return change


def injected(name: str, reference: str, value: float) -> Change:
    def change(found: dict[str, Any], row: str) -> None:
        ratios = found["injections"][name]["ratio_to"][reference]
        ratios[row]["body_velocity_rmse"] = [value, value - 0.1, value + 0.1]

    return change


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize(
    "words, change, told",
    [
        *(
            (words, scaled(metric, mean=mean, worst=worst), told)
            for words, metric in (
                ("body velocity", "body_velocity_rmse"),
                ("horizontal position", "position_rmse_horizontal"),
            )
            for mean, worst, told in (
                (1.01, 1.0299, "1.010; largest 1.030 (T03) | yes |"),
                (1.011, 1.02, "1.011; largest 1.020 (T03) | **no** |"),
                (1.0, 1.031, "1.000; largest 1.031 (T03) | **no** |"),
            )
        ),
        (
            "tilt",
            scaled("tilt_rmse_deg", mean=1.2, worst=1.199),
            "1.200; largest 1.199 (T03) | yes |",
        ),
        (
            "tilt",
            scaled("tilt_rmse_deg", mean=1.1, worst=1.3),
            "1.100; largest 1.300 (T03) | **no** |",
        ),
        # How far it is off counts, not whether it is too deep.
        ("depth", on_t03("depth_error_end", -0.59), "largest +0.090 m (T03) | yes |"),
        ("depth", on_t03("depth_error_end", -0.61), "largest +0.110 m (T03) | **no** |"),
        ("depth", on_t03("depth_error_end", 0.4, -0.5), "largest -0.100 m (T03) | yes |"),
        ("NIS", on_t03("nis_mean", 0.8), "0.800 to 3.000 (hand-set 0.500 to 0.500) | yes |"),
        ("NIS", on_t03("nis_mean", 0.79), "0.790 to 3.000 (hand-set 0.500 to 0.500) | **no** |"),
        ("NIS", on_t03("nis_mean", 3.6), "3.000 to 3.600 (hand-set 0.500 to 0.500) | **no** |"),
        (
            "lag 1",
            on_t03("innovation_autocorrelation", -0.2),
            "-0.200 to 0.000 (hand-set 0.500 to 0.500) | yes |",
        ),
        (
            "lag 1",
            on_t03("innovation_autocorrelation", 0.21),
            "0.000 to 0.210 (hand-set 0.500 to 0.500) | **no** |",
        ),
        (
            "inside 3 sigma",
            on_t03("body_velocity_inside_3_sigma", 0.98),
            "0.980 to 1.000 (hand-set 0.500 to 0.500) | yes |",
        ),
        (
            "inside 3 sigma",
            on_t03("body_velocity_inside_3_sigma", 0.97),
            "0.970 to 1.000 (hand-set 0.500 to 0.500) | **no** |",
        ),
    ],
)
def test_a_row_is_judged_on_the_recordings_as_they_are(
    row: str, words: str, change: Change, told: str
) -> None:
    found = document("vehicle")
    change(found, row)
    assert verdict("vehicle", found, "as they are", words, f"`{row}`") == told


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize(
    "name, reference, limit",
    [
        ("sensor", "told", 1.0),
        ("published", "told", 1.0),
        ("vibrating", "best constant", 0.94),
        ("coloured", "best constant", 0.94),
    ],
)
def test_a_row_is_judged_with_noise_injected(
    row: str, name: str, reference: str, limit: float
) -> None:
    for ratio, met in ((limit, "yes"), (limit + 0.001, "**no**")):
        found = document("vehicle")
        injected(name, reference, ratio)(found, row)
        told = verdict("vehicle", found, f"`{name}`", f"`{row}` / {reference}")
        assert told.startswith(f"{ratio:.3f} [{ratio - 0.1:.3f}, {ratio + 0.1:.3f}]")
        assert told.endswith(f"| {met} |")


@pytest.mark.parametrize("row", [*ROWS, "taught", "taught, no floor"])
@pytest.mark.parametrize("seconds", [10, 30, 60])
def test_predictions_are_judged_by_the_worse_end_at_every_length(row: str, seconds: int) -> None:
    for words, name, good, bad in (
        ("error after", "error", [0.9, 0.8, 1.0], [0.9, 0.8, 1.01]),
        ("log likelihood after", "log_likelihood", [0.1, 0.01, 0.2], [0.1, -0.01, 0.2]),
    ):
        found = document("withheld")
        for of in found["against_hand_set"][row].values():
            of[name] = good
        assert verdict("withheld", found, words, f"`{row}`").endswith("| yes |")
        found["against_hand_set"][row][f"{seconds} s"][name] = bad
        told = verdict("withheld", found, words, f"`{row}`")
        assert told.endswith("| **no** |")
        assert f"{bad[0]:.3f} [{bad[1]:.3f}, {bad[2]:.3f}]" in told


@pytest.mark.parametrize("part", ["vehicle", "withheld"])
def test_a_target_without_its_numbers_is_not_judged(part: str) -> None:
    found = document(part)
    for rows in (
        *(
            ratios
            for one in found.get("injections", {}).values()
            for ratios in one["ratio_to"].values()
        ),
        found.get("as_recorded", found)["rows"],
        found.get("as_recorded", {}).get("ratio_to", {}).get("hand-set", {}),
        found.get("against_hand_set", {}),
    ):
        rows.pop("bands", None)
    text = pages({part: found})[part].partition("## Targets")[2].partition("\n\n")[2]
    of_bands = [x for x in text.splitlines() if x.startswith("| ") and "`bands`" in x]
    assert of_bands
    assert all(line.endswith("| not computed |  |") for line in of_bands)


def test_predictions_are_compared_over_the_same_pings_and_drawn_by_stretches() -> None:
    """Two of three recordings are of one stretch."""
    count = {"a": 2.0, "b": 1.0, "c": 3.0}
    errors = {"hand-set": {"a": 0.1, "b": 0.2, "c": 0.3}, "bands": {"a": 0.2, "b": 0.2, "c": 0.3}}
    likelihoods = {
        "hand-set": {"a": 5.0, "b": 6.0, "c": 7.0},
        "bands": {"a": 6.0, "b": 6.0, "c": 6.5},
    }
    rows = {
        row: {
            name: {
                f"{column} {seconds} s": value
                for seconds in (10, 30, 60)
                for column, value in (
                    ("count", count[name]),
                    ("error", errors[row][name]),
                    ("log_likelihood", likelihoods[row][name]),
                )
            }
            for name in count
        }
        for row in errors
    }
    draws = statistics.resamples(np.array([0, 0, 1]), np.random.default_rng(4))
    for found in against_hand_set(rows, draws)["bands"].values():
        # Of squares: 2 * 0.04 + 0.04 and 3 * 0.09 over 2 * 0.01 + 0.04 and 3 * 0.09.
        assert found["error"] == pytest.approx([(0.39 / 0.33) ** 0.5, 1.0, 2.0**0.5])
        assert found["log_likelihood"] == pytest.approx([(2.0 - 1.5) / 6.0, -0.5, 2.0 / 3.0])


def test_the_intervals_of_the_document_are_those_of_its_recordings() -> None:
    found = document("withheld")
    draws = withheld._draws(np.array(found["stretches"]), found["seed"])
    for row, lengths in against_hand_set(found["rows"], draws).items():
        for length, numbers in lengths.items():
            for name, values in numbers.items():
                assert found["against_hand_set"][row][length][name] == pytest.approx(values)
