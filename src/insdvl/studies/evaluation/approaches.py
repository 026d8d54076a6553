"""The rows of the comparison: filters that differ in the source of their process noise.

Reports and the option --rows use the same names. Some rows are the best of several candidates,
chosen on seeds of their own: the best constant Q, the best innovation-adaptive filters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build, flatten
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.initial_errors import P_0
from insdvl.simulation.trajectories import AUV
from insdvl.studies.evaluation.sensors import Sensors
from insdvl.tuner.features.band_forms import least_band, median_of_spectrum, single_band
from insdvl.tuner.features.bands import NEAR
from insdvl.tuner.features.closed_form import degree_5
from insdvl.tuner.models import Model, ModelError, load_model
from insdvl.tuner.own import OwnEstimator
from insdvl.tuner.windows import Estimator

#: Parameters of the filter by preset: `calibrated` is this project's filter; `paper` is the
#: published one, which uses variances as densities and bias walks of density 0.001;
#: `paper-no-walk` is the same without bias walks, to show their effect.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "calibrated": {
        "error_state": "invariant",
        "process_noise.convention": "per_sample",
        "process_noise.accelerometer_bias_walk": 1e-9,
        "process_noise.gyroscope_bias_walk": 1e-13,
    },
    "paper": {
        "error_state": "ned",
        "process_noise.convention": "density",
        "process_noise.accelerometer_bias_walk": 1e-3,
        "process_noise.gyroscope_bias_walk": 1e-3,
    },
    "paper-no-walk": {
        "error_state": "ned",
        "process_noise.convention": "density",
        "process_noise.accelerometer_bias_walk": 0.0,
        "process_noise.gyroscope_bias_walk": 0.0,
    },
}

FIRST = (0.01, 0.001)  # the first published constant: variances of f_b [(m/s^2)^2], w_ib_b
SECOND = (0.2, 0.02)  # the second, 20 times the first

#: Model of each row with a process noise that was learned from white noise.
LEARNED = {
    "hcf paper": "paper",
    "hcf default": "default",
    "dnn": "dnn",
    "dnn default": "dnn-default",
}
#: The row of the model that was learned from vehicles, and its name.
BANDS = "bands"
#: The same, with a factor that the innovations tell.
BANDS_WITH_FACTOR = "bands with factor"
#: The same, at the level of the truth: with one factor for a mission, or one for each channel. They
#: show what a factor can gain, and are not among `ROWS`.
TRUE_FACTOR, TRUE_FACTORS = "bands with true factor", "bands with true factors"
#: The row whose vehicle has taught itself on other missions; not among `ROWS`, for it takes long.
TAUGHT = "taught"
CLOSED_FORM = "closed form"
SINGLE_BAND = "single band"
LEAST_BAND = "least band"
MEDIAN_OF_SPECTRUM = "median of spectrum"
ORACLE = "oracle"
#: The row whose filter has the true shaping states of the noise, see matched/.
MATCHED = "matched"
FIRST_CONSTANT = "constant 0.01/0.001"
SECOND_CONSTANT = "constant 0.2/0.02"
BEST_CONSTANT = "best constant"
BEST_CONSTANT_SRMSE = "best constant for SRMSE"
ZERO_VELOCITY = "zero velocity"
PERFECT_HEADING = "perfect heading"
_LITERAL = {f"adaptive xi={xi} literal": xi for xi in (1, 5)}
_FLOORED = {f"adaptive xi={xi} floored": xi for xi in (1, 5)}
BEST_XI = "adaptive best xi"
VARIATIONAL = "adaptive variational"
#: Sage and Husa, by the forms of the filter.
SAGE_HUSA = {"adaptive sage-husa Q": "sage_husa", "adaptive sage-husa Q and R": "sage_husa_r"}

#: All rows, in the order of the tables.
ROWS = (
    FIRST_CONSTANT,
    SECOND_CONSTANT,
    *_LITERAL,
    *_FLOORED,
    BEST_XI,
    VARIATIONAL,
    *SAGE_HUSA,
    "dnn",
    "dnn default",
    "hcf paper",
    "hcf default",
    BANDS,
    BANDS_WITH_FACTOR,
    BEST_CONSTANT,
    BEST_CONSTANT_SRMSE,
    CLOSED_FORM,
    SINGLE_BAND,
    LEAST_BAND,
    MEDIAN_OF_SPECTRUM,
    ORACLE,
    MATCHED,
    ZERO_VELOCITY,
    PERFECT_HEADING,
)
#: Rows that differ in the noise of the DVL alone, by its source; they are told the effective Q, but
#: for those whose Q and R are both learned. Of these, two have states for the DVL's slow error, and
#: two the factor.
R_NOMINAL, R_ORACLE = "R nominal", "R oracle"
R_LEARNED, R_ADAPTIVE = "R learned", "R adaptive"
R_LEARNED_RECEIVED, R_ADAPTIVE_RECEIVED = "R learned received", "R adaptive received"
BANDS_WITH_R = "bands with R adaptive"
BANDS_WITH_ERROR = "bands with R adaptive and DVL error"
#: Two whose filters learn a factor on the Q that they are told.
R_NOMINAL_WITH_FACTOR, R_ADAPTIVE_WITH_FACTOR = "R nominal with factor", "R adaptive with factor"
FACTOR_WITH_R = "bands with factor and R adaptive"
FACTOR_WITH_ERROR = "bands with factor and R adaptive and DVL error"
#: The rows whose Q and R are both learned, without the factor and with it.
WITH_R = (BANDS_WITH_R, BANDS_WITH_ERROR, FACTOR_WITH_R, FACTOR_WITH_ERROR)
R_SOURCES = {
    R_NOMINAL: "nominal",
    R_ADAPTIVE: "adaptive",
    R_LEARNED: "learned",
    R_ADAPTIVE_RECEIVED: "adaptive",
    R_LEARNED_RECEIVED: "learned",
    R_ORACLE: "nominal",
    R_NOMINAL_WITH_FACTOR: "nominal",
    R_ADAPTIVE_WITH_FACTOR: "adaptive",
    **dict.fromkeys(WITH_R, "adaptive"),
}
#: Those of them that also receive what the tuner learns from the pings.
R_RECEIVED = (R_ADAPTIVE_RECEIVED, R_LEARNED_RECEIVED)
#: Those of them with the factor.
_FACTORED = (R_NOMINAL_WITH_FACTOR, R_ADAPTIVE_WITH_FACTOR, FACTOR_WITH_R, FACTOR_WITH_ERROR)
#: Slow error of the DVL that the rows with states for it are told: sigma over that of the data
#: sheet's white noise, and time constant [s]. They are the middles of the ranges, 0.1 to 0.5 and 5
#: to 30 s in logarithm, of which `realistic` draws those of a vehicle: told, not learned.
_SLOW_ERROR, _SLOW_ERROR_TIME = 0.3, 12.0
#: Rows that need no filter of their own: they follow from the truth and the result of the oracle.
FLOORS = (ZERO_VELOCITY, PERFECT_HEADING)

#: Prefix of the row of a model that does not ship; the path of the model follows.
OWN_MODEL = "model "
#: Prefix of the row of an estimator of your own; its name follows.
OWN_ESTIMATOR = "estimator "

#: Samples in the window of the closed forms.
WINDOW = 200
#: The closed forms, and the largest number of samples that each uses.
_CLOSED_FORMS: Mapping[str, tuple[Estimator, int]] = {
    CLOSED_FORM: (degree_5, WINDOW),
    SINGLE_BAND: (single_band, NEAR),
    LEAST_BAND: (least_band, NEAR),
    MEDIAN_OF_SPECTRUM: (median_of_spectrum, NEAR),
}


@dataclass(frozen=True)
class Approach:
    """A filter and where its Q comes from.

    Attributes:
        name: Name of the row, or of the candidate.
        parameters: Parameters of the filter.
        q_source: The source of a received Q: the row of a learned model, of a closed form, or
            `ORACLE`; empty where the filter receives none; `MATCHED` for a filter of its own.
        told_r: Whether the filter receives the effective variances of the pings.
        q_factor: On the variances that it receives.
        tuned_r: Whether it receives the noise of the pings that the tuner learns.
    """

    name: str
    parameters: FilterParameters
    q_source: str = ""
    told_r: bool = False
    q_factor: float = 1.0
    tuned_r: bool = False


@dataclass(frozen=True)
class Setting:
    """Settings that all rows of a table share.

    Attributes:
        preset: Key of `PRESETS`.
        error_state: ``invariant`` or ``ned``; empty selects that of the preset.
        gate: Whether the chi-square gate is on.
        q_factor: Of the rows of `R_SOURCES`, on the variances that they are told.
        sensors: Of the vehicle.
    """

    preset: str
    error_state: str = ""
    gate: bool = False
    q_factor: float = 1.0
    sensors: Sensors = field(default_factory=Sensors)

    def filter(self, variances: Sequence[float] = FIRST, **values: Any) -> FilterParameters:
        """Parameters of a filter.

        Args:
            variances: Nominal variances of each axis of f_b and of w_ib_b.
            values: Further parameters of the group ``process_noise``, by name.
        """
        given = {
            **PRESETS[self.preset],
            "origin.latitude_deg": float(np.degrees(AUV.lat_0)),
            "origin.longitude_deg": float(np.degrees(AUV.lon_0)),
            "origin.height": AUV.h_0,
            **flatten(P_0, "initial."),
            "initial.mode": "set_odometry",
            "gate.enabled": self.gate,
            "dvl.covariance": "message",
            "dvl.noise_std": (self.sensors.dvl_std,) * 3,
            "process_noise.accelerometer_variance": (float(variances[0]),) * 3,
            "process_noise.gyroscope_variance": (float(variances[1]),) * 3,
        }
        if self.error_state:
            given["error_state"] = self.error_state
        grade = self.sensors.grade
        if grade is not None:
            given |= {
                "initial.accelerometer_bias_std": grade.accelerometer_bias,
                "initial.gyroscope_bias_std": grade.gyroscope_bias,
                "process_noise.accelerometer_bias_walk": 0.0,
                "process_noise.gyroscope_bias_walk": 0.0,
            }
        given |= {f"process_noise.{name}": value for name, value in values.items()}
        return build(FilterParameters, given)


def approach(name: str, setting: Setting) -> Approach:
    """The approach of a row whose parameters are not searched for."""
    if name == FIRST_CONSTANT:
        return Approach(name, setting.filter(FIRST))
    if name == SECOND_CONSTANT:
        return Approach(name, setting.filter(SECOND))
    if name in _LITERAL:
        return _adaptive(name, setting, FIRST, _LITERAL[name], "literal")
    if name in _FLOORED:
        return _adaptive(name, setting, FIRST, _FLOORED[name], "floored")
    if name in R_SOURCES:
        factor = name in _FACTORED
        parameters = setting.filter(source="oracle", adaptive_factor=factor)
        dvl = replace(parameters.dvl, noise_source=R_SOURCES[name])
        if name in (BANDS_WITH_ERROR, FACTOR_WITH_ERROR):
            dvl = replace(
                dvl,
                bias_model="gauss_markov",
                bias_std=(_SLOW_ERROR * setting.sensors.dvl_std,) * 3,
                bias_time_constant=_SLOW_ERROR_TIME,
            )
        parameters = replace(parameters, dvl=dvl)
        source = BANDS if name in WITH_R else ORACLE
        received = name in R_RECEIVED
        return Approach(name, parameters, source, name == R_ORACLE, setting.q_factor, received)
    if name == BANDS_WITH_FACTOR:
        return Approach(name, setting.filter(source="external", adaptive_factor=True), BANDS)
    source = "oracle" if name == ORACLE else "external"
    return Approach(name, setting.filter(source=source), name, told_r=name == ORACLE)


def _adaptive(
    name: str, setting: Setting, nominal: Sequence[float], xi: int, form: str
) -> Approach:
    parameters = setting.filter(nominal, source="adaptive", adaptive_window=xi, adaptive_form=form)
    return Approach(name, parameters)


#: Variances of the search for the best constant: decades around those of the scenarios, then steps
#: of a third of a decade around the best decade.
_F_DECADES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)
_W_DECADES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
_STEPS = tuple(10.0 ** (step / 3.0) for step in range(-1, 2))
#: Decades of the gyroscopes in the scenarios of `DRAWN`, whose gyroscopes are better.
_W_DECADES_DRAWN = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
_XI_GRID = (1, 2, 5, 10, 20, 50)
_TAU_GRID = (1.0, 3.0, 10.0, 30.0)
_FORGETTING_GRID = (0.95, 0.98, 0.99, 0.998)


def constants(
    setting: Setting, scenario: str, around: Approach | None = None
) -> tuple[Approach, ...]:
    """Candidates for the best constant Q: over decades, or in finer steps around the best one.

    For an IMU of a grade the decades are those of the scenario times the factors of the grade.
    """
    if around is None:
        grade = setting.sensors.grade
        of_f, of_w = (1.0, 1.0) if grade is None else grade.scale()
        decades = _W_DECADES_DRAWN if scenario in DRAWN else _W_DECADES
        grid = product([f * of_f for f in _F_DECADES], [w * of_w for w in decades])
    else:
        f, w = nominal(around)
        grid = product([f * step for step in _STEPS], [w * step for step in _STEPS])
    return tuple(Approach(f"{f:.3g}/{w:.3g}", setting.filter((f, w))) for f, w in grid)


def nominal(approach: Approach) -> tuple[float, float]:
    """Nominal variances of f_b and of w_ib_b."""
    noise = approach.parameters.process_noise
    return noise.accelerometer_variance[0], noise.gyroscope_variance[0]


def adaptives(setting: Setting, best: tuple[float, float]) -> dict[str, tuple[Approach, ...]]:
    """Candidates for the best innovation-adaptive filters, by row.

    Each window, prior and forgetting factor is tried with two nominal Q: the first published
    constant and the best constant.

    Args:
        setting: Setting of the table.
        best: Variances of the best constant.
    """
    xi = tuple(
        _adaptive(f"xi={n} floored, nominal {f:.3g}/{w:.3g}", setting, (f, w), n, "floored")
        for (f, w), n in product((FIRST, best), _XI_GRID)
    )
    tau = tuple(
        Approach(
            f"tau={tau:g}, nominal {f:.3g}/{w:.3g}",
            setting.filter(
                (f, w), source="adaptive", adaptive_form="variational", adaptive_prior=tau
            ),
        )
        for (f, w), tau in product((FIRST, best), _TAU_GRID)
    )
    sage_husa = {
        row: tuple(
            Approach(
                f"b={b:g}, nominal {f:.3g}/{w:.3g}",
                setting.filter(
                    (f, w), source="adaptive", adaptive_form=form, adaptive_forgetting=b
                ),
            )
            for (f, w), b in product((FIRST, best), _FORGETTING_GRID)
        )
        for row, form in SAGE_HUSA.items()
    }
    return {BEST_XI: xi, VARIATIONAL: tau, **sage_husa}


def model_of(row: str) -> str | None:
    """Name or path of the model of a row; None where the row has none."""
    if row.startswith(OWN_MODEL):
        return row.removeprefix(OWN_MODEL)
    of_bands = (BANDS, BANDS_WITH_FACTOR, TRUE_FACTOR, TRUE_FACTORS, *WITH_R)
    return BANDS if row in of_bands else LEARNED.get(row)


@cache
def model(row: str) -> Model | None:
    """The model of a row, read once; None where the row has none.

    Raises:
        ModelError: The model cannot be used.
    """
    name = model_of(row)
    return None if name is None else load_model(name)


def unavailable(rows: Sequence[str]) -> dict[str, str]:
    """Reason of each row that cannot be computed here."""
    reasons = {}
    for row in rows:
        try:
            model(row)
        except ModelError as error:
            reasons[row] = str(error)
    return reasons


def fingerprint(rows: Sequence[str]) -> dict[str, str]:
    """SHA-256 of the model, or of the file of the estimator, of each row that has one."""
    missing = unavailable(rows)
    models = {row: model(row) for row in rows if row not in missing}
    found = {row: one.card["sha256"] for row, one in models.items() if one is not None}
    own = {row: own_estimator(row) for row in rows}
    return found | {row: one.fingerprint for row, one in own.items() if one is not None}


@cache
def own_estimator(row: str) -> OwnEstimator | None:
    """The estimator of your own of a row, tried once; None where the row has none.

    Raises:
        EstimatorError: It cannot be used.
    """
    if not row.startswith(OWN_ESTIMATOR):
        return None
    return OwnEstimator(row.removeprefix(OWN_ESTIMATOR))


def estimator(row: str) -> tuple[Estimator, int, int]:
    """The estimator of a row with a learned Q or a closed form, with its samples.

    Returns:
        The estimator, and the least and the largest number of samples that it uses.

    Raises:
        ModelError: The model of the row cannot be used.
    """
    found = model(row)
    if found is not None:
        return found.variances, found.window, found.history
    estimate, history = _CLOSED_FORMS[row]
    return estimate, WINDOW, history
