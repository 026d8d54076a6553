"""A covariance of the DVL's noise that is received: when it is in effect, and its bounds."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl.navigation.events import NS, Event, Imu, SensorNoise, refusal
from insdvl.navigation.measurement_noise.source import LARGEST, InForce
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import (
    DvlParameters,
    FilterParameters,
    GateParameters,
    OriginParameters,
    ProcessNoiseParameters,
)
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.fold import Fold
from insdvl.timeline.recorded import fold_arrays
from insdvl.timeline.state_file import decode, encode

SEED = 161_803
VARIANCES = np.array([1e-4] * 3 + [1e-8] * 3)
STD = 0.02  # m/s, of the DVL, true and nominal
SOURCES = ("adaptive", "learned")
AT = 6 * NS + NS // 20  # between two pings
TIMEOUT = 3.0


def parameters(source: str, q_factor: float = 1.0) -> FilterParameters:
    q = q_factor * VARIANCES
    return FilterParameters(
        frame_convention="ned",
        q_timeout=TIMEOUT,
        dvl=DvlParameters(noise_std=(STD,) * 3, noise_source=source, noise_floor=0.002),
        gate=GateParameters(enabled=False),
        process_noise=ProcessNoiseParameters(
            accelerometer_variance=tuple(q[:3].tolist()), gyroscope_variance=tuple(q[3:].tolist())
        ),
        initial=P_0,
        origin=OriginParameters(height=float(AUV.h_0)),
    )


def mission(duration: float = 12.0, q_factor: float = 1.0) -> Mission:
    model, q = DvlModel(noise_std=(STD,) * 3, rate=5.0), q_factor * VARIANCES
    return simulate(AUV, constant(q), seed=SEED, duration=duration, dvl=model)


def pings(m: Mission) -> list[Dvl]:
    return [Dvl(stamp, v_d) for stamp, v_d in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)]


def samples(m: Mission) -> list[Imu]:
    rows = zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True)
    return [Imu(stamp, f, w) for stamp, f, w in rows]


def received(factor: float, stamp_ns: int = AT) -> SensorNoise:
    return SensorNoise(stamp_ns, "dvl", factor * STD**2 * np.eye(3))


def start(m: Mission, settings: FilterParameters) -> Event:
    return drawn_initial(m.initial, settings.initial, np.random.default_rng([SEED, 1]))


def factors(settings: FilterParameters, m: Mission, *events: Event) -> np.ndarray:
    """The factor in effect at the end of each sample."""
    result = fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start(m, settings), *events])
    return np.array(result.states["dvl_noise"]["factor"])


def test_it_is_in_effect_from_its_stamp_until_the_timeout() -> None:
    """Of two pings before and behind the stamp the first has the filter's own window."""
    m, settings = mission(), parameters("learned")
    own = factors(settings, m, *pings(m))
    told = factors(settings, m, *pings(m), received(3.0))
    before = m.stamps_ns < AT + NS // 10  # the next ping is at 6.2 s
    np.testing.assert_array_equal(told[before], own[before])
    during = (m.stamps_ns >= AT + NS // 5) & (m.stamps_ns < AT + TIMEOUT * NS)
    np.testing.assert_allclose(told[during], 3.0)
    after = m.stamps_ns > AT + (TIMEOUT + 0.3) * NS
    # The corrections of the two have turned the pings a little differently.
    np.testing.assert_allclose(told[after], own[after], rtol=1e-2)


def test_the_noise_in_force_is_told_with_where_it_is_from() -> None:
    m, settings = mission(), parameters("learned")

    def in_force(seconds: float, *events: Event) -> InForce:
        fold = Fold(settings)
        for event in (start(m, settings), *pings(m), *events, *samples(m)):
            if event.stamp_ns <= seconds * NS:
                fold.add(event)
        state = fold.latest
        assert state is not None
        noise = fold.filter.noise_in_force(state, "dvl")
        assert noise is not None and noise.factor == state["dvl_noise"]["factor"]
        return noise

    assert in_force(0.5) == InForce(1.0, {"nominal": 1.0}, None, timed_out=False)
    own = in_force(6.0)
    assert (own.text, own.age_ns, own.timed_out) == ("own window", None, False)
    told = in_force(7.0, received(4.0))
    assert (told.text, told.age_ns, told.timed_out) == ("received", 7 * NS - AT, False)
    assert told.factor == pytest.approx(4.0)
    old = in_force(10.0, received(4.0))
    assert (old.text, old.timed_out) == ("own window", True)
    settings = parameters("adaptive", q_factor=100.0)
    mixed = in_force(12.0, received(4.0))
    assert set(mixed.origins) <= {"innovations", "own window"}
    assert sum(mixed.origins.values()) == pytest.approx(1.0)
    settings = parameters("nominal")
    assert Fold(settings).filter.noise_in_force(Fold(settings).filter.empty()[0], "dvl") is None


def test_of_the_stamp_of_a_ping_it_is_that_ping_s() -> None:
    m, settings = mission(8.0), parameters("learned")
    stamp = int(m.dvl_stamps_ns[20])
    told = factors(settings, m, *pings(m), received(3.0, stamp))
    assert told[np.searchsorted(m.stamps_ns, stamp)] == pytest.approx(3.0)


def test_what_a_message_tells_of_single_pings_stays_in_theirs() -> None:
    """Twice the nominal covariance of its ping, and of each that follows twice its own."""
    m, settings = mission(8.0), parameters("learned")
    R = [STD**2 * (1.0 + k % 3) * np.eye(3) for k in range(len(m.v_d))]
    measured = [replace(ping, R=R_0) for ping, R_0 in zip(pings(m), R, strict=True)]
    event = SensorNoise(measured[20].stamp_ns, "dvl", 2.0 * R[20])
    told = factors(settings, m, *measured, event)
    since = m.stamps_ns - event.stamp_ns
    np.testing.assert_allclose(told[(since >= 0) & (since < TIMEOUT * NS)], 2.0)


@pytest.mark.parametrize(("factor", "limit"), [(1e-6, 0.01), (1e6, LARGEST)])
def test_it_has_the_bounds_of_the_own_estimate(factor: float, limit: float) -> None:
    """A floor of 2 mm/s where 20 are nominal."""
    m = mission(8.0)
    told = factors(parameters("learned"), m, *pings(m), received(factor))
    assert told[-1] == pytest.approx(limit)


@pytest.mark.parametrize("factor", [0.25, 4.0])
@pytest.mark.parametrize("q_factor", [1e-3, 1e3])
def test_beside_a_wrong_q_it_is_what_the_adaptive_estimate_goes_to(
    q_factor: float, factor: float
) -> None:
    """To the received factor, also where that is wrong; without it to the own window's, about 1.

    The IMU is noisy enough for Q to matter from ping to ping.
    """
    m, settings = mission(20.0, 100.0), parameters("adaptive", 100.0 * q_factor)
    events = [received(factor, AT + k * NS) for k in range(14)]
    assert factors(settings, m, *pings(m), *events)[-1] == pytest.approx(factor)
    assert 0.5 < factors(settings, m, *pings(m))[-1] < 2.0


def test_a_filter_of_nominal_noise_does_not_take_it() -> None:
    m, settings = mission(8.0), parameters("nominal")
    results = [
        fold_arrays(settings, m.stamps_ns, m.f_b, m.w_ib_b, [start(m, settings), *pings(m), *some])
        for some in ([], [received(3.0, int(m.dvl_stamps_ns[20]))])
    ]
    np.testing.assert_array_equal(results[0].track["v_n"], results[1].track["v_n"])


@pytest.mark.parametrize("source", SOURCES)
def test_late_doubled_and_resumed_are_the_offline_run_to_the_bit(source: str) -> None:
    m, settings = mission(9.0), parameters(source)
    noise = [received(2.0), received(0.5, AT + NS)]
    expected = fold_arrays(
        settings, m.stamps_ns, m.f_b, m.w_ib_b, [start(m, settings), *pings(m), *noise]
    ).states[-1:]

    late = Fold(settings, len(m.stamps_ns))
    arrivals = [(event.stamp_ns, event) for event in [*samples(m), *pings(m)]]
    arrivals += [(event.stamp_ns + delay, event) for event in noise for delay in (0, NS, NS + 1)]
    late.add(start(m, settings))
    for _, event in sorted(arrivals, key=lambda pair: pair[0]):
        late.add(event)
    assert late.latest.tobytes() == expected.tobytes()

    half = AT + NS // 2  # the first one is in effect
    events = sorted([*samples(m), *pings(m), *noise], key=lambda event: event.stamp_ns)
    first = Fold(settings, len(m.stamps_ns))
    first.add(start(m, settings))
    for event in events:
        if event.stamp_ns <= half:
            first.add(event)
    record = decode(encode(first.latest, settings), first.filter)
    second = Fold(settings, len(m.stamps_ns))
    second.resume(record, settings)
    for event in events:
        if event.stamp_ns > half:
            second.add(event)
    assert second.latest.tobytes() == expected.tobytes()


def test_a_restart_of_the_state_keeps_it() -> None:
    """What was received is of the sensor, not of the state."""
    m, settings = mission(9.0), parameters("learned")
    again = replace(start(m, settings), stamp_ns=AT + NS // 2)
    told = factors(settings, m, *pings(m), received(3.0), again)
    assert told[m.stamps_ns < AT + TIMEOUT * NS][-1] == pytest.approx(3.0)


def test_numbers_that_no_noise_has_are_refused() -> None:
    assert refusal(SensorNoise(0, "dvl", np.full((3, 3), np.nan))) == "not_finite"
    assert refusal(SensorNoise(0, "dvl", 1e13 * np.eye(3))) == "out_of_range"
    assert refusal(received(1.0)) is None


def test_the_true_noise_of_each_ping_is_as_good_as_its_covariance() -> None:
    """The source ``oracle``: a filter whose pings tell their own covariance is the same."""
    m = mission_above_a_bottom()
    own = [replace(ping, R=np.diag(r)) for ping, r in zip(pings(m), m.r, strict=True)]
    told = [
        SensorNoise(stamp, "dvl", np.diag(r))
        for stamp, r in zip(m.dvl_stamps_ns.tolist(), m.r, strict=True)
    ]
    nominal, oracle = parameters("nominal"), parameters("oracle")
    assert m.r.max() > 2.0 * m.r.min()
    of_ping, of_oracle = (
        fold_arrays(p, m.stamps_ns, m.f_b, m.w_ib_b, [start(m, p), *events])
        for p, events in ((nominal, own), (oracle, [*told, *pings(m)]))
    )
    # The gain of an estimated R is that of R, its covariance Joseph's: equal but for rounding.
    for name in ("v_n", "C_n_b"):
        np.testing.assert_allclose(of_oracle.track[name], of_ping.track[name], atol=1e-9)


def mission_above_a_bottom() -> Mission:
    model = DvlModel(noise_std=(STD,) * 3, rate=5.0)
    return simulate(AUV, DRAWN["bottom-tactical"], seed=SEED, duration=60.0, dvl=model)
