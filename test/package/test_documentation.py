"""The documentation names files, targets and links that exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.paths import ROOT

PAGES = sorted([ROOT / "README.md", ROOT / "test" / "README.md", *(ROOT / "docs").glob("*.md")])
FOLDERS = (
    "benchmarks",
    "config",
    "docs",
    "examples",
    "executables",
    "launch",
    "scripts",
    "sros2",
    "test",
    "urdf",
)
PACKAGE = ROOT / "gear_dynamics_ros"


def links(text: str) -> Iterator[str]:
    """Targets of links and pictures in this repository, with their anchors."""
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not re.match(r"[a-z]+:", target):
            yield target


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    headings = re.findall(r"^#+ (.+)$", text, flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def named_files(text: str) -> Iterator[Path]:
    """Files and folders of the repository that a page names in the typeface of code."""
    for name in re.findall(r"`([\w./-]+)`", text):
        first = name.split("/")[0]
        if "/" in name and first in FOLDERS:
            yield ROOT / name
        elif "/" in name and name.endswith(".py") and (PACKAGE / first).is_dir():
            yield PACKAGE / name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in links(page.read_text(encoding="utf-8")):
        target, _, anchor = link.partition("#")
        linked = (page.parent / target) if target else page
        assert linked.exists(), link
        assert not anchor or anchor in anchors(linked), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_that_are_named_exist(page: Path) -> None:
    assert [path for path in named_files(page.read_text(encoding="utf-8")) if not path.exists()] == []


def test_make_has_the_targets_that_are_named() -> None:
    targets = set(re.findall(r"^([a-z_]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.M))
    named = {
        name for page in PAGES for name in re.findall(r"`make ([a-z_]+)", page.read_text(encoding="utf-8"))
    }
    assert {"demo", "test", "bench"} <= named <= targets
