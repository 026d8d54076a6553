"""A factor on the process noise, told by the innovations of the velocity.

What a source tells of Q, a constant or a tuner, may be off by a factor that stays for the whole
mission: slow noise that hides below the motion, or motion that looks like slow noise. The pings
know it. A bank of small filters has one for each level of the factor (bank.py); the likelihoods of
their innovations tell how probable each is, and that with the mean standard deviation is in effect.

Only a ping that the gate takes as it is teaches, see `Filter.update`. The bank knows of no noise
but Q: after a gap of the IMU, frozen samples, or an inflation of P it begins anew, and as long as
the heading does not tell the Earth's rate.

Derivation: docs/explanation/process-noise-factor.md.
"""

from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.coordinates import body_velocity_jacobian
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, ATTITUDE, GYROSCOPE_BIAS, VELOCITY
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.earth import EARTH_RATE, gravity
from insdvl.navigation.geometry.frames import vector_from_rotation
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.measurements.base import Vehicle
from insdvl.navigation.process_noise import bank
from insdvl.navigation.process_noise.bank import LEVELS, PACKED, SIZE
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.process_noise.received import bounded
from insdvl.navigation.state.fields import COUNT, COVARIANCE, NEVER, NUMBER, STAMP, Field, State
from insdvl.navigation.state.groups import GATE_COUNTERS

#: After so long [s] without a ping the bank begins again at the next one.
PAUSE = 20.0
#: For so long [s] after its start the bank teaches nothing: all levels have the filter's estimate
#: then, and the filter itself may just have started.
SETTLING = 10.0
#: For so long [s] after a glitch of the IMU nothing is learned: Q is too large while a tuner has
#: the glitch in its window of 6 s, which it tells once a second.
GLITCH = 8.0
#: A heading that is known to this [rad], one sigma, tells the Earth's rate well enough.
KNOWN_HEADING = 0.02

#: Name of the group of the state record.
GROUP = "q_factor"
FIELDS = (
    Field("factor", NUMBER),  # in effect
    Field("likelihoods", NUMBER, (LEVELS.size,)),  # logarithms, see bank.py
    # Q without the factor, base_link axes, and its stamp
    Field("Q_f", COVARIANCE, (3, 3)),
    Field("Q_w", COVARIANCE, (3, 3)),
    Field("told_ns", STAMP),
    Field("learned_ns", STAMP),  # of the last ping that has taught
    # The bank: estimates relative to the filter's, covariances, begin, stamp of the last ping, and
    # how many disturbances there had been
    Field("errors", NUMBER, (LEVELS.size, SIZE)),
    Field("P", NUMBER, (LEVELS.size, PACKED)),
    Field("begin_ns", STAMP),
    Field("ping_ns", STAMP),
    Field("disturbances", COUNT),
)
#: Counters of events in which the filter's P gets what is no process noise: from the samples. Of a
#: single sample that is left out it gets next to nothing.
_OF_SAMPLES = ("gaps", "saturated", "frozen", "no_data")
_HEADING = ATTITUDE.stop - 1


class Estimate(NamedTuple):
    """What a correction changes of a state: attitude, velocity and biases."""

    C_n_b: Array
    v_n: Array
    b_f: Array
    b_w: Array


def estimate(nav: State) -> Estimate:
    """A copy of that of a state."""
    return Estimate(*(nav[name].copy() for name in Estimate._fields))


class Factor:
    """Estimates the factor on the Q of a state record, and keeps Q at it.

    Args:
        parameters: Of the process noise.
        vehicle: Memory and error state of the filter.
    """

    def __init__(self, parameters: ProcessNoiseParameters, vehicle: Vehicle) -> None:
        self._parameters = parameters
        self._vehicle = vehicle

    def start(self, s: State) -> None:
        """Nothing is learned of the Q in effect."""
        s[GROUP]["factor"], s[GROUP]["likelihoods"], s[GROUP]["learned_ns"] = 1.0, 0.0, NEVER
        self._take(s)

    def told(self, s: State) -> None:
        """A Q has taken the place of the one before; the factor goes on with it.

        A factor belongs to what it is on: between a received Q and the nominal one it starts anew.
        """
        if (s[GROUP]["told_ns"] == NEVER) != (s["noise"]["q_ns"] == NEVER):
            self.start(s)
        else:
            self._take(s)

    def _take(self, s: State) -> None:
        m, noise = s[GROUP], s["noise"]
        m["Q_f"], m["Q_w"], m["told_ns"] = noise["Q_f"], noise["Q_w"], noise["q_ns"]
        self._scale(s)

    def restart(self, s: State) -> None:
        """The state is a new one: the bank begins again, what was learned stays."""
        s[GROUP]["begin_ns"] = s[GROUP]["ping_ns"] = NEVER

    def _scale(self, s: State) -> None:
        """Q in effect, within the bounds of a received one."""
        p, m, noise = self._parameters, s[GROUP], s["noise"]
        for name, low, high in (
            ("Q_f", p.accelerometer_floor, p.accelerometer_ceiling),
            ("Q_w", p.gyroscope_floor, p.gyroscope_ceiling),
        ):
            noise[name], _, _ = bounded(m["factor"] * m[name], low, high)

    def meet(self, s: State, stamp_ns: int, now: Innovated, *, teaches: bool) -> Estimate:
        """The bank takes an accepted ping, before the filter is corrected by it.

        Args:
            s: State at the ping.
            stamp_ns: Of the ping.
            now: The ping, as the filter takes it.
            teaches: Whether the levels learn from it.

        Returns:
            The estimate of the filter, for `corrected`.
        """
        m, nav, disturbances = s[GROUP], s["nav"], _disturbances(s)
        if (m["told_ns"] == NEVER) != (s["noise"]["q_ns"] == NEVER):  # it has timed out
            self.told(s)
        is_new = m["ping_ns"] == NEVER or stamp_ns - int(m["ping_ns"]) > PAUSE * NS
        if is_new or disturbances != m["disturbances"] or not self._knows_earth_rate(s):
            m["disturbances"] = disturbances
            self.restart(s)
        else:
            self._advance(s, stamp_ns, now, teaches=teaches)
        return estimate(nav)

    def _advance(self, s: State, stamp_ns: int, now: Innovated, *, teaches: bool) -> None:
        m, nav = s[GROUP], s["nav"]
        seconds = (stamp_ns - int(m["ping_ns"])) / NS
        density, p = float(self._vehicle.constants[0]["density"]), self._parameters
        bank.advance(
            m["errors"],
            m["P"],
            nav["C_n_b"],
            nav["v_n"],
            gravity(nav["llh"][0], nav["llh"][2]),
            density * m["Q_f"],
            density * m["Q_w"],
            p.accelerometer_bias_walk,
            p.gyroscope_bias_walk,
            seconds,
        )
        rows, n = now.measured, now.H.shape[1]
        H, likelihoods = now.H[rows], np.empty(LEVELS.size)
        of_bank = np.zeros((len(H), SIZE))
        of_bank[:, VELOCITY] = H[:, VELOCITY]
        usable = bank.correct(
            m["errors"],
            m["P"],
            float(m["factor"]),
            of_bank,
            now.innovation[rows],
            np.ascontiguousarray(now.S[np.ix_(rows, rows)]),
            H @ nav["P"][:n, :n] @ H.T,
            likelihoods,
        )
        if not usable:
            self.restart(s)
        elif teaches and self._is_settled(s, stamp_ns):
            since_ns = m["learned_ns"] if m["learned_ns"] != NEVER else stamp_ns
            age = (stamp_ns - int(since_ns)) / NS
            m["likelihoods"] = bank.learned(m["likelihoods"], likelihoods, age)
            m["factor"], m["learned_ns"] = bank.mean_factor(m["likelihoods"]), stamp_ns

    @staticmethod
    def _is_settled(s: State, stamp_ns: int) -> bool:
        """Whether filter and bank have run for long enough, and without a glitch of the IMU."""
        begin_ns, glitch_ns = int(s[GROUP]["begin_ns"]), int(s["channels"]["step_ns"].max())
        return stamp_ns - begin_ns >= SETTLING * NS and stamp_ns - glitch_ns > GLITCH * NS

    def _knows_earth_rate(self, s: State) -> bool:
        """Whether the Earth's rate, which the bank leaves out, tilts the vehicle by too little.

        As far as the heading is unknown it is an error of the turn. A bias that may be as large
        covers it, and so does noise that tilts as much while the bank settles.
        """
        c = self._vehicle.constants[0]
        if not c["earth_rate"]:
            return True
        unknown = EARTH_RATE * np.sqrt(s["nav"]["P"][_HEADING, _HEADING])
        noise = np.sqrt(float(c["density"]) * np.trace(s[GROUP]["Q_w"]) / 3.0 / SETTLING)
        bias = self._vehicle.gyroscope_bias_std
        return bool(unknown <= max(bias, noise, EARTH_RATE * KNOWN_HEADING))

    def corrected(self, s: State, stamp_ns: int, before: Estimate) -> None:
        """The filter was corrected by that ping: the bank's estimates are relative to the new one.

        Args:
            s: State, corrected.
            stamp_ns: Of the ping.
            before: The estimate before that.
        """
        m = s[GROUP]
        if m["begin_ns"] == NEVER:
            self._begin(s, stamp_ns)
        else:
            self.follow(s, before)
        m["ping_ns"] = stamp_ns
        self._scale(s)

    @staticmethod
    def follow(s: State, before: Estimate) -> None:
        """The filter was corrected: the bank's estimates are relative to the new one.

        The bank knows the pings alone. What another sensor corrects is, against the bank, an error
        that the filter no longer has.

        Args:
            s: State, corrected.
            before: The estimate before that.
        """
        errors, nav = s[GROUP]["errors"], s["nav"]
        turned = nav["C_n_b"] @ before.C_n_b.T
        errors[:, VELOCITY] -= nav["v_n"] - turned @ before.v_n
        errors[:, ATTITUDE] -= vector_from_rotation(turned)
        errors[:, ACCELEROMETER_BIAS] -= nav["b_f"] - before.b_f
        errors[:, GYROSCOPE_BIAS] -= nav["b_w"] - before.b_w

    def _begin(self, s: State, stamp_ns: int) -> None:
        """All levels begin with the filter's estimate and covariance."""
        m, nav, n = s[GROUP], s["nav"], self._vehicle.n
        of_body = body_velocity_jacobian(
            nav["C_n_b"], nav["v_n"], invariant=self._vehicle.invariant, n=n
        )
        J, packed = np.eye(SIZE, n), np.empty(PACKED)
        J[VELOCITY] = nav["C_n_b"] @ of_body
        m["errors"] = 0.0
        bank.pack(packed, J @ nav["P"][:n, :n] @ J.T)
        m["P"] = packed
        m["begin_ns"] = stamp_ns


def _disturbances(s: State) -> int:
    """How many samples and gates have changed P by what is no process noise."""
    of_samples = sum(int(s["counters"][name]) for name in _OF_SAMPLES)
    gates = (s["gate"][name] for name in s["gate"].dtype.names)
    return of_samples + sum(int(gate[name]) for gate in gates for name in GATE_COUNTERS)
