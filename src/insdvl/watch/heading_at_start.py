"""What an operator is told of the heading with which a filter started by gyrocompassing."""

import math

from insdvl.navigation.start import gyrocompass
from insdvl.navigation.start.parameters import InitialParameters
from insdvl.navigation.state import State

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


def heading_at_start(s: State, initial: InitialParameters) -> tuple[bool, str] | None:
    """Whether gyrocompassing has found the heading, and a sentence; None if it did not decide.

    Args:
        s: An initialised state record.
        initial: Parameters of the start.
    """
    outcome, number = int(s["start"]["compass"]), float(s["start"]["compass_number"])
    if outcome == gyrocompass.UNDECIDED:
        return None
    if outcome == gyrocompass.FOUND:
        return True, f"heading by gyrocompassing, one sigma {math.degrees(number):.3g} deg"
    if outcome == gyrocompass.INACCURATE:
        number = math.degrees(number)
    sigma = math.degrees(initial.heading_std)
    why = _WHY[outcome].format(number=number)
    return False, f"heading as told, one sigma {sigma:.3g} deg: no gyrocompassing, {why}"
