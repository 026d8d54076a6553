"""The targets of the results, judged by the numbers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from insdvl.studies.evaluation.approaches import (
    BANDS,
    BANDS_WITH_FACTOR,
    ORACLE,
    WITH_R,
)
from insdvl.studies.report.markdown import interval, table

Documents = Mapping[str, Any]


@dataclass(frozen=True)
class Target:
    """A target, set before the measurement.

    Attributes:
        text: The target in words.
        measured: The number as text, and whether it meets the target; None where it is missing.
    """

    text: str
    measured: Callable[[Documents], tuple[str, bool] | None]


def row(document: Mapping[str, Any], approach: str) -> Mapping[str, Any] | None:
    """A row of a comparison; None where it is missing."""
    return next((r for r in document["rows"] if r["approach"] == approach), None)


def _ratio(
    part: str,
    reference: str,
    metric: str,
    limit: float,
    model: str = "hcf default",
    words: str = "learned",
) -> Target:
    """The upper end of the interval of a paired ratio of a learned model."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        document = documents.get(part, {"rows": []})
        learned, oracle = row(document, model), row(document, "oracle")
        if learned is None or oracle is None or reference not in learned["ratio_to"]:
            return None
        ratio = learned["ratio_to"][reference][metric]
        text = interval(ratio)
        if reference != "oracle":
            text += f" (oracle {interval(oracle['ratio_to'][reference][metric])})"
        return text, ratio[2] <= limit

    scenario = part.rpartition("-")[0]
    name = {"body_rmse": "body velocity", "srmse": "SRMSE"}[metric]
    return Target(f"`{scenario}`: {name}, {words} / {reference}, at most {limit:g}", measured)


def _nees(part: str, block: str) -> Target:
    def measured(documents: Documents) -> tuple[str, bool] | None:
        if part not in documents:
            return None
        learned, oracle = (row(documents[part], name) for name in ("hcf default", "oracle"))
        if learned is None or oracle is None:
            return None
        value, best = learned["nees_per_dof"][block], oracle["nees_per_dof"][block]
        holds = 0.93 <= value <= 1.10 or abs(value - 1.0) <= abs(best - 1.0)
        return f"{value:.3f} (oracle {best:.3f})", holds

    scenario, words = part.removesuffix("-calibrated"), block.replace("_", " and ")
    return Target(
        f"`{scenario}`: NEES per degree of freedom, {words}, in [0.93, 1.10] or as good as the "
        "oracle's",
        measured,
    )


def _accuracy_of(span: str, words: str, limit: float) -> Target:
    def measured(documents: Documents) -> tuple[str, bool] | None:
        rows = documents.get("q-accuracy", {"rows": []})["rows"]
        learned = next((r for r in rows if r["estimator"] == "hcf default"), None)
        if learned is None:
            return None
        error = learned["auv"][span]["all"]["relative_rmse"]
        return f"{100.0 * error:.1f} %", error <= limit

    return Target(f"relative RMSE of q, {words}, at most {100.0 * limit:.1f} %", measured)


def _injected(reference: str, limit: float) -> Target:
    def measured(documents: Documents) -> tuple[str, bool] | None:
        if "vehicle" not in documents:
            return None
        ratios = documents["vehicle"]["injections"]["sensor"]["ratio_to"][reference]
        ratio = ratios["hcf default"]["body_velocity_rmse"]
        return interval(ratio), ratio[0] <= limit

    return Target(
        f"recordings with injected noise: body velocity, learned / {reference}, paired mean at "
        f"most {limit:g}",
        measured,
    )


def drawn(name: str, row_: str) -> Target:
    """On recordings with noise of a scenario that is not white."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        found = documents.get("vehicle", {"injections": {}})["injections"].get(name)
        if found is None or row_ not in found["ratio_to"]["best constant"]:
            return None
        ratios = found["ratio_to"]["best constant"]
        ratio, told = (ratios[of]["body_velocity_rmse"] for of in (row_, "told with hand-set"))
        return f"{interval(ratio)} (told with hand-set {interval(told)})", ratio[0] <= 0.94

    return Target(
        f"recordings with `{name}` noise injected: body velocity, `{row_}` / best constant, paired "
        "mean at most 0.94",
        measured,
    )


def harmless(
    metric: str,
    words: str,
    row_: str = "hcf default",
    called: str = "learned",
    limits: tuple[float, float] = (1.01, 1.03),
) -> Target:
    """At most so much of hand-set noise on the mean of the recordings, and on each."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        if "vehicle" not in documents:
            return None
        rows = documents["vehicle"]["as_recorded"]["rows"]
        if row_ not in rows:
            return None
        learned, hand_set = (rows[name][metric] for name in (row_, "hand-set"))
        each = {name: learned[name] / hand_set[name] for name in learned if name != "mean"}
        mean = documents["vehicle"]["as_recorded"]["ratio_to"]["hand-set"][row_][metric][0]
        worst = max(each, key=each.__getitem__)
        text = f"{mean:.3f}; largest {each[worst]:.3f} ({worst})"
        return text, mean <= limits[0] and each[worst] <= limits[1]

    return Target(
        f"recordings as they are: {words}, {called} / hand-set, at most {limits[0]:g} on the mean "
        f"and {limits[1]:g} on each",
        measured,
    )


TARGETS = (
    _accuracy_of("in range", "in the range of the training", 0.104),
    _accuracy_of("1/1000", "at variances 1000 times smaller", 0.11),
    _accuracy_of("x 10", "at variances 10 times larger", 0.11),
    *(
        _ratio(f"{scenario}-calibrated", "oracle", metric, limit)
        for scenario, limit in (
            ("constant", 1.01),
            ("constant-tableI", 1.01),
            ("varying", 1.01),
            ("wide", 1.02),
        )
        for metric in ("body_rmse", "srmse")
    ),
    *(
        _ratio(f"{scenario}-calibrated", reference, metric, limit)
        for scenario, limit in (("varying", 0.98), ("wide", 0.90))
        for reference, metric in (
            ("best constant", "body_rmse"),
            ("best constant", "srmse"),
            ("best constant for SRMSE", "srmse"),
        )
    ),
    _ratio("varying-calibrated", "first constant", "srmse", 0.80),
    *(
        _nees(f"{scenario}-calibrated", block)
        for scenario in ("varying", "wide")
        for block in ("velocity", "attitude", "velocity_attitude")
    ),
    _injected("told", 1.02),
    _injected("best constant", 0.85),
    harmless("body_velocity_rmse", "body velocity"),
    harmless("velocity_rmse", "NED velocity"),
    harmless("position_rmse_horizontal", "horizontal position"),
)


def _of_bands(scenario: str, row_: str) -> tuple[Target, ...]:
    """Targets of the model `bands`, by a row that has it, on noise that is not white."""
    part = f"{scenario}-spectrum"

    def gain(documents: Documents) -> tuple[str, bool] | None:
        found = [row(documents.get(part, {"rows": []}), name) for name in (row_, "oracle")]
        if found[0] is None or found[1] is None or "best constant" not in found[0]["ratio_to"]:
            return None
        (to_constant, to_oracle, best) = (
            found[0]["ratio_to"]["best constant"]["body_rmse"],
            found[0]["ratio_to"]["oracle"]["body_rmse"],
            found[1]["ratio_to"]["best constant"]["body_rmse"],
        )
        near = best[0] > 0.92 and to_oracle[2] <= 1.02
        text = f"{interval(to_constant)}; {interval(to_oracle)} (oracle {interval(best)})"
        return text, to_constant[2] <= 0.94 or near

    return (
        Target(
            f"`{scenario}`: body velocity, `{row_}` / best constant at most 0.94, or over the "
            "oracle at most 1.02 where the oracle itself is above 0.92",
            gain,
        ),
        _ratio(part, "closed form", "body_rmse", 0.9, row_, f"`{row_}`"),
        _consistent(scenario, row_),
    )


def _consistent(scenario: str, row_: str) -> Target:
    low, high = (0.85, 1.15) if scenario == "coloured" else (0.9, 1.1)

    def measured(documents: Documents) -> tuple[str, bool] | None:
        learned = row(documents.get(f"{scenario}-spectrum", {"rows": []}), row_)
        if learned is None:
            return None
        value = learned["nees_per_dof"]["velocity"]
        return f"{value:.3f}", low <= value <= high

    words = f"NEES per degree of freedom, velocity, `{row_}`, in [{low:g}, {high:g}]"
    return Target(f"`{scenario}`: {words}", measured)


def _gap_closed(row_: str) -> Target:
    """Of learned Q and learned R together: how much of what the oracle gains."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        document = documents.get("realistic-spectrum", {"rows": []})
        learned, oracle = row(document, row_), row(document, ORACLE)
        if learned is None or oracle is None:
            return None
        ratio, best = (r["ratio_to"]["best constant"]["body_rmse"] for r in (learned, oracle))
        gap = 1.0 - best[0]
        share, least = ((1.0 - x) / gap if gap > 0.0 else 0.0 for x in (ratio[0], ratio[2]))
        text = f"{interval(ratio)}, {100.0 * share:.0f} % (oracle {interval(best)})"
        return text, ratio[2] <= 0.85 or (best[0] > 0.80 and least >= 0.75)

    return Target(
        f"`realistic`: body velocity, `{row_}` / best constant, at most 0.85, or at least 75 % of "
        "the gap to the oracle where the oracle is above 0.80",
        measured,
    )


#: Of the page on noise that is not white.
OF_SPECTRUM = (
    *(
        target
        for name in ("vibrating", "coloured", "realistic")
        for row_ in (BANDS, BANDS_WITH_FACTOR)
        for target in _of_bands(name, row_)
    ),
    *(target for row_ in WITH_R for target in (_gap_closed(row_), _consistent("realistic", row_))),
    *(
        drawn(name, row_)
        for name in ("vibrating", "coloured")
        for row_ in (BANDS, BANDS_WITH_FACTOR)
    ),
    *(
        _ratio("waves-spectrum", "best constant", "body_rmse", 1.0, row_, f"`{row_}`")
        for row_ in (BANDS, BANDS_WITH_FACTOR)
    ),
    *(
        target
        for scenario, limit in (("varying", 1.003), ("wide", 1.008))
        for target in (
            *(
                _ratio(f"{scenario}-spectrum", "oracle", "body_rmse", limit, row_, f"`{row_}`")
                for row_ in (BANDS, BANDS_WITH_FACTOR)
            ),
            _ratio(f"{scenario}-calibrated", "oracle", "body_rmse", limit, words="`default`"),
        )
    ),
)


def targets_table(documents: Documents, targets: Sequence[Target]) -> str:
    """The table of targets, with a verdict where the numbers are there."""
    body = []
    for target in targets:
        found = target.measured(documents)
        value, met = ("not computed", "") if found is None else (found[0], _verdict(found[1]))
        body.append([target.text, value, met])
    return table(["target", "measured", "met"], body)


def _verdict(met: bool) -> str:
    return "yes" if met else "**no**"
