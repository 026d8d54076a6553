"""`insdvl warm`: compile the functions of filter, tuner, simulator and replay, and cache them.

For the image of a vehicle's computer, and after an update: the first start then takes no longer
than any other.
"""

import argparse
import sys
import time
from pathlib import Path

from insdvl import kernels
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import build
from insdvl.simulation.mission import mission_of
from insdvl.simulation.parameters import SimulatorParameters
from insdvl.timeline.compilation import compile_fold
from insdvl.timeline.recorded import fold_arrays
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner
from insdvl.watch.alignment.check import compile_check


def run(arguments: argparse.Namespace) -> int:
    """Compile and cache; 1 if nothing can be cached."""
    warnings: list[str] = []
    begin = time.monotonic()
    with kernels.compiling(
        begins=lambda why: print(f"compiling {why}: about a minute", flush=True),
        ends=lambda seconds: print(f"compiled in {seconds:.0f} s"),
        warns=warnings.append,
    ):
        compile_all()
    folder = kernels.cache_dir(Path(kernels.__file__))
    if folder is None and not warnings:
        warnings.append("no folder is writable: set INSDVL_CACHE_DIR")
    if folder is None or warnings:
        print(f"insdvl warm: {'; '.join(warnings)}", file=sys.stderr)
        return 1
    print(f"ready in {folder.parent}, {time.monotonic() - begin:.0f} s in all")
    return 0


def compile_all() -> None:
    """Call every function that is compiled, as programs do."""
    parameters = FilterParameters()
    compile_fold(parameters)
    compile_check(parameters)
    mission = mission_of(SimulatorParameters())
    fold_arrays(parameters, mission.stamps_ns, mission.f_b, mission.w_ib_b, [])
    for model in ("default", "paper"):
        Tuner(build(TunerParameters, {"model": model}))
