"""Where the vehicle is, against a solution of its own: the path integrated in Earth-fixed axes.

The reference owes nothing to the radii of curvature: the local axes follow from the normal of the
ellipsoid at the Cartesian position, r' = C_e_n v_n, and latitude and height from Bowring's formula
and Newton. Odom's plane is a difference of Cartesian vectors.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from places import position
from scipy.integrate import solve_ivp
from scipy.stats import chi2
from told import TOLD

from insdvl.navigation.events import NS, Initial, Origin, refusal
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry import odom
from insdvl.navigation.geometry.earth import MAX_LATITUDE, MAX_LATITUDE_DEG
from insdvl.navigation.geometry.frames import rotation_from_rpy
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, build
from insdvl.simulation.grades import GRADES
from insdvl.simulation.motion import Channel, Ramp, Trajectory
from insdvl.simulation.sensors.imu import ideal_imu
from insdvl.studies.consistency.flights import Case, fly
from insdvl.timeline.recorded import fold_arrays

A, F = 6378137.0, 1.0 / 298.257223563
B, E2 = A * (1.0 - F), F * (2.0 - F)


# ------------------------------------------------------------------ the reference


def cartesian(llh):
    """Earth-fixed coordinates (..., 3) of places (..., 3)."""
    lat, lon, h = np.moveaxis(np.asarray(llh), -1, 0)
    N = A**2 / np.sqrt((A * np.cos(lat)) ** 2 + (B * np.sin(lat)) ** 2)
    return np.stack(
        [
            (N + h) * np.cos(lat) * np.cos(lon),
            (N + h) * np.cos(lat) * np.sin(lon),
            ((B / A) ** 2 * N + h) * np.sin(lat),
        ],
        axis=-1,
    )


def geodetic(r):
    """Places (..., 3) of Earth-fixed coordinates: Bowring's latitude, then fixed-point steps."""
    x, y, z = np.moveaxis(np.asarray(r), -1, 0)
    p = np.hypot(x, y)
    beta = np.arctan2(z * A, p * B)
    lat = np.arctan2(z + E2 / (1 - E2) * B * np.sin(beta) ** 3, p - E2 * A * np.cos(beta) ** 3)
    for _ in range(4):
        N = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + E2 * N * np.sin(lat), p)
    N = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    h = p * np.cos(lat) + z * np.sin(lat) - A**2 / N
    return np.stack([lat, np.arctan2(y, x), h], axis=-1)


def local_axes(llh):
    """Columns north, east, down in Earth-fixed axes (3, 3)."""
    lat, lon, _ = llh
    down = -np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.cross([0.0, 0.0, 1.0], -down)
    east /= np.linalg.norm(east)
    return np.stack([np.cross(east, down), east, down], axis=1)


def flown(trajectory, times):
    """Earth-fixed coordinates (N, 3) of the trajectory, from its velocity alone."""

    def rate(t, r):
        return local_axes(geodetic(r)) @ trajectory.truth([t]).v_n[0]

    start = cartesian(trajectory.origin)
    span = (0.0, trajectory.duration)
    # A first step of its own choice may look beyond the end of the trajectory.
    steps = {"first_step": 1.0, "max_step": 60.0}
    solution = solve_ivp(
        rate, span, start, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-5, **steps
    )
    return solution.y.T


def in_plane(r, origin):
    """Odom's x, y (N, 2) of Earth-fixed coordinates (N, 3)."""
    return ((r - cartesian(origin)) @ local_axes(origin))[:, :2]


def north_in_plane(llh, origin):
    """Angle of local north in odom's plane."""
    north = local_axes(origin).T @ local_axes(llh)[:, 0]
    return np.arctan2(north[1], north[0])


# ------------------------------------------------------------------ 20 km


def voyage(lat_deg, heading_deg, lon_deg=179.95):
    """20 km in 2000 s, with a bend half way and a slow dive, starting near the date line."""
    return Trajectory(
        duration=2000.0,
        speed=Channel(10.0),
        heading=Channel(np.radians(heading_deg), ramps=(Ramp(900.0, 1000.0, 0.5, 20.0),)),
        pitch=Channel(ramps=(Ramp(300.0, 320.0, -0.01, 5.0),)),
        lat_0=np.radians(lat_deg),
        lon_0=np.radians(lon_deg),
        h_0=-5.0,
    )


VOYAGES = [(60.0, 90.0), (80.0, 90.0), (-45.0, 135.0), (80.0, 200.0), (-80.0, 270.0), (0.0, 60.0)]
TIMES = np.linspace(0.0, 2000.0, 21)


@cache
def reference(lat_deg, heading_deg):
    return flown(voyage(lat_deg, heading_deg), TIMES)


@pytest.mark.parametrize(("lat_deg", "heading_deg"), VOYAGES)
def test_the_truth_is_the_path_over_the_earth(lat_deg, heading_deg):
    trajectory, r = voyage(lat_deg, heading_deg), reference(lat_deg, heading_deg)
    truth = trajectory.truth(TIMES)
    expected = geodetic(r)
    np.testing.assert_allclose(cartesian(truth.llh), r, atol=1e-3)
    np.testing.assert_allclose(truth.p_o[:, :2], in_plane(r, trajectory.origin), atol=1e-3)
    np.testing.assert_allclose(truth.p_o[:, 2], -5.0 - expected[:, 2], atol=1e-3)
    gamma = [north_in_plane(place, trajectory.origin) for place in expected]
    np.testing.assert_allclose(truth.gamma, gamma, atol=1e-9)
    assert np.abs(truth.llh[:, 1]).max() <= np.pi
    if np.sin(np.radians(heading_deg)) > 0.1:  # it has crossed the date line
        assert truth.llh[-1, 1] < 0.0


def filter_at(trajectory, **changes):
    """A filter that starts with the truth at the first sample."""
    start = trajectory.truth([0.01])
    lat, lon, height = trajectory.origin
    C_o_b = start.C_o_b[0]
    rpy = (
        np.arctan2(C_o_b[2, 1], C_o_b[2, 2]),
        -np.arcsin(C_o_b[2, 0]),
        np.arctan2(C_o_b[1, 0], C_o_b[0, 0]),
    )
    values = {
        "frame_convention": "ned",
        "imu.frozen_samples": 0,
        "initial.position": tuple(start.p_o[0].tolist()),
        "initial.rpy": tuple(map(float, rpy)),
        "initial.velocity": tuple((start.C_n_b[0].T @ start.v_n[0]).tolist()),
        "origin.latitude_deg": float(np.degrees(lat)),
        "origin.longitude_deg": float(np.degrees(lon)),
        "origin.height": float(height),
    }
    return build(FilterParameters, TOLD | values | changes)


def perfectly_navigated(trajectory, **changes):
    """Result of the filter with perfect readings of the whole trajectory at 100 Hz."""
    stamps_ns = np.arange(1, round(trajectory.duration * 100) + 1) * (NS // 100)
    t = np.minimum(stamps_ns / NS, trajectory.duration)
    f_b, w_ib_b = ideal_imu(trajectory, t, 0.01, earth_rate=changes.get("earth_rate", True))
    return fold_arrays(filter_at(trajectory, **changes), stamps_ns, f_b, w_ib_b, [])


@pytest.mark.parametrize(
    ("lat_deg", "heading_deg"),
    [*VOYAGES[::2], *(pytest.param(*v, marks=pytest.mark.long) for v in VOYAGES[1::2])],
)
def test_the_filter_with_perfect_readings_is_where_the_vehicle_is(lat_deg, heading_deg):
    """Horizontally 0.01 m over 20 km, in odom and on the Earth."""
    trajectory, r = voyage(lat_deg, heading_deg), reference(lat_deg, heading_deg)
    result = perfectly_navigated(trajectory)
    at = np.round(TIMES[1:] * 100).astype(int) - 1
    states = result.states[at]
    found = [odometry(result.filter, states, k) for k in range(len(at))]
    error = np.array([o.position[:2] for o in found]) - in_plane(r[1:], trajectory.origin)
    assert np.hypot(*error.T).max() < 0.01
    np.testing.assert_allclose(cartesian(states["nav"]["llh"]), r[1:], atol=0.02)
    truth = trajectory.truth(TIMES[1:])
    C_o_b = np.array([rotation_of(o) for o in found])
    np.testing.assert_allclose(C_o_b, truth.C_o_b, atol=1e-6)


def rotation_of(out):
    x, y, z, w = out.quaternion_xyzw
    v = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) * (w * w - v @ v) + 2.0 * np.outer(v, v) + 2.0 * w * cross


@pytest.mark.parametrize("error_state", ["ned", "invariant"])
def test_without_earth_rate_the_filter_is_where_its_simulator_is(error_state):
    """Both let the axes follow the meridian and leave out what that does to the readings."""
    trajectory = dataclasses.replace(voyage(60.0, 70.0), duration=400.0)
    result = perfectly_navigated(trajectory, earth_rate=False, error_state=error_state)
    truth = trajectory.truth([400.0], earth_rate=False)
    np.testing.assert_allclose(position(result.states["nav"])[-1], truth.p_o[0], atol=0.01)


# ------------------------------------------------------------------ odom


ORIGINS = [(60.0, 179.9), (-75.0, -3.0), (0.0, 0.0), (89.0, 20.0)]


def a_place(origin, x, y, z=0.0):
    place = odom.place_of(np.array([x, y, z]), origin)
    assert place is not None
    return place


@pytest.mark.parametrize("degrees", ORIGINS)
def test_odom_is_the_tangent_plane_and_the_height(degrees):
    origin = np.array([*np.radians(degrees), 30.0])
    rng = np.random.default_rng(7)
    for size in (0.0, 10.0, 1e4, 1e5 if degrees[0] < 80.0 else 4e4):
        p_o = np.array([*rng.uniform(-size, size, 2), 12.0])
        place = a_place(origin, *p_o)
        np.testing.assert_allclose(in_plane(cartesian(place)[None], origin)[0], p_o[:2], atol=1e-7)
        assert place[2] == 18.0
        found, gamma = odom.in_odom(place, origin)
        np.testing.assert_allclose(found, p_o, atol=1e-7)
        assert gamma == pytest.approx(north_in_plane(place, origin), abs=1e-12)


@pytest.mark.parametrize("degrees", ORIGINS)
def test_the_jacobian_of_odom_is_the_derivative(degrees):
    """By metres in Earth-fixed axes along the local ones at the vehicle."""
    origin = np.array([*np.radians(degrees), 30.0])
    place = a_place(origin, 3e4, -2e4, -5.0)
    J, turn = odom.jacobian(place, origin)
    slope, axes, r = np.empty(2), local_axes(place), cartesian(place)
    odom.convergence_slope(slope, place, origin)
    for i in range(3):
        ahead, behind = (odom.in_odom(geodetic(r + s * axes[:, i]), origin) for s in (1.0, -1.0))
        np.testing.assert_allclose((ahead[0] - behind[0]) / 2.0, J[:, i], atol=1e-7)
        expected = slope[i] if i < 2 else 0.0
        assert (ahead[1] - behind[1]) / 2.0 == pytest.approx(expected, abs=1e-13, rel=1e-6)
    gamma = north_in_plane(place, origin)
    expected = [[np.cos(gamma), -np.sin(gamma)], [np.sin(gamma), np.cos(gamma)]]
    np.testing.assert_allclose(turn[:2, :2], expected, atol=1e-12)


@pytest.mark.parametrize("velocity_frame", ["body", "nav"])
def test_an_initial_state_far_from_the_origin_comes_out_as_it_went_in(velocity_frame):
    """Position, attitude, velocity and covariances; north is 2 deg off odom's x there."""
    filter_ = Filter(
        build(
            FilterParameters,
            TOLD
            | TOLD
            | {"frame_convention": "ned", "origin.latitude_deg": 75.0, "error_state": "ned"},
        )
    )
    rng, state = np.random.default_rng(3), filter_.empty()
    root = rng.standard_normal((3, 3, 3))
    P_v, P_psi, P_p = root @ np.swapaxes(root, 1, 2) * [[[1e-2]], [[1e-4]], [[1.0]]]
    C = rotation_from_rpy(np.array([0.1, -0.2, 2.0]))
    p_o, v_b = np.array([3e4, 6e4, 40.0]), np.array([1.5, 0.2, -0.1])
    in_body = velocity_frame == "body"
    initial = Initial(0, C, p_o, v_b if in_body else C @ v_b, velocity_frame, P_v, P_psi, P_p)
    filter_.initialise(state, initial, 0, np.zeros(3))
    out = odometry(filter_, state, 0)
    np.testing.assert_allclose(out.position, p_o, atol=1e-7)
    np.testing.assert_allclose(rotation_of(out), C, atol=1e-12)
    np.testing.assert_allclose(out.twist_linear, v_b, atol=1e-12)
    np.testing.assert_allclose(out.pose_covariance[:3, :3], P_p, atol=1e-6)
    np.testing.assert_allclose(out.pose_covariance[3:5, 3:5], P_psi[:2, :2], atol=1e-9)
    if in_body:
        np.testing.assert_allclose(out.twist_covariance[:3, :3], P_v, atol=1e-9)
    _, gamma = odom.in_odom(out.place, np.array([np.radians(75.0), np.radians(34.0), 0.0]))
    assert np.degrees(gamma) < -2.0


# ------------------------------------------------------------------ near the poles


@pytest.mark.parametrize("lat_deg", [89.45, -89.45])
def test_a_kilometre_at_the_largest_latitude(lat_deg):
    trajectory = dataclasses.replace(voyage(lat_deg, 100.0, 10.0), duration=100.0)
    times = np.linspace(0.0, 100.0, 5)
    r, result = flown(trajectory, times), perfectly_navigated(trajectory)
    at = np.round(times[1:] * 100).astype(int) - 1
    error = position(result.states[at]["nav"])[:, :2] - in_plane(r[1:], trajectory.origin)
    assert np.hypot(*error.T).max() < 0.01


def nees_at(lat_deg, runs):
    """NEES of the horizontal position per axis after 600 s, over runs; seeds chosen beforehand."""
    case = Case(GRADES["fog"], 1.0, position_std=10.0, latitude_deg=lat_deg)
    flights = [fly(case, seed) for seed in range(700, 700 + runs)]
    heading = np.sqrt(np.mean([flight.heading_deg[-1] ** 2 for flight in flights]))
    error = np.sqrt(np.mean([flight.error[-1] ** 2 for flight in flights]))
    nees = float(np.mean([flight.nees[-1] for flight in flights]))
    print(f"{lat_deg} deg: NEES {nees:.2f}, position {error:.1f} m, heading {heading:.2f} deg")
    return nees


def test_the_covariance_holds_at_the_largest_latitude():
    low, high = chi2.ppf([0.0005, 0.9995], 2 * 4) / (2 * 4)
    assert low < nees_at(89.4, 4) < high


@pytest.mark.long
@pytest.mark.parametrize("lat_deg", [45.0, 80.0, 89.0, 89.4, -89.4])
def test_the_covariance_holds_at_all_latitudes(lat_deg):
    low, high = chi2.ppf([0.0005, 0.9995], 2 * 12) / (2 * 12)
    assert low < nees_at(lat_deg, 12) < high


@pytest.mark.parametrize("lat_deg", [90.0, -90.0, 89.6])
def test_a_pole_is_no_origin(lat_deg):
    with pytest.raises(ParameterError, match=r"origin\.latitude_deg.*89\.5"):
        build(FilterParameters, TOLD | {"origin.latitude_deg": lat_deg})
    assert refusal(Origin(0, np.radians(lat_deg), 0.0, 0.0)) == "out_of_range"


@pytest.mark.parametrize(("model", "sign"), [("ned", 1.0), ("invariant", -1.0)])
def test_a_vehicle_that_sails_to_the_pole_is_held_and_says_so(model, sign):
    """All numbers stay finite; the latitude stays at the limit, its sigma grows by the way."""
    filter_ = Filter(
        build(
            FilterParameters,
            TOLD
            | TOLD
            | {
                "frame_convention": "ned",
                "error_state": model,
                "imu.frozen_samples": 0,
                "origin.latitude_deg": sign * (MAX_LATITUDE_DEG - 1e-4),
                "initial.velocity": (sign * 5.0, 0.0, 0.0),
            },
        )
    )
    n = 6000
    stamps_ns = np.arange(1, n + 1) * (NS // 100)
    f_b, w_ib_b = np.tile([0.0, 0.0, -9.832], (n, 1)), np.zeros((n, 3))
    result = fold_arrays(filter_.parameters, stamps_ns, f_b, w_ib_b, [])
    nav = result.states["nav"][-1]
    assert nav["llh"][0] == sign * MAX_LATITUDE
    assert result.counts["beyond_latitude"] > 1000
    for name in ("llh", "v_n", "C_n_b", "P"):
        assert np.isfinite(nav[name]).all()
    out = odometry(result.filter, result.states, n - 1)
    assert np.isfinite(out.pose_covariance).all()
    assert np.sqrt(out.place_covariance[0, 0]) > 200.0
    assert np.linalg.eigvalsh(nav["P"][:15, :15])[0] > -1e-9


@pytest.mark.parametrize("lat_deg", [MAX_LATITUDE_DEG, -MAX_LATITUDE_DEG])
def test_the_largest_latitude_itself_may_be_the_origin(lat_deg):
    filter_ = Filter(build(FilterParameters, TOLD | {"origin.latitude_deg": lat_deg}))
    state = filter_.empty()
    initial = Initial(0, np.eye(3), np.zeros(3), np.zeros(3), "body")
    filter_.initialise(state, initial, 0, np.zeros(3))
    assert state[0]["nav"]["initialised"]
    assert refusal(Origin(0, np.radians(lat_deg), 0.0, 0.0)) is None


@pytest.mark.parametrize("position", [(0.0, 6e4, 0.0), (8e5, 8e5, 0.0)])
def test_parameters_that_start_at_no_place_are_refused(position):
    with pytest.raises(ParameterError, match=r"initial\.position.*1000 km.*89\.5 deg"):
        build(
            FilterParameters,
            TOLD | {"origin.latitude_deg": 89.0, "initial.position": position},
        )


@pytest.mark.parametrize("p_o", [(2e6, 0.0, 0.0), (60_000.0, 0.0, 0.0)])
def test_a_start_at_no_place_is_counted_and_not_used(p_o):
    """Too far from the origin, or beyond the largest latitude."""
    filter_ = Filter(
        build(FilterParameters, TOLD | {"origin.latitude_deg": 89.0, "frame_convention": "ned"})
    )
    state = filter_.empty()
    initial = Initial(0, np.eye(3), np.array(p_o), np.zeros(3), "body")
    filter_.initialise(state, initial, 0, np.zeros(3))
    assert not state[0]["nav"]["initialised"]
    assert state[0]["counters"]["off_the_map"] == 1
    assert (refusal(initial) == "out_of_range") == (p_o[0] > odom.MAX_FROM_ORIGIN)
