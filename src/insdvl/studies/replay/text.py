"""The numbers of a replay for the terminal: the table, and the verdict in words."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from insdvl.navigation.measurements.dvl import Dvl
from insdvl.studies.judgement.numbers import refusals
from insdvl.terminal import Line

_ROWS = (
    ("velocity RMSE, navigation axes", "velocity_rmse", "m/s"),
    ("velocity RMSE, body axes", "body_velocity_rmse", "m/s"),
    ("body velocity inside 3 sigma", "body_velocity_inside_3_sigma", ""),
    ("position RMSE, horizontal", "position_rmse_horizontal", "m"),
    ("depth error at the end", "depth_error_end", "m"),
    ("its sigma", "depth_sigma_end", "m"),
    ("heading RMSE", "heading_rmse_deg", "deg"),
    ("tilt RMSE", "tilt_rmse_deg", "deg"),
    ("reference stamps", "reference_stamps", ""),
)
#: The number that only a filter has that learns it.
FACTOR = "process_noise_factor"
_ALWAYS = (
    ("mean NIS (3 dof)", "nis_mean", ""),
    ("mean NIS, accepted only", "nis_mean_accepted", ""),
    ("DVL accepted", "dvl_accepted", ""),
    ("DVL rejected", "dvl_rejected", ""),
    ("DVL not judged", "dvl_not_judged", ""),
    ("process noise", "process_noise", ""),
    ("factor on it at the end", FACTOR, ""),
)
#: Widths of the labels, and the styles of judgements by what they begin with.
TABLE, VERDICT = 32, 20
_STYLES = {"FITS": "bold green", "NOT RIGHT": "bold red", "": "bold yellow"}
#: Of the prediction of withheld measurements.
_WITHHELD = (
    ("error", "error", "m/s"),
    ("log_likelihood", "log likelihood", ""),
    ("covered", "inside 95 %", ""),
)


def table_of(document: dict[str, Any]) -> Iterator[Line]:
    """The table of the command's JSON document; errors only where there is a reference.

    What the verdict says is left to it.
    """
    yield Line("recording", f"{document['bag']}, {document['duration']:.5g} s")
    yield Line("configuration", document["configuration"])
    has_reference = document["reference_stamps"] >= 2
    if not has_reference:
        yield Line("reference", "none in the recording: judged by the innovations")
    for text, name, unit in (*(_ROWS if has_reference else ()), *_ALWAYS):
        value = document[name]
        if value is None and name == FACTOR:
            continue
        shown = "unknown" if value is None else value
        if isinstance(value, float):
            shown = f"{value:.4g}"
        if by_reason := document.get(f"{name}_by_reason"):
            shown = f"{value} ({', '.join(f'{reason} {n}' for reason, n in by_reason.items())})"
        yield Line(text, f"{shown} {unit}".rstrip())
    if noise := document["dvl_noise_in_force"]:
        yield from _noise_in_force(noise)
    if jumps := document["counts"]["time_jumps"]:
        yield Line("time jumps", f"{jumps}; errors are those after the last one")
    if document["start"]:
        yield Line("", f"start: {document['start']}")
    for finding in document["findings"]:
        if not _told(finding, document):
            yield Line("", f"finding: {finding}")
    for key, count in document["rejected"].items():
        yield Line(f"not used: {key}", str(count))


def _noise_in_force(noise: dict[str, Any]) -> Iterator[Line]:
    """The noise of the DVL that the filter used where it is not nominal."""
    for label, name, unit in (
        ("sigma of the DVL in force", "sigma", " m/s"),
        ("factor on its nominal R", "factor", ""),
    ):
        if told := noise[name]:
            text = f"mean {told['mean']:.3g}{unit} ({told['min']:.3g} to {told['max']:.3g})"
            yield Line(label, text)
    shares = (f"{name} {100.0 * share:.0f} %" for name, share in noise["origins"].items())
    yield Line("where it is from", ", ".join(shares))


def _told(finding: str, document: dict[str, Any]) -> bool:
    """Whether the verdict has what a finding of the filter begins with."""
    what = finding.partition(" (")[0].partition(":")[0]
    return any(x["text"].startswith(what) for x in document["verdict"]["findings"])


def verdict_of(document: dict[str, Any]) -> Iterator[Line]:
    """The verdict: numbers with what they should be, further findings, and the judgement."""
    numbers = document["verdict"]
    yield Line("", "\nIs it right?")
    for label, text in _numbers(document, numbers):
        yield Line(f"  {label}", text)
    for finding in numbers["findings"]:
        if finding["text"] in numbers["judgement"]:
            continue
        yield Line("", f"  - {finding['text']}")
        if finding["remedy"]:
            yield Line("", f"    {finding['remedy']}")
    judgement = numbers["judgement"]
    yield Line(
        "", judgement, next(s for begin, s in _STYLES.items() if judgement.startswith(begin))
    )


def side_by_side(documents: Sequence[dict[str, Any]]) -> str:
    """The numbers of several configurations in columns, and the judgement of each."""
    has_reference = all(document["reference_stamps"] >= 2 for document in documents)
    rows = [*(_ROWS if has_reference else ()), *_ALWAYS]
    if all(document[FACTOR] is None for document in documents):
        rows = [row for row in rows if row[1] != FACTOR]
    lines = ["", "Side by side"]
    lines += [f"  {k}: {document['configuration']}" for k, document in enumerate(documents, 1)]
    lines.append(_columns("", range(1, len(documents) + 1)))
    for text, name, unit in rows:
        lines.append(f"{_columns(text, (d[name] for d in documents))} {unit}".rstrip())
    for windows in zip(*(document["verdict"]["withheld"] for document in documents), strict=False):
        label = f"{windows[0]['seconds']:g} s without DVL"
        for name, text, unit in _WITHHELD:
            values = (window[name] for window in windows)
            lines.append(f"{_columns(f'{label}, {text}', values)} {unit}".rstrip())
    for k, document in enumerate(documents, 1):
        lines.append(f"  {k}: {document['verdict']['judgement']}")
    return "\n".join(lines)


def _columns(label: str, values: Iterable[Any]) -> str:
    return f"{label:32}" + "".join(f" {_shown(value):>11}" for value in values)


def _shown(value: Any) -> str:
    """A value of a document in a few characters."""
    if value is None:
        return "unknown"
    return f"{value:.4g}" if isinstance(value, float) else str(value).partition(",")[0]


def _numbers(document: dict[str, Any], numbers: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """What a number is, and the number with what it should be."""
    if innovations := numbers["innovations"]:
        low, high = innovations["nis_bounds"]
        yield (
            "NIS",
            f"{innovations['nis_mean']:.2f}, should be "
            f"{innovations['nis_expected']:g} ({low:.2f} to {high:.2f} by chance), over all "
            f"{innovations['judged']} that were judged; median {innovations['nis_median']:.2f}, "
            f"should be {innovations['nis_median_expected']:.2f}",
        )
    if (share := numbers["refused_share"]) is not None:
        by = ", ".join(f"{name} {count}" for name, count in refusals(document, Dvl.name).items())
        yield "refused", f"{100.0 * share:.1f} % of the DVL" + (f" ({by})" if by else "")
    if (outages := numbers["dvl_outages"])["count"]:
        yield (
            "outages of the DVL",
            f"{outages['count']}, together {outages['seconds']:.0f} s, the longest "
            f"{outages['longest']:.0f} s; {outages['lost_under_way']:.0f} of "
            f"{outages['under_way']:.0f} s under way",
        )
    if innovations:
        yield (
            "correlation",
            f"{innovations['autocorrelation']:+.3f} of neighbouring innovations "
            f"(white: within {innovations['autocorrelation_bound']:.3f})",
        )
        means = ", ".join(
            f"{axis} {value:+.1f}"
            for axis, value in zip("xyz", innovations["mean_in_standard_errors"], strict=False)
        )
        yield "mean innovation", f"{means} standard errors"
    if noise := numbers["dvl_noise"]:
        yield (
            "noise of the DVL",
            f"{noise['shown']:.2g} m/s as the recording shows it, {noise['told']:.2g} as told",
        )
    for sensor, bias in (numbers["biases"] or {}).items():
        if bias["in_initial_sigmas"]:
            values = ", ".join(f"{value:+.1f}" for value in bias["in_initial_sigmas"])
            yield f"{sensor} bias", f"{values} of its initial sigma"
    if position := numbers["position"]:
        yield (
            "position",
            f"{position['distance']:.4g} m travelled; sigma at the end "
            f"{position['horizontal_sigma']:.2g} m horizontally, {position['depth_sigma']:.2g} m "
            f"in depth, {position['heading_sigma_deg']:.2g} deg in heading",
        )
    for w in numbers["withheld"]:
        low, high = w["nis_bounds"]
        yield (
            f"{w['seconds']:3g} s without DVL",
            f"{w['error']:.2g} m/s off, sigma {w['sigma']:.2g}; "
            f"NIS {w['nis_mean']:.2f} ({low:.2f} to {high:.2f} by chance), "
            f"{100.0 * w['covered']:.0f} % of {w['count']} within 95 %",
        )
