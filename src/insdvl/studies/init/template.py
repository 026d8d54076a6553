"""The parameters that matter, filled from what was seen of a recording, each with its reason."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from insdvl.navigation.parameters import FilterParameters
from insdvl.simulation.grades import GRADES, Grade
from insdvl.studies.check.bias import REST
from insdvl.studies.check.findings import CHECK, FILTER, REPLAY, Finding, right_angles, settings_of
from insdvl.studies.check.imu import NAMES
from insdvl.studies.check.inspection import GYROSCOPE_BIAS, Inspection
from insdvl.studies.report.parameter_page import yaml_value

_HOUR = 3600.0  # s, in which a bias wanders by a third of its turn-on sigma
_HEADER = f"""\
# From {{name}} by `insdvl init`; for `insdvl replay --config` and, as --params-file, for the nodes.
# {CHECK} marks what the recording does not tell: measure it on the vehicle.
"""


class Line(NamedTuple):
    """A parameter.

    Attributes:
        name: Of the parameter.
        value: Its value.
        why: Where the value is from.
    """

    name: str
    value: Any
    why: str


def parameter_lines(
    seen: Inspection, found: Sequence[Finding], told: Mapping[str, Mapping[str, Any]]
) -> dict[str, list[Line]]:
    """The parameters, by node.

    Args:
        seen: What was seen of it, usable.
        found: What is said of it.
        told: Parameters that are set, by node.
    """
    settings = settings_of(found)
    mended = settings.get(FILTER, {})
    lines = {line.name: line for line in _filter(seen)}
    for key, value in mended.items():
        # What is filled in is told for each axis, by the fix, or is at least that of the grade.
        filled = key in ("origin.latitude_deg", GYROSCOPE_BIAS)
        if not key.startswith("process_noise.") and not filled:
            why = f"{CHECK}: as `insdvl check` tells"
            if key.endswith("mount"):
                why += f"; at right angles it were {yaml_value(right_angles(value))}"
            lines[key] = Line(key, value, why)
    by_node = {FILTER: lines, REPLAY: {line.name: line for line in _replay(seen)}}
    for node, rows in by_node.items():
        rows |= {key: Line(key, value, "as set") for key, value in told.get(node, {}).items()}
    return {node: list(rows.values()) for node, rows in by_node.items()}


def parameter_file(name: str, lines: Mapping[str, Sequence[Line]]) -> str:
    """The file, of a recording of this name."""
    text = _HEADER.format(name=name)
    for node, of_node in lines.items():
        text += f"/**/{node}:\n  ros__parameters:\n"
        for line in of_node:
            text += f"    {f'{line.name}: {yaml_value(line.value)}':42}  # {line.why}\n"
    return text


def _filter(seen: Inspection) -> Iterator[Line]:
    """The ten that are to be set, and the grade of the IMU."""
    p = seen.parameters
    imu, dvl, orientation = seen.imu, seen.dvl, seen.orientation
    assert imu is not None and dvl is not None and orientation is not None
    rate = p.imu.rate
    up = f"the mean specific force along z is {imu.mean[2]:+.2f} m/s^2"
    if "imu.mount" in seen.found:
        up = f"{CHECK}: gravity is on another axis than z"
    yield Line("frame_convention", p.frame_convention, up)
    if seen.place is None:
        yield Line("origin.latitude_deg", p.origin.latitude_deg, f"{CHECK}: to a degree")
    else:
        yield Line("origin.latitude_deg", round(seen.place[0], 2), "by the first fix")
    yield Line("imu.rate", rate, "Hz, by the stamps")
    yield Line("imu.mount", p.imu.mount, f"{CHECK}: roll, pitch, yaw, rad")
    yield Line("dvl.mount", p.dvl.mount, f"{CHECK}: roll, pitch, yaw, rad")
    yield Line("dvl.lever_arm", p.dvl.lever_arm, f"{CHECK}: position in base_link, m")
    yield _dvl_noise(seen)
    yield Line("initial.mode", p.initial.mode, "assumes nothing")
    told = "the IMU tells it" if orientation.is_told else f"{CHECK}: no sensor tells it"
    yield Line("initial.heading", p.initial.heading, told)
    yield Line("process_noise.source", "constant", "external: the tuner learns it")
    noise = p.process_noise
    floors = np.repeat([noise.accelerometer_floor, noise.gyroscope_floor], 3)
    variance = np.where(imu.variance > 0.0, np.maximum(imu.variance, floors), _told(p))
    name, grade = _grade(variance, rate)
    for k, sensor in enumerate(("accelerometer", "gyroscope")):
        by_bands = imu.low_passed or not set(imu.shaken).isdisjoint(NAMES[3 * k : 3 * k + 3])
        by = "at low frequencies, by the model bands" if by_bands else "by differences"
        values = tuple(float(f"{x:.2g}") for x in variance[3 * k : 3 * k + 3])
        yield Line(f"process_noise.{sensor}_variance", values, by)
    for sensor in ("accelerometer", "gyroscope"):
        bias = getattr(grade, f"{sensor}_bias")
        walk = (bias / 3.0) ** 2 / _HOUR
        why = f"{CHECK}: grade {name}, by its noise"
        yield _bias(seen, Line(f"initial.{sensor}_bias_std", float(f"{bias:.2g}"), why))
        yield Line(f"process_noise.{sensor}_bias_walk", float(f"{walk:.2g}"), why)


def _bias(seen: Inspection, of_grade: Line) -> Line:
    """That of the grade, or what the recording shows beyond it."""
    shown = seen.gyroscope_bias
    if of_grade.name != GYROSCOPE_BIAS or shown is None or not shown.exceeds(of_grade.value):
        return of_grade
    if not shown.is_usable:
        why = f"{of_grade.why}; {shown.rounded:g} by {shown.source}: record {REST}"
        return of_grade._replace(why=why)
    why = f"by {shown.source}; by its grade {of_grade.value:g}"
    return Line(GYROSCOPE_BIAS, shown.rounded, why)


#: The resolution of a DVL's numbers [m/s]: that of a simulator may have no noise.
_LEAST_SCATTER = 1e-3


def _dvl_noise(seen: Inspection) -> Line:
    """What the pings show beside the motion that the IMU tells, else their scatter with the motion.

    Errors that last are in neither, so it is at least dvl.noise_floor.
    """
    name, told = "dvl.noise_std", seen.parameters.dvl
    scatter = seen.dvl.scatter if seen.dvl is not None else None
    if seen.ping_noise is not None:
        shown, by = seen.ping_noise[0], "from ping to ping"
    elif scatter is not None and np.nansum(scatter) > 0.0:
        shown, by = float(np.sqrt(np.nanmean(scatter**2))), "by their scatter"
    else:
        return Line(name, told.noise_std, f"{CHECK}: m/s, by its data sheet")
    sigma = max(float(f"{shown:.2g}"), told.noise_floor, _LEAST_SCATTER)
    return Line(name, (sigma,) * 3, f"m/s, {shown:.2g} {by}, and at least dvl.noise_floor")


def _told(p: FilterParameters) -> list[float]:
    noise = p.process_noise
    return [*noise.accelerometer_variance, *noise.gyroscope_variance]


def _grade(variance: Any, rate: float) -> tuple[str, Grade]:
    """The grade whose noise of the gyroscope is nearest, by its name."""
    density = math.sqrt(float(np.mean(variance[3:])) / rate)

    def distance(name: str) -> float:
        return abs(math.log(density / GRADES[name].gyroscope_noise))

    name = min(GRADES, key=distance)
    return name, GRADES[name]


def _replay(seen: Inspection) -> Iterator[Line]:
    """The topics."""
    sensors = seen.sensors
    assert sensors.dvl_row is not None
    imu_kind, dvl_kind = (seen.topics[name].type for name in (sensors.imu, sensors.dvl))
    yield Line("imu_topic", sensors.imu, _among(imu_kind, sensors.imu_rivals))
    name = sensors.dvl_row.replay_parameter
    yield Line(name, sensors.dvl, _among(dvl_kind, sensors.dvl_rivals))
    if sensors.odometry:
        yield Line("ground_truth_topic", sensors.odometry, f"{CHECK}: a reference, for the errors")


def _among(kind: str, rivals: Sequence[str]) -> str:
    """The type, and what else the sensor could be."""
    return f"{CHECK}: or {', or '.join(rivals)}; {kind}" if rivals else kind
