"""How the DVL is mounted against the IMU: the most probable values, from windows of motion.

The derivation is in docs/explanation/alignment.md; the residuals are those of rows.py.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.geometry.frames import rotation_from_vector, vector_from_rotation
from insdvl.watch.alignment.rows import DELAY, MOUNT, SCALE, SIZE, Mounted, rows
from insdvl.watch.alignment.windows import SLOW, Bases, Noise, Window, joined

CLIMB = 0.1  # one sigma of the mean vertical velocity, as a part of the speed
MOST_NOISE = 0.25  # of the power of F, up to which the noise in it is known well enough
#: The 24 turns by right angles.
_RIGHT_ANGLES = [
    turn
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
    if np.linalg.det(turn := np.diag(signs)[list(order)]) > 0.0
]
_STEPS = 15
_LINEAR_STEPS = 6
_POOLED = 4  # steps with one noise of all windows, before each has its own


@dataclass(frozen=True)
class Prior:
    """What is thought of the unknowns before any motion: independent normal distributions.

    Attributes:
        mean: (15,).
        sigma: (15,).
    """

    mean: Array
    sigma: Array


@dataclass(frozen=True)
class Information:
    """Products of the rows of W windows, without their parabolas, and of their slow parts.

    Attributes:
        all: (W, 16, 16).
        slow: (W, 12, 16) the rows themselves, of their slow parts: degree after degree.
        dof: (W,) number of residuals.
        climb: (16, 16) of the vehicle's travel being level, in units of its variance.
    """

    all: Array
    slow: Array
    dof: Array
    climb: Array

    @classmethod
    def of(cls, items: Sequence[tuple[Array, Array, float]], climb: Array) -> "Information":
        """From what `information` gives for each window, and from `Travel.row`."""
        alls, slows, dofs = zip(*items, strict=True)
        return cls(np.array(alls), np.array(slows), np.array(dofs), np.outer(climb, climb))


@dataclass(frozen=True)
class Travel:
    """How the vehicle moves on the whole.

    A constant vertical velocity changes nothing in a turn, so that a wrong scale looks like a DVL
    that is pitched. But few vehicles climb or dive all the time.

    Attributes:
        v_d: (3,) mean velocity in DVL axes.
        speed: Its RMS.
        up: (3,) mean direction of the specific force in body axes.
    """

    v_d: Array
    speed: float
    up: Array

    @classmethod
    def of(cls, v_d: Array, f: Array) -> "Travel":
        """Of readings of the DVL (K, 3) and of the accelerometer (K, 3)."""
        up = f.mean(axis=0)
        speed = float(np.sqrt((v_d**2).sum(axis=1).mean()))
        return cls(v_d.mean(axis=0), speed, up / max(float(np.linalg.norm(up)), 1e-9))

    def row(self, known: Mounted, x: Array) -> Array:
        """Derivatives (16,) by the unknowns of the mean climb, and itself, divided by its sigma."""
        C = rotation_from_vector(x[MOUNT]) @ known.C_b_d
        v_b = C @ self.v_d / self.speed
        row = np.zeros(SIZE + 1)
        row[MOUNT] = np.cross(v_b, self.up)
        row[-1] = v_b @ self.up
        return row / CLIMB


def information(a: Array, bases: Bases, noise: float) -> tuple[Array, Array, float]:
    """Products (16, 16) of a window's rows, their slow parts (12, 16), and number of residuals.

    Args:
        a: (K, 3, 16) rows.
        bases: Of the window.
        noise: Sum of the squares that the IMU's noise adds to those of kappa F. It is in y and in
            its derivative by the scale; their product would make kappa too small.
    """
    K, _, n = a.shape
    flat = a.reshape(K, -1)
    flat = flat - bases.parabola @ (bases.parabola.T @ flat)
    slow = (bases.slow.T @ flat).reshape(-1, n)
    flat = flat.reshape(-1, n)
    products = flat.T @ flat
    products[SCALE, -1] -= noise
    products[-1, SCALE] -= noise
    return products, slow, 3.0 * (K - SLOW[0])


@dataclass(frozen=True)
class Fit:
    """The most probable values of the unknowns under a prior.

    Attributes:
        values: (15,).
        covariance: (15, 15).
        noise: Of the windows, as the residuals show it.
        volume: ln of the share of the prior's volume that the data leave, twice, and negative; with
            the squared distance from its mean, and of the climb from none.
        slow: (W, 12) slow parts of y.
    """

    values: Array
    covariance: Array
    noise: Noise
    volume: float
    slow: Array

    @property
    def sigma(self) -> Array:
        """(15,)."""
        return np.sqrt(np.diag(self.covariance))

    def cost(self, noise: Noise | None = None, excess: float = 1.0) -> float:
        """-2 ln of the evidence (Laplace), the noise of each window being unknown.

        Args:
            noise: Of the residuals, if more of them is noise than the residuals show.
            excess: Number of residuals that count as one.
        """
        noise = noise or self.noise
        return float(noise.dof @ np.log(noise.variance)) / excess + self.volume


def _squares(products: Array, step: Array) -> Array:
    """(W,) sums of squares after a step of the unknowns."""
    x = np.append(step, 1.0)
    return np.maximum(np.einsum("wij,i,j->w", products, x, x), 0.0)


def noise_after(info: Information, step: Array, floor: float, *, pooled: bool = False) -> Noise:
    """The noise that a step of the unknowns leaves; pooled: the same in all windows."""
    squares = _squares(info.all, step)
    slow = (info.slow @ np.append(step, 1.0)).reshape(len(squares), len(SLOW), 3) ** 2
    few = 3.0 * len(SLOW)
    rest = (squares - slow.sum(axis=(1, 2))) / (info.dof - few)
    slow = slow.mean(axis=2)
    if pooled:
        slow, rest = (
            np.repeat(a.mean(axis=0, keepdims=True), len(a), axis=0) for a in (slow, rest)
        )
    return Noise(info.dof, np.maximum(slow, floor), np.maximum(rest, floor))


def _information(info: Information, noise: Noise) -> Array:
    """Products (16, 16) of all windows, divided by the variances."""
    return np.einsum("w,wij->ij", noise.weights, info.all) + info.climb


def _step(info: Information, at: Array, prior: Prior, noise: Noise) -> Array:
    """Step (15,) from `at` to the most probable values of the linear problem."""
    N = _information(info, noise)
    A = N[:-1, :-1] + np.diag(prior.sigma**-2)
    b = -N[:-1, -1] - (at - prior.mean) / prior.sigma**2
    return np.asarray(np.linalg.solve(A, b), dtype=np.float64)


def _covariance(info: Information, prior: Prior, noise: Noise) -> Array:
    """Covariance (15, 15) of the values.

    White noise of the DVL, of variance r in each of K - 3 pings, adds 2 r (K - 3) to the squares of
    the derivatives by each turn, and tells nothing of the turn.
    """
    N = _information(info, noise)[:-1, :-1]
    white = 2.0 * float(noise.weights @ (noise.rest * noise.dof)) / 3.0
    N[MOUNT, MOUNT] -= white * np.eye(3)
    scaled = N * np.outer(prior.sigma, prior.sigma)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2.0)
    vectors = prior.sigma[:, None] * vectors
    return (vectors / (1.0 + np.maximum(values, 0.0))) @ vectors.T


def _fit(info: Information, values: Array, step: Array, prior: Prior, noise: Noise) -> Fit:
    """The fit that ends in values + step."""
    covariance = _covariance(info, prior, noise)
    distance = (values + step - prior.mean) / prior.sigma
    squares = float(distance @ distance) + float(_squares(info.climb[None], step)[0])
    volume = 2.0 * float(np.log(prior.sigma).sum()) - float(np.linalg.slogdet(covariance)[1])
    slow = info.slow @ np.append(step, 1.0)
    return Fit(values + step, covariance, noise, squares + volume, slow)


def linear_spread(info: Information, fit: Fit, prior: Prior) -> Array:
    """Covariance (15, 15) of the values of a linear fit under another prior."""
    return _covariance(info, prior, fit.noise)


def linear_fit(info: Information, prior: Prior, floor: float) -> Fit:
    """A fit near zero, where the problem is linear."""
    step, at = np.zeros(SIZE), np.zeros(SIZE)
    for k in range(_LINEAR_STEPS):
        noise = noise_after(info, step, floor, pooled=k < 2)
        step = _step(info, at, prior, noise)
    return _fit(info, at, step, prior, noise_after(info, step, floor))


class Problem:
    """The windows of one mission, whose unknowns are estimated.

    Args:
        windows: Of the motion, at least one.
        bases: Of each.
        noises: (W,) sums of the squares of F that are noise of the IMU [(m/s)^2].
        known: The mount from which the unknowns count.
        floor: Variance that no DVL is below [(m/s)^2].
    """

    def __init__(
        self,
        windows: Sequence[Window],
        bases: Sequence[Bases],
        noises: Sequence[float],
        known: Mounted,
        floor: float,
    ) -> None:
        self._all = joined(windows)
        ends = np.cumsum([len(w.t) for w in windows]).tolist()
        self._slices = [slice(a, b) for a, b in zip([0, *ends], ends, strict=False)]
        self._travel = Travel.of(self._all.v_d, self._all.f)
        self._bases = bases
        self._known = known
        self._floor = floor
        self._of_turns = self._products_of_turns()
        power = self._of_turns[-1, -1]  # of F
        self._noises = np.array(noises) * (sum(noises) < MOST_NOISE * power)

    def at(self, values: Array) -> Information:
        """The linear problem at some values (15,)."""
        a = rows(self._all, self._known, values)
        noises = self._noises * math.exp(2.0 * values[SCALE])
        return Information.of(
            [
                information(a[s], b, noise)
                for s, b, noise in zip(self._slices, self._bases, noises, strict=True)
            ],
            self._travel.row(self._known, values),
        )

    def fit(self, prior: Prior, start: Array) -> Fit:
        """Gauss-Newton from a start (15,)."""
        values, here = start, np.zeros(SIZE)
        info = self.at(values)
        for k in range(_STEPS):
            noise = noise_after(info, here, self._floor, pooled=k < _POOLED)
            step = _step(info, values, prior, noise)
            size = max(np.abs(step[MOUNT]).max() / 0.5, abs(step[SCALE]), abs(step[DELAY]) / 0.5)
            step = step / max(size, 1.0)
            turn = rotation_from_vector(step[MOUNT]) @ rotation_from_vector(values[MOUNT])
            values = values + step
            values[MOUNT] = vector_from_rotation(turn)
            info = self.at(values)
            if k >= _POOLED and (np.abs(step) < 1e-2 * prior.sigma).all():
                break
        return _fit(info, values, here, prior, noise_after(info, here, self._floor))

    def spread(self, fit: Fit, prior: Prior) -> Array:
        """Covariance (15, 15) of a fit's values under another prior."""
        return _covariance(self.at(fit.values), prior, fit.noise)

    def starts(self, prior: Prior, *, level: bool) -> list[Array]:
        """Two values (15,) from which Gauss-Newton finds a turn of any angle.

        They are the best of some turns: of those about the vertical by half right angles, and, if
        it need not be level, of the 24 by right angles.
        """
        turns = [rotation_from_vector(np.array([0.0, 0.0, k * math.pi / 4.0])) for k in range(8)]
        if not level:
            turns += _RIGHT_ANGLES
        products = self._of_turns
        misfits = []
        for turn in turns:
            x = np.append(turn.ravel(), -math.exp(prior.mean[SCALE]))
            misfits.append(float(x @ products @ x))
        found = []
        for k in np.argsort(misfits)[:2]:
            start = np.zeros(SIZE)
            start[MOUNT] = vector_from_rotation(turns[int(k)])
            start[SCALE] = prior.mean[SCALE]
            found.append(start)
        return found

    def rolled(self, fit: Fit) -> list[Array]:
        """The values of a fit, with further turns by right angles about the direction of travel.

        These are what the motion tells least.
        """
        turn = rotation_from_vector(fit.values[MOUNT])
        along = turn @ self._known.C_b_d @ self._all.v_d.mean(axis=0)
        along /= max(float(np.linalg.norm(along)), 1e-9)
        found = []
        for quarter in range(1, 4):
            start = fit.values.copy()
            rolled = rotation_from_vector(along * quarter * math.pi / 2.0) @ turn
            start[MOUNT] = vector_from_rotation(rolled)
            found.append(start)
        return found

    def _products_of_turns(self) -> Array:
        """Products (10, 10) of R C v_d, linear in the nine elements of a turn, and of F."""
        w = self._all
        a = np.einsum("kai,kj->kaij", w.R, w.v_d @ self._known.C_b_d.T).reshape(-1, 3, 9)
        F = w.F + np.einsum("kij,kj->ki", w.R, np.cross(w.w, self._known.l_b))
        both = np.concatenate([a, F[:, :, None]], axis=2)
        flat = both.reshape(len(both), -1)
        parts = []
        for s, bases in zip(self._slices, self._bases, strict=True):
            part = flat[s] - bases.parabola @ (bases.parabola.T @ flat[s])
            parts.append(part.reshape(-1, 10))
        joined_parts = np.concatenate(parts)
        return joined_parts.T @ joined_parts
