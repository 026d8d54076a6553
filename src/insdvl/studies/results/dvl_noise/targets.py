"""The targets of the study, set before the measurement."""

from dataclasses import dataclass

from insdvl.studies.evaluation.approaches import (
    R_ADAPTIVE,
    R_ADAPTIVE_WITH_FACTOR,
    R_LEARNED,
    R_NOMINAL,
    R_ORACLE,
)
from insdvl.studies.report.markdown import interval
from insdvl.studies.results.dvl_noise.study import (
    FOG,
    GATE,
    LARGE_Q,
    LEFT_OUT,
    OUTLIERS,
    OWN_REFERENCES,
    PLAIN,
    RATES,
    SMALL_Q,
    TACTICAL,
)
from insdvl.studies.results.dvl_noise.tables import ratio
from insdvl.studies.results.targets import Documents, Target


@dataclass(frozen=True)
class Limit:
    """What the upper end of the interval of a ratio may be.

    Attributes:
        scenario: Of the comparison.
        condition: Of the comparison.
        reference: What the error is compared with: a row of the same comparison, or the same row
            in one of the `OWN_REFERENCES`.
        limit: At most this.
    """

    scenario: str
    condition: str
    reference: str
    limit: float


LIMITS = (
    Limit(TACTICAL, PLAIN, R_ORACLE, 1.03),
    Limit(FOG, PLAIN, R_ORACLE, 1.10),
    *(Limit(scenario, GATE, PLAIN, 1.02) for scenario in RATES),
    *(Limit(scenario, OUTLIERS, LEFT_OUT, 1.05) for scenario in RATES),
    *(
        Limit(scenario, condition, R_NOMINAL, 1.02)
        for scenario in RATES
        for condition in (SMALL_Q, LARGE_Q)
    ),
)


def _target(approach: str, of: Limit) -> Target:
    """That of a row; beside its ratio stands that of the oracle, which is told R."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        if "dvl-noise" not in documents:
            return None
        document = documents["dvl-noise"]
        found, oracle = (
            ratio(document, of.scenario, of.condition, row, of.reference)
            for row in (approach, R_ORACLE)
        )
        text = interval(found)
        if of.reference != R_ORACLE:
            text += f" (oracle {interval(oracle)})"
        # A row that is missing or has failed meets no target.
        return text, found is not None and found[2] <= of.limit

    own = of.reference in OWN_REFERENCES
    words = f"itself with {of.reference}" if own else f"`{of.reference}`"
    where = f"`{of.scenario}`, {of.condition}"
    return Target(f"{where}: `{approach}` over {words}, at most {of.limit:.2f}", measured)


OF_DVL_NOISE = tuple(
    _target(approach, limit)
    for approach in (R_ADAPTIVE, R_ADAPTIVE_WITH_FACTOR, R_LEARNED)
    for limit in LIMITS
)
