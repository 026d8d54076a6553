"""Parameters of the gate."""

from dataclasses import dataclass

from insdvl.parameters.declaration import parameter


@dataclass(frozen=True)
class GateParameters:
    """Which measurements are used."""

    enabled: bool = parameter(
        True, "Reject measurements that fail the chi-square gate.", changeable=True
    )
    probability: float = parameter(
        0.999,
        "Probability that a good measurement passes the gate.",
        above=0.5,
        high=1.0 - 1e-12,
        changeable=True,
    )
    max_rejection_time: float = parameter(
        60.0,
        "If a sensor is rejected without a break for this time (in stamps), or for as long as it "
        "has agreed with the filter before if that is shorter (at most 5 s if the filter itself "
        "may be wrong), the filter gives in: the covariance is inflated, of velocity for the DVL "
        "(and of tilt, if the filter may have drifted), of the height for a depth sensor, of the "
        "attitude for a heading sensor. A sensor that had jumped stays in doubt for this time, "
        "less and less if it had agreed for no more than 5 s before. After twice the time the "
        "state is restarted from the measurement.",
        unit="s",
        above=0.0,
        high=3600.0,
        changeable=True,
    )
