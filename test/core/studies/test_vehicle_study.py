"""The study on recordings: its runs are those of `insdvl replay`, and its comparison is fair."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import record, save

from insdvl import cli
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.recordings.base import BagError
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.replay.inputs.drawn_noise import DrawnNoise
from insdvl.studies.replay.scores import errors_of
from insdvl.studies.results import recordings, vehicle, vehicle_runs
from insdvl.studies.results.recordings import Settings
from insdvl.studies.results.vehicle_runs import AS_RECORDED, METRICS, Noise, NoisyRun, Shared
from insdvl.studies.results.vehicle_tables import vehicle_tables
from insdvl.tuner.models import load_model

SEED = 3
MODEL = "hcf paper"
CONFIG = """
/**/insdvl_filter:
  ros__parameters:
    dvl: {noise_std: [0.02, 0.02, 0.02]}
    gate: {enabled: GATE, probability: 0.9}
    process_noise:
      source: SOURCE
      accelerometer_variance: [3.0e-3, 2.0e-3, 1.0e-3]
      gyroscope_variance: [1.0e-8, 2.0e-8, 3.0e-8]
    initial: {mode: topic}
/**/insdvl_tuner:
  ros__parameters: {model: paper}
/**/insdvl_replay:
  ros__parameters:
    imu_topic: /imu
    dvl_topic: /dvl
    ground_truth_topic: /truth
    true_process_noise_topic: ''
"""


def config(folder: Path, source: str, *, gate: bool = False) -> Path:
    path = folder / f"{source}.yaml"
    path.write_text(CONFIG.replace("SOURCE", source).replace("GATE", f"{gate}"))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings; the second is the beginning of the first."""
    folder = tmp_path_factory.mktemp("voyage")
    for name, trajectory, duration in (("a", "circle", 20.0), ("b", "circle", 16.0), ("c", "", 18)):
        mission = simulate(
            BASELINE[trajectory or "straight"],
            constant([1e-4] * 3 + [1e-7] * 3),
            seed=5,
            duration=float(duration),
            start_ns=1_700_000_000_000_000_000,
        )
        save(folder / name, record(mission, every=50))
    (folder / "README.md").write_text("Not a recording.")
    return folder


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return Settings.load(config(tmp_path_factory.mktemp("config"), "constant"))


@pytest.fixture(scope="module")
def shared(folder: Path, settings: Settings) -> Shared:
    loaded = recordings.load_all(folder, settings)
    return Shared(settings, {r.name: r for r in loaded}, {MODEL: load_model("paper")})


def injection(shared: Shared, recording: str, name: str, role: int, index: int) -> Noise:
    of = shared.recordings[recording]
    return vehicle_runs.injection(shared.settings, of, name, SEED, role, index)


@pytest.fixture(scope="module")
def document(shared: Shared) -> dict[str, Any]:
    with open_pool(Workers(jobs=1)) as pool:
        return vehicle.study_recordings(
            list(shared.recordings.values()),
            shared.settings,
            shared.models,
            runs=2,
            tuning_runs=1,
            seed=SEED,
            pool=pool,
        )


@pytest.fixture(scope="module")
def rows_of_c(shared: Shared) -> dict[str, Any]:
    """All rows of a noisy recording, and the seed of the noise."""
    injected = injection(shared, "c", "sensor", vehicle_runs.TEST, 1)
    rows = vehicle_runs.all_rows(shared, NoisyRun("c", injected, {}))
    return {"injection": injected, "seed": injected.seed, "rows": rows}


@pytest.mark.parametrize("gate", [False, True])
@pytest.mark.parametrize(
    ("row", "source"), [("told", "oracle"), (MODEL, "external"), ("hand-set", "constant")]
)
def test_a_run_of_the_study_is_that_of_the_replay(
    folder: Path, rows_of_c: dict[str, Any], tmp_path: Path, row: str, source: str, gate: bool
) -> None:
    noise = ",".join(f"{limit!r}" for triad in vehicle_runs.INJECTIONS["sensor"] for limit in triad)
    arguments = ["replay", str(folder / "c"), "--config", str(config(tmp_path, source, gate=gate))]
    arguments += ["--inject-noise", noise, "--seed", str(rows_of_c["seed"])]
    assert cli.main([*arguments, "--json", str(tmp_path / "c.json")]) == 0
    expected = json.loads((tmp_path / "c.json").read_text())
    found = rows_of_c["rows"][row + (", gate on" if gate else "")]
    assert dict(zip(METRICS, found, strict=True)) == {name: expected[name] for name in METRICS}
    assert expected["reference_stamps"] > 30
    assert bool(expected["dvl_rejected"]) == gate


def test_a_recording_as_it_is_has_no_injected_noise_to_be_told(
    folder: Path, shared: Shared, tmp_path: Path
) -> None:
    rows = vehicle_runs.all_rows(shared, NoisyRun("c", None, {}))
    assert set(rows) == {MODEL, "closed form", "hand-set"}
    arguments = ["replay", str(folder / "c"), "--config", str(config(tmp_path, "constant"))]
    assert cli.main([*arguments, "--json", str(tmp_path / "c.json")]) == 0
    expected = json.loads((tmp_path / "c.json").read_text())
    expected["innovation_autocorrelation"] = expected["innovation_autocorrelation"][0]
    assert list(rows["hand-set"]) == [expected[name] for name in AS_RECORDED]


def test_the_honest_total_is_the_injected_and_the_hand_set_noise(
    shared: Shared, rows_of_c: dict[str, Any]
) -> None:
    settings, recording = shared.settings, shared.recordings["c"]
    q, noise = rows_of_c["injection"].draw(recording.stamps_ns)
    nominal = [3e-3, 2e-3, 1e-3, 1e-8, 2e-8, 3e-8]
    every = recording.stamps_ns - 10_000_000, q + nominal  # told with each sample
    samples = recording.samples + noise
    result = vehicle_runs.filtered(settings, recording, samples, settings.external(), every)
    errors = errors_of(result, recording.truth_ns, recording.truth)
    found = rows_of_c["rows"]["told with hand-set"][0]
    assert found == pytest.approx(errors["body_velocity_rmse"])


def test_noise_that_is_not_white_is_told_by_what_integrates(shared: Shared) -> None:
    """Its effective variances depend on the DVL of the recording."""
    for name in "vibrating", "coloured":
        noise = injection(shared, "a", name, vehicle_runs.TEST, 0)
        assert isinstance(noise, DrawnNoise)
        assert (noise.scenario, noise.dvl.rate) == (name, pytest.approx(1.0))
        assert noise.dvl.noise_std == (0.02,) * 3
        rows = vehicle_runs.all_rows(shared, NoisyRun("a", noise, {}))
        settings, recording = shared.settings, shared.recordings["a"]
        q, added = noise.draw(recording.stamps_ns)
        told = recording.stamps_ns - 10_000_000, q
        samples = recording.samples + added
        result = vehicle_runs.filtered(settings, recording, samples, settings.external(), told)
        errors = errors_of(result, recording.truth_ns, recording.truth)
        assert rows["told"][0] == pytest.approx(errors["body_velocity_rmse"])


def test_recordings_of_one_stretch_are_found(shared: Shared) -> None:
    assert recordings.stretches(list(shared.recordings.values())).tolist() == [0, 0, 1]


def test_every_run_has_its_own_noise(shared: Shared, document: dict[str, Any]) -> None:
    test = [
        seed
        for numbers in document["injections"].values()
        for seeds in numbers["seeds"].values()
        for seed in seeds
    ]
    tuning = [
        injection(shared, recording, "sensor", vehicle_runs.TUNING, k).seed
        for recording in shared.recordings
        for k in range(2)
    ]
    assert len(set(test)) == 6  # the injections are paired
    assert not set(test) & set(tuning)


def test_the_best_constant_has_not_seen_the_stretch_that_it_is_used_on(
    shared: Shared, document: dict[str, Any]
) -> None:
    for name, limits in vehicle_runs.INJECTIONS.items():
        numbers = document["injections"][name]
        candidates = vehicle.grid(limits)
        cost = {}
        for recording in shared.recordings.values():
            tried = vehicle_runs.constant_run(
                shared,
                NoisyRun(
                    recording.name,
                    injection(shared, recording.name, name, vehicle_runs.TUNING, 0),
                    {f"{i}": q for i, q in enumerate(candidates)},
                ),
            )
            cost[recording.name] = np.array([tried[f"{i}"][0] for i in range(len(candidates))])
        assert numbers["best_constant"]["a"] == candidates[int(np.argmin(cost["c"]))]
        assert numbers["best_constant"]["b"] == candidates[int(np.argmin(cost["c"]))]
        assert numbers["best_constant"]["c"] == candidates[int(np.argmin(cost["a"] + cost["b"]))]


def test_the_grid_spans_what_is_injected() -> None:
    q = np.array(vehicle.grid(((1e-4, 1e-2), (1e-6, 1e-6))))
    assert q.shape == (9, 2)
    np.testing.assert_allclose(np.unique(q[:, 0]), [1e-3, 9.9e-3 / np.log(100.0), 1e-2])
    np.testing.assert_allclose(q[:, 1], 1e-6)


def test_the_numbers_are_means_and_ratios_of_the_runs(
    shared: Shared, document: dict[str, Any]
) -> None:
    numbers = document["injections"]["published"]

    def rows(name: str, k: int) -> dict[str, Any]:
        injected = injection(shared, name, "published", vehicle_runs.TEST, k)
        return vehicle_runs.all_rows(shared, NoisyRun(name, injected, {}))

    runs = {name: [rows(name, k) for k in range(2)] for name in shared.recordings}
    heading = list(METRICS).index("heading_rmse_deg")
    mean = {
        row: np.mean([[run[row][heading] for run in runs[name]] for name in runs], axis=1)
        for row in (MODEL, "told")
    }
    found = numbers["rows"][MODEL]["heading_rmse_deg"]
    assert [found[name] for name in runs] == pytest.approx(mean[MODEL])
    assert found["mean"] == pytest.approx(np.mean(mean[MODEL]))
    middle, low, high = numbers["ratio_to"]["told"][MODEL]["heading_rmse_deg"]
    assert middle == pytest.approx(np.mean(mean[MODEL]) / np.mean(mean["told"]))
    # Whole stretches are drawn: the ends are those of the one or of the other stretch alone.
    alone = [
        np.sum(mean[MODEL][part]) / np.sum(mean["told"][part]) for part in (slice(2), slice(2, 3))
    ]
    assert (low, high) == pytest.approx((min(alone), max(alone)))


def test_what_is_kept_holds_for_the_same_inputs_only(folder: Path, shared: Shared) -> None:
    loaded, settings, models = list(shared.recordings.values()), shared.settings, shared.models
    first = recordings.fingerprint(loaded, settings, models)
    assert recordings.fingerprint(recordings.load_all(folder, settings), settings, models) == first
    other_filter = replace(settings, filter=replace(settings.filter, q_timeout=2.0))
    noisier = replace(loaded[0], samples=loaded[0].samples + 1e-9)
    for changed in (
        recordings.fingerprint(loaded, other_filter, models),
        recordings.fingerprint([noisier, *loaded[1:]], settings, models),
        recordings.fingerprint(loaded, settings, {}),
    ):
        assert changed != first


def test_the_tables_have_all_rows(document: dict[str, Any]) -> None:
    assert json.loads(json.dumps(document, allow_nan=False)) is not None
    text = vehicle_tables(document)
    for row in ("told", "told with hand-set", MODEL, "closed form", "hand-set", "best constant"):
        assert text.count(f"\n| {row} |") >= 2
    assert "| closed form, tilt |" in text
    clean = document["as_recorded"]["rows"]["closed form"]
    for metric, name in AS_RECORDED.items():
        if metric not in vehicle_runs.ERRORS:
            of_each = " | ".join(f"{clean[metric][recording]:.3f}" for recording in "abc")
            assert f"\n| closed form, {name} | {of_each} |" in text


def test_a_folder_that_cannot_be_used_is_refused(
    folder: Path, settings: Settings, tmp_path: Path
) -> None:
    with pytest.raises(BagError, match="absent is not a folder of recordings"):
        recordings.load_all(tmp_path / "absent", settings)
    with pytest.raises(BagError, match="has 0 recordings"):
        recordings.load_all(tmp_path, settings)
    for name in ("a", "b"):
        (tmp_path / name).symlink_to(folder / name)
    with pytest.raises(BagError, match="has 2 recordings; two of different stretches"):
        recordings.load_all(tmp_path, settings)
