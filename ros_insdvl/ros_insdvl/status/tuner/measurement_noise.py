"""The tuner's cause `measurement noise`: the DVL's noise that is learned, and why none is."""

from collections.abc import Collection

import numpy as np

from insdvl.messages.topics import DVL, DVL_WITH_COVARIANCE, MEASUREMENT_NOISE
from insdvl.tuner.measurement_noise import UNUSED, TunedSensorNoise
from ros_insdvl.status.diagnostics import RECENT, WARN, Status, View

_DVLS = (DVL, DVL_WITH_COVARIANCE)
#: What the counts of unused pings mean.
_WHY = {
    "pings_incomplete": "with a component that is not measured",
    "pings_without_lock": "zero, repeated or not finite",
    "pings_out_of_order": "not newer than the one before",
    "pings_far_ahead": "far ahead of the IMU's stamps",
    "pings_without_samples": "without IMU samples around them",
}
#: So many pings without one that can be used are no longer chance.
_FEW = 5


def measurement_noise_status(
    view: View, latest: TunedSensorNoise | None, events: Collection[str]
) -> Status:
    """The status of the DVL's noise.

    Args:
        view: What the tuner counted.
        latest: Its last estimate.
        events: Names of what became of the pings.
    """
    status = Status("measurement noise", "learned from the pings and the IMU between them")
    view.report_refused(status, list(_DVLS))
    heard = DVL_WITH_COVARIANCE if view.received.total[DVL_WITH_COVARIANCE] else DVL
    view.report_silence(
        status, heard, WARN, "check the DVL's driver, its topic and the connections"
    )
    recent = view.events.recent
    unused = {name: recent[name] for name in UNUSED if recent[name]}
    if not recent["pings"] and sum(unused.values()) > _FEW:
        told = ", ".join(f"{count} {_WHY[name]}" for name, count in unused.items())
        status.complain(
            WARN,
            "nothing",
            f"no ping of the last {RECENT:.0f} s tells the DVL's noise: {told}; the filter "
            "continues with an estimate of its own",
        )
    if latest is not None:
        for axis, sigma in zip("xyz", np.sqrt(np.diagonal(latest.R)), strict=True):
            status.values[f"R sigma {axis} [m/s]"] = f"{sigma:.3g}"
    view.show_events(status, *events)
    view.show(status, MEASUREMENT_NOISE, *_DVLS)
    return status
