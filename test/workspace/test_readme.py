"""The README: one screen, with commands that tests run and numbers that stand in the results."""

import re

from sources import ROOT

README = (ROOT / "README.md").read_text()
COMMANDS_PAGE = (ROOT / "docs" / "reference" / "commands.md").read_text()
PAGES = ROOT / "docs" / "results"
RESULTS = (PAGES / "calibrated.md").read_text() + (PAGES / "targets.md").read_text()


def test_it_is_one_screen_of_text() -> None:
    assert len(README.splitlines()) <= 60
    assert len(README.split()) <= 450


def test_its_picture_is_small() -> None:
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", README)
    assert len(pictures) == 1
    assert (ROOT / pictures[0]).stat().st_size <= 100_000


def test_its_commands_are_run_by_the_test_of_the_commands_page() -> None:
    """On the page of commands, word for word but for comments."""
    commands = re.findall(r"^insdvl [^#\n]*", README, re.MULTILINE)
    assert len(commands) == 5
    page = COMMANDS_PAGE.splitlines()
    assert [command.strip() for command in commands if command.strip() not in page] == []


def test_its_numbers_are_those_of_the_results() -> None:
    """Calibration and adaptation of `varying`, adaptation of `wide`, and the NEES of `varying`."""
    gain = r"`{}`: body velocity [\d.]+ %, of which ([\d.]+) % .*?\(calibration\), and ([\d.]+) %"
    (varying,), (wide,) = (re.findall(gain.format(name), RESULTS) for name in ("varying", "wide"))
    (nees,) = re.findall(
        r"`varying`: NEES per degree of freedom, velocity and attitude, .*?\| ([\d.]+) \(", RESULTS
    )
    said = re.findall(r"^- \*\w+\*:.*$", README, re.MULTILINE)
    numbers = [re.findall(r"\d+\.\d+", line) for line in said]
    assert numbers == [[varying[0]], [varying[1], wide[1]], [f"{float(nees):.2f}"]]
