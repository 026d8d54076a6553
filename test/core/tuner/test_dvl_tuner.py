"""The tuner of the DVL's noise: what it finds, what does not matter, what it leaves out."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl.navigation.events import NS, Imu
from insdvl.navigation.geometry.frames import NED, rotation_from_rpy, rotation_from_vector
from insdvl.navigation.measurement_noise import window
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.trajectories import AUV
from insdvl.tuner.measurement_noise import DvlTuner, TunedSensorNoise
from insdvl.tuner.parameters import TunedDvl, TunedImu, TunerParameters

SEED = 31_415
VARIANCES = np.array([1e-6] * 3 + [1e-10] * 3)  # of the IMU: it adds nothing that matters
STD = 0.05  # m/s, nominal
ARM, MOUNT = (0.8, 0.0, 0.5), (0.1, -0.2, 1.5)
#: Relative spread of a factor from 15 differences by their median, see the page.
SPREAD = 0.38


def parameters(**dvl: object) -> TunerParameters:
    return TunerParameters(
        frame_convention="ned",
        dvl=TunedDvl(**{"noise_std": (STD,) * 3, "noise_floor": 0.001, **dvl}),
    )


def mission(std: float = STD, duration: float = 60.0, **dvl: object) -> Mission:
    model = DvlModel(noise_std=(std,) * 3, rate=5.0, **dvl)
    return simulate(AUV, constant(VARIANCES), seed=SEED, duration=duration, dvl=model)


def samples(m: Mission) -> list[Imu]:
    rows = zip(m.stamps_ns.tolist(), m.f_b, m.w_ib_b, strict=True)
    return [Imu(stamp, f, w) for stamp, f, w in rows]


def pings(m: Mission) -> list[Dvl]:
    return [Dvl(stamp, v_d) for stamp, v_d in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True)]


def told(tuner: DvlTuner, events: list[Imu | Dvl]) -> list[TunedSensorNoise]:
    found = []
    for event in events:
        found += tuner.add_sample(event) if isinstance(event, Imu) else tuner.add_ping(event)
    return found


def in_order(*events: list[Imu] | list[Dvl]) -> list[Imu | Dvl]:
    return sorted([one for some in events for one in some], key=lambda event: event.stamp_ns)


def factors(p: TunerParameters, m: Mission) -> np.ndarray:
    found = told(DvlTuner(p), in_order(samples(m), pings(m)))
    return np.array([np.trace(one.R) for one in found]) / (3.0 * STD**2)


def test_the_sigma_of_the_pings_is_found_whatever_the_nominal_one_is() -> None:
    """In the geometric mean over 60 s: 20 windows that share nothing, so 4 sigma are 34 %."""
    for ratio in (0.2, 1.0, 4.0):
        found = np.exp(np.mean(np.log(factors(parameters(), mission(ratio * STD)))))
        assert found == pytest.approx(ratio**2, rel=4.0 * SPREAD / np.sqrt(20.0))


def lively(arm: tuple[float, ...], mount: tuple[float, ...]) -> list[Imu | Dvl]:
    """A vehicle that rolls, pitches, turns and surges within seconds; pings at 1 Hz, no noise."""
    dt, C, events = 0.01, rotation_from_rpy(np.array([0.3, -0.2, 1.0])), []
    C_b_d, g = rotation_from_rpy(np.array(mount)), np.array([0.0, 0.0, 9.81])

    def rate(t: float) -> np.ndarray:
        return np.array([0.3, 0.2, 0.25]) * np.sin(2.0 * np.pi * np.array([0.2, 0.15, 0.1]) * t)

    def velocity(t: float) -> np.ndarray:
        return np.array([1.0, 0.5, 0.2]) * np.sin(np.array([0.7, 0.9, 1.1]) * t)

    for k in range(3000):
        t, w = k * dt, rate((k + 0.5) * dt)
        middle = C @ rotation_from_vector(w * dt / 2.0)
        f = middle.T @ ((velocity(t + dt) - velocity(t)) / dt - g)
        C, t, stamp = C @ rotation_from_vector(w * dt), t + dt, (k + 1) * NS // 100
        events.append(Imu(stamp, f, w))
        if (k + 1) % 100 == 0:
            v_b = C.T @ velocity(t) + np.cross(rate(t), arm)
            events.append(Dvl(stamp, C_b_d.T @ v_b))
    return events


def test_motion_gravity_arm_and_mounts_are_not_noise() -> None:
    """Less than 2 mm/s is left, of the turn rate's line; without arm or mount 10 or more."""
    events, right = lively(ARM, MOUNT), {"mount": MOUNT, "lever_arm": ARM}

    def sigma(**told_of_it: tuple[float, ...]) -> float:
        found = told(DvlTuner(parameters(noise_floor=0.0, **told_of_it)), events)
        return float(np.sqrt(np.trace(found[-1].R) / 3.0))

    assert sigma(**right) < 0.002
    assert sigma(mount=MOUNT) > 0.01
    assert sigma(lever_arm=ARM) > 0.01


def test_the_axes_of_the_imu_are_those_of_its_mount() -> None:
    m, turned = mission(0.0), (0.3, 0.2, -1.0)
    C = NED.body_rotation(rotation_from_rpy(np.array(turned)))
    readings = [Imu(s.stamp_ns, C.T @ s.f_b, C.T @ s.w_ib_b) for s in samples(m)]
    p = replace(parameters(), imu=TunedImu(mount=turned))
    found = told(DvlTuner(p), in_order(readings, pings(m)))
    assert np.sqrt(found[-1].R[0, 0]) == pytest.approx(0.001, rel=1e-6)


def test_nothing_is_told_before_five_differences() -> None:
    m = mission(duration=10.0)
    found = told(DvlTuner(parameters()), in_order(samples(m), pings(m)))
    first = window.PAST + window.FEWEST - 1
    assert [one.stamp_ns for one in found] == m.dvl_stamps_ns[first:].tolist()


def test_the_estimate_is_a_factor_on_what_the_message_tells() -> None:
    m, R = mission(duration=20.0), np.diag([1.0, 4.0, 0.25]) * STD**2
    measured = [replace(ping, R=R) for ping in pings(m)]
    found = told(DvlTuner(parameters()), in_order(samples(m), measured))
    np.testing.assert_allclose(found[-1].R / found[-1].R[0, 0], R / R[0, 0], atol=1e-12)


def test_late_pings_and_a_late_start_give_the_same_bits() -> None:
    m = mission(duration=30.0)
    expected = told(DvlTuner(parameters()), in_order(samples(m), pings(m)))
    late = [(ping.stamp_ns + NS // 3, ping) for ping in pings(m)]
    order = sorted([*late, *((s.stamp_ns, s) for s in samples(m))], key=lambda pair: pair[0])
    # The last pings would come behind the end.
    found = told(DvlTuner(parameters()), [event for _, event in order])
    for a, b in zip(expected, found, strict=True):
        assert a.stamp_ns == b.stamp_ns and a.R.tobytes() == b.R.tobytes()
    half = 15 * NS + m.start_ns
    behind = [event for event in in_order(samples(m), pings(m)) if event.stamp_ns > half]
    resumed = {one.stamp_ns: one for one in told(DvlTuner(parameters()), behind)}
    for one in expected[-30:]:
        assert resumed[one.stamp_ns].R.tobytes() == one.R.tobytes()


def test_pings_that_are_too_slow_are_told_nothing_of_after_a_minute() -> None:
    """One ping in 4 s: four of them are not compared, and what was before gets old."""
    m = mission(duration=120.0)
    slow = [ping for k, ping in enumerate(pings(m)) if k < 100 or k % 20 == 0]
    found = told(DvlTuner(parameters()), in_order(samples(m), slow))
    last = slow[99].stamp_ns + 60 * NS
    assert last - 4 * NS < found[-1].stamp_ns <= last


def test_over_a_gap_of_the_dvl_the_window_stays_for_a_minute() -> None:
    m = mission(duration=120.0)
    for seconds, silent in ((30.0, 0), (70.0, window.PAST + window.FEWEST - 1)):
        behind = slice(100 + round(seconds * 5.0), None)
        kept = [*pings(m)[:100], *pings(m)[behind]]
        found = told(DvlTuner(parameters()), in_order(samples(m), kept))
        assert found[100 - 7].stamp_ns == kept[100 + silent].stamp_ns


def test_wild_pings_do_not_carry_it_away() -> None:
    """5 % of 20 sigma: less than 2 in the factor; by the mean of the squares it would be 4."""
    m = mission(outlier_probability=0.05, outlier_size=20.0 * STD, duration=120.0)
    assert np.exp(np.mean(np.log(factors(parameters(), m)))) < 2.0


def test_pings_without_lock_and_late_ones_are_counted_and_left_out() -> None:
    m = mission(duration=10.0)
    good = pings(m)
    zero = Dvl(good[20].stamp_ns + NS // 20, np.zeros(3))
    again = Dvl(good[20].stamp_ns + NS // 10, good[20].v_d)
    partial = replace(
        good[21],
        stamp_ns=good[21].stamp_ns + 1,
        v_d=good[21].v_d + 0.01,  # no repetition
        measured=(True, False, True),
    )
    wrong = replace(good[22], stamp_ns=good[22].stamp_ns + 1, v_d=np.full(3, np.nan))
    tuner = DvlTuner(parameters())
    events = in_order(samples(m), good, [zero, again, partial, wrong])
    found = told(tuner, [*events, good[0]])
    expected = told(DvlTuner(parameters()), in_order(samples(m), good))
    assert [one.R.tobytes() for one in found] == [one.R.tobytes() for one in expected]
    assert tuner.counts["pings_without_lock"] == 3
    assert tuner.counts["pings_incomplete"] == 1
    assert tuner.counts["pings_out_of_order"] == 1
    assert tuner.counts["pings"] == len(good)


@pytest.mark.parametrize("before_samples", [True, False])
def test_a_ping_with_a_stamp_far_ahead_stops_nothing(before_samples: bool) -> None:
    m = mission(duration=20.0)
    good = pings(m)
    wrong = Dvl(good[30].stamp_ns + 3600 * NS, good[30].v_d + 0.5)
    events = in_order(samples(m), good)
    at = 0 if before_samples else events.index(good[30])
    tuner = DvlTuner(parameters())
    found = told(tuner, [*events[:at], wrong, *events[at:]])
    expected = told(DvlTuner(parameters()), events)
    assert [one.R.tobytes() for one in found] == [one.R.tobytes() for one in expected]
    assert tuner.counts["pings_far_ahead"] == 1 and tuner.counts["pings_out_of_order"] == 0


def test_over_a_gap_of_the_imu_nothing_is_compared() -> None:
    m = mission(duration=20.0)
    begin = m.start_ns + 10 * NS
    kept = [s for s in samples(m) if not begin < s.stamp_ns <= begin + NS]
    tuner = DvlTuner(parameters())
    found = told(tuner, in_order(kept, pings(m)))
    assert tuner.counts["pings_without_samples"] >= 4
    assert all(np.isfinite(one.R).all() for one in found)
    squares_before = np.array([one.stamp_ns for one in found])
    assert not ((squares_before > begin) & (squares_before < begin + NS)).any()


def test_bad_samples_are_left_out() -> None:
    m = mission(duration=10.0)
    bad = [Imu(s.stamp_ns + 1, np.full(3, np.nan), s.w_ib_b) for s in samples(m)[::50]]
    found = told(DvlTuner(parameters()), in_order(samples(m), bad, pings(m)))
    expected = told(DvlTuner(parameters()), in_order(samples(m), pings(m)))
    assert [one.R.tobytes() for one in found] == [one.R.tobytes() for one in expected]
