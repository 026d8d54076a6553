"""The tuner's cause `measurement noise`: the DVL's noise that is learned, and why none is."""

from collections.abc import Collection

import numpy as np

from insdvl.messages.topics import DVL, DVL_WITH_COVARIANCE, MEASUREMENT_NOISE
from insdvl.tuner.measurement_noise import TunedSensorNoise
from ros_insdvl.status.diagnostics import WARN, Status, View

_DVLS = (DVL, DVL_WITH_COVARIANCE)


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
    if latest is not None:
        for axis, sigma in zip("xyz", np.sqrt(np.diagonal(latest.R)), strict=True):
            status.values[f"R sigma {axis} [m/s]"] = f"{sigma:.3g}"
    view.show_events(status, *events)
    view.show(status, MEASUREMENT_NOISE, *_DVLS)
    return status
