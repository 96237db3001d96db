"""What the pages say exists: links, paths, names, pictures, commands with their options, jobs."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from synthgen import cli as synthgen
from synthgen.planning.job import load_job
from totalediting import cli as totalediting

ROOT = Path(__file__).parents[1]
DOCS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES = [*DOCS, ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md"]
JOBS = sorted((ROOT / "render_jobs").glob("*.toml"))
APPS = {"synthgen": synthgen.app, "totalediting": totalediting.app}
PACKAGES = r"(?:assets_procedural|synthgen|totalediting)"
COMMAND = re.compile(rf"(?<!from )`?\b((?:{'|'.join(APPS)}) [a-z][^`\n#|]*)")
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE_BLOCK = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
PATH = re.compile(
    rf"(?<![\w./-])(?:{PACKAGES}|benchmarks|docs|examples|render_jobs|tests)/[\w./-]*"
)
TEST = re.compile(r"`(test_\w+\.py)::(\w+)`")
DOTTED = re.compile(rf"`({PACKAGES}(?:\.\w+)+)")
IMPORT = re.compile(rf"^from ({PACKAGES}[\w.]*) import ([\w, ]+)", re.MULTILINE)

every_page = pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
every_doc = pytest.mark.parametrize("page", DOCS, ids=lambda p: p.name)


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)", CODE_BLOCK.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@every_page
def test_links_lead_somewhere(page: Path):
    for target in LINK.findall(page.read_text()):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        found = page.parent / name if name else page
        assert found.exists(), f"{page.name} links to {target}"
        assert not anchor or anchor in anchors(found), f"{page.name} links to {target}"


@every_doc
def test_files_and_folders_that_are_named_exist(page: Path):
    for path in PATH.findall(page.read_text()):
        assert (ROOT / path.rstrip(".")).exists(), f"{page.name} names {path}"


@every_doc
def test_tests_that_are_named_exist(page: Path):
    for file, name in TEST.findall(page.read_text()):
        (path,) = (ROOT / "tests").rglob(file)
        assert f"\ndef {name}(" in path.read_text(), f"{page.name} names {file}::{name}"


@every_doc
def test_modules_and_functions_that_are_named_exist(page: Path):
    text = page.read_text()
    names = DOTTED.findall(text)
    for module, imported in IMPORT.findall(text):
        names += [f"{module}.{name.strip()}" for name in imported.split(",")]
    for name in names:
        assert resolve(name) is not None, f"{page.name} names {name}"


def test_the_readmes_python_runs(
    small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/demo").symlink_to(small_dataset)
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), re.M | re.S)
    assert blocks
    for block in blocks:
        exec(block, {})


def resolve(name: str) -> Any:
    """What a dotted name stands for: a module, or what is found inside one."""
    package, *rest = name.split(".")
    found = importlib.import_module(package)
    for i, part in enumerate(rest):
        try:
            found = getattr(found, part)
        except AttributeError:
            found = importlib.import_module(".".join([package, *rest[: i + 1]]))
    return found


@every_page
def test_tables_are_whole(page: Path):
    """Each has a header, a rule below it, and as many cells in every row."""
    text = CODE_BLOCK.sub("", page.read_text())
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        lines = re.sub(r"`[^`]*`", "", table).splitlines()
        assert len(lines) > 1 and set(lines[1]) <= set("|-: "), f"{page.name}: {lines[0]}"
        cells = [line.count("|") for line in lines]
        assert set(cells) == {cells[0]}, f"{page.name}: {lines[cells.index(max(cells))]}"


def test_pictures_are_small():
    pictures = [p for p in (ROOT / "docs").iterdir() if p.suffix in (".jpg", ".png")]
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size < 500_000, picture


@pytest.mark.parametrize("page", [*PAGES, *JOBS], ids=lambda p: p.name)
def test_commands_exist_with_the_options_that_are_shown(page: Path):
    for line in COMMAND.findall(page.read_text()):
        program, *words = shlex.split(line.rstrip(".,;)"))
        group = typer.main.get_command(APPS[program])
        command = group.commands.get(words[0])  # pyright: ignore[reportAttributeAccessIssue]
        assert command is not None, line
        known = {option for parameter in command.params for option in parameter.opts}
        assert {w.split("=")[0] for w in words if w.startswith("--")} <= known, line


@pytest.mark.parametrize("job", JOBS, ids=lambda p: p.name)
def test_the_jobs_that_are_shipped_are_valid(job: Path):
    assert load_job(job).name == job.stem
