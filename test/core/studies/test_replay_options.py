"""Options of `insdvl replay` and `insdvl check`: settings, a part of the recording, comparison."""

import json
from pathlib import Path
from typing import Any

import pytest
from looked_at import flown, raws_of
from recordings import save

from insdvl.cli import main

CONFIG = """
/**/insdvl_filter:
  ros__parameters: {initial.mode: topic, dvl.noise_std: [0.02, 0.02, 0.02]}
/**/insdvl_replay:
  ros__parameters: {imu_topic: /imu, dvl_topic: /dvl, ground_truth_topic: /truth}
"""
SECONDS = 30.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("options")
    save(path / "dive", raws_of(flown(SECONDS)))
    (path / "my.yaml").write_text(CONFIG)
    return path


def replayed(folder: Path, *options: str, code: int = 0) -> dict[str, Any]:
    """The document of a replay."""
    numbers = folder / "numbers.json"
    numbers.unlink(missing_ok=True)
    call = ["replay", f"{folder}/dive", "-c", f"{folder}/my.yaml", "--json", str(numbers)]
    assert main([*call, *options]) == code
    return json.loads(numbers.read_text()) if code == 0 else {}


def test_a_setting_is_used_and_told(folder: Path) -> None:
    document = replayed(folder, "--set", "dvl.noise_std=[0.5, 0.5, 0.5]")
    assert document["parameters"]["insdvl_filter"]["dvl.noise_std"] == [0.5, 0.5, 0.5]
    assert document["configuration"].endswith("my.yaml, dvl.noise_std=[0.5, 0.5, 0.5]")
    assert document["nis_mean"] < 0.1


def test_wrong_settings_are_told_together(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replayed(folder, "--set", "dvl.noise=1", "--set", "rate", code=2)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2 and "did you mean dvl.noise_std" in said[0]


def test_a_part_of_a_recording_is_replayed(folder: Path) -> None:
    whole = replayed(folder)
    part = replayed(folder, "--from", "10", "--to", "25")
    assert whole["duration"] == pytest.approx(SECONDS, abs=0.1)
    assert part["duration"] == pytest.approx(15.0, abs=0.1)
    assert part["dvl_accepted"] + part["dvl_rejected"] == 15
    assert replayed(folder, "--from", "20")["duration"] == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--from", "-1"], "--from must be at least 0"),
        (["--from", "20", "--to", "20"], "--to above it"),
        (["--from", "100"], "nothing is recorded from 100 s to its end"),
    ],
)
def test_a_part_that_is_not_there_is_told(
    folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    replayed(folder, *options, code=2)
    assert message in capsys.readouterr().err


def test_configurations_stand_side_by_side(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "other.yaml").write_text(
        "/**/insdvl_filter: {ros__parameters: {dvl.noise_std: [0.2, 0.2, 0.2]}}\n"
    )
    sources = ("process_noise.source=external", f"{folder}/other.yaml")
    document = replayed(folder, *(word for s in sources for word in ("--compare", s)))
    first, second = document["compared"]
    assert first["process_noise"] == "external, learned by default"
    assert second["parameters"]["insdvl_filter"]["dvl.noise_std"] == [0.2, 0.2, 0.2]
    said = capsys.readouterr().out
    lines = said[said.index("Side by side") :].splitlines()
    assert [line.split(": ")[0] for line in lines[1:4]] == ["  1", "  2", "  3"]
    (nis,) = [line for line in lines if line.startswith("mean NIS (3 dof)")]
    means = [d["nis_mean"] for d in (document, first, second)]
    assert [float(word) for word in nis.split()[4:]] == pytest.approx(means, rel=1e-3)
    assert lines[-2] == f"  2: {first['verdict']['judgement']}"


def test_check_takes_settings(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call = ["check", f"{folder}/dive", "-c", f"{folder}/my.yaml"]
    assert main([*call, "--set", "imu.rate=50.0"]) in (0, 1)
    assert "50" in capsys.readouterr().out
    assert main([*call, "--set", "imu.rat=50.0"]) == 2
    assert "did you mean imu.rate?" in capsys.readouterr().err


def test_an_estimator_of_your_own_gives_q(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(folder))
    (folder / "noise_of_a_test.py").write_text(
        "def variances(samples, rate):\n    return samples.var(axis=0)\n\n"
        "def late(samples, rate):\n    return [1.0] * 6 if len(samples) < 500 else None\n"
    )
    document = replayed(folder, "--estimator", "noise_of_a_test:variances")
    assert document["process_noise"] == "external, learned by noise_of_a_test:variances"
    assert document["model"] is None
    learned = replayed(folder, "--set", "process_noise.source=external")
    assert document["nis_mean"] != learned["nis_mean"]
    replayed(folder, "--estimator", "noise_of_a_test:late", code=2)
    replayed(folder, "--estimator", "noise_of_a_test:absent", code=2)
    late, absent = [line for line in capsys.readouterr().err.splitlines() if "estimator" in line]
    assert "estimator 'noise_of_a_test:late' must answer 6 variances" in late
    assert absent.endswith("noise_of_a_test has no function 'absent'")
