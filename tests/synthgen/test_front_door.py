"""`from synthgen import …`: what is promised is there, and costs nothing before it is used."""

from __future__ import annotations

import subprocess
import sys

import pytest

import synthgen
from synthgen.dataset import open_dataset
from synthgen.farm.local import render_job
from synthgen.planning.job import load_job


def loaded_after(code: str) -> set[str]:
    """The modules that a fresh interpreter has loaded after `code`."""
    command = [sys.executable, "-c", f"import sys; {code}; print(*sys.modules)"]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())


def test_importing_the_package_imports_nothing_else() -> None:
    loaded = loaded_after("import synthgen; dir(synthgen)")
    assert not {"numpy", "pydantic", "torch", "bpy", "typer", "rich"} & loaded
    assert {name for name in loaded if name.startswith("synthgen.")} == set()


@pytest.mark.parametrize("name", ["load_job", "open_dataset", "render_job"])
def test_no_name_brings_blender_or_torch(name: str) -> None:
    assert not {"bpy", "torch", "anny"} & loaded_after(f"from synthgen import {name}")


def test_reading_loads_nothing_of_the_farm() -> None:
    loaded = loaded_after("from synthgen import open_dataset")
    assert not [name for name in loaded if name.startswith("synthgen.farm")]


def test_all_lists_what_is_there() -> None:
    assert set(synthgen.__all__) <= set(dir(synthgen))
    assert all(getattr(synthgen, name) for name in synthgen.__all__)
    assert synthgen.open_dataset is open_dataset
    assert synthgen.load_job is load_job
    assert synthgen.render_job is render_job


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'synthgen' has no attribute 'render_jbo'"):
        getattr(synthgen, "render_jbo")  # noqa: B009
    with pytest.raises(ImportError):
        exec("from synthgen import render_jbo")
