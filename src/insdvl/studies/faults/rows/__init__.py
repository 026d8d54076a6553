"""The rows of the fault matrix that concern messages and time, by subject."""

from insdvl.studies.faults.rows import (
    depth,
    drivers,
    dvl,
    heading,
    imu,
    network,
    process_noise,
    time,
)
from insdvl.studies.faults.rows.base import FlightRow

ROWS: tuple[FlightRow, ...] = (
    *imu.ROWS,
    *dvl.ROWS,
    *drivers.ROWS,
    *depth.ROWS,
    *heading.ROWS,
    *process_noise.ROWS,
    *time.ROWS,
    *network.ROWS,
)
