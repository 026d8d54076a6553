"""What others would do with one IMU sample: plain numpy, filterpy and python-ins."""

from collections.abc import Callable

import numpy as np
import pandas as pd
from pyins import filters, measurements, strapdown, transform

from insdvl.arrays import Array
from insdvl.navigation.geometry import earth
from insdvl.simulation.mission import Mission

_I3, _I15 = np.eye(3), np.eye(15)

#: Advances a state by a sample: C_n_b, v_n, llh and P are arrays that change in place.
Step = Callable[[dict[str, Array], Array, Array, float], None]


def _skew(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def _turn(phi: Array) -> Array:
    X = _skew(phi)
    angle = np.linalg.norm(phi)
    if angle < 1e-8:
        return _I3 + X
    return _I3 + np.sin(angle) / angle * X + (1.0 - np.cos(angle)) / angle**2 * X @ X


def mechanise(s: dict[str, Array], f_b: Array, w_b: Array, dt: float) -> tuple[Array, Array]:
    """Strapdown as a short program would have it; returns F (15, 15) and G (15, 6)."""
    C, v, llh = s["C_n_b"], s["v_n"], s["llh"]
    lat, h = llh[0], llh[2]
    R_N, R_E = earth.radii(lat)
    w_ie = earth.EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    w_en = np.array([v[1] / (R_E + h), -v[0] / (R_N + h), -v[1] * np.tan(lat) / (R_E + h)])
    g = np.array([0.0, 0.0, earth.gravity(lat, h)])
    f_n = C @ _turn(0.5 * w_b * dt) @ f_b
    a = f_n + g - np.cross(2.0 * w_ie + w_en, v)
    F, G = np.zeros((15, 15)), np.zeros((15, 6))
    v_x = _skew(v)
    F[:3, :3] = -_skew(2.0 * w_ie + w_en)
    F[:3, 3:6] = _skew(g) + v_x @ _skew(w_ie)
    F[:3, 6:9], F[:3, 9:12] = -C, -v_x @ C
    F[3:6, 3:6], F[3:6, 9:12] = -_skew(w_ie + w_en), -C
    F[12:, :3] = _I3
    G[:3, :3], G[:3, 3:], G[3:6, 3:] = C, v_x @ C, C
    llh += dt * np.array([v[0] / (R_N + h), v[1] / ((R_E + h) * np.cos(lat)), -v[2]])
    v += dt * a
    s["C_n_b"][:] = _turn(-(w_ie + w_en) * dt) @ C @ _turn(w_b * dt)
    return F, G


def plain_numpy(density: Array) -> Step:
    """One step of all in numpy, with densities (6,)."""

    def step(s: dict[str, Array], f_b: Array, w_b: Array, dt: float) -> None:
        F, G = mechanise(s, f_b, w_b, dt)
        Phi = _I15 + F * dt + F @ F * (0.5 * dt**2)
        s["P"][:] = Phi @ s["P"] @ Phi.T + (G * density) @ G.T * dt

    return step


def of_filterpy(density: Array) -> Step | str:
    """The same with filterpy's Kalman filter; a sentence where it is not installed."""
    try:
        from filterpy.kalman import KalmanFilter
    except ImportError:
        return "filterpy is left out: it is not installed (pip install filterpy)"
    kalman = KalmanFilter(dim_x=15, dim_z=3)

    def step(s: dict[str, Array], f_b: Array, w_b: Array, dt: float) -> None:
        F, G = mechanise(s, f_b, w_b, dt)
        kalman.P = s["P"]
        kalman.predict(F=_I15 + F * dt + F @ F * (0.5 * dt**2), Q=(G * density) @ G.T * dt)
        s["P"][:] = kalman.P

    return step


def of_python_ins(mission: Mission) -> Callable[[], object]:
    """A call that runs python-ins' filter over a mission, with its covariance at 10 Hz."""
    truth = mission.initial
    rph = transform.mat_to_rph(truth.C_n_b[0])
    first = [np.degrees(truth.llh[0, 0]), np.degrees(truth.llh[0, 1]), truth.llh[0, 2]]
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    pva = pd.Series([*first, *truth.v_n[0], *rph], index=names)
    times = (np.append(mission.start_ns, mission.stamps_ns) - mission.start_ns) * 1e-9
    columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    steps = np.hstack([mission.w_ib_b, mission.f_b]) * np.diff(times)[:, None]
    imu = pd.DataFrame(np.vstack([steps[:1], steps]), index=times, columns=columns)
    increments = strapdown.compute_increments_from_imu(imu, "increment")
    dvl = pd.DataFrame(
        mission.v_d,
        index=(mission.dvl_stamps_ns - mission.start_ns) * 1e-9,
        columns=["VX", "VY", "VZ"],
    )
    ping = measurements.BodyVelocity(dvl, 0.02)
    pva.name = 0.0
    return lambda: filters.run_feedback_filter(
        pva, 0.1, 0.1, 0.5, 1.0, increments, measurements=[ping], time_step=0.1
    )
