"""Faults of the clock: stamps that jump, and the ends of time."""

import numpy as np

from insdvl.messages.topics import DVL, IMU
from insdvl.navigation.events import NS
from insdvl.studies.faults import changes
from insdvl.studies.faults.checks import (
    AFTER,
    SETTLE,
    counter,
    covered,
    error_below,
    nothing_refused,
    recovers,
    refused,
    rejoins,
    same_bits,
    stops,
)
from insdvl.studies.faults.rows.base import BEGIN, END, LEVELLING, ONE_SEED, FlightRow
from insdvl.studies.faults.stream import Sensors

#: Start of a mission of the usual length whose last sample is 10 ms before 2^31 s.
LAST_START_NS = 2**31 * NS - round((END + SETTLE + AFTER + 1.01) * NS)


def _way(step: float) -> str:
    return "ahead" if step > 0.0 else "back"


def _rows() -> list[FlightRow]:
    rows = []
    for step in (1000.0, 40.0, -5.0, -500.0):
        rows.append(
            FlightRow(
                "Time",
                f"clock set {_way(step)} by {abs(step):g} s; jump_action reset",
                changes.clock_step(BEGIN, step),
                (nothing_refused(), counter("time_jumps", 1), covered(), recovers(30.0), rejoins()),
                end=BEGIN,
                parameters=LEVELLING,
            )
        )
    for step in (1000.0, -500.0):
        rows.append(
            FlightRow(
                "Time",
                f"clock set {_way(step)} by {abs(step):g} s; jump_action hold",
                changes.all_of(
                    changes.clock_step(BEGIN, step),
                    changes.unpublished(BEGIN, np.inf, (IMU, DVL)),
                ),
                (counter("time_jumps", 0), stops()),
                end=BEGIN,
                parameters={"jump_action": "hold"},
                seeds=ONE_SEED,
            )
        )
    rows += [
        FlightRow(
            "Time",
            "clock set ahead by 1000 s and back after 5 s; jump_action hold",
            changes.all_of(
                changes.clock_step(BEGIN, 1000.0),
                changes.clock_step(BEGIN + 5.0, -1000.0),
                changes.unpublished(BEGIN, BEGIN + 5.0, (IMU, DVL)),
            ),
            # The second sample shows that the time in between was a gap; the first was refused.
            (
                counter("time_jumps", 0),
                counter("gaps", 1),
                counter("recovered", 1),
                covered(),
                recovers(20.0),
                rejoins(),
            ),
            end=BEGIN + 5.0,
            parameters={"jump_action": "hold"},
        ),
        FlightRow(
            "Time",
            "clock set back by 1 s, onto stamps that were there",
            changes.all_of(
                changes.clock_step(BEGIN, -1.0),
                changes.unpublished(BEGIN, BEGIN + 1.0, (IMU, DVL)),
            ),
            (refused("duplicate", IMU, DVL), covered(), recovers(20.0), rejoins()),
            end=BEGIN + 1.0,
        ),
        FlightRow(
            "Time",
            "clock set back by 1.003 s, in between the stamps that were there",
            changes.all_of(
                changes.clock_step(BEGIN, -1.003),
                changes.unpublished(BEGIN, BEGIN + 1.003, (IMU,)),
            ),
            (nothing_refused(), covered(), recovers(20.0), rejoins()),
            end=BEGIN + 1.003,
        ),
        FlightRow(
            "Time",
            "clock set ahead by 5 s, less than jump_limit",
            changes.clock_step(BEGIN, 5.0),
            (nothing_refused(), counter("gaps", 1), covered(), recovers(20.0), rejoins()),
            end=BEGIN,
        ),
        FlightRow(
            "Time",
            "a recording that is played again from its beginning",
            changes.played_again(100.0),
            (
                nothing_refused(),
                counter("time_jumps", 1),
                covered(),
                error_below(3.0),
                rejoins(),
            ),
            begin=100.0,
            end=100.0,
            parameters=LEVELLING,
        ),
        FlightRow(
            "Time",
            "stamps from 0",
            changes.unchanged,
            (nothing_refused(), same_bits()),
            sensors=Sensors(start_ns=0),
            calm=Sensors(),
            seeds=ONE_SEED,
        ),
        FlightRow(
            "Time",
            "stamps up to 2^31 s",
            changes.unchanged,
            (nothing_refused(), same_bits()),
            sensors=Sensors(start_ns=LAST_START_NS),
            calm=Sensors(),
            seeds=ONE_SEED,
        ),
    ]
    return rows


ROWS = tuple(_rows())
