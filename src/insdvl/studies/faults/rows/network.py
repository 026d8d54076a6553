"""Faults of the network between sensors and filter."""

from insdvl.messages.topics import DVL, IMU
from insdvl.studies.faults import changes
from insdvl.studies.faults.checks import (
    covered,
    error_below,
    nothing_refused,
    refused,
    rejoins,
    same_bits,
)
from insdvl.studies.faults.rows.base import ONE_SEED, FlightRow


def _rows() -> list[FlightRow]:
    return [
        FlightRow(
            "Network",
            f"{100.0 * loss:g} % of all messages lost",
            changes.network(loss=loss),
            (nothing_refused(), covered(), rejoins(), error_below(1.0)),
        )
        for loss in (0.001, 0.01, 0.1)
    ] + [
        FlightRow(
            "Network",
            "20 % of all messages twice, all delayed by 0.2 to 1.2 s and reordered",
            changes.network(duplication=0.2, delay=0.2, jitter=1.0),
            (refused("duplicate", IMU, DVL), same_bits()),
            parameters={"output_delay": 2.0},
            seeds=ONE_SEED,
        ),
    ]


ROWS = tuple(_rows())
