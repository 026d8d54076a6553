"""Parameters of the monitor."""

from dataclasses import dataclass

from insdvl.parameters.declaration import parameter


@dataclass(frozen=True)
class MonitorParameters:
    """What the monitor shows, and how often."""

    filters: tuple[str, ...] = parameter(
        ("",),
        "Namespaces of the filters to show, such as /constant and /learned; an empty one is the "
        "monitor's own.",
    )
    period: float = parameter(1.0, "Wall time between two tables.", unit="s", low=0.1, high=3600.0)
    window: float = parameter(
        10.0,
        "Time of the stamps over which the RMS velocity error is taken.",
        unit="s",
        low=1.0,
        high=600.0,
    )
    keep: int = parameter(
        20_000, "Odometry messages kept for each topic.", low=100, high=100_000_000
    )
