"""The training of every model: data set, splits, a fit for each, errors on unseen data, card.

A `Method` has what differs between the kinds of models.
"""

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.jobs.tasks import Function, Result
from insdvl.studies.training import dataset
from insdvl.studies.training.dataset import Indices, Recipe
from insdvl.studies.training.metrics import RANDOM, TARGETS, described, metrics_of, splits_of
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.models import Regressor


@dataclass(frozen=True)
class Method:
    """A kind of model.

    Attributes:
        kind: Name of the kind in the card.
        fit: ``fit((X, y, *settings), (training, part))`` returns the arrays of a part of a model,
            for examples X (M, F), y (M,) and the indices of the training examples.
        settings: Settings of the fit.
        regressor: Makes the model from its arrays.
        described_as: Key and value of the card that describe the model.
        versions: Versions for the card of the libraries that the result depends on.
        parts: The parts of a model, which are fitted independently of each other.
        join: The arrays of a model from those of its parts.
    """

    kind: str
    fit: Function
    settings: tuple[Any, ...]
    regressor: Callable[[Result], Regressor]
    described_as: tuple[str, Mapping[str, Any]]
    versions: Mapping[str, str]
    parts: Sequence[Any] = (None,)
    join: Callable[[Sequence[Result]], Result] = itemgetter(0)


def train_method(
    method: Method, recipe: Recipe, pool: Pool, store: Store | None, say: Callable[[str], None]
) -> tuple[Result, dict[str, Any]]:
    """Train a model.

    Args:
        method: Kind of model.
        recipe: Settings of the data set; its seed is also that of the split.
        pool: Does the work; the result does not depend on it.
        store: Keeps finished parts.
        say: Called with messages of progress.

    Returns:
        The arrays of the model, and its card without name and hash.
    """
    schema = SCHEMAS[recipe.schema]
    data = dataset.build_data_set(recipe, pool, store)
    say(f"data set: {data.q.size} examples of {data.X.shape[1]} numbers")

    splits = splits_of(data, recipe.seed)
    fits = pool.compute(
        method.fit,
        {
            f"{split} {number}": (training, part)
            for split, (training, _) in splits.items()
            for number, part in enumerate(method.parts)
        },
        shared=(data.X, schema.encode(data.q, data.scale), *method.settings),
        store=store,
        label=f"fits {recipe.name}",
    )
    n = len(method.parts)
    arrays = {split: method.join(fits[i * n : (i + 1) * n]) for i, split in enumerate(splits)}
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
