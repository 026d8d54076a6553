"""A data set of drawn vehicles: features of what their IMUs show, and the density a filter needs.

Every vehicle is a mission of its own, drawn from a random stream of its own: noise, vibration,
waves and DVL as in the scenarios of docs/explanation/effective-noise.md, in equal numbers; one of
the trajectories of the training; a DVL of 0.02 to 0.1 m/s at 1 or 5 Hz. Some of the IMUs have
a low-pass. The trajectory of the evaluation, and its random streams, are not among them. An example
is one channel at one time.

Vehicles, not examples, are divided into those of training, validation and test.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.jobs.pool import Pool
from insdvl.jobs.store import Store
from insdvl.jobs.tasks import Result
from insdvl.simulation.drawn.scenarios import DRAWN, Scenario
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import SCENARIOS, ProfileFactory
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import BASELINE
from insdvl.tuner.features.schemas import SCHEMAS
from insdvl.tuner.windows import CHANNELS

#: Kinds of vehicles: white noise alone, with gyroscopes in proportion or as noisy as the
#: accelerometers, and the scenarios that are not white.
KINDS: dict[str, Scenario | ProfileFactory] = {
    "white": Scenario(),
    "wide": SCENARIOS["wide"],
    **{name: DRAWN[name] for name in ("vibrating", "coloured", "waves", "realistic")},
}
DVL_STD = (0.02, 0.1)  # m/s, drawn log-uniformly
DVL_RATES = (1.0, 5.0)  # Hz
BANDWIDTH = (4.0, 40.0)  # Hz, of an IMU with a low-pass, drawn log-uniformly
EVERY = 300  # samples from an example of a channel to the next

#: Parts of the data set, and how many vehicles of ten of a kind each has.
PARTS = {"training": 7, "validation": 1, "test": 2}

_STREAM = 3000  # first key of the random streams of the vehicles


@dataclass(frozen=True)
class Recipe:
    """Settings of a data set.

    Attributes:
        schema: Name of the feature schema.
        seed: Random seed, not negative.
        vehicles: Number of each kind, a multiple of ten.
        duration: Length of a mission [s].
        low_passed: Share of the IMUs that have a low-pass.
    """

    schema: str
    seed: int
    vehicles: int
    duration: float
    low_passed: float = 0.0


class Vehicles(NamedTuple):
    """M examples, ordered by kind, vehicle, time, channel.

    Attributes:
        X: (M, F) features.
        scale: (M,) variances that the targets are relative to.
        q: (M,) effective variance per sample.
        kind: (M,) index in `KINDS`.
        vehicle: (M,) number of the vehicle among those of its kind.
    """

    X: Array
    scale: Array
    q: Array
    kind: NDArray[np.int64]
    vehicle: NDArray[np.int64]

    def part(self, name: str) -> NDArray[np.intp]:
        """The examples of a part of `PARTS`; vehicles have the parts in turn."""
        turn = [part for part, count in PARTS.items() for _ in range(count)]
        own = np.array([part == name for part in turn])
        return np.flatnonzero(own[self.vehicle % len(turn)])


def mission_of(recipe: Recipe, kind: str, vehicle: int) -> Mission:
    """The mission of a vehicle."""
    key = (_STREAM, list(KINDS).index(kind), vehicle)
    drawn, flown = np.random.SeedSequence(recipe.seed, spawn_key=key).spawn(2)
    rng = np.random.default_rng(drawn)
    trajectory = list(BASELINE.values())[rng.integers(len(BASELINE))]
    std = float(np.exp(rng.uniform(*np.log(DVL_STD))))
    dvl = DvlModel(noise_std=(std,) * 3, rate=float(rng.choice(DVL_RATES)))
    low_passed = rng.random() < recipe.low_passed
    corner = float(np.exp(rng.uniform(*np.log(BANDWIDTH))))
    imu = ImuModel(bandwidth=corner if low_passed else 0.0)
    return simulate(trajectory, KINDS[kind], seed=flown, duration=recipe.duration, imu=imu, dvl=dvl)


def build(recipe: Recipe, pool: Pool, store: Store | None = None) -> Vehicles:
    """The data set; it does not depend on the workers."""
    tasks = {
        f"{kind}-{number:04}": (kind, number) for kind in KINDS for number in range(recipe.vehicles)
    }
    parts = pool.compute(_examples, tasks, shared=recipe, store=store, label="vehicles")
    sizes = [part["q"].size for part in parts]
    kinds = list(KINDS)
    return Vehicles(
        X=np.concatenate([part["X"] for part in parts]),
        scale=np.concatenate([part["scale"] for part in parts]),
        q=np.concatenate([part["q"] for part in parts]),
        kind=np.repeat([kinds.index(kind) for kind, _ in tasks.values()], sizes),
        vehicle=np.repeat([number for _, number in tasks.values()], sizes),
    )


def _examples(recipe: Recipe, task: tuple[str, int]) -> Result:
    """Features, scales and effective variances of a vehicle.

    The first example has the shortest window. From a vehicle without noise in a channel nothing is
    learned: there is none.
    """
    schema = SCHEMAS[recipe.schema]
    mission = mission_of(recipe, *task)
    samples = np.hstack([mission.f_b, mission.w_ib_b]).T
    history = schema.history or schema.min_samples
    ends = np.arange(schema.min_samples, samples.shape[1] + 1, EVERY)
    rows = [
        schema.extract(np.ascontiguousarray(samples[:, max(0, end - history) : end]))
        for end in ends
    ]
    return {
        "X": np.concatenate([X for X, _ in rows]),
        "scale": np.concatenate([scale for _, scale in rows]),
        "q": mission.q[ends - 1].reshape(ends.size * CHANNELS),
    }
