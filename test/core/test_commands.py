"""The frame of the command: what it says without running anything, and how it ends."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from insdvl import cli, commands
from insdvl.commands import COMMANDS, overview, parser_of, whole_parser
from insdvl.simulation import noise
from insdvl.simulation.drawn.scenarios import DRAWN
from insdvl.simulation.grades import GRADES
from insdvl.simulation.trajectories import AUV
from insdvl.studies.arguments import consistency as of_consistency
from insdvl.studies.arguments import evaluation as of_evaluation
from insdvl.studies.arguments import results as of_results
from insdvl.studies.arguments import training as of_training
from insdvl.studies.consistency.page import STUDIES
from insdvl.studies.evaluation import approaches, outages
from insdvl.studies.results.command import PARTS
from insdvl.studies.training.command import PRESETS
from insdvl.studies.training.dataset import WINDOW

HEAVY = {"joblib", "matplotlib", "numba", "numpy", "rosbags", "scipy", "sklearn", "torch", "yaml"}
LOOK = """
import contextlib, io, sys
from insdvl.cli import main
for words in {calls}:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        with contextlib.suppress(SystemExit):
            main(words)
print(*{{name.partition(".")[0] for name in sys.modules}})
"""


def loaded(calls: list[list[str]], folder: Path) -> set[str]:
    """The packages that some calls load, all in one interpreter."""
    result = subprocess.run(
        [sys.executable, "-c", LOOK.format(calls=calls)], cwd=folder, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    return set(result.stdout.split())


def test_helps_and_wrong_calls_load_nothing_heavy(tmp_path: Path) -> None:
    calls = [[], ["--help"], ["--version"], ["fly"], *([name, "--help"] for name in COMMANDS)]
    calls += [[name, "--no-such-option"] for name in COMMANDS] + [["replay"], ["train", "--seed"]]
    calls += [[name, *call.split()] for name, (call, _) in WRONG_CALLS.items()]
    found = loaded(calls, tmp_path)
    assert found & HEAVY == set()
    assert {"insdvl", "argparse"} <= found


def test_alone_it_says_in_12_lines_what_one_can_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 12
    assert max(map(len, lines)) <= 80
    assert [name for name in COMMANDS if name not in overview()] == []


def examples_of(name: str) -> list[list[str]]:
    """The words of the examples in a help, behind `insdvl NAME`."""
    lines = [line.strip() for line in parser_of(name).format_help().splitlines()]
    calls = [line.removeprefix("insdvl ") for line in lines if line.startswith("insdvl ")]
    return [commands_of_shell(call)[1:] for call in calls if call.split()[0] == name]


def commands_of_shell(line: str) -> list[str]:
    """The words of the first command of a line, without what follows for the shell."""
    words = shlex.split(line)
    ends = [k for k, word in enumerate(words) if word in ("&&", ">", "|")]
    return words[: min(ends, default=len(words))]


@pytest.mark.parametrize("name", COMMANDS)
def test_a_help_has_two_examples_that_parse_and_the_exit_codes(name: str) -> None:
    examples = examples_of(name)
    assert len(examples) >= 2
    for words in examples:
        parser_of(name).parse_args(words)
    assert "exit code: 0 done" in parser_of(name).format_help()


@pytest.mark.parametrize("name", [name for name, c in COMMANDS.items() if c.goal])
def test_the_examples_of_the_overview_parse(name: str) -> None:
    parser_of(name).parse_args(COMMANDS[name].example.split())


def test_a_wrong_command_is_told_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["repaly", "dive"]) == 2
    error = capsys.readouterr().err
    assert "unknown command 'repaly'; did you mean replay?" in error
    assert cli.main(["--verison"]) == 2
    assert "unknown option '--verison'" in capsys.readouterr().err


def test_all_wrong_options_are_told_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["evaluate", "--scenaro", "wide", "--jsn=x.json", "--runs", "3"])
    assert ended.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "insdvl evaluate: unknown option --scenaro; did you mean --scenario?",
        "insdvl evaluate: unknown option --jsn; did you mean --json?",
        "See insdvl evaluate --help.",
    ]
    with pytest.raises(SystemExit) as ended:
        cli.main(["init"])
    assert ended.value.code == 2
    assert "required: BAG, -o" in capsys.readouterr().err


WRONG_CALLS = {
    "evaluate": (
        "--scenario vary --preset calibratd --rows orcle,hcf,bands --runs 1 --seed -1 --dvl-std 0 "
        "--duration 5 --jobs 0 --json no/x.json",
        [
            "--scenario: unknown name 'vary'; did you mean varying?; known are constant, ",
            "--preset: unknown name 'calibratd'; did you mean calibrated?; known are calibrated, ",
            "--rows: unknown name 'orcle'; did you mean oracle?; known are constant 0.01/0.001, ",
            "--rows: unknown name 'hcf'; known are constant 0.01/0.001, ",
            "--runs must be >= 2, got 1",
            "--seed must be >= 0, got -1",
            "--dvl-std must be within 0.001 to 10 m/s, got 0",
            "--duration must be within 10 to 330 s, got 5",
            "--jobs must be >= 1, got 0",
        ],
    ),
    "train": (
        "--preset defalt --window 1 --seed -1 --quick --scheduler host:1",
        [
            "--preset: unknown name 'defalt'; did you mean default?; known are bands, default, ",
            "--scheduler host:1 needs --backend dask, got loky",
            "--seed must be within 0 to 4294967295, got -1",
            "--window must be within 10 to 2000, got 1",
        ],
    ),
    "results": (
        "--parts windw,vehicle --runs 1 --tuning-runs 0 --jobs 0",
        [
            "--parts: unknown name 'windw'; did you mean window?; known are q-accuracy, ",
            "--parts vehicle needs --recordings and --config",
            "--runs must be >= 2, got 1",
            "--tuning-runs must be >= 2, got 0",
            "--jobs must be >= 1, got 0",
        ],
    ),
    "consistency": (
        "--studies blcks,heading --runs 1 --seed -3 --jobs -1",
        [
            "--studies: unknown name 'blcks'; did you mean blocks?; known are blocks, position, ",
            "--runs must be >= 2, got 1",
            "--seed must be >= 0, got -3",
            "--jobs must be >= 1, got -1",
        ],
    ),
}


@pytest.mark.parametrize("name", WRONG_CALLS)
def test_all_wrong_values_of_a_study_are_told_together(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    call, expected = WRONG_CALLS[name]
    assert cli.main([name, *call.split()]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == len(expected)
    for line, text in zip(lines, expected, strict=True):
        assert line.startswith(f"insdvl {name}: {text}")
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_ends_with_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "resolve_name", lambda name: interrupted)
    assert cli.main(["doctor"]) == 130
    assert cli.main(["evaluate", "--json", "x.json"]) == 130
    assert capsys.readouterr().err.splitlines() == [
        "insdvl doctor: interrupted",
        "insdvl evaluate: interrupted; finished parts are kept, run it again",
    ]


@pytest.mark.parametrize(
    "call", ["params", "cite", "completion bash", "params --help", "--help", ""]
)
def test_a_reader_that_has_seen_enough_is_no_error(call: str) -> None:
    """As in `insdvl params | head`: silence, and the exit code of a process that SIGPIPE ends."""
    reader, writer = os.pipe()
    os.close(reader)
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "insdvl.cli", *call.split()]
    try:
        ended = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, env=paths)
    finally:
        os.close(writer)
    assert (ended.returncode, ended.stderr) == (141, b"")


def test_names_in_arguments_are_those_of_the_modules() -> None:
    assert (*noise.SCENARIOS, *DRAWN) == of_evaluation.SCENARIOS
    assert tuple(GRADES) == of_evaluation.GRADES
    assert outages.CONVERGENCE == of_evaluation.CONVERGENCE
    assert tuple(approaches.PRESETS) == of_evaluation.PRESETS
    assert of_evaluation.ROWS == approaches.ROWS
    assert of_evaluation.TRUE_FACTOR_ROWS == (approaches.TRUE_FACTOR, approaches.TRUE_FACTORS)
    assert of_evaluation.TAUGHT == approaches.TAUGHT
    assert tuple(approaches.R_SOURCES) == of_evaluation.R_ROWS
    assert AUV.duration == of_evaluation.DURATION
    assert of_results.PARTS == PARTS
    assert tuple(PRESETS) == of_training.PRESETS
    assert of_training.WINDOW == WINDOW
    assert tuple(study.name for study in STUDIES) == of_consistency.STUDIES


def test_the_whole_parser_has_every_command() -> None:
    parsed = whole_parser().parse_args(["check", "dive", "--json", "-"])
    assert (parsed.command, str(parsed.bag)) == ("check", "dive")
    assert commands.nearest("chekc", COMMANDS) == "; did you mean check?"
