"""Parameters of the tuner."""

from dataclasses import dataclass

from insdvl.parameters.declaration import parameter


@dataclass(frozen=True)
class TunerParameters:
    """Parameters of the tuner, for the node and for `insdvl replay`."""

    enabled: bool = parameter(True, "Publish process_noise; ~/enable changes it at run time.")
    model: str = parameter(
        "default", "Name of a model that ships with insdvl, or the path of a model's file."
    )
    rate: float = parameter(
        1.0, "How often Q is learned, in the time of the stamps.", unit="Hz", above=0.0, high=100.0
    )
    difference_order: int = parameter(
        0,
        "No variance is told above that of differences of this order (with a margin), which leave "
        "out the vehicle's own fast motion; 0 for no bound.",
        low=0,
        high=20,
    )
    max_gap: float = parameter(
        0.1,
        "A window that spans a longer interval between stamps is not used.",
        unit="s",
        above=0.0,
    )
