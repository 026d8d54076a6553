"""Where the process noise comes from.

The state record holds the variances in effect (``Q_f``, ``Q_w``), the stamp of a received Q
(``q_ns``) and, for the innovation-adaptive source, a density in the model's coordinates (``root``).
These modules are the only ones that write them, apart from the time-out in the prediction kernel.

Sources: `constant` keeps the nominal; `external`, `message` and `oracle` receive a `ProcessNoise`;
`adaptive` estimates from the innovations: Q itself, Q and R, or what a wrong Q has made of the
predicted covariance. Beside any source but `adaptive`, `factor` scales Q as the innovations tell.
"""

from insdvl.navigation.measurements.base import Vehicle
from insdvl.navigation.process_noise.adaptive import InnovationAdaptive
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.process_noise.received import ProcessNoiseSource
from insdvl.navigation.process_noise.sage_husa import SageHusa
from insdvl.navigation.process_noise.variational import Variational


def source_of(parameters: ProcessNoiseParameters, vehicle: Vehicle) -> ProcessNoiseSource:
    """The source that the parameters ask for."""
    if parameters.source != "adaptive":
        return ProcessNoiseSource(parameters, vehicle.C_b_i)
    if parameters.adaptive_form == "variational":
        return Variational(parameters, vehicle.C_b_i)
    if parameters.adaptive_form.startswith("sage_husa"):
        return SageHusa(parameters, vehicle, with_r=parameters.adaptive_form == "sage_husa_r")
    return InnovationAdaptive(parameters, vehicle.C_b_i)
