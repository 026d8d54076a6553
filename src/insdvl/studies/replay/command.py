"""The command `insdvl replay`: the core filter over a recording, without ROS."""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from insdvl.commands import INTERRUPTED
from insdvl.jobs.progress import Progress
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError, flatten
from insdvl.parameters.files import ParameterFile
from insdvl.parameters.files import read as read_files
from insdvl.parameters.sections import Loaded, full_name, nothing_for, reaches, warnings
from insdvl.parameters.settings import load_set, settings
from insdvl.recordings.base import BagError
from insdvl.recordings.parameters import ReplayParameters
from insdvl.recordings.played import Recording
from insdvl.studies.arguments.output import TERMINAL
from insdvl.studies.document import check_place, write_document
from insdvl.studies.judgement.incidents import incidents_of
from insdvl.studies.judgement.noise import NoiseInForce
from insdvl.studies.judgement.verdict import Verdict, verdict
from insdvl.studies.replay.fold import Replayed, fold_recording, read
from insdvl.studies.replay.inputs.between import Between
from insdvl.studies.replay.inputs.extrinsics import with_extrinsics
from insdvl.studies.replay.inputs.injection import Injected, Injection
from insdvl.studies.replay.inputs.sources import (
    Configuration,
    check_named,
    named_of,
    with_measurement_noise,
    with_process_noise,
)
from insdvl.studies.replay.inputs.watched import Watched, interruption
from insdvl.studies.replay.result import Output, new_folder
from insdvl.studies.replay.scores import report
from insdvl.studies.replay.text import TABLE, VERDICT, side_by_side, table_of, verdict_of
from insdvl.studies.report.facts import card_of, changed_parameters, versions
from insdvl.terminal import say
from insdvl.tuner.parameters import TunerParameters
from insdvl.watch.start import waits_for


def run(arguments: argparse.Namespace) -> int:
    """Replay. The exit code is 2 if the input is refused; then nothing is written.

    It is 1 with ``--strict`` where the verdict has a finding.
    """
    try:
        found, interrupted = _replay(arguments)
    except MemoryError as error:
        print(f"insdvl replay: not enough memory for {arguments.bag}: {error}", file=sys.stderr)
        return 2
    except (ValueError, OSError) as error:
        text = str(error)
        faults = text.splitlines() if isinstance(error, ParameterError) else [text]
        for fault in faults:
            print(f"insdvl replay: {' '.join(fault.split())}", file=sys.stderr)
        return 2
    if interrupted:
        return INTERRUPTED
    return 1 if found and arguments.strict else 0


def _replay(arguments: argparse.Namespace) -> tuple[bool, bool]:
    """Replay; returns whether the verdict has a finding, and whether it was interrupted."""
    out = _check_places(arguments)
    first, *others = (_configured(arguments, further) for further in ("", *arguments.compare))
    for text in dict.fromkeys(text for one in (first, *others) for text in one.warnings):
        print(f"insdvl replay: WARN {text}", file=sys.stderr)
    check_named([first, *others])
    # First, since one that is refused must leave no result behind.
    compared = [_navigated(arguments, other, None)[0] for other in others]
    with interruption() as ends:
        document, judgement, without_report = _navigated(arguments, first, out, ends)
    if compared:
        document["compared"] = compared
    write_document(arguments.json, document)
    words = sys.stderr if arguments.json == TERMINAL else sys.stdout
    say(table_of(document), TABLE, words)
    if out is not None:
        print(f"{'result':32} {out}", file=words)
    if without_report:
        print(f"{'report.html':32} left out: {without_report}", file=words)
    say(verdict_of(document), VERDICT, words)
    if compared:
        print(side_by_side([document, *compared]), file=words)
    if document["interrupted"]:
        text = f"interrupted: the result is of the first {document['duration']:.0f} s"
        print(f"insdvl replay: {text}", file=sys.stderr)
    return bool(judgement.findings), document["interrupted"]


def _never() -> bool:
    return False


def _navigated(
    arguments: argparse.Namespace,
    configuration: Configuration,
    out: Path | None,
    ends: Callable[[], bool] = _never,
) -> tuple[dict[str, Any], Verdict, str]:
    """The document of a configuration, its verdict, and why there is no report.

    Args:
        arguments: Of the command.
        configuration: With what it is navigated.
        out: Folder of the result, None for none.
        ends: Whether the recording ends here, though it goes on.
    """
    filter_, tuner, replay = configuration.filter, configuration.tuner, configuration.replay
    injection = _injection(arguments)

    stored = read(arguments.bag, replay, filter_)
    recording: Recording = stored
    if arguments.begin is not None or arguments.end is not None:
        recording = Between(recording, arguments.begin or 0.0, arguments.end)
    filter_ = with_extrinsics(arguments.bag, recording, filter_)
    if injection is not None:
        recording = Injected(recording, injection)
    configuration = replace(configuration, filter=filter_)
    recording, q_from = with_process_noise(recording, configuration)
    recording, r_from = with_measurement_noise(recording, configuration)
    end = min(stored.duration, arguments.end or math.inf)
    progress = Progress("seconds", max(int(end - (arguments.begin or 0.0)), 1))
    recording = Watched(recording, progress if sys.stderr.isatty() else None, ends)

    in_force = NoiseInForce()

    def judged(replayed: Replayed) -> tuple[dict[str, Any], Verdict]:
        if not replayed.last.known_ns:
            raise BagError(
                f"the filter was never initialised (initial.mode {filter_.initial.mode!r}): it "
                f"waits for {waits_for(filter_)}"
            )
        document = report(replayed)
        judgement = verdict(replayed, filter_, document)
        document |= {
            "bag": str(arguments.bag),
            "interrupted": ends(),
            "configuration": configuration.text,
            "process_noise": q_from,
            "measurement_noise": r_from,
            "dvl_noise_in_force": in_force.numbers(replayed.fold.filter, replayed.taken),
            "injected_noise": asdict(injection) if injection else None,
            "parameters": {"insdvl_filter": flatten(filter_), "insdvl_tuner": flatten(tuner)},
            "verdict": judgement.numbers,
            "incidents": [asdict(incident) for incident in incidents_of(replayed)],
            "versions": versions(),
            "changed_parameters": changed_parameters(filter_),
            "model": card_of(tuner) if q_from.startswith("external, learned") else None,
        }
        return document, judgement

    without_report = ""
    if out is None:
        with progress:
            replayed = fold_recording(recording, filter_, [in_force])
        document, judgement = judged(replayed)
    else:
        with Output(out, filter_, arguments.rate) as output:
            with progress:
                replayed = fold_recording(recording, filter_, [in_force, output])
            document, judgement = judged(replayed)
            without_report = output.finish(replayed, document)
    return document, judgement, without_report


def _configured(arguments: argparse.Namespace, further: str = "") -> Configuration:
    """The parameters of the three nodes.

    Args:
        arguments: Of the command.
        further: A file, or a setting, beside those of the arguments.
    """
    paths, rules = list(arguments.config or []), list(arguments.set)
    if "=" in further and not Path(further).exists():
        rules.append(further)
    elif further:
        paths.append(Path(further))
    groups = {
        "insdvl_filter": FilterParameters,
        "insdvl_tuner": TunerParameters,
        "insdvl_replay": ReplayParameters,
    }
    if arguments.estimator is not None:
        rules.append(f"insdvl_tuner:estimator={arguments.estimator}")
        # A source that is set beside it precedes it, and is refused where the estimator is idle.
        rules.insert(0, "insdvl_filter:process_noise.source=external")
    faults: list[str] = []
    told = settings(rules, groups, faults)
    files = read_files(paths)
    names = [_full_name(arguments.namespace, files, node) for node in groups]
    loaded: list[Loaded[Any]] = []
    for name, (node, group) in zip(names, groups.items(), strict=True):
        try:
            loaded.append(load_set(files, name, group, told[node]))
        except ParameterError as error:
            faults += str(error).splitlines()
    if faults:
        raise ParameterError("\n".join(dict.fromkeys(faults)))
    unknown_to_all = [g for g in loaded[0].ignored if all(g in one.ignored for one in loaded)]
    warned = warnings(files, names, unknown_to_all)
    if files and not any(reaches(file, names[:1]) for file in files):
        warned += [nothing_for(file, names[:1]) for file in files if reaches(file, names)]
    filter_, tuner, replay = (one.parameters for one in loaded)
    text = ", ".join([*map(str, paths), *rules]) or "all defaults: no --config was given"
    named = named_of(told["insdvl_tuner"])
    learns_dvl_noise = "measurement_noise" in told["insdvl_tuner"] and tuner.measurement_noise
    return Configuration(filter_, tuner, replay, named, learns_dvl_noise, text, tuple(warned))


def _full_name(namespace: str | None, files: Sequence[ParameterFile], node: str) -> str:
    if namespace is None:
        return full_name(files, node)
    return f"/{namespace.strip('/')}/{node}" if namespace.strip("/") else f"/{node}"


def _check_places(arguments: argparse.Namespace) -> Path | None:
    """Check before the long computation that the results can be written; the folder of the result.

    Nothing is overwritten but the file of --json.
    """
    check_place(arguments.json)
    out: Path | None = arguments.out
    if out is None:
        return new_folder(arguments.bag) if arguments.json is None else None
    return out


def _injection(arguments: argparse.Namespace) -> Injection | None:
    if arguments.inject_noise is None:
        return None
    text = arguments.inject_noise
    try:
        limits = [float(part) for part in text.split(",")]
    except ValueError:
        limits = []
    ordered = len(limits) == 4 and 0 < limits[0] <= limits[1] and 0 < limits[2] <= limits[3]
    if not ordered or not all(math.isfinite(limit) for limit in limits):
        raise ValueError(
            "--inject-noise must be four numbers ACC_LO,ACC_HI,GYR_LO,GYR_HI with "
            f"0 < LO <= HI, got {text!r}"
        )
    return Injection((limits[0], limits[1]), (limits[2], limits[3]), arguments.seed)
