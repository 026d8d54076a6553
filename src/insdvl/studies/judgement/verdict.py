"""What a replay says of its configuration, and one line of judgement with what to set.

A finding needs two things: chance does not explain it, and it is large enough to matter. Both
limits, and the model behind each rule, are in docs/explanation/verdict.md. None is fitted to a
recording.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from insdvl.files import finite
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start.automatic import USEFUL_HEADING
from insdvl.studies.judgement.finding import Finding
from insdvl.studies.judgement.innovations import FACTOR, FEWEST, SIGMAS, statistics
from insdvl.studies.judgement.mounting import (
    ARMS,
    DEPTH_OFFSET,
    MOUNT_SIGMAS,
    Change,
    Mount,
    can_be,
    mounting,
    told_otherwise,
)
from insdvl.studies.judgement.noise import DvlNoise, dvl_noise, imu_variances
from insdvl.studies.judgement.numbers import (
    biases,
    by_name,
    changes,
    judged_count,
    position,
    refused_share,
)
from insdvl.studies.judgement.outages import Outage, of_dvl_outages, of_imu_outages, outages_of
from insdvl.studies.judgement.pose import against_reference, of_pose, of_velocity
from insdvl.studies.judgement.refusals import of_claims, of_gate, of_sensors
from insdvl.studies.judgement.withheld import WINDOWS, Withheld, predictions
from insdvl.studies.replay.fold import Replayed
from insdvl.studies.replay.taken import MOST
from insdvl.watch.start import DIVERGED

#: Seed of the noise that is added to find what noise makes of the mount.
SEED = 0
#: Correlation of neighbours, and mean innovation in its sigmas, beyond which they matter.
CORRELATED, OFFSET = 0.2, 0.2


@dataclass(frozen=True)
class Verdict:
    """The judgement of a replay.

    Attributes:
        findings: What does not fit, the most likely cause of the others first.
        judgement: One line.
        numbers: For the JSON document.
    """

    findings: list[Finding]
    judgement: str
    numbers: dict[str, Any]


def verdict(replayed: Replayed, parameters: FilterParameters, document: dict[str, Any]) -> Verdict:
    """Judge a replay.

    Args:
        replayed: The folded recording.
        parameters: Of the filter.
        document: The numbers of `scores.report`.
    """
    reports = [u.report for u in replayed.updates if u.report.measurement == Dvl.name]
    innovations = statistics(reports)
    filter_ = replayed.fold.filter
    used = {
        u.stamp_ns
        for u in replayed.last.updates
        if u.report.measurement == Dvl.name and u.report.corrected
    }
    noise = dvl_noise(replayed.taken, filter_, replayed.ping_noise)
    # Axes or units that are wrong, and a filter that diverges, make the rest meaningless, and its
    # computation long; what they do to noise, gate and biases would be called the fault of these.
    diverged = list(_of_divergence(document))
    is_meaningful = not replayed.findings and not diverged
    mount = None
    if is_meaningful:
        rng = np.random.default_rng(SEED)
        mount = mounting(replayed.taken, parameters, used, rng)
    part = replayed.taken.first(MOST)
    withheld = [
        found
        for seconds in WINDOWS
        if is_meaningful and (found := predictions(part, parameters, used, seconds))
    ]
    imu = imu_variances(part)
    reference = against_reference(replayed.at_reference)
    claims, start = list(of_claims(document, filter_)), list(_of_start(document))
    # Without most of the DVL neither heading nor position can be found: then that is the cause.
    is_cause = 2 * by_name(document, Dvl.name).total() > judged_count(document, Dvl.name)
    outages = outages_of(replayed)
    findings = [*_of_axes(replayed), *diverged, *of_imu_outages(outages)]
    findings += [*(claims if is_cause else []), *of_dvl_outages(outages)]
    prediction: list[Finding] = []
    if is_meaningful:
        findings += of_sensors(replayed, document)
        prediction = list(_of_prediction(innovations, noise, withheld, parameters, imu))
        pose = list(of_pose(reference, document, parameters))
        # A Q that is too small makes errors of the pose beyond its sigma, but no heading far off.
        is_far = reference and reference.heading and reference.heading.rmse > USEFUL_HEADING
        if pose and not is_far and any(not finding.cautious for finding in prediction):
            findings += prediction
            prediction = []
        findings += pose
    findings += [*start, *([] if is_cause else claims)]
    if is_meaningful:
        findings += [
            *_of_dvl_noise(noise, parameters),
            *_of_mount(mount, parameters),
            *of_gate(document, innovations, filter_),
            *prediction,
            *_of_biases(document),
            *_of_whiteness(innovations, noise),
            *of_velocity(document),
        ]
    numbers = {
        "innovations": innovations,
        "refused_share": refused_share(document, Dvl.name),
        "dvl_outages": outages.numbers,
        "biases": biases(filter_, replayed),
        "position": position(replayed),
        "reference": asdict(reference) if reference else None,
        "dvl_noise": asdict(noise) if noise else None,
        "imu_variance_by_differences": imu,
        "mounting": changes(mount),
        "withheld": [asdict(w) for w in withheld],
        "findings": [asdict(finding) for finding in findings],
    }
    judgement = _judgement(findings, innovations, mount, noise, document, outages.dvl)
    return Verdict(findings, judgement, finite(numbers | {"judgement": judgement}))


def _judgement(
    findings: list[Finding],
    innovations: dict[str, Any] | None,
    mount: Mount | None,
    noise: DvlNoise | None,
    document: dict[str, Any],
    outages: Sequence[Outage] = (),
) -> str:
    if findings:
        more = f" ({len(findings) - 1} more above)" if len(findings) > 1 else ""
        wrong = [finding for finding in findings if not finding.cautious]
        kind = "NOT RIGHT" if wrong else "TOO CAUTIOUS"
        return f"{kind}: {(wrong or findings)[0].sentence}{more}"
    if innovations is None:
        accepted = document["dvl_accepted"]
        return f"CANNOT TELL: only {accepted} DVL measurements were used, {FEWEST} are needed"
    text = "FITS: nothing in the innovations contradicts the configuration"
    if _differs(noise):
        text += "; NIS is small, as the noise of the DVL is told with errors that last"
    if outages:
        text += f"; the DVL was not used for {sum(o.seconds for o in outages):.0f} s"
    if hidden := ", ".join(_not_shown(mount)):
        text += f"; not seen by this motion: {hidden}; turns, dives and changes of speed show it"
    return text


def _not_shown(mount: Mount | None) -> Iterator[str]:
    """What could be off by twice what care allows and be no finding, with its sigma."""
    if mount is None:
        return
    all_of = {change.unknown.name: change for change in mount}
    for names, shown, scale, unit in (
        (("mount_x",), "the roll of the DVL", math.degrees(1.0), "deg"),
        (("mount_y",), "its pitch", math.degrees(1.0), "deg"),
        (("mount_z",), "its yaw", math.degrees(1.0), "deg"),
        (ARMS, "its lever arm", 1.0, "m"),
        (("time_offset",), "its time offset", 1.0, "s"),
        (("scale",), "its scale", 100.0, "%"),
    ):
        worst = max((all_of[name] for name in names), key=lambda change: change.sigma)
        if MOUNT_SIGMAS * worst.sigma > 2.0 * worst.unknown.careful:
            is_known = math.isfinite(worst.sigma)
            yield f"{shown} (sigma {worst.sigma * scale:.2g} {unit})" if is_known else shown


# ---------------------------------------------------------------- the rules


def _of_axes(replayed: Replayed) -> Iterator[Finding]:
    for text in replayed.findings:
        yield Finding("axes", f"axes, units or mounts contradict the motion: {text}", "")


def _of_divergence(document: dict[str, Any]) -> Iterator[Finding]:
    if count := document["counts"]["diverged"]:
        text = f"the filter has diverged and given up its state (diverged {count})"
        yield Finding("diverged", text, DIVERGED)


def _of_start(document: dict[str, Any]) -> Iterator[Finding]:
    for sentence in document["findings"]:
        if sentence.startswith("heading unknown"):
            what, _, remedy = sentence.rpartition(": set ")
            text = f"{what.partition(' (')[0]}: position and course are not those on the map"
            yield Finding("heading", text, f"set {remedy}")


def _of_mount(mount: Mount | None, parameters: FilterParameters) -> Iterator[Finding]:
    """The one change that makes the innovations the most probable, and those nearly as good."""
    if mount is None:
        return
    ranked = sorted((c for c in mount if can_be(c, parameters)), key=lambda change: -change.z)
    best = ranked[0]
    beyond = [change for change in ranked if change.matters]
    if not beyond or beyond[0] is not best:
        return
    # Odds of a hundred between two causes: 2 ln 100 in the squares of their sigmas.
    as_good = [c for c in beyond if best.z**2 - c.z**2 < 2.0 * math.log(100.0)]
    texts, remedies = zip(*(_change(c, parameters) for c in as_good), strict=True)
    yield Finding("mount", "; or ".join(texts), "; or ".join(remedies))


def _change(change: Change, parameters: FilterParameters) -> tuple[str, str]:
    """What is wrong, and what to set."""
    name, value, sigma = change.unknown.name, change.value, change.sigma
    dvl = told_otherwise(parameters, [], change.unknown, value, {})[0].dvl
    if name.startswith("mount"):
        angle, axis = math.degrees(value), name[-1]
        mount = _list(dvl.mount, 4)
        return (
            f"the DVL is turned by {angle:+.1f} deg about {axis} (sigma {math.degrees(sigma):.1f})",
            f"set dvl.mount to {mount} rad",
        )
    if name.startswith("lever_arm"):
        return (
            f"the lever arm of the DVL is off by {value:+.2f} m in {name[-1]} (sigma {sigma:.2f})",
            f"set dvl.lever_arm to {_list(dvl.lever_arm, 2)} m",
        )
    if name in ("time_offset", DEPTH_OFFSET.name):
        late = "late" if value < 0.0 else "early"
        label, group, told = "DVL", "dvl", parameters.dvl.time_offset
        if name == DEPTH_OFFSET.name:
            label, group, told = "depth sensor", "depth", parameters.depth.time_offset
        return (
            f"the stamps of the {label} are {abs(value):.2f} s {late} (sigma {sigma:.2f})",
            f"set {group}.time_offset to {told + value:.3f} s",
        )
    return (
        f"the DVL's velocities are {-100.0 * value:+.1f} % wrong (sigma {100.0 * sigma:.1f})",
        f"multiply them by {1.0 + value:.3f} in the driver (speed of sound)",
    )


def _differs(noise: DvlNoise | None) -> bool:
    """Whether another noise from ping to ping is told than the recording shows."""
    if noise is None or noise.z < SIGMAS:
        return False
    return not 1.0 / FACTOR < noise.shown / noise.told < FACTOR


def _of_dvl_noise(noise: DvlNoise | None, parameters: FilterParameters) -> Iterator[Finding]:
    """The pings do not show errors that last: more than they show is right up to the floor."""
    if noise is None or not _differs(noise):
        return
    floor = parameters.dvl.noise_floor
    honest = max(noise.shown, floor)
    if noise.shown < noise.told < FACTOR * honest:
        return
    ratio = noise.told / honest if noise.told > noise.shown else noise.told / noise.shown
    by = f"{ratio:.1f} times too large" if ratio > 1.0 else f"{1.0 / ratio:.1f} times too small"
    value = _list([honest] * 3, 4)
    remedy = f"set dvl.noise_std to {value} m/s"
    if honest == floor:
        remedy += ", which is dvl.noise_floor"
    if noise.by_messages:
        remedy += ", and dvl.covariance to 'parameters': the messages tell another one"
    if ratio > 1.0:
        remedy += " or somewhat more: errors that last longer than seconds are not in it"
    yield Finding(
        "dvl_noise",
        f"the noise of the DVL is told {by}: sigma {noise.told:.2g} m/s, and the recording shows "
        f"{noise.shown:.2g}",
        remedy,
        cautious=ratio > 1.0,
    )


def _of_prediction(
    innovations: dict[str, Any] | None,
    noise: DvlNoise | None,
    withheld: list[Withheld],
    parameters: FilterParameters,
    imu: tuple[float, float],
) -> Iterator[Finding]:
    """NIS that is not that of the DVL's noise is that of the prediction."""
    if innovations is None or any(_of_dvl_noise(noise, parameters)):
        return
    # What is told for errors that last makes NIS small where there are none: no finding then.
    fits = not _differs(noise)
    source = parameters.process_noise.source
    low, high = innovations["nis_median_bounds"]
    median, middle = innovations["nis_median"], innovations["nis_median_expected"]
    expected = innovations["nis_expected"]
    beyond = [
        w
        for w in withheld
        if not w.nis_bounds[0] <= w.nis_mean <= w.nis_bounds[1] + w.nis_of_curvature
        and not expected / FACTOR**2 < w.nis_mean < expected * FACTOR**2 + w.nis_of_curvature
        and (fits or w.nis_mean > expected)
    ]
    large = median > middle
    beside = not low <= median <= high and not middle / FACTOR < median < middle * FACTOR
    if beside and (fits or large):
        text = (
            f"the median of NIS is {median:.2f} and should be {middle:.2f}: the prediction is "
            f"{'worse' if large else 'better'} than the filter says"
        )
    elif beyond:
        w = max(beyond, key=lambda w: w.seconds)
        large = w.nis_mean > expected
        text = (
            f"{w.seconds:g} s without the DVL the velocity is {w.error:.2g} m/s off, and the "
            f"filter says {w.sigma:.2g}"
        )
    else:
        return
    if source == "constant":
        remedy = (
            f"{_variances(parameters, imu, large=large)}, or set process_noise.source to 'external'"
        )
    else:
        remedy = f"compare with process_noise.source 'constant'; it is {source!r}"
        if source != "adaptive" and not parameters.process_noise.adaptive_factor:
            remedy = f"set process_noise.adaptive_factor to true, or {remedy}"
    yield Finding("prediction", text, remedy, cautious=not large)


def _variances(parameters: FilterParameters, imu: tuple[float, float], *, large: bool) -> str:
    """Which variances to raise, or to lower: those that the samples do not contradict, if any."""
    noise = parameters.process_noise
    both = [
        (name, float(np.mean(told)), shown)
        for name, told, shown in (
            ("accelerometer_variance", noise.accelerometer_variance, imu[0]),
            ("gyroscope_variance", noise.gyroscope_variance, imu[1]),
        )
    ]
    named = [one for one in both if (one[1] < one[2]) == large] or both
    texts = [
        f"process_noise.{name} (told {told:.2g}, the samples show {shown:.2g})"
        for name, told, shown in named
    ]
    return f"{'raise' if large else 'lower'} {' and '.join(texts)}"


def _of_biases(document: dict[str, Any]) -> Iterator[Finding]:
    for text in document["findings"]:
        if " bias " in text and not text.startswith("heading"):
            what, _, remedy = text.partition(": ")
            yield Finding("bias", what, remedy)


def _of_whiteness(innovations: dict[str, Any] | None, noise: DvlNoise | None) -> Iterator[Finding]:
    """Correlation and mean; a noise that is told wrongly correlates the innovations by itself."""
    if innovations is None:
        return
    rho, bound = innovations["autocorrelation"], innovations["autocorrelation_bound"]
    if abs(rho) > max(bound, CORRELATED) and not _differs(noise):
        yield Finding(
            "correlated",
            f"neighbouring innovations are correlated by {rho:+.2f} and should be white",
            "errors of the DVL last for seconds: set dvl.bias_model to 'gauss_markov' with "
            "dvl.bias_std, which insdvl train --from-bags tells"
            if rho > 0.0
            else "the filter follows the DVL's noise: lower process_noise.*_variance",
            cautious=rho < 0.0,
        )
    for axis, t, share in zip(
        "xyz", innovations["mean_in_standard_errors"], innovations["mean_in_sigmas"], strict=False
    ):
        if abs(t) > SIGMAS and abs(share) > OFFSET:
            yield Finding(
                "mean",
                f"the innovation in {axis} of the DVL has the mean "
                f"{innovations['mean']['xyz'.index(axis)]:+.3g} m/s, {abs(t):.1f} standard errors",
                "check dvl.mount and dvl.lever_arm, or set dvl.bias_model to 'gauss_markov'",
            )


def _list(values: Any, digits: int) -> str:
    return "[" + ", ".join(f"{float(value) + 0.0:.{digits}f}" for value in values) + "]"
