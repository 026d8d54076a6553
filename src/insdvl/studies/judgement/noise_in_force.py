"""The noise of the DVL that the filter used, where it learns it: its size, and where it is from."""

from collections import Counter
from typing import Any

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.state.fields import NEVER
from insdvl.studies.replay.consumer import Consumer, initialised
from insdvl.studies.replay.taken import Taken


class NoiseInForce(Consumer):
    """Follows the noise in force, from one measurement that has taught to the next.

    After a time jump it begins anew.
    """

    def __init__(self) -> None:
        self._last_ns = NEVER  # stamp of the last measurement seen
        self._ended = True
        self._factors: dict[int, float] = {}  # by the stamp of the measurement
        self._origins: Counter[str] = Counter()

    def take(self, filter_: Filter, states: Records) -> None:
        """See `Consumer`."""
        if self._ended:
            self._factors, self._origins, self._ended = {}, Counter(), False
        for known in initialised(states):
            taught_ns = known[f"{Dvl.name}_noise"]["learned_ns"]
            for k in np.flatnonzero(np.diff(taught_ns, prepend=self._last_ns)).tolist():
                self._see(filter_, known[k], int(taught_ns[k]))
            self._last_ns = int(taught_ns[-1])

    def _see(self, filter_: Filter, state: Any, stamp_ns: int) -> None:
        noise = filter_.noise_in_force(state, Dvl.name)
        if noise is None or stamp_ns == NEVER:  # it is that at a start
            return
        self._factors[stamp_ns] = noise.factor
        self._origins.update(noise.origins)

    def end(self) -> None:
        """See `Consumer`."""
        self._last_ns, self._ended = NEVER, True

    def numbers(self, filter_: Filter, taken: Taken) -> dict[str, Any] | None:
        """Factor on the nominal R and sigma [m/s], each with mean, min and max; and the origins.

        Args:
            filter_: The filter.
            taken: What was folded, whose measurements tell the nominal noise.

        Returns:
            None where the noise is nominal, or nothing has taught.
        """
        if not self._factors:
            return None
        model, variances = filter_.models[Dvl.name], []
        for event in taken.events:
            if isinstance(event, Dvl) and all(event.measured):
                factor = self._factors.get(event.stamp_ns)
                if factor is not None:
                    variances.append(factor * float(np.trace(model.noise(event))) / 3.0)
        count = len(self._factors)
        return {
            "measurements": count,
            "factor": _told(np.array(list(self._factors.values()))),
            "sigma": _told(np.sqrt(variances)) if variances else None,
            "origins": {name: share / count for name, share in self._origins.most_common()},
        }


def _told(values: Array) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "min": float(values.min()),
        "max": float(values.max()),
    }
