"""Draws a forest plot: for each group and row a ratio, with its interval as a line."""

import io
from pathlib import Path

from insdvl.extras import extra
from insdvl.files import write
from insdvl.studies.results.pictures.forests import Forest

with extra("plot"):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

_TICKS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0)
_FEW_TICKS = (0.2, 0.5, 0.8, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)
_WIDE = 3.0  # largest ratio over the smallest from which on there are few ticks
_GROUP = 0.9  # of the distance of two groups, for all rows


def draw(path: Path, forest: Forest) -> None:
    """Draw a forest plot.

    Args:
        path: The PNG file.
        forest: What is drawn.
    """
    groups, rows = forest.groups, forest.rows
    height = 1.6 + max(1, len(groups)) * max(0.25, 0.08 * len(rows))
    figure = Figure(figsize=(9.5, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.axvline(1.0, color="#222222", linewidth=1.0)
    step = _GROUP / max(1, len(rows))
    ends = [1.0]
    for i, ratios in enumerate(groups.values()):
        for k, (name, (words, colour)) in enumerate(rows.items()):
            if name in ratios:
                middle, low, high = ratios[name]
                y = i + (k - (len(rows) - 1) / 2) * step
                axes.plot([low, high], [y, y], color=colour, linewidth=2.0)
                axes.plot(middle, y, "o", color=colour, markersize=4, label=words)
                ends += [low, high]
    axes.set_yticks(range(len(groups)), list(groups))
    axes.set_ylim(max(1, len(groups)) - 0.5, -0.5)
    axes.set_xscale("log")
    is_wide = max(ends) > _WIDE * min(ends)
    axes.xaxis.set_major_locator(FixedLocator(_FEW_TICKS if is_wide else _TICKS))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(forest.axis)
    axes.grid(True, axis="x", linewidth=0.4, alpha=0.6)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="y", length=0)
    handles, labels = axes.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    shown = [words for words, _ in rows.values() if words in once]
    figure.legend(
        [once[words] for words in shown],
        shown,
        loc="outside lower center",
        ncols=3,
        fontsize=8,
        frameon=False,
    )
    figure.suptitle(forest.title, fontsize=12)
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=110)
    write(path, image.getvalue())
