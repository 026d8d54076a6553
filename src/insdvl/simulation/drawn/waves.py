"""Waves and steering: real motion at 0.1 to 3 Hz, added to the functions of a trajectory."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi, radians, sqrt
from types import MappingProxyType
from typing import Any

import numpy as np

from insdvl.simulation.motion import Channel, Trajectory, Wave

#: Sigma of the waves in each function of the trajectory, [m/s] or [rad], of a sea of strength 1.
WAVES: Mapping[str, float] = MappingProxyType(
    {
        "speed": 0.05,
        "sway": 0.05,
        "heave": 0.1,
        "heading": radians(0.5),
        "pitch": radians(1.0),
        "roll": radians(2.0),
    }
)
STRENGTH = (0.5, 2.0)  # of the sea, drawn uniformly
PEAK = (0.1, 0.5)  # Hz, of the sea, drawn uniformly
SPREAD = (0.7, 1.3)  # frequencies around the peak
#: Sigma of the rates of turn [rad/s] in the functions that steering moves.
STEERING: Mapping[str, float] = MappingProxyType({"heading": 0.01, "pitch": 0.01})
STEERING_FREQUENCY = (0.5, 3.0)  # Hz, drawn log-uniformly
_SINES = 3  # of each kind in each function


@dataclass(frozen=True)
class Sea:
    """The sines that are added to each function of a trajectory."""

    added: Mapping[str, tuple[Wave, ...]]

    def moved(self, trajectory: Trajectory) -> Trajectory:
        """A trajectory with the sines added."""
        changed: dict[str, Any] = {}
        for name, added in self.added.items():
            channel: Channel = getattr(trajectory, name)
            changed[name] = replace(channel, waves=channel.waves + added)
        return replace(trajectory, **changed)


def drawn_sea(rng: np.random.Generator) -> Sea:
    """Waves and steering of one mission."""
    strength, peak = rng.uniform(*STRENGTH), rng.uniform(*PEAK)
    added = {}
    for name, sigma in WAVES.items():
        frequencies = np.clip(peak * rng.uniform(*SPREAD, _SINES), *PEAK)
        amplitudes = np.full(_SINES, strength * sigma * sqrt(2.0 / _SINES))
        if name in STEERING:
            low, high = np.log(STEERING_FREQUENCY)
            steered = np.exp(rng.uniform(low, high, _SINES))
            rate = STEERING[name] * sqrt(2.0 / _SINES)
            frequencies = np.concatenate([frequencies, steered])
            amplitudes = np.concatenate([amplitudes, rate / (2.0 * pi * steered)])
        phases = rng.uniform(0.0, 2.0 * pi, frequencies.size)
        added[name] = tuple(
            Wave(float(a), float(1.0 / f), float(phase))
            for a, f, phase in zip(amplitudes, frequencies, phases, strict=True)
        )
    return Sea(added)
