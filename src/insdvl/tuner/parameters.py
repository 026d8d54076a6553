"""Parameters of the tuner."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, TypeVar

from insdvl.navigation.channels import ImuParameters
from insdvl.navigation.measurements.dvl import DvlParameters
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import parameter

_Group = TypeVar("_Group", bound="TunedImu | TunedDvl")


def _same(group: type[Any], name: str) -> Any:
    """A parameter that is declared as one of the filter's; here it stays as it was at the start."""
    of_filter = next(one for one in dataclasses.fields(group) if one.name == name)
    return field(default=of_filter.default, metadata={**of_filter.metadata, "changeable": False})


def _taken(ours: _Group, theirs: Any) -> _Group:
    """A group with the values that another one has under the same names."""
    names = [one.name for one in dataclasses.fields(ours)]
    return dataclasses.replace(ours, **{name: getattr(theirs, name) for name in names})


@dataclass(frozen=True)
class TunedImu:
    """What the tuner of the DVL's noise needs to know of the IMU, as the filter does."""

    mount: tuple[float, ...] = _same(ImuParameters, "mount")
    lever_arm: tuple[float, ...] = _same(ImuParameters, "lever_arm")
    time_offset: float = _same(ImuParameters, "time_offset")


@dataclass(frozen=True)
class TunedDvl:
    """What it needs to know of the DVL."""

    type: str = _same(DvlParameters, "type")
    mount: tuple[float, ...] = _same(DvlParameters, "mount")
    lever_arm: tuple[float, ...] = _same(DvlParameters, "lever_arm")
    time_offset: float = _same(DvlParameters, "time_offset")
    covariance: str = _same(DvlParameters, "covariance")
    noise_std: tuple[float, ...] = _same(DvlParameters, "noise_std")
    noise_floor: float = _same(DvlParameters, "noise_floor")


@dataclass(frozen=True)
class TunerParameters:
    """Parameters of the tuner, for the node and for `insdvl replay`."""

    enabled: bool = parameter(
        True,
        "Publish process_noise, and with measurement_noise that; the service ~/enable sets it too.",
        changeable=True,
    )
    model: str = parameter("default", "Name of a shipped model, or path of a model file.")
    estimator: str = parameter(
        "",
        "A function PACKAGE.MODULE:FUNCTION that estimates Q in place of a model; empty for the "
        "model.",
    )
    rate: float = parameter(
        1.0,
        "Rate of the estimates of Q, in the time of the stamps.",
        unit="Hz",
        above=0.0,
        high=100.0,
    )
    difference_order: int = parameter(
        0,
        "Order of the differences whose variance (with a margin) is the upper bound of the "
        "estimates; differences suppress fast motion of the vehicle. Not for an IMU with a "
        "low-pass, whose differences show less than its noise. 0 means no bound.",
        low=0,
        high=20,
    )
    max_gap: float = parameter(
        0.1,
        "Windows that span a longer interval between stamps are not used.",
        unit="s",
        above=0.0,
    )
    measurement_noise: bool = parameter(
        False,
        "Publish measurement_noise: the noise of the DVL, from its pings and the IMU between them. "
        "It needs the vehicle: frame_convention, imu.* and dvl.* as the filter has them.",
    )
    frame_convention: str = _same(FilterParameters, "frame_convention")
    imu: TunedImu = field(default_factory=TunedImu)
    dvl: TunedDvl = field(default_factory=TunedDvl)

    def of_vehicle(self, filter_: FilterParameters) -> "TunerParameters":
        """The same for the vehicle that a filter is told of."""
        return dataclasses.replace(
            self,
            frame_convention=filter_.frame_convention,
            imu=_taken(self.imu, filter_.imu),
            dvl=_taken(self.dvl, filter_.dvl),
        )
