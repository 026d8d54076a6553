"""How vehicles move that are not those of the training: each mission is drawn.

Car, surface vessel, ROV and three AUVs. Frequencies and phases of the waves, the times of turns and
stops and the speeds are drawn; what a kind of vehicle has in common stands here.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from insdvl.arrays import Array
from insdvl.simulation.drawn.vibration import Vibration, drawn_sines
from insdvl.simulation.motion import Channel, Motion, Ramp, Trajectory, Wave

#: Waves of a channel: sigma of all together, lowest and highest frequency [Hz].
Waves = tuple[float, float, float]

_WAVES = 3  # sines of a channel
#: Of an engine: range of the sigma of a line in a channel [m/s^2], [rad/s].
_SHAKE_F, _SHAKE_W = (0.05, 0.3), (0.002, 0.01)


def _waves(rng: np.random.Generator, sigma: float, low: float, high: float) -> tuple[Wave, ...]:
    frequency = np.exp(rng.uniform(np.log(low), np.log(high), _WAVES))
    phase = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    amplitude = sigma * math.sqrt(2.0 / _WAVES)
    return tuple(
        Wave(amplitude, 1.0 / f, angle)
        for f, angle in zip(frequency.tolist(), phase.tolist(), strict=True)
    )


def _channels(rng: np.random.Generator, sea: Mapping[str, Waves]) -> dict[str, tuple[Wave, ...]]:
    return {name: _waves(rng, *waves) for name, waves in sea.items()}


@dataclass(frozen=True, eq=False)
class Engine:
    """Vibration of a running engine: as strong at rest as in motion.

    Attributes:
        sines: The vibration at a speed of 1 m/s.
    """

    sines: Vibration

    def shake(self, t: Array, speed: Channel, heading: Channel, llh: Array, motion: Motion) -> None:
        """See `Vibration.shake`; speed and heading do not matter."""
        self.sines.shake(t, Channel(1.0), Channel(), llh, motion)


def car(rng: np.random.Generator, duration: float) -> Trajectory:
    """Town traffic: 8 to 15 m/s, turns of 90 deg in 5 s at 5 m/s, stops, 1 to 2 m/s^2."""
    softness, t, u = 0.4, 5.0, 0.0
    speed: list[Ramp] = []
    heading: list[Ramp] = []

    def change_to(target: float) -> None:
        nonlocal t, u
        took = abs(target - u) / rng.uniform(1.0, 2.0)
        if took > 0.2:
            speed.append(Ramp(t, t + took, target - u, softness))
            t, u = t + took + 2.0, target

    while t < duration:
        change_to(rng.uniform(8.0, 15.0))
        t += rng.uniform(5.0, 20.0)
        what = rng.choice(["turn", "turn", "stop", "speed"])
        if what == "turn":
            change_to(5.0)
            side = float(rng.choice([-1.0, 1.0]))
            heading.append(Ramp(t, t + 5.0, side * math.pi / 2.0, softness))
            t += 6.0
        elif what == "stop":
            change_to(0.0)
            t += rng.uniform(5.0, 20.0)
    return Trajectory(
        duration=duration,
        speed=Channel(ramps=tuple(speed)),
        heading=Channel(rng.uniform(-3.0, 3.0), ramps=tuple(heading)),
        pitch=Channel(waves=_waves(rng, radians(1.0), 1 / 60, 1 / 20)),
        roll=Channel(waves=_waves(rng, radians(0.7), 1 / 60, 1 / 20)),
        bank=-0.05,
        pivot=-1.2,
        h_0=50.0,
    )


def shaken_car(rng: np.random.Generator, duration: float) -> Trajectory:
    """The car with an engine of three lines between 20 and 40 Hz, also at rest."""
    base = rng.uniform(20.0, 26.0)
    frequency = np.array([base, 1.5 * base, rng.uniform(27.0, 40.0)])
    low, high = np.log(np.repeat([_SHAKE_F, _SHAKE_W], 3, axis=0)).T
    sigma = np.exp(rng.uniform(low, high, (frequency.size, 6)))
    engine = Engine(drawn_sines(2.0 * np.pi * frequency, sigma**2, rng))
    return replace(car(rng, duration), vibration=engine)


def _legs(
    rng: np.random.Generator,
    duration: float,
    speed: float,
    leg: float,
    turn: float,
    sea: Mapping[str, Waves],
    softness: float = 1.0,
) -> Trajectory:
    """Legs of `leg` s, joined by half turns of `turn` s to alternate sides."""
    ramps, t, side = [], leg * rng.uniform(0.4, 1.0), 1.0
    while t < duration:
        ramps.append(Ramp(t, t + turn, side * math.pi, softness))
        t, side = t + turn + leg, -side
    waves = _channels(rng, sea)
    return Trajectory(
        duration=duration,
        speed=Channel(speed, waves=waves.get("speed", ())),
        heading=Channel(rng.uniform(-3.0, 3.0), ramps=tuple(ramps), waves=waves.get("heading", ())),
        pitch=Channel(radians(-0.5), waves=waves.get("pitch", ())),
        roll=Channel(waves=waves.get("roll", ())),
        sway=Channel(waves=waves.get("sway", ())),
        heave=Channel(waves=waves.get("heave", ())),
    )


def shallow_auv(rng: np.random.Generator, duration: float) -> Trajectory:
    """A small AUV near the surface, where waves of 4 to 10 s move it."""
    sea = {
        "speed": (0.03, 0.1, 0.25),
        "sway": (0.03, 0.1, 0.25),
        "heave": (0.05, 0.1, 0.25),
        "pitch": (radians(0.6), 0.1, 0.25),
        "roll": (radians(1.2), 0.1, 0.25),
        "heading": (radians(0.3), 0.1, 0.25),
    }
    legs = _legs(rng, duration, rng.uniform(0.8, 1.4), 50.0, 18.0, sea)
    return replace(legs, bank=0.3, pivot=0.2)


def vessel(rng: np.random.Generator, duration: float) -> Trajectory:
    """A small surface vessel in waves of 2.5 to 10 s."""
    sea = {
        "speed": (0.10, 0.1, 0.4),
        "sway": (0.15, 0.1, 0.4),
        "heave": (0.25, 0.1, 0.4),
        "pitch": (radians(2.0), 0.1, 0.4),
        "roll": (radians(4.0), 0.1, 0.4),
        "heading": (radians(1.0), 0.1, 0.4),
    }
    legs = _legs(rng, duration, rng.uniform(1.5, 3.5), 100.0, 30.0, sea)
    return replace(legs, bank=-0.2, pivot=0.5, h_0=20.0)


def deep_auv(rng: np.random.Generator, duration: float) -> Trajectory:
    """A large AUV on long legs at depth."""
    sea = {
        "speed": (0.02, 1 / 60, 1 / 30),
        "pitch": (radians(0.3), 1 / 40, 1 / 15),
        "roll": (radians(0.3), 1 / 30, 1 / 12),
    }
    legs = _legs(rng, duration, rng.uniform(1.4, 2.0), 170.0, 40.0, sea, softness=2.0)
    return replace(legs, bank=0.3, pivot=0.5, h_0=-100.0)


def smooth_auv(rng: np.random.Generator, duration: float) -> Trajectory:
    """An AUV on legs of a minute that only steering moves."""
    sea = {
        "speed": (0.05, 1 / 60, 1 / 30),
        "pitch": (radians(0.5), 1 / 40, 1 / 15),
        "roll": (radians(0.5), 1 / 30, 1 / 12),
    }
    legs = _legs(rng, duration, rng.uniform(1.0, 2.0), 60.0, 22.0, sea)
    return replace(legs, bank=0.4, pivot=0.4, h_0=-20.0)


def rov(rng: np.random.Generator, duration: float) -> Trajectory:
    """An ROV that hovers, and turns now and then."""
    turns, t = [], 30.0
    while t < duration:
        turns.append(Ramp(t, t + 15.0, rng.uniform(-0.7, 0.7)))
        t += rng.uniform(40.0, 90.0)
    return Trajectory(
        duration=duration,
        speed=Channel(waves=_waves(rng, 0.03, 1 / 40, 1 / 6)),
        sway=Channel(waves=_waves(rng, 0.03, 1 / 40, 1 / 6)),
        heave=Channel(waves=_waves(rng, 0.02, 1 / 40, 1 / 6)),
        heading=Channel(
            rng.uniform(-3.0, 3.0),
            ramps=tuple(turns),
            waves=_waves(rng, radians(1.0), 1 / 30, 1 / 8),
        ),
        pitch=Channel(waves=_waves(rng, radians(0.7), 1 / 20, 1 / 4)),
        roll=Channel(waves=_waves(rng, radians(0.7), 1 / 20, 1 / 4)),
        h_0=-50.0,
    )
