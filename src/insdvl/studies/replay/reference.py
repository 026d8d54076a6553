"""The recorded reference, and the states at its stamps."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records, Stamps
from insdvl.messages import convert
from insdvl.messages.cdr.odometries import decode_odometries
from insdvl.messages.cdr.odometry_bytes import OdometryColumns
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.topics import TRUTH
from insdvl.navigation.events import MAX_VARIANCE
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import (
    NED,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)
from insdvl.navigation.geometry.odom import MAX_FROM_ORIGIN
from insdvl.navigation.odometry import odometries
from insdvl.recordings.base import Raw, decode
from insdvl.recordings.played import Recording
from insdvl.studies.evaluation.metrics import Track
from insdvl.studies.replay.consumer import Consumer, initialised

#: Messages that are read at once.
_BATCH = 4096


def truth_of(recording: Recording) -> tuple[Stamps, Track]:
    """Stamps (M,) and states of the ground truth, in the axes of the stream."""
    stamps_ns, truth, _ = reference_of(recording)
    return stamps_ns, truth


def reference_of(recording: Recording) -> tuple[Stamps, Track, Array]:
    """As `truth_of`, and what it says of its own error (M, 2), see `AtReference.told_sigma`."""
    messages = recording.on([TRUTH])
    stamps: list[Stamps] = [np.empty(0, np.int64)]
    shapes = (3, 3), (3,), (3,), (2,)
    columns = [[np.empty((0, *shape))] for shape in shapes]
    while batch := list(islice(messages, _BATCH)):
        stamps_ns, *values = _states_of(batch)
        stamps.append(stamps_ns)
        for column, value in zip(columns, values, strict=True):
            column.append(value)
    C, v_b, p_o, sigma = (np.concatenate(column) for column in columns)
    return np.concatenate(stamps), Track(C, v_b, p_o), sigma


def _states_of(raws: Sequence[Raw]) -> tuple[Stamps, Array, Array, Array, Array]:
    """Of the messages that can be used, see `reference_of`.

    Stamps, attitudes, velocities in body axes, positions and sigmas.
    """
    first = decode(raws[0]).message
    frames = str(first.header.frame_id), str(first.child_frame_id)
    told, is_known = decode_odometries([raw.data for raw in raws], frames)
    is_known &= _is_plain(told)
    stamps_ns, v_b, p_o = told.stamps_ns, told.linear, told.position
    C = np.empty((len(raws), 3, 3))
    C[is_known] = rotation_from_quaternion(told.quaternion_xyzw[is_known])
    variances = np.diagonal(told.pose_covariance, axis1=1, axis2=2)
    sigma = np.sqrt(np.stack([variances[:, 5], variances[:, :2].sum(axis=1)], axis=1).clip(min=0.0))
    for k in np.flatnonzero(~is_known).tolist():
        try:
            event = convert.initial(decode(raws[k]).message, NED, once=True)
        except RejectedMessage:  # counted where it is folded
            continue
        stamps_ns[k], C[k], v_b[k], p_o[k] = event.stamp_ns, event.C_o_b, event.v, event.p_o
        P_psi, P_p = (np.zeros((3, 3)) if P is None else P for P in (event.P_psi, event.P_p))
        sigma[k] = np.sqrt([max(P_psi[2, 2], 0.0), max(P_p[0, 0] + P_p[1, 1], 0.0)])
        is_known[k] = True
    return stamps_ns[is_known], C[is_known], v_b[is_known], p_o[is_known], sigma[is_known]


def _is_plain(told: OdometryColumns) -> NDArray[np.bool_]:
    """Whether odometries (N,) are such that `convert.initial` surely takes them."""
    numbers = np.hstack([told.position, told.quaternion_xyzw, told.linear])
    plain = np.isfinite(numbers).all(axis=1)
    plain &= np.abs(np.linalg.norm(told.quaternion_xyzw, axis=1) - 1.0) < 0.99e-2
    plain &= np.abs(told.position[:, :2]).max(axis=1) < 0.7 * MAX_FROM_ORIGIN
    for P in told.pose_covariance, told.twist_covariance:
        # Positive definite by its diagonal, as that of a reference with independent errors; or
        # unknown.
        diagonal = np.diagonal(P, axis1=1, axis2=2)
        beside = np.abs(P).sum(axis=2) - np.abs(diagonal)
        dominant = (diagonal >= beside).all(axis=1) & (diagonal.max(axis=1) <= MAX_VARIANCE)
        plain &= dominant & (P.transpose(0, 2, 1) == P).all(axis=(1, 2))
    return plain


@dataclass(frozen=True)
class AtReference:
    """The reference and the filter at those M stamps of the reference for which there is a state.

    Attributes:
        stamps_ns: (M,) stamps, in the order of the reference.
        truth: The reference, in the axes of the stream.
        track: The filter.
        sigma: (M, 6) what it says of its error, of velocity in body axes [m/s] and position [m].
        heading_sigma: (M,) the same of the heading [rad].
        told_sigma: (M, 2) what the reference says of its own error, of heading [rad] and horizontal
            position [m]; 0 where it says nothing.
    """

    stamps_ns: Stamps
    truth: Track
    track: Track
    sigma: Array
    heading_sigma: Array
    told_sigma: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)


class Reference(Consumer):
    """Finds the states at the stamps of a reference, in the axes of the stream.

    Between two stamps of the IMU position, velocity and sigmas are interpolated linearly, the
    attitude along the shortest rotation. After a time jump it begins anew.

    Args:
        stamps_ns: (M,) stamps of the reference.
        truth: Its states.
        told_sigma: (M, 2) see `AtReference`; by default it says nothing.
    """

    def __init__(self, stamps_ns: Stamps, truth: Track, told_sigma: Array | None = None) -> None:
        self._stamps_ns, self._truth = stamps_ns, truth
        self._told_sigma = np.zeros((len(stamps_ns), 2)) if told_sigma is None else told_sigma
        self._order = np.argsort(stamps_ns, kind="stable")
        self._sorted_ns = stamps_ns[self._order]
        self._begin()

    def _begin(self) -> None:
        self._row: Records | None = None  # odometry of the last state that was taken
        self._row_ns = 0
        self._indices: list[NDArray[np.intp]] = []
        self._found: list[tuple[Array, ...]] = []  # C, v_b, p_o, sigma, that of the heading
        self._is_over = False

    def take(self, filter_: Filter, states: Records) -> None:
        """See `Consumer`."""
        if self._is_over:
            self._begin()
        follows = bool(states[0]["nav"]["initialised"])
        for known in initialised(states):
            if not follows:
                self._row = None
            self._take(filter_, known)
            follows = False  # between two runs the filter knew nothing
        if not states[-1]["nav"]["initialised"]:
            self._row = None

    def _take(self, filter_: Filter, states: Records) -> None:
        """States that are all initialised, and follow the last one that was taken, if any."""
        times_ns = np.ascontiguousarray(states["nav"]["time_ns"])
        if self._row is None:
            first = np.searchsorted(self._sorted_ns, times_ns[0])
        else:
            first = np.searchsorted(self._sorted_ns, self._row_ns, side="right")
        part = slice(first, np.searchsorted(self._sorted_ns, times_ns[-1], side="right"))
        wanted_ns = self._sorted_ns[part]
        after = np.searchsorted(times_ns, wanted_ns)
        exact = times_ns[after] == wanted_ns
        before = np.where(exact, after, after - 1)  # -1 is the last state of those before
        last = len(states) - 1
        needed, rows = np.unique(np.concatenate([before, after, [last]]), return_inverse=True)
        table = odometries(filter_, states, needed[needed >= 0])
        if needed[0] < 0:
            table = np.concatenate([self._row, table])
        if wanted_ns.size:
            a, b = rows[: len(after)], rows[len(after) : -1]
            before_ns = np.where(before < 0, self._row_ns, times_ns[before])
            span = np.where(exact, 1, times_ns[after] - before_ns)
            share = ((wanted_ns - before_ns) / span)[:, None]
            self._indices.append(self._order[part])
            self._found.append(_between(table, a, b, exact[:, None], share))
        self._row, self._row_ns = table[-1:].copy(), int(times_ns[-1])

    def end(self) -> None:
        """See `Consumer`."""
        self._is_over = True

    @property
    def result(self) -> AtReference:
        """Of the last time that was taken."""
        indices = np.concatenate([np.empty(0, np.intp), *self._indices])
        order = np.argsort(indices)
        shapes = (3, 3), (3,), (3,), (6,), (1,)
        C, v_b, p_o, sigma, heading_sigma = (
            np.concatenate([np.empty((0, *shape)), *(found[k] for found in self._found)])[order]
            for k, shape in enumerate(shapes)
        )
        at, truth = indices[order], self._truth
        return AtReference(
            self._stamps_ns[at],
            Track(truth.C_n_b[at], truth.v_b[at], truth.p_o[at]),
            Track(C, v_b, p_o),
            sigma,
            heading_sigma[:, 0],
            self._told_sigma[at],
        )


def _between(
    table: Records, a: NDArray[np.intp], b: NDArray[np.intp], exact: NDArray[np.bool_], share: Array
) -> tuple[Array, ...]:
    """C, v_b, p_o and sigmas at a share (M, 1) of the way from rows a to rows b of odometries."""

    def between(column: Array) -> Array:
        return np.where(exact, column[b], column[a] + share * (column[b] - column[a]))

    attitudes = rotation_from_quaternion(table["quaternion_xyzw"][:, 0])
    turn = vector_from_rotation(np.swapaxes(attitudes[a], -1, -2) @ attitudes[b])
    C = attitudes[a] @ rotation_from_vector(share * turn)
    variances: Sequence[Array] = [
        np.diagonal(table[name], axis1=1, axis2=2)[:, :3]
        for name in ("twist_covariance", "pose_covariance")
    ]
    sigma = np.sqrt(np.concatenate(variances, axis=1))
    heading_sigma = np.sqrt(table["pose_covariance"][:, 5, 5:])
    velocity, position = between(table["twist_linear"]), between(table["position"])
    return C, velocity, position, between(sigma), between(heading_sigma)
