"""README and docs: links lead to files and headings, and commands have options that exist."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path

import pytest
from support import PROJECT

PAGES = sorted(
    path
    for pattern in ("*.md", "docs/*.md", "docs/*/*.md", "bags/*.md", "benchmarks/*.md", "bringup/*.md")
    for path in PROJECT.glob(pattern)
)
LINK = re.compile(r"\]\((?!https?:)([^)\s]*)\)")
COMMAND = re.compile(r"^(?:python3 bootstrap\.py|ros2 run ik_node) ([^#>\n]+)", re.MULTILINE)
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def anchors(path: Path) -> set[str]:
    """Anchors that GitHub gives the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(PROJECT)))
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for link in LINK.findall(re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name}: {link}"
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), f"{page.name}: {link}"


def commands() -> list[tuple[str, str]]:
    """Page and command line of every executable of this package in a shell block."""
    return [
        (page.name, command)
        for page in PAGES
        for block in BLOCK.findall(page.read_text(encoding="utf-8"))
        for command in COMMAND.findall(block)
        if not re.search(r"[A-Z]{4,}|--ros-args|\.\.\.", command)
    ]


@pytest.mark.parametrize(("page", "command"), commands())
def test_commands_have_options_that_exist(page: str, command: str) -> None:
    name, *arguments = shlex.split(command)
    if name in ("test", "ik_benchmark", "ik_node", "ik_simulator", "ik_watchdog"):
        pytest.skip("its options are those of pytest, of a benchmark, or of ROS")
    module = importlib.import_module(f"ik_node.cli.{name.removeprefix('ik_')}")
    module.parser().parse_args(arguments)


def test_there_are_commands_to_check() -> None:
    assert len([command for _, command in commands() if not command.startswith(("test", "ik_benchmark"))]) >= 10
