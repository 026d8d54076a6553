"""The ordinary measurement, which nothing speaks against: judged and taken in by one kernel each.

What the gate does with all others is in gate.py. The conditions that both need are here.
"""

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.kernels import kernel
from insdvl.navigation import algebra
from insdvl.navigation.channels import any_unseen
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.rotation import copy_matrix
from insdvl.navigation.process_noise import shown
from insdvl.navigation.state.fields import NEVER

#: An interval between measurements that is longer bears nothing out [ns]; a trusted filter may
#: reject for so long what need not be a fault of the sensor; two steps farther apart are no drift.
LEAST_PATIENCE_NS = 5 * NS
#: A sensor takes back a claim if it returns by more than this part of it.
RETURNS = 0.5


@kernel
def is_doubted(doubt_from_ns: int, doubt_for: int, stamp_ns: int) -> bool:
    """Whether a sensor may have an error of its own at a stamp."""
    return doubt_from_ns != NEVER and stamp_ns < doubt_from_ns + doubt_for


@kernel
def doubt_at(doubt: float, doubt_from_ns: int, half_life_ns: int, stamp_ns: int) -> float:
    """The error that a doubted sensor may have at a stamp, one sigma in each row.

    Args:
        doubt: That error at first.
        doubt_from_ns: Since when.
        half_life_ns: In this time it halves; 0 if it stays.
        stamp_ns: Of the measurement.
    """
    if half_life_ns == 0:
        return doubt
    return doubt * 0.5 ** ((stamp_ns - doubt_from_ns) / half_life_ns)


@kernel
def may_go_on(
    fault_ns: int, rejected_from_ns: int, patient_for: int, unseen: bool, stamp_ns: int
) -> bool:
    """Whether a fault of the sensor is known that a measurement may repeat."""
    if fault_ns == NEVER or unseen:
        return False
    return stamp_ns - rejected_from_ns < patient_for


@kernel
def note_claim(
    claim: Array, first: Array, rejected_from_ns: int, gave_in_ns: int, innovation: Array
) -> None:
    """Note whether a measurement that is used after rejections repeats what was rejected.

    Then that is a claim. If it does not, a claim that the filter has just given in to is void.
    """
    if rejected_from_ns == NEVER:
        return
    along, square = 0.0, 0.0
    for i in range(len(innovation)):
        along += innovation[i] * first[i]
        square += first[i] * first[i]
    if along > RETURNS * square:
        for i in range(len(innovation)):
            claim[i] = first[i]
    elif gave_in_ns >= rejected_from_ns:
        claim[:] = 0.0


@kernel
def is_ordinary(
    state: Records,
    memory: Records,
    constants: Records,
    stamp_ns: int,
    innovation: Array,
    H: Array,
    own: Array,
    limits: Array,
    R: Array,
    S: Array,
    K: Array,
) -> tuple[float, int, bool]:
    """Compare a measurement with its prediction, and judge it where nothing speaks against it.

    Args:
        state: (1,) record at the measurement.
        memory: (1,) of the gate, a part of it.
        constants: (1,) of the filter.
        stamp_ns: Of the measurement.
        innovation: (m,) of the measurement.
        H: (m, n) Jacobian.
        own: (m, m) covariance of its noise.
        limits: (m + 1,) of the NIS, by the number of rows that were measured.
        R: (m, m) result, that covariance with the error that the sensor may have.
        S: (m, m) result, covariance of the innovation.
        K: (n, m) result, gain.

    Returns:
        The NIS, the number of rows that were measured, and whether the measurement is ordinary.
    """
    s, g = state[0], memory[0]
    doubted = is_doubted(g.doubt_from_ns, g.doubt_for, stamp_ns)
    copy_matrix(R, own)
    if doubted:
        for a in range(len(R)):
            R[a, a] += doubt_at(g.doubt, g.doubt_from_ns, g.doubt_half_life, stamp_ns) ** 2
    nis, rows = algebra.gain(s.nav.P, H, R, innovation, S, K), algebra.rows_of(H)
    if not np.isfinite(nis):
        return nis, rows, False
    shown.advance(s, constants[0], stamp_ns)
    unseen = any_unseen(s.channels.unseen_ns)
    if doubted or may_go_on(g.fault_ns, g.rejected_from_ns, g.patient_for, unseen, stamp_ns):
        return nis, rows, False
    fair = nis
    if shown.has_excess(s.noise.excess):
        P = shown.with_excess(s.nav.P, s.noise.excess, H)
        fair = algebra.gain(P, H, R, innovation, np.empty_like(S), np.empty_like(K))
    if fair > limits[rows]:
        return nis, rows, False
    g.drifts = 0
    note_claim(g.claim, g.first, g.rejected_from_ns, g.gave_in_ns, innovation)
    return nis, rows, True


@kernel
def accept(
    state: Records,
    memory: Records,
    constants: Records,
    stamp_ns: int,
    H: Array,
    K: Array,
    left: Array,
    patience_ns: int,
    tells_velocity: bool,
) -> None:
    """A measurement has corrected the state, see `Gate.accept`."""
    shown.corrected(state[0], constants[0], K, H)
    for i in range(len(left)):
        memory[0].left[i] = left[i]
    bear_out(state, memory, stamp_ns, patience_ns, tells_velocity)


@kernel
def bear_out(
    state: Records, memory: Records, stamp_ns: int, patience_ns: int, tells_velocity: bool
) -> None:
    """A sensor bears the filter out.

    Args:
        state: (1,) record at the measurement.
        memory: (1,) of the gate, a part of it.
        stamp_ns: Of the measurement.
        patience_ns: Most trust that the filter gains.
        tells_velocity: Whether it tells velocity and tilt.
    """
    s, g = state[0], memory[0]
    if g.accepted_ns != NEVER:
        since_ns = stamp_ns - g.accepted_ns
        # What was contradicted, or not looked at, counts double against the filter.
        trust_ns = g.trusted_for - 2 * since_ns
        if since_ns <= LEAST_PATIENCE_NS and g.rejected_from_ns == NEVER:
            trust_ns = g.trusted_for + since_ns
        if is_doubted(g.doubt_from_ns, g.doubt_for, stamp_ns):
            g.trusted_for = 0
        elif not any_unseen(s.channels.unseen_ns):
            g.trusted_for = min(max(trust_ns, 0), patience_ns)
    g.accepted_ns = stamp_ns
    if tells_velocity:
        s.channels.told_ns = stamp_ns
    g.rejected_from_ns = NEVER
    g.fault_ns = NEVER
