"""The estimated noise of the DVL in the filter: what teaches it, and what it is worth."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl.navigation.events import NS, Imu
from insdvl.navigation.gate.gate import Gate
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.navigation.state.fields import NEVER
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV, STATIC
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays
from insdvl.timeline.state_file import decode, encode

SEED = 271_828
VARIANCES = np.array([1e-4] * 3 + [1e-8] * 3)
STD = 0.02  # m/s, of the DVL
SOURCES = ("adaptive", "learned")
#: What the filter has learned, without what only carries the pings to the present.
TAUGHT = (
    *("factor", "probabilities", "learned_ns", "pings_ns"),
    *("squares", "squares_ns", "product", "square", "pairs", "innovation"),
)


def parameters(source: str, q_factor: float = 1.0, *, gate: bool = True) -> FilterParameters:
    q = q_factor * VARIANCES
    return FilterParameters(
        frame_convention="ned",
        dvl=DvlParameters(noise_std=(STD,) * 3, noise_source=source, noise_floor=0.002),
        gate=GateParameters(enabled=gate),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=tuple(q[:3].tolist()), gyroscope_variance=tuple(q[3:].tolist())
        ),
        initial=P_0,
        origin=OriginParameters(height=float(AUV.h_0)),
    )


def mission(duration: float = 20.0, seed: int = SEED, std: float = STD, **dvl: object) -> Mission:
    model = DvlModel(noise_std=(std,) * 3, rate=5.0, **dvl)
    return simulate(AUV, constant(VARIANCES), seed=seed, duration=duration, dvl=model)


def pings(m: Mission) -> list[Dvl]:
    return [Dvl(stamp, v_d) for stamp, v_d in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)]


def fly(settings: FilterParameters, m: Mission, measured: list[Dvl]) -> FoldResult:
    start = drawn_initial(m.initial, settings.initial, np.random.default_rng([SEED, 1]))
    return fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start, *measured])


def taught(result: FoldResult) -> dict[str, np.ndarray]:
    return {name: result.states["dvl_noise"][name] for name in TAUGHT}


def rmse(result: FoldResult, m: Mission, after: float = 10.0) -> float:
    """Of the body velocity."""
    first = np.searchsorted(m.stamps_ns, after * NS)
    v = [
        np.einsum("kji,kj->ki", track["C_n_b"], track["v_n"])[first:]
        for track in (result.track, vars(m.truth))
    ]
    return float(np.sqrt(np.mean(np.sum((v[0] - v[1]) ** 2, axis=1))))


# ------------------------------------------------------------------ one state on all ways


@pytest.mark.parametrize("source", SOURCES)
def test_online_late_and_resumed_are_the_offline_run_to_the_bit(source: str) -> None:
    settings, m = parameters(source), mission(8.0)
    expected = fly(settings, m, pings(m)).states[-1:]
    start = drawn_initial(m.initial, settings.initial, np.random.default_rng([SEED, 1]))
    samples = [Imu(t, f, w) for t, f, w in zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True)]
    rng = np.random.default_rng(3)
    late = [(event.stamp_ns + int(rng.uniform(0.0, 1.5) * NS), event) for event in pings(m)]
    order = sorted([*late, *((s.stamp_ns, s) for s in samples)], key=lambda pair: pair[0])

    fold = Fold(settings, len(samples))
    fold.add(start)
    for _, event in order:
        fold.add(event)
    assert fold.latest.tobytes() == expected.tobytes()

    half = samples[len(samples) // 2 - 5].stamp_ns  # 5 samples behind a ping
    events = sorted([*samples, *pings(m)], key=lambda event: event.stamp_ns)
    first = Fold(settings, len(samples))
    first.add(start)
    for event in events:
        if event.stamp_ns <= half:
            first.add(event)
    record = decode(encode(first.latest, settings), first.filter)
    second = Fold(settings, len(samples))
    second.resume(record, settings)
    for event in events:
        if event.stamp_ns > half:
            second.add(event)
    assert second.latest.tobytes() == expected.tobytes()


# ------------------------------------------------------------------ what teaches


def test_a_refused_ping_does_not_teach() -> None:
    m = mission()
    good = pings(m)
    wild = replace(good[-1], v_d=good[-1].v_d + np.array([0.0, 1.0, 0.0]))
    refused = fly(parameters("adaptive"), m, [*good[:-1], wild])
    assert refused.updates[-1].report.reason == "gate"
    without = fly(parameters("adaptive"), m, good[:-1])
    for name, value in taught(refused).items():
        np.testing.assert_array_equal(value[-1], taught(without)[name][-1], err_msg=name)


def test_a_ping_that_refuses_itself_does_not_teach() -> None:
    """Exact zeros of a vehicle that moves: no lock."""
    m = mission()
    good = pings(m)
    result = fly(parameters("adaptive"), m, [*good[:-1], replace(good[-1], v_d=np.zeros(3))])
    assert result.updates[-1].report.reason == "no_lock"
    without = fly(parameters("adaptive"), m, good[:-1])
    for name, value in taught(result).items():
        np.testing.assert_array_equal(value[-1], taught(without)[name][-1], err_msg=name)


def test_exact_zeros_at_rest_do_not_teach() -> None:
    """They are used, by their nominal noise, and tell nothing of the DVL's or the IMU's."""
    m = simulate(
        STATIC,
        constant(VARIANCES),
        seed=SEED,
        duration=40.0,
        dvl=DvlModel(noise_std=(STD,) * 3, rate=5.0),
    )
    good = pings(m)
    at_rest = [replace(ping, v_d=np.zeros(3)) for ping in good[100:]]
    settings = parameters("adaptive")
    of_q = replace(settings.process_noise, adaptive_factor=True)
    settings = replace(settings, process_noise=of_q)
    result = fly(settings, m, [*good[:100], *at_rest])
    used = [update for update in result.updates[100:] if update.report.accepted]
    assert len(used) > 50
    without = fly(settings, m, good[:100])
    learned_ns = [r.states["q_factor"]["learned_ns"][-1] for r in (result, without)]
    assert learned_ns == [good[99].stamp_ns] * 2
    for name, value in taught(result).items():
        np.testing.assert_array_equal(value[-1], taught(without)[name][-1], err_msg=name)


def test_nothing_is_learned_while_the_imu_is_in_doubt() -> None:
    """The accelerometers freeze; the pings are used, and their noise stays as it was known."""
    m = mission()
    at = np.searchsorted(m.stamps_ns, 10 * NS)
    m.f_b[at:] = m.f_b[at]
    result = fly(parameters("adaptive"), m, pings(m))
    doubted = result.states["channels"]["unseen_ns"].max(axis=1) != NEVER
    first = int(np.argmax(doubted))
    assert doubted[first:].all() and first < at + 100
    used = [u for u in result.updates if u.stamp_ns > m.stamps_ns[first] and u.report.accepted]
    assert len(used) > 20
    for name, value in taught(result).items():
        np.testing.assert_array_equal(value[-1], value[first], err_msg=name)


def test_a_ping_that_is_used_softly_or_doubted_does_not_teach(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The gate gives such a ping a larger R."""
    m, meet = mission(4.0), Gate.meet

    def softly(self, state, stamp_ns, linearised):
        now, accepted = meet(self, state, stamp_ns, linearised)
        return now._replace(R=2.0 * now.R) if stamp_ns > 2 * NS else now, accepted

    usual = taught(fly(parameters("adaptive"), m, pings(m)))
    monkeypatch.setattr(Gate, "meet", softly)
    result = fly(parameters("adaptive"), m, pings(m))
    assert all(update.report.accepted for update in result.updates)
    at = np.searchsorted(m.stamps_ns, 2 * NS) + 1
    for name, value in taught(result).items():
        np.testing.assert_array_equal(value[-1], value[at], err_msg=name)
    assert (usual["probabilities"][-1] != usual["probabilities"][at]).any()


def test_a_filter_that_begins_to_estimate_begins_with_the_nominal_noise() -> None:
    s = fly(parameters("nominal"), mission(1.0), []).states[-1]
    assert s["dvl_noise"]["factor"] == 0.0
    m = mission(2.0)
    factor = fly(parameters("adaptive"), m, pings(m)[:1]).states["dvl_noise"]["factor"]
    assert factor[0] == 1.0


# ------------------------------------------------------------------ what it finds


def factors(source: str, m: Mission, **settings: object) -> np.ndarray:
    result = fly(parameters(source, **settings), m, pings(m))
    return result.states["dvl_noise"]["factor"]


@pytest.mark.parametrize("source", SOURCES)
def test_a_noise_that_is_half_of_the_nominal_is_found(source: str) -> None:
    """A factor of 0.25, by its geometric mean over the last 30 s: 3 memories of the estimate."""
    found = factors(source, mission(40.0, std=0.5 * STD))[1000:]
    assert np.exp(np.mean(np.log(found))) == pytest.approx(0.25, rel=0.3)


def test_a_window_that_is_older_than_a_minute_tells_nothing() -> None:
    """From 20 s on one ping in 4 s: four of them are not compared, and the rest gets old."""
    m = mission(90.0, std=0.5 * STD)
    slow = [ping for k, ping in enumerate(pings(m)) if k < 100 or k % 20 == 0]
    states = fly(parameters("learned"), m, slow).states
    seconds = (states["nav"]["time_ns"] - m.start_ns) / NS
    found = states["dvl_noise"]["factor"]
    assert np.all(found[(seconds > 25.0) & (seconds < 75.0)] < 0.6)
    assert np.all(found[seconds > 85.0] == 1.0)


def test_without_noise_the_sigma_is_that_of_the_floor() -> None:
    found = factors("adaptive", mission(std=1e-6))
    assert np.sqrt(found[-1]) * STD == pytest.approx(0.002, rel=1e-6)


def test_the_gate_judges_by_twice_the_nominal_sigma_or_more() -> None:
    """A quiet DVL of which a ping is off by 6 nominal sigma: not refused, though 60 of its own."""
    m = mission(std=0.1 * STD)
    good = pings(m)
    off = replace(good[-1], v_d=good[-1].v_d + np.array([0.0, 0.12, 0.0]))
    report = fly(parameters("adaptive"), m, [*good[:-1], off]).updates[-1].report
    assert report.accepted
    assert report.nis > 100.0  # by what was learned before it


@pytest.mark.long
def test_a_step_from_5_to_100_mm_s_and_back() -> None:
    """RMSE at most 1.1 of that of the filter that is told the noise, with the gate on.

    The nominal sigma is 50 mm/s: by what the gate takes, it must be half of the largest.
    """
    ratios = []
    for seed in range(8):
        m = mission(120.0, seed=seed, std=1.0)
        rng = np.random.default_rng([SEED, seed])
        sigma = np.where(np.sin(m.dvl_stamps_ns / NS * 2 * np.pi / 60.0) > 0.0, 0.1, 0.005)
        error = sigma[:, None] * rng.standard_normal(m.v_d.shape)
        true = m.v_d - ideal_error(m)
        measured = [Dvl(int(t), v) for t, v in zip(m.dvl_stamps_ns, true + error, strict=True)]
        told = [replace(ping, R=s**2 * np.eye(3)) for ping, s in zip(measured, sigma, strict=True)]
        settings = parameters("nominal", gate=False)
        known = replace(settings, dvl=replace(settings.dvl, covariance="message"))
        adaptive = parameters("adaptive")
        adaptive = replace(adaptive, dvl=replace(adaptive.dvl, noise_std=(0.05,) * 3))
        ratios.append((rmse(fly(adaptive, m, measured), m), rmse(fly(known, m, told), m)))
    estimated, oracle = np.mean(ratios, axis=0)
    assert estimated / oracle < 1.1


def ideal_error(m: Mission) -> np.ndarray:
    """Errors (N, 3) of the pings of a mission, whose DVL has no arm."""
    at = np.searchsorted(m.stamps_ns, m.dvl_stamps_ns)
    v_b = np.einsum("kji,kj->ki", m.truth.C_n_b[at], m.truth.v_n[at])
    return m.v_d - v_b


@pytest.mark.long
@pytest.mark.parametrize("q_factor", [0.01, 100.0])
def test_a_wrong_constant_q_does_not_push_r_away(q_factor: float) -> None:
    """At most 1.03 of the RMSE with the constant R, which is right; 8 flights of 2 minutes."""
    errors = []
    for seed in range(8):
        m = mission(120.0, seed=seed)
        errors.append(
            [
                rmse(fly(parameters(s, q_factor, gate=False), m, pings(m)), m, 30.0)
                for s in ("adaptive", "nominal")
            ]
        )
    estimated, nominal = np.mean(errors, axis=0)
    assert estimated < 1.03 * nominal


@pytest.mark.long
def test_outliers_of_1_m_s_cost_at_most_5_percent() -> None:
    """5 % of them; against the same flights without those pings, gate on."""
    errors = []
    for seed in range(8):
        m = mission(120.0, seed=seed, outlier_probability=0.05, outlier_size=1.0)
        both = pings(m), pings(m.without_outliers())
        errors.append([rmse(fly(parameters("adaptive"), m, p), m) for p in both])
    with_them, without = np.mean(errors, axis=0)
    assert with_them < 1.05 * without
