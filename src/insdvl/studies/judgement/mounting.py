"""How far mount, lever arm, stamps and scale of the DVL are off, by the innovations.

The innovations of a filter are white. What is told wrongly leaves a pattern in them: that by which
they change when it is told a little otherwise. So the recording is folded again, with one thing
after the other changed by a little, and the values are those under which the innovations are the
most probable. The model is in docs/explanation/verdict.md.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array
from insdvl.navigation.events import NS, Event
from insdvl.navigation.geometry.frames import rotation_from_rpy, rpy_from_rotation
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.studies.replay.taken import MOST, Taken

#: The samples of the IMU are averaged over so long [s]: a vehicle that turns by 20 deg/s turns by a
#: degree in it.
AVERAGE = 0.05
#: Measurements so near to the end are not used [s]: a later stamp has no sample yet.
END = 0.5
#: Fewest innovations from which anything is estimated.
FEWEST = 50


@dataclass(frozen=True)
class Unknown:
    """Something that was told of the DVL.

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
NAMES = tuple(unknown.name for unknown in UNKNOWNS)


@dataclass(frozen=True)
class Change:
    """What one unknown would have to change by, if it alone were told wrongly.

    Attributes:
        unknown: What it is.
        value: Of the change, which is to be added to what is told.
        sigma: One sigma of it.
    """

    unknown: Unknown
    value: float
    sigma: float

    @property
    def z(self) -> float:
        """How many sigmas the change is away from none."""
        return abs(self.value) / self.sigma


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
        turned = Rotation.from_rotvec(vector).as_matrix() @ rotation_from_rpy(np.array(dvl.mount))
        mount = tuple(rpy_from_rotation(turned).tolist())
        return replace(parameters, dvl=replace(dvl, mount=mount)), events
    if unknown.name in ARMS:
        arm = list(dvl.lever_arm)
        arm[ARMS.index(unknown.name)] += change
        return replace(parameters, dvl=replace(dvl, lever_arm=tuple(arm))), events
    if unknown.name == "time_offset":
        later_ns = round(change * NS)
        return parameters, [
            replace(e, stamp_ns=e.stamp_ns + later_ns) if isinstance(e, Dvl) else e for e in events
        ]
    return parameters, [
        replace(e, v_d=e.v_d + change * predicted[e.stamp_ns])
        if isinstance(e, Dvl) and e.stamp_ns in predicted
        else e
        for e in events
    ]


def mounting(
    taken: Taken, parameters: FilterParameters, used: set[int]
) -> tuple[Change, ...] | None:
    """The changes of all `UNKNOWNS` that the innovations ask for; None where they are too few.

    Each is as if it were the only one.

    Args:
        taken: What was folded.
        parameters: Of the filter.
        used: Stamps of the DVL measurements that the filter accepted. Only these are folded again,
            without the gate: a decision must not depend on a small change.
    """
    part, parameters = taken.first(MOST).averaged(parameters, AVERAGE)
    parameters = replace(parameters, gate=replace(parameters.gate, enabled=False))
    last_ns = int(part.samples[0][-1]) - round(END * NS)
    events = [e for e in part.events if not isinstance(e, Dvl) or e.stamp_ns in used]
    events = [e for e in events if e.stamp_ns <= last_ns]
    read = {e.stamp_ns: e.v_d for e in events if isinstance(e, Dvl)}
    stamps, nu, S = _innovations(part, parameters, events)
    if len(nu) < FEWEST:
        return None
    predicted = {t: read[t] - of_t for t, of_t in zip(stamps, nu, strict=True)}
    weights = np.linalg.inv(S)
    columns = []
    for unknown in UNKNOWNS:
        told = told_otherwise(parameters, events, unknown, unknown.step, predicted)
        _, changed, _ = _innovations(part, *told)
        if changed.shape != nu.shape:
            return None
        columns.append(changed - nu)
    G = np.stack(columns, axis=2)
    of_steps = np.einsum("kia,kij,kja->a", G, weights, G)
    gradient = np.einsum("kia,kij,kj->a", G, weights, nu)
    # The innovations themselves tell how large they are; so a sigma does not depend on R and Q.
    power = float(np.einsum("ki,kij,kj->", nu, weights, nu)) / nu.size
    changes = []
    for k, unknown in enumerate(UNKNOWNS):
        information = max(float(of_steps[k]), 1e-12)
        steps = -float(gradient[k]) / information
        left = nu + steps * G[:, :, k]
        scores = np.einsum("ki,kij,kj->k", G[:, :, k], weights, left)
        variance = max(power * information, _variance_of_sum(scores))
        sigma = math.sqrt(variance) / information
        changes.append(Change(unknown, steps * unknown.step, sigma * unknown.step))
    return tuple(changes)


def _variance_of_sum(values: Array) -> float:
    """Variance of a sum whose terms differ in size and are correlated with near ones.

    Newey and West, A simple, positive semi-definite, heteroskedasticity and autocorrelation
    consistent covariance matrix, Econometrica 55 (1987).
    """
    lags = int(4.0 * (len(values) / 100.0) ** (2.0 / 9.0))
    total = float(values @ values)
    for lag in range(1, lags + 1):
        total += 2.0 * (1.0 - lag / (lags + 1.0)) * float(values[lag:] @ values[:-lag])
    return total


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
