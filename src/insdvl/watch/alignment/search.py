"""Which cause explains the motion best, and which others explain it nearly as well."""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import rotation_from_vector
from insdvl.tuner.features.differences import integrated_variances
from insdvl.watch.alignment.causes import NOTHING, TURNS, Cause, Miswired
from insdvl.watch.alignment.estimation import (
    Fit,
    Information,
    Prior,
    Problem,
    Travel,
    information,
    linear_fit,
    linear_spread,
)
from insdvl.watch.alignment.gravity import GRAVITY
from insdvl.watch.alignment.outliers import outliers
from insdvl.watch.alignment.rows import MOUNT, SCALE, SIZE, Mounted, rows
from insdvl.watch.alignment.windows import SLOW, Bases, Noise, Window, integrated

FEWEST_PINGS = SLOW[-1] + 2  # of a window: one more than its polynomials
SMALLEST = 1e-3  # m/s, noise of a DVL; none is better
ACCUSED = 2.0 * math.log(1e4)  # twice the log of the odds against right parameters
AS_GOOD = 2.0 * math.log(1e2)  # of the odds up to which another cause is named as well
SPEED = 5.0  # m/s, one sigma of the speed of a vehicle
CHANCE = 3.0  # sigmas of the power of noise
FREE = Cause(frozenset(["mount", "scale", "arm", "delay"]))
BEAM = 2  # most probable causes to which one thing more is added
UNEXPLAINED = 1.5  # excess of the slow part of a residual, from which all causes are tried


@dataclass(frozen=True)
class Samples:
    """What a window was made of, see `integrated`."""

    stamps: Stamps
    f: Array
    w: Array
    pings: Stamps
    v_d: Array
    average: float

    def window(self, cause: Miswired | None = None) -> Window:
        """The window, with the readings that a cause takes for right."""
        f, w, v_d = self.f, self.w, self.v_d
        if cause is not None:
            f, w, v_d = f @ cause.accelerometer.T, w @ cause.gyroscope.T, v_d @ cause.dvl.T
        return integrated(self.stamps, f, w, self.pings, v_d, self.average)

    def without(self, is_left_out: NDArray[np.bool_]) -> "Samples":
        """The same without some pings (K,), from the first that stays on."""
        pings = self.pings[~is_left_out]
        since = slice(int(np.searchsorted(self.stamps, pings[0], side="right")), None)
        return replace(
            self,
            stamps=self.stamps[since],
            f=self.f[since],
            w=self.w[since],
            pings=pings,
            v_d=self.v_d[~is_left_out],
        )


class Motion:
    """One window, with what every miswired sensor would make of it once that is asked for."""

    def __init__(self, samples: Samples) -> None:
        self.samples = samples
        self.window = samples.window()
        self.bases = Bases.of(self.window.t)
        self.noise = self._noise()
        few = 3.0 * len(SLOW)
        dof = 3.0 * (len(self.window.t) - SLOW[0])
        self.squares = 3.0 * float(self.noise[:-1].sum()) + (dof - few) * float(self.noise[-1])
        self.tried: list[tuple[Array, Array, float]] = []

    def _noise(self) -> Array:
        """Variances (5,) of the residual by the noise of the IMU, see `of_noise` [(m/s)^2].

        A turn by an angular random walk leaks gravity, and turns the velocity. The noise is that
        which is integrated: vibration is motion, which the pings have as well.
        """
        s = self.samples
        dt = float(np.diff(s.stamps).mean()) / NS
        f, w = (q * dt for q in integrated_variances(np.hstack([s.f, s.w]), 1.0 / dt))
        of_walk, of_integral = self.bases.of_noise(self.window.t)
        speed = float((self.window.v_d**2).sum(axis=1).mean())
        turned = 2.0 / 3.0 * w * (speed * of_walk + GRAVITY**2 * of_integral)  # two of three
        return turned + f * of_walk

    def compute(self, causes: Sequence[Miswired], known: Mounted) -> None:
        """Compute what each cause makes of the window."""
        here = np.zeros(SIZE)
        self.tried = [
            information(rows(self.samples.window(cause), known, here), self.bases, 0.0)
            for cause in causes
        ]


@dataclass(frozen=True)
class Explanation:
    """A cause, and the values that it gives.

    Attributes:
        cause: What is wrong.
        fit: The values.
        cost: -2 ln of its probability, up to a constant.
    """

    cause: Cause | Miswired
    fit: Fit
    cost: float

    @property
    def accuses(self) -> frozenset[str]:
        """What is accused; two explanations of the same differ in its value only."""
        cause = self.cause
        if isinstance(cause, Cause):
            names = {"mount" if block in TURNS else block for block in cause.blocks}
            return frozenset(names | ({"scale"} if cause.unit else set()))
        if cause.factor != 1.0:
            return frozenset(["gyroscope scale"])
        if cause.sensor == "DVL" and np.linalg.det(cause.matrix) > 0.0:
            return frozenset(["mount"])
        return frozenset([f"{cause.sensor} {cause.matrix.tolist()}"])


class Search:
    """Explains windows of motion.

    Args:
        known: The mount that the parameters tell.
        causes: The miswired sensors that are tried.
        accelerometer_bias: One sigma [m/s^2].
        gyroscope_bias: One sigma [rad/s].
        lasting: One sigma of the errors of a right DVL that last [m/s].
        lasts: Their time constant [s].
    """

    def __init__(
        self,
        known: Mounted,
        causes: Sequence[Miswired],
        accelerometer_bias: float,
        gyroscope_bias: float,
        lasting: float,
        lasts: float,
    ) -> None:
        self.known = known
        self.causes = causes
        self._accelerometer_bias, self.gyroscope_bias = accelerometer_bias, gyroscope_bias
        self._lasting, self._lasts = lasting, lasts

    def _prior(self, cause: Cause | Miswired) -> Prior:
        return cause.prior(self._accelerometer_bias, self.gyroscope_bias)

    def problem(self, motions: Sequence[Motion]) -> Problem:
        """Of estimating the unknowns from some windows."""
        windows, bases = [m.window for m in motions], [m.bases for m in motions]
        return Problem(windows, bases, [m.squares for m in motions], self.known, SMALLEST**2)

    def suspects(self, motions: Sequence[Motion]) -> bool:
        """Whether anything may be wrong: a quick answer, that is seldom yes without a reason."""
        problem = self.problem(motions)
        nominal = problem.fit(self._prior(NOTHING), np.zeros(SIZE))
        if nominal.noise.excess > UNEXPLAINED:
            return True
        info = problem.at(np.zeros(SIZE))
        straight = linear_fit(info, self._prior(NOTHING), SMALLEST**2)
        return any(
            linear_fit(info, self._prior(cause), SMALLEST**2).cost() + cause.penalty
            < straight.cost()
            for cause in NOTHING.more()
        )

    def explain(self, motions: Sequence[Motion]) -> Generator[None, None, list[Explanation]]:
        """The explanations that are nearly as probable as the best one, that first.

        Empty when the parameters are right, or nothing tells that they are not. One thing more is
        taken to be wrong as long as that makes the explanation more probable. It pauses after each
        hundredth of a second or so.
        """
        problem = self.problem(motions)
        fits: dict[Cause | Miswired, Fit] = {}
        tried = {
            cause: Information.of([m.tried[k] for m in motions], self._climb(motions, cause))
            for k, cause in enumerate(self.causes)
        }
        for wrong, info in tried.items():
            fits[wrong] = linear_fit(info, self._prior(wrong), SMALLEST**2)
        yield
        fits[NOTHING] = yield from self._fit(problem, NOTHING)
        size, beam = 0, [NOTHING]
        while beam and size == beam[0].size:
            for cause in (c for b in beam for c in b.more()):
                if cause not in fits:
                    fits[cause] = yield from self._fit(problem, cause)
            found = [e.cause for e in self._ranked(fits, motions) if isinstance(e.cause, Cause)]
            size += 1
            beam = found[:BEAM] if found[0].size == size else []
            beam = [c for c in beam if c.size == size]
        ranked = self._ranked(fits, motions)
        nothing = next(e for e in ranked if e.cause is NOTHING)
        if nothing.cost - ranked[0].cost < ACCUSED:
            return []
        chosen: list[Explanation] = []
        for e in ranked:
            if e.cost - ranked[0].cost > AS_GOOD:
                break
            if not any(e.accuses >= c.accuses for c in chosen):
                chosen.append(self._spread(problem, tried, e) if "mount" in e.accuses else e)
        return chosen

    def free(self, motions: Sequence[Motion], explanation: Explanation | None) -> Fit:
        """The unknowns with nothing known of mount, scale, lever arm and stamps.

        Args:
            motions: The windows.
            explanation: Of the windows, with a cause that is none of miswired axes; None where the
                parameters are right.
        """
        values, prior = np.zeros(SIZE), self._prior(FREE)
        if explanation is not None and isinstance(explanation.cause, Cause):
            values = explanation.fit.values
            prior.mean[SCALE] = self._prior(explanation.cause).mean[SCALE]
        return self.problem(motions).fit(prior, values)

    def ping_noise(self, motions: Sequence[Motion]) -> tuple[float, float]:
        """Sigma of the DVL's noise from ping to ping [m/s], and its own sigma.

        It is the median over the windows, without outliers: one in each window would be in all of
        them. The variance of n residuals is known to 2 / n of its square, by a median to pi / n.
        The unknowns are free: what a mount that is not told makes of the motion is no noise.
        """
        motions = self._without_outliers(motions)
        noise = self.free(motions, None).noise
        dof = noise.dof - 3.0 * len(SLOW)
        shares = (
            noise.rest / (1.0 - 2.0 / (9.0 * dof)) ** 3
        )  # the median of chi-square over its dof
        rest = float(np.median(shares))
        of_imu = float(np.median([m.noise[-1] for m in motions]))
        variance = max(rest - of_imu, SMALLEST**2)
        of_variance = rest * math.sqrt(math.pi / float(dof.sum()))
        return math.sqrt(variance), of_variance / (2.0 * math.sqrt(variance))

    def _without_outliers(self, motions: Sequence[Motion]) -> Sequence[Motion]:
        """The windows that have pings enough left without their outliers."""
        here = np.zeros(SIZE)
        lines = [(m.window.t, rows(m.window, self.known, here)[..., -1]) for m in motions]
        found = outliers(lines, SMALLEST)
        left = [
            Motion(motion.samples.without(is_outlier)) if is_outlier.any() else motion
            for motion, is_outlier in zip(motions, found, strict=True)
            if len(is_outlier) - is_outlier.sum() >= FEWEST_PINGS
        ]
        return left or motions

    def _climb(self, motions: Sequence[Motion], cause: Miswired) -> Array:
        """Row (16,) of the vehicle's climb when a cause is taken for right."""
        v_d = np.concatenate([m.window.v_d for m in motions]) @ cause.dvl.T
        f = np.concatenate([m.window.f for m in motions]) @ cause.accelerometer.T
        return Travel.of(v_d, f).row(self.known, np.zeros(SIZE))

    def _fit(self, problem: Problem, cause: Cause) -> Generator[None, None, Fit]:
        """The fit of a cause; it pauses after each try."""
        prior = self._prior(cause)
        if not cause.blocks & TURNS:
            yield
            return problem.fit(prior, prior.mean)
        fits = []
        for start in problem.starts(prior, level="yaw" in cause.blocks):
            fits.append(problem.fit(prior, start))
            yield
        best = min(fits, key=lambda fit: fit.cost())
        if "mount" in cause.blocks:
            for start in problem.rolled(best):
                fits.append(problem.fit(prior, start))
                yield
        return min(fits, key=lambda fit: fit.cost())

    def _spread(
        self, problem: Problem, tried: dict[Miswired, Information], e: Explanation
    ) -> Explanation:
        """An explanation by a turn, with the sigmas of one of which nothing was known."""
        if isinstance(e.cause, Miswired):
            prior = self._prior(Cause(frozenset(["mount"])))
            covariance = linear_spread(tried[e.cause], e.fit, prior)
        else:
            prior = self._prior(replace(e.cause, blocks=e.cause.blocks - TURNS | {"mount"}))
            covariance = problem.spread(e.fit, prior)
        return replace(e, fit=replace(e.fit, covariance=covariance))

    def _ranked(
        self, fits: dict[Cause | Miswired, Fit], motions: Sequence[Motion]
    ) -> list[Explanation]:
        """All explanations, the most probable one first.

        What is noise of the IMU in any case is no reason to prefer a cause that makes less of it,
        such as a gyroscope whose rates are too large, or a DVL that reads too little; nor is an
        error of a right DVL that lasts; nor what a turn of the DVL makes of the noise of an axis
        that measures nothing.
        """
        v_d = np.concatenate([m.window.v_d for m in motions])
        square = float((v_d**2).sum(axis=1).mean())
        least = np.array([m.noise for m in motions])
        lasting = self._lasting**2 * np.array(
            [m.bases.of_lasting(m.window.t, self._lasts) for m in motions]
        )
        noises = {
            cause: fit.noise.at_least(least, self._share(cause, fit), lasting)
            for cause, fit in fits.items()
        }

        def cost(cause: Cause | Miswired, excess: float) -> float:
            return fits[cause].cost(noises[cause], excess) + cause.penalty

        turns = {cause: self._turn(cause, fit) for cause, fit in fits.items()}
        bounds = {
            cause: [
                (other, self._most(turns[cause], turns[other], fit, motions))
                for other in cause.less_turned
                if other in fits
            ]
            + [
                (other, self._most_scaled(cause, fit, fits[other], noises[cause], least))
                for other in cause.less_scaled
                if other in fits
            ]
            for cause, fit in fits.items()
        }

        def bounded(cause: Cause | Miswired, excess: float) -> float:
            lowest = [cost(other, excess) - most / excess for other, most in bounds[cause]]
            speed = math.sqrt(square) * math.exp(-fits[cause].values[SCALE])
            return max([cost(cause, excess), *lowest]) + (speed / SPEED) ** 2

        best = min(fits, key=lambda cause: bounded(cause, 1.0))
        excess = noises[best].excess
        found = [Explanation(cause, fit, bounded(cause, excess)) for cause, fit in fits.items()]
        return sorted(found, key=lambda e: e.cost)

    def _turn(self, cause: Cause | Miswired, fit: Fit) -> Array:
        """DVL to body (3, 3) when a cause is taken for right."""
        turn = rotation_from_vector(fit.values[MOUNT]) @ self.known.C_b_d
        return turn @ cause.dvl if isinstance(cause, Miswired) else turn

    @staticmethod
    def _most(turn: Array, other: Array, fit: Fit, motions: Sequence[Motion]) -> float:
        """By how much one turn of the DVL can fit better than another: by the signal it changes.

        The signal is the slow part of the change, less the noise that is in all of it.

        Args:
            turn: (3, 3) DVL to body.
            other: (3, 3) the turn with which it is compared.
            fit: With the turn.
            motions: The windows.
        """
        change = turn - other
        slow, noise = 0.0, 0.0
        for motion, variance in zip(motions, fit.noise.variance, strict=True):
            w, bases = motion.window, motion.bases
            of_turn = np.einsum("kij,kj->ki", w.R, w.v_d @ change.T)
            parts = [float(((b.T @ of_turn) ** 2).sum()) for b in (bases.slow, bases.parabola)]
            rest = float((of_turn**2).sum()) - sum(parts)
            dof = 3.0 * (len(w.t) - SLOW[-1] - 1)
            slow += parts[0] / variance
            noise += 3.0 * len(SLOW) * rest / dof / variance
        # The power of noise in n values is within sqrt(2 n) of itself per value, one sigma.
        chance = noise * math.sqrt(2.0 / (3.0 * len(SLOW) * len(motions)))
        return max(0.0, slow - noise - CHANCE * chance)

    def _most_scaled(
        self, cause: Cause | Miswired, fit: Fit, other: Fit, noise: Noise, imu: Array
    ) -> float:
        """By how much another scale can fit better than none: by the signal that it changes.

        The noise of the IMU changes as well, and its power is known no better than from the few
        slow degrees of each window, here as if each window had one.

        Args:
            cause: With the scale.
            fit: With it.
            other: Without.
            noise: Of the residuals of the first.
            imu: (W, 5) variances by the noise of the IMU, see `Motion.noise`.
        """
        changed = ((fit.slow - other.slow) ** 2).sum(axis=1) / noise.variance
        of_noise = (1.0 - self._share(cause, fit)) ** 2 * 3.0 * imu[:, :-1].sum(axis=1)
        of_noise /= noise.variance
        chance = math.sqrt(float(of_noise @ of_noise))
        return max(0.0, float(changed.sum() - of_noise.sum()) - CHANCE * chance)

    @staticmethod
    def _share(cause: Cause | Miswired, fit: Fit) -> float:
        """Of the IMU's noise that a cause leaves in the residuals."""
        share = math.exp(fit.values[SCALE])
        if isinstance(cause, Miswired):
            share /= cause.factor
        return min(1.0, share)
