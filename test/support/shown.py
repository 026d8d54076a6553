"""What a monitor's table shows of a filter, as an example."""

import numpy as np

from insdvl.watch.table.numbers import Measured, Pose, Shown, Triads

POSE = Pose(
    stamp_s=1234.56,
    position=np.array([123.456, -45.678, 12.3456]),
    rpy_deg=np.array([1.234, -0.567, 271.89]),
    velocity=np.array([1.5, 0.02, -0.01]),
    position_sigma=np.array([1.23, 0.87, 0.052]),
    rpy_sigma_deg=np.array([0.052, 0.052, 1.4]),
    velocity_sigma=np.array([0.021, 0.019, 0.012]),
)
SHOWN = Shown(
    label="/learned",
    node="/learned/insdvl_filter",
    silent=0.4,
    pose=POSE,
    measured=(
        Measured("DVL", 398, {"gate": 1, "no_lock": 1}, 0.42),
        Measured("depth sensor", 4000, {}, 0.1),
    ),
    nis=2.95,
    nis_count=100,
    bias=Triads(np.array([1.2e-3, -0.3e-3, 0.0]), np.array([1e-6, 2e-6, -1e-6])),
    bias_sigma=Triads(np.full(3, 0.8e-3), np.full(3, 0.5e-6)),
    noise=Triads(np.array([0.012, 0.011, 0.013]), np.array([1e-3, 2e-3, 3e-3])),
    nominal=Triads(np.full(3, 0.01), np.full(3, 0.001)),
    noise_source="external, 0.5 s old",
    inflations=2,
    imu_rate=99.96,
    output_rate=100.0,
)
