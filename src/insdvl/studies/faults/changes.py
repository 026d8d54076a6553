"""Faults as changes of a stream of messages.

Each function makes a change, ``change(stream, rng) -> stream``, and marks messages that are no
longer valid. Times are seconds from the start of the mission.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.topics import DVL, DVL_WITH_COVARIANCE, IMU
from insdvl.navigation.events import NS
from insdvl.recordings.messages import twist_message
from insdvl.studies.faults.link import RelayParameters, links
from insdvl.studies.faults.stream import Arrival, Epoch, Stream

Change = Callable[[Stream, np.random.Generator], Stream]
Edit = Callable[[Any], Any]

#: Fields of the two vectors of an Imu.
FORCE, RATE = "linear_acceleration", "angular_velocity"


# ---------------------------------------------------------------- messages


def stamped(sec: int, nanosec: int) -> Edit:
    """Set the stamp of a message, to a valid one or not."""

    def edit(message: Any) -> Any:
        stamp = replace(message.header.stamp, sec=sec, nanosec=nanosec)
        return replace(message, header=replace(message.header, stamp=stamp))

    return edit


def shifted(shift_ns: int) -> Edit:
    """Move the stamp of a message [ns]."""

    def edit(message: Any) -> Any:
        return stamped(*divmod(_stamp_ns(message) + shift_ns, NS))(message)

    return edit


def framed(frame_id: str) -> Edit:
    """Set the frame_id of a message."""
    return lambda message: replace(message, header=replace(message.header, frame_id=frame_id))


def triad(name: str, change: Callable[[Array], Array]) -> Edit:
    """Change one of the vectors (3,) of an Imu."""

    def edit(message: Any) -> Any:
        return replace(message, **{name: _changed_vector(getattr(message, name), change)})

    return edit


def both(first: Edit, second: Edit) -> Edit:
    """Two edits of one message."""
    return lambda message: second(first(message))


def velocity(change: Callable[[Array], Array]) -> Edit:
    """Change the linear velocity (3,) of a TwistStamped."""

    def edit(message: Any) -> Any:
        linear = _changed_vector(message.twist.linear, change)
        return replace(message, twist=replace(message.twist, linear=linear))

    return edit


def pressure(change: Callable[[float], float]) -> Edit:
    """Change the pressure [Pa] of a FluidPressure."""
    return lambda message: replace(message, fluid_pressure=change(message.fluid_pressure))


def orientation(change: Callable[[Array], Array]) -> Edit:
    """Change the quaternion (4,), x, y, z, w, of an Imu."""

    def edit(message: Any) -> Any:
        q = message.orientation
        x, y, z, w = change(np.array([q.x, q.y, q.z, q.w])).tolist()
        return replace(message, orientation=replace(q, x=x, y=y, z=z, w=w))

    return edit


def covariance(Q: Array) -> Edit:
    """Set both covariances (3, 3) of an Imu."""
    fields = {f"{name}_covariance": Q.ravel() for name in (FORCE, RATE)}
    return lambda message: replace(message, **fields)


def axis(k: int, value: float) -> Callable[[Array], Array]:
    """Set component k of a vector."""

    def change(vector: Array) -> Array:
        vector[k] = value
        return vector

    return change


# ---------------------------------------------------------------- changes


def unchanged(stream: Stream, rng: np.random.Generator) -> Stream:
    """No fault."""
    return stream


def edited(
    topic: str, begin: float, end: float, edit: Edit, *, share: float = 1.0, valid: bool = False
) -> Change:
    """Change the messages of a topic within [begin, end), all of them or a random share."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        def each(arrival: Arrival) -> Iterator[Arrival]:
            inside = _inside(stream, arrival, topic, begin, end)
            if inside and (share == 1.0 or rng.random() < share):
                arrival = arrival._replace(message=edit(arrival.message), valid=valid)
            yield arrival

        return stream.changed(each)

    return change


def added(
    topic: str,
    begin: float,
    end: float,
    edit: Edit,
    *,
    share: float = 1.0,
    onto: str | None = None,
    first: bool = False,
) -> Change:
    """Add a changed copy, which is not valid, to messages of a topic within [begin, end).

    Args:
        topic: Topic of the messages.
        begin: [s].
        end: [s].
        edit: Changes the copy.
        share: Share of the messages that are copied, at random.
        onto: Topic of the copies, if it differs.
        first: Whether the copy arrives before the message.
    """

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        def each(arrival: Arrival) -> Iterator[Arrival]:
            inside = _inside(stream, arrival, topic, begin, end)
            if inside and (share == 1.0 or rng.random() < share):
                copy = Arrival(arrival.time_ns, onto or topic, edit(arrival.message), valid=False)
                yield from (copy, arrival) if first else (arrival, copy)
            else:
                yield arrival

        return stream.changed(each)

    return change


def dropped(topic: str, begin: float, end: float) -> Change:
    """Drop the messages of a topic within [begin, end)."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        return stream.changed(lambda a: () if _inside(stream, a, topic, begin, end) else (a,))

    return change


def held(topic: str, begin: float, end: float, count: int = 1) -> Change:
    """A sensor repeats its last messages before the fault within [begin, end), with new stamps.

    Args:
        topic: Topic of the messages.
        begin: [s].
        end: [s].
        count: How many messages it repeats, in turn.
    """

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        last: deque[Any] = deque(maxlen=count)

        def each(arrival: Arrival) -> Iterator[Arrival]:
            if _inside(stream, arrival, topic, begin, end):
                last.rotate(-1)
                stale = replace(last[-1], header=arrival.message.header)
                arrival = arrival._replace(message=stale, valid=False)
            elif arrival.topic == topic:
                last.append(arrival.message)
            yield arrival

        return stream.changed(each)

    return change


def frozen(name: str, k: int, begin: float, end: float) -> Change:
    """Component k of a vector of the IMU keeps its value within [begin, end)."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        inside = (a for a in stream.arrivals if _inside(stream, a, IMU, begin, end))
        field = getattr(next(inside).message, name)
        value = (field.x, field.y, field.z)[k]
        return edited(IMU, begin, end, triad(name, axis(k, value)), valid=True)(stream, rng)

    return change


def clipped(name: str, k: int, limit: float, begin: float, end: float, push: float) -> Change:
    """Component k of a vector of the IMU has an offset and saturates at plus or minus a limit."""

    def clip(vector: Array) -> Array:
        vector[k] = np.clip(vector[k] + push, -limit, limit)
        return vector

    return edited(IMU, begin, end, triad(name, clip), valid=True)


def outliers(begin: float, end: float, size: float) -> Change:
    """Each DVL velocity within [begin, end) has an error of this length and a random direction."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        def off(vector: Array) -> Array:
            direction = rng.standard_normal(3)
            return vector + size * direction / np.linalg.norm(direction)

        return edited(DVL, begin, end, velocity(off))(stream, rng)

    return change


def second_publisher(
    begin: float, end: float, delay: float, onto: str, decimals: int | None = None
) -> Change:
    """A second driver publishes each DVL measurement again.

    Args:
        begin: [s].
        end: [s].
        delay: How much later its stamps are [s].
        onto: Its topic, with or without a covariance.
        decimals: To how many decimals it rounds the velocity [m/s]; None for not at all.
    """

    def again(message: Any) -> Any:
        if decimals is not None:
            message = velocity(lambda v: v.round(decimals))(message)
        if onto == DVL_WITH_COVARIANCE:
            message = _with_covariance(message, 0.01 * np.eye(3))
        return shifted(round(delay * NS))(message)

    return added(DVL, begin, end, again, onto=onto)


def with_covariance(covariance: Array) -> Edit:
    """Give a TwistStamped a covariance field of any size."""

    def edit(message: Any) -> Any:
        made = _with_covariance(message, np.eye(3))
        return replace(made, twist=replace(made.twist, covariance=covariance))

    return edit


def alternating(topic: str, begin: float, end: float, *edits: Edit) -> Change:
    """Change the messages of a topic within [begin, end) by each edit in turn."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        turn = cycle(edits)
        return edited(topic, begin, end, lambda message: next(turn)(message))(stream, rng)

    return change


def told(begin: float, end: float, R: Array) -> Change:
    """The DVL's driver tells a covariance (3, 3) with each velocity within [begin, end)."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = R

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        edit = with_covariance(covariance.ravel())

        def each(arrival: Arrival) -> Iterator[Arrival]:
            if _inside(stream, arrival, DVL, begin, end):
                message = edit(arrival.message)
                arrival = arrival._replace(topic=DVL_WITH_COVARIANCE, message=message)
            yield arrival

        return stream.changed(each)

    return change


def late(topic: str, begin: float, end: float, delay: float, share: float) -> Change:
    """Delay a random share of the messages within [begin, end) by a time [s]."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        def each(arrival: Arrival) -> Iterator[Arrival]:
            if _inside(stream, arrival, topic, begin, end) and rng.random() < share:
                arrival = arrival._replace(time_ns=arrival.time_ns + round(delay * NS))
            yield arrival

        return stream.changed(each)

    return change


def invalid_when_late(topic: str, begin: float, end: float, delay: float, share: float) -> Change:
    """As `late`, by more than max_delay: the messages are no longer valid."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        moved = late(topic, begin, end, delay, share)(stream, rng)
        return moved.changed(
            lambda a: (
                (a._replace(valid=a.time_ns == _stamp_ns(a.message)),) if a.topic == topic else (a,)
            )
        )

    return change


def network(
    loss: float = 0.0, duplication: float = 0.0, delay: float = 0.0, jitter: float = 0.0
) -> Change:
    """All messages of the whole mission pass a bad link."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        topics = tuple(sorted({arrival.topic for arrival in stream.arrivals}))
        parameters = RelayParameters(
            topics=topics,
            loss=loss,
            duplication=duplication,
            delay=delay,
            jitter=jitter,
            seed=int(rng.integers(2**31)),
        )
        link = links(parameters)

        def each(arrival: Arrival) -> Iterator[Arrival]:
            for k, wait in enumerate(link[arrival.topic].delays()):
                time_ns = arrival.time_ns + round(wait * NS)
                yield arrival._replace(time_ns=time_ns, valid=k == 0)

        return stream.changed(each)

    return change


def clock_step(at: float, step: float) -> Change:
    """The clock of the stamps is set ahead (or back) by a step [s] at a time."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        step_ns, begin_ns = round(step * NS), stream.mission.start_ns + round(at * NS)

        def each(arrival: Arrival) -> Iterator[Arrival]:
            if arrival.time_ns >= begin_ns:
                arrival = arrival._replace(message=shifted(step_ns)(arrival.message))
            yield arrival

        moved = stream.changed(each)
        epoch = Epoch(begin_ns, stamp_ns=stream.epochs[-1].stamp_ns + step_ns)
        return replace(moved, epochs=(*stream.epochs, epoch))

    return change


def played_again(length: float) -> Change:
    """A recording of this length [s] is played twice."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        length_ns = round(length * NS)
        once = [a for a in stream.arrivals if stream.seconds(a) <= length]
        again = [a._replace(time_ns=a.time_ns + length_ns) for a in once]
        epoch = Epoch(stream.mission.start_ns + length_ns + 1, -length_ns, -length_ns)
        return replace(stream, arrivals=(*once, *again), epochs=(*stream.epochs, epoch))

    return change


def unpublished(begin: float, end: float, topics: Sequence[str]) -> Change:
    """No output is expected of messages of these topics that arrive within [begin, end)."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        def each(arrival: Arrival) -> Iterator[Arrival]:
            touched = any(_inside(stream, arrival, topic, begin, end) for topic in topics)
            yield arrival._replace(valid=arrival.valid and not touched)

        return stream.changed(each)

    return change


def all_of(*changes: Change) -> Change:
    """Several changes, one after the other."""

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        for each in changes:
            stream = each(stream, rng)
        return stream

    return change


def _inside(stream: Stream, arrival: Arrival, topic: str, begin: float, end: float) -> bool:
    return arrival.topic == topic and begin <= stream.seconds(arrival) < end


def _changed_vector(field: Any, change: Callable[[Array], Array]) -> Any:
    """A Vector3 with other numbers."""
    x, y, z = change(np.array([field.x, field.y, field.z])).tolist()
    return replace(field, x=x, y=y, z=z)


def _with_covariance(message: Any, R: Array) -> Any:
    """A TwistWithCovarianceStamped from a TwistStamped."""
    v = message.twist.linear
    return twist_message(_stamp_ns(message), message.header.frame_id, [v.x, v.y, v.z], R)


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * NS + int(message.header.stamp.nanosec)
