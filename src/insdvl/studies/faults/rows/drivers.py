"""Pings that a driver of a DVL marks as none, in the driver's own message type."""

from collections.abc import Callable, Iterator

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.drivers import DAVE, DVL_MSGS, MARINE_ACOUSTIC, STONEFISH
from insdvl.messages.dvl import FILL_VELOCITY
from insdvl.messages.topics import DVL
from insdvl.navigation.geometry.frames import ENU
from insdvl.recordings.drivers import PLAIN, Told, dvl_message
from insdvl.studies.faults.changes import Change
from insdvl.studies.faults.checks import covered, none_refused, recovers, refused, rejoins
from insdvl.studies.faults.rows.base import BEGIN, END, FlightRow
from insdvl.studies.faults.stream import Arrival, Stream

Velocity = Callable[[Array], Array]


def _noise(v: Array) -> Array:
    """Nothing but noise (3,) [m/s], another one for each velocity."""
    seed = np.frombuffer(v.tobytes(), np.uint32)
    return 0.02 * np.random.default_rng(seed).standard_normal(3)


def _by(kind: str, told: Told = PLAIN, velocity: Velocity = np.array) -> Change:
    """All of the DVL's messages in the type of a driver.

    Args:
        kind: The type.
        told: What the driver tells within [BEGIN, END).
        velocity: What it makes of the velocity (3,) there, forward-right-down [m/s].
    """

    def change(stream: Stream, rng: np.random.Generator) -> Stream:
        def each(arrival: Arrival) -> Iterator[Arrival]:
            if arrival.topic != DVL:
                yield arrival
                return
            linear = arrival.message.twist.linear
            v, says, valid = ENU.body @ [linear.x, linear.y, linear.z], PLAIN, True
            if BEGIN <= stream.seconds(arrival) < END and told is not PLAIN:
                v, says, valid = velocity(v), told, False
            message = dvl_message(kind, arrival.time_ns, v, says)
            yield arrival._replace(message=message, valid=valid)

        return stream.changed(each)

    return change


def _row(
    kind: str, words: str, reason: str, told: Told, velocity: Velocity = np.array
) -> FlightRow:
    return FlightRow(
        "DVL drivers",
        f"{kind.replace('/msg', '')}: {words}",
        _by(kind, told, velocity),
        (refused(reason, DVL), covered(), recovers(10.0), rejoins()),
    )


ROWS = (
    *(
        FlightRow(
            "DVL drivers",
            f"{kind.replace('/msg', '')}: no fault",
            _by(kind),
            (none_refused(), covered(), rejoins()),
        )
        for kind in (MARINE_ACOUSTIC, DVL_MSGS, STONEFISH, DAVE)
    ),
    _row(
        MARINE_ACOUSTIC,
        "marked as invalid for 30 s, the velocity is noise",
        "invalid",
        Told(valid=False),
        _noise,
    ),
    _row(
        MARINE_ACOUSTIC,
        "two good beams for 30 s, off by 0.5 m/s",
        "no_bottom",
        Told(good_beams=2),
        lambda v: v + np.array([0.3, -0.4, 0.0]),
    ),
    _row(
        MARINE_ACOUSTIC,
        "of the water for 30 s, in a current of 0.5 m/s",
        "through_water",
        Told(water=True),
        lambda v: v + np.array([0.3, -0.4, 0.0]),
    ),
    _row(
        DVL_MSGS,
        "-32.768 m/s for 30 s, marked as valid",
        "invalid",
        Told(sigma=0.01),
        lambda v: np.full(3, FILL_VELOCITY),
    ),
    _row(DVL_MSGS, "altitude -1 for 30 s, zeros", "no_bottom", Told(altitude=-1.0), np.zeros_like),
    _row(
        STONEFISH,
        "altitude -1 for 30 s, the velocity is noise",
        "no_bottom",
        Told(altitude=-1.0),
        _noise,
    ),
    _row(
        DAVE,
        "no beam locked for 30 s, zeros",
        "no_bottom",
        Told(good_beams=0),
        np.zeros_like,
    ),
)
