"""The filter's inputs: which events a message on each topic of the table becomes.

The filter node and `insdvl replay` read their messages through this, so both fold the same events.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from insdvl.messages import convert
from insdvl.messages.cdr.imu_bytes import ImuColumns
from insdvl.messages.convert import ImuSamples, RejectedMessage
from insdvl.messages.topics import Topic, ZeroStamp, orientation_sigma, taken
from insdvl.navigation.events import NS, Event, Imu, Measurement, Orientation
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state.fields import NEVER
from insdvl.parameters.declaration import check_map
from insdvl.timeline.fold import Fold


def frame_id_of(message: Any) -> str:
    """The frame of a sensor that has sent a message; empty for one without a header.

    Of an odometry it is the child_frame_id: its twist is in those axes.
    """
    if hasattr(message, "child_frame_id"):
        return str(message.child_frame_id)
    return str(message.header.frame_id) if hasattr(message, "header") else ""


class Inputs:
    """Messages to events, as the filter's parameters ask.

    Attributes:
        topics: The topics that are taken, by their names.
        required: Topics without which there is no result, and why.
        initial_topic: Topic of the initial state with ``initial.mode: topic``, else None.
        frame_ids: The last frame_id of each topic.
        frame_changes: How often the frame_id of each topic has changed.
        initial_done: Whether no further message of the initial topic, and no orientation, can
            start the filter.
    """

    def __init__(self, parameters: FilterParameters, *, has_map: bool = False) -> None:
        """Look up the topics of these parameters.

        Args:
            parameters: Of the filter.
            has_map: Whether an input is absolute: then a pose that is told is in map, not in odom.

        Raises:
            ParameterError: Two parameters name one topic, or map one of the other frames.
        """
        self._parameters = parameters
        self._renamed = {"odom_frame": "map_frame"} if has_map else {}
        if has_map:
            check_map(parameters.map_frame, parameters.odom_frame, parameters.base_frame)
        self._max_delay_ns = round(parameters.max_delay * NS)
        self._jump_limit_ns = round(parameters.jump_limit * NS)
        self.frame_ids: dict[str, str] = {}
        self.frame_changes: Counter[str] = Counter()
        self.topics: dict[str, Topic] = taken(parameters)
        reasons = {name: topic.required(parameters) for name, topic in self.topics.items()}
        self.required = {name: reason for name, reason in reasons.items() if reason}
        first = [name for name, topic in self.topics.items() if topic.until_started]
        self.initial_topic: str | None = first[0] if first else None
        self._frames = {name: self._expected(topic) for name, topic in self.topics.items()}
        self._offsets_ns = {name: self._offset_ns(topic) for name, topic in self.topics.items()}
        self.reset()

    @property
    def measured(self) -> dict[str, list[str]]:
        """The kinds of measurements that are taken, each with its topics."""
        found: dict[str, list[str]] = {}
        for name, topic in self.topics.items():
            if topic.measurement:
                found.setdefault(topic.measurement, []).append(name)
        return found

    def _expected(self, topic: Topic) -> list[tuple[str, Callable[[Any], Any], str]]:
        """Name and getter of each frame field that must have a value, and that value."""
        fields: list[tuple[str, Callable[[Any], Any], str]] = []
        for name, parameter in topic.frames.items():
            parameter = self._renamed.get(parameter, parameter)
            if expected := str(attrgetter(parameter)(self._parameters)):
                fields.append((name.split(".")[-1], attrgetter(name), expected))
        return fields

    def _offset_ns(self, topic: Topic) -> int:
        """What is added to the stamps of a topic [ns]."""
        if not topic.time_offset:
            return 0
        return round(attrgetter(topic.time_offset)(self._parameters) * NS)

    def reset(self) -> None:
        """Take messages of the initial topic again."""
        self.initial_done = False
        self._initial_until_ns: int | None = None
        self._unstamped: Event | None = None  # waits for the stamp of the first sample

    def events(self, topic: str, message: Any, fold: Fold) -> Iterator[Event]:
        """The events of a message.

        Args:
            topic: One of `topics`.
            message: Of one of the topic's types.
            fold: Takes each event before the next one is requested; its newest sample has the stamp
                of a set_odometry that has none.

        Raises:
            RejectedMessage: The message cannot be used.
        """
        row, newest_ns = self.topics[topic], fold.newest_ns
        self._check_frame(topic, row, message)
        if row.until_started and self._is_initial_done(fold):
            return
        for converted in row.convert(message, self._parameters):
            if isinstance(converted, Orientation) and self._is_initial_done(fold):
                continue
            event = self._with_stamp(converted, row.zero_stamp, newest_ns)
            if event is not None and not hasattr(message, "header"):
                self._check_clock(event, newest_ns)
            if event is not None:
                event = self._in_time(event, topic)
            if event is None:
                continue
            yield event
            if self._unstamped is not None and isinstance(event, Imu):
                yield replace(self._unstamped, stamp_ns=event.stamp_ns)
                self._unstamped = None

    def imu_samples(self, topic: str, messages: ImuColumns) -> ImuSamples:
        """Many messages of the IMU, as `events` converts each of them."""
        parameters, offset_ns = self._parameters, self._offsets_ns[topic]
        convention = CONVENTIONS[parameters.frame_convention]
        samples = convert.imu_samples(messages, convention, orientation_sigma(parameters))
        stamps_ns = samples.stamps_ns + offset_ns
        return samples._replace(stamps_ns=stamps_ns, usable=samples.usable & (stamps_ns >= 0))

    def sample_count(self, topic: str, samples: ImuSamples, part: slice, fold: Fold) -> int:
        """How many of the first of some messages of the IMU are samples for `events` and no more.

        None are before the first message, after a change of the frame_id, or while a message may
        hold other events as well.

        Args:
            topic: Of the IMU.
            samples: Of messages of that topic.
            part: Which of them follow.
            fold: See `events`.
        """
        row, parameters, frame_id = self.topics[topic], self._parameters, self.frame_ids.get(topic)
        if row.measurement or parameters.process_noise.source == "message":
            return 0
        if self._unstamped is not None or frame_id not in samples.frame_ids:
            return 0
        if any(expected != frame_id for _, _, expected in self._frames[topic]):
            return 0
        fit = samples.usable[part] & (samples.frames[part] == samples.frame_ids[frame_id])
        if parameters.initial.takes_orientation:
            self._take_again(fold)
            if not self.initial_done:
                fit &= ~samples.oriented[part]
        return len(fit) if fit.all() else int(np.argmin(fit))

    def _is_initial_done(self, fold: Fold) -> bool:
        """Decide `initial_done`: the fold has started, and max_delay has passed since.

        Until then a message with an earlier stamp may still arrive, and would be the first.
        """
        self._take_again(fold)
        if not self.initial_done and fold.latest is not None:
            if self._initial_until_ns is None:
                self._initial_until_ns = fold.newest_ns + self._max_delay_ns
            self.initial_done = fold.newest_ns > self._initial_until_ns
        return self.initial_done

    def _take_again(self, fold: Fold) -> None:
        """What starts a filter also starts one that has given up its state."""
        if self.initial_done and fold.latest is None:
            self.reset()

    def _with_stamp(self, event: Event, zero_stamp: ZeroStamp, newest_ns: int) -> Event | None:
        """The event, with a stamp where zero means none; None while it waits for a sample's.

        Raises:
            RejectedMessage: ``no_stamp``: zero is the beginning of time, and that is long past; or
                a measurement has the stamp of the newest sample, and there is none.
        """
        if event.stamp_ns > 0 or zero_stamp is ZeroStamp.UNSET:
            return event
        if zero_stamp is ZeroStamp.BEGINNING:
            if newest_ns > self._jump_limit_ns:
                raise RejectedMessage("no_stamp", "stamp is 0")
            return event
        if newest_ns != NEVER:
            return replace(event, stamp_ns=newest_ns + event.stamp_ns)
        if isinstance(event, Measurement):
            raise RejectedMessage("no_stamp", "no IMU sample has arrived whose stamp it could have")
        self._unstamped = event
        return None

    def _check_clock(self, event: Event, newest_ns: int) -> None:
        """Refuse a time of a device, which is not that of a header, unless it is the IMU's.

        Raises:
            RejectedMessage: ``no_stamp``.
        """
        if newest_ns != NEVER and abs(event.stamp_ns - newest_ns) > self._max_delay_ns:
            raise RejectedMessage(
                "no_stamp",
                f"the device's time is {(event.stamp_ns - newest_ns) / NS:.3f} s from the newest "
                "IMU sample's: set its clock, or take the time of arrival (dvl.stamp)",
            )

    def _in_time(self, event: Event, topic: str) -> Event:
        """The event at the time at which it was valid, by the topic's time offset.

        Raises:
            RejectedMessage: ``bad_stamp``: that is before the beginning of time.
        """
        offset_ns = self._offsets_ns[topic]
        if not offset_ns or event.stamp_ns == 0:  # the beginning of time stays where it is
            return event
        stamp_ns = event.stamp_ns + offset_ns
        if stamp_ns < 0:
            parameter = self.topics[topic].time_offset
            raise RejectedMessage("bad_stamp", f"stamp with {parameter} is {stamp_ns / NS:g} s")
        return replace(event, stamp_ns=stamp_ns)

    def _check_frame(self, topic: str, row: Topic, message: Any) -> None:
        """Refuse a frame that is not the expected one; count changes of the frame_id.

        A message without a header has no frame.

        Raises:
            RejectedMessage: ``wrong_frame``.
        """
        if not hasattr(message, "header"):
            return
        of_odometry = row.measurement and hasattr(message, "child_frame_id")
        for name, get, expected in self._frames[topic]:
            found = str(get(message))
            if of_odometry:
                name, found = "child_frame_id", frame_id_of(message)
            if found != expected and (found or not row.command):
                raise RejectedMessage("wrong_frame", f"{name} is {found!r}, not {expected!r}")
        frame_id = frame_id_of(message) if of_odometry else str(message.header.frame_id)
        if self.frame_ids.setdefault(topic, frame_id) != frame_id:
            self.frame_ids[topic] = frame_id
            self.frame_changes[topic] += 1
