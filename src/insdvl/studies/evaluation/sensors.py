"""The sensors of the missions of a comparison, of which the filters know the data sheets."""

from dataclasses import dataclass

from insdvl.simulation.grades import GRADES, Grade
from insdvl.simulation.mission import DEFAULT_IMU
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import ImuModel

OUTLIER = 1.0  # m/s


@dataclass(frozen=True)
class Sensors:
    """IMU and DVL of the AUV.

    Attributes:
        dvl_std: Noise of each component of a ping on the DVL's data sheet, one sigma [m/s].
        dvl_rate: Pings per second.
        outliers: Probability that a ping is off by `OUTLIER`.
        outliers_missing: Whether the pings that are off are missing instead, and all others are the
            same.
        imu_grade: Key of `GRADES`, of the IMU of a scenario of `DRAWN`; empty for that of the
            scenario. The filter knows its turn-on biases, which do not walk.
        outage: Length of the outages of the DVL [s], see `outages`; 0 for none.
    """

    dvl_std: float = 0.1
    dvl_rate: float = 1.0
    outliers: float = 0.0
    outliers_missing: bool = False
    imu_grade: str = ""
    outage: float = 0.0

    @property
    def grade(self) -> Grade | None:
        """Of the IMU; None for that of the scenario."""
        return GRADES[self.imu_grade] if self.imu_grade else None

    @property
    def imu(self) -> ImuModel:
        """The IMU without its noise."""
        return DEFAULT_IMU if self.grade is None else self.grade.imu()

    @property
    def dvl(self) -> DvlModel:
        """The DVL of the data sheet, without outages."""
        return DvlModel(
            rate=self.dvl_rate,
            noise_std=(self.dvl_std,) * 3,
            outlier_probability=self.outliers,
            outlier_size=OUTLIER,
        )
