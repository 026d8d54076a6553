"""Tables of the study on recordings, as Markdown."""

from collections.abc import Mapping
from typing import Any

from insdvl.studies.report.markdown import interval, number, table
from insdvl.studies.results.vehicle_runs import AS_RECORDED, ERRORS, HAND_SET, METRICS

#: Numbers of the recordings as they are that have no ratio.
_CONSISTENCY = tuple(name for name in AS_RECORDED if name not in ERRORS)


def vehicle_tables(document: Mapping[str, Any]) -> str:
    """The tables of the study."""
    parts = []
    for name, numbers in document["injections"].items():
        (acc_low, acc_high), (gyr_low, gyr_high) = numbers["limits"]
        parts.append(
            f"Injected noise `{name}`, variances in [{acc_low:g}, {acc_high:g}] (m/s^2)^2 and "
            f"[{gyr_low:g}, {gyr_high:g}] (rad/s)^2: means over {len(document['recordings'])} "
            f"recordings and {document['runs']} seeds.\n"
        )
        parts.append(_means(numbers["rows"]))
        references = numbers["ratio_to"]
        for metric in ("body_velocity_rmse", "velocity_rmse"):
            parts.append(f"Ratios of the mean {METRICS[metric].split(' [')[0]} errors.\n")
            parts.append(
                table(
                    ["row", *(f"to {reference}" for reference in references)],
                    [
                        [
                            row,
                            *(
                                interval(ratios[row][metric] if row in ratios else None)
                                for ratios in references.values()
                            ),
                        ]
                        for row in numbers["rows"]
                    ],
                )
            )
    clean = document["as_recorded"]
    parts.append("As recorded: means over the recordings.\n")
    parts.append(_means(clean["rows"]))
    ratios = clean["ratio_to"][HAND_SET]
    parts.append(f"Ratios of the errors to those of {HAND_SET}, as recorded.\n")
    names = document["recordings"]
    parts.append(
        table(
            ["row", "all", *names],
            [
                [
                    f"{row}, {METRICS[metric].split(' [')[0]}",
                    interval(ratios[row][metric]),
                    *(
                        number(
                            clean["rows"][row][metric][name]
                            / clean["rows"][HAND_SET][metric][name],
                            3,
                        )
                        for name in names
                    ),
                ]
                for row in ratios
                for metric in ERRORS
            ],
        )
    )
    parts.append("Consistency as recorded.\n")
    parts.append(
        table(
            ["row", *names],
            [
                [
                    f"{row}, {AS_RECORDED[metric]}",
                    *(number(numbers[metric][name], 3) for name in names),
                ]
                for row, numbers in clean["rows"].items()
                for metric in _CONSISTENCY
            ],
        )
    )
    return "\n".join(parts)


def _means(rows: Mapping[str, Any]) -> str:
    return table(
        ["row", *METRICS.values()],
        [[row, *(number(values[m]["mean"]) for m in METRICS)] for row, values in rows.items()],
    )
