"""The answers to each question, from what was seen of a recording."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from insdvl.messages.topics import DEPTH
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.studies.check.bias import REST
from insdvl.studies.check.findings import (
    AXES,
    CHECK,
    FILTER,
    FIT,
    HEADING,
    MOST,
    NEEDED,
    NONE,
    PINGS,
    REPLAY,
    SAMPLES,
    START,
    Finding,
    fatal,
    right_angles,
    setting,
    wrong,
)
from insdvl.studies.check.inspection import GYROSCOPE_BIAS, Inspection
from insdvl.studies.check.timing import stamp_answers
from insdvl.watch.alignment.check import FEWEST_WINDOWS

#: A sigma of the messages is too large from so many times the scatter of the pings on. Errors that
#: last are not in the scatter, and a driver may count them.
TOO_UNSURE = 10.0


def answers(seen: Inspection) -> list[Finding]:
    """All that is to be said, in the order of the questions."""
    found = list(_needed(seen))
    if seen.imu is not None:
        found += stamp_answers(seen)
        found += [*_axes(seen), *_start(seen), *_heading(seen), *_samples(seen)]
    if seen.dvl is not None:
        found += _pings(seen)
    if seen.imu is not None and seen.dvl is not None:
        found += _fit(seen)
    return found


# ---------------------------------------------------------------- each question


def _needed(seen: Inspection) -> Iterator[Finding]:
    sensors, replay = seen.sensors, seen.replay
    if not sensors.imu:
        yield fatal(NEEDED, "No topic has the type sensor_msgs/msg/Imu: the filter needs an IMU.")
    elif sensors.imu == replay.imu_topic:
        yield Finding(NEEDED, f"The IMU is on {sensors.imu}.")
    else:
        yield setting(
            NEEDED,
            f"The IMU is on {sensors.imu}, which imu_topic must name.",
            {"imu_topic": sensors.imu},
            REPLAY,
        )
    if sensors.dvl_row is None:
        yield fatal(NEEDED, "No topic has a type of a DVL: the filter needs its velocities.")
    elif sensors.dvl == getattr(replay, sensors.dvl_row.replay_parameter):
        yield Finding(NEEDED, f"The DVL is on {sensors.dvl}.")
    else:
        name = sensors.dvl_row.replay_parameter
        yield setting(
            NEEDED,
            f"The DVL is on {sensors.dvl}, which {name} must name.",
            {name: sensors.dvl},
            REPLAY,
        )
    for remark in seen.remarks:
        yield wrong(NEEDED, f"{remark[0].upper()}{remark[1:]}.")
    for use, chosen, rivals in (
        ("IMU", sensors.imu, sensors.imu_rivals),
        ("DVL", sensors.dvl, sensors.dvl_rivals),
    ):
        if rivals:
            yield wrong(
                NEEDED,
                f"{CHECK} that {chosen} is the {use} of this vehicle: {', '.join(rivals)} could "
                "be, and is not looked at. Name it with imu_topic or dvl_topic of insdvl_replay.",
            )
    if sensors.pressure and not seen.parameters.depth.topic:
        name = sensors.pressure.lstrip("/")
        yield setting(
            NEEDED, f"{sensors.pressure} tells the depth.", {"depth.topic": name or DEPTH}
        )
    if seen.place is not None:
        lat, told = seen.place[0], seen.parameters.origin.latitude_deg
        if abs(lat - told) > 1.0:
            yield setting(
                NEEDED,
                f"The first fix is at latitude {lat:.2f} deg, origin.latitude_deg is {told:g}.",
                {"origin.latitude_deg": round(lat, 2)},
            )


def _axes(seen: Inspection) -> Iterator[Finding]:
    assert seen.imu is not None
    f = seen.imu.mean[:3]
    shown = f"[{', '.join(f'{x:+.2f}' for x in f)}] m/s^2"
    text = f"The mean specific force is {shown} in the axes of the IMU."
    changed = {n: v for n, v in seen.found.items() if n in ("frame_convention", "imu.mount")}
    if changed:
        yield setting(AXES, text, changed)
    else:
        yield Finding(AXES, text)
    for sentence in seen.gravity:
        told = seen.parameters.frame_convention
        other = next(name for name in CONVENTIONS if name != told)
        reversed_ = "wrong sign" in sentence
        mended = reversed_ or "would make it upright" in sentence
        settings = {FILTER: {"frame_convention": other}} if reversed_ else NONE
        yield Finding(AXES, f"{sentence}.", wrong=True, fatal=not mended, settings=settings)


def _start(seen: Inspection) -> Iterator[Finding]:
    assert seen.imu is not None
    start, first = seen.imu.start, seen.dvl.first if seen.dvl is not None else ()
    speed = max(first, default=0.0)
    if start is None:
        yield Finding(START, "Too few samples to tell.")
        return
    noise = 3.0 * max(seen.parameters.dvl.noise_std)
    told = f", the DVL reads {speed:.2f} m/s" if first else ""
    if start.motion > 1.0 or speed > noise:
        text = f"Yes{told}: the filter starts under way, tilt to 3 deg, and needs a DVL velocity."
    elif not first:
        shown = "that it vibrates" if start.spread > 1.0 else "no motion"
        text = (
            f"Not told: the samples show {shown}, and no DVL says whether the vehicle stays or "
            "moves steadily."
        )
    elif start.spread > 1.0:
        text = f"It stays, but vibrates{told}: biases and heading are not taken from that rest."
    else:
        text = f"No{told}: levelling and gyroscope biases are taken from the rest."
    yield Finding(START, text)


def _heading(seen: Inspection) -> Iterator[Finding]:
    o = seen.orientation
    assert o is not None
    for name in seen.sensors.headings:
        yield Finding(HEADING, f"{name} may tell it: heading.topic: {name.lstrip('/')}.")
    if o.told + o.untold and o.tilted > MOST * (o.told + o.untold):
        yield Finding(
            HEADING, "The orientation of the IMU is in other axes than its force: not used."
        )
    elif o.is_told and o.sigma is not None:
        yield Finding(
            HEADING, f"From the orientation of the IMU, one sigma {math.degrees(o.sigma):.2g} deg."
        )
        return
    elif o.untold > MOST * o.looked:
        yield Finding(
            HEADING,
            "The IMU has an orientation of unknown covariance. If its heading is right, set "
            "initial.heading: imu and initial.heading_std.",
        )
    if seen.sensors.odometry:
        yield Finding(
            HEADING,
            f"{seen.sensors.odometry} may tell it: initial.mode: topic, initial.topic: "
            f"{seen.sensors.odometry.lstrip('/')}.",
        )
    yield Finding(
        HEADING,
        "No sensor is known to tell it: it is unknown until the motion shows it. If you know "
        "it, set initial.heading: parameters and initial.rpy.",
    )


def _samples(seen: Inspection) -> Iterator[Finding]:
    imu = seen.imu
    assert imu is not None
    refused = sum(imu.refused.values())
    if refused > MOST * (refused + imu.count):
        yield fatal(SAMPLES, f"Most samples cannot be used: {_counted(imu.refused)}.")
    elif refused:
        yield wrong(SAMPLES, f"Samples that cannot be used: {_counted(imu.refused)}.")
    for channel, value in imu.stands.items():
        name = "imu.acceleration_range" if channel[0] == "f" else "imu.rate_range"
        told = seen.parameters.imu
        range_ = told.acceleration_range if channel[0] == "f" else told.rate_range
        unit = "m/s^2" if channel[0] == "f" else "rad/s"
        if not range_ or abs(value) < range_:
            yield wrong(
                SAMPLES,
                f"{channel} is saturated: it stands at {value:.4g} {unit}.",
                **{name: _floor(abs(value))},
            )
    for count, text in (
        (imu.saturated, "at the end of the declared range"),
        (
            imu.frozen,
            "with a frozen channel, bit-equal for imu.frozen_samples (for a simulator without "
            "noise set that to 0)",
        ),
        (imu.no_data, "with a specific force of exactly zero"),
        (imu.glitches, "with a reading that leaves its neighbours (a glitch)"),
    ):
        if count:
            yield wrong(SAMPLES, f"{count} of {imu.count} samples {text}.")
    if imu.variance.any():
        f, w = np.sqrt(imu.variance[:3]).max(), np.sqrt(imu.variance[3:]).max()
        yield Finding(
            SAMPLES, f"Noise of a sample, one sigma: {f:.2g} m/s^2 and {w:.2g} rad/s at most."
        )
        if imu.low_passed:
            yield Finding(
                SAMPLES,
                "Their noise falls towards half the rate in all channels: the IMU has a low-pass, "
                "or the vehicle vibrates. What is told here is the noise at low frequencies. The "
                "tuner's difference_order must be 0.",
            )
        elif imu.shaken:
            yield Finding(
                SAMPLES,
                "Neighbouring samples differ by more than that: the vehicle vibrates. What is told "
                "here is the noise at low frequencies.",
            )
        yield from _bias(seen)
        settings = _noise(seen)
        if settings:
            yield setting(
                SAMPLES, "process_noise tells a sigma that is more than 3 times off.", settings
            )


def _bias(seen: Inspection) -> Iterator[Finding]:
    bias, told = seen.gyroscope_bias, seen.parameters.initial.gyroscope_bias_std
    if bias is not None and (GYROSCOPE_BIAS in seen.found or bias.exceeds(told)):
        text = (
            f"The bias of the gyroscope is {bias.size:.2g} rad/s by {bias.source}, more than "
            f"{GYROSCOPE_BIAS} tells"
        )
        if bias.is_usable:
            yield setting(SAMPLES, f"{text}.", {GYROSCOPE_BIAS: bias.rounded})
        else:
            yield wrong(SAMPLES, f"{text}. With a speed along one axis it takes {REST}.")


def _noise(seen: Inspection) -> dict[str, tuple[float, ...]]:
    """The variances of the noise, where the parameters are far from them."""
    assert seen.imu is not None
    told = seen.parameters.process_noise
    found: dict[str, tuple[float, ...]] = {}
    for name, part in (("accelerometer", slice(0, 3)), ("gyroscope", slice(3, 6))):
        variance = float(seen.imu.variance[part].max())
        if variance:  # that of a simulator may be rounding alone
            variance = max(variance, getattr(told, f"{name}_floor"))
        told_variance = max(getattr(told, f"{name}_variance"))
        if variance and not 1 / 9 <= told_variance / variance <= 9:
            found[f"process_noise.{name}_variance"] = (float(f"{variance:.2g}"),) * 3
    return found


def _pings(seen: Inspection) -> Iterator[Finding]:
    dvl = seen.dvl
    assert dvl is not None
    refused = sum(dvl.refused.values())
    if refused > MOST * (refused + dvl.count):
        yield fatal(PINGS, f"Most measurements cannot be used: {_counted(dvl.refused)}.")
    elif refused:
        yield wrong(PINGS, f"Measurements that cannot be used: {_counted(dvl.refused)}.")
    if dvl.speed is None:
        yield wrong(PINGS, "No velocity differs from zero.")
    elif dvl.too_fast > MOST * dvl.count:
        unit = f": the unit is {dvl.unit}, convert it to m/s in the driver" if dvl.unit else ""
        yield fatal(
            PINGS,
            f"The median speed is {dvl.speed[0]:.4g} m/s, dvl.max_speed is "
            f"{seen.parameters.dvl.max_speed:g}{unit}.",
        )
    else:
        yield Finding(
            PINGS, f"Speeds: {dvl.speed[0]:.3g} m/s in the median, {dvl.speed[1]:.3g} at most."
        )
        if dvl.too_fast:
            yield wrong(PINGS, f"{dvl.too_fast} of {dvl.count} are beyond dvl.max_speed: refused.")
    for count, text in (
        (dvl.zeros, "are exactly zero: no bottom lock, or a vehicle at rest"),
        (dvl.repeats, "repeat the one before: no bottom lock, or a coarse resolution"),
        (dvl.partial, "lack a component"),
    ):
        if count:
            yield wrong(PINGS, f"{count} of {dvl.count} {text}.")
    if dvl.told is not None:
        yield Finding(PINGS, f"The messages tell a sigma of {dvl.told:.2g} m/s.")
    if dvl.scatter is not None and np.nansum(dvl.scatter) > 0.0:
        shown = _list(dvl.scatter[np.isfinite(dvl.scatter)])
        yield Finding(PINGS, f"They scatter by {shown} m/s, motion between pings included.")
        told, largest = seen.parameters.dvl, float(np.nanmax(dvl.scatter))
        of_messages = dvl.told or 0.0
        unsure = of_messages > TOO_UNSURE * max(largest, told.noise_floor)
        if unsure and told.covariance != "parameters":
            yield setting(
                PINGS,
                f"That is less than a tenth of the sigma of the messages, which dvl.covariance "
                f"{told.covariance!r} takes: 'parameters' takes dvl.noise_std.",
                {"dvl.covariance": "parameters"},
            )


def _fit(seen: Inspection) -> Iterator[Finding]:
    if seen.windows < FEWEST_WINDOWS:
        yield Finding(
            FIT,
            f"Not told: that takes {FEWEST_WINDOWS} stretches of 20 s with both, the recording has "
            f"{seen.windows}.",
        )
        return
    if seen.remedies:
        texts = "; or ".join(remedy.text for remedy in seen.remedies)
        mended = [remedy.settings for remedy in seen.remedies if remedy.settings]
        settings = mended[0] if mended else {}
        yield Finding(
            FIT,
            f"No: {texts}.",
            wrong=True,
            fatal=not mended,
            settings={FILTER: settings} if settings else NONE,
        )
        for name in ("dvl.mount", "imu.mount"):
            if name in settings:
                angles = right_angles(settings[name])
                yield Finding(FIT, f"If it was mounted at right angles, {name} is {list(angles)}.")
    else:
        yield Finding(
            FIT, f"Yes: nothing contradicts the parameters in {seen.windows} stretches of 20 s."
        )


def _counted(reasons: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in reasons.items())


def _list(values: Any) -> str:
    return f"[{', '.join(f'{x:.2g}' for x in values + 0.0)}]"


def _floor(value: float) -> float:
    """A value, rounded down to four digits: a reading at the end of the range must reach it."""
    digits = 3 - math.floor(math.log10(value))
    return math.floor(value * 10.0**digits) / 10.0**digits
