"""The command `insdvl train --from-bags`: recordings of a vehicle -> what its DVL teaches."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError
from insdvl.parameters.sections import load_section
from insdvl.recordings.base import BagError
from insdvl.recordings.parameters import ReplayParameters
from insdvl.studies.replay.fold import fold_recording, read
from insdvl.studies.replay.inputs.extrinsics import with_extrinsics
from insdvl.studies.replay.taken import MOST
from insdvl.studies.teaching.lesson import Lesson, LessonError, lesson_of
from insdvl.studies.teaching.slow_error import slow_error_of
from insdvl.studies.teaching.teach import TeachingError, fits_of, teach
from insdvl.tuner.models import ModelError, write_model
from insdvl.tuner.parameters import TunerParameters

NAME = "taught"  # of the model


def run(arguments: argparse.Namespace) -> int:
    """Learn and write the model; the exit code is 2 for invalid input, 1 for a refusal."""
    try:
        lessons = lessons_of(arguments.from_bags, arguments.config or [])
        fits = fits_of(lessons, print)
        of_dvl = slow_error_of(fits)
        print("\n".join(of_dvl.lines))
        taught = teach(fits)
        card = {"name": NAME, **taught.card, "slow_error_of_dvl": of_dvl.card}
        written = write_model(arguments.out, taught.regressor.save(), card)
    except (TeachingError, LessonError) as error:
        for line in str(error).splitlines():
            print(f"insdvl train: no model: {line}", file=sys.stderr)
        return 1
    except (BagError, ParameterError, ModelError, OSError) as error:
        for line in str(error).splitlines():
            print(f"insdvl train: {line}", file=sys.stderr)
        return 2
    print("\n".join(taught.lines))
    for path in written:
        print(f"{path}: {path.stat().st_size} bytes")
    return 0


def lessons_of(bags: Sequence[Path], config: Sequence[Path]) -> list[Lesson]:
    """The lessons of recordings.

    Args:
        bags: The recordings.
        config: Parameter files of the nodes; all defaults without any.

    Raises:
        BagError: A recording cannot be read; a line for each that cannot be used.
        ParameterError: The parameters are refused.
        LessonError: A recording cannot teach; a line for each that cannot, with the reason.
    """
    files = list(config)
    filter_ = load_section(files, "insdvl_filter", FilterParameters, required=bool(files))
    tuner = load_section(files, "insdvl_tuner", TunerParameters)
    replay = load_section(files, "insdvl_replay", ReplayParameters)
    lessons: list[Lesson] = []
    faults: list[BagError | LessonError] = []
    for bag in bags:
        try:
            lessons.append(lesson_of_bag(bag, filter_, tuner, replay))
        except (BagError, LessonError) as error:
            faults.append(error)
    if faults:
        text = "\n".join(map(str, faults))
        unreadable = any(isinstance(fault, BagError) for fault in faults)
        raise BagError(text) if unreadable else LessonError(text)
    return lessons


def lesson_of_bag(
    bag: Path, parameters: FilterParameters, tuner: TunerParameters, replay: ReplayParameters
) -> Lesson:
    """The lesson of a recording, of its last part where its time jumps, and of at most `MOST`.

    The filter has its nominal process noise, whatever source it would have aboard.
    """
    recording = read(bag, replay, parameters)
    parameters = with_extrinsics(bag, recording, parameters)
    constant = replace(parameters.process_noise, source="constant")
    parameters = replace(parameters, process_noise=constant)
    replayed = fold_recording(recording, parameters)
    if replayed.findings:
        raise LessonError(f"{bag}: {replayed.findings[0]}")
    part = replayed.taken.first(MOST)
    stamps_ns, samples = part.samples
    if not len(stamps_ns):
        raise LessonError(f"{bag} has no usable samples of the IMU")
    return lesson_of(bag.name, parameters, tuner, stamps_ns, samples, part.events)
