"""CONTRIBUTING.md, "Add a hair style", followed to the letter in a copy of the packages."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_ENTRIES = re.compile(r"(STYLES: dict\[str, Style\] = \{\n.*?)(^\})", re.DOTALL | re.MULTILINE)


def recipe() -> dict[str, str]:
    """The recipe's code blocks by language."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    section = re.split(r"^## ", text.split("## Add a hair style\n")[1], flags=re.MULTILINE)[0]
    return dict(re.findall(r"^```(\w*)\n(.*?)^```", section, re.DOTALL | re.MULTILINE))


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packages with the recipe's entry at the end of the table."""
    folder = tmp_path_factory.mktemp("copy")
    for package in ("assets_procedural", "synthgen", "render_jobs"):
        shutil.copytree(ROOT / package, folder / package)
    styles = folder / "assets_procedural/hair/styles.py"
    entry = recipe()["python"]
    changed, count = _ENTRIES.subn(lambda m: m[1] + entry + m[2], styles.read_text())
    assert count == 1
    styles.write_text(changed)
    return folder


def run(copy: Path, code: str, *arguments: str) -> str:
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_job_accepts_the_new_style_and_no_other(copy: Path):
    render = shlex.split(recipe()[""].splitlines()[0])
    job, setting = render[2], render[render.index("--set") + 1]
    code = "import sys; from synthgen.planning.job import load_job; load_job({!r}, {!r})"
    run(copy, code.format(job, [setting]))
    with pytest.raises(AssertionError, match="flattop"):
        run(copy, code.format(job, [setting.replace("flat_top", "flattop")]))


def test_people_are_drawn_who_wear_the_new_style(copy: Path):
    code = (
        "import numpy as np\n"
        "from assets_procedural.people.people_settings import PeopleSettings\n"
        "from assets_procedural.people.person_sampling import sample_person\n"
        "rng = np.random.default_rng(0)\n"
        "print(*(sample_person(rng, PeopleSettings()).hair.style for _ in range(1500)))"
    )
    assert run(copy, code).split().count("flat_top") > 2


def test_the_new_style_is_long_on_the_top_and_short_below(copy: Path):
    code = (
        "import numpy as np\n"
        "from assets_procedural.body.head import HeadModel\n"
        "from assets_procedural.hair.scalp_hair import scalp_hair\n"
        "from assets_procedural.person import Hair, Person\n"
        "person = Person(hair=Hair(style='flat_top'))\n"
        "identity = HeadModel.load().identity(person)\n"
        "piece, = scalp_hair(person, identity, np.random.default_rng(0))\n"
        "strands = piece.place(identity.neutral)\n"
        "length = np.linalg.norm(np.diff(strands, axis=1), axis=-1).sum(axis=1)\n"
        "top = strands[:, 0, 2] > np.quantile(strands[:, 0, 2], 0.7)\n"
        "print(len(strands), np.median(length[top]), np.median(length[~top]))"
    )
    count, top, below = map(float, run(copy, code).split())
    assert count > 10_000
    assert 0.03 < top < 0.1
    assert below < 0.5 * top
