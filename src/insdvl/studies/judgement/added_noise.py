"""A recording with the noise that the filter is told of, once more."""

from dataclasses import replace

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import Event, ProcessNoise
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.studies.replay.taken import Taken

#: Sources of Q that are told it by events; with the others the nominal one is taken.
_TOLD = ("external", "message", "oracle")


def noisier(taken: Taken, parameters: FilterParameters, rng: np.random.Generator) -> Taken:
    """The samples of the IMU and the pings of the DVL with white noise as Q and R tell it.

    Args:
        taken: What was folded.
        parameters: Of the filter that folded it.
        rng: Of the noise.
    """
    stamps_ns, readings = taken.samples
    variances = told_variances(stamps_ns, taken.events, parameters)
    noise = rng.standard_normal(readings.shape) * np.sqrt(variances)
    model = Filter(parameters).models[Dvl.name]

    def pinged(event: Event) -> Event:
        if not isinstance(event, Dvl):
            return event
        sigma = np.where(event.measured, np.sqrt(np.diagonal(model.noise(event))), 0.0)
        return replace(event, v_d=event.v_d + sigma * rng.standard_normal(3))

    return Taken.of(stamps_ns, readings + noise, [pinged(event) for event in taken.events])


def told_variances(stamps_ns: Stamps, events: list[Event], parameters: FilterParameters) -> Array:
    """Variances (N, 6) of samples at stamps (N,), as the filter is told them, in IMU axes.

    Args:
        stamps_ns: Rising.
        events: Those that tell Q among them.
        parameters: Of the filter.
    """
    noise = parameters.process_noise
    nominal = np.array([*noise.accelerometer_variance, *noise.gyroscope_variance])
    told = [
        (
            event.stamp_ns,
            np.concatenate(
                [
                    default if Q is None else np.clip(np.diagonal(Q), *bounds)
                    for Q, default, bounds in (
                        (
                            event.Q_f,
                            nominal[:3],
                            (noise.accelerometer_floor, noise.accelerometer_ceiling),
                        ),
                        (event.Q_w, nominal[3:], (noise.gyroscope_floor, noise.gyroscope_ceiling)),
                    )
                ]
            ),
        )
        for event in sorted(events, key=lambda event: event.stamp_ns)
        if isinstance(event, ProcessNoise) and noise.source in _TOLD
    ]
    steps = np.array([stamp_ns for stamp_ns, _ in told], dtype=np.int64)
    values = np.array([nominal, *(value for _, value in told)])
    found = values[np.searchsorted(steps, stamps_ns, side="left")]
    # A density is that of a variance per sample times the interval.
    return found * (parameters.imu.rate if noise.convention == "density" else 1.0)
