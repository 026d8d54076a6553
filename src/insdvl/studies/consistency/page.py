"""The page docs/results/consistency.md, written from its numbers."""

from collections.abc import Mapping
from typing import Any

from insdvl.studies.consistency.gyrocompassing import GYROCOMPASSING_STUDY
from insdvl.studies.consistency.heading import HEADING_STUDY
from insdvl.studies.consistency.outage import OUTAGE_STUDY
from insdvl.studies.consistency.position import POSITION_STUDY
from insdvl.studies.consistency.sensitivity import SENSITIVITY_STUDY
from insdvl.studies.consistency.table import BLOCK_STUDY

#: The sections of the page, in their order.
STUDIES = (
    BLOCK_STUDY,
    POSITION_STUDY,
    OUTAGE_STUDY,
    GYROCOMPASSING_STUDY,
    HEADING_STUDY,
    SENSITIVITY_STUDY,
)


def consistency_page(studies: Mapping[str, Any]) -> str:
    """The page; a study whose numbers are missing is named.

    Args:
        studies: Numbers by the name of the study.
    """
    parts = [_INTRODUCTION]
    for study in STUDIES:
        if study.name in studies:
            parts.append(study.section(studies[study.name]))
        else:
            parts.append(f"Not computed: {study.name}.")
    return "\n".join(part.strip() + "\n" for part in parts)


_INTRODUCTION = """
# Consistency

Is the filter as good as it says? Simulated missions with a known truth, many of each, against the
covariance of the filter. One command flies them and writes this page:

```
make consistency                            # everything
make consistency ARGS="--quick --out DIR"   # a few runs of some rows, elsewhere
```

NEES is $e^T P^{-1} e$ per degree of freedom, 1 on average for a consistent filter, above 1 for an
overconfident one. The numbers behind the tables, with those of every run, the seeds and the
versions, are in [consistency.json](consistency.json). What the results mean is in
[README.md](README.md#consistency).
"""
