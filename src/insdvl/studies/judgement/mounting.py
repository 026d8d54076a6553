"""How far mount, lever arm, stamps and scale of the DVL are off, or the stamps of a depth sensor.

The innovations of the DVL are white. What is told wrongly leaves a pattern in them: that by which
they change when it is told a little otherwise. So the recording is folded again, with one thing
after the other changed by a little, and the values are those under which the innovations are the
most probable. The model is in docs/explanation/verdict.md.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS, Event
from insdvl.navigation.geometry.frames import (
    rotation_from_rpy,
    rotation_from_vector,
    rpy_from_rotation,
)
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.studies.judgement.added_noise import noisier
from insdvl.studies.judgement.innovations import FACTOR, variance_of_sum
from insdvl.studies.replay.taken import MOST, Taken

#: The samples of the IMU are averaged over so long [s]: a vehicle that turns by 20 deg/s turns by a
#: degree in it.
AVERAGE = 0.05
#: Measurements so near to the end are not used [s]: a later stamp has no sample yet.
END = 0.5
#: Fewest innovations from which anything is estimated.
FEWEST = 50
#: Sigmas of an unknown of the mount: the chance of any of nine is that of one other rule.
MOUNT_SIGMAS = 4.0
#: How often noise is added where something seems wrong.
REPEATS = 8
#: A DVL is not farther from base_link than this [m]; a longer lever arm is never advised.
LONGEST_ARM = 15.0


@dataclass(frozen=True)
class Unknown:
    """Something that was told of the DVL, or of the depth sensor beside it.

    Attributes:
        name: In the JSON document.
        careful: One sigma of what is set with care, see docs/explanation/alignment.md.
        step: By which it is changed.
    """

    name: str
    careful: float
    step: float


_TURNS = ("mount_x", "mount_y", "mount_z")
ARMS = ("lever_arm_x", "lever_arm_y", "lever_arm_z")
#: Turns about the axes of base_link [rad], lever arm [m], time offset [s], relative scale.
UNKNOWNS = (
    *(Unknown(name, math.radians(1.0), math.radians(0.2)) for name in _TURNS),
    *(Unknown(name, 0.1, 0.02) for name in ARMS),
    Unknown("time_offset", 0.02, 0.005),
    Unknown("scale", 0.01, 0.002),
)
#: Of the depth sensor [s]: a lag pulls the vertical velocity off in a dive, and the DVL shows it.
DEPTH_OFFSET = Unknown("depth_time_offset", 0.1, 0.02)
#: Whose stamps an unknown shifts.
_SHIFTED: Mapping[str, type[Event]] = MappingProxyType(
    {"time_offset": Dvl, DEPTH_OFFSET.name: Depth}
)
NAMES = tuple(unknown.name for unknown in UNKNOWNS)


@dataclass(frozen=True)
class Change:
    """What one unknown would have to change by, if it alone were told wrongly.

    Attributes:
        unknown: What it is.
        value: Of the change, which is to be added to what is told; 0 where nothing is known of it.
        sigma: One sigma of it; infinite where nothing is known.
    """

    unknown: Unknown
    value: float
    sigma: float

    @property
    def z(self) -> float:
        """How many sigmas the change is away from none."""
        return abs(self.value) / self.sigma

    @property
    def matters(self) -> bool:
        """Whether it is beyond chance, and beyond what is set with care."""
        return self.z > MOUNT_SIGMAS and abs(self.value) > self.unknown.careful


#: What `mounting` gives.
Mount = tuple[Change, ...]


def told_otherwise(
    parameters: FilterParameters,
    events: Sequence[Event],
    unknown: Unknown,
    change: float,
    predicted: Mapping[int, Array],
) -> tuple[FilterParameters, Sequence[Event]]:
    """Parameters and events under which one unknown is told otherwise.

    Args:
        parameters: Of the filter.
        events: As they were taken.
        unknown: What is changed.
        change: By how much.
        predicted: Velocity (3,) that the filter predicted of each stamp. The scale is changed by a
            part of it: the measured one has the noise that is in the innovation as well.
    """
    dvl = parameters.dvl
    if unknown.name in _TURNS:
        vector = np.zeros(3)
        vector[_TURNS.index(unknown.name)] = change
        turned = rotation_from_vector(vector) @ rotation_from_rpy(np.array(dvl.mount))
        mount = tuple(rpy_from_rotation(turned).tolist())
        return replace(parameters, dvl=replace(dvl, mount=mount)), events
    if unknown.name in ARMS:
        arm = list(dvl.lever_arm)
        arm[ARMS.index(unknown.name)] += change
        return replace(parameters, dvl=replace(dvl, lever_arm=tuple(arm))), events
    if shifted := _SHIFTED.get(unknown.name):
        later_ns = round(change * NS)
        return parameters, [
            replace(e, stamp_ns=e.stamp_ns + later_ns) if isinstance(e, shifted) else e
            for e in events
        ]
    return parameters, [
        replace(e, v_d=e.v_d + change * predicted[e.stamp_ns])
        if isinstance(e, Dvl) and e.stamp_ns in predicted
        else e
        for e in events
    ]


@dataclass(frozen=True)
class Sums:
    """Over all measurements, of the changes g of the innovations nu by a step of U unknowns.

    Attributes:
        information: (U,) of g^T S^-1 g.
        gradient: (U,) of g^T S^-1 nu.
        variance: (U,) of the gradient.
    """

    information: Array
    gradient: Array
    variance: Array


def mounting(
    taken: Taken, parameters: FilterParameters, used: set[int], rng: np.random.Generator
) -> tuple[Change, ...] | None:
    """The changes of all `UNKNOWNS` that the innovations ask for; None where they are too few.

    Each is as if it were the only one. Where there is a depth sensor the last one is
    `DEPTH_OFFSET`.

    Args:
        taken: What was folded.
        parameters: Of the filter.
        used: Stamps of the DVL measurements that the filter accepted. Only these are folded again,
            without the gate: a decision must not depend on a small change.
        rng: Of the noise that is added where something seems wrong, see `_without_noise`.
    """
    part, parameters = taken.first(MOST).averaged(parameters, AVERAGE)
    parameters = replace(parameters, gate=replace(parameters.gate, enabled=False))
    last_ns = int(part.samples[0][-1]) - round(END * NS)
    part.events = [
        e
        for e in part.events
        if e.stamp_ns <= last_ns and (not isinstance(e, Dvl) or e.stamp_ns in used)
    ]
    every = (*UNKNOWNS, DEPTH_OFFSET) if parameters.depth.topic else UNKNOWNS
    sums = _sums(part, parameters, every)
    if sums is None:
        return None
    changes = _changes(every, sums)
    suspected = [k for k, change in enumerate(changes) if change.matters]
    if suspected:
        unknowns = [every[k] for k in suspected]
        kept = Sums(sums.information[suspected], sums.gradient[suspected], sums.variance[suspected])
        noisy = [
            _sums(noisier(part, parameters, rng), parameters, unknowns) for _ in range(REPEATS)
        ]
        known = _without_noise(kept, [found for found in noisy if found is not None])
        for k, change in zip(suspected, _changes(unknowns, known), strict=True):
            changes[k] = change if _improves(change, changes[k]) else _unknown(change.unknown)
    return tuple(changes)


def can_be(change: Change, parameters: FilterParameters) -> bool:
    """Whether a vehicle can have what a change leads to."""
    told = parameters.dvl.lever_arm
    arm = told_otherwise(parameters, [], change.unknown, change.value, {})[0].dvl.lever_arm
    return math.hypot(*arm) <= max(LONGEST_ARM, math.hypot(*told))


def _unknown(unknown: Unknown) -> Change:
    """Of an unknown of which the recording says nothing."""
    return Change(unknown, 0.0, math.inf)


def _improves(change: Change, recorded: Change) -> bool:
    """Whether a change that matters makes the innovations of the recording more probable.

    Their weighted squares are a parabola with its least value at the change that the recording has
    with its noise. A step to beyond twice of that, or to the other side, makes them larger.

    Args:
        change: What is left without noise.
        recorded: With the noise.
    """
    return not change.matters or 0.0 < change.value / recorded.value < 2.0


def _changes(unknowns: Sequence[Unknown], sums: Sums) -> list[Change]:
    """The most probable change of each unknown."""
    return [
        Change(
            unknown,
            float(-gradient / information) * unknown.step,
            float(math.sqrt(variance) / information) * unknown.step,
        )
        if information > 0.0
        else _unknown(unknown)
        for unknown, information, gradient, variance in zip(
            unknowns, sums.information, sums.gradient, sums.variance, strict=True
        )
    ]


def _without_noise(sums: Sums, noisy: Sequence[Sums]) -> Sums:
    """What the sums would be without noise in the changes g of the innovations.

    The same noise is in g and in nu: in the predicted velocity, the turn rate and the specific
    force. Their product is then not zero when all is right. The sums grow in proportion to the
    power of the noise; so what they grow by when it is added once more is what it makes of them
    (Cook and Stefanski, Simulation-extrapolation estimation in parametric measurement error models,
    J. Am. Stat. Assoc. 89 (1994)).

    Args:
        sums: As the recording has them.
        noisy: With noise added.

    Returns:
        The sums; the information is zero where noise may be all there is.
    """
    if len(noisy) < 2:
        return sums
    count = len(noisy)
    gradients = np.array([one.gradient for one in noisy])
    informations = np.array([one.information for one in noisy])
    gradient = 2.0 * sums.gradient - gradients.mean(axis=0)
    of_noise = np.maximum(informations.mean(axis=0) - sums.information, 0.0)
    information = sums.information - of_noise
    # A sigma is seldom told better than to FACTOR, and what is added differs from time to time. If
    # noise explains all the information so, the motion tells nothing: any value would be that of
    # a gradient over an information that is not known.
    doubt = informations.std(axis=0, ddof=1) / math.sqrt(count)
    is_left = sums.information > FACTOR**2 * of_noise + MOUNT_SIGMAS * doubt
    # Of the gradient at the estimate: both sums have a part in it.
    value = -gradient / np.where(is_left, information, np.inf)
    of_added = (gradients + value * informations).var(axis=0, ddof=1) / count
    return Sums(np.where(is_left, information, 0.0), gradient, sums.variance + of_added)


def _sums(part: Taken, parameters: FilterParameters, unknowns: Sequence[Unknown]) -> Sums | None:
    """The sums of some unknowns; None where the innovations are too few."""
    events = part.events
    read = {e.stamp_ns: e.v_d for e in events if isinstance(e, Dvl)}
    stamps, nu, S = _innovations(part, parameters, events)
    if len(nu) < FEWEST:
        return None
    predicted = {t: read[t] - of_t for t, of_t in zip(stamps, nu, strict=True)}
    weights = np.linalg.inv(S)
    # The innovations themselves tell how large they are; so a sigma does not depend on R and Q.
    power = float(np.einsum("ki,kij,kj->", nu, weights, nu)) / nu.size
    found = []
    for unknown in unknowns:
        told = told_otherwise(parameters, events, unknown, unknown.step, predicted)
        _, changed, _ = _innovations(part, *told)
        if changed.shape != nu.shape:
            return None
        g = changed - nu
        information = max(float(np.einsum("ki,kij,kj->", g, weights, g)), 1e-12)
        gradient = float(np.einsum("ki,kij,kj->", g, weights, nu))
        left = nu - gradient / information * g
        of_left = np.einsum("ki,kij,kj->k", g, weights, left)
        found.append((information, gradient, max(power * information, variance_of_sum(of_left))))
    return Sums(*np.array(found).T)


def _innovations(
    part: Taken, parameters: FilterParameters, events: Sequence[Event]
) -> tuple[list[int], Array, Array]:
    """Stamps of the DVL, innovations (K, 3) and their covariances (K, 3, 3)."""
    updates = [
        update
        for update in part.folded(parameters, events).updates
        if update.report.measurement == Dvl.name
        and update.report.judged
        and update.report.rows == len(update.report.innovation)
    ]
    nu = np.array([update.report.innovation for update in updates]).reshape(-1, 3)
    S = np.array([update.report.S for update in updates]).reshape(-1, 3, 3)
    return [update.stamp_ns for update in updates], nu, S
