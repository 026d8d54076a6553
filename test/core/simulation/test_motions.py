"""The motions of vehicles that are not those of the training."""

import numpy as np
import pytest

from insdvl.simulation.drawn.motions import car, rov, shaken_car
from insdvl.simulation.vehicles import VEHICLES

DURATION = 120.0


@pytest.mark.parametrize("name", VEHICLES)
def test_a_generator_decides_the_motion(name: str) -> None:
    motion, t = VEHICLES[name].motion, np.linspace(0.0, DURATION, 50)
    one, again, other = (
        motion(np.random.default_rng(seed), DURATION).truth(t).v_n for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 1e-3


@pytest.mark.parametrize("seed", range(5))
def test_the_car_drives_as_in_a_town(seed: int) -> None:
    t = np.arange(0.0, 400.0, 0.1)
    truth = car(np.random.default_rng(seed), 400.0).truth(t)
    forward = np.einsum("ij,ij->i", truth.v_n, truth.C_n_b[:, :, 0])
    assert forward.min() > -0.2 and 8.0 < forward.max() < 15.2
    assert np.sum(np.abs(forward) < 0.05) > 10  # it starts at rest, and stops
    turning = np.abs(truth.w_nb_b[:, 2]) > 0.2
    assert turning.any() and forward[turning].max() < 6.0
    along = np.einsum("ij,ij->i", truth.a_n, truth.C_n_b[:, :, 0])
    assert np.abs(along[~turning]).max() < 2.5


def test_the_rov_stays_about_where_it_is() -> None:
    truth = rov(np.random.default_rng(1), DURATION).truth(np.arange(0.0, DURATION, 0.1))
    assert np.linalg.norm(truth.v_n, axis=1).max() < 0.25
    assert np.linalg.norm(truth.p_o, axis=1).max() < 5.0


def test_an_engine_shakes_the_car_also_at_rest() -> None:
    """The specific force and the turn rate have the power of the lines that are drawn."""
    t = np.arange(0.0, 4.0, 0.002)  # it stands until 5 s
    trajectory = shaken_car(np.random.default_rng(3), DURATION)
    truth = trajectory.truth(t)
    smooth = truth.f_b - truth.f_b.mean(axis=0)
    sines = trajectory.vibration.sines
    sigma = np.sqrt(np.sum(sines.sine**2 + sines.cosine**2, axis=0) / 2.0)
    np.testing.assert_allclose(smooth.std(axis=0), sigma[:3], rtol=0.1)
    np.testing.assert_allclose(truth.w_ib_b.std(axis=0), sigma[3:], rtol=0.1)
    assert (sines.omega > 2.0 * np.pi * 20.0).all() and (sines.omega < 2.0 * np.pi * 40.1).all()
