"""The page docs/results.md, written from the numbers of its parts.

Sentences here say what was done and why; every number comes from the documents.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from insdvl.studies.evaluation import accuracy, tables, vehicle, window
from insdvl.studies.evaluation.tables import interval, number, table

Documents = Mapping[str, Any]

_NO_WALK = "constant-paper-no-walk"


@dataclass(frozen=True)
class Target:
    """What was aimed for, before anything was measured.

    Attributes:
        text: What, in words.
        measured: The number, as text, and whether it meets the target; None where it is missing.
    """

    text: str
    measured: Callable[[Documents], tuple[str, bool] | None]


def row(document: Mapping[str, Any], approach: str) -> Mapping[str, Any] | None:
    """A row of a comparison; None where there is none."""
    return next((r for r in document["rows"] if r["approach"] == approach), None)


def _ratio(part: str, reference: str, metric: str, limit: float) -> Target:
    """The upper end of the interval of a paired ratio of the learned `default`."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        document = documents.get(part, {"rows": []})
        learned, oracle = row(document, "hcf default"), row(document, "oracle")
        if learned is None or oracle is None or reference not in learned["ratio_to"]:
            return None
        ratio = learned["ratio_to"][reference][metric]
        text = interval(ratio)
        if reference != "oracle":
            text += f" (oracle {interval(oracle['ratio_to'][reference][metric])})"
        return text, ratio[2] <= limit

    scenario = part.removesuffix("-calibrated")
    name = {"body_rmse": "body velocity", "srmse": "SRMSE"}[metric]
    return Target(f"`{scenario}`: {name}, learned / {reference}, at most {limit:g}", measured)


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


def _harmless(metric: str, words: str) -> Target:
    """Within 2 % on the mean of the recordings, 5 % on each."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        if "vehicle" not in documents:
            return None
        rows = documents["vehicle"]["as_recorded"]["rows"]
        learned, hand_set = (rows[name][metric] for name in ("hcf default", "hand-set"))
        each = {name: learned[name] / hand_set[name] for name in learned if name != "mean"}
        mean = documents["vehicle"]["as_recorded"]["ratio_to"]["hand-set"]["hcf default"][metric][0]
        worst = max(each, key=each.__getitem__)
        text = f"{mean:.3f}; largest {each[worst]:.3f} ({worst})"
        return text, mean <= 1.02 and each[worst] <= 1.05

    return Target(
        f"recordings as they are: {words}, learned / hand-set, at most 1.02 on the mean and 1.05 "
        "on each",
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
    _harmless("body_velocity_rmse", "body velocity"),
    _harmless("velocity_rmse", "NED velocity"),
    _harmless("position_rmse_horizontal", "horizontal position"),
)


def markdown(documents: Documents) -> str:
    """The page; a part whose numbers are missing is named as such."""
    parts = [
        _INTRODUCTION.format(provenance=_provenance(documents)),
        _targets(documents),
        _accuracy(documents),
        _calibrated(documents),
        _published(documents),
        _error_state_and_gate(documents),
        _window(documents),
        _vehicle(documents),
        _NOT_CLAIMED,
    ]
    return "\n".join(part.strip() + "\n" for part in parts)


_INTRODUCTION = """
# Results

How good navigation gets when the process noise is learned, against everything else that could be
done, on simulations and on recordings of a real vehicle. This page, its tables and its pictures are
written by one command, on all cores in about an hour:

```
make results                                       # the simulations
make results ARGS="--recordings DIR --config FILE"   # and recordings of a real vehicle
```

The numbers behind the tables are in [results/](results/), one JSON file for each part, with those
of every run, the seeds and the versions. {provenance}

In brackets stand 95 % intervals, of a bootstrap over runs that draws a run with the results of all
rows. Rows of one table see the same missions, noise, DVL errors and initial errors. What is
searched for (the best constant, the best adaptive filter) is searched on other seeds than those
that are reported. A ratio below 1 means that the row is better.
"""


def _provenance(documents: Documents) -> str:
    seeds = {d["plan"]["seed"] for d in documents.values() if "plan" in d}
    environments = {str(sorted(d["environment"].items())) for d in documents.values()}
    text = "Seed of all runs: " + ", ".join(str(seed) for seed in sorted(seeds)) + "."
    if len(environments) > 1:
        text += " The parts were computed with different versions; each file says which."
    return text


def _targets(documents: Documents) -> str:
    body = []
    for target in TARGETS:
        found = target.measured(documents)
        value, holds = ("not computed", "") if found is None else (found[0], _yes(found[1]))
        body.append([target.text, value, holds])
    return (
        "## Targets\n\nSet before anything was measured; a ratio meets its target when the upper "
        "end of its interval does. *Learned* is the model `default`.\n\n"
        + table(["target", "measured", "met"], body)
    )


def _yes(holds: bool) -> str:
    return "yes" if holds else "**no**"


def _section(title: str, prose: str, parts: Sequence[str]) -> str:
    return "\n\n".join([f"## {title}", prose.strip(), *(part.strip() for part in parts)]) + "\n"


def _missing(*parts: str) -> str:
    return f"Not computed: {', '.join(parts)}."


def _accuracy(documents: Documents) -> str:
    document = documents.get("q-accuracy")
    return _section(
        "How well the variance is known",
        """
A window of 200 samples of one channel, and the variance of its white noise. Two limits: who knows
the published grid of 15 variances cannot have a smaller RMSE than Bayes' rule; who answers alike
for an IMU in any unit (scale-equivariant), and must allow for motion that a polynomial of degree 5
describes, has 194 degrees of freedom and a relative error of $\\sqrt{2/194}$ = 10.2 %.
""",
        [accuracy.markdown(document) if document else _missing("q-accuracy")],
    )


def _comparison(documents: Documents, part: str, title: str) -> str:
    if part not in documents:
        return f"### {title}\n\n{_missing(part)}"
    return f"### {title}\n\n{tables.comparison(documents[part])}"


_SCENARIO_TITLES = {
    "constant": "`constant`: variances 0.01 and 0.001 all the time",
    "constant-tableI": "`constant-tableI`: 0.01² and 0.001²",
    "varying": "`varying`: each channel in [0.001, 0.05], a new value every 15 to 45 s",
    "wide": "`wide`: the same in [1e-5, 0.05]",
}


def _calibrated(documents: Documents) -> str:
    gains = []
    for scenario in ("varying", "wide"):
        part = f"{scenario}-calibrated"
        if part in documents:
            gains.append(_gain(documents[part], scenario))
    pictures = [
        f"![Errors over time, {scenario}](results/{scenario}-calibrated.png)"
        for scenario in ("varying", "wide")
        if f"{scenario}-calibrated" in documents
    ]
    return _section(
        "The comparison, calibrated",
        """
The filter of this project: invariant error state, variances per sample, bias walks of the data
sheet; 330 s of an AUV, initial errors drawn from $P_0$, the gate off. Body velocity is what the
process noise can move. SRMSE and SMAE are of the velocity in NED, mostly heading, which DVL and IMU
do not observe; `perfect heading` is the oracle's result with its heading error taken out.

*Oracle*: told the true variances at every change. *Best constant*: the best of a grid, for each
metric. *Adaptive*: from the innovations (literal, as published; floored, added to the nominal;
`best xi` the best window and nominal; `variational` the best prior weight and nominal of a
variational Bayes filter). *Closed form*: the variance around a polynomial of degree 5.
""",
        [
            *(
                _comparison(documents, f"{scenario}-calibrated", title)
                for scenario, title in _SCENARIO_TITLES.items()
            ),
            "### The gain in two parts",
            *gains,
            _ADDED,
            *pictures,
        ],
    )


_ADDED = """
### What the learned model adds, and where

Over the closed form, on white noise: nothing, as the last column of the ratios says. The variance
around a polynomial of degree 5 holds all that a window knows of its noise, the trees and the
networks that are scale-equivariant learn that there is nothing to correct, and what makes the
difference to a constant is that the process noise is measured at all. Models that answer in the
range of their training (`hcf paper`, `dnn`) do no better inside it and worse outside.

Where the closed form fails is motion that no polynomial follows over a window, as on the
[real vehicle](#a-real-vehicle). There the tuner's bound by differences of a high order
([tuner.md](explanation/tuner.md)) is what helps, not learning.

What is left between learned and oracle is lateness: a change is noticed when the window has seen
it, and told within the second after. Until then a filter whose noise has grown believes too much,
which NEES shows in `wide` more than the errors do: see [window and rate](#window-and-rate).
"""


def _gain(document: Mapping[str, Any], scenario: str) -> str:
    first, best, learned = (
        row(document, name) for name in ("constant 0.01/0.001", "best constant", "hcf default")
    )
    if first is None or best is None or learned is None:
        return _missing(scenario)
    sentences = []
    for metric, name in (("body_rmse", "body velocity"), ("srmse", "SRMSE")):
        calibration = 100.0 * (1.0 - best["ratio_to"]["first constant"][metric][0])
        adaptation = 100.0 * (1.0 - learned["ratio_to"]["best constant"][metric][0])
        total = 100.0 * (1.0 - learned["ratio_to"]["first constant"][metric][0])
        sentences.append(
            f"{name} {total:.1f} %: {calibration:.1f} % from the first constant to the best one "
            f"(calibration), and of what is left {adaptation:.1f} % from there to the learned "
            "process noise (adaptation)"
        )
    closed = learned["ratio_to"]["closed form"]
    return (
        f"`{scenario}`: {'; '.join(sentences)}. Learned over closed form: body velocity "
        f"{interval(closed['body_rmse'], 4)}, SRMSE {interval(closed['srmse'], 4)}."
    )


def _published(documents: Documents) -> str:
    parts = [
        _comparison(documents, f"{scenario}-paper", title)
        for scenario, title in _SCENARIO_TITLES.items()
    ]
    if "constant-paper" in documents:
        parts.append(_against_zero_velocity(documents["constant-paper"]))
        parts.append("![Errors over time, preset paper](results/constant-paper.png)")
    parts.append(_comparison(documents, _NO_WALK, "`constant`, preset `paper-no-walk`"))
    if _NO_WALK in documents:
        parts.append(f"![Errors over time, without bias walks](results/{_NO_WALK}.png)")
    return _section(
        "The published table, attempted",
        """
Preset `paper`: the error state and the numbers of the published text as literally as it allows: a
variance is itself used as the density, and both bias walks have the density eps = 0.001.

What limits this table is eps. As a density of the gyroscope bias it lets the bias wander by 0.03
rad/s within a second, and the heading that integrates it by $\\sqrt{\\epsilon t^3 / 3}$: a radian
after 14 s. From then on the filter holds nothing that it knows of the heading, and NED velocity is
the velocity of a vehicle that points anywhere, whatever the variances q are. Two floors show it:
with the heading error taken out (`perfect heading`) the same result is several times as good, and
to say that the vehicle stands still (`zero velocity`) is hard to beat. Without the walks
(`paper-no-walk`) the same filter keeps its heading.

The published rows stand beside ours. They were measured on another trajectory and with settings
that the text leaves open, so the numbers are not expected to agree; the order and the size of the
gain are what can be compared.
""",
        parts,
    )


def _against_zero_velocity(document: Mapping[str, Any]) -> str:
    zero = row(document, "zero velocity")
    if zero is None:
        return _missing("zero velocity")
    filters = [r for r in document["rows"] if r["nis"] is not None]
    worse = [r for r in filters if r["srmse"] > zero["srmse"]]
    return (
        f"In `constant` the SRMSE of `zero velocity` is {number(zero['srmse'], 3)} m/s; "
        f"{len(worse)} of the {len(filters)} filters are worse than that."
    )


def _error_state_and_gate(documents: Documents) -> str:
    parts = [
        _comparison(documents, "varying-ned", "`varying`, error state `ned`"),
        _comparison(
            documents, "varying-gate", "`varying`, invariant, with the chi-square gate (0.999)"
        ),
    ]
    return _section(
        "Error state and gate",
        """
The same missions with the published error state in the calibrated filter, and with the gate, which
is off elsewhere: a filter that believes a wrong constant rejects good measurements with it.
""",
        parts,
    )


def _window(documents: Documents) -> str:
    document = documents.get("window")
    return _section(
        "Window and rate",
        """
A long window knows a constant variance better, a short one notices a change sooner; what was told
holds until the next. A model of each length, trained alike.
""",
        [window.markdown(document) if document else _missing("window")],
    )


def _vehicle(documents: Documents) -> str:
    document = documents.get("vehicle")
    return _section(
        "A real vehicle",
        """
Eight recordings of 400 s of the AUV Snapir (Cohen and Klein, Engineering Applications of Artificial
Intelligence 146:110221, 2025), a navigation-grade IMU and a DVL, with noise added to the IMU. The
reference is a fusion of the same sensors, and so not independent. The recordings are not part of
this project. As in the simulations all measurements are used; rows with the gate stand beside, and
show what it does where the noise has just grown. The learned rows are bounded by differences of
order 10, the closed form is not.
""",
        [_limits_of(document), vehicle.markdown(document)] if document else [_missing("vehicle")],
    )


def _limits_of(document: Mapping[str, Any]) -> str:
    sensor = document["injections"]["sensor"]
    told = sensor["ratio_to"]["best constant"]["told"]["body_velocity_rmse"]
    hand_set = document["as_recorded"]["rows"]["hand-set"]["body_velocity_rmse"]["mean"]
    noisy = sensor["rows"]["told"]["body_velocity_rmse"]["mean"]
    tilt = document["as_recorded"]["rows"]
    return (
        "The target of 15 % below the best constant is beyond what true variances give: the "
        f"filter that is told them has {interval(told)} of the best constant's error. Of its "
        f"{number(noisy)} m/s, {number(hand_set)} m/s are there without injected noise, the error "
        "of DVL and reference, and with a DVL that good once per second a constant that is large "
        "enough follows it. Without injected noise what is learned is the vehicle's motion; the "
        f"tilt error, {number(tilt['hand-set']['tilt_rmse_deg']['mean'])} deg by hand, is "
        f"{number(tilt['hcf default']['tilt_rmse_deg']['mean'])} deg then."
    )


_NOT_CLAIMED = """
## What is not claimed

- The simulated noise is white, and the variances are piecewise constant. Sensors whose noise is
  coloured, or that vibrate, are measured in the recordings only.
- One trajectory, one DVL (0.1 m/s, once per second), one set of initial errors. Where the DVL is
  better or comes more often, the process noise matters less.
- An interval covers the draw of the missions, not the choice of the scenarios.
- Heading is not observable with these sensors. No row makes it so, and SRMSE mostly tells it.
- The variances that a scenario draws are those that the learned models were trained for, but for
  `wide` and `constant-tableI`, which reach far below.
"""
