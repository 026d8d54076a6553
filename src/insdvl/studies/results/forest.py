"""One picture of all comparisons: each row's error over that of a filter that knows the noise."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from insdvl.extras import extra
from insdvl.files import write
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.noise import SCENARIOS
from insdvl.studies.results.targets import Documents, row

with extra("plot"):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

#: Rows of the picture and their words and colours (Okabe and Ito), in the order of the legend.
_ROWS = {
    "hcf default": ("learned", "#0072b2"),
    "bands": ("learned from spectra", "#56b4e9"),
    "bands with factor": ("and a factor that the DVL tells", "#000000"),
    "bands with factor and R adaptive": ("and the noise of the DVL", "#999999"),
    "closed form": ("closed form, the variance of a window", "#009e73"),
    "adaptive variational": ("variational Bayes, from innovations", "#cc79a7"),
    "best constant": ("best constant", "#e69f00"),
    "constant 0.01/0.001": ("constant 0.01/0.001, as published", "#d55e00"),
}
_TICKS = (0.9, 1.0, 1.1, 1.2, 1.5, 2.0, 3.0, 5.0)
_STEP = 0.12  # between rows, of the distance of two groups

Ratio = tuple[float, float, float]


def groups(documents: Documents) -> dict[str, dict[str, Ratio]]:
    """Ratio of the body velocity errors, with its 95 % interval, by group and row.

    Args:
        documents: Numbers by part; a part that is missing has no group.
    """
    found: dict[str, dict[str, Ratio]] = {}
    parts = {f"{scenario}-calibrated": scenario for scenario in SCENARIOS}
    parts |= {f"{scenario}-spectrum": scenario for scenario in DRAWN}
    for part, scenario in parts.items():
        if part in documents:
            found[f"{scenario}, simulated"] = _of_comparison(documents[part])
    if "vehicle" in documents:
        for name, injected in documents["vehicle"]["injections"].items():
            ratios = injected["ratio_to"]["told"]
            found[f"recordings, noise injected: {name}"] = {
                name: tuple(ratios[name]["body_velocity_rmse"]) for name in _ROWS if name in ratios
            }
    return found


def _of_comparison(document: Mapping[str, Any]) -> dict[str, Ratio]:
    ratios = {}
    for name in _ROWS:
        numbers = row(document, name)
        if numbers is not None and "oracle" in (numbers["ratio_to"] or {}):
            ratios[name] = tuple(numbers["ratio_to"]["oracle"]["body_rmse"])
    return ratios


def draw(path: Path, documents: Documents) -> None:
    """Draw the ratios.

    Args:
        path: The PNG file.
        documents: Numbers by part.
    """
    found = groups(documents)
    figure = Figure(figsize=(9.5, 1.6 + 0.75 * max(1, len(found))), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.axvline(1.0, color="#222222", linewidth=1.0)
    for i, ratios in enumerate(found.values()):
        for k, (name, (words, colour)) in enumerate(_ROWS.items()):
            if name in ratios:
                middle, low, high = ratios[name]
                y = i + (k - (len(_ROWS) - 1) / 2) * _STEP
                axes.plot([low, high], [y, y], color=colour, linewidth=2.0)
                axes.plot(middle, y, "o", color=colour, markersize=5, label=words)
    axes.set_yticks(range(len(found)), list(found))
    axes.set_ylim(max(1, len(found)) - 0.5, -0.5)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(_TICKS))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("error of the body velocity, ratio with its 95 % interval")
    axes.grid(True, axis="x", linewidth=0.4, alpha=0.6)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="y", length=0)
    handles, labels = axes.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    figure.legend(
        once.values(), once.keys(), loc="outside lower center", ncols=3, fontsize=8, frameon=False
    )
    figure.suptitle("How much worse each filter is than one that is told the noise", fontsize=12)
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=110)
    write(path, image.getvalue())
