"""A misfit that one bad sample of the IMU explains.

A sample that leaves its neighbours is believed if the next one agrees with it, and left out if not
(channels.py). Either may be wrong. Then it has turned the state, or changed its velocity, about the
axis of its channel: by no more than the size of the step, for as long as it lasted. A measurement
tells by how much.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation import coordinates, kalman
from insdvl.navigation.error_state import ATTITUDE, POSITION, VELOCITY
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.measurements.base import Vehicle
from insdvl.navigation.process_noise import shown
from insdvl.navigation.state.fields import State


def explains(
    s: State, vehicle: Vehicle, since_ns: int, stamp_ns: int, now: Innovated, limit: float
) -> bool:
    """Inflate the covariance by the step of a channel, if that explains an innovation.

    Args:
        s: State at the measurement.
        vehicle: That carries the IMU.
        since_ns: Steps after this stamp count: of the last accepted measurement.
        stamp_ns: Of the measurement.
        now: The measurement; its NIS is beyond the limit.
        limit: Of the NIS.

    Returns:
        Whether the covariance is larger now; the NIS by it is within the limit.
    """
    channels = s["channels"]
    stepped = np.flatnonzero(channels["step_ns"] > since_ns)
    if not stepped.size:
        return False
    # The vehicle turns and moves between the sample and the measurement. With this part of the
    # impulse in all directions, twice, one across the axis still has 1.25 times the limit.
    loosely = 1.0 / np.sqrt(2.5 * limit)
    n, C_n_i = now.H.shape[1], s["nav"]["C_n_b"] @ vehicle.C_b_i
    size = float(np.linalg.norm(now.innovation))
    columns = []
    for i in stepped:
        impulses, axis = _impulses(s, vehicle, int(i), stamp_ns, n), C_n_i[:, i % 3]
        seen = float(np.linalg.norm(now.H @ impulses @ axis))
        lasted_ns = int(channels["step_ns"][i]) - int(channels["step_from_ns"][i])
        largest = float(channels["step"][i]) * lasted_ns / NS
        amount = size / seen if size < largest * seen else largest
        columns.append(amount * impulses @ np.column_stack([axis, loosely * np.eye(3)]))
        if i >= 3:
            columns.append(amount * seen * loosely * np.eye(n)[:, VELOCITY])
    A = np.concatenate(columns, axis=1)
    R = now.R + (now.H @ A) @ (now.H @ A).T
    if kalman.innovate(shown.covariance(s, now.H), now.innovation, now.H, R).nis > limit:
        return False
    s["nav"]["P"][:n, :n] += A @ A.T
    return True


def _impulses(s: State, vehicle: Vehicle, i: int, stamp_ns: int, n: int) -> Array:
    """Error state (n, 3) at a stamp by unit impulses about NED's axes in the triad of channel i.

    After the time t a change of the velocity dv has moved the position by t dv. For `invariant` a
    turn psi has dv = ([v x] + [g x] t) psi, for `ned` without [v x]; in metres it has moved the
    position by t^2 / 2 [g x] psi.
    """
    A = np.zeros((n, 3))
    seconds = (stamp_ns - int(s["channels"]["step_ns"][i])) / NS
    if i < 3:
        A[VELOCITY], A[POSITION] = np.eye(3), seconds * np.eye(3)
        return A
    g_x = shown.gravity_matrix(s["nav"])
    A[ATTITUDE] = np.eye(3)
    A[VELOCITY] = seconds * g_x
    if vehicle.invariant:
        A[VELOCITY] += cross_matrix(s["nav"]["v_n"])
    A[POSITION] = coordinates.turns_position(s, invariant=vehicle.invariant)
    A[POSITION] += seconds**2 / 2.0 * g_x
    return A
