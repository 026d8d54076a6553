"""The command `insdvl models`: the shipped models, and what their cards say."""

import argparse
from collections.abc import Mapping
from typing import Any

from insdvl.files import json_text
from insdvl.tuner.models import shipped_cards

_HEADER = ("name", "kind", "inputs", "window", "trained on", "error", "needs")
#: Extra of the packages that a kind of model needs aboard.
_NEEDS = {"network": "insdvl[onnx]"}


def run(arguments: argparse.Namespace) -> int:
    """Print the cards."""
    cards = shipped_cards()
    if arguments.json:
        print(json_text({card["name"]: card for card in cards}), end="")
        return 0
    rows = [_HEADER, *(_row(card) for card in cards)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(_HEADER))]
    for row in rows:
        print("  ".join(f"{cell:{w}}" for cell, w in zip(row, widths, strict=True)).rstrip())
    print()
    print("window: samples; trained on: variances of white noise, or kinds of vehicles; error, on")
    print("what training has not seen: relative RMSE, or RMS of the logarithm of the variance.")
    print("The tuner's parameter 'model' takes a name.")
    return 0


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
        f"{len(kinds)} kinds of vehicles" if kinds else trained_on,
        f"{error:.1%}" if error is not None else f"{of_vehicles:.2f} in log" if of_vehicles else "",
        _NEEDS.get(card["kind"], ""),
    )
