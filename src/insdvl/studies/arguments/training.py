"""The arguments of `insdvl train`."""

import argparse
from pathlib import Path

from insdvl.commands import examples
from insdvl.jobs.arguments import add_worker_options

#: The names that the modules of the study define; a test holds that they are the same.
PRESETS = ("bands", "default", "paper", "dnn", "dnn-default")
WINDOW = 200  # samples


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = examples(
        "train --preset default --out models",
        "train --preset paper --window 100 --seed 3 --jobs 2",
        "train --preset bands --quick --out models",
        "train --from-bags dive1 dive2 dive3 --config my.yaml --out models",
    )
    parser.add_argument(
        "--preset",
        default="default",
        choices=PRESETS,
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
        help="--preset bands with a fifth of the vehicles",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("models"),
        metavar="DIR",
        help="output folder of model and card (default: ./models)",
    )
    add_worker_options(parser)
