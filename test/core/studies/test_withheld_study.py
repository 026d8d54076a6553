"""The study without a reference: nobody is taught by the recording that judges, and all predict."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from insdvl.navigation.events import Initial
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
from insdvl.studies.results import withheld
from insdvl.studies.results.recordings import Recording, Settings, stream_axes
from insdvl.studies.results.vehicle_runs import HAND_SET
from insdvl.studies.results.withheld import COLUMNS, FREE, TAUGHT, TAUGHT_CONSTANT, Shared
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
