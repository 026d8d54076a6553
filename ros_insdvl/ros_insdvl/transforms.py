"""What goes to /tf: odom -> base_link and, where there is a map, map -> odom."""

from math import cos, sin
from typing import Any

from geometry_msgs.msg import TransformStamped

from insdvl.messages.make import fill_transform
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import FilterParameters


class Transforms:
    """Fills one message of /tf, again and again: it is serialised when it is sent.

    Args:
        message_type: tf2_msgs/TFMessage.
        parameters: Of the filter.
        has_map: Whether there is a map.
    """

    def __init__(
        self, message_type: type[Any], parameters: FilterParameters, *, has_map: bool
    ) -> None:
        self._of_base = TransformStamped(child_frame_id=parameters.base_frame)
        self._of_base.header.frame_id = parameters.odom_frame
        self._of_odom = TransformStamped(child_frame_id=parameters.odom_frame)
        self._of_odom.header.frame_id = parameters.map_frame
        self._message = message_type()
        self._message.transforms = [self._of_base, *([self._of_odom] if has_map else [])]

    def of(self, output: Odometry) -> Any:
        """The message of an output."""
        pose, stamp_ns = output.in_odom, output.stamp_ns
        fill_transform(self._of_base, stamp_ns, pose.position, pose.quaternion_xyzw)
        half = output.map_to_odom[3] / 2.0
        turn = (0.0, 0.0, sin(half), cos(half))
        fill_transform(self._of_odom, stamp_ns, output.map_to_odom[:3], turn)
        return self._message
