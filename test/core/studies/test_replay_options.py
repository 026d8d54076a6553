"""Options of `insdvl replay` and `insdvl check`: settings, a part of the recording, comparison."""

import json
import re
import signal
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from looked_at import Memory, flown, raws_of
from recordings import save

from insdvl.cli import main
from insdvl.jobs.progress import Progress
from insdvl.messages.topics import DVL, IMU, MEASUREMENT_NOISE, PROCESS_NOISE
from insdvl.navigation.events import Event
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import DvlParameters, FilterParameters, GateParameters
from insdvl.studies.judgement.noise import NoiseInForce
from insdvl.studies.replay import command
from insdvl.studies.replay.inputs.learning import Learned, LearnedOfDvl
from insdvl.studies.replay.inputs.watched import interruption
from insdvl.studies.replay.taken import Taken
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.parameters import TunedDvl, TunerParameters

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


def replayed(folder: Path, *options: str, bag: str = "dive", code: int = 0) -> dict[str, Any]:
    """The document of a replay."""
    numbers = folder / "numbers.json"
    numbers.unlink(missing_ok=True)
    call = ["replay", f"{folder}/{bag}", "-c", f"{folder}/my.yaml", "--json", str(numbers)]
    assert main([*call, *options]) == code
    return json.loads(numbers.read_text()) if code == 0 else {}


def test_a_setting_is_used_and_told(folder: Path) -> None:
    document = replayed(folder, "--set", "dvl.noise_std=[0.5, 0.5, 0.5]")
    assert document["parameters"]["insdvl_filter"]["dvl.noise_std"] == [0.5, 0.5, 0.5]
    assert document["configuration"].endswith("my.yaml, dvl.noise_std=[0.5, 0.5, 0.5]")
    assert document["nis_mean"] < 0.1


def test_both_lines_of_the_refused_agree(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The ping before a start under way is told apart, and refused by neither."""
    document = replayed(folder, "--set", "initial.mode=auto")
    lines = capsys.readouterr().out.splitlines()

    def told(label: str) -> str:
        (line,) = (line for line in lines if line.strip().startswith(label))
        return line.strip().removeprefix(label).strip()

    assert told("DVL rejected") == "0"
    assert told("refused") == "0.0 % of the DVL"
    assert told("DVL not judged") == "1 (not_initialised 1)"
    assert document["dvl_accepted"] + 1 == document["messages"][DVL]


def test_the_factor_on_q_is_told_where_it_is_learned(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A constant that is told a hundred times too large."""
    assert replayed(folder)["process_noise_factor"] is None
    assert "factor on it" not in capsys.readouterr().out
    large = "process_noise.accelerometer_variance=[1, 1, 1]"
    factor = "process_noise.adaptive_factor=true"
    document = replayed(folder, "--set", large, "--set", factor)
    assert document["process_noise_factor"] < 0.5
    assert f"{document['process_noise_factor']:.4g}" in capsys.readouterr().out


def test_the_noise_of_the_dvl_in_force_is_told_where_it_is_learned(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sigma that is told five times too large; by the tuner, and by the filter's own window."""
    assert replayed(folder)["dvl_noise_in_force"] is None
    assert "in force" not in capsys.readouterr().out
    large = "dvl.noise_std=[0.1, 0.1, 0.1]"
    learned = ("--set", large, "--set", "dvl.noise_source=learned")
    for tuner, origin in (("true", "received"), ("false", "own window")):
        setting = f"insdvl_tuner:measurement_noise={tuner}"
        noise = replayed(folder, *learned, "--set", setting)["dvl_noise_in_force"]
        assert noise["origins"][origin] > 0.6
        assert sum(noise["origins"].values()) == pytest.approx(1.0)
        factor, sigma = noise["factor"], noise["sigma"]
        assert factor["min"] <= factor["mean"] <= factor["max"] == 1.0
        assert sigma["max"] == pytest.approx(0.1)
        assert 0.01 < sigma["min"] < 0.03 < sigma["mean"] < 0.07
        shown = capsys.readouterr().out
        assert f"sigma of the DVL in force        mean {sigma['mean']:.3g} m/s" in shown
        assert f"{origin} {100.0 * noise['origins'][origin]:.0f} %" in shown


def test_the_noise_in_force_is_that_of_the_last_part() -> None:
    m = flown(12.0)
    parameters = FilterParameters(
        frame_convention="ned",
        initial=replace(FilterParameters().initial, mode="parameters"),
        dvl=DvlParameters(noise_source="learned"),
        gate=GateParameters(enabled=False),
    )
    pairs = zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)
    pings: list[Event] = [Dvl(stamp_ns, v_d) for stamp_ns, v_d in pairs]
    samples = np.hstack([m.f_b, m.w_ib_b])
    result = fold_arrays(parameters, m.stamps_ns, m.f_b, m.w_ib_b, pings)
    taken, noise = Taken.of(m.stamps_ns, samples, pings), NoiseInForce()
    noise.take(result.filter, result.states)
    noise.end()
    told = noise.numbers(result.filter, taken)
    assert told is not None and told["measurements"] == len(pings)
    factors = result.states["dvl_noise"]["factor"]
    assert told["factor"]["min"] == pytest.approx(factors[factors > 0.0].min())
    noise.take(result.filter, result.states[:1])  # another time, in which nothing has taught
    noise.end()
    assert noise.numbers(result.filter, taken) is None


def test_wrong_settings_are_told_together(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replayed(folder, "--set", "dvl.noise=1", "--set", "rate", code=2)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2 and "did you mean dvl.noise_std" in said[0]


def test_a_part_of_a_recording_is_replayed(folder: Path) -> None:
    whole = replayed(folder)
    part = replayed(folder, "--from", "10", "--to", "25")
    assert whole["duration"] == pytest.approx(SECONDS, abs=0.1)
    assert part["duration"] == pytest.approx(15.0, abs=0.1)
    assert part["dvl_accepted"] + part["dvl_rejected"] + part["dvl_not_judged"] == 15
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


def test_all_that_is_wrong_with_a_call_is_told_together(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "there"
    out.mkdir()
    call = ["replay", f"{tmp_path}/absent", "-c", f"{tmp_path}/no.yaml", "--out", str(out)]
    assert main([*call, "--from", "5", "--to", "2", "--rate", "-1"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert all(line.startswith("insdvl replay: ") for line in said)
    for text in ("absent does not exist", "no.yaml does not exist", "--to above it", "--rate must"):
        assert any(text in line for line in said), text
    assert "there exists already" in said[-1] and len(said) == 5
    values = ("--set", "gate.probability=7", "--set", "gate.probabilty=7")
    replayed(folder, *values, code=2)
    unknown, range_ = capsys.readouterr().err.splitlines()
    assert "did you mean gate.probability?" in unknown and "must be > 0.5 and <= 0.9999" in range_


def test_a_part_is_checked_made_a_file_of_and_exported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dive, part = f"{folder}/dive", ("--from", "10", "--to", "20")
    assert main(["check", dive, *part, "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["duration"] == pytest.approx(10.0, abs=0.1)
    assert main(["init", dive, *part, "--set", "imu_topic=/imu", "-o", f"{tmp_path}/a.yaml"]) == 0
    assert main(["export", dive, *part, "--topic", "/imu", "-o", f"{tmp_path}/imu.csv"]) == 0
    rows = (tmp_path / "imu.csv").read_text().splitlines()
    assert len(rows) == pytest.approx(1001, abs=1)
    capsys.readouterr()
    late = ["export", dive, "--from", "99", "--topic", "/imu", "-o", f"{tmp_path}/late.csv"]
    assert main(late) == 2
    assert "nothing is recorded from 99 s to its end" in capsys.readouterr().err


# ---------------------------------------------------------------- progress, interruption


def test_an_interruption_keeps_what_was_navigated(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    class Pressed(Progress):
        """Someone presses Ctrl-C after a while."""

        def show(self, done: int) -> None:
            if done == 12:
                signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    out = tmp_path / "out"
    call = ["replay", f"{folder}/dive", "-c", f"{folder}/my.yaml", "--out", str(out)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "Progress", Pressed)
        patch.setattr(sys.stderr, "isatty", lambda: True)
        assert main(call) == 130
    assert signal.getsignal(signal.SIGINT) is before
    said = capsys.readouterr()
    assert re.search(r"interrupted: the result is of the first 1\d s", said.err)
    document = json.loads((out / "numbers.json").read_text())
    assert document["interrupted"] and 5.0 < document["duration"] < 15.0
    assert (out / "metadata.yaml").is_file() and (out / "track.csv").is_file()


def test_the_second_interruption_ends_it() -> None:
    with interruption() as ends:
        assert not ends()
        signal.raise_signal(signal.SIGINT)
        assert ends()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_progress_has_the_time_left_and_is_on_a_terminal_only(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    replayed(folder)
    assert "left" not in capsys.readouterr().err
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")
    replayed(folder)
    assert re.search(r"seconds: \d\d/30, 0:\d\d elapsed, 0:\d\d left", capsys.readouterr().err)


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


@pytest.fixture(scope="module")
def tuned(folder: Path) -> Path:
    """The same folder, with the recording `tuned`: the dive, recorded with the tuner on."""
    names = {"/imu": IMU}
    raws = [r._replace(topic=names.get(r.topic, r.topic)) for r in raws_of(flown(SECONDS))]
    memory = Memory(raws)
    stream = SimpleNamespace(topics=frozenset(memory.topics), on=memory.raw)
    learned = Learned(stream, TunerParameters(model="bands"))  # type: ignore[arg-type]
    back = {IMU: "/imu", PROCESS_NOISE: "/process_noise"}
    raws = list(learned.on({*memory.topics, PROCESS_NOISE}))
    save(folder / "tuned", [r._replace(topic=back.get(r.topic, r.topic)) for r in raws])
    return folder


EXTERNAL = ("--set", "process_noise.source=external")


def test_a_model_that_is_set_is_used_in_place_of_a_recorded_q(
    tuned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = replayed(tuned, *EXTERNAL, bag="tuned")
    assert (recorded["process_noise"], recorded["model"]) == ("external, recorded", None)
    document = replayed(tuned, *EXTERNAL, "--set", "model=default", bag="tuned")
    assert document["process_noise"] == "external, learned by default, in place of the recorded"
    assert document["model"]["name"] == "default"
    without = replayed(tuned, *EXTERNAL, "--set", "model=default")
    assert document["nis_mean"] == without["nis_mean"] != recorded["nis_mean"]
    compared = replayed(tuned, *EXTERNAL, "--compare", "model=default", bag="tuned")
    assert compared["nis_mean"] == recorded["nis_mean"]
    assert compared["compared"][0]["nis_mean"] == without["nis_mean"]
    assert "WARN" not in capsys.readouterr().err


def test_an_estimator_that_is_set_is_used_in_place_of_a_recorded_q(
    tuned: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tuned))
    (tuned / "another_noise_of_a_test.py").write_text(
        "def variances(samples, rate):\n    return samples.var(axis=0)\n"
    )
    name = "another_noise_of_a_test:variances"
    document = replayed(tuned, "--estimator", name, bag="tuned")
    assert document["process_noise"] == f"external, learned by {name}, in place of the recorded"
    assert document["nis_mean"] == replayed(tuned, "--estimator", name)["nis_mean"]


def test_a_model_of_a_file_is_not_used_beside_a_recorded_q_and_that_is_told(
    tuned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of a vehicle names the model that made the recorded Q, by its path aboard."""
    (tuned / "vehicle.yaml").write_text(
        "/**/insdvl_filter:\n  ros__parameters: {process_noise.source: external}\n"
        "/**/insdvl_tuner:\n  ros__parameters: {model: /aboard/taught.npz}\n"
    )
    vehicle = ("-c", f"{tuned}/vehicle.yaml")
    assert replayed(tuned, *vehicle, bag="tuned")["process_noise"] == "external, recorded"
    assert "WARN the recording has process_noise, which is used; the model" in (
        capsys.readouterr().err
    )
    replayed(tuned, *vehicle, code=2)


@pytest.mark.parametrize("bag", ["dive", "tuned"])
@pytest.mark.parametrize("source", [(), EXTERNAL])
def test_a_model_that_does_not_exist_is_refused(
    tuned: Path, source: tuple[str, ...], bag: str, capsys: pytest.CaptureFixture[str]
) -> None:
    replayed(tuned, *source, "--set", "model=nope", bag=bag, code=2)
    assert "there is no model 'nope'" in capsys.readouterr().err


def test_a_model_or_an_estimator_that_nothing_would_use_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    constant = ("--set", "process_noise.source=constant")
    replayed(folder, "--set", "model=bands", code=2)
    replayed(folder, "--compare", "model=bands", code=2)
    replayed(folder, *constant, "--estimator", "a:b", code=2)
    replayed(folder, "--set", "model=bands", "--estimator", "a:b", code=2)
    of_model, again, of_estimator, both = capsys.readouterr().err.splitlines()
    assert of_model == again
    assert of_model.endswith(
        "parameter 'model' of insdvl_tuner is set to 'bands' but would not be used: "
        "process_noise.source is 'constant'; add --set process_noise.source=external, or leave "
        "model out"
    )
    assert "'estimator' of insdvl_tuner is set to 'a:b' but would not be used" in of_estimator
    assert both.endswith("estimator 'a:b' takes its place; set only one")
    # It is meant for the second one.
    compare = ("--compare", "process_noise.source=external")
    document = replayed(folder, "--set", "model=bands", *compare)
    assert document["compared"][0]["process_noise"] == "external, learned by bands"


@pytest.fixture(scope="module")
def with_noise(folder: Path) -> Path:
    """The same folder, with the recording `noisy`: the dive, recorded with the R of a tuner."""
    names = {"/imu": IMU, "/dvl": DVL}
    raws = [r._replace(topic=names.get(r.topic, r.topic)) for r in raws_of(flown(SECONDS))]
    memory = Memory(raws)
    stream = SimpleNamespace(topics=frozenset(memory.topics), on=memory.raw)
    vehicle = TunerParameters(dvl=TunedDvl(noise_std=(0.02, 0.02, 0.02)))
    learned = LearnedOfDvl(stream, vehicle)  # type: ignore[arg-type]
    back = {IMU: "/imu", DVL: "/dvl", MEASUREMENT_NOISE: "/measurement_noise"}
    raws = list(learned.on({*memory.topics, MEASUREMENT_NOISE}))
    assert any(raw.topic == MEASUREMENT_NOISE for raw in raws)
    save(folder / "noisy", [r._replace(topic=back.get(r.topic, r.topic)) for r in raws])
    return folder


ADAPTIVE = ("--set", "dvl.noise_source=adaptive")
R_LEARNED = ("--set", "measurement_noise=true")


def test_an_r_that_is_to_be_learned_is_learned_in_place_of_a_recorded_one(
    with_noise: Path,
) -> None:
    told = (*ADAPTIVE, "--set", "dvl.noise_std=[0.1, 0.1, 0.1]")
    recorded = replayed(with_noise, *told, bag="noisy")
    assert recorded["measurement_noise"] == "adaptive, recorded"
    document = replayed(with_noise, *told, *R_LEARNED, bag="noisy")
    assert document["measurement_noise"] == (
        "adaptive, learned by the tuner, in place of the recorded"
    )
    without = replayed(with_noise, *told, *R_LEARNED)
    assert without["measurement_noise"] == "adaptive, learned by the tuner"
    assert document["nis_mean"] == without["nis_mean"] != recorded["nis_mean"]


@pytest.mark.parametrize("source", ["nominal", "oracle"])
def test_an_r_that_is_to_be_learned_and_that_nothing_would_use_is_refused(
    with_noise: Path, source: str, capsys: pytest.CaptureFixture[str]
) -> None:
    told = ("--set", f"dvl.noise_source={source}", *R_LEARNED)
    for bag in ("dive", "noisy"):
        replayed(with_noise, *told, bag=bag, code=2)
        assert capsys.readouterr().err.endswith(
            "parameter 'measurement_noise' of insdvl_tuner is set to True but would not be used: "
            f"dvl.noise_source is {source!r}; add --set dvl.noise_source=adaptive, or leave "
            "measurement_noise out\n"
        )
    # It is meant for the second one.
    compare = ("--compare", "dvl.noise_source=adaptive")
    document = replayed(with_noise, "--set", "dvl.noise_source=nominal", *R_LEARNED, *compare)
    assert document["compared"][0]["measurement_noise"] == "adaptive, learned by the tuner"


def test_a_tuner_that_is_off_learns_no_r(
    with_noise: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    off = ("--set", "insdvl_tuner:enabled=false", "--set", "process_noise.source=constant")
    replayed(with_noise, *ADAPTIVE, *R_LEARNED, *off, code=2)
    assert "the tuner is not enabled" in capsys.readouterr().err
