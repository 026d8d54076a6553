"""What goes to /tf: odom -> base_link and, where there is a map, map -> odom."""

from collections.abc import Callable
from math import cos, sin
from typing import Any

from insdvl.messages.make import fill_transform
from insdvl.navigation.odometry import Odometry
from insdvl.navigation.parameters import FilterParameters

#: Topics of transforms, their type, and that of its elements.
TF, TF_STATIC = "/tf", "/tf_static"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
TRANSFORM = "geometry_msgs/msg/TransformStamped"


class Transforms:
    """Fills one message of /tf, again and again: it is serialised when it is sent.

    Args:
        new: Makes a message of a type, ``package/msg/Name``.
        parameters: Of the filter.
        has_map: Whether there is a map.
    """

    def __init__(
        self, new: Callable[[str], Any], parameters: FilterParameters, *, has_map: bool
    ) -> None:
        def transform(parent: str, child: str) -> Any:
            stamped = new(TRANSFORM)
            stamped.header.frame_id, stamped.child_frame_id = parent, child
            return stamped

        self._of_base = transform(parameters.odom_frame, parameters.base_frame)
        self._of_odom = transform(parameters.map_frame, parameters.odom_frame)
        self._message = new(TF_MESSAGE)
        self._message.transforms = [self._of_base, *([self._of_odom] if has_map else [])]

    def of(self, output: Odometry) -> Any:
        """The message of an output."""
        pose, stamp_ns = output.in_odom, output.stamp_ns
        fill_transform(self._of_base, stamp_ns, pose.position, pose.quaternion_xyzw)
        half = output.map_to_odom[3] / 2.0
        turn = (0.0, 0.0, sin(half), cos(half))
        fill_transform(self._of_odom, stamp_ns, output.map_to_odom[:3], turn)
        return self._message
