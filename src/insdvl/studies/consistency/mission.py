"""The mission of the table: 20 minutes of an AUV that dives, surveys and comes back up."""

import math
from dataclasses import replace

from insdvl.simulation.motion import Channel, Ramp, Wave
from insdvl.studies.consistency.flights import TRANSIT


def _turn(start: float, duration: float, change_deg: float) -> Ramp:
    return Ramp(start, start + duration, math.radians(change_deg))


#: Out for four minutes with two bends, six legs of a lawn mower, a full circle, and on: 2.0 km at
#: 1.3 to 2.1 m/s, at most 1 km away. It dives by 15 m in the second minute and rises in the last
#: but one. Waves move it all the time, by a degree in roll and pitch.
PATROL = replace(
    TRANSIT,
    duration=1200.0,
    speed=Channel(
        1.8,
        ramps=(Ramp(400.0, 410.0, -0.4), Ramp(840.0, 850.0, 0.6), Ramp(1080.0, 1090.0, -0.2)),
        waves=(Wave(0.1, 47.0), Wave(0.05, 7.0, 0.3)),
    ),
    heading=Channel(
        math.radians(20.0),
        ramps=(
            _turn(60.0, 15.0, 50.0),
            _turn(150.0, 15.0, -80.0),
            *(_turn(240.0 + 84.0 * k, 24.0, (-1) ** k * 180.0) for k in range(6)),
            _turn(780.0, 60.0, 360.0),
            _turn(900.0, 20.0, 120.0),
            _turn(1000.0, 15.0, -60.0),
            _turn(1100.0, 15.0, 45.0),
        ),
        waves=(Wave(math.radians(0.8), 31.0), Wave(math.radians(0.5), 8.0, 0.7)),
    ),
    pitch=Channel(
        ramps=(
            _turn(62.0, 8.0, -8.0),
            _turn(120.0, 8.0, 8.0),
            _turn(1085.0, 8.0, 8.0),
            _turn(1143.0, 8.0, -8.0),
        ),
        waves=(Wave(math.radians(0.6), 23.0, 0.5), Wave(math.radians(0.6), 9.0, 1.3)),
    ),
    roll=Channel(waves=(Wave(math.radians(0.6), 19.0, 1.0), Wave(math.radians(0.8), 7.0))),
)
