"""Map and odom: where the estimate is, and the frame in which no absolute input moves it.

The filter estimates in map. Odom is the same estimate, seen through four numbers of the record, the
position p of odom's origin in map and the yaw of its axes:

    p_m = p + R_z(yaw) p_o,        C_m_b = R_z(yaw) C_o_b

An absolute input tells heading or position against the Earth. What its update moves the estimate by
in position and yaw goes into the four numbers, and odom stays where it is. All other updates move
both. Roll, pitch, twist and biases are the same in both.

Odom's error is that of the estimate, and what absolute inputs have corrected. The two are
independent, so the covariances add: P of the estimate, and that of the corrections, which is what
each of them has taken from P. Derivation: docs/explanation/map-odom.md.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.kernels import kernel
from insdvl.navigation import coordinates
from insdvl.navigation.error_state import ATTITUDE, POSITION
from insdvl.navigation.geometry import earth, odom
from insdvl.navigation.geometry.rotation import about_down, cross_matrix, product_transposed
from insdvl.navigation.measurements.base import Vehicle
from insdvl.navigation.state.fields import State

#: A turn of odom by so much [rad], in sum, or a step of it by so much [m], counts as a reset.
RESET_TURN = math.radians(5.0)
RESET_STEP = 10.0

#: Where the horizontal part of the nose is shorter than this, within 10 deg of the vertical, yaw is
#: not defined: there the turn about the vertical is taken.
_SHORTEST_NOSE = math.sin(math.radians(10.0))
_HEADING = ATTITUDE.stop - 1


class Before(NamedTuple):
    """The estimate before an update.

    Attributes:
        C_n_b: (3, 3) attitude.
        llh: (3,) place of the IMU.
        seen: The rest, where the update is of an absolute input; else None.
    """

    C_n_b: Array
    llh: Array
    seen: "_Seen | None"


@dataclass(frozen=True)
class _Seen:
    """Where base_link is, and the covariance of its pose by the estimate.

    Attributes:
        gamma: Direction of north at base_link in map [rad].
        p_o: (3,) position in odom [m], north, east, down.
        P: (4, 4) covariance by P of `p_o`, without what a turn about the start makes of it, and of
            yaw; in odom's axes.
    """

    gamma: float
    p_o: Array
    P: Array


def before(s: State, vehicle: Vehicle, *, absolute: bool) -> Before:
    """The estimate before an update, by an absolute input or by another."""
    nav, o = s["nav"], s["odom"]
    seen = None
    if absolute:
        p_m, gamma = _in_map(s, vehicle)
        p_o = _turn(-float(o["yaw"])) @ (p_m - o["p"])
        if not is_moved(s):  # from here on odom has the way from the reference that map has now
            o["reference"] = p_o - _to_odom(s, 0.0) @ _from_reference(s, vehicle)
        seen = _Seen(gamma, p_o, _covariance(s, vehicle, p_o, float(o["yaw"])))
    return Before(nav["C_n_b"].copy(), nav["llh"].copy(), seen)


def moved(state: Records, vehicle: Vehicle, was: Before) -> None:
    """An update has moved the estimate: odom stays, or the move is looked at whether it is a reset.

    Args:
        state: (1,) record after the update.
        vehicle: Of the filter.
        was: The estimate before it.
    """
    if was.seen is None:
        move_odom(state, was.C_n_b, was.llh)
        return
    s = state[0]
    nav, o, seen, yaw = s["nav"], s["odom"], was.seen, float(s["odom"]["yaw"])
    turn = yaw_between(was.C_n_b, nav["C_n_b"])
    p_m, gamma = _in_map(s, vehicle)
    after = math.remainder(yaw + turn + gamma - seen.gamma, 2.0 * math.pi)
    if (was.llh != nav["llh"]).any() or (was.C_n_b != nav["C_n_b"]).any():
        o["p"] = p_m - _turn(after) @ seen.p_o
        o["yaw"] = after
    P = _covariance(s, vehicle, seen.p_o, after)
    o["P"] += _positive(seen.P - P, np.diagonal(seen.P))


def begin(s: State) -> None:
    """A new state begins: odom is map."""
    o = s["odom"]
    for name in o.dtype.names:
        o[name] = 0.0


def is_moved(s: State) -> bool:
    """Whether an absolute input has corrected the estimate, so that odom is not map."""
    o = s["odom"]
    return bool(o["yaw"] or o["p"].any() or o["P"].any())


@kernel
def yaw_between(C_before: Array, C_after: Array) -> float:
    """By how much the yaw has changed [rad]: the direction of the nose, seen from above."""
    a, b = C_before[:, 0], C_after[:, 0]
    if min(math.hypot(a[0], a[1]), math.hypot(b[0], b[1])) > _SHORTEST_NOSE:
        return math.atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
    turn = np.empty((3, 3))
    product_transposed(turn, C_after, C_before)
    return math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])


@kernel
def move_odom(state: Records, C_before: Array, llh_before: Array) -> None:
    """Odom has moved with the estimate by an update."""
    s, step = state[0], np.empty(3)
    o = s.odom
    o.turned += yaw_between(C_before, s.nav.C_n_b)
    earth.displacement(step, llh_before, s.nav.llh)
    distance = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    if abs(o.turned - o.turned_at_reset) > RESET_TURN or distance > RESET_STEP:
        o.turned_at_reset = o.turned
        s.counters.odom_resets += 1


def _origin(s: State) -> Array:
    nav = s["nav"]
    return np.array([nav["lat_0"], nav["lon_0"], nav["h_0"]])


def _in_map(s: State, vehicle: Vehicle) -> tuple[Array, float]:
    """Position (3,) of base_link in map [m], north, east, down, and direction of north there."""
    nav = s["nav"]
    place = nav["llh"].copy()
    earth.move(place, -nav["C_n_b"] @ vehicle.l_b_imu)
    p_m = np.empty(3)
    odom.position(p_m, place, _origin(s))
    return p_m, _north(s, place)


def _north(s: State, place: Array) -> float:
    """Direction of north at a place in map [rad]."""
    C = np.empty((3, 3))
    odom.axes(C, place, _origin(s))
    return float(odom.convergence(C))


def _turn(angle: float) -> Array:
    R = np.empty((3, 3))
    about_down(R, angle)
    return R


def _to_odom(s: State, yaw: float) -> Array:
    """Rotation (3, 3) from north, east, down at the vehicle to odom's axes, whose yaw is given."""
    return _turn(_north(s, s["nav"]["llh"]) - yaw)


def _from_reference(s: State, vehicle: Vehicle) -> Array:
    """b (3,) from the reference of the position error to base_link [m], north, east, down."""
    nav = s["nav"]
    return coordinates.from_reference(nav) - nav["C_n_b"] @ vehicle.l_b_imu


def _covariance(s: State, vehicle: Vehicle, p_o: Array, yaw: float) -> Array:
    """Covariance (4, 4) by P of the position and of yaw in odom's axes, see `_Seen`.

    With the error of base_link's position

        invariant:  dp - [b x] psi,  b from the reference of the filter
        ned:        dp + [C l x] psi

    and b_o from that of odom, which began to differ there, the rows are that error + [b_o x] e_D
    psi_D: what is left without a turn about the start.
    """
    P, A = s["nav"]["P"], _to_odom(s, yaw)
    b_o = A.T @ (p_o - s["odom"]["reference"])
    J = np.zeros((4, vehicle.n))
    J[:3, POSITION] = np.eye(3)
    if vehicle.invariant:
        J[:3, ATTITUDE] = -cross_matrix(_from_reference(s, vehicle))
    else:
        J[:3, ATTITUDE] = cross_matrix(s["nav"]["C_n_b"] @ vehicle.l_b_imu)
    J[0, _HEADING] += b_o[1]
    J[1, _HEADING] -= b_o[0]
    J[3, _HEADING] = 1.0
    J[:3] = A @ J[:3]
    return np.asarray(J @ P[: vehicle.n, : vehicle.n] @ J.T)


def _positive(P: Array, variances: Array) -> Array:
    """The part of a symmetric matrix (m, m) that is no loss, in units of given variances (m,)."""
    sigma = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    values, vectors = np.linalg.eigh(P / np.outer(sigma, sigma))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) * sigma[:, None]
    return np.asarray(root @ root.T)
