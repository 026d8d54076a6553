"""Where the process noise comes from.

The state record holds the variances in effect (``Q_f``, ``Q_w``), the stamp of a received Q
(``q_ns``) and, for the innovation-adaptive source, a density in the model's coordinates (``root``).
These modules are the only ones that write them, apart from the time-out in the prediction kernel.

Sources: `constant` keeps the nominal; `external`, `message` and `oracle` receive a `ProcessNoise`;
`adaptive` estimates from the innovations: Q itself, or what a wrong Q has made of the predicted
covariance.
"""

from insdvl.arrays import Array
from insdvl.navigation.process_noise.adaptive import InnovationAdaptive
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.process_noise.received import ProcessNoiseSource
from insdvl.navigation.process_noise.variational import Variational


def source_of(parameters: ProcessNoiseParameters, C_b_i: Array) -> ProcessNoiseSource:
    """The source that the parameters ask for.

    Args:
        parameters: Of the process noise.
        C_b_i: (3, 3) rotation from IMU to base_link axes.
    """
    if parameters.source != "adaptive":
        return ProcessNoiseSource(parameters, C_b_i)
    if parameters.adaptive_form == "variational":
        return Variational(parameters, C_b_i)
    return InnovationAdaptive(parameters, C_b_i)
