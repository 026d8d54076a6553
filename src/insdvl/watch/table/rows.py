"""The rows of the table: what each says of a filter, in a cell of some width."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array
from insdvl.watch.consistency import nis_interval
from insdvl.watch.table.digits import UNKNOWN, number, with_sigma
from insdvl.watch.table.numbers import ERROR, Shown, Triads

#: Rows of a velocity measurement of a DVL.
DVL_ROWS = 3
#: Share of consistent filters whose mean NIS lies within the interval that is shown.
INTERVAL = 0.9
#: A filter that was not heard of for longer may have ended [s]; it reports once a second.
SILENT = 5.0
#: A filter without odometry for longer stands still [s]: it sends some with each sample.
STILL = 2.0
#: The bar of the NIS: its width, and the width of a cell from which on there is room for it.
BAR, BAR_FROM = 25, 50

_MILLI = 1e3  # mm/s^2 in m/s^2
_DEG_PER_H = math.degrees(1.0) * 3600.0  # deg/h in rad/s


class Row(NamedTuple):
    """A row.

    Attributes:
        label: What it is, with its unit.
        cell: Its text of a filter, in a width of cells.
    """

    label: str
    cell: Callable[[Shown, int], str]


def _state(shown: Shown, width: int) -> str:
    if shown.silent is None:
        return "not heard of yet"
    if shown.silent > SILENT:
        return f"SILENT for {shown.silent:.0f} s"
    worst = max((finding.level for finding in shown.findings), default=0)
    if shown.pose is None:
        return "not initialised"
    if still := _standing_still(shown):
        return f"NO ODOMETRY for {still:.0f} s"
    if worst >= ERROR:
        return f"ERROR, see below ({len(shown.findings)})"
    return f"navigates, {len(shown.findings)} to note" if shown.findings else "navigates, all well"


def _standing_still(shown: Shown) -> float:
    """How long a filter has published no odometry [s]; 0 for one that does."""
    return shown.still if shown.still is not None and shown.still > STILL else 0.0


def _position(axis: int) -> Callable[[Shown, int], str]:
    def cell(shown: Shown, width: int) -> str:
        if shown.pose is None:
            return UNKNOWN
        return with_sigma([shown.pose.position[axis]], [shown.pose.position_sigma[axis]])

    return cell


def _heading(shown: Shown, width: int) -> str:
    if shown.pose is None:
        return UNKNOWN
    sigma = shown.pose.rpy_sigma_deg[2]
    text = with_sigma([shown.pose.rpy_deg[2]], [sigma])
    return f"{text} (unknown)" if sigma > 60.0 else text


def _tilt(shown: Shown, width: int) -> str:
    if shown.pose is None:
        return UNKNOWN
    return with_sigma(shown.pose.rpy_deg[:2], shown.pose.rpy_sigma_deg[:2])


def _speed(shown: Shown, width: int) -> str:
    if shown.pose is None:
        return UNKNOWN
    v, sigma = shown.pose.velocity, shown.pose.velocity_sigma
    speed = float(np.linalg.norm(v))
    # Along the velocity; at rest, that of the worst axis.
    along = math.hypot(*(v / speed * sigma)) if speed > 0.0 else max(sigma)
    return with_sigma([speed], [along])


def _velocity(shown: Shown, width: int) -> str:
    if shown.pose is None:
        return UNKNOWN
    return with_sigma(shown.pose.velocity, shown.pose.velocity_sigma)


def _measured(number_of: int) -> Callable[[Shown, int], str]:
    def cell(shown: Shown, width: int) -> str:
        if number_of >= len(shown.measured):
            return UNKNOWN
        measured = shown.measured[number_of]
        refused = sum(measured.refused.values())
        total = measured.used + refused
        if not total:
            return "none received yet"
        age = ""
        if measured.age is not None:
            # Its age is of the filter's time, which stands still with the odometry.
            still = _standing_still(shown)
            seconds = f"{measured.age + still:.0f}" if still else number(measured.age, 2)
            age = f"{seconds} s ago, "
        text = f"{age}{100.0 * measured.used / total:.1f} % of {total} used"
        common = sorted(measured.refused.items(), key=lambda item: -item[1])[:2]
        reasons = f" ({', '.join(f'{reason} {count}' for reason, count in common)})"
        return text + reasons if common and len(text + reasons) <= width else text

    return cell


def bar(nis: float, low: float, high: float) -> str:
    """The NIS on a line from 0 to twice its expectation, with its interval: ``[---=#=---]``."""
    end = 2.0 * DVL_ROWS

    def place(value: float) -> int:
        return min(max(round(value / end * (BAR - 1)), 0), BAR - 1)

    line = ["=" if place(low) <= k <= place(high) else "-" for k in range(BAR)]
    line[place(nis)] = "#" if low <= nis <= high else "!"
    return f"[{''.join(line)}]"


def _nis(shown: Shown, width: int) -> str:
    if shown.nis is None or not shown.nis_count:
        return UNKNOWN
    low, high = nis_interval(DVL_ROWS, shown.nis_count, INTERVAL)
    text = f"{shown.nis:.2f}"
    if width >= BAR_FROM:
        text += f" {bar(shown.nis, low, high)}"
    return f"{text} {low:.2f} to {high:.2f}"


def _fit(shown: Shown, width: int) -> str:
    """In words, for there is no truth at sea."""
    if shown.nis is None or not shown.nis_count:
        return "no DVL measurement used yet"
    low, high = nis_interval(DVL_ROWS, shown.nis_count, INTERVAL)
    if shown.nis > high:
        return (
            "overconfident: NIS too large"
            if width < BAR_FROM
            else ("innovations larger than expected: overconfident")
        )
    if shown.nis < low:
        return (
            "too cautious: NIS too small"
            if width < BAR_FROM
            else ("innovations smaller than expected: too cautious")
        )
    return "innovations as expected"


def _biases(field: str, factor: float) -> Callable[[Shown, int], str]:
    def cell(shown: Shown, width: int) -> str:
        if shown.bias is None or shown.bias_sigma is None:
            return UNKNOWN
        values, sigmas = (factor * getattr(t, field) for t in (shown.bias, shown.bias_sigma))
        return with_sigma(values, sigmas)

    return cell


def _noise(field: str) -> Callable[[Shown, int], str]:
    def cell(shown: Shown, width: int) -> str:
        if shown.noise is None:
            return UNKNOWN
        values = getattr(shown.noise, field)
        text = " ".join(number(v) for v in values)
        if shown.nominal is not None and width >= BAR_FROM:
            text += f" = {_ratios(shown.nominal, values, field)} x nominal"
        return text

    return cell


def _true_noise(field: str) -> Callable[[Shown, int], str]:
    def cell(shown: Shown, width: int) -> str:
        if shown.true_noise is None:
            return UNKNOWN
        return " ".join(number(v) for v in getattr(shown.true_noise, field))

    return cell


def _ratios(nominal: Triads, values: Array, field: str) -> str:
    pairs = zip(values, getattr(nominal, field), strict=True)
    return " ".join(number(v / n, 2) if n > 0.0 else UNKNOWN for v, n in pairs)


def _source(shown: Shown, width: int) -> str:
    return shown.noise_source or UNKNOWN


def _gate(shown: Shown, width: int) -> str:
    if not shown.measured:
        return UNKNOWN
    refused = shown.measured[0].refused.get("gate", 0)
    return f"{refused} refused, {shown.inflations} inflations, {shown.restarts} restarts"


def _rates(shown: Shown, width: int) -> str:
    if shown.imu_rate is None and shown.output_rate is None:
        return UNKNOWN
    rates = (UNKNOWN if r is None else number(r) for r in (shown.imu_rate, shown.output_rate))
    return "IMU {}, odometry {}".format(*rates)


def _error(shown: Shown, width: int) -> str:
    if shown.error is None:
        return UNKNOWN
    error = shown.error
    text = f"{number(error.now)} off, RMS {number(error.rms)}"
    return f"{text}, 3 sigma {number(error.three_sigma)}" if width >= BAR_FROM else text


_STATE = (
    Row("state", _state),
    Row("north [m]", _position(0)),
    Row("east [m]", _position(1)),
    Row("depth [m]", _position(2)),
    Row("heading [deg]", _heading),
    Row("speed [m/s]", _speed),
    Row("v x y z [m/s]", _velocity),
    Row("roll pitch [deg]", _tilt),
)
_FIT = (Row("NIS of the DVL", _nis), Row("fit", _fit))
_TRUTH = Row("truth [m/s]", _error)
_TRUE_NOISE = (Row("true noise f", _true_noise("f")), Row("true noise w", _true_noise("w")))
_BIASES = (
    Row("bias f [mm/s^2]", _biases("f", _MILLI)),
    Row("bias w [deg/h]", _biases("w", _DEG_PER_H)),
)
_INSIDE = (
    Row("noise f [m/s^2]", _noise("f")),
    Row("noise w [rad/s]", _noise("w")),
    Row("process noise", _source),
    Row("gate", _gate),
    Row("rates [Hz]", _rates),
)
#: What a line of a log has of each filter.
ESSENCE = (
    Row("depth", _position(2)),
    Row("heading", _heading),
    Row("speed", _speed),
    Row("DVL", _measured(0)),
)


def rows_of(filters: Sequence[Shown]) -> Iterator[Row]:
    """The rows, from what a navigator looks at first to what an engineer looks at."""
    yield from _STATE
    longest = max(filters, key=lambda shown: len(shown.measured)).measured
    labels = [measured.label for measured in longest] or ["DVL"]
    for number_of, label in enumerate(labels):
        yield Row(label, _measured(number_of))
    yield from _FIT
    if any(shown.error is not None for shown in filters):
        yield _TRUTH
    yield from _BIASES
    if any(shown.true_noise is not None for shown in filters):
        yield from _TRUE_NOISE
    yield from _INSIDE
