"""Jobs by name: what ships is found anywhere, a path stays a path, the rest is one helpful line."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel

from assets_procedural.settings import Settings
from synthgen.errors import JobError
from synthgen.planning import shipped_jobs as shipped
from synthgen.planning.job import JobSpec, SubsetSpec, load_job

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Outside a checkout."""
    monkeypatch.chdir(tmp_path)


def test_every_shipped_job_is_found_by_its_name() -> None:
    files = {path.stem: path for path in (ROOT / "render_jobs").glob("*.toml")}
    assert shipped.shipped_jobs() == files
    assert load_job("demo") == load_job(files["demo"])


def test_every_shipped_job_says_what_it_is_for_in_a_line() -> None:
    for file in shipped.shipped_jobs().values():
        assert 10 < len(shipped.purpose(file)) < 110, file


def _settings(table: type[BaseModel], before: str = "") -> set[str]:
    """Dotted names of all settings of a job but for those of its subsets."""
    names: set[str] = set()
    for name, field in table.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, Settings) and kind.model_fields:
            names |= _settings(kind, f"{before}{name}.")
        elif name != "subsets":
            names.add(before + name)
    return names


def test_multiview_and_video_explain_every_setting(tmp_path: Path) -> None:
    said: set[str] = set()
    for name in ("multiview", "video"):
        text = shipped.shipped_jobs()[name].read_text()
        text = re.sub(r"^# (?=\[|\w+ += )", "", text, flags=re.MULTILINE)
        read = tomllib.loads(text)
        said |= {f"subsets.{setting}" for s in read["subsets"].values() for setting in s}
        said |= {name for name in read if not isinstance(read[name], dict)}
        said |= {f"{t}.{setting}" for t, v in read.items() if isinstance(v, dict) for setting in v}
        job = tmp_path / "job.toml"
        job.write_text(re.sub("^people_of.*", "", text, flags=re.MULTILINE))  # of no real subset
        load_job(job)
    known = _settings(JobSpec) | {f"subsets.{name}" for name in SubsetSpec.model_fields}
    assert known <= said, known - said


def test_a_file_of_that_name_comes_first() -> None:
    Path("demo").write_text(Path(ROOT, "render_jobs", "video.toml").read_text())
    assert load_job("demo").name == "video"


def test_a_folder_of_that_name_is_no_job() -> None:
    Path("demo").mkdir()
    assert load_job("demo").name == "demo"


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(JobError, match=r'^JOB: dmo: no such job; did you mean "demo"') as error:
        load_job("dmo")
    assert ", ".join(shipped.shipped_jobs()) in str(error.value)
    assert os.linesep not in str(error.value)


def test_what_ends_in_toml_is_a_path() -> None:
    with pytest.raises(JobError, match=r"^demo\.toml: no such job file"):
        load_job("demo.toml")


def test_an_installation_without_jobs_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shipped, "PACKAGE", "no_such_package")
    shipped.shipped_jobs.cache_clear()
    try:
        with pytest.raises(JobError, match="shipped: none are installed; or give the path"):
            load_job("demo")
    finally:
        shipped.shipped_jobs.cache_clear()
