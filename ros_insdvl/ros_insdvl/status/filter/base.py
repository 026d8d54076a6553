"""What a cause of the filter may see, and what it gives."""

from math import degrees, inf

import numpy as np

from insdvl.navigation.odometry import Odometry
from insdvl.timeline.jumps import TimeJump
from insdvl.timeline.output import AppliedUpdate
from ros_insdvl.status.diagnostics import Status, View


class Cause:
    """One cause: it remembers what it needs of what the filter does, and gives its status."""

    def reset(self) -> None:
        """Forget everything that was remembered by stamps: another time begins."""

    def jumped(self, jump: TimeJump) -> None:
        """The fold has followed the samples into another time."""

    def updated(self, update: AppliedUpdate) -> None:
        """A measurement was used or rejected."""

    def status(self, view: View) -> Status:
        """The status, as of now."""
        raise NotImplementedError


class Published:
    """The odometry that was published in this time.

    Attributes:
        first_ns: Stamp of the first one, None before it.
        last: The last one.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Another time begins."""
        self.first_ns: int | None = None
        self.last: Odometry | None = None

    def add(self, output: Odometry) -> None:
        """Odometry was published."""
        if self.first_ns is None:
            self.first_ns = output.stamp_ns
        self.last = output

    @property
    def height_sigma(self) -> float:
        """Sigma of the height in the last output [m]."""
        return inf if self.last is None else float(np.sqrt(self.last.pose_covariance[2, 2]))

    @property
    def heading_sigma_deg(self) -> float:
        """Sigma of the heading in the last output [deg]."""
        return inf if self.last is None else degrees(np.sqrt(self.last.pose_covariance[5, 5]))

    @property
    def velocity_sigma(self) -> float:
        """Largest sigma of the velocity's axes in the last output [m/s]."""
        if self.last is None:
            return inf
        return float(np.sqrt(np.diag(self.last.twist_covariance)[:3].max()))
