"""What the README and the docs say exists: links, pictures, commands, options, jobs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer

from synthgen import cli as synthgen
from synthgen.planning.job import load_job
from totalediting import cli as totalediting

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
JOBS = sorted((ROOT / "render_jobs").glob("*.toml"))
APPS = {"synthgen": synthgen.app, "totalediting": totalediting.app}
COMMAND = re.compile(rf"`?((?:{'|'.join(APPS)}) [a-z][^`\n#|]*)")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path):
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


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
