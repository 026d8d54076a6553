"""Parameters of the tuner."""

from dataclasses import dataclass

from insdvl.parameters.declaration import parameter


@dataclass(frozen=True)
class TunerParameters:
    """Parameters of the tuner, for the node and for `insdvl replay`."""

    enabled: bool = parameter(True, "Publish process_noise; ~/enable changes it at run time.")
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
        "estimates; differences suppress fast motion of the vehicle. 0 means no bound.",
        low=0,
        high=20,
    )
    max_gap: float = parameter(
        0.1,
        "Windows that span a longer interval between stamps are not used.",
        unit="s",
        above=0.0,
    )
