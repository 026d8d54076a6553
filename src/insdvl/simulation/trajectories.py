"""The named trajectories: those of the training, the unseen test, and two for unit tests."""

import math
from math import radians

from insdvl.simulation.motion import Channel, Ramp, Trajectory, Wave


def _lawn_mower() -> Trajectory:
    """Legs of 60 s along north and south, joined by half circles that alternate in sense."""
    leg, turn = 60.0, 24.0
    turns, t, sense = [], 0.0, 1.0
    while t + leg + turn < 420.0:
        turns.append(Ramp(t + leg, t + leg + turn, sense * math.pi))
        t, sense = t + leg + turn, -sense
    return Trajectory(
        duration=420.0,
        speed=Channel(1.6, waves=(Wave(0.1, 47.0),)),
        heading=Channel(radians(10.0), ramps=tuple(turns), waves=(Wave(radians(0.8), 31.0),)),
        pitch=Channel(radians(-0.5), waves=(Wave(radians(0.6), 23.0, 0.5),)),
        roll=Channel(waves=(Wave(radians(0.6), 19.0, 1.0),)),
        bank=0.4,
        pivot=0.4,
        h_0=-20.0,
    )


#: Trajectories of the training.
BASELINE: dict[str, Trajectory] = {
    "straight": Trajectory(
        duration=400.0,
        speed=Channel(
            1.0,
            ramps=(
                Ramp(30.0, 38.0, 1.2),
                Ramp(90.0, 95.0, -1.5),
                Ramp(150.0, 165.0, 1.8),
                Ramp(220.0, 226.0, -0.9),
                Ramp(280.0, 284.0, 0.7),
                Ramp(340.0, 355.0, -1.4),
            ),
        ),
        heading=Channel(radians(60.0), waves=(Wave(radians(0.5), 37.0),)),
        pitch=Channel(waves=(Wave(radians(0.7), 21.0),)),
        roll=Channel(waves=(Wave(radians(0.8), 17.0, 2.0),)),
    ),
    "circle": Trajectory(
        duration=400.0,
        speed=Channel(1.2, ramps=(Ramp(150.0, 170.0, 0.8), Ramp(300.0, 315.0, -0.6))),
        heading=Channel(
            slope=0.06,
            ramps=(Ramp(100.0, 180.0, 3.2, 4.0), Ramp(250.0, 420.0, -5.8, 4.0)),
            waves=(Wave(radians(1.0), 41.0),),
        ),
        pitch=Channel(radians(-1.0), waves=(Wave(radians(0.4), 25.0),)),
        roll=Channel(waves=(Wave(radians(0.5), 18.0),)),
        bank=0.5,
        pivot=0.5,
        h_0=-10.0,
    ),
    "lawn_mower": _lawn_mower(),
    "spiral_dive": Trajectory(
        duration=400.0,
        speed=Channel(1.3, ramps=(Ramp(190.0, 200.0, -0.4), Ramp(280.0, 290.0, 0.5))),
        heading=Channel(radians(-120.0), slope=0.09, ramps=(Ramp(200.0, 420.0, -31.0, 3.0),)),
        pitch=Channel(
            ramps=(
                Ramp(15.0, 25.0, radians(-15.0), 2.0),
                Ramp(180.0, 195.0, radians(15.0), 2.0),
                Ramp(210.0, 225.0, radians(12.0), 2.0),
                Ramp(370.0, 380.0, radians(-12.0), 2.0),
            ),
            waves=(Wave(radians(0.3), 29.0),),
        ),
        roll=Channel(waves=(Wave(radians(0.4), 22.0),)),
        bank=0.4,
        pivot=0.4,
    ),
}

#: The unseen test: 330 s from (32 deg, 34 deg, -5 m) northwards, at 1 m/s but for one faster leg.
AUV = Trajectory(
    duration=330.0,
    speed=Channel(1.0, ramps=(Ramp(205.0, 210.0, 0.2), Ramp(250.0, 255.0, -0.2))),
    heading=Channel(
        ramps=(
            Ramp(45.0, 60.0, radians(75.0)),
            Ramp(95.0, 101.0, radians(-35.0)),
            Ramp(130.0, 160.0, radians(200.0), 1.5),
            Ramp(185.0, 195.0, radians(-60.0)),
            Ramp(225.0, 232.0, radians(45.0)),
            Ramp(262.0, 292.0, radians(-250.0), 1.5),
        ),
    ),
    pitch=Channel(
        ramps=(
            Ramp(70.0, 74.0, radians(-12.0)),
            Ramp(112.0, 116.0, radians(12.0)),
            Ramp(168.0, 172.0, radians(8.0)),
            Ramp(198.0, 202.0, radians(-8.0)),
            Ramp(236.0, 240.0, radians(-18.0)),
            Ramp(270.0, 275.0, radians(18.0)),
        ),
    ),
    bank=0.35,
    pivot=0.5,
)

#: Motions for tests of the equations: an hour at rest, and an hour on a level circle.
STATIC = Trajectory(duration=3600.0, speed=Channel(), heading=Channel(radians(30.0)))
LOOP = Trajectory(
    duration=3600.0,
    speed=Channel(1.5),
    heading=Channel(slope=2.0 * math.pi / 120.0),
    bank=0.5,
)

_NAMED = {**BASELINE, "auv": AUV, "static": STATIC, "loop": LOOP}
NAMES = tuple(_NAMED)


def trajectory_named(name: str) -> Trajectory:
    """A trajectory of this module by its name.

    Raises:
        ValueError: The name is unknown.
    """
    if name not in _NAMED:
        raise ValueError(f"unknown trajectory {name!r}; known: {', '.join(NAMES)}")
    return _NAMED[name]
