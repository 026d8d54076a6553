"""A heading sensor that tells the yaw with white noise alone, for tests."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.measurements.base import Block
from insdvl.navigation.measurements.heading import Heading, HeadingParameters
from insdvl.navigation.parameters import FilterParameters


def compass(stamp_ns: int, yaw: float, std: float) -> Heading:
    """A yaw against north [rad] with its sigma; the sensor is level."""
    return Heading(stamp_ns, rotation_from_rpy(np.array([0.0, 0.0, yaw])), np.eye(3) * std**2)


@dataclass(frozen=True)
class CompassParameters(HeadingParameters):
    """The sensor; with ``clones`` it brings constants that nothing drives, for a test to use."""

    clones: int = 0

    ROOM: ClassVar[Mapping[str, int]] = {}

    def blocks(self) -> tuple[Block, ...]:
        return (Block("clone", (1.0,) * self.clones),) if self.clones else ()


def with_compass(parameters: FilterParameters, clones: int = 0) -> FilterParameters:
    """The same filter, which takes the yaw as it is told."""
    heading = CompassParameters(
        topic="compass",
        covariance="message",
        roll_pitch_std=1e-6,
        error_std=0.0,
        interval=0.0,
        clones=clones,
    )
    return replace(parameters, heading=heading)
