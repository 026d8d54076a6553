"""The arguments of `insdvl train`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from insdvl.commands import Names, examples, unknown_names
from insdvl.jobs.arguments import add_worker_options, worker_faults

#: The names that the modules of the study define; a test holds that they are the same.
PRESETS = ("bands", "default", "paper", "dnn", "dnn-default")
BANDS = "bands"
WINDOW = 200  # samples
_LIMITS = (10, 2000)  # of a window
_LIMITS_OF = {BANDS: (WINDOW, WINDOW), "dnn": (22, 2000), "dnn-default": (22, 2000)}
MAX_SEED = 2**32 - 1  # scikit-learn's largest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "train --preset default --out models",
        "train --preset paper --window 100 --seed 3 --jobs 2",
        "train --preset bands --quick --out models",
        "train --from-bags dive1 dive2 dive3 --config my.yaml --out models",
    )
    parser.set_defaults(faults=_faults)
    parser.add_argument(
        "--preset",
        default="default",
        choices=Names(PRESETS),
        help="model to train; default: trees for any scale; paper: trees as published; "
        "dnn-default, dnn: the same with a convolutional network; bands: trees on band powers, "
        "for noise that is not white",
    )
    parser.add_argument(
        "--from-bags",
        type=Path,
        nargs="+",
        metavar="BAG",
        help="recordings of one vehicle, at least two: its DVL teaches which bands of the IMU's "
        "spectrum are noise; the model is named taught, and the options above and below it, "
        "--config and --out aside, have no effect",
    )
    parser.add_argument(
        "-c",
        "--config",
        type=Path,
        action="append",
        metavar="YAML",
        help="with --from-bags: parameter file of the nodes; may be given several times",
    )
    parser.add_argument(
        "--window",
        type=int,
        default=WINDOW,
        metavar="N",
        help="samples of a window; other than 200, the model is named PRESET-N (default: 200)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="random seed of data set, split and training (default: 0)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="use a tenth of the data; the name of the model ends with -quick",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("models"),
        metavar="DIR",
        help="output folder of model and card (default: ./models)",
    )
    add_worker_options(parser)


def _faults(arguments: argparse.Namespace) -> Iterator[str]:
    if arguments.from_bags:
        for path in (*arguments.from_bags, *(arguments.config or [])):
            if not path.exists():
                yield f"{path} does not exist"
        return
    if arguments.config:
        yield "--config is used with --from-bags only: name the recordings, or leave it out"
    preset, window = arguments.preset, arguments.window
    yield from unknown_names("--preset", [preset], PRESETS)
    yield from worker_faults(arguments)
    if not 0 <= arguments.seed <= MAX_SEED:
        yield f"--seed must be within 0 to {MAX_SEED}, got {arguments.seed}"
    low, high = _LIMITS_OF.get(preset, _LIMITS)
    if not low <= window <= high:
        yield f"--window must be within {low} to {high}, got {window}"
