"""Where the heading may come from: the orientation in the messages of the IMU."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.messages import convert
from insdvl.messages.convert import RejectedMessage
from insdvl.navigation.geometry.frames import Convention
from insdvl.navigation.start.automatic import LARGEST_TILT_ERROR

EVERY = 20  # messages: of the others the orientation is not looked at


@dataclass(frozen=True)
class OrientationFacts:
    """What the orientations of the IMU tell.

    Attributes:
        looked: Number of messages that were looked at.
        told: Number of those with an orientation and a sigma of the heading.
        untold: Number of those with an orientation whose covariance is unknown (zeros).
        sigma: Median of the told sigmas of the heading [rad]; None without any.
        tilted: Number of orientations that are in other axes than the specific force.
    """

    looked: int
    told: int
    untold: int
    sigma: float | None
    tilted: int

    @property
    def is_told(self) -> bool:
        """Whether the filter takes the heading from it without being told to."""
        return self.told > self.looked / 2 and self.tilted < self.told / 2


class OrientationLog:
    """Looks at some of the messages.

    Args:
        convention: Of the stream.
    """

    def __init__(self, convention: Convention) -> None:
        self._convention = convention
        self._messages = self._looked = self._told = self._untold = self._tilted = 0
        self._sigmas: list[float] = []

    def add(self, message: Any, f_b: Array) -> None:
        """Look at a message of the IMU.

        Args:
            message: A sensor_msgs/Imu.
            f_b: (3,) its specific force in forward-right-down.
        """
        self._messages += 1
        if self._messages % EVERY:
            return
        self._looked += 1
        try:
            told = convert.orientation(message, self._convention, 0.0)
            found = told or convert.orientation(message, self._convention, 1.0)
        except RejectedMessage:  # counted with the sample
            return
        if found is None:
            return
        if told is None:
            self._untold += 1
        else:
            self._told += 1
            self._sigmas.append(told.heading_std)
        up = found.C_n_i @ f_b
        if -up[2] <= math.cos(LARGEST_TILT_ERROR) * np.hypot.reduce(up):
            self._tilted += 1

    def facts(self) -> OrientationFacts:
        """What they tell."""
        sigma = float(np.median(self._sigmas)) if self._sigmas else None
        return OrientationFacts(self._looked, self._told, self._untold, sigma, self._tilted)
