"""Messages to events: what is refused, by which name, and what becomes of the rest."""

from types import SimpleNamespace as Message

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.messages import convert as messages
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.dvl import dvl
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU, NED

NAN, INF = float("nan"), float("inf")


def header(sec=12, nanosec=345_678_901):
    return Message(stamp=Message(sec=sec, nanosec=nanosec), frame_id="any")


def xyz(x, y, z):
    return Message(x=x, y=y, z=z)


def flat(matrix):
    return np.asarray(matrix, dtype=float).ravel()


def imu_message(f=(0.1, 0.2, 9.8), w=(0.01, 0.02, 0.03), P_f=None, P_w=None):
    return Message(
        header=header(),
        linear_acceleration=xyz(*f),
        angular_velocity=xyz(*w),
        linear_acceleration_covariance=np.zeros(9) if P_f is None else flat(P_f),
        angular_velocity_covariance=np.zeros(9) if P_w is None else flat(P_w),
        orientation_covariance=flat([[-1.0, 0, 0], [0, 0, 0], [0, 0, 0]]),
    )


def twist_message(v=(1.0, 0.2, -0.1), covariance=None):
    twist = Message(linear=xyz(*v), angular=xyz(0.0, 0.0, 0.0))
    if covariance is not None:
        twist = Message(twist=twist, covariance=flat(covariance))
    return Message(header=header(), twist=twist)


def odometry_message(
    q=(0.0, 0.0, 0.0, 1.0), p=(1.0, 2.0, 3.0), v=(0.5, 0.1, 0.2), P=None, P_v=None
):
    orientation = Message(x=q[0], y=q[1], z=q[2], w=q[3])
    return Message(
        header=header(),
        pose=Message(
            pose=Message(position=xyz(*p), orientation=orientation),
            covariance=np.zeros(36) if P is None else flat(P),
        ),
        twist=Message(
            twist=Message(linear=xyz(*v), angular=xyz(0.0, 0.0, 0.0)),
            covariance=np.zeros(36) if P_v is None else flat(P_v),
        ),
    )


def fix_message(latitude=32.0, longitude=34.0, altitude=-5.0, status=0):
    return Message(
        header=header(),
        status=Message(status=status),
        latitude=latitude,
        longitude=longitude,
        altitude=altitude,
    )


def block_covariance():
    """A full, positive 6 by 6."""
    root = np.random.default_rng(70).standard_normal((6, 6))
    return root @ root.T


def reason_of(function, *arguments, **named):
    with pytest.raises(RejectedMessage) as caught:
        function(*arguments, **named)
    assert str(caught.value).startswith(caught.value.reason + ": ")
    return caught.value.reason


def test_stamps_are_exact_nanoseconds():
    assert messages.stamp_ns(header(1_700_000_000, 999_999_999)) == 1_700_000_000_999_999_999


@pytest.mark.parametrize(
    ("sec", "nanosec"), [(-1, 0), (-(2**31), 999_999_999), (0, NS), (5, 2**32 - 1), (5, -1)]
)
def test_bad_stamps(sec, nanosec):
    with pytest.raises(RejectedMessage, match=f"bad_stamp: stamp is {sec} s and {nanosec} ns"):
        messages.stamp_ns(header(sec, nanosec))


def test_the_last_stamp_there_is():
    assert messages.stamp_ns(header(2**31 - 1, NS - 1)) == 2**31 * NS - 1


def test_a_sensor_has_to_set_its_stamp():
    for function, message in ((messages.imu, imu_message()), (dvl, twist_message())):
        message.header = header(0, 0)
        assert reason_of(function, message, ENU) == "no_stamp"
        message.header = header(0, 1)
        assert function(message, ENU).stamp_ns == 1


SIZES = [0, 1, 2, 3, 6, 8, 10, 12, 35, 37]


@pytest.mark.parametrize("size", SIZES)
def test_covariances_of_a_wrong_size(size):
    """Refused by name where the covariance counts; a sample whose own is broken is a sample."""
    wrong = np.ones(size)
    message = imu_message(P_f=wrong)
    assert messages.imu(message, ENU) is not None
    assert reason_of(messages.process_noise, message, ENU) == "bad_covariance"
    message = imu_message(P_w=wrong)
    assert messages.imu(message, ENU) is not None
    assert reason_of(messages.process_noise, message, ENU) == "bad_covariance"
    assert reason_of(dvl, twist_message(covariance=wrong), ENU) == "bad_covariance"
    for message in (odometry_message(P=wrong), odometry_message(P_v=wrong)):
        assert reason_of(messages.initial, message, ENU, once=False) == "bad_covariance"


def test_a_covariance_beyond_all_measure():
    """So large that its eigenvalues overflow."""
    for size in (1e13, 1e200, 1.7e308):
        assert reason_of(messages.covariance, size * np.eye(3), 3, "P") == "bad_covariance"


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
@pytest.mark.parametrize("axis", range(3))
def test_not_finite(bad, axis):
    values = [0.1, 0.2, 0.3]
    values[axis] = bad
    assert reason_of(messages.imu, imu_message(f=values), ENU) == "not_finite"
    assert reason_of(messages.imu, imu_message(w=values), ENU) == "not_finite"
    assert reason_of(dvl, twist_message(values), ENU) == "not_finite"
    odometry = odometry_message(p=values)
    assert reason_of(messages.initial, odometry, ENU, once=False) == "not_finite"
    odometry = odometry_message(v=values)
    assert reason_of(messages.initial, odometry, ENU, once=False) == "not_finite"


def test_the_reason_names_the_field_and_the_value():
    with pytest.raises(RejectedMessage, match=r"angular_velocity is \[0.0, nan, 0.0\]"):
        messages.imu(imu_message(w=(0.0, NAN, 0.0)), ENU)


class TestImu:
    def test_changes_axes(self):
        event = messages.imu(imu_message(f=(1.0, 2.0, 3.0), w=(4.0, 5.0, 6.0)), ENU)
        assert event.stamp_ns == 12_345_678_901
        np.testing.assert_array_equal(event.f_b, [1.0, -2.0, -3.0])
        np.testing.assert_array_equal(event.w_ib_b, [4.0, -5.0, -6.0])

    def test_at_rest_in_ros_axes_gravity_pulls_down_in_ours(self):
        event = messages.imu(imu_message(f=(0.0, 0.0, 9.8)), ENU)
        np.testing.assert_array_equal(event.f_b, [0.0, 0.0, -9.8])

    def test_ned_streams_pass_unchanged(self):
        event = messages.imu(imu_message(f=(1.0, 2.0, 3.0)), NED)
        np.testing.assert_array_equal(event.f_b, [1.0, 2.0, 3.0])

    @pytest.mark.parametrize("field", ["P_f", "P_w"])
    def test_minus_one_means_not_measured(self, field):
        message = imu_message(**{field: np.diag([-1.0, 0.0, 0.0])})
        assert reason_of(messages.imu, message, ENU) == "no_data"

    def test_the_orientation_need_not_be_measured(self):
        assert messages.imu(imu_message(), ENU) is not None

    def test_covariances_are_not_its_business(self):
        """A sample with a broken covariance is still a sample."""
        assert messages.imu(imu_message(P_f=np.full(9, NAN)), ENU) is not None


class TestCovariance:
    def test_zeros_are_unknown(self):
        assert messages.covariance(np.zeros(9), 3, "P") is None

    def test_passes_a_good_one_exactly(self):
        P = block_covariance()
        np.testing.assert_array_equal(messages.covariance(flat(P), 6, "P"), P)

    def test_passes_a_singular_one(self):
        P = np.diag([1.0, 0.0, 4.0])
        np.testing.assert_array_equal(messages.covariance(flat(P), 3, "P"), P)

    def test_minus_one(self):
        assert reason_of(messages.covariance, flat(np.diag([-1.0, 0, 0])), 3, "P") == "no_data"

    @pytest.mark.parametrize(
        "values",
        [
            np.zeros(8),
            np.ones(36),
            [],
            np.full(9, NAN),
            [NAN] + [0.0] * 8,
            flat(np.diag([1.0, INF, 1.0])),
            flat([[1.0, 0.1, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            flat(np.diag([1.0, -0.5, 1.0])),
            flat([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            flat(np.diag([-2.0, 1.0, 1.0])),
        ],
        ids=[
            "short",
            "long",
            "empty",
            "nan",
            "nan first",
            "infinite",
            "asymmetric",
            "negative variance",
            "negative eigenvalue",
            "negative first",
        ],
    )
    def test_refused(self, values):
        assert reason_of(messages.covariance, values, 3, "P") == "bad_covariance"

    @pytest.mark.parametrize("rounding", [1e-12, 1.9e-8, 1e-6])
    def test_rounding_is_no_reason(self, rounding):
        """Relative to the largest element; single precision makes 6e-8."""
        P = block_covariance()
        P[0, 1] += rounding * np.abs(P).max()
        symmetric = messages.covariance(flat(P), 6, "P")
        np.testing.assert_array_equal(symmetric, symmetric.T)
        np.testing.assert_allclose(symmetric, P, atol=rounding * np.abs(P).max())

    def test_a_larger_asymmetry_is(self):
        P = block_covariance()
        P[0, 1] += 2e-6 * np.abs(P).max()
        assert reason_of(messages.covariance, flat(P), 6, "P") == "bad_covariance"

    def test_a_singular_covariance_in_single_precision_has_no_negative_eigenvalue(self):
        rng = np.random.default_rng(71)
        for _ in range(100):
            root = rng.standard_normal((3, 1))
            P = (root @ root.T).astype(np.float32).astype(float)
            mended = messages.covariance(P.ravel(), 3, "P")
            np.testing.assert_allclose(mended, P, atol=1e-7 * P.max())
            assert np.linalg.eigvalsh(mended)[0] > -1e-9 * P.max()


class TestCompleted:
    def test_all_unknown_stays_unknown(self):
        assert messages.completed(None, (1.0, 2.0, 3.0)) is None

    def test_of_positive_variances_nothing_changes(self):
        """Also where it is singular: two components that are the same."""
        for P in (block_covariance()[:3, :3], np.ones((3, 3))):
            np.testing.assert_array_equal(messages.completed(P, (1.0, 2.0, 3.0)), P)

    def test_a_zero_variance_is_unknown_and_independent(self):
        P = np.array([[4.0, 0.0, 1.0], [0.0, 0.0, 1e-12], [1.0, 1e-12, 9.0]])
        expected = np.array([[4.0, 0.0, 1.0], [0.0, 0.25, 0.0], [1.0, 0.0, 9.0]])
        np.testing.assert_array_equal(messages.completed(P, (7.0, 0.5, 7.0)), expected)


class TestProcessNoise:
    def test_covariances_in_our_axes(self):
        Q = block_covariance()[:3, :3]
        event = messages.process_noise(imu_message(P_f=Q, P_w=2.0 * Q), ENU)
        signs = np.array([1.0, -1.0, -1.0])
        np.testing.assert_array_equal(event.Q_f, Q * np.outer(signs, signs))
        np.testing.assert_array_equal(event.Q_w, 2.0 * Q * np.outer(signs, signs))

    @pytest.mark.parametrize("unknown", [np.zeros(9), np.diag([-1.0, 0.0, 0.0])])
    def test_unknown_is_not_zero(self, unknown):
        event = messages.process_noise(imu_message(P_f=unknown, P_w=np.eye(3)), ENU)
        assert event.Q_f is None
        np.testing.assert_array_equal(event.Q_w, np.eye(3))

    def test_one_bad_triad_refuses_the_message(self):
        message = imu_message(P_f=np.eye(3), P_w=np.diag([1.0, -1.0, 1.0]))
        assert reason_of(messages.process_noise, message, ENU) == "bad_covariance"


class TestDvl:
    def test_without_covariance(self):
        event = dvl(twist_message((1.0, 2.0, 3.0)), ENU)
        np.testing.assert_array_equal(event.v_d, [1.0, -2.0, -3.0])
        assert event.R is None

    def test_takes_the_block_of_the_velocity(self):
        P = block_covariance()
        event = dvl(twist_message(covariance=P), NED)
        np.testing.assert_array_equal(event.R, P[:3, :3])
        signs = np.array([1.0, -1.0, -1.0])
        event = dvl(twist_message(covariance=P), ENU)
        np.testing.assert_array_equal(event.R, P[:3, :3] * np.outer(signs, signs))

    def test_zeros_are_unknown(self):
        assert dvl(twist_message(covariance=np.zeros(36)), ENU).R is None

    def test_turn_rates_that_are_not_measured_do_not_matter(self):
        P = np.zeros((6, 6))
        P[:3, :3] = np.eye(3)
        P[3:, 3:] = np.diag([-1.0, 0.0, 0.0])
        np.testing.assert_array_equal(dvl(twist_message(covariance=P), NED).R, np.eye(3))

    def test_minus_one_is_an_unknown_variance(self):
        """REP-145 has it for a covariance that is not measured; drivers write it for unknown."""
        P = np.zeros((6, 6))
        P[0, 0] = -1.0
        assert dvl(twist_message(covariance=P), ENU).R is None
        P = np.diag([-1.0, 4.0, 9.0, 0.0, 0.0, 0.0])
        P[0, 1] = P[1, 0] = 7.0
        P[1, 2] = P[2, 1] = 3.0
        event = dvl(twist_message(covariance=P), NED)
        np.testing.assert_array_equal(event.R, [[0, 0, 0], [0, 4, 3], [0, 3, 9]])
        assert event.measured == (True, True, True)

    @pytest.mark.parametrize("v", [0.5, NAN, INF])
    @pytest.mark.parametrize("correlation", [0.0, 0.5, NAN, INF])
    def test_an_infinite_variance_is_a_component_that_was_not_measured(self, v, correlation):
        P = np.diag([4.0, INF, 9.0, 0.0, 0.0, 0.0])
        P[0, 1] = P[1, 0] = P[1, 2] = P[2, 1] = correlation
        event = dvl(twist_message((1.0, v, 3.0), covariance=P), ENU)
        np.testing.assert_array_equal(event.v_d, [1.0, 0.0, -3.0])
        np.testing.assert_array_equal(event.R, np.diag([4.0, 0.0, 9.0]))
        assert event.measured == (True, False, True)

    @pytest.mark.parametrize("variance", [100.0, 1e6, 1e15])
    def test_a_huge_variance_is_a_component_that_was_not_measured(self, variance):
        """One sigma of 10 m/s is the fill value of a figure of merit."""
        P = np.diag([4.0, variance, 9.0, 0.0, 0.0, 0.0])
        event = dvl(twist_message((1.0, 0.5, 3.0), covariance=P), ENU)
        np.testing.assert_array_equal(event.v_d, [1.0, 0.0, -3.0])
        np.testing.assert_array_equal(event.R, np.diag([4.0, 0.0, 9.0]))
        assert event.measured == (True, False, True)
        alone = np.diag([-1.0, variance, 0.0, 0.0, 0.0, 0.0])
        event = dvl(twist_message(covariance=alone), ENU)
        assert (event.R, event.measured) == (None, (True, False, True))

    @pytest.mark.parametrize("variance", [100.0, 1e6, 1e15])
    def test_huge_variances_alone_are_invalid(self, variance):
        for variances in ([variance] * 3, [variance, INF, variance]):
            P = np.diag([*variances, 0.0, 0.0, 0.0])
            assert reason_of(dvl, twist_message(covariance=P), ENU) == "invalid"
        P = np.diag([99.0, 99.0, 99.0, 1e6, 1e6, 1e6])  # of the turn rate nothing is asked
        event = dvl(twist_message(covariance=P), ENU)
        np.testing.assert_array_equal(event.R, 99.0 * np.eye(3))
        assert event.measured == (True, True, True)

    def test_nothing_measured_is_no_data(self):
        P = np.diag([INF, INF, INF, 0.0, 0.0, 0.0])
        assert reason_of(dvl, twist_message(covariance=P), ENU) == "no_data"

    def test_nan_with_a_variance_that_is_only_unknown_is_refused(self):
        P = np.diag([4.0, -1.0, 9.0, 0.0, 0.0, 0.0])
        message = twist_message((1.0, NAN, 3.0), covariance=P)
        assert reason_of(dvl, message, ENU) == "not_finite"

    @pytest.mark.parametrize(
        "P",
        [
            np.diag([1.0, -0.5, 1.0, 1.0, 1.0, 1.0]),
            np.diag([1.0, -INF, 1.0, 1.0, 1.0, 1.0]),
            np.full((6, 6), NAN),
        ],
    )
    def test_bad_covariance(self, P):
        assert reason_of(dvl, twist_message(covariance=P), ENU) == "bad_covariance"


class TestInitial:
    def test_facing_east_in_ros_is_a_heading_of_90_degrees(self):
        event = messages.initial(odometry_message(), ENU, once=True)
        np.testing.assert_allclose(
            event.C_o_b, Rotation.from_euler("z", 90.0, degrees=True).as_matrix(), atol=1e-15
        )
        np.testing.assert_array_equal(event.p_o, [2.0, 1.0, -3.0])
        np.testing.assert_array_equal(event.v, [0.5, -0.1, -0.2])
        assert event.velocity_frame == "body"
        assert event.once
        assert event.P_v is event.P_psi is event.P_p is None

    def test_blocks_of_the_covariances(self):
        P, P_v = block_covariance(), 2.0 * block_covariance()
        event = messages.initial(odometry_message(P=P, P_v=P_v), NED, once=False)
        np.testing.assert_array_equal(event.P_p, P[:3, :3])
        np.testing.assert_array_equal(event.P_psi, P[3:, 3:])
        np.testing.assert_array_equal(event.P_v, P_v[:3, :3])

    def test_covariances_in_our_axes(self):
        """Variances of east, north, up; of the turns about them; of forward, left, up."""
        P = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
        P[0, 2] = P[2, 0] = 0.5
        event = messages.initial(odometry_message(P=P, P_v=P), ENU, once=False)
        np.testing.assert_array_equal(np.diagonal(event.P_p), [2.0, 1.0, 3.0])
        assert event.P_p[1, 2] == -0.5
        np.testing.assert_array_equal(np.diagonal(event.P_psi), [5.0, 4.0, 6.0])
        np.testing.assert_array_equal(np.diagonal(event.P_v), [1.0, 2.0, 3.0])
        assert event.P_v[0, 2] == -0.5

    def test_a_block_of_zeros_is_unknown(self):
        P = np.zeros((6, 6))
        P[:3, :3] = np.eye(3)
        event = messages.initial(odometry_message(P=P), NED, once=False)
        np.testing.assert_array_equal(event.P_p, np.eye(3))
        assert event.P_psi is None

    @pytest.mark.parametrize(
        "q",
        [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0), (NAN, 0.0, 0.0, 1.0), (0.0, INF, 0.0, 1.0)],
    )
    def test_bad_quaternion(self, q):
        message = odometry_message(q=q)
        assert reason_of(messages.initial, message, ENU, once=False) == "bad_quaternion"

    def test_a_position_too_far_from_the_origin_is_refused_by_its_distance(self):
        with pytest.raises(RejectedMessage, match=r"out_of_range: .* 2000 km .* at most 1000 km"):
            messages.initial(odometry_message(p=(-1.6e6, 1.2e6, 0.0)), ENU, once=False)
        near = messages.initial(odometry_message(p=(6e5, -7.9e5, 0.0)), ENU, once=False)
        np.testing.assert_allclose(near.p_o, [-7.9e5, 6e5, 0.0])

    def test_bad_covariance(self):
        message = odometry_message(P=np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1.0]))
        assert reason_of(messages.initial, message, ENU, once=False) == "bad_covariance"


class TestOrigin:
    def test_radians_and_metres(self):
        event = messages.origin(fix_message(), 9.0)
        assert (event.lat, event.lon, event.h) == (np.radians(32.0), np.radians(34.0), -5.0)

    @pytest.mark.parametrize(
        ("changes", "reason"),
        [
            ({"status": -1}, "no_data"),
            ({"latitude": NAN}, "not_finite"),
            ({"longitude": NAN}, "not_finite"),
            ({"altitude": INF}, "not_finite"),
            ({"altitude": -INF}, "not_finite"),
            ({"latitude": 90.1}, "out_of_range"),
            ({"latitude": 90.0}, "out_of_range"),
            ({"latitude": -89.6}, "out_of_range"),
            ({"latitude": -91.0}, "out_of_range"),
        ],
    )
    def test_refused(self, changes, reason):
        assert reason_of(messages.origin, fix_message(**changes), 9.0) == reason


def oriented(covariance, q=(0.0, 0.0, 0.34289781, 0.93937271)):
    message = imu_message()
    message.orientation = Message(x=q[0], y=q[1], z=q[2], w=q[3])
    message.orientation_covariance = flat(covariance)
    return message


def test_a_measured_orientation_is_one_in_the_core_s_axes():
    """A yaw of 0.7 rad from east, counter-clockwise, is a heading of 90 deg less 0.7 rad."""
    event = messages.orientation(oriented(np.diag([0.01, 0.01, 0.04])), ENU, 0.0)
    assert event.heading_std == pytest.approx(0.2)
    heading = np.arctan2(event.C_n_i[1, 0], event.C_n_i[0, 0])
    assert heading == pytest.approx(np.pi / 2 - 0.7)
    assert event.C_n_i[2, 2] == pytest.approx(1.0)


@pytest.mark.parametrize(
    "message",
    [
        oriented(np.diag([-1.0, 0.0, 0.0])),  # REP-145: not measured
        oriented(np.zeros((3, 3))),  # unknown
        oriented(np.diag([0.01, 0.01, 100.0])),  # tilt only
        oriented(np.diag([0.01, 0.01, NAN])),
        oriented(np.diag([0.01, 0.01, 0.04]), q=(0.0, 0.0, 0.0, 0.0)),
        oriented(np.diag([0.01, 0.01, 0.04]), q=(NAN, 0.0, 0.0, 1.0)),
    ],
)
def test_an_orientation_that_tells_no_heading_is_none(message):
    assert messages.orientation(message, ENU, 0.0) is None


def test_told_to_use_it_an_unknown_covariance_takes_the_parameter():
    event = messages.orientation(oriented(np.zeros((3, 3))), ENU, 0.05)
    assert event.heading_std == pytest.approx(0.05)
