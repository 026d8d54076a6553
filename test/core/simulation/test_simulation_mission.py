"""Whole missions: stamps, what a seed fixes, pairs of runs, and the parameters."""

import dataclasses

import numpy as np
import pytest

from insdvl.navigation.geometry.frames import ENU, rotation_from_rpy
from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.mission import ImuModel, mission_of, simulate
from insdvl.simulation.noise import SCENARIOS, NoiseProfile, constant
from insdvl.simulation.parameters import SimulatorParameters
from insdvl.simulation.sensors.dvl import DvlModel, ideal_velocity
from insdvl.simulation.sensors.imu import ideal_imu
from insdvl.simulation.trajectories import AUV, BASELINE

VARYING = SCENARIOS["varying"]
QUIET_IMU = ImuModel(
    accelerometer_bias_std=0.0,
    gyroscope_bias_std=0.0,
    accelerometer_bias_walk=0.0,
    gyroscope_bias_walk=0.0,
)


def arrays(mission):
    named = dataclasses.asdict(mission)
    for group in ("initial", "truth", "profile"):
        named |= {f"{group}.{name}": value for name, value in named.pop(group).items()}
    return {name: value for name, value in named.items() if isinstance(value, np.ndarray)}


def differing(one, other):
    a, b = arrays(one), arrays(other)
    return {name for name in a if not np.array_equal(a[name], b[name])}


def test_one_seed_is_one_mission_to_the_bit():
    dvl = DvlModel(outlier_probability=0.1, bias_std=0.01)
    one, again = (simulate(AUV, VARYING, seed=4, duration=60.0, dvl=dvl) for _ in range(2))
    assert differing(one, again) == set()
    other = simulate(AUV, VARYING, seed=5, duration=60.0, dvl=dvl)
    assert differing(one, other) >= {"f_b", "w_ib_b", "q", "bias", "v_d", "profile.variances"}


@pytest.mark.parametrize(
    ("changed", "what_differs"),
    [
        ({"dvl": DvlModel(noise_std=(0.2,) * 3)}, {"v_d", "r"}),
        ({"dvl": DvlModel(bias_std=0.1)}, {"v_d"}),
        ({"dvl": DvlModel(outlier_probability=0.3)}, {"v_d", "dvl_outlier"}),
        ({"dvl": DvlModel(lever_arm=(1.0, 0.0, 0.0))}, {"v_d"}),
        ({"imu": ImuModel(accelerometer_bias_std=0.1)}, {"f_b", "bias"}),
        ({"imu": ImuModel(gyroscope_bias_walk=1e-6)}, {"w_ib_b", "bias"}),
        ({"imu": ImuModel(bandwidth=10.0)}, {"f_b", "w_ib_b"}),
    ],
)
def test_a_setting_changes_its_own_error_only(changed, what_differs):
    base = simulate(AUV, VARYING, seed=4, duration=100.0)
    assert (
        differing(base, simulate(AUV, VARYING, seed=4, duration=100.0, **changed)) == what_differs
    )


def test_an_outage_takes_pings_away_and_changes_no_other():
    base = simulate(AUV, VARYING, seed=4, duration=60.0)
    cut = simulate(AUV, VARYING, seed=4, duration=60.0, dvl=DvlModel(outages=(10.0, 20.0)))
    left = (base.dvl_stamps_ns < 10_000_000_000) | (base.dvl_stamps_ns >= 20_000_000_000)
    np.testing.assert_array_equal(cut.dvl_stamps_ns, base.dvl_stamps_ns[left])
    np.testing.assert_array_equal(cut.v_d, base.v_d[left])
    assert differing(base, cut) == {"dvl_stamps_ns", "v_d", "r", "dvl_outlier"}


def test_another_profile_scales_the_same_draws():
    loud, soft = (
        simulate(AUV, constant([q] * 6), seed=2, duration=30.0, imu=QUIET_IMU) for q in (0.04, 0.01)
    )
    clean = ideal_imu(AUV, loud.stamps_ns / 1e9, 0.01)[0]
    np.testing.assert_allclose(loud.f_b - clean, 2.0 * (soft.f_b - clean), atol=1e-12)


def test_a_longer_mission_begins_as_the_shorter_one():
    dvl = DvlModel(outlier_probability=0.2, bias_std=0.05)
    short, long = (
        simulate(AUV, VARYING, seed=9, duration=duration, dvl=dvl) for duration in (50.0, 100.0)
    )
    n, m = short.stamps_ns.size, short.dvl_stamps_ns.size
    for name in ("stamps_ns", "f_b", "w_ib_b", "q", "bias"):
        np.testing.assert_array_equal(getattr(short, name), getattr(long, name)[:n])
    for name in ("dvl_stamps_ns", "v_d", "dvl_outlier"):
        np.testing.assert_array_equal(getattr(short, name), getattr(long, name)[:m])


def test_stamps_are_whole_multiples_from_the_start():
    mission = simulate(AUV, VARYING, seed=1, start_ns=1_700_000_000_123_456_789)
    elapsed = mission.stamps_ns - mission.start_ns
    np.testing.assert_array_equal(elapsed, np.arange(1, 33_001) * 10_000_000)
    np.testing.assert_array_equal(
        mission.dvl_stamps_ns - mission.start_ns, np.arange(1, 331) * 1_000_000_000
    )
    assert mission.stamps_ns.dtype == np.int64


def test_stamps_of_a_rate_that_divides_no_second_do_not_drift():
    mission = simulate(BASELINE["circle"], VARYING, seed=1, imu=ImuModel(rate=300.0))
    assert mission.stamps_ns.size == 120_000
    assert mission.stamps_ns[-1] == 400_000_000_000
    assert set(np.diff(mission.stamps_ns)) == {3_333_333, 3_333_334}
    assert mission.truth.t[-1] == 400.0


def test_the_last_stamp_is_the_end_even_where_the_product_is_rounded_down():
    assert 0.29 * 100.0 < 29.0
    assert simulate(AUV, VARYING, seed=1, duration=0.29).stamps_ns[-1] == 290_000_000


def test_readings_are_truth_bias_and_noise_of_the_intervals_variance():
    def two_levels(duration, rng):
        return NoiseProfile(np.array([0.0, 20.0]), np.array([[1e-4] * 6, [1e-2] * 6]))

    mission = simulate(AUV, two_levels, seed=3, duration=40.0)
    f_b, w_ib_b = ideal_imu(AUV, mission.stamps_ns / 1e9, 0.01)
    noise = np.concatenate([mission.f_b - f_b, mission.w_ib_b - w_ib_b], axis=1) - mission.bias
    # The interval that ends at 20 s still has the old variance, the next one the new.
    assert mission.q[1998:2002, 0].tolist() == [1e-4, 1e-4, 1e-2, 1e-2]
    assert mission.stamps_ns[1999] == 20_000_000_000
    assert (noise[:2000] ** 2).mean() == pytest.approx(1e-4, rel=0.06)
    assert (noise[2000:] ** 2).mean() == pytest.approx(1e-2, rel=0.06)


def test_true_process_noise_is_stamped_where_it_begins_to_hold():
    def changes(duration, rng):
        return NoiseProfile(np.array([0.0, 2.5, 4.0]), np.array([[1.0] * 6, [2.0] * 6, [3.0] * 6]))

    mission = simulate(AUV, changes, seed=3, duration=6.0, start_ns=100)
    stamps, variances = mission.process_noise()
    seconds = (stamps - 100) / 1e9
    np.testing.assert_array_equal(seconds, [0.0, 1.0, 2.0, 2.5, 3.0, 4.0, 5.0])
    assert variances[:, 0].tolist() == [1.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0]
    for row, stamp in enumerate(mission.stamps_ns):
        begin = mission.stamps_ns[row - 1] if row else mission.start_ns
        latest = np.flatnonzero(stamps <= begin)[-1]
        assert mission.q[row, 0] == variances[latest, 0], stamp


def test_truth_at_the_start_and_at_the_stamps():
    mission = simulate(AUV, VARYING, seed=3, duration=10.0)
    np.testing.assert_allclose(mission.initial.v_n, [[1.0, 0.0, 0.0]], atol=1e-12)
    expected = AUV.truth(np.arange(1, 1001) * 0.01)
    np.testing.assert_allclose(mission.truth.p_o, expected.p_o, atol=1e-12)
    for name in ("f_b", "w_ib_b", "q", "bias", "v_d"):
        array = getattr(mission, name)
        assert array.flags.c_contiguous
        assert array.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        mission.truth.p_o[0] = 0.0  # shared by all missions on this trajectory


def test_earth_rate_off():
    on, off = (
        simulate(AUV, VARYING, seed=1, duration=5.0, earth_rate=earth_rate)
        for earth_rate in (True, False)
    )
    difference = np.linalg.norm(on.w_ib_b - off.w_ib_b, axis=1)
    np.testing.assert_allclose(difference, 7.292115e-5, rtol=5e-3)


@pytest.mark.parametrize("duration", [0.0, 0.009, 330.1, np.nan])
def test_wrong_duration(duration):
    with pytest.raises(ValueError, match=r"duration must be within 0\.01 to 330 s, got"):
        simulate(AUV, VARYING, seed=1, duration=duration)


# Parameters


def test_parameters_reach_the_models():
    mission = mission_of(
        build(
            SimulatorParameters,
            {
                "trajectory": "lawn_mower",
                "duration": 100.0,
                "seed": 6,
                "noise.profile": "on-off",
                "noise.on_factor": 4.0,
                "noise.half_period": 10.0,
                "imu.rate": 50.0,
                "imu.accelerometer_bias_std": 0.0,
                "imu.gyroscope_bias_std": 0.0,
                "imu.accelerometer_bias_walk": 0.0,
                "imu.gyroscope_bias_walk": 0.0,
                "dvl.rate": 2.0,
                "dvl.outages": [10.0, 20.0, 30.0, 30.5],
                "dvl.noise_std": [0.0, 0.0, 0.0],
            },
        )
    )
    assert mission.stamps_ns[0] == 20_000_000
    assert mission.dvl_stamps_ns.size == 200 - 20 - 1
    assert not mission.bias.any()
    np.testing.assert_allclose(mission.q[[0, 500, 1000], 0], [0.01, 0.04, 0.01])
    np.testing.assert_allclose(mission.q[[0, 500, 1000], 5], [0.001, 0.004, 0.001])
    pings = BASELINE["lawn_mower"].truth(mission.dvl_stamps_ns / 1e9)
    np.testing.assert_allclose(mission.v_d, ideal_velocity(pings, DvlModel()), atol=1e-12)


def test_mount_and_lever_arm_are_in_the_axes_of_the_stream():
    """A DVL 1 m to the left and 0.5 m above, turned to the left: negative in forward-right-down."""
    flu = {
        "dvl.noise_std": [0.0, 0.0, 0.0],
        "duration": 100.0,
        "dvl.mount": [0.0, 0.0, 0.7],
        "dvl.lever_arm": [0.2, 1.0, 0.5],
    }
    frd = flu | {"dvl.mount": [0.0, 0.0, -0.7], "dvl.lever_arm": [0.2, -1.0, -0.5]}
    one = mission_of(build(SimulatorParameters, flu))
    other = mission_of(build(SimulatorParameters, frd | {"frame_convention": "ned"}))
    np.testing.assert_allclose(one.v_d, other.v_d, atol=1e-12)
    pings = AUV.truth(one.dvl_stamps_ns / 1e9)
    v_flu = (np.einsum("kji,kj->ki", pings.C_n_b, pings.v_n)) @ ENU.body
    v_flu += np.cross(pings.w_nb_b @ ENU.body, [0.2, 1.0, 0.5])
    expected = v_flu @ rotation_from_rpy(np.array([0.0, 0.0, 0.7]))
    np.testing.assert_allclose(one.v_d @ ENU.body, expected, atol=1e-12)


@pytest.mark.parametrize(
    "profile", [*SCENARIOS, "coloured", pytest.param("realistic", marks=pytest.mark.long)]
)
def test_scenarios_by_parameter(profile):
    mission = mission_of(
        build(SimulatorParameters, {"noise.profile": profile, "seed": 8, "duration": 50.0})
    )
    expected = simulate(AUV, {**SCENARIOS, **DRAWN}[profile], seed=8, duration=50.0)
    assert differing(mission, expected) == set()


def test_noise_file_by_parameter(tmp_path):
    path = tmp_path / "noise.csv"
    path.write_text("0,1,2,3,4,5,6\n")
    values = {"noise.profile": "file", "noise.file": str(path), "duration": 1.0}
    assert mission_of(build(SimulatorParameters, values)).q[50].tolist() == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"duration": 500.0}, r"parameter 'duration': duration must be within"),
        (
            {"trajectory": "loop", "duration": 3600.0, "imu.rate": 2000.0},
            r"parameter 'duration' must be at most 2500 s at imu\.rate 2000 Hz, got 3600\.0",
        ),
        ({"trajectory": "loop", "imu.rate": 2000.0}, r"'duration' must be .* got 3600\.0"),
        (
            {"noise.profile": "file", "noise.file": "absent"},
            r"parameter 'noise\.file': cannot read the noise profile",
        ),
        (
            {"noise.profile": "waves", "dvl.noise_std": [0.1, 0.1, 0.0]},
            r"'dvl\.noise_std' must be > 0 with noise\.profile 'waves'.* got \[0\.1, 0\.1, 0\.0\]",
        ),
        ({"noise.profile": "pink"}, r"parameter 'noise\.profile' must be one of constant"),
        ({"dvl.outages": [1.0, 2.0, 3.0]}, r"'dvl\.outages' must be pairs .* got \[1\.0, 2\.0, 3"),
        ({"dvl.outages": [2.0, 1.0]}, r"'dvl\.outages' must be pairs .* got \[2\.0, 1\.0\]"),
        ({"dvl.outages": [-2.0, 1.0]}, r"'dvl\.outages' must be >= 0"),
        ({"dvl.outlier_probability": 1.5}, r"'dvl\.outlier_probability' must be"),
        ({"trajectory": "square"}, r"'trajectory' must be one of straight"),
        ({"seed": -1}, r"'seed' must be >= 0"),
        ({"seed": 1.0}, r"'seed' must be an int"),
    ],
)
def test_wrong_parameters_are_named(values, message):
    with pytest.raises(ParameterError, match=message):
        mission_of(build(SimulatorParameters, values))
