"""The low-pass of a simulated IMU."""

import numpy as np
import pytest
from scipy.signal import butter, sosfreqz

from insdvl.parameters.declaration import ParameterError
from insdvl.simulation.sensors.imu import ImuModel

RATE, CORNER = 200.0, 20.0
IMU = ImuModel(rate=RATE, bandwidth=CORNER)


def test_a_constant_reading_passes_from_the_first_sample_on():
    readings = np.tile([0.1, -0.2, -9.8, 1e-3, 0.0, 0.2], (300, 1))
    np.testing.assert_allclose(IMU.filtered(readings), readings, atol=1e-9)


@pytest.mark.parametrize(("frequency", "gain"), [(0.5, 1.0), (CORNER, 0.5**0.5), (80.0, 0.01)])
def test_its_gain_falls_from_the_corner_on(frequency, gain):
    t = np.arange(2000) / RATE
    waves = np.tile(np.sin(2.0 * np.pi * frequency * t)[:, None], (1, 6))
    settled = IMU.filtered(waves)[400:]
    assert np.sqrt(2.0 * np.mean(settled**2)) == pytest.approx(gain, abs=0.01)


def test_white_noise_keeps_its_density_at_low_frequencies():
    noise = np.random.default_rng(5).standard_normal((400_000, 6))
    filtered = IMU.filtered(noise)
    slow = filtered.reshape(-1, 400, 6).mean(axis=1)  # means over 2 s
    assert np.mean(slow**2) * 400 == pytest.approx(1.0, rel=0.1)
    _, response = sosfreqz(butter(2, CORNER, fs=RATE, output="sos"), 4096)
    assert np.mean(filtered**2) == pytest.approx(np.mean(np.abs(response) ** 2), rel=0.02)


@pytest.mark.parametrize("corner", [100.0, 1e3])
def test_a_corner_above_half_the_rate_is_refused(corner):
    with pytest.raises(ParameterError, match="bandwidth"):
        ImuModel(rate=RATE, bandwidth=corner)
