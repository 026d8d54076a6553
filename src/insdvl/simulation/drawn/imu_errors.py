"""Errors of the IMU that are not white, sample by sample, beside the spectra that they have."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.simulation.drawn.spectrum import Spectrum, flicker
from insdvl.simulation.noise import NoiseProfile, gauss_markov

#: Time constants of the flicker noise [s]: from a tenth of a second to longer than a mission.
FLICKER = (0.1, 1000.0)


@dataclass(frozen=True, eq=False)
class Line:
    """A sine in the samples that is no motion: vibration above half the sample rate, aliased.

    Attributes:
        frequency: As it appears in the samples, below half the rate [Hz].
        variances: (6,) of the channels.
    """

    frequency: float
    variances: Array


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """The first-order (Gauss-Markov) errors that are added up in the noise of an IMU.

    Attributes:
        channels: (M,) the channel of each.
        time_constants: (M,) [s].
        variances: (K, M) stationary variances at K times [unit^2].
    """

    channels: NDArray[np.intp]
    time_constants: Array
    variances: Array


@dataclass(frozen=True, eq=False)
class ImuErrors:
    """What a drawn IMU adds to white noise and biases. Channels are ordered as in `noise`.

    Attributes:
        coloured: First-order noise. Its variances are those of a white noise with the density that
            this has at f = 0; None without.
        time_constants: (6,) of the first-order noise [s].
        flicker: (6,) coefficients h of the density h / |f| [unit^2].
        counts: (6,) size of a count of the integrated channels [m/s], [rad]; 0 for none.
        lines: Aliased vibration.
        force: (3, 3) scale factor errors of the accelerometers, and misalignments off the diagonal.
        rate: (3, 3) the same of the gyroscopes.
    """

    coloured: NoiseProfile | None
    time_constants: Array
    flicker: Array
    counts: Array
    lines: tuple[Line, ...]
    force: Array
    rate: Array

    def spectra(self, t: float, white: Array, dt: float) -> list[Spectrum]:
        """The spectra of the six channels from time t on.

        Args:
            t: [s].
            white: (6,) variances per sample of the white noise then.
            dt: Time between samples [s].
        """
        found = self.first_order(np.array([t]), dt)
        columns = found.channels, found.variances[0], found.time_constants
        every = list(zip(*(column.tolist() for column in columns), strict=True))
        return [
            Spectrum(
                white=float(white[i] * dt),
                first_order=tuple((variance, tau) for at, variance, tau in every if at == i),
                lines=tuple((float(line.variances[i]), line.frequency) for line in self.lines),
                bounded=float(self.counts[i] ** 2 / 12.0),
            )
            for i in range(6)
        ]

    def first_order(self, t: Array, dt: float) -> FirstOrder:
        """The flicker, as the first-order errors that it is made of, and the coloured noise.

        Args:
            t: (K,) [s].
            dt: Time between samples [s].
        """
        every = np.arange(6)
        channels = [np.empty(0, np.intp)]
        taus, variances = [np.empty(0)], [np.empty((t.size, 0))]
        if self.flicker.any():
            for variance, tau in flicker(1.0, *FLICKER):
                channels.append(every)
                taus.append(np.full(6, tau))
                variances.append(np.tile(variance * self.flicker, (t.size, 1)))
        if self.coloured is not None:
            channels.append(every)
            taus.append(self.time_constants)
            variances.append(self._variances(self.coloured.variance_at(t), dt))
        return FirstOrder(np.concatenate(channels), np.concatenate(taus), np.hstack(variances))

    def distorted(self, readings: Array) -> Array:
        """True readings (N, 6) with scale factors and misalignments."""
        f, w = readings[:, :3], readings[:, 3:]
        return readings + np.hstack([f @ self.force.T, w @ self.rate.T])

    def noise(self, begins: Array, dt: float, rng: np.random.Generator) -> Array:
        """Coloured noise, flicker and lines (N, 6) of samples.

        Args:
            begins: (N,) beginnings of their intervals [s].
            dt: Time between samples [s].
            rng: Each kind of error draws from a stream of its own.
        """
        coloured, flickering, phases = rng.spawn(3)
        total = np.zeros((begins.size, 6))
        if self.coloured is not None:
            unit = gauss_markov(np.ones(6), dt / self.time_constants, begins.size, coloured)
            total += np.sqrt(self._variances(self.coloured.variance_at(begins), dt)) * unit
        if self.flicker.any():
            parts = flicker(1.0, *FLICKER)
            for (variance, tau), stream in zip(parts, flickering.spawn(len(parts)), strict=True):
                std = np.sqrt(variance * self.flicker)
                total += gauss_markov(std, dt / tau, begins.size, stream)
        for line in self.lines:
            angle = 2.0 * np.pi * line.frequency * begins[:, None]
            phase = phases.uniform(0.0, 2.0 * np.pi, 6)
            total += np.sqrt(2.0 * line.variances) * np.sin(angle + phase)
        return total

    def counted(self, readings: Array, dt: float) -> Array:
        """Readings (N, 6) as whole counts of their integral; the rest is carried to the next."""
        out = readings.copy()
        for i in np.flatnonzero(self.counts):
            whole = np.rint(np.cumsum(readings[:, i]) * (dt / self.counts[i]))
            out[:, i] = np.diff(whole, prepend=0.0) * (self.counts[i] / dt)
        return out

    def _variances(self, white: Array, dt: float) -> Array:
        """Variances (K, 6) of first-order noise with the densities white dt at f = 0."""
        return white * dt / (2.0 * self.time_constants)
