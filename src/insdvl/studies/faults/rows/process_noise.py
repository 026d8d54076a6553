"""Faults of the received process noise, and of the samples it is learned from."""

from collections.abc import Callable
from typing import Any

import numpy as np

from insdvl.messages.topics import IMU, PROCESS_NOISE
from insdvl.studies.faults import changes
from insdvl.studies.faults.changes import FORCE, Change, axis, triad
from insdvl.studies.faults.checks import (
    counter,
    covered,
    error_below,
    nothing_refused,
    recovers,
    refused,
    rejoins,
)
from insdvl.studies.faults.rows.base import BEGIN, END, FlightRow
from insdvl.studies.faults.stream import Sensors


def _rows() -> list[FlightRow]:
    external = {"process_noise.source": "external"}
    learned = Sensors(learned=True)

    def edited(change: Callable[[Any], Any]) -> Change:
        return changes.edited(PROCESS_NOISE, BEGIN, END, change)

    return [
        FlightRow(
            "Process noise",
            "not told for 30 s",
            changes.dropped(PROCESS_NOISE, BEGIN, END),
            (nothing_refused(), counter("q_timeouts", 1), covered(), recovers(10.0)),
            parameters=external,
        ),
        FlightRow(
            "Process noise",
            "NaN for 30 s",
            edited(changes.covariance(np.full((3, 3), np.nan))),
            (
                refused("bad_covariance", PROCESS_NOISE),
                counter("q_timeouts", 1),
                covered(),
                recovers(10.0),
            ),
            parameters=external,
        ),
        FlightRow(
            "Process noise",
            "zeros (unknown) for 30 s",
            edited(changes.covariance(np.zeros((3, 3)))),
            (nothing_refused(), covered(), recovers(10.0)),
            parameters=external,
        ),
        FlightRow(
            "Process noise",
            "far too small for 30 s: the floor",
            edited(changes.covariance(1e-30 * np.eye(3))),
            # A wrong Q gives a wrong sigma; what must hold is that no good measurement is lost.
            (nothing_refused(), counter("floors", 30), error_below(1.0), rejoins()),
            parameters=external,
        ),
        FlightRow(
            "Process noise",
            "far too large for 30 s: the ceiling",
            edited(changes.covariance(1e5 * np.eye(3))),
            (nothing_refused(), counter("ceilings", 30), covered(), recovers(20.0), rejoins()),
            parameters=external,
        ),
        FlightRow(
            "Process noise",
            "learned: NaN in a channel of the IMU, 1 % of the samples",
            changes.edited(IMU, BEGIN, END, triad(FORCE, axis(0, np.nan)), share=0.01),
            (refused("not_finite", IMU), covered(), recovers(10.0)),
            parameters=external,
            sensors=learned,
        ),
        FlightRow(
            "Process noise",
            "learned: gap of 1 s in a turn",
            changes.dropped(IMU, 47.0, 48.0),
            (nothing_refused(), counter("gaps", 1), covered(), recovers(20.0), rejoins()),
            begin=47.0,
            end=48.0,
            parameters=external,
            sensors=learned,
        ),
        FlightRow(
            "Process noise",
            "learned: 10 % of all messages lost",
            changes.network(loss=0.1),
            (nothing_refused(), covered(), rejoins(), error_below(1.0)),
            parameters=external,
            sensors=learned,
        ),
        FlightRow(
            "Process noise",
            "learned: one sample of 100 m/s^2 in an axis of the IMU",
            changes.edited(IMU, BEGIN, BEGIN + 0.005, triad(FORCE, axis(0, 100.0))),
            # It adds 1 m/s of velocity, and the tuner's window keeps it for 2 s.
            (nothing_refused(), error_below(2.0), recovers(20.0), rejoins()),
            end=BEGIN + 0.005,
            parameters=external,
            sensors=learned,
        ),
    ]


ROWS = tuple(_rows())
