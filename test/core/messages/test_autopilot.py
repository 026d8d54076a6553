"""What an autopilot gets of our odometry through MAVROS' plugin `odometry`.

The plugin turns both poses by the static transforms <frame>_ned and <child>_frd, the covariances in
blocks of three, and sends the upper triangles. The same is done here, with a message filled as the
node fills it (docs/how-to/autopilot.md).
"""

from typing import Any

import numpy as np
import pytest
from compass import compass, with_compass
from scipy.spatial.transform import Rotation

from insdvl.messages.make import fill_odometry
from insdvl.navigation.events import Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.odometry import odometry
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.base import new_message

#: What MAVROS publishes: odom_ned <- odom and base_link_frd <- base_link.
NED = Rotation.from_euler("xyz", [np.pi, 0.0, np.pi / 2]).as_matrix()
FRD = Rotation.from_euler("xyz", [np.pi, 0.0, 0.0]).as_matrix()
RPY, P_NED, V_FRD = (0.1, -0.3, 2.0), (30.0, -20.0, 6.0), (1.2, 0.1, -0.2)


@pytest.fixture(scope="module")
def message() -> Any:
    """Of a state that a heading has corrected, so that odom is not map."""
    filter_ = Filter(with_compass(FilterParameters()))
    state = filter_.empty()
    C = Rotation.from_euler("xyz", RPY).as_matrix()
    initial = Initial(
        10**9,
        C,
        np.array(P_NED),
        np.array(V_FRD),
        "body",
        P_v=np.diag([0.01, 0.04, 0.09]),
        P_psi=np.diag([1e-4, 2e-4, 3e-2]),
        P_p=np.diag([1.0, 4.0, 9.0]),
    )
    filter_.initialise(state, initial, 10**9, np.array([0.01, 0.02, 0.03]))
    assert filter_.update(state, compass(10**9, RPY[2] + 0.2, 0.05), np.zeros(3), 1.0).accepted
    o = odometry(filter_, state, 0)
    assert abs(o.map_to_odom[3]) > 0.1
    made = new_message("nav_msgs/msg/Odometry")
    made.header.frame_id, made.child_frame_id = FilterParameters().odom_frame, "base_link"
    pose = o.in_odom
    fill_odometry(
        made,
        o.stamp_ns,
        pose.position,
        pose.quaternion_xyzw,
        o.twist_linear,
        o.twist_angular,
        pose.covariance,
        o.twist_covariance,
    )
    return made


def vector(field: Any) -> np.ndarray:
    return np.array([field.x, field.y, field.z])


def turned(flat: Any, R: np.ndarray) -> np.ndarray:
    blocks = np.kron(np.eye(2), R)
    return blocks @ np.asarray(flat).reshape(6, 6) @ blocks.T


def test_the_frames_are_those_that_mavros_knows(message: Any) -> None:
    """It publishes odom -> odom_ned and base_link -> base_link_frd itself."""
    assert message.header.frame_id == "odom" and message.child_frame_id == "base_link"


def test_the_pose_is_north_east_down_of_forward_right_down(message: Any) -> None:
    q = message.pose.pose.orientation
    C = NED @ Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix() @ FRD.T
    np.testing.assert_allclose(NED @ vector(message.pose.pose.position), P_NED, atol=1e-6)
    # Yaw is that of odom, which the heading has not moved; roll and pitch are the estimate's.
    yaw, pitch, roll = Rotation.from_matrix(C).as_euler("ZYX")
    assert yaw == pytest.approx(RPY[2], abs=1e-5)
    assert (roll, pitch) == pytest.approx(RPY[:2], abs=0.02)


def test_the_twist_is_forward_right_down(message: Any) -> None:
    np.testing.assert_allclose(FRD @ vector(message.twist.twist.linear), V_FRD, atol=0.02)
    np.testing.assert_allclose(
        FRD @ vector(message.twist.twist.angular), [0.01, 0.02, 0.03], atol=2e-4
    )


def test_both_covariances_are_filled_and_in_the_order_of_mavlink(message: Any) -> None:
    """x, y, z, then rotations about the frame's axes; velocity in body axes, then turn rate."""
    pose = turned(message.pose.covariance, NED)
    np.testing.assert_allclose(np.diag(pose)[:3], [1.0, 4.0, 9.0], rtol=1e-3)
    np.testing.assert_allclose(np.diag(pose)[3:], [1e-4, 2e-4, 3e-2], rtol=0.1)
    twist = turned(message.twist.covariance, FRD)
    np.testing.assert_allclose(np.diag(twist)[:3], [0.01, 0.04, 0.09], rtol=0.05)
    for P in (pose, twist):
        upper = P[np.triu_indices(6)]
        assert len(upper) == 21 and np.isfinite(upper).all() and upper[0] > 0.0
        assert np.linalg.eigvalsh(P)[0] > 0.0
