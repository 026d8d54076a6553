"""Tables of a comparison, as Markdown."""

from collections.abc import Mapping
from typing import Any

from insdvl.studies.evaluation.approaches import FIRST_CONSTANT, SECOND_CONSTANT, ZERO_VELOCITY
from insdvl.studies.report.markdown import interval, number, table

#: Or and Klein, Table II: SRMSE and SMAE [m/s].
PUBLISHED = {
    FIRST_CONSTANT: (1.082, 0.961),
    SECOND_CONSTANT: (1.142, 0.992),
    "adaptive xi=1 literal": (1.127, 0.983),
    "adaptive xi=5 literal": (1.085, 0.908),
    "dnn": (1.055, 0.928),
    "hcf paper": (0.980, 0.866),
}


#: Reference and error of each ratio in a table.
_RATIOS = (
    ("oracle", "body_rmse"),
    ("oracle", "srmse"),
    ("matched", "body_rmse"),
    ("best constant", "body_rmse"),
    ("best constant for SRMSE", "srmse"),
    ("first constant", "body_rmse"),
    ("first constant", "srmse"),
    ("closed form", "body_rmse"),
    ("R oracle", "body_rmse"),
    ("R nominal", "body_rmse"),
)
_WORDS = {"body_rmse": "body velocity", "srmse": "SRMSE"}


def comparison_tables(document: Mapping[str, Any]) -> str:
    """The tables of a comparison: errors, ratios, consistency, notes."""
    parts = [_errors(document), _ratios(document), _consistency(document), _notes(document)]
    return "\n".join(parts)


def _errors(document: Mapping[str, Any]) -> str:
    """Mean errors of each row with their 95 % intervals, and the published numbers."""
    metrics = ("body_rmse", "srmse", "smae", "heading_rmse_deg", "tilt_rmse_deg")
    with_depth = any("depth_rmse" in row for row in document["rows"])
    head = [
        "approach",
        "body velocity RMSE [m/s]",
        "SRMSE [m/s]",
        "SMAE [m/s]",
        "heading [deg]",
        "tilt [deg]",
        "drift [%]",
        *(["depth [m]"] if with_depth else []),
        "failures",
        "published SRMSE / SMAE",
    ]
    body = []
    for row in document["rows"]:
        name = row["approach"]
        cells = [_with_ends(row, metric, 3 if "deg" in metric else 4) for metric in metrics]
        drift = _with_ends(row, "position_drift_percent", 1)
        if name == ZERO_VELOCITY:  # it has none of these
            cells[3:], drift = ["–", "–"], "–"
        depth = [_with_ends(row, "depth_rmse", 3)] if with_depth else []
        published = PUBLISHED.get(name)
        body.append(
            [
                _settings(document, name),
                *cells,
                drift,
                *depth,
                str(row["failures"]),
                f"{published[0]:.3f} / {published[1]:.3f}" if published else "",
            ]
        )
    return table(head, body)


def _with_ends(row: Mapping[str, Any], metric: str, digits: int) -> str:
    if row[metric] is None:
        middle = row["median"][metric]
        return "–" if middle is None else f"median {number(middle, digits)}"
    low, high = row["interval"][metric]
    return interval((row[metric], low, high), digits)


def _settings(document: Mapping[str, Any], name: str) -> str:
    found = document["searches"].get(name)
    return f"{name} ({found['best']})" if found else name


def _ratios(document: Mapping[str, Any]) -> str:
    """Paired ratios of the mean errors, with 95 % intervals."""
    there = {label for row in document["rows"] for label in row["ratio_to"]}
    columns = [(label, metric) for label, metric in _RATIOS if label in there]
    body = []
    for row in document["rows"]:
        ratio = row["ratio_to"]
        cells = [interval(ratio[label][metric] if ratio else None) for label, metric in columns]
        body.append([row["approach"], *cells])
    return table(["approach", *(f"{_WORDS[m]} / {label}" for label, m in columns)], body)


def _consistency(document: Mapping[str, Any]) -> str:
    """Time means of NEES per degree of freedom and of NIS (3 degrees of freedom)."""
    blocks = ("velocity", "attitude", "velocity_attitude", "bias", "position")
    head = [
        "approach",
        *(f"NEES {block.replace('_', ' and ')}" for block in blocks),
        "NIS",
        "innovation autocorrelation",
    ]
    body = [
        [
            row["approach"],
            *(number(row["nees_per_dof"][block], 3) for block in blocks),
            number(row["nis"], 3),
            number(row["innovation_autocorrelation"], 3),
        ]
        for row in document["rows"]
        if row["nis"] is not None or row["failures"]
    ]
    return table(head, body)


def _notes(document: Mapping[str, Any]) -> str:
    """The runs behind the numbers, and the rows that are missing."""
    plan = document["plan"]
    lines = [
        f"Scenario {plan['scenario']}, preset {plan['setting']['preset']}, seed {plan['seed']}: "
        f"means over the {document['paired_runs']} of {document['runs']} runs in which no row "
        "failed, not counting rows that fail in more than a tenth of all runs."
    ]
    lines += [f"Left out: {row} ({reason})." for row, reason in document["omitted"].items()]
    return "\n".join(lines) + "\n"
