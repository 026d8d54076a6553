"""Where the sensors are on the vehicle, from /tf_static by the frame_id of their messages.

The transforms of /tf_static make a tree of frames. From base_link to the frame of a sensor they
compose to the sensor's mount and lever arm, in the convention of the parameters: those take the
rotation from the sensor's axes to base_link's, and its position in base_link, in the axes that the
frames have (frame_convention).

The frame of a DVL has the axes in which its messages are. Those of a driver's own type may look
down with z where frame_convention looks up; `dvl.mount` does not count that as a turn, so it is
taken off.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.convert import RejectedMessage
from insdvl.messages.drivers import DRIVERS, Axes, axes_of
from insdvl.messages.dvl import body_axes
from insdvl.messages.topics import IMU, Topic
from insdvl.messages.transforms import TF_STATIC
from insdvl.navigation.geometry.frames import (
    CONVENTIONS,
    rotation_from_quaternion,
    rpy_from_rotation,
)
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, build, flatten


class FrameError(ValueError):
    """Frames are not connected; the message names the one that is missing."""


@dataclass(frozen=True)
class Transform:
    """Pose of a frame in another one: x_there = R x + t.

    Attributes:
        R: (3, 3) rotation from the frame's axes.
        t: (3,) position of its origin [m].
    """

    R: Array
    t: Array

    def of(self, inner: "Transform") -> "Transform":
        """The pose of a frame that has the pose ``inner`` in this one."""
        return Transform(self.R @ inner.R, self.R @ inner.t + self.t)

    def inverse(self) -> "Transform":
        """The pose of the other frame in this one."""
        return Transform(self.R.T, -self.R.T @ self.t)


_SAME = Transform(np.eye(3), np.zeros(3))


class FrameTree:
    """The frames of /tf_static."""

    def __init__(self) -> None:
        self._in_parent: dict[str, tuple[str, Transform]] = {}

    def add(self, message: Any) -> None:
        """Take the transforms of a tf2_msgs/TFMessage; the last one of a frame counts.

        Raises:
            RejectedMessage: ``not_finite``, or ``bad_quaternion``; nothing of the message is taken.
        """
        taken = {}
        for stamped in message.transforms:
            child, parent = _name(stamped.child_frame_id), _name(stamped.header.frame_id)
            taken[child] = parent, _transform(stamped.transform, f"{parent} -> {child}")
        self._in_parent.update(taken)

    def pose(self, base: str, frame: str) -> Transform:
        """The pose of a frame in another one.

        Raises:
            FrameError: They are not connected.
        """
        base, frame = _name(base), _name(frame)
        above = dict(self._above(base))
        for name, transform in self._above(frame):
            if name in above:
                return above[name].inverse().of(transform)
        parents = {parent for parent, _ in self._in_parent.values()}
        for name in (frame, base):
            if name not in self._in_parent and name not in parents:
                raise FrameError(f"{TF_STATIC} has no frame '{name}'")
        tops = (list(self._above(name))[-1][0] for name in (frame, base))
        raise FrameError(
            f"{TF_STATIC} does not connect '{frame}', which is below '{next(tops)}', with "
            f"'{base}', which is below '{next(tops)}'"
        )

    def _above(self, frame: str) -> Iterator[tuple[str, Transform]]:
        """A frame and those above it, with its pose in each.

        Raises:
            FrameError: It is above itself.
        """
        name, transform, seen = frame, _SAME, {frame}
        yield name, transform
        while name in self._in_parent:
            name, step = self._in_parent[name]
            if name in seen:
                raise FrameError(f"the frames of {TF_STATIC} go round in a circle at '{name}'")
            seen.add(name)
            transform = step.of(transform)
            yield name, transform


def _name(frame: str) -> str:
    """Without the slash that old drivers write before a frame."""
    return str(frame).lstrip("/")


def _transform(message: Any, what: str) -> Transform:
    t, q = message.translation, message.rotation
    position = np.array([t.x, t.y, t.z], dtype=float)
    q_xyzw = np.array([q.x, q.y, q.z, q.w], dtype=float)
    if not (np.isfinite(position).all() and np.isfinite(q_xyzw).all()):
        raise RejectedMessage("not_finite", f"transform {what} is {position} {q_xyzw}")
    if not abs(np.hypot.reduce(q_xyzw) - 1.0) < 1e-2:
        raise RejectedMessage("bad_quaternion", f"rotation of {what} is {q_xyzw.tolist()}")
    return Transform(rotation_from_quaternion(q_xyzw), position)


class Extrinsics:
    """Collects what ``extrinsics: tf`` needs: the transforms, and the frame_id of each sensor.

    Args:
        parameters: Of the filter.
        topics: That it takes, by their names.
    """

    def __init__(self, parameters: FilterParameters, topics: Mapping[str, Topic]) -> None:
        self._parameters = parameters
        self._tree = FrameTree()
        #: Topics of each sensor that has a place on the vehicle, by its group of parameters.
        self._topics: dict[str, list[str]] = {}
        for name, topic in topics.items():
            group = "imu" if topic.name == IMU else topic.measurement
            if group and _places(getattr(parameters, group)):
                self._topics.setdefault(group, []).append(name)
        told = ((g, getattr(getattr(parameters, g), "frame_id", "")) for g in self._topics)
        self._frame_ids = {group: frame_id for group, frame_id in told if frame_id}
        #: Why the messages of a sensor have not told its frame, by its group.
        self._silent: dict[str, str] = {}
        kind = parameters.dvl.type
        #: Axes of the DVL's messages, None until one is there.
        self._dvl_axes: Axes | None = None if kind == "auto" else DRIVERS[kind].axes

    def hear(self, topic: str, message: Any) -> None:
        """A sensor's message tells its frame, where the parameters do not.

        That of a pose or of an attitude is the frame in which it is told: there the parameters say
        where the sensor is.
        """
        for group in [group for group, topics in self._topics.items() if topic in topics]:
            if group == Dvl.name and self._dvl_axes is None:
                self._dvl_axes = axes_of(message)
            if hasattr(message, "child_frame_id"):
                self._tell(group, "child_frame_id", message.child_frame_id)
            elif hasattr(message, "pose") or hasattr(message, "quaternion"):
                del self._topics[group]
            elif hasattr(message, "header"):
                self._tell(group, "frame_id", message.header.frame_id)
            else:
                self._silent[group] = f"its messages have no frame: set {group}.frame_id"

    def _tell(self, group: str, name: str, frame_id: Any) -> None:
        """A message of a sensor has a frame, which may be empty."""
        if frame_id:
            self._frame_ids.setdefault(group, str(frame_id))
        else:
            self._silent[group] = f"the {name} of its messages is empty: its driver must set it"

    def add(self, message: Any) -> None:
        """Take the transforms of a tf2_msgs/TFMessage.

        Raises:
            RejectedMessage: See `FrameTree.add`.
        """
        self._tree.add(message)

    def missing(self) -> list[str]:
        """What is not known yet, or out of range, a sentence each; empty where all is well."""
        sentences = []
        for group, topics in self._topics.items():
            frame_id = self._frame_ids.get(group)
            if frame_id is None and group in self._silent:
                sentences.append(f"{group}: {self._silent[group]}")
                continue
            if frame_id is None:
                sentences.append(
                    f"no message on {' or '.join(topics)}, which tells the sensor's frame (or set "
                    f"{group}.frame_id)"
                )
                continue
            if group == Dvl.name and self._dvl_axes is None:
                sentences.append(
                    f"no message on {' or '.join(topics)}, whose type tells the axes of the "
                    "sensor's frame (or set dvl.type)"
                )
            try:
                self._tree.pose(self._parameters.base_frame, frame_id)
            except FrameError as error:
                sentences.append(f"{group}: {error}")
        if not sentences:
            try:
                self.applied(self._parameters)
            except ParameterError as error:
                sentences.append(str(error))
        return sentences

    def found(self) -> dict[str, tuple[float, ...]]:
        """Values of the parameters ``*.mount`` and ``*.lever_arm``.

        Raises:
            FrameError: Something is missing.
        """
        values: dict[str, tuple[float, ...]] = {}
        for group in self._topics:
            if group not in self._frame_ids:
                raise FrameError(f"no message has told the frame of {group}")
            pose = self._tree.pose(self._parameters.base_frame, self._frame_ids[group])
            told = {"mount": rpy_from_rotation(pose.R @ self._axes(group)), "lever_arm": pose.t}
            for name in _places(getattr(self._parameters, group)):
                values[f"{group}.{name}"] = tuple(told[name].tolist())
        return values

    def _axes(self, group: str) -> Array:
        """Rotation (3, 3) to the axes of a sensor's frame from those that its mount has."""
        convention = CONVENTIONS[self._parameters.frame_convention]
        if group != Dvl.name or self._dvl_axes is None:
            return np.eye(3)
        return body_axes(self._dvl_axes, convention) @ convention.body

    def applied(self, parameters: FilterParameters) -> FilterParameters:
        """Parameters with what was found.

        Args:
            parameters: Those of the filter, whose settings may have changed since.

        Raises:
            FrameError: Something is missing.
            ParameterError: A value is out of range.
        """
        return build(FilterParameters, flatten(parameters) | self.found())

    @property
    def text(self) -> str:
        """One line: what was found, from which frames."""
        parts = []
        for name, value in self.found().items():
            group = name.split(".")[0]
            numbers = ", ".join(f"{x:.4g}" for x in value)
            parts.append(f"{name} [{numbers}] from '{self._frame_ids[group]}'")
        return "; ".join(parts)


def _places(group: Any) -> list[str]:
    """The parameters of a sensor's group that say where it is."""
    names = {item.name for item in dataclasses.fields(group)}
    return [name for name in ("mount", "lever_arm") if name in names]
