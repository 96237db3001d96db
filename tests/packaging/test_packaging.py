"""What stands beside the packages agrees with them: metadata, hooks, Dockerfile, site."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

import synthgen

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PACKAGES = ("assets_procedural", "synthgen", "totalediting")


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == synthgen.__version__
    assert citation["title"] == PROJECT["name"]
    assert citation["license"] == PROJECT["license"]
    assert [author["name"] for author in citation["authors"]] == [
        author["name"] for author in PROJECT["authors"]
    ]


def test_the_packages_say_that_they_are_typed():
    for package in PACKAGES:
        assert (ROOT / package / "py.typed").is_file(), package


def test_hooks_check_what_make_lint_checks():
    config = ROOT / ".pre-commit-config.yaml"
    command = [sys.executable, "-m", "pre_commit", "validate-config", config]
    subprocess.run(command, check=True, capture_output=True)
    (repository,) = yaml.safe_load(config.read_text())["repos"]
    hooks = {hook["entry"].removeprefix(".venv/bin/").split()[0] for hook in repository["hooks"]}
    makefile = (ROOT / "Makefile").read_text()
    lint = makefile[makefile.index("\nlint:") : makefile.index("\ntest:")]
    assert hooks == {*re.findall(r"\$\(BIN\)/(\S+)", lint), "make"}


def test_the_image_is_made_of_files_that_exist_and_installs_extras_that_exist():
    text = (ROOT / "Dockerfile").read_text()
    sources = [
        source
        for line in re.findall(r"^COPY (.+)$", text, re.MULTILINE)
        for source in line.split()[:-1]
    ]
    # All but what .dockerignore lets through is kept from the build.
    let_through = re.findall(r"^!(.+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE)
    assert sorted(sources) == sorted(let_through)
    assert all((ROOT / source).exists() for source in sources)
    (extras,) = re.findall(r"'/source\[(.+)\]'", text)
    assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation as a site, where a link that leads nowhere is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize("package", ["synthgen", "totalediting"])
def test_the_site_documents_all_that_can_be_relied_on(site: Path, package: str):
    page = (site / "api" / "index.html").read_text()
    for name in importlib.import_module(package).__all__:
        if not name.startswith("_"):
            assert f'id="{package}.{name}"' in page


def test_the_site_has_a_page_for_every_module(site: Path):
    for package in PACKAGES:
        for source in (ROOT / package).rglob("[!_]*.py"):
            place = source.relative_to(ROOT).with_suffix("")
            assert (site / "api" / place / "index.html").is_file(), place
