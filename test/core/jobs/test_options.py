"""Options of the workers."""

import argparse
import os

import pytest

from insdvl.jobs import arguments as module
from insdvl.jobs.arguments import add_worker_options
from insdvl.jobs.options import Workers, WorkersError, workers_from


def workers_of(*options):
    parser = argparse.ArgumentParser()
    add_worker_options(parser)
    return workers_from(parser.parse_args(options))


def test_options():
    assert workers_of() == Workers("loky", len(os.sched_getaffinity(0)))
    assert workers_of("--jobs", "3", "--backend", "dask") == Workers("dask", 3)
    scheduler = "tcp://host:8786"
    assert workers_of("--backend", "dask", "--scheduler", scheduler).scheduler == scheduler


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--jobs", "0"], "--jobs must be >= 1, got 0"),
        (["--scheduler", "host:1"], "--scheduler host:1 needs --backend dask, got loky"),
        (
            ["--backend", "dask", "--scheduler", "host:1", "--jobs", "2"],
            "--jobs 2 cannot be used with",
        ),
    ],
)
def test_bad_options(options, sentence):
    with pytest.raises(WorkersError, match=sentence):
        workers_of(*options)


def test_all_that_is_wrong_is_told() -> None:
    with pytest.raises(WorkersError) as raised:
        workers_of("--jobs", "0", "--scheduler", "host:1")
    assert [line[:14] for line in str(raised.value).splitlines()] == [
        "--jobs must be",
        "--scheduler ho",
        "--jobs 0 canno",
    ]


def test_dask_that_is_not_installed(monkeypatch):
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with pytest.raises(WorkersError, match=r"insdvl\[dask\]"):
        workers_of("--backend", "dask")
    assert workers_of("--jobs", "2") == Workers("loky", 2)
