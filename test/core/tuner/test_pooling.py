"""IMUs of other rates than those of the training, and IMUs with a low-pass."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from insdvl.navigation.events import NS
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.mission import simulate
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import AUV
from insdvl.tuner.models import load_model
from insdvl.tuner.offline import tuned_by_model
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner
from insdvl.tuner.windows import MOST, means, pool_of

MODEL = load_model("bands")
Q = np.repeat([1e-3, 1e-8], 3)
BANDS = TunerParameters(model="bands", max_gap=0.5)


def white(n: int, seed: int = 4) -> np.ndarray:
    return np.sqrt(Q) * np.random.default_rng(seed).standard_normal((n, 6))


def stamps(n: int, rate: float) -> np.ndarray:
    return np.rint(np.arange(1, n + 1) * (NS / rate)).astype(np.int64)


@pytest.mark.parametrize(
    ("rate", "k"),
    [(25, 1), (62.5, 1), (100, 1), (149, 1), (151, 2), (200, 2), (400, 4), (1000, 10), (4000, 10)],
)
def test_a_mean_has_as_many_samples_as_make_about_100_hz(rate, k):
    assert pool_of(rate) == k <= MOST


def test_means_are_of_the_last_samples():
    windows = np.arange(14.0).reshape(2, 7)
    np.testing.assert_array_equal(means(windows, 3), [[2.0, 5.0], [9.0, 12.0]])


@pytest.mark.parametrize("rate", [50.0, 125.0, 200.0, 400.0, 1000.0])
def test_white_noise_has_its_variance_per_sample_at_any_rate(rate):
    n = round(22 * max(rate, 100.0))
    _, variances = tuned_by_model(stamps(n, rate), white(n), MODEL, BANDS)
    ratio = np.exp(np.log(variances / Q).mean())
    assert 0.7 < ratio < 1.4


@pytest.mark.parametrize("order", [0, 6])
@pytest.mark.parametrize("rate", [62.5, 400.0])
def test_the_tuner_answers_as_for_a_whole_recording(rate, order):
    """With jitter, and with a gap after which there are too few samples for a while."""
    n = 4000
    of_imu = stamps(n, rate) + np.random.default_rng(1).integers(0, round(NS / rate / 3), n)
    of_imu[2500:] += 2 * NS
    parameters = TunerParameters(model="bands", difference_order=order)
    tuner, samples = Tuner(parameters), white(n)
    online = [tuner.add(*one) for one in zip(of_imu, samples, strict=True)]
    found = [one for one in online if one is not None]
    at_ns, variances = tuned_by_model(of_imu, samples, MODEL, parameters)
    assert [one.stamp_ns for one in found] == at_ns.tolist()
    np.testing.assert_array_equal([one.variances for one in found], variances)


def test_a_fast_imu_on_a_moving_vehicle_has_the_density_of_a_slow_one():
    """In waves. Samples four times as fast have four times the variance for the same density."""
    found = {}
    for rate in (100.0, 400.0):
        mission = simulate(AUV, DRAWN["waves"], seed=11, duration=80.0, imu=ImuModel(rate=rate))
        samples = np.hstack([mission.f_b, mission.w_ib_b])
        at_ns, variances = tuned_by_model(mission.stamps_ns, samples, MODEL, BANDS)
        told = mission.q[np.searchsorted(mission.stamps_ns, at_ns)]
        found[rate] = np.log(variances / told)[at_ns > 25 * NS]
    for errors in found.values():
        assert np.sqrt(np.mean(errors**2)) < 1.2  # the card has 0.6 for such vehicles


@pytest.mark.parametrize("rate", [62.5, 100.0, 200.0])
@pytest.mark.parametrize("corner", [0.08, 0.15, 0.3])
def test_an_imu_with_a_low_pass_has_the_noise_that_it_passes(corner, rate):
    """A filter integrates slow noise, which the low-pass leaves as it is."""
    imu = ImuModel(rate=rate, bandwidth=corner * rate)
    n = round(45 * rate)
    _, variances = tuned_by_model(stamps(n, rate), imu.filtered(white(n)), MODEL, BANDS)
    ratio = np.exp(np.log(variances / Q).mean())
    assert 1.0 / 3.0 < ratio < 3.0


@pytest.mark.parametrize("order", [1, 4, 8])
@pytest.mark.parametrize("corner", [0.1, 0.2, 0.4])
def test_the_order_of_the_low_pass_need_not_be_known(order, corner):
    """The training has the second."""
    sections = butter(order, corner, fs=1.0, output="sos")
    noise = np.random.default_rng(9).standard_normal((20, 6, 2400))
    windows = np.ascontiguousarray(sosfilt(sections, noise)[:, :, 400:].reshape(-1, 2000))
    assert 1.0 / 1.5 < np.exp(np.log(MODEL.variances(windows)).mean()) < 1.5
