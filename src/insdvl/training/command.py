"""The command `insdvl train`: data set -> model and card."""

import argparse
import io
import json
import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from insdvl.tuner.forest import Forest
from insdvl.tuner.models import sha256
from insdvl.tuner.schemas import SCHEMAS

MAX_SEED = 2**32 - 1  # scikit-learn's largest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--preset",
        default="paper",
        choices=tuple(SCHEMAS),
        help="which model; paper: 24 features, as published (default)",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes; the model does not depend on it (default: all cores)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="of data set, split and ensemble (default: 0)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("models"),
        metavar="DIR",
        help="folder of the two files, PRESET.npz and PRESET.json (default: ./models)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Train, and write the two files; the exit code is 2 where the input is refused."""
    try:
        _check(arguments)
    except (ValueError, OSError) as error:
        print(f"insdvl train: {error}", file=sys.stderr)
        return 2
    # Only training needs scikit-learn: the other commands start without it.
    from insdvl.training.ensemble import train

    forest, card = train(arguments.preset, arguments.seed, arguments.jobs, print)
    try:
        written = write(arguments.out, forest, card)
    except OSError as error:
        print(f"insdvl train: cannot write the model: {error}", file=sys.stderr)
        return 2
    for path in written:
        print(f"{path}: {path.stat().st_size} bytes")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    if arguments.jobs < 1:
        raise ValueError(f"--jobs must be >= 1, got {arguments.jobs}")
    if not 0 <= arguments.seed <= MAX_SEED:
        raise ValueError(f"--seed must be within 0 to {MAX_SEED}, got {arguments.seed}")
    # Minutes of work come before the files: whether they can be written is tried first.
    existing = arguments.out
    while not existing.exists():
        existing = existing.parent
    if not existing.is_dir():
        raise ValueError(f"--out {arguments.out}: {existing} is not a folder")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise ValueError(f"--out {arguments.out}: {error.strerror or error}") from error


def write(out: Path, forest: Forest, card: Mapping[str, Any]) -> tuple[Path, Path]:
    """The files of a model: both are complete before either takes its name.

    The arrays are not compressed, so that their bytes, and the hash, do not depend on a
    compressor's version.
    """
    buffer = io.BytesIO()
    arrays: dict[str, Any] = forest.arrays
    np.savez(buffer, **arrays)
    data = buffer.getvalue()
    text = json.dumps({**card, "sha256": sha256(data)}, indent=2) + "\n"
    out.mkdir(parents=True, exist_ok=True)
    targets = out / f"{card['name']}.npz", out / f"{card['name']}.json"
    with tempfile.TemporaryDirectory(dir=out, prefix=".train-") as folder:
        for target, content in zip(targets, (data, text.encode()), strict=True):
            (Path(folder) / target.name).write_bytes(content)
        for target in targets:
            os.replace(Path(folder) / target.name, target)
    return targets
