"""The command `insdvl train`: data set -> model and card."""

import argparse
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

from insdvl.jobs.options import Workers, WorkersError, workers_from
from insdvl.jobs.pool import TaskError, open_pool
from insdvl.jobs.store import Store
from insdvl.studies.teaching import command as teaching
from insdvl.studies.training import dataset
from insdvl.tuner.models import write_model


@dataclass(frozen=True)
class Preset:
    """The module that trains a model.

    Attributes:
        module: Has ``train(preset, window, seed, pool, store, say)``; imported only when needed.
        quick: Further arguments of it, for a tenth of the data.
        packages: Optional packages that it needs.
    """

    module: str
    quick: Mapping[str, int]
    packages: tuple[str, ...] = ()


_FEW_WINDOWS = MappingProxyType({"n_windows": dataset.WINDOWS // 10})
_TREES = Preset("insdvl.studies.training.ensemble", _FEW_WINDOWS)
_NETWORK = Preset("insdvl.studies.training.network", _FEW_WINDOWS, ("torch", "onnx", "onnxruntime"))
_BANDS = Preset("insdvl.studies.training.bands", MappingProxyType({"of_each_kind": 10}))

PRESETS = {
    "bands": _BANDS,
    "default": _TREES,
    "paper": _TREES,
    "dnn": _NETWORK,
    "dnn-default": _NETWORK,
}


def run(arguments: argparse.Namespace) -> int:
    """Train, and write model and card; the exit code is 2 for invalid input.

    Finished parts are kept in the output folder until both files are written, so an interrupted
    training resumes.
    """
    if arguments.from_bags:
        return teaching.run(arguments)
    preset, window, out = arguments.preset, arguments.window, arguments.out
    name = preset if window == dataset.WINDOW else f"{preset}-{window}"
    if arguments.quick:
        name += "-quick"
    try:
        workers = _checked(arguments)
    except (ValueError, OSError) as error:
        print(f"insdvl train: {error}", file=sys.stderr)
        return 2
    module = import_module(PRESETS[preset].module)
    extent = PRESETS[preset].quick if arguments.quick else {}
    try:
        with open_pool(workers) as pool:
            store = Store(
                out / f".{name}.work",
                {"preset": preset, "window": window, "seed": arguments.seed, **extent},
                Path(str(module.__file__)),
            )
            data, card = module.train(preset, window, arguments.seed, pool, store, print, **extent)
            written = write_model(out, data, {"name": name, **card})
            store.clear()
    except (WorkersError, OSError) as error:
        print(f"insdvl train: {error}", file=sys.stderr)
        return 2
    except TaskError as error:
        print(f"insdvl train: {error}", file=sys.stderr)
        return 1
    for path in written:
        print(f"{path}: {path.stat().st_size} bytes")
    return 0


def _checked(arguments: argparse.Namespace) -> Workers:
    workers = workers_from(arguments)
    preset = PRESETS[arguments.preset]
    missing = [name for name in preset.packages if find_spec(name) is None]
    if missing:
        raise ValueError(
            f"--preset {arguments.preset} needs {', '.join(missing)}: "
            "install insdvl[dnn] and insdvl[onnx]"
        )
    # Training takes minutes: check first that the files can be written.
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
    return workers
