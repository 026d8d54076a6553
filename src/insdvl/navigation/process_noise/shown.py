"""Process noise that the IMU itself shows, beyond what the filter is told.

Neighbouring samples of white noise differ by twice its variance (channels.py). Where that is more
than the filter is told, its P is too small, and a right measurement would look like a fault. The
verdict on a measurement therefore takes the covariance of the error that the untold noise makes,
with the gains that the filter really has. P itself stays as the filter is told.

Derivation: docs/explanation/filter.md.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.channels import FEWEST_CHANGES
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    VELOCITY,
)
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.measurements.base import Vehicle
from insdvl.navigation.state import NEVER, State

#: The mean of the last changes is known to 15 %: what is shown counts from so much of the told on.
CLEARLY_MORE = 1.5
#: The error states that the untold noise reaches: it drives velocity and attitude, and with wrong
#: gains also the estimates of the biases.
REACHED = slice(VELOCITY.start, GYROSCOPE_BIAS.stop)
_N = REACHED.stop


def gravity_matrix(nav: State) -> Array:
    """[g x] (3, 3) at the place of a state: what a turn makes of the acceleration [m/s^2]."""
    lat, _, h = nav["llh"]
    return cross_matrix(np.array([0.0, 0.0, gravity(lat, h)]))


def _untold_densities(s: State, vehicle: Vehicle) -> tuple[Array, Array]:
    """Densities (3, 3) of the noise of both triads that is not told, NED."""
    c, C = vehicle.constants[0], vehicle.C_b_i
    if s["channels"]["changes"] < FEWEST_CHANGES:
        return np.zeros((3, 3)), np.zeros((3, 3))
    C_n_i, change = s["nav"]["C_n_b"] @ C, s["channels"]["change"]
    densities = []
    for name, part in (("Q_f", slice(0, 3)), ("Q_w", slice(3, 6))):
        shown = change[part] / (2.0 * c["rate"])
        told = c["density"] * np.diag(C.T @ s["noise"][name] @ C)
        density = np.where(shown > CLEARLY_MORE * told, shown - told, 0.0)
        densities.append(C_n_i * density @ C_n_i.T)
    return densities[0], densities[1]


def advance(s: State, vehicle: Vehicle, stamp_ns: int) -> None:
    """Add to ``noise.excess`` what the untold noise has made since it was last advanced.

    With the noise n_w of the gyroscopes dv' = [v x] n_w + [g x] psi and psi' = n_w; with that of
    the accelerometers dv' = n_f. For `ned` without [v x].
    """
    noise, nav = s["noise"], s["nav"]
    since_ns, noise["excess_ns"] = int(noise["excess_ns"]), stamp_ns
    if since_ns == NEVER or stamp_ns <= since_ns:
        return
    seconds = (stamp_ns - since_ns) / NS
    S_f, S_w = _untold_densities(s, vehicle)
    if not (S_f.any() or S_w.any() or noise["excess"].any()):
        return
    g_x = gravity_matrix(nav)
    M = cross_matrix(nav["v_n"]) if vehicle.invariant else np.zeros((3, 3))
    Phi, Q, C = np.eye(_N), np.zeros((_N, _N)), nav["C_n_b"]
    Phi[VELOCITY, ATTITUDE] = g_x * seconds
    Phi[VELOCITY, ACCELEROMETER_BIAS] = -C * seconds
    Phi[VELOCITY, GYROSCOPE_BIAS] = -(M * seconds + g_x * seconds**2 / 2.0) @ C
    Phi[ATTITUDE, GYROSCOPE_BIAS] = -C * seconds
    cross = M @ S_w @ g_x.T
    Q[VELOCITY, VELOCITY] = (S_f + M @ S_w @ M.T) * seconds + (cross + cross.T) * seconds**2 / 2.0
    Q[VELOCITY, VELOCITY] += g_x @ S_w @ g_x.T * seconds**3 / 3.0
    Q[VELOCITY, ATTITUDE] = M @ S_w * seconds + g_x @ S_w * seconds**2 / 2.0
    Q[ATTITUDE, VELOCITY] = Q[VELOCITY, ATTITUDE].T
    Q[ATTITUDE, ATTITUDE] = S_w * seconds
    noise["excess"] = Phi @ noise["excess"] @ Phi.T + Q


def drift(s: State, vehicle: Vehicle, seconds: float) -> Array:
    """Covariance (3, 3) of what the untold noise adds to a drift of the velocity, NED."""
    S_f, S_w = _untold_densities(s, vehicle)
    g_x = gravity_matrix(s["nav"])
    tilt = s["noise"]["excess"][ATTITUDE, ATTITUDE] * seconds**2 + S_w * seconds**3 / 3.0
    return S_f * seconds + g_x @ tilt @ g_x.T


def corrected(s: State, K: Array, H: Array) -> None:
    """A measurement has corrected the state with the gain K (n, m) and the Jacobian H (m, n)."""
    B = np.eye(_N) - K[REACHED] @ H[:, REACHED]
    s["noise"]["excess"] = B @ s["noise"]["excess"] @ B.T


def restart(s: State) -> None:
    """The state is a new one."""
    s["noise"]["excess"], s["noise"]["excess_ns"] = 0.0, s["nav"]["time_ns"]


def covariance(s: State, n: int) -> Array:
    """Covariance (n, n) of the error state, with that of the untold noise."""
    P = s["nav"]["P"][:n, :n].copy()
    P[REACHED, REACHED] += s["noise"]["excess"]
    return P
