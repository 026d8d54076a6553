"""What a measurement says of itself: too fast, no lock, a repetition that is none by chance."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import poisson

from insdvl.navigation.events import NS
from insdvl.navigation.filter import LAYOUT, Filter
from insdvl.navigation.measurements import claims
from insdvl.navigation.measurements.base import SensorModel
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    InitialParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.navigation.state.fields import READINGS
from insdvl.simulation.initial_errors import drawn_initial
from insdvl.simulation.mission import ImuModel, Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 271_828
VARIANCES = [1e-4] * 3 + [1e-6] * 3
FILL = -32.768  # m/s: the smallest 16-bit number, in mm/s
HOUR = 18_000  # measurements, at 5 Hz


def parameters(**dvl: object) -> FilterParameters:
    return FilterParameters(
        frame_convention="ned",
        dvl=DvlParameters(**({"noise_std": (0.02,) * 3} | dvl)),
        gate=GateParameters(),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=tuple(VARIANCES[:3]), gyroscope_variance=tuple(VARIANCES[3:])
        ),
        initial=InitialParameters(mode="set_odometry", velocity_std=0.02, heading_std=0.01),
        origin=OriginParameters(height=float(AUV.h_0)),
    )


def mission(duration: float) -> Mission:
    dvl = DvlModel(noise_std=(0.02,) * 3)
    return simulate(AUV, constant(VARIANCES), seed=SEED, duration=duration, imu=ImuModel(), dvl=dvl)


def fly(m: Mission, v_d: np.ndarray, settings: FilterParameters | None = None) -> FoldResult:
    settings = settings or parameters()
    start = drawn_initial(m.initial, settings.initial, np.random.default_rng([SEED, 1]))
    pings = [Dvl(t, v) for t, v in zip(m.dvl_stamps_ns.tolist(), v_d, strict=True)]
    pings = [ping for ping in pings if not np.isnan(ping.v_d).any()]
    return fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start, *pings])


# ------------------------------------------------------------------ too fast


def fill(kind: str, v_d: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What a DVL without bottom lock reports in place of velocities (M, 3)."""
    filled = np.full_like(v_d, FILL)
    if kind == "z":
        filled[:, :2] = v_d[:, :2]
    elif kind == "with zeros in turn":
        filled[1::2] = 0.0
    elif kind == "rounded":
        filled += rng.uniform(-1e-3, 1e-3, v_d.shape)
    return filled


@pytest.mark.parametrize(
    "kind",
    [
        "z",
        "all",
        pytest.param("with zeros in turn", marks=pytest.mark.long),
        pytest.param("rounded", marks=pytest.mark.long),
    ],
)
def test_fill_values_are_as_no_measurement_for_however_long(kind: str) -> None:
    """To the bit, for 140 s, over twice gate.max_rejection_time; a good one is used at once."""
    m = mission(220.0)
    lost = slice(60, 200)
    v_d, absent = m.v_d.copy(), m.v_d.copy()
    v_d[lost] = fill(kind, m.v_d[lost], np.random.default_rng(SEED))
    absent[lost] = np.nan
    spoilt = fly(m, v_d)
    reasons = [u.report.reason for u in spoilt.updates]
    assert set(reasons[lost]) <= {"too_fast", "no_lock"}
    assert reasons.count("too_fast") == (70 if kind == "with zeros in turn" else 140)
    assert reasons[200] == ""
    assert spoilt.states.tobytes() == fly(m, absent).states.tobytes()


@pytest.mark.parametrize("unit", [100.0, 1000.0])
def test_another_unit_is_refused_from_the_start(unit: float) -> None:
    m = mission(20.0)
    result = fly(m, unit * m.v_d)
    refused = sum(result.refused.values()) + len(result.updates)
    assert refused == len(m.v_d)
    assert all(u.report.reason == "too_fast" for u in result.updates)


def test_a_faster_vehicle_is_told() -> None:
    """The norm counts."""
    model = Filter(parameters(max_speed=20.0)).models["dvl"]
    memory = LAYOUT.empty()[0]["gate"]["dvl"]
    for v_d, reason in (([0.0, 12.0, 15.9], ""), ([0.0, 12.0, 16.1], "too_fast")):
        assert claims.refusal(memory, model, Dvl(0, np.array(v_d))) == reason


# ------------------------------------------------------------------ repetitions


@cache
def model_of(noise_std: float) -> SensorModel:
    return Filter(parameters(noise_std=(noise_std,) * 3)).models["dvl"]


def refused(v_d: np.ndarray, noise_std: float = 0.02) -> np.ndarray:
    """(M,) which velocities (M, 3), one after the other, are refused as repeated."""
    model = model_of(noise_std)
    memory = LAYOUT.empty()[0]["gate"]["dvl"]
    reasons = [claims.refusal(memory, model, Dvl(0, v)) for v in v_d]
    assert set(reasons) <= {"", "repeated"}
    return np.array(reasons) == "repeated"


def read(noise: float, count: int, seed: int = SEED) -> np.ndarray:
    """(count, 3) of a DVL in whole mm/s at rest, just not at exact zeros."""
    rng = np.random.default_rng(seed)
    v_d = np.round([0.002, -0.001, 0.1] + noise * rng.standard_normal((count, 3)), 3)
    return v_d[v_d.any(axis=1)]


@pytest.mark.parametrize(
    ("noise", "noise_std"), [(0.01, 0.1), (0.006, 0.01), (0.002, 0.1), (0.0005, 0.01)]
)
def test_an_honest_dvl_in_whole_mm_per_s_at_rest_is_used(noise: float, noise_std: float) -> None:
    """At most one of a thousand is refused, in an hour, also where half of them are repetitions."""
    v_d = read(noise, HOUR)
    assert refused(v_d, noise_std).mean() <= claims.LEAST_CHANCE


def test_repetitions_are_as_frequent_as_the_bound_says() -> None:
    """8 choices, each (1 / (2 sqrt(pi) 3))^3 with a noise of three steps: 0.66 %."""
    v_d = read(0.003, 2 * HOUR)
    known = np.full(3, 0.003)
    bound = READINGS * (1.0 / (6.0 * np.sqrt(np.pi))) ** 3
    again = [(v_d[k - READINGS : k] == v_d[k]).all(axis=1).sum() for k in range(READINGS, len(v_d))]
    assert np.mean(again) == pytest.approx(bound, rel=0.2)
    # With eight readings whose scatter is that noise, the rule has the same number.
    apart = np.sqrt(2.0) * 0.003 * np.tile([1.0, -1.0], 4)[:, None] / 2.0 * np.ones(3)
    apart = np.round(apart, 3)
    scatter = np.sqrt(np.mean(np.diff(apart, axis=0) ** 2, axis=0) / 2.0)
    chance = claims.repeat_chance(apart[3], apart[3:4], known)
    assert chance == pytest.approx(bound / READINGS, rel=1e-9)
    assert claims.repeat_chance(np.array([1.0, 2.0, 3.0]), apart, scatter) == 1.0


@pytest.mark.parametrize("form", ["double", "single"])
def test_a_real_repetition_is_refused(form: str) -> None:
    """From the first one on, for however long; also where two values come in turn."""
    rng = np.random.default_rng(SEED)
    v_d = [1.0, 0.1, 0.0] + 0.02 * rng.standard_normal((40, 3))
    if form == "single":
        v_d = v_d.astype(np.float32).astype(float)
    for before in (1, 2, 5, 20):
        held = np.concatenate([v_d[:before], np.tile(v_d[before - 1], (300, 1)), v_d[before:]])
        assert refused(held).tolist() == [False] * before + [True] * 300 + [False] * (40 - before)
    in_turn = np.concatenate([v_d[:20], np.tile(v_d[18:20], (50, 1)), v_d[20:]])
    assert refused(in_turn).tolist() == [False] * 20 + [True] * 100 + [False] * 20


@pytest.mark.parametrize("in_turn", [1, 2])
def test_real_repetitions_in_whole_mm_per_s_are_refused(in_turn: int) -> None:
    """Of a noise of 1 cm/s: chance would make one in 5,000, so even the first one is refused.

    It passes where the scatter of seven differences is so small, by chance, that the noise of all
    three components together looks a fifth of what it is (ln 5.5 is three sigma): less than 1 %.
    """
    passed = []
    for seed in range(200):
        v_d = read(0.01, 10, seed)
        held = np.concatenate([v_d, np.tile(v_d[-in_turn:], (20 // in_turn, 1))])
        passed.append(np.count_nonzero(~refused(held)[len(v_d) :]))
    assert np.count_nonzero(passed) <= poisson.ppf(0.9999, 0.01 * len(passed))
    assert np.max(passed) <= 2 * in_turn


def test_a_coarse_dvl_that_hangs_is_refused_when_chance_has_run_out() -> None:
    """Noise of two steps: each of them alone is likely, three in a row are not."""
    passed = []
    for seed in range(100):
        v_d = read(0.002, 10, seed)
        held = np.concatenate([v_d, np.tile(v_d[-1], (30, 1))])
        passed.append(np.count_nonzero(~refused(held)[len(v_d) :]))
    assert np.mean(passed) < 3.0


def refused_along_x(speeds: np.ndarray, noise_std: float = 0.1) -> np.ndarray:
    """(M,) which speeds (M,) of a log that measures one axis are refused as repeated."""
    model, memory = model_of(noise_std), LAYOUT.empty()[0]["gate"]["dvl"]
    reasons = [
        claims.refusal(memory, model, Dvl(0, np.array([u, 0.0, 0.0]), None, (True, False, False)))
        for u in speeds
    ]
    assert set(reasons) <= {"", "repeated"}
    return np.array(reasons) == "repeated"


def test_a_log_along_one_axis_in_whole_mm_per_s_is_used() -> None:
    """Its two zeros are no evidence: one component repeats itself by chance, in the first as well.

    Until four are known the noise is 0.1 m/s, as told, though it is 1 to 10 mm/s: chance makes a
    second repetition once in 10,000, so a few may be refused then.
    """
    shares = []
    for noise in (0.001, 0.002, 0.01):
        for seed in range(50):
            rng = np.random.default_rng([SEED, seed])
            speeds = np.round(1.0 + noise * rng.standard_normal(120), 3)
            shares.append(refused_along_x(speeds).mean())
    assert np.mean(shares) < 0.01


def test_a_log_along_one_axis_that_hangs_is_refused() -> None:
    """With full digits from the first repetition on, in whole mm/s when chance has run out."""
    speeds = 1.0 + 0.02 * np.random.default_rng(SEED).standard_normal(20)
    held = np.concatenate([speeds, np.full(100, speeds[-1])])
    assert refused_along_x(held).tolist() == [False] * 20 + [True] * 100
    coarse = refused_along_x(np.round(held, 3))
    assert not coarse[:20].any()
    assert coarse[25:].all()


def test_the_step_of_a_stream_is_found_in_single_precision() -> None:
    rng = np.random.default_rng(SEED)
    for step in (0.01, 1e-3, 1e-4):
        values = np.round(rng.uniform(-3.0, 3.0, (9, 3)) / step) * step
        assert claims.resolution(values) == step
        assert claims.resolution(values.astype(np.float32).astype(float)) == step
    assert claims.resolution(rng.uniform(-3.0, 3.0, (9, 3))) == claims.RESOLUTIONS[-1]


def test_what_is_refused_is_not_remembered() -> None:
    model, memory = Filter(parameters()).models["dvl"], LAYOUT.empty()[0]["gate"]["dvl"]
    good = np.array([1.01, 0.02, 0.03])
    assert claims.refusal(memory, model, Dvl(NS, good)) == ""
    before = memory.tobytes()
    for v_d in (np.zeros(3), np.full(3, FILL)):
        assert claims.refusal(memory, model, Dvl(2 * NS, v_d)) != ""
        assert memory.tobytes() == before
