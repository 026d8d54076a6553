"""The published P_0, and initial states whose errors are drawn from it: the one place for both."""

import math

import numpy as np

from insdvl.navigation.events import Initial
from insdvl.navigation.geometry.frames import rotation_from_vector
from insdvl.navigation.parameters import InitialParameters
from insdvl.simulation.motion import Truth

#: The published initial uncertainty, with which evaluation, fault flights and demo are flown. The
#: defaults of `InitialParameters` have the biases of a MEMS.
P_0 = InitialParameters(
    mode="parameters",
    velocity_std=0.1,
    tilt_std=math.radians(0.5),
    heading_std=math.radians(1.0),
    accelerometer_bias_std=1e-3,
    gyroscope_bias_std=1e-5,
    position_std=0.1,
)

_DOWN = np.array([0.0, 0.0, 1.0])


def drawn_initial(
    truth: Truth,
    sigma: InitialParameters,
    rng: np.random.Generator,
    *,
    stamp_ns: int = 0,
    with_position: bool = True,
    uniform_heading: bool = False,
) -> Initial:
    """The truth with a random error of attitude, position and velocity.

    The errors are independent, in this order of draws: tilt and heading, position, velocity in the
    frame ``sigma.velocity_frame``. The true attitude is R_h R_t times the drawn one, with the
    heading error R_h and the tilt R_t, as in the error state (navigation/coordinates.py).

    Args:
        truth: Its first state is used.
        sigma: Standard deviations and the frame of the velocity.
        rng: Generator of the draws.
        stamp_ns: Stamp of the event.
        with_position: False keeps the true position and draws nothing for it.
        uniform_heading: Draws a heading error that is uniform within +-pi, in place of the normal
            one; all other errors are the same.
    """
    C_o_b, v_b = truth.C_o_b[0], truth.C_n_b[0].T @ truth.v_n[0]
    psi = rng.standard_normal(3) * sigma.attitude_std
    if uniform_heading:
        psi[2] = rng.uniform(-math.pi, math.pi)
    error = rotation_from_vector(psi * _DOWN) @ rotation_from_vector(psi * (1.0 - _DOWN))
    p_o = truth.p_o[0]
    if with_position:
        p_o = p_o + sigma.position_std * rng.standard_normal(3)
    v = v_b if sigma.velocity_frame == "body" else C_o_b @ v_b
    return Initial(
        stamp_ns=stamp_ns,
        C_o_b=error.T @ C_o_b,
        p_o=p_o,
        v=v + sigma.velocity_std * rng.standard_normal(3),
        velocity_frame=sigma.velocity_frame,
    )
