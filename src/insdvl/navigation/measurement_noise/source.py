"""The estimated noise of a velocity sensor, on the state record.

The record holds the probabilities of the levels of the factor on the nominal covariance, the last
pings, the squares of the window and the correlation of the innovations. Only a measurement that the
gate takes as it is teaches: not one that is refused, doubted, used softly, or taken for a vehicle
at rest, nor one beside an IMU that is in doubt.
"""

from typing import Any, NamedTuple

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation import kalman
from insdvl.navigation.error_state import VELOCITY
from insdvl.navigation.events import NS, Measurement, SensorNoise
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.measurement_noise import guard, levels, window
from insdvl.navigation.measurement_noise.guard import Correlation
from insdvl.navigation.measurement_noise.levels import LARGEST, SMALLEST, Factors, Whitened
from insdvl.navigation.measurements.base import Linearised, SensorModel
from insdvl.navigation.state.fields import COUNT, COVARIANCE, NEVER, NUMBER, STAMP, Field, State

#: Sources of a sensor's noise, its parameter ``noise_source``.
NOMINAL, LEARNED, ORACLE = "nominal", "learned", "oracle"

#: After so long [s] without a measurement an innovation is not compared with the one before.
PAUSE = 10.0
#: Least and largest factor by which the gate judges.
LEAST_FOR_GATE, LARGEST_FOR_GATE = 4.0, 9.0

#: What the filter has learned itself.
_OWN = (
    Field("factor", NUMBER),  # on the nominal covariance, in effect; 0 before there is any
    # Of the levels, see levels.py, and stamp of the last measurement that has taught
    Field("probabilities", NUMBER, (len(levels.LEVELS),)),
    Field("learned_ns", STAMP),
    # The last pings, the newest first: velocity at the IMU, carried forward, and covariance of
    # their noise, NED; their stamps; and the velocity of the state that they were carried to
    Field("pings", NUMBER, (window.PAST, 3)),
    Field("covariances", NUMBER, (window.PAST, 3, 3)),
    Field("pings_ns", STAMP, (window.PAST,)),
    Field("v_n", NUMBER, (3,)),
    Field("carried_ns", STAMP),
    # Squares of the third differences, and the stamps of their newest pings
    Field("squares", NUMBER, (window.SIZE,)),
    Field("squares_ns", STAMP, (window.SIZE,)),
    # Correlation of the innovations, see guard.py, and the last one in sigma
    Field("product", NUMBER),
    Field("square", NUMBER),
    Field("pairs", COUNT),
    Field("innovation", NUMBER, (3,)),
)

#: The group of the state record.
FIELDS = (
    *_OWN,
    # Covariance that was received last, its stamp, and the factor that it is on the nominal
    # covariance of the first measurement since, 0 before that one
    Field("received", COVARIANCE, (3, 3)),
    Field("received_ns", STAMP),
    Field("received_factor", NUMBER),
)


#: What an R in force is made from.
INNOVATIONS, RECEIVED, WINDOW = "innovations", "received", "own window"


class InForce(NamedTuple):
    """The noise that the last measurement that taught had, and the next one is expected to have.

    Attributes:
        factor: On the nominal covariance.
        origins: The share of each of `INNOVATIONS`, `RECEIVED`, `WINDOW` and `NOMINAL` in it, that
            is not zero.
        age_ns: Of the covariance that was received last; None before the first one.
        timed_out: Whether that one was too old for the last measurement that taught.
    """

    factor: float
    origins: dict[str, float]
    age_ns: int | None
    timed_out: bool

    @property
    def text(self) -> str:
        """The origins in words."""
        if len(self.origins) == 1:
            return next(iter(self.origins))
        return ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in self.origins.items())


def smallest_factor(R_0: Array, floor: float) -> float:
    """Smallest factor on a nominal covariance (m, m) that a floor of the sigmas allows."""
    variances = np.diagonal(R_0)
    if not variances.all():
        return 1.0
    return min(max(float(np.max(floor**2 / variances)), SMALLEST), LARGEST)


class MeasurementNoise:
    """Estimates the noise of one velocity sensor.

    Args:
        name: Of its measurements.
        model: Of the sensor.
        timeout_ns: A received covariance that is older is not used.
    """

    def __init__(self, name: str, model: SensorModel[Any], timeout_ns: int) -> None:
        self._group = f"{name}_noise"
        self._model = model
        self._timeout_ns = timeout_ns
        # What is received has no doubt either; the oracle differs in the topic alone.
        self._learned = model.noise_source in (LEARNED, ORACLE)

    def start(self, s: State) -> None:
        """Nothing is known but what was received; the nominal noise is expected."""
        m = s[self._group]
        for field in _OWN:
            m[field.name] = NEVER if field.holds == STAMP else 0
        m["factor"] = 1.0
        m["probabilities"] = levels.PRIOR

    def receive(self, s: State, event: SensorNoise) -> None:
        """A covariance takes the place of the window's factor from its stamp on."""
        m = s[self._group]
        m["received"], m["received_ns"], m["received_factor"] = event.R, event.stamp_ns, 0.0

    def in_force(self, s: State) -> InForce:
        """The noise in force, and where it is from."""
        m = s[self._group]
        age_ns = None
        if m["received_ns"] != NEVER:
            age_ns = int(s["nav"]["time_ns"]) - int(m["received_ns"])
        if m["learned_ns"] == NEVER:
            return InForce(1.0, {NOMINAL: 1.0}, age_ns, timed_out=False)
        learned_ns, basis = int(m["learned_ns"]), NOMINAL
        in_time = self._in_time(m, learned_ns)
        if in_time and m["received_factor"]:
            basis = RECEIVED
        elif len(window.recent(m["squares"], m["squares_ns"], learned_ns)) >= window.FEWEST:
            basis = WINDOW
        told = Correlation(float(m["product"]), float(m["square"]), int(m["pairs"]))
        doubt = self._doubt(told, len(m["innovation"]))
        shares = {INNOVATIONS: 1.0 - doubt, basis: doubt}
        origins = {name: share for name, share in shares.items() if share > 0.0}
        timed_out = age_ns is not None and not in_time
        return InForce(float(m["factor"]), origins, age_ns, timed_out)

    # ---------------------------------------------------------------- the pings, carried by the IMU

    def carry(self, s: State) -> None:
        """Carry the pings forward to the state, before any measurement corrects it.

        By the specific force alone: a constant gravity is a line in time, which the third
        difference does not have.
        """
        m, nav = s[self._group], s["nav"]
        if m["factor"] == 0.0:  # a state from a filter that did not estimate it
            self.start(s)
        time_ns, carried_ns = int(nav["time_ns"]), int(m["carried_ns"])
        if carried_ns not in (NEVER, time_ns):
            fell = np.array([0.0, 0.0, gravity(nav["llh"][0], nav["llh"][2])])
            m["pings"] += nav["v_n"] - m["v_n"] - fell * ((time_ns - carried_ns) / NS)
        m["v_n"], m["carried_ns"] = nav["v_n"], time_ns

    def follow(self, s: State, C_n_b: Array) -> None:
        """Turn the pings with a correction of the state, whose attitude was C_n_b (3, 3) before."""
        m, nav = s[self._group], s["nav"]
        m["pings"] = m["pings"] @ (nav["C_n_b"] @ C_n_b.T).T
        m["v_n"] = nav["v_n"]

    # ---------------------------------------------------------------- R

    def for_gate(self, s: State, event: Measurement, nominal: Linearised) -> Linearised:
        """The measurement by whose R the gate judges: 2 to 3 times the nominal sigma.

        A gate that went by a small estimate would refuse the first measurements above a worse
        bottom, and never learn of it; one that went by a large one would let a fault pass.
        """
        factor = min(max(self._expected(s, event), LEAST_FOR_GATE), LARGEST_FOR_GATE)
        return nominal._replace(R=self._scaled(event, nominal, factor))

    def predicted(self, s: State, event: Measurement, nominal: Linearised) -> Innovated:
        """The measurement against its prediction, by what was learned before it."""
        R = self._scaled(event, nominal, self._expected(s, event))
        return kalman.innovate(s["nav"]["P"], nominal.z_minus_h, nominal.H, R)

    def learn(self, s: State, event: Measurement, nominal: Linearised, now: Innovated) -> Innovated:
        """Learn from a measurement, to which the pings were carried.

        Args:
            s: State at the measurement.
            event: The measurement.
            nominal: The same, with its nominal R.
            now: The same, as the gate has taken it.

        Returns:
            The measurement with the gain that is known with it, and the R with which Joseph's form
            also has the doubt about that gain.
        """
        of_gain, of_covariance = self._factors(s, event, nominal, now)
        R = self._scaled(event, nominal, of_gain)
        known = kalman.innovate(s["nav"]["P"], now.innovation, now.H, R)
        return known._replace(R=self._scaled(event, nominal, of_covariance))

    def _scaled(self, event: Measurement, nominal: Linearised, factor: float) -> Array:
        """R with a factor on the measurement's own noise, where it was measured."""
        measured = nominal.H.any(axis=1)
        own = np.where(np.outer(measured, measured), self._model.noise(event), 0.0)
        return nominal.R + (factor - 1.0) * own

    def _expected(self, s: State, event: Measurement) -> float:
        return max(float(s[self._group]["factor"]), self._smallest(self._model.noise(event)))

    def _smallest(self, R_0: Array) -> float:
        return smallest_factor(R_0, self._model.noise_floor)

    def _factors(
        self, s: State, event: Measurement, nominal: Linearised, now: Innovated
    ) -> Factors:
        m, stamp_ns, measured = s[self._group], event.stamp_ns, now.measured
        R_0, rows = self._model.noise(event), np.ix_(measured, measured)
        own, other = R_0[rows], (nominal.R - R_0)[rows]
        M = (now.S - now.R)[rows] + other
        innovation = levels.whitened(now.innovation[measured], M, own)
        if innovation is None:
            expected = self._expected(s, event)
            return Factors(expected, expected)
        if measured.all():
            self._compare(m, stamp_ns, now, R_0)
        low = self._smallest(R_0)
        of_window = self._received(m, stamp_ns, R_0, comparable=bool(measured.all()))
        if of_window is None:
            of_window = window.mean_factor(window.recent(m["squares"], m["squares_ns"], stamp_ns))
        found = self._believe(m, stamp_ns, innovation, low)
        told = Correlation(float(m["product"]), float(m["square"]), int(m["pairs"]))
        doubt = self._doubt(told, int(measured.sum()))
        of_window = min(max(1.0 if of_window is None else of_window, low), LARGEST)
        factor = guard.between(found.gain, of_window, doubt)
        if measured.all():
            self._correlate(m, stamp_ns, now.innovation, np.diagonal(M + factor * own), told)
        m["factor"], m["learned_ns"] = factor, stamp_ns
        return Factors(factor, factor * (found.covariance / found.gain) ** (1.0 - doubt))

    def _doubt(self, told: Correlation, components: int) -> float:
        """How far the innovations are not believed; what is learned does without them."""
        return 1.0 if self._learned else guard.doubt(told, components)

    def _in_time(self, m: State, stamp_ns: int) -> bool:
        """Whether a covariance was received that is not too old at a stamp."""
        return bool(
            m["received_ns"] != NEVER and stamp_ns - int(m["received_ns"]) <= self._timeout_ns
        )

    def _received(self, m: State, stamp_ns: int, R_0: Array, *, comparable: bool) -> float | None:
        """The received factor; None where none is in effect.

        A covariance is compared with the nominal one of the measurement that has its stamp, or is
        the first one after it: what a message tells of single measurements stays in theirs.
        """
        if not self._in_time(m, stamp_ns):
            return None
        if m["received_factor"] == 0.0 and comparable:
            m["received_factor"] = np.trace(np.linalg.solve(R_0, m["received"])) / len(R_0)
        return float(m["received_factor"]) or None

    def _compare(self, m: State, stamp_ns: int, now: Innovated, R_0: Array) -> None:
        """The ping joins the last ones, and their third difference the window."""
        C_d_n = now.H[:, VELOCITY]
        ping = C_d_n.T @ now.innovation + m["v_n"]
        stamps = np.concatenate([m["pings_ns"][::-1], [stamp_ns]])
        velocities = np.concatenate([m["pings"][::-1], ping[None]])
        covariances = np.concatenate([m["covariances"][::-1], (C_d_n.T @ R_0 @ C_d_n)[None]])
        if stamps[0] != NEVER and stamp_ns - stamps[0] <= window.LONGEST * NS:
            square = window.difference_square(stamps, velocities, covariances)
            if np.isfinite(square):
                oldest = np.argmin(m["squares_ns"])
                m["squares"][oldest], m["squares_ns"][oldest] = square, stamp_ns
        m["pings_ns"], m["pings"] = stamps[:0:-1], velocities[:0:-1]
        m["covariances"] = covariances[:0:-1]

    @staticmethod
    def _believe(m: State, stamp_ns: int, innovation: Whitened, low: float) -> Factors:
        """The levels learn from an innovation."""
        since = (stamp_ns - int(m["learned_ns"])) / NS if m["learned_ns"] != NEVER else 0.0
        before = levels.moved(m["probabilities"], since)
        m["probabilities"], factors = levels.learned(before, innovation, low)
        return factors

    @staticmethod
    def _correlate(
        m: State, stamp_ns: int, innovation: Array, variances: Array, told: Correlation
    ) -> None:
        """The innovation is compared with the one before it, where that is near."""
        now = guard.normalised(innovation, variances)
        if m["learned_ns"] != NEVER and stamp_ns - int(m["learned_ns"]) <= PAUSE * NS:
            m["product"], m["square"], m["pairs"] = guard.followed(told, m["innovation"], now)
        m["innovation"] = now
