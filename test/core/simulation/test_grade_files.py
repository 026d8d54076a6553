"""The parameter files for the grades of IMU are those of the grades that studies are flown with."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.sections import load_section
from insdvl.simulation.grades import GRADES
from insdvl.simulation.parameters import SimulatorParameters

CONFIG = Path(__file__).parents[3] / "ros_insdvl" / "config"


@pytest.mark.parametrize("name", GRADES)
def test_a_file_has_the_numbers_of_its_grade(name: str) -> None:
    grade = GRADES[name]
    path = CONFIG / f"imu_{name}.yaml"
    told = load_section(path, "insdvl_filter", FilterParameters, required=True)
    noise, initial = told.process_noise, told.initial
    variances = [*noise.accelerometer_variance, *noise.gyroscope_variance]
    np.testing.assert_allclose(variances, grade.variances(told.imu.rate), rtol=1e-3)
    assert initial.mode == "auto"
    assert initial.accelerometer_bias_std == pytest.approx(grade.accelerometer_bias, rel=1e-3)
    assert initial.gyroscope_bias_std == pytest.approx(grade.gyroscope_bias, rel=1e-3)
    # A learned Q may come, and is never below the sensor's own noise.
    replace(told, process_noise=replace(noise, source="external"))
    assert noise.accelerometer_floor == noise.accelerometer_variance[0]
    assert noise.gyroscope_floor == noise.gyroscope_variance[0]


def test_the_defaults_of_filter_and_simulator_fit_each_other() -> None:
    """The default biases are those of a MEMS, and the simulator's are within them."""
    initial, imu = FilterParameters().initial, SimulatorParameters().imu
    mems = GRADES["mems"]
    assert initial.accelerometer_bias_std == pytest.approx(mems.accelerometer_bias, rel=1e-3)
    assert initial.gyroscope_bias_std == pytest.approx(mems.gyroscope_bias, rel=1e-3)
    assert imu.accelerometer_bias_std <= initial.accelerometer_bias_std
    assert imu.gyroscope_bias_std <= initial.gyroscope_bias_std
    assert imu.rate == FilterParameters().imu.rate
