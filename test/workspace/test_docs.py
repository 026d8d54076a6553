"""Links and paths of pages and sources lead somewhere."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from sources import ROOT, modules

from insdvl.parameters.sections import load_section
from insdvl.studies.report.parameter_page import SECTIONS

PAGES = [ROOT / "README.md", *sorted(ROOT.glob("*/**/*.md"))]
PAGES = [
    page for page in PAGES if not re.match(r"\.|build|install|log", page.relative_to(ROOT).parts[0])
]
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```", re.DOTALL)


@cache
def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", CODE.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken(page: Path) -> Iterator[str]:
    for link in LINK.findall(CODE.sub("", page.read_text())):
        path, _, anchor = link.partition("#")
        if "://" in link:
            continue
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            yield link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    assert list(broken(page)) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_parameter_files_on_a_page_are_valid(page: Path, tmp_path: Path) -> None:
    for block in re.findall(r"```\n(/\*\*/insdvl_.*?)```", page.read_text(), re.DOTALL):
        (tmp_path / "file.yaml").write_text(block)
        for node, group in SECTIONS.items():
            load_section(tmp_path / "file.yaml", node, group)


def test_pages_named_in_sources_exist() -> None:
    tests = sorted((ROOT / "test").rglob("*.py"))
    configurations = sorted(ROOT.glob("ros_insdvl*/config/*.yaml"))
    others = [ROOT / "Makefile", ROOT / "README.md", ROOT / "models" / "README.md"]
    missing = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in [*modules().values(), *tests, *configurations, *others]
        for name in re.findall(r"\bdocs/[\w/.-]+\.(?:md|svg|json)", path.read_text())
        if not (ROOT / name).is_file()
    ]
    assert missing == []


def test_the_index_has_every_page() -> None:
    index = (ROOT / "docs" / "README.md").read_text()
    pages = [str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")]
    assert [page for page in pages if page != "README.md" and f"({page})" not in index] == []


def test_the_example_of_a_sensor_is_the_code() -> None:
    """Each block of the page names its file, and stands in it as it is."""
    page = (ROOT / "docs" / "how-to" / "extending.md").read_text()
    blocks = re.findall(r"```python\n# (\S+)\n\n(.*?)\n```", page, re.DOTALL)
    assert {path.rpartition("/")[2] for path, _ in blocks} == {
        "depth.py",
        "parameters.py",
        "topics.py",
    }
    for path, block in blocks:
        source = (ROOT / path).read_text()
        for part in block.split("\n\n# ...\n\n"):
            assert part in source, f"{path} does not have:\n{part}"
