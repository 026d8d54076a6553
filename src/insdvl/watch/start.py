"""What an operator is told of a filter's start: what was taken from where, and what is missing."""

import math
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.topics import FIX, IMU, SET_ODOMETRY
from insdvl.navigation.error_state import ATTITUDE
from insdvl.navigation.filter import Filter
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start import automatic, gyrocompass
from insdvl.navigation.start.parameters import InitialParameters
from insdvl.navigation.state.fields import State

#: A bias that is estimated beyond so many of its initial sigma is a finding.
SIGMAS = 4.0

#: Why gyrocompassing has not found the heading.
_WHY = {
    gyrocompass.INACCURATE: "with bias, bias walk and noise of the gyroscope as they are told its "
    "sigma would be {number:.3g} deg",
    gyrocompass.MOVES: "the vehicle was not at rest, specific force or angular rate varied "
    "{number:.3g} times as much as noise explains; keep it still and call ~/reset",
    gyrocompass.GAP: "samples were missing; call ~/reset to try again",
    gyrocompass.NOT_THE_EARTH: "the angular rate was not that of the Earth, by {number:.3g} times "
    "what biases explain; check origin.latitude_deg and initial.gyroscope_bias*, keep the vehicle "
    "still and call ~/reset",
}
_SOURCES = {
    automatic.PARAMETERS: "from initial.rpy",
    automatic.IMU: "from the orientation in imu/data_raw",
    automatic.GYROCOMPASS: "by gyrocompassing",
    automatic.KEPT: "kept over the reset",
    automatic.SENSOR: "from heading.topic",
}
#: What tells a heading that is unknown.
REMEDY = (
    "set initial.mode:=topic where initial.topic ({topic}) has it, heading.topic where a compass "
    "has it, initial.heading:=parameters where the yaw of initial.rpy is right, or publish "
    "set_odometry"
)
#: What to do about a filter that diverges.
DIVERGED = (
    "no measurement holds a part of the state, or noise and biases of the IMU are told far too "
    "large; check process_noise, initial.*_std and which components of the velocity are measured"
)


@dataclass(frozen=True)
class Report:
    """How a filter started.

    Attributes:
        text: One line: what was taken from where; empty for a start that was told completely.
        missing: What is still not known, and what would tell it; empty where nothing is missing.
    """

    text: str
    missing: str


def _heading_sigma(s: State) -> float:
    """One sigma of the heading now [rad]."""
    return math.sqrt(s["nav"]["P"][ATTITUDE.stop - 1, ATTITUDE.stop - 1])


def is_heading_known(s: State) -> bool:
    """Whether the heading of an initialised state is known to `automatic.USEFUL_HEADING`."""
    return _heading_sigma(s) < automatic.USEFUL_HEADING


def unknown_heading(s: State) -> str:
    """What an unknown heading does to odom; empty where it is known."""
    if is_heading_known(s):
        return ""
    return (
        f"heading unknown, one sigma {math.degrees(_heading_sigma(s)):.3g} deg: odom turns, with "
        "the path travelled, when DVL and IMU tell it"
    )


def heading_news(s: State) -> str:
    """What to say when a heading that was unknown is known."""
    sigma, turned = (math.degrees(x) for x in (_heading_sigma(s), s["odom"]["turned"]))
    return (
        f"heading known, one sigma {sigma:.3g} deg: odom, with the path travelled, was turned by "
        f"{turned:.3g} deg since the start"
    )


def report_of_start(filter_: Filter, s: State) -> Report:
    """How a filter started, and what it still does not know.

    Args:
        filter_: The filter.
        s: An initialised state record, the latest.
    """
    initial = filter_.parameters.initial
    if initial.mode != "auto" or s["start"]["heading_from"] == automatic.TOLD:
        return _told(s, initial)
    start = s["start"]
    source, sigma = int(start["heading_from"]), math.degrees(start["heading_std"])
    how = "at rest" if start["at_rest"] else "while moving"
    tilt = f"tilt by levelling {how}, one sigma {math.degrees(start['tilt_std']):.2g} deg"
    velocity = "velocity from the DVL" if start["velocity_told"] else "velocity unknown until a DVL"
    bias = "gyroscope bias " + ("from the rest" if start["at_rest"] else "as told")
    if source != automatic.UNKNOWN:
        heading = f"heading {_SOURCES[source]}, one sigma {sigma:.3g} deg"
        return Report("; ".join((heading, tilt, velocity, bias)), "")
    why, outcome = "", int(start["compass"])
    if outcome in _WHY:
        why = f" (no gyrocompassing: {_of_compass(s)})"
    text = "; ".join((f"heading unknown{why}", tilt, velocity, bias))
    if is_heading_known(s):
        return Report(text, "")
    now, remedy = math.degrees(_heading_sigma(s)), REMEDY.format(topic=initial.topic)
    return Report(text, f"heading unknown, one sigma {now:.3g} deg{why}: {remedy}")


def waits_for(parameters: FilterParameters) -> str:
    """What a filter that has not started waits for."""
    initial = parameters.initial
    text = {
        "auto": f"{initial.levelling_time:g} s of IMU samples whose specific force is gravity, and "
        "for a DVL velocity or for motion",
        "parameters": "the first IMU sample",
        "levelling": f"{initial.levelling_time:g} s of IMU samples at rest",
        "gyrocompassing": f"{initial.gyrocompass_time:g} s of IMU samples at rest",
        "topic": f"a message on {initial.topic}",
        "set_odometry": f"a message on {SET_ODOMETRY}",
    }[initial.mode]
    if initial.heading == "imu":
        text += f", with an orientation in {IMU} whose covariance[0] is not -1"
    if parameters.origin.source == "topic":
        text += f" and a fix on {FIX}"
    return text


def _told(s: State, initial: InitialParameters) -> Report:
    """Of the modes in which a heading is told, unless gyrocompassing has found one."""
    outcome = int(s["start"]["compass"])
    if outcome == gyrocompass.UNDECIDED:
        return Report("", "")
    number = math.degrees(s["start"]["compass_number"])
    if outcome == gyrocompass.FOUND:
        return Report(f"heading by gyrocompassing, one sigma {number:.3g} deg", "")
    sigma = math.degrees(initial.heading_std)
    text = f"heading as told, one sigma {sigma:.3g} deg: no gyrocompassing, {_of_compass(s)}"
    return Report(text, text)


def _of_compass(s: State) -> str:
    outcome, number = int(s["start"]["compass"]), float(s["start"]["compass_number"])
    if outcome == gyrocompass.INACCURATE:
        number = math.degrees(number)
    return _WHY[outcome].format(number=number)


def large_biases(filter_: Filter, s: State) -> list[str]:
    """The biases that are estimated beyond `SIGMAS` of their initial sigma, each in a sentence.

    The walk of a bias since the start belongs to its sigma.

    Args:
        filter_: The filter.
        s: An initialised state record.
    """
    parameters, vehicle, nav = filter_.parameters, filter_.vehicle, s["nav"]
    initial, noise = parameters.initial, parameters.process_noise
    seconds = (int(nav["time_ns"]) - int(nav["start_ns"])) * 1e-9
    to_imu = vehicle.axes.body @ vehicle.C_b_i.T
    found = []
    for name, unit, estimate, told, std, walk in (
        (
            "accelerometer",
            "m/s^2",
            nav["b_f"],
            initial.accelerometer_bias,
            initial.accelerometer_bias_std,
            noise.accelerometer_bias_walk,
        ),
        (
            "gyroscope",
            "rad/s",
            nav["b_w"],
            initial.gyroscope_bias,
            initial.gyroscope_bias_std,
            noise.gyroscope_bias_walk,
        ),
    ):
        off = np.abs(to_imu @ estimate - np.array(told))
        sigma = math.sqrt(std**2 + walk * seconds)
        axis = int(np.argmax(off))
        if sigma and off[axis] > SIGMAS * sigma:  # with 0 it is as told, but for rounding
            found.append(_large(name, unit, axis, off, sigma))
    return found


def _large(name: str, unit: str, axis: int, off: Array, sigma: float) -> str:
    return (
        f"{name} bias {'xyz'[axis]} is {off[axis]:.3g} {unit} from initial.{name}_bias, "
        f"{off[axis] / sigma:.1f} times its sigma: set initial.{name}_bias_std to that "
        "of the IMU, check its unit and mount"
    )
