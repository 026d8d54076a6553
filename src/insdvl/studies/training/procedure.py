"""How every model is trained: data set, splits, a fit of each, errors on what was unseen, card.

What is special of a kind of model, and nothing else, is a `Method`.
"""

import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl.jobs.parallel import Function, Pool, Result, Store
from insdvl.studies.training import dataset
from insdvl.studies.training.dataset import Indices, Recipe
from insdvl.studies.training.metrics import RANDOM, TARGETS, described, metrics_of, splits_of
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.models import Regressor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Method:
    """A kind of model.

    Attributes:
        kind: In the words of a card.
        fit: Trains on examples: ``fit((X, y, *settings), training)`` gives the model's arrays, with
            X (M, F), y (M,) and the indices of the training examples.
        settings: Of the fit.
        regressor: The model of the arrays.
        described_as: Key and value of the card that say how the model was made.
        versions: Of the libraries that decide the result, for the card.
    """

    kind: str
    fit: Function
    settings: tuple[Any, ...]
    regressor: Callable[[Result], Regressor]
    described_as: tuple[str, Mapping[str, Any]]
    versions: Mapping[str, str]


def train(
    method: Method, recipe: Recipe, pool: Pool, store: Store | None, say: Callable[[str], None]
) -> tuple[Result, dict[str, Any]]:
    """The arrays of a model, and its card without name and hash.

    Args:
        method: Kind of model.
        recipe: Of the data set; its seed is also that of the split.
        pool: Does the work; the result does not depend on it.
        store: Keeps finished parts.
        say: Is told what is being done.
    """
    schema = SCHEMAS[recipe.schema]
    data = dataset.build(recipe, pool, store)
    say(f"data set: {data.q.size} examples of {data.X.shape[1]} numbers")

    splits = splits_of(data, recipe.seed)
    fits = pool.run(
        method.fit,
        {split: training for split, (training, _) in splits.items()},
        shared=(data.X, schema.encode(data.q, data.scale), *method.settings),
        store=store,
        label=f"fits {recipe.name}",
    )
    arrays = dict(zip(splits, fits, strict=True))
    regressors = {split: method.regressor(fit) for split, fit in arrays.items()}

    def predict(split: str, examples: Indices) -> Array:
        answers = regressors[split].predict(data.X[examples])
        return schema.decode(answers, data.scale[examples])

    metrics = metrics_of(data, splits, predict, say)
    key, description = method.described_as
    card = {
        "kind": method.kind,
        "feature_schema": recipe.schema,
        "features": list(schema.names),
        "target": TARGETS[schema.relative],
        "window": recipe.window,
        "data_set": described(recipe, data),
        key: {**description, "seed": recipe.seed, "trained_on": RANDOM},
        "metrics": metrics,
        "versions": {"python": platform.python_version(), **method.versions},
    }
    return arrays[RANDOM], card
