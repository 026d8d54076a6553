"""The simulated pressure sensor: absolute pressure at its position, and its noise."""

from dataclasses import dataclass, replace

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.geometry.frames import Convention
from insdvl.parameters.declaration import lever_arm, parameter
from insdvl.simulation.motion import Truth


@dataclass(frozen=True)
class DepthModel:
    """The simulated depth sensor, a pressure sensor."""

    rate: float = parameter(
        0.0, "Pressures per second; 0 for no sensor.", unit="Hz", low=0.0, high=1000.0
    )
    lever_arm: tuple[float, ...] = lever_arm("depth sensor")
    noise_std: float = parameter(0.02, "White noise, one sigma.", unit="m", low=0.0)
    water_density: float = parameter(
        1025.0, "Density of the water.", unit="kg/m^3", low=900.0, high=1300.0
    )
    atmospheric_pressure: float = parameter(
        101_325.0, "Pressure at the surface.", unit="Pa", low=0.0, high=120_000.0
    )
    surface_height: float = parameter(
        0.0,
        "Height of the water's surface above the ellipsoid.",
        unit="m",
        low=-12_000.0,
        high=100_000.0,
    )

    def in_frd(self, convention: Convention) -> "DepthModel":
        """This sensor with its lever arm in forward-right-down.

        Args:
            convention: Axes of the lever arm.
        """
        return replace(self, lever_arm=tuple(convention.body @ self.lever_arm))


def ideal_pressure(truth: Truth, model: DepthModel) -> Array:
    """Absolute pressure (N,) [Pa] at the sensor.

    Args:
        truth: At the times of the readings.
        model: With its lever arm in forward-right-down.
    """
    height = truth.llh[:, 2] - truth.C_n_b[:, 2, :] @ np.array(model.lever_arm)
    g = np.array([gravity(*place) for place in zip(truth.llh[:, 0], height, strict=True)])
    return model.atmospheric_pressure + model.water_density * g * (model.surface_height - height)


def pressure_noise(model: DepthModel, lat_0: float, size: int, rng: np.random.Generator) -> Array:
    """Noise (N,) of the pressure [Pa]."""
    sigma = model.noise_std * model.water_density * gravity(lat_0, 0.0)
    return sigma * rng.standard_normal(size)
