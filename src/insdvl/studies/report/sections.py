"""The sections of the report, each headed by the question that it answers."""

import math
from html import escape
from typing import Any

import numpy as np

from insdvl.studies.report import figures as f
from insdvl.studies.report.fit_section import fit
from insdvl.studies.report.parts import Part, Section, table
from insdvl.studies.report.results import Result
from insdvl.studies.report.track_sections import motion, reference, where

# ---------------------------------------------------------------- trust


def trust(result: Result) -> Part:
    """Judgement, findings, and the numbers with what they should be."""
    document, verdict = result.numbers, result.numbers["verdict"]
    judgement = str(verdict["judgement"])
    kind = "good" if judgement.startswith("FITS") else "bad"
    kind = "unknown" if judgement.startswith(("CANNOT", "TOO CAUTIOUS")) else kind
    findings = "".join(
        f"<li><b>{escape(x['text'])}</b><br>{escape(x['remedy'])}</li>" for x in verdict["findings"]
    )
    html = f'<p class="judgement {kind}">{escape(judgement)}</p>'
    html += f"<ol>{findings}</ol>" if findings else ""
    return Part(html + table(_numbers(document, verdict), ("", "is", "should be")), [])


def _numbers(document: dict[str, Any], verdict: dict[str, Any]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    if innovations := verdict["innovations"]:
        low, high = innovations["nis_bounds"]
        bound = innovations["autocorrelation_bound"]
        means = ", ".join(f"{value:+.1f}" for value in innovations["mean_in_standard_errors"])
        rows += [
            (
                f"NIS, mean over {innovations['judged']} DVL measurements",
                f"{innovations['nis_mean']:.2f}",
                f"{innovations['nis_expected']:g} ({low:.2f} to {high:.2f} by chance)",
            ),
            (
                "its median, which outliers do not move",
                f"{innovations['nis_median']:.2f}",
                "{:.2f} ({:.2f} to {:.2f} by chance)".format(
                    innovations["nis_median_expected"], *innovations["nis_median_bounds"]
                ),
            ),
            (
                "correlation of neighbouring innovations",
                f"{innovations['autocorrelation']:+.3f}",
                f"within {bound:.3f}",
            ),
            ("mean innovation, in standard errors", means, "within 3.3"),
        ]
    if verdict["refused_share"] is not None:
        rows.append(("DVL refused", f"{100.0 * verdict['refused_share']:.1f} %", "0.1 %"))
    outages = verdict.get("dvl_outages")  # a result of an earlier version has none
    if outages and outages["count"]:
        lost = f"{outages['seconds']:.0f} s, the longest {outages['longest']:.0f} s"
        rows.append((f"outages of the DVL ({outages['count']})", lost, ""))
    if noise := verdict["dvl_noise"]:
        rows.append(
            (
                "noise of the DVL from ping to ping",
                f"{noise['shown']:.2g} m/s",
                f"{noise['told']:.2g} m/s, as told",
            )
        )
    for w in verdict["withheld"]:
        rows.append(
            (
                f"prediction after {w['seconds']:g} s without the DVL ({w['count']} times)",
                f"{w['error']:.2g} m/s off, {100.0 * w['covered']:.0f} % inside",
                f"{w['sigma']:.2g} m/s, 95 %",
            )
        )
    if position := verdict["position"]:
        rows += [
            ("distance travelled", f"{position['distance']:.4g} m", ""),
            ("horizontal sigma at the end", f"{position['horizontal_sigma']:.2g} m", ""),
            ("depth sigma at the end", f"{position['depth_sigma']:.2g} m", ""),
        ]
    if document["reference_stamps"] >= 2:
        inside = 100.0 * document["body_velocity_inside_3_sigma"]
        rows.append(("velocity errors inside 3 sigma", f"{inside:.1f} %", "99.7 %"))
    return rows


# ---------------------------------------------------------------- noise, biases


def noise(result: Result) -> Part:
    """Noise per sample in effect against the nominal, and the turn rate."""
    t = result.track["stamp"] - result.start
    told = result.numbers["parameters"]["insdvl_filter"]
    found = []
    for sensor, unit in (("accelerometer", "m/s²"), ("gyroscope", "rad/s")):
        values = result.vector(f"{sensor}_noise")
        traces = [
            f.line(t, values[:, k], axis, f.AXES[k], line={"shape": "hv"})
            for k, axis in enumerate("xyz")
        ]
        nominal = math.sqrt(float(np.mean(told[f"process_noise.{sensor}_variance"])))
        found.append(
            f.over_time(
                traces,
                f"{sensor} [{unit}]",
                yaxis={"type": "log", "range": f.log_window(values, nominal)},
                shapes=[f.level(nominal, "nominal")],
            )
        )
    rate = np.degrees(result.vector("rate"))
    found.append(
        f.over_time(
            [f.line(t, rate[:, k], axis, f.AXES[k]) for k, axis in enumerate("xyz")],
            "turn rate [deg/s]",
        )
    )
    source = escape(str(result.numbers["process_noise"]))
    return Part(f"<p>One sigma per sample of the IMU, source of Q: <b>{source}</b>.</p>", found)


def bias(result: Result) -> Part:
    """Biases with their bands, and the sigma that they began with."""
    t = result.track["stamp"] - result.start
    told = result.numbers["parameters"]["insdvl_filter"]
    found = []
    for sensor, unit, scale in (
        ("accelerometer", "mm/s²", 1e3),
        ("gyroscope", "deg/h", math.degrees(3600.0)),
    ):
        initial = 2.0 * scale * float(told[f"initial.{sensor}_bias_std"])
        values = scale * result.vector(f"{sensor}_bias")
        sigma = scale * result.vector(f"{sensor}_bias_sigma")
        most = f.window(np.append(values.ravel(), [initial, -initial]))
        found.append(
            f.with_sigma(
                t,
                values,
                sigma,
                list("xyz"),
                f"{sensor} [{unit}]",
                yaxis={"range": most},
                shapes=[f.level(initial, "2 initial sigma"), f.level(-initial, "")],
            )
        )
    text = "<p>Bands are 2 sigma. A bias beyond the dashed lines is larger than told.</p>"
    return Part(text, found)


# ---------------------------------------------------------------- what went wrong


def incidents(result: Result) -> Part:
    """A bar for each incident over time."""
    found = result.numbers["incidents"]
    if not found:
        return Part(
            "<p>Nothing: no gap, no outage, no glitch, nothing refused, no restart.</p>", []
        )
    names = list(dict.fromkeys(incident["name"] for incident in found))
    traces = []
    for name in names:
        x: list[float | None] = []
        texts: list[str] = []
        for incident in (i for i in found if i["name"] == name):
            begin, end = incident["begin"] - result.start, incident["end"] - result.start
            x += [begin, max(end, begin + 1e-3), None]
            lasted = f", {end - begin:.1f} s" if end > begin else ""
            texts += [f"{name}: {incident['count']}{lasted}"] * 3
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "x": x,
                "y": [name.replace("_", " ")] * len(x),
                "text": texts,
                "hovertemplate": "%{text}, at %{x:.1f} s<extra></extra>",
                "line": {"width": 8, "color": f.RED},
                "marker": {"size": 9, "color": f.RED, "symbol": "line-ns-open"},
                "showlegend": False,
            }
        )
    height = 110 + 28 * len(names)
    figure = f.over_time(traces, "", height=height, yaxis={"automargin": True}, hovermode="closest")
    return Part("", [figure])


# ---------------------------------------------------------------- what was run


def run(result: Result) -> Part:
    """Recording, versions, changed parameters, and the model's card."""
    document = result.numbers
    rows = [
        ("recording", str(document["bag"])),
        ("configuration", str(document["configuration"])),
        ("IMU samples", str(document["imu_samples"])),
        ("duration", f"{document['duration']:.1f} s"),
        *((name, text) for name, text in document["versions"].items()),
    ]
    changed = [
        (name, str(value), str(default))
        for name, (value, default) in document["changed_parameters"].items()
    ]
    html = table(rows) + "<h3>Parameters that differ from the default</h3>"
    html += table(changed, ("parameter", "value", "default")) if changed else "<p>None.</p>"
    if card := document["model"]:
        html += "<h3>Model of the process noise</h3>"
        html += table([(name, str(value)) for name, value in card.items()])
    return Part(html, [])


SECTIONS = (
    Section("trust", "Can I trust this run?", trust),
    Section("where", "Where was it?", where),
    Section("motion", "How fast, and which way?", motion),
    Section("fit", "Does it fit the DVL?", fit),
    Section("noise", "What noise was learned?", noise),
    Section("bias", "What are the biases?", bias),
    Section("incidents", "What went wrong, and when?", incidents),
    Section("reference", "How far is it from the reference?", reference),
    Section("run", "What was run?", run),
)
