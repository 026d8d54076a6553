"""Predictions of withheld pings, against those of the filter with hand-set noise."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.studies.evaluation.statistics import Draws, Interval, ratio_of_means
from insdvl.studies.judgement.withheld import WINDOWS
from insdvl.studies.report.markdown import interval, table
from insdvl.studies.results.vehicle_runs import HAND_SET

#: Numbers of a row by name of the recording, then by column of the study.
Numbers = Mapping[str, Mapping[str, float]]


def against_hand_set(rows: Mapping[str, Numbers], draws: Draws) -> dict[str, Any]:
    """Each row against hand-set noise, by row and by length of the windows.

    Args:
        rows: Of the study, by row. All predict the same pings.
        draws: Weights (RESAMPLES, R) of the R recordings.

    Returns:
        For each row and length ``error``, the ratio of the RMS errors over all pings, and
        ``log_likelihood``, the mean difference for a ping, both with intervals. A recording that
        is too short for a length is left out of it.
    """
    return {
        row: {f"{w:g} s": _compared(numbers, rows[HAND_SET], w, draws) for w in WINDOWS}
        for row, numbers in rows.items()
        if row != HAND_SET
    }


def _compared(row: Numbers, hand_set: Numbers, seconds: float, draws: Draws) -> dict[str, Interval]:
    def column(numbers: Numbers, name: str) -> Array:
        return np.array([of[f"{name} {seconds:g} s"] for of in numbers.values()])

    count = column(hand_set, "count")
    long = np.isfinite(count)
    if not long.any():
        return dict.fromkeys(("error", "log_likelihood"), (math.nan,) * 3)
    count, draws = count[long], draws[:, long]
    draws = draws[draws.any(axis=1)]
    error, best = (column(numbers, "error")[long] for numbers in (row, hand_set))
    middle, low, high = np.sqrt(ratio_of_means(count * error**2, count * best**2, draws))
    gain = (column(row, "log_likelihood") - column(hand_set, "log_likelihood"))[long]
    return {
        "error": (float(middle), float(low), float(high)),
        "log_likelihood": ratio_of_means(count * gain, count, draws),
    }


def predictions_table(against: Mapping[str, Any]) -> str:
    """The table of `against_hand_set`."""
    head = [
        text
        for w in WINDOWS
        for text in (f"error / {HAND_SET}, {w:g} s", f"log likelihood - {HAND_SET}, {w:g} s")
    ]
    return table(
        ["row", *head],
        [
            [row, *(interval(of[name]) for of in lengths.values() for name in of)]
            for row, lengths in against.items()
        ],
    )
