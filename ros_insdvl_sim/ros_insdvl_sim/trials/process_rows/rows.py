"""All rows of processes and networks, in the order of the page."""

from ros_insdvl_sim.trials.process_rows import clock, host, network, restarts, tuner
from ros_insdvl_sim.trials.process_rows.row import LiveRow

ROWS: tuple[LiveRow, ...] = (
    *tuner.ROWS,
    *restarts.ROWS,
    *host.ROWS,
    *clock.ROWS,
    *network.ROWS,
)
