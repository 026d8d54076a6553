"""Parameters of the process noise."""

from dataclasses import dataclass

from insdvl.navigation.state.fields import MAX_WINDOW
from insdvl.parameters.declaration import ParameterError, parameter


@dataclass(frozen=True)
class ProcessNoiseParameters:
    """The process noise Q and where it comes from."""

    source: str = parameter(
        "constant",
        "Where Q comes from: the nominal values; the innovations; the process_noise topic; the "
        "covariances in imu/data_raw; the simulator's ground_truth/process_noise.",
        choices=("constant", "adaptive", "external", "message", "oracle"),
    )
    convention: str = parameter(
        "per_sample",
        "Whether a variance is per IMU sample (density = variance / imu.rate) or is itself used "
        "as the density.",
        choices=("per_sample", "density"),
    )
    accelerometer_variance: tuple[float, ...] = parameter(
        (0.01, 0.01, 0.01), "Nominal variance of each axis.", unit="(m/s^2)^2", low=0.0, length=3
    )
    gyroscope_variance: tuple[float, ...] = parameter(
        (0.001, 0.001, 0.001), "Nominal variance of each axis.", unit="(rad/s)^2", low=0.0, length=3
    )
    accelerometer_bias_walk: float = parameter(
        1e-9, "Density of the accelerometer bias walk.", unit="(m/s^2)^2/s", low=0.0
    )
    gyroscope_bias_walk: float = parameter(
        1e-13, "Density of the gyroscope bias walk.", unit="(rad/s)^2/s", low=0.0
    )
    accelerometer_floor: float = parameter(
        1e-8,
        "Smallest variance that an external or message Q may set; counted when it acts.",
        unit="(m/s^2)^2",
        low=0.0,
    )
    gyroscope_floor: float = parameter(
        1e-12,
        "Smallest variance that an external or message Q may set; counted when it acts.",
        unit="(rad/s)^2",
        low=0.0,
    )
    accelerometer_ceiling: float = parameter(
        100.0,
        "Largest variance that an external or message Q may set; counted when it acts.",
        unit="(m/s^2)^2",
        above=0.0,
        high=1e6,
    )
    gyroscope_ceiling: float = parameter(
        10.0,
        "Largest variance that an external or message Q may set; counted when it acts.",
        unit="(rad/s)^2",
        above=0.0,
        high=1e6,
    )
    adaptive_window: int = parameter(
        5, "Number of innovations averaged by the adaptive source (xi).", low=1, high=MAX_WINDOW
    )
    adaptive_form: str = parameter(
        "floored",
        "What the adaptive source does: add its estimate to the nominal Q (floored); replace Q by "
        "it (literal); leave Q alone and estimate the predicted covariance at each update by "
        "variational Bayes (variational); or adapt Q, from the nominal on, by the recursion of "
        "Sage and Husa (sage_husa), or Q and R of the DVL (sage_husa_r).",
        choices=("floored", "literal", "variational", "sage_husa", "sage_husa_r"),
    )
    adaptive_prior: float = parameter(
        10.0,
        "Weight of the predicted covariance relative to one innovation (tau), for the form "
        "'variational'.",
        above=0.0,
        high=1e6,
    )

    adaptive_forgetting: float = parameter(
        0.98,
        "Weight of what was learned before an innovation (b), for the forms 'sage_husa' and "
        "'sage_husa_r'.",
        low=0.5,
        high=0.9999,
    )

    adaptive_factor: bool = parameter(
        False,
        "Whether a common factor on Q, 1/16 to 16, is learned from the innovations of the "
        "velocity; the floors and ceilings hold for the product. Not beside the source 'adaptive'.",
    )

    def __post_init__(self) -> None:
        if self.adaptive_factor and self.source == "adaptive":
            raise ParameterError(
                "parameter 'process_noise.adaptive_factor' must be false where the source is "
                "'adaptive': both learn from the same innovations"
            )
        for sensor in ("accelerometer", "gyroscope"):
            floor, ceiling = (getattr(self, f"{sensor}_{end}") for end in ("floor", "ceiling"))
            if floor > ceiling:
                raise ParameterError(
                    f"parameter 'process_noise.{sensor}_floor' must be at most {sensor}_ceiling "
                    f"({ceiling:g}), got {floor!r}"
                )
