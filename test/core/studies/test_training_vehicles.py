"""The data set of drawn vehicles, and the training of the model `bands`."""

import numpy as np
import pytest
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.metrics import mean_gamma_deviance

from insdvl import cli
from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.studies.training import bands, vehicles
from insdvl.studies.training.vehicles import KINDS, PARTS, Recipe, Vehicles
from insdvl.tuner.features.band_features import BAND_FEATURE_NAMES
from insdvl.tuner.features.bands import WINDOW
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.forest import Forest
from insdvl.tuner.models import load_model

TINY = Recipe("bands", seed=5, vehicles=1, duration=6.0)


@pytest.fixture(scope="module")
def tiny() -> Vehicles:
    with open_pool(Workers(jobs=1)) as pool:
        return vehicles.build(TINY, pool)


def test_examples_are_ordered_by_kind_vehicle_time_channel(tiny):
    assert tiny.X.shape == (len(KINDS) * 2 * 6, len(BAND_FEATURE_NAMES))
    np.testing.assert_array_equal(tiny.kind, np.repeat(np.arange(len(KINDS)), 12))
    np.testing.assert_array_equal(tiny.X[:12, -1], np.repeat([1.0, 2.0], 6))  # history
    mission = vehicles.mission_of(TINY, "white", 0)
    np.testing.assert_array_equal(tiny.q[:12], mission.q[[199, 499]].ravel())


def test_a_vehicle_depends_on_its_kind_number_and_seed():
    q = {
        (recipe.seed, kind, number): vehicles.mission_of(recipe, kind, number).f_b[0, 0]
        for recipe in (TINY, Recipe("bands", 6, 1, 6.0))
        for kind in ("white", "coloured")
        for number in (0, 1)
    }
    assert len(set(q.values())) == 8
    again = vehicles.mission_of(TINY, "white", 1).f_b[0, 0]
    assert again == q[5, "white", 1]


def test_parts_share_no_vehicle():
    vehicle = np.tile(np.repeat(np.arange(20), 3), 2)
    data = Vehicles(*[np.zeros(vehicle.size)] * 3, np.repeat([0, 1], 60), vehicle)
    found = {
        part: {(k, v) for k, v in zip(data.kind[at], vehicle[at], strict=True)}
        for part in PARTS
        for at in [data.part(part)]
    }
    assert {part: len(own) for part, own in found.items()} == {
        "training": 28,
        "validation": 4,
        "test": 8,
    }
    assert len(set().union(*found.values())) == 40


def test_boosted_trees_are_a_mean_of_trees():
    rng = np.random.default_rng(1)
    X = rng.standard_normal((300, 4)).astype(np.float32)
    sigma = np.exp(X[:, 0] + np.abs(X[:, 1]) - 2.0)
    ensemble = HistGradientBoostingRegressor(loss="gamma", max_iter=7, random_state=3)
    expected = ensemble.fit(X, sigma).predict(X)
    forest = bands.of_boosted(ensemble)
    np.testing.assert_allclose(np.exp(forest.predict(X)), expected**2, rtol=1e-12)


def test_what_the_features_do_not_tell_is_averaged_as_standard_deviation():
    """Half of the vehicles have 100 times the variance of the others."""
    rng = np.random.default_rng(2)
    X = rng.standard_normal((4000, 3))
    sigma = np.where(np.arange(len(X)) % 2, 1.0, 10.0)
    arrays = bands._fit((X, np.log(sigma**2), 0), bands.BOOSTED)
    found = np.exp(Forest(arrays).predict(X))
    # The mean of logarithms would be 10, that of variances 50.
    assert 0.85 * 5.5**2 < np.median(found) < 1.15 * 5.5**2


def test_the_training_teaches_the_validation_chooses_and_the_test_does_neither(monkeypatch):
    """Validation and test are made of what the two candidates say after the training alone."""
    rng = np.random.default_rng(3)
    vehicle = np.tile(np.repeat(np.arange(10), 24), len(KINDS))
    kind = np.repeat(np.arange(len(KINDS)), 240)
    X = rng.normal(0.0, 0.5, (vehicle.size, len(BAND_FEATURE_NAMES))).astype(np.float32)
    q = np.exp(rng.normal(0.5, 0.3, vehicle.size))
    data = Vehicles(X, np.ones(vehicle.size), q, kind, vehicle)
    at = {part: data.part(part) for part in PARTS}
    schema = SCHEMAS[bands.SCHEMA]
    training = X[at["training"]], schema.encode(q[at["training"]], 1.0), 4
    said = {}
    for name in (bands.BAGGED, bands.BOOSTED):
        forest = Forest(bands._fit(training, name))
        said[name] = np.exp(schema.bounded(X, forest.predict(X)))
    monkeypatch.setattr(bands.vehicles, "build", lambda *_: data)
    for true, other in ((bands.BAGGED, bands.BOOSTED), (bands.BOOSTED, bands.BAGGED)):
        q[at["validation"]], q[at["test"]] = (
            said[name][at[part]] for name, part in ((true, "validation"), (other, "test"))
        )
        with open_pool(Workers(jobs=1)) as pool:
            _, card = bands.train(bands.SCHEMA, WINDOW, 4, pool, None, lambda _: None)
        assert card["ensemble"]["chosen"] == true
        assert card["ensemble"]["validation_deviance"][true] == pytest.approx(0.0, abs=1e-9)
        assert min(card["metrics"]["test_deviance"]["learned"].values()) > 1e-6


def test_deviance_is_zero_for_the_truth_and_least_at_the_mean():
    assert bands.deviance(np.zeros(3)) == 0.0
    q = np.array([1.0, 4.0, 7.0])
    for m in (3.9, 4.1):
        assert bands.deviance(np.log(4.0 / q)) < bands.deviance(np.log(m / q))
    np.testing.assert_allclose(
        bands.deviance(np.log(5.0 / q)), mean_gamma_deviance(q, np.full(3, 5.0))
    )


def test_the_command_writes_a_model_that_a_tuner_can_use(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bands, "DURATION", 3.0)
    command = ("train", "--preset", "bands", "--quick", "--jobs", "1", "--out", str(tmp_path))
    assert cli.main(command) == 0
    model = load_model(str(tmp_path / "bands-quick.npz"))
    assert (model.window, model.history) == (200, 2000)
    assert model.card["data_set"]["examples"] == 60 * 6
    chosen, errors = (model.card["ensemble"][k] for k in ("chosen", "validation_deviance"))
    assert errors[chosen] == min(errors.values())
    white = np.random.default_rng(0).standard_normal((48, 600))
    np.testing.assert_allclose(
        model.variances(4.0 * white), 16.0 * model.variances(white), rtol=1e-12
    )


def test_the_window_is_that_of_the_features(capsys):
    assert cli.main(("train", "--preset", "bands", "--window", "100")) == 2
    assert "--window must be within 200 to 200, got 100" in capsys.readouterr().err
