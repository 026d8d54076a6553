"""Messages of rclpy as sensors send them, in forward-left-up and ENU."""

from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

from insdvl.messages.convert import stamp_ns
from insdvl.messages.make import set_quaternion, set_vector
from insdvl.messages.topics import DVL, IMU
from insdvl.navigation.events import NS
from insdvl.simulation.messages import StreamFormat, dvl_messages, imu_messages
from insdvl.simulation.mission import Mission
from ros_insdvl.conversions import time_of

STEP_NS = NS // 100


def stamp_of(message: Any) -> int:
    return stamp_ns(message.header)


def imu_message(stamp: int, f_b: Any = (0.0, 0.0, 9.8), w_ib_b: Any = (0.0, 0.0, 0.0)) -> Imu:
    message = Imu()
    message.header.stamp = time_of(stamp)
    message.header.frame_id = "imu_link"
    set_vector(message.linear_acceleration, f_b)
    set_vector(message.angular_velocity, w_ib_b)
    return message


def sample_at_rest(start_ns: int, k: int) -> Imu:
    """The k-th sample of a vehicle at rest; no channel is frozen."""
    noise = k % 2 * 1e-7
    return imu_message(start_ns + k * STEP_NS, (noise, noise, 9.8 + noise), (noise, noise, noise))


def dvl_message(stamp: int, v_d: Any = (0.0, 0.0, 0.0)) -> TwistStamped:
    message = TwistStamped()
    message.header.stamp = time_of(stamp)
    message.header.frame_id = "dvl_link"
    set_vector(message.twist.linear, v_d)
    return message


def odometry_message(stamp: int, position: Any = (0.0, 0.0, 0.0)) -> Odometry:
    """At a position, level, heading west, 1 m/s forward."""
    message = Odometry(child_frame_id="base_link")
    message.header.stamp = time_of(stamp)
    message.header.frame_id = "odom"
    set_vector(message.pose.pose.position, position)
    set_quaternion(message.pose.pose.orientation, (0.0, 0.0, 1.0, 0.0))
    set_vector(message.twist.twist.linear, (1.0, 0.0, 0.0))
    return message


def sensor_messages(m: Mission, dvl_shift_ns: int = 0) -> list[tuple[int, str, Any]]:
    """Stamps, topics and messages of a mission's IMU and DVL."""
    kinds = {IMU: Imu, DVL: TwistStamped}

    def new(topic: str) -> Any:
        return kinds[topic]()

    shifted = StreamFormat(start_ns=dvl_shift_ns)
    return [*imu_messages(m, new), *dvl_messages(m, new, shifted)]
