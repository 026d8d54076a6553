"""What a filter's state says to an operator: its times and the process noise in use."""

from typing import Any, NamedTuple

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.process_noise import factor
from insdvl.navigation.state.fields import NEVER


class StateSummary(NamedTuple):
    """Times and process noise of a state.

    Attributes:
        time_ns: Stamp of the state.
        accepted_ns: Stamp of the last accepted measurement of each kind, None before the first.
        process_noise_ns: Stamp of the received process noise, None while Q is nominal.
        sigma_f: Per-sample noise of the specific force (3,) [m/s^2].
        sigma_w: Per-sample noise of the angular rate (3,) [rad/s].
        factor: On the process noise that is told, where the filter learns it.
    """

    time_ns: int
    accepted_ns: dict[str, int | None]
    process_noise_ns: int | None
    sigma_f: Array
    sigma_w: Array
    factor: float


def summary(state: Any) -> StateSummary:
    """The summary of a state record (see `insdvl.navigation.state.layout`)."""
    gates, noise = state["gate"], state["noise"]
    return StateSummary(
        time_ns=int(state["nav"]["time_ns"]),
        accepted_ns={name: _stamp(gates[name]["accepted_ns"]) for name in gates.dtype.names},
        process_noise_ns=_stamp(noise["q_ns"]),
        sigma_f=np.sqrt(np.diag(noise["Q_f"])),
        sigma_w=np.sqrt(np.diag(noise["Q_w"])),
        factor=float(state[factor.GROUP]["factor"]),
    )


def _stamp(value: Any) -> int | None:
    stamp_ns = int(value)
    return None if stamp_ns == NEVER else stamp_ns
