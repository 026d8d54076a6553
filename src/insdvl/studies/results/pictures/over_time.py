"""Which comparisons are drawn over time, and the sentence above each.

The sentence is computed from the numbers of the comparison, so that it holds for other ones too.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from insdvl.studies.evaluation.approaches import BEST_CONSTANT, FIRST_CONSTANT, ORACLE
from insdvl.studies.results.targets import Documents, row

_LEARNED = "hcf default"
#: Rows of the plots.
DRAWN = (FIRST_CONSTANT, BEST_CONSTANT, _LEARNED, ORACLE)


def over_time(documents: Documents) -> dict[str, str]:
    """The sentences by part; one whose numbers are missing is left out."""
    found = {}
    for part, sentence in _SENTENCES.items():
        document = documents.get(part, {"rows": []})
        rows = {name: row(document, name) for name in DRAWN}
        # A row that failed in many runs has no ratios.
        if all(one is not None and ORACLE in one["ratio_to"] for one in rows.values()):
            found[part] = sentence(rows)
    return found


def _velocity(rows: Mapping[str, Any], scenario: str) -> str:
    over = {name: one["ratio_to"][ORACLE]["body_rmse"][0] for name, one in rows.items()}
    return (
        f"Scenario {scenario}: a learned Q has {over[_LEARNED]:.3f} of the velocity error of a "
        f"told one, and the published constant {over[FIRST_CONSTANT]:.2f}"
    )


def _heading(rows: Mapping[str, Any], walks: str) -> str:
    degrees = {name: f"{one['heading_rmse_deg']:.1f}" for name, one in rows.items()}
    return (
        f"{walks} the heading error is {degrees[_LEARNED]} deg (learned Q), {degrees[ORACLE]} "
        f"(told Q), {degrees[BEST_CONSTANT]} (best constant)"
    )


#: By part, which is also the name of the file. Only what a page shows is drawn.
_SENTENCES: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "varying-calibrated": partial(_velocity, scenario="varying"),
    "wide-calibrated": partial(_velocity, scenario="wide"),
    "constant-paper": partial(_heading, walks="With the published bias walks"),
    "constant-paper-no-walk": partial(_heading, walks="Without bias walks"),
}
