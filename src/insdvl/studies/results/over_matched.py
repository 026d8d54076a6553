"""The table that compares the white oracle with the filter that has the true shaping states."""

from collections.abc import Sequence

from insdvl.studies.report.markdown import interval, number, table
from insdvl.studies.results.targets import Documents, row

_OVER_MATCHED = """## White oracle over matched

`matched` is the filter that has the true shaping states of the simulated noise
([effective-noise.md](../explanation/effective-noise.md#9-the-lower-bound)). The ratio of
the oracle's error to its error is what white densities cost.

"""


def over_matched(documents: Documents, scenarios: Sequence[str]) -> list[str]:
    """How far the white oracle is from the filter that has the true shaping states.

    Args:
        documents: Numbers by part.
        scenarios: Those of the page on noise that is not white.

    Returns:
        The part of the page; none where no scenario has both rows.
    """
    body = []
    for scenario in scenarios:
        document = documents.get(f"{scenario}-spectrum", {"rows": []})
        oracle, matched = (row(document, name) for name in ("oracle", "matched"))
        if oracle is None or matched is None:
            continue
        ratio = oracle["ratio_to"]["matched"]
        nees = (number(r["nees_per_dof"]["velocity"], 3) for r in (oracle, matched))
        cells = (interval(ratio[metric], 4) for metric in ("body_rmse", "srmse"))
        body.append([f"`{scenario}`", *cells, *nees])
    if not body:
        return []
    head = ["scenario", "body velocity", "SRMSE", "NEES velocity: oracle", "matched"]
    return [_OVER_MATCHED + table(head, body)]
