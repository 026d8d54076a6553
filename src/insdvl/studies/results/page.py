"""The pages of docs/results/, one for each study, written from the numbers of their parts.

A page has tables, definitions, and verdicts that are computed. What follows from the numbers is
written by hand in docs/results.md and docs/results/README.md: other numbers would leave a compiled
sentence standing.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from insdvl.simulation.noise import SCENARIO_TEXTS, SCENARIOS
from insdvl.studies.evaluation.tables import comparison_tables
from insdvl.studies.report.markdown import interval, number, table
from insdvl.studies.results.accuracy import accuracy_tables
from insdvl.studies.results.breadth.tables import outages_tables, rates_tables
from insdvl.studies.results.breadth.targets import OF_BREADTH
from insdvl.studies.results.dvl_noise import text as dvl_noise
from insdvl.studies.results.dvl_noise.study import RUNS
from insdvl.studies.results.dvl_noise.tables import noise_tables
from insdvl.studies.results.dvl_noise.targets import OF_DVL_NOISE
from insdvl.studies.results.others import text as others
from insdvl.studies.results.others.study import RUNS as RUNS_OF_OTHERS
from insdvl.studies.results.others.tables import others_tables
from insdvl.studies.results.others.targets import OF_OTHERS
from insdvl.studies.results.over_matched import over_matched
from insdvl.studies.results.pictures.forests import forests
from insdvl.studies.results.pictures.over_time import over_time
from insdvl.studies.results.recorded.targets import OF_VEHICLE, OF_WITHHELD
from insdvl.studies.results.targets import (
    OF_SPECTRUM,
    TARGETS,
    Documents,
    row,
    targets_table,
)
from insdvl.studies.results.vehicle_tables import vehicle_tables
from insdvl.studies.results.window import window_tables
from insdvl.studies.results.withheld import withheld_tables

_NO_WALK = "constant-paper-no-walk"
#: The scenarios of the page on noise that is not white, the white ones last.
SPECTRUM = ("vibrating", "coloured", "waves", "realistic", "varying", "wide")


def pages(documents: Documents) -> dict[str, str]:
    """The pages by name; a part whose numbers are missing is named.

    Args:
        documents: Numbers by part, as in docs/results/.
    """
    provenance = _provenance(documents)
    pictures = forests(documents)
    found = {}
    for name, write in _PAGES.items():
        title, _, text = write(documents).strip().partition("\n\n")
        if name in pictures:
            text = f"![{pictures[name].title}]({name}.png)\n\n{text}"
        found[name] = f"{title}\n\n{text}\n\n{provenance}\n"
    return found


def _provenance(documents: Documents) -> str:
    seeds = {d["plan"]["seed"] for d in documents.values() if "plan" in d}
    environments = {str(sorted(d["environment"].items())) for d in documents.values()}
    text = (
        "Written by `insdvl results` from the JSON files beside this page, which have the numbers "
        "of every\nrun, the seeds and the versions. Seed of all runs: "
        + ", ".join(str(seed) for seed in sorted(seeds))
        + "."
    )
    if len(environments) > 1:
        text += " Parts were computed with\ndifferent versions."
    return f"---\n{text}"


def _targets(documents: Documents) -> str:
    return (
        "# Targets\n\nThe targets were set before the measurements. A ratio meets its target when "
        "the upper end of its\ninterval does, one on the recordings when the mean "
        "does. *Learned* is the model `default`.\n\n"
        + targets_table(documents, TARGETS)
        + "\n## Targets of the other studies\n\n"
        + _targets_of_studies(documents)
    )


#: Targets that are on the pages of their studies.
_OF_STUDIES = {
    "spectrum": OF_SPECTRUM,
    "breadth": OF_BREADTH,
    "other-vehicles": OF_OTHERS,
    "dvl-noise": OF_DVL_NOISE,
    "vehicle": OF_VEHICLE,
    "withheld": OF_WITHHELD,
}


def _targets_of_studies(documents: Documents) -> str:
    body = []
    for name, targets in _OF_STUDIES.items():
        measured = [found for target in targets if (found := target.measured(documents))]
        met = sum(is_met for _, is_met in measured)
        body.append([f"[{name}]({name}.md#targets)", str(met), str(len(measured))])
    return table(["page", "met", "measured"], body) + (
        "\nWhich of those that are missed no source of Q can meet is told in [what the results "
        "mean](README.md#noise-that-is-not-white),\nof the recordings in its section on the [real "
        "vehicle](README.md#a-real-vehicle).\n"
    )


def _section(title: str, prose: str, parts: Sequence[str]) -> str:
    return "\n\n".join([f"# {title}", prose.strip(), *(part.strip() for part in parts)]) + "\n"


def _concluded(document: Mapping[str, Any], text: str, runs: int) -> list[str]:
    """A text that was written by hand for seed 1; other missions may say otherwise: none."""
    written_for = (document["seed"], document["runs"]) == (1, runs)
    return [f"**Conclusion.** {text.strip()}"] if written_for else []


def _missing(*parts: str) -> str:
    return f"Not computed: {', '.join(parts)}."


def _accuracy(documents: Documents) -> str:
    document = documents.get("q-accuracy")
    return _section(
        "Accuracy of the variance",
        """
An estimator gets a window of 200 samples of one channel, and estimates the variance of its white
noise. There are two limits. An estimator that knows the published grid of 15 variances cannot have
a smaller RMSE than the Bayes estimator. A scale-equivariant estimator that allows for motion along
a polynomial of degree 5 has 194 degrees of freedom and a relative error of at least
$\\sqrt{2/194}$ = 10.2 %.
""",
        [accuracy_tables(document) if document else _missing("q-accuracy")],
    )


def _comparison(documents: Documents, part: str, title: str) -> str:
    if part not in documents:
        return f"## {title}\n\n{_missing(part)}"
    return f"## {title}\n\n{comparison_tables(documents[part])}"


def _over_time(documents: Documents, part: str) -> str:
    sentence = over_time(documents).get(part)
    return f"![{sentence}]({part}.png)" if sentence else ""


def _scenarios(documents: Documents, preset: str) -> list[str]:
    return [
        _comparison(documents, f"{scenario}-{preset}", f"`{scenario}`: {SCENARIO_TEXTS[scenario]}")
        for scenario in SCENARIOS
    ]


def _calibrated(documents: Documents) -> str:
    parts = {
        scenario: documents[f"{scenario}-calibrated"]
        for scenario in ("varying", "wide")
        if f"{scenario}-calibrated" in documents
    }
    plots = [_over_time(documents, f"{scenario}-calibrated") for scenario in parts]
    return _section(
        "The comparison, calibrated",
        """
The filter of this project: invariant error state, variances per sample, bias walks of the data
sheet. Missions are 330 s of an AUV, with initial errors drawn from $P_0$ and the gate off. SRMSE
and SMAE are errors of the NED velocity.

*Oracle* receives the true variances at every change. *Perfect heading* is the result of the oracle
without its heading error. *Best constant* is the best of a grid, for each metric. *Adaptive*
filters use the innovations: `literal` as published; `floored` added to the nominal Q; `best xi`
with the best window and nominal Q; `variational` is a variational Bayes filter with the best prior
weight and nominal Q. *Closed form* is the variance around a polynomial of degree 5.

Brackets hold 95 % intervals of a bootstrap over runs, which draws each run with the results of all
rows. All rows of a table see the same missions, noise, DVL errors and initial errors. Searches
(best constant, best adaptive filter) use other seeds than the reported runs. A ratio below 1 means
that the row is better than its reference.
""",
        [
            *_scenarios(documents, "calibrated"),
            "## The gain in two parts",
            *(_gain(document, scenario) for scenario, document in parts.items()),
            *plots,
        ],
    )


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
            f"{name} {total:.1f} %, of which {calibration:.1f} % from the first constant to the "
            f"best one (calibration), and {adaptation:.1f} % of the rest from the best constant to "
            "the learned process noise (adaptation)"
        )
    closed = learned["ratio_to"]["closed form"]
    return (
        f"`{scenario}`: {'; '.join(sentences)}. Learned / closed form: body velocity "
        f"{interval(closed['body_rmse'], 4)}, SRMSE {interval(closed['srmse'], 4)}."
    )


def _spectrum(documents: Documents) -> str:
    return _section(
        "Noise that is not white",
        """
The filter of this project on vehicles that vibrate, pitch in waves or have coloured noise
([effective-noise.md](../explanation/effective-noise.md#8-scenarios)), and in two scenarios of white
noise. `bands` is the model that was learned from the spectra of simulated vehicles
([learned-bands.md](../explanation/learned-bands.md)), `bands with factor` the same with a factor on
Q that the filter learns from its innovations
([process-noise-factor.md](../explanation/process-noise-factor.md)). `single band`, `least band` and
`median of spectrum` are closed forms of the same spectra, `closed form` is the variance around a
polynomial. *Adaptive* filters use the innovations: by their mean over the best window, in the
coordinates of the invariant error state (`best xi`), by variational Bayes, and by the recursions of
Sage and Husa for Q, or for Q and R ([filter.md](../explanation/filter.md)).
In `realistic` there are rows that
also learn R ([measurement-noise.md](../explanation/measurement-noise.md)), two of them with states
for the slow error of the DVL (sigma 0.3 of that of the data sheet, 12 s). The oracle receives the
effective variances. White noise is what `default` was trained on ([calibrated.md](calibrated.md)).
`bands` does not take for granted that noise is white: it knows less of white noise than `default`
does. What each source costs per second of mission is in
[learned-bands.md](../explanation/learned-bands.md#6-numbers).
""",
        [
            "## Targets\n\nSet before the measurement. The upper end of an interval has to meet "
            "them.\n\n" + targets_table(documents, OF_SPECTRUM),
            *over_matched(documents, SPECTRUM),
            *(_comparison(documents, f"{name}-spectrum", f"`{name}`") for name in SPECTRUM),
        ],
    )


def _published(documents: Documents) -> str:
    parts = _scenarios(documents, "paper")
    if "constant-paper" in documents:
        parts.append(_against_zero_velocity(documents["constant-paper"]))
        parts.append(_over_time(documents, "constant-paper"))
    parts.append(_comparison(documents, _NO_WALK, "`constant`, preset `paper-no-walk`"))
    if _NO_WALK in documents:
        parts.append(_over_time(documents, _NO_WALK))
    return _section(
        "The published table, attempted",
        """
Preset `paper` follows the published text as literally as possible: its error state and its numbers,
variances used as densities, and bias walks of density eps = 0.001. Preset `paper-no-walk` is the
same without bias walks. The published numbers stand next to ours; they were measured on another
trajectory, with settings that the text leaves open.
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
        f"{len(worse)} of the {len(filters)} filters are worse."
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
is off in all other tables.
""",
        parts,
    )


def _window(documents: Documents) -> str:
    document = documents.get("window")
    return _section(
        "Window and rate",
        """
One model per window length, trained alike. A variance applies until the next one is published.
""",
        [window_tables(document) if document else _missing("window")],
    )


_SET_BEFORE = "## Targets\n\nSet before the measurement."
_OF_NIS = """A filter that is right about itself has a NIS of 3. The R that was
set by hand is four to nine times the variance that the pings show
([snapir.yaml](../../ros_insdvl/config/snapir.yaml)), and the one that is learned cannot go lower,
since its vertical component is at `dvl.noise_floor`: no source of Q can meet the target for the
NIS. Beside it is what hand-set noise has.
"""


def _vehicle(documents: Documents) -> str:
    document = documents.get("vehicle")
    return _section(
        "A real vehicle",
        """
Recordings of a real vehicle, with noise added to the IMU. Errors are differences to the recorded
reference. All measurements are used, as in the simulations; rows `gate on` have the gate of the
configuration. *Told* receives the injected variances; *told with hand-set* receives them plus the
hand-set variances, which stand for the noise of the recording itself. The learned rows are bounded
by differences, the closed form is not. `bands with factor and R adaptive` is flown where nothing is
injected, since what is injected is no noise of the DVL. `sensor` and `published` are white noise.
`vibrating` and `coloured` are drawn as in [spectrum.md](spectrum.md), and told by their effective
variances; vibration is in the samples of the IMU alone, as its velocity is no more than some mm/s.
The *best constant* of a recording is the best of a grid of three by three; where its corner with
the largest variances wins, a larger one would be better by some parts in a thousand.
""",
        [
            f"{_SET_BEFORE} {_OF_NIS}\n{targets_table(documents, OF_VEHICLE)}",
            vehicle_tables(document) if document else _missing("vehicle"),
        ],
    )


def _withheld(documents: Documents) -> str:
    document = documents.get("withheld")
    return _section(
        "Judged without a reference",
        """
The recordings as they are. The DVL is withheld everywhere for 10, 30 and 60 s, and the first ping
after each window is predicted: error, log likelihood of one ping, and share within the region of
95 %. All rows predict the same pings. *Taught* has the weights of the bands, or the constant, that
the DVL teaches on the other stretches of the voyage; *taught constant* always has the constant. The
floors of the configuration hold, and in the rows *no floor* they do not.
""",
        [
            f"{_SET_BEFORE} The worse end of each interval has to meet them.\n\n"
            + targets_table(documents, OF_WITHHELD),
            withheld_tables(document) if document else _missing("withheld"),
        ],
    )


def _breadth(documents: Documents) -> str:
    document, parts = documents.get("breadth"), [_missing("breadth")]
    if document:
        parts = [
            f"## Grades of IMU and rates of the DVL\n\n{rates_tables(document)}",
            f"## Outages of the DVL\n\n{outages_tables(document)}",
        ]
    return _section(
        "Other IMUs, other rates, and outages",
        """
Does the process noise that was learned from spectra also serve an IMU of another grade, a DVL that
is faster, slower or better, and a minute without DVL? Scenarios and rows are those of
[spectrum.md](spectrum.md); grades and outages are in
[effective-noise.md](../explanation/effective-noise.md#8-scenarios). The noise of the DVL is 0.1
m/s where nothing else is said. `bands` was trained on other IMUs, with 1 and 5 Hz, and without
outages. Drift is the change of the position's error in an outage. NEES is 1 for a filter that is
right about itself; that of the position at the end of an outage has the drift and what was wrong
before.
""",
        [
            "## Targets\n\nSet before the measurement. Each has to be met by every line of its "
            "scenario, with the upper end\nof the interval of a ratio. *Oracle* tells how many "
            "lines the filter that is told the noise meets.\n\n"
            + targets_table(documents, OF_BREADTH),
            *parts,
        ],
    )


def _other_vehicles(documents: Documents) -> str:
    document, parts, concluded = documents.get("other-vehicles"), [_missing("other-vehicles")], []
    if document:
        parts = [others_tables(document)]
        concluded = _concluded(document, others.CONCLUSION, RUNS_OF_OTHERS)
    return _section(
        "Vehicles that are not those of the training",
        others.QUESTION,
        [
            *concluded,
            others.DEFINITIONS,
            "## Targets\n\n" + targets_table(documents, OF_OTHERS),
            *parts,
        ],
    )


def _dvl_noise(documents: Documents) -> str:
    document = documents.get("dvl-noise")
    return _section(
        "Learned noise of the DVL",
        dvl_noise.QUESTION,
        [
            *(_concluded(document, dvl_noise.CONCLUSION, RUNS) if document else []),
            dvl_noise.DEFINITIONS,
            f"{_SET_BEFORE} The upper end of an interval has to meet them.\n\n"
            + targets_table(documents, OF_DVL_NOISE),
            noise_tables(document) if document else _missing("dvl-noise"),
        ],
    )


#: The pages, by name.
_PAGES: Mapping[str, Callable[[Documents], str]] = {
    "targets": _targets,
    "variance": _accuracy,
    "calibrated": _calibrated,
    "spectrum": _spectrum,
    "breadth": _breadth,
    "other-vehicles": _other_vehicles,
    "dvl-noise": _dvl_noise,
    "published": _published,
    "error-state-and-gate": _error_state_and_gate,
    "window": _window,
    "vehicle": _vehicle,
    "withheld": _withheld,
}
PAGES = tuple(_PAGES)
