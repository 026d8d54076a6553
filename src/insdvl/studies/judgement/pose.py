"""What a recorded reference says of heading, position and velocity, against the filter's sigmas.

The errors of one run are one realisation: near ones are alike, and those of the position grow out
of one another. So nothing is concluded from their number, see docs/explanation/verdict.md.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from insdvl.arrays import Array
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.start.automatic import UNKNOWN_HEADING, USEFUL_HEADING
from insdvl.studies.evaluation.metrics import attitude_error, path_length, rmse
from insdvl.studies.judgement.finding import Finding
from insdvl.studies.judgement.innovations import CHANCE, FACTOR
from insdvl.studies.replay.reference import AtReference
from insdvl.watch.start import REMEDY

#: Share of the time in which an error has to be beyond its bound.
SHARE = 0.1
#: Sigmas of that bound. An error of a right filter is beyond it for the share CHANCE * SHARE of the
#: time on average, however its values are correlated; so in at most CHANCE of the runs for SHARE.
BOUND = float(-ndtri(CHANCE * SHARE / 2.0))
#: What is set with care: a turn [rad], and what that and a scale of 1 % make of a distance.
CAREFUL_TURN = math.radians(1.0)
CAREFUL_SHARE = math.hypot(CAREFUL_TURN, 0.01)
#: Fewest stamps of the reference from which anything is concluded.
FEWEST = 30


@dataclass(frozen=True)
class PoseError:
    """An error against the reference while the filter knows the heading; rad or m.

    Attributes:
        rmse: Its root mean square.
        sigma: That of what filter and reference say of it.
        in_sigmas: It is beyond so many of these for the share `SHARE` of the time.
        matters: Whether it is then beyond what is set with care as well.
    """

    rmse: float
    sigma: float
    in_sigmas: float
    matters: bool

    @property
    def is_wrong(self) -> bool:
        """Whether it is beyond chance, and beyond what is set with care."""
        return self.matters and self.in_sigmas > FACTOR * BOUND


@dataclass(frozen=True)
class AgainstReference:
    """The errors of the pose; None for what the reference does not tell.

    Attributes:
        heading: [rad].
        position: Horizontal [m], about the offset while the heading was known first.
    """

    heading: PoseError | None
    position: PoseError | None


def against_reference(at: AtReference) -> AgainstReference | None:
    """The errors while the filter says that it knows the heading; None where these are too few.

    While it says that it does not, the heading is not wrong, and the path is turned with it.
    """
    known = at.heading_sigma < USEFUL_HEADING
    if np.count_nonzero(known) < FEWEST:
        return None
    heading = position = None
    told = at.told_sigma[:, 0]
    # An attitude that is never filled in is that without any turn.
    if (told < UNKNOWN_HEADING).all() and (at.truth.C_n_b != at.truth.C_n_b[0]).any():
        error = np.abs(attitude_error(at.track.C_n_b, at.truth.C_n_b)[:, 2])
        sigma = np.hypot(at.heading_sigma, told)
        heading = _error(error[known], sigma[known], CAREFUL_TURN)
    # The noise of either makes its own path longer.
    length = min(path_length(at.truth.p_o), path_length(at.track.p_o))
    if length > 0.0:
        # The origins may differ. The standard deviation of a difference is at most the sum of both.
        off = (at.truth.p_o - at.track.p_o)[:, :2]
        sigma = np.hypot(np.linalg.norm(at.sigma[:, 3:5], axis=1), at.told_sigma[:, 1])
        first = np.flatnonzero(known)[:FEWEST]
        error = np.linalg.norm(off - np.median(off[first], axis=0), axis=1)
        sigma = sigma + np.median(sigma[first])
        position = _error(error[known], sigma[known], CAREFUL_SHARE * length)
    return AgainstReference(heading, position)


def _error(error: Array, sigma: Array, careful: float) -> PoseError:
    """Of errors (N,) and their sigmas (N,)."""
    ratio = np.divide(error, sigma, out=np.full_like(error, np.inf), where=sigma > 0.0)
    # "higher": a number of the list, since there may be infinite ones among them.
    beyond = float(np.quantile(ratio, 1.0 - SHARE, method="higher"))
    large = float(np.quantile(error, 1.0 - SHARE))
    return PoseError(rmse(error), rmse(sigma), beyond, large > careful)


def of_pose(
    reference: AgainstReference | None, document: dict[str, Any], parameters: FilterParameters
) -> Iterator[Finding]:
    """Heading and position that are off by more than the filter says."""
    if reference is None:
        return
    heading, position = reference.heading, reference.position
    is_turned = heading is not None and heading.is_wrong
    if is_turned and heading:
        text = (
            f"the heading is {math.degrees(heading.rmse):.3g} deg off the reference (RMSE), and "
            f"the filter says a sigma of {math.degrees(heading.sigma):.2g} deg"
        )
        if (document["start"] or "").startswith("heading unknown"):
            remedy = f"it was found wrongly while moving; {REMEDY}".format(
                topic=parameters.initial.topic
            )
        else:
            remedy = "check what told it at the start, initial.heading_std and the gyroscope"
        yield Finding("heading_error", text, f"{remedy}; or the axes of the reference are others")
    # A jump of odom is none of the filter's errors.
    if position and position.is_wrong and not document["counts"].get("odom_resets"):
        text = (
            f"the position is {position.rmse:.3g} m off the reference (RMSE), and the filter says "
            f"a sigma of {position.sigma:.2g} m"
        )
        remedy = (
            "it follows from the heading"
            if is_turned
            else "check the scale of the DVL (speed of sound), the yaw of dvl.mount and the axes "
            "of the reference"
        )
        yield Finding("position_error", text, remedy)


def of_velocity(document: dict[str, Any]) -> Iterator[Finding]:
    """Velocity in body axes that is off by more than the filter says."""
    inside = document["body_velocity_inside_3_sigma"]
    if inside is not None and inside < 0.9:
        yield Finding(
            "reference",
            f"only {100.0 * inside:.0f} % of the velocity errors against the reference are within "
            "3 sigma",
            "check the reference's axes and stamps, then the noise of IMU and DVL",
        )
