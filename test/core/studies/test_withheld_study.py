"""The study without a reference: nobody is taught by the recording that judges, and all predict."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from insdvl.navigation.events import NS, Initial
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.recordings.parameters import ReplayParameters
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import BASELINE
from insdvl.studies.evaluation.approaches import Setting
from insdvl.studies.evaluation.metrics import Track
from insdvl.studies.evaluation.sensors import Sensors
from insdvl.studies.evaluation.statistics import resamples
from insdvl.studies.judgement.withheld import WINDOWS, predictions
from insdvl.studies.replay.taken import Taken
from insdvl.studies.results import withheld
from insdvl.studies.results.recorded.predictions import against_hand_set
from insdvl.studies.results.recordings import Recording, Settings, stream_axes
from insdvl.studies.results.vehicle_runs import HAND_SET
from insdvl.studies.results.withheld import COLUMNS, FREE, TAUGHT, TAUGHT_CONSTANT, Shared
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.parameters import TunerParameters

HAND_SET_Q = (1e-2, 1e-7)  # ten times the true variances


@pytest.fixture(scope="module")
def settings() -> Settings:
    filter_ = Setting("calibrated", sensors=Sensors(dvl_std=0.02)).filter(HAND_SET_Q)
    return Settings(filter_, TunerParameters(), ReplayParameters())


def recorded(settings: Settings, name: str, seed: int) -> Recording:
    flown = simulate(
        list(BASELINE.values())[seed % 4],
        constant(np.repeat([1e-3, 1e-8], 3)),
        seed=seed,
        duration=100.0,
        dvl=DvlModel(noise_std=(0.02,) * 3),
    )
    start: Initial = drawn_initial(flown.initial, P_0, np.random.default_rng(seed))
    pings = zip(flown.dvl_stamps_ns.tolist(), flown.v_d, strict=True)
    every = slice(99, None, 100)
    v_b = np.einsum("kji,kj->ki", flown.truth.C_n_b, flown.truth.v_n)
    return Recording(
        name,
        flown.stamps_ns,
        np.hstack([flown.f_b, flown.w_ib_b]) @ stream_axes(settings),
        (start, *(Dvl(stamp_ns, v_d) for stamp_ns, v_d in pings)),
        flown.stamps_ns[every],
        Track(flown.truth.C_n_b[every], v_b[every], flown.truth.p_o[every]),
        {},
    )


@pytest.fixture(scope="module")
def recordings(settings: Settings) -> list[Recording]:
    return [recorded(settings, name, seed) for seed, name in enumerate("abc")]


def test_no_recording_is_among_its_own_teachers(
    recordings: list[Recording], settings: Settings
) -> None:
    parts = np.arange(3)
    altered = [replace(recordings[0], samples=1.5 * recordings[0].samples), *recordings[1:]]
    before, after = (
        withheld.taught_without((some, settings, parts), 0) for some in (recordings, altered)
    )
    for name, values in before.items():
        np.testing.assert_array_equal(after[name], values, err_msg=name)


@pytest.fixture(scope="module")
def rows(recordings: list[Recording], settings: Settings) -> Callable[[str, str], float]:
    found = withheld.taught_without((recordings, settings, np.arange(3)), 2)
    models = {row: withheld._model(found, row) for row in (TAUGHT, TAUGHT_CONSTANT)}
    shared = Shared(settings, {"c": recordings[2]}, {"c": models})
    scored = withheld.scored_rows(shared, "c")
    assert set(scored) == {
        HAND_SET,
        *(row + floor for row in (TAUGHT, TAUGHT_CONSTANT) for floor in ("", FREE)),
    }
    return lambda row, column: float(scored[row][COLUMNS.index(column)])


def test_all_rows_predict_the_same_pings(rows: Callable[[str, str], float]) -> None:
    for seconds in (10, 30):
        assert rows(HAND_SET, f"count {seconds} s") >= 1.0
        assert rows(TAUGHT + FREE, f"count {seconds} s") == rows(HAND_SET, f"count {seconds} s")


def test_what_the_dvl_teaches_predicts_it_better_than_ten_times_the_noise(
    rows: Callable[[str, str], float],
) -> None:
    column = "log_likelihood 10 s"
    assert rows(TAUGHT_CONSTANT + FREE, column) > rows(HAND_SET, column)


def test_only_the_first_ping_behind_each_window_is_scored(
    recordings: list[Recording], settings: Settings
) -> None:
    """Pings come each second from 1 s on; 20 s to recover, 10 s withheld, and again."""
    one = recordings[0]
    start, *pings = one.events
    seconds = [round((ping.stamp_ns - one.stamps_ns[0]) / NS) for ping in pings]
    scored = range(seconds[0] + 31, seconds[-1] + 1, 31)
    given = [
        ping
        for ping, second in zip(pings, seconds, strict=True)
        if not any(last - 10 <= second < last for last in scored)
    ]
    readings = one.samples @ stream_axes(settings).T
    folded = fold_arrays(
        settings.filter, one.stamps_ns, readings[:, :3], readings[:, 3:], [start, *given]
    )
    stamps_ns = {ping.stamp_ns for ping, s in zip(pings, seconds, strict=True) if s in scored}
    reports = [u.report for u in folded.updates if u.stamp_ns in stamps_ns]
    taken = Taken.of(one.stamps_ns, readings, one.events)
    used = {ping.stamp_ns for ping in pings}
    found = predictions(taken, settings.filter, used, 10.0)
    assert found is not None
    assert found.count == len(reports) == len(scored) == 3
    squares = [r.innovation @ r.innovation for r in reports]
    assert found.error == pytest.approx(np.sqrt(np.mean(squares)))
    assert found.sigma == pytest.approx(np.sqrt(np.mean([np.trace(r.S) for r in reports])))
    logs = [multivariate_normal(cov=r.S).logpdf(r.innovation) for r in reports]
    assert found.log_likelihood == pytest.approx(np.mean(logs))
    nis = np.array([r.innovation @ np.linalg.solve(r.S, r.innovation) for r in reports])
    assert found.nis_mean == pytest.approx(nis.mean())
    assert found.covered == np.mean(nis < chi2.ppf(0.95, 3))


def test_a_recording_too_short_for_a_length_is_left_out_of_it() -> None:
    """Two recordings of 2 and 6 pings; a third one has no window of 60 s."""

    def numbers(error: float, log_likelihood: float, has_60: bool = True) -> dict[str, float]:
        return {
            f"{name} {seconds:g} s": value if has_60 or seconds < 60.0 else np.nan
            for seconds in WINDOWS
            for name, value in (("error", error), ("log_likelihood", log_likelihood))
        }

    def of(count: float, *values: float, has_60: bool = True) -> dict[str, float]:
        counts = {f"count {s:g} s": count if has_60 or s < 60.0 else np.nan for s in WINDOWS}
        return counts | numbers(*values, has_60=has_60)

    hand_set = {"a": of(2.0, 1.0, -1.0), "b": of(6.0, 1.0, -1.0)}
    learned = {"a": of(2.0, 2.0, 0.0), "b": of(6.0, 2.0, 4.0)}
    short = {"c": of(8.0, 1.0, -1.0, has_60=False)}
    draws = resamples(np.arange(3), np.random.default_rng(3))
    found = against_hand_set({HAND_SET: hand_set | short, "learned": learned | short}, draws)
    of_60 = found["learned"]["60 s"]
    assert of_60["error"] == pytest.approx((2.0, 2.0, 2.0))
    middle, low, high = of_60["log_likelihood"]  # gains of 1 and 5
    assert (middle, low, high) == pytest.approx((4.0, 1.0, 5.0))
    of_10 = found["learned"]["10 s"]
    assert of_10["error"][0] == pytest.approx(np.sqrt((8.0 * 4.0 + 8.0) / 16.0))
    nobody = against_hand_set({HAND_SET: short, "learned": short}, draws[:, :1])
    assert np.isnan(nobody["learned"]["60 s"]["error"]).all()
