"""The command `insdvl models`: the shipped models, and what their cards say."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from insdvl.studies.document import check_place, tell
from insdvl.tuner.models import shipped_cards

_HEADER = ("name", "kind", "inputs", "window", "trained on", "error", "needs")
_FOOT = """\
window: samples; trained on: variances of white noise, or kinds of vehicles;
error, on what training has not seen: relative RMSE, or RMS of the logarithm of
the variance; onnx: needs insdvl[onnx].
The tuner's parameter 'model' takes a name."""
#: Extra of the packages that a kind of model needs aboard.
_NEEDS = {"network": "onnx"}


def run(arguments: argparse.Namespace) -> int:
    """Tell the cards; the exit code is 2 where they cannot be written."""
    cards = shipped_cards()
    try:
        check_place(arguments.json)
        tell(arguments.json, {card["name"]: card for card in cards}, _table(cards))
    except (ValueError, OSError) as error:
        print(f"insdvl models: {error}", file=sys.stderr)
        return 2
    return 0


def _table(cards: Sequence[Mapping[str, Any]]) -> str:
    rows = [_HEADER, *(_row(card) for card in cards)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(_HEADER))]
    lines = [
        "  ".join(f"{cell:{w}}" for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    return "\n".join([*lines, "", _FOOT])


def _row(card: Mapping[str, Any]) -> tuple[str, ...]:
    """A card as a row; what it does not say is empty."""
    data_set, metrics = card.get("data_set", {}), card.get("metrics", {})
    variances, kinds = data_set.get("variances", []), data_set.get("kinds", [])
    of_vehicles = metrics.get("test_rms_log_q", {}).get("learned", {}).get("all")
    error = metrics.get("trajectory_split", {}).get("relative_rmse")
    trained_on = f"{variances[0]:g} to {variances[-1]:g}" if variances else ""
    return (
        card["name"],
        card["kind"],
        card["feature_schema"],
        str(card["window"]),
        f"{len(kinds)} kinds" if kinds else trained_on,
        f"{error:.1%}" if error is not None else f"{of_vehicles:.2f} in log" if of_vehicles else "",
        _NEEDS.get(card["kind"], ""),
    )
