"""The table of accuracies: every row measured on what it has not trained on."""

import json

import numpy as np
import pytest

from insdvl.jobs.options import Workers
from insdvl.jobs.pool import open_pool
from insdvl.simulation.trajectories import AUV, STATIC
from insdvl.studies.results import accuracy
from insdvl.studies.training import dataset
from insdvl.studies.training.dataset import VARIANCES, Recipe
from insdvl.tuner.features.closed_form import degree_5
from insdvl.tuner.models import load_model

SMALL = 4  # windows of each channel of a recording


@pytest.fixture(scope="module")
def document():
    """The study with 2 repetitions and a data set of 1,440 examples."""
    with pytest.MonkeyPatch.context() as patch, open_pool(Workers(jobs=1)) as pool:
        patch.setattr(accuracy, "REPETITIONS", 2)
        patch.setattr(accuracy, "Recipe", lambda *given: Recipe(*given, n_windows=SMALL))
        return accuracy.study_accuracy(3, pool)


def test_the_rows_and_the_document_are_complete(document):
    rows = [row["estimator"] for row in document["rows"]]
    assert {"hcf paper", "hcf default", *accuracy.CLOSED_FORMS} <= set(rows)
    assert set(rows) | set(document["omitted"]) >= {"dnn", "dnn default"}
    assert json.loads(json.dumps(document)) == document
    text = accuracy.accuracy_tables(document)
    for row in rows:
        assert f"| {row} |" in text


def test_unseen_examples_are_those_of_the_random_split(document):
    """The model `default` on the examples that its own training split leaves out."""
    recipe = Recipe("default", 0, n_windows=SMALL)
    recordings = [(i, j) for i in range(4) for j in range(15)]
    windows = np.concatenate([dataset.noisy_windows(recipe, *r) for r in recordings])
    q = np.repeat([VARIANCES[j] for _, j in recordings], 6 * SMALL)
    _, test = dataset.random_split(q.size, 0)
    error = load_model("default").variances(windows[test]) - q[test]
    (row,) = (row for row in document["rows"] if row["estimator"] == "hcf default")
    assert row["published"]["random_split"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    stated = load_model("default").card["metrics"]["trajectory_split"]["rmse"]
    assert row["published"]["trajectory_split"] == stated


def test_the_limits_hold(document):
    """1,980 windows: an RMSE of a relative error is known to 1.6 %, a bias to 0.23 %."""
    limit = document["limits"]["relative"]
    assert limit == pytest.approx(0.1015, abs=1e-4)
    for row in document["rows"]:
        if row["estimator"] in ("hcf default", "degree-5 detrend"):
            for name in accuracy.FACTORS:
                of_all = row["auv"][name]["all"]
                assert 0.92 * limit < of_all["relative_rmse"] < 1.08 * limit
                assert abs(of_all["relative_bias"]) < 0.017
        if row["estimator"] == "hcf paper":
            assert row["auv"]["1/1000"]["all"]["relative_bias"] > 1.0


def test_workers_and_seed():
    with open_pool(Workers(jobs=1)) as pool:
        tasks = {"a": (0, 0), "b": (0, 1)}
        flights = [
            pool.compute(accuracy.unseen_flight, tasks, shared=(["degree-5 detrend"], seed))
            for seed in (1, 1, 2)
        ]
    first, again, other = ([result["relative_errors"] for result in runs] for runs in flights)
    np.testing.assert_array_equal(first, again)
    assert not np.isclose(first[0], first[1]).any() and not np.isclose(first, other).any()


def test_where_motion_hides_noise():
    """A vehicle at rest hides nothing; on the AUV a line hides small variances in its turns."""
    for form in accuracy.motion(STATIC).values():
        assert all(channel["hidden 1/1000"] == 0.0 for channel in form.values())
    seen = accuracy.motion(AUV)
    assert seen["variance after linear detrend"]["f_x"]["hidden 1/1000"] > 0.2
    assert all(c["hidden 1/1000"] == 0.0 for c in seen["degree-5 detrend"].values())
    windows = accuracy.ideal_windows(AUV)
    largest = degree_5(windows[2]).max()
    assert seen["degree-5 detrend"]["f_z"]["largest"] == pytest.approx(largest)
