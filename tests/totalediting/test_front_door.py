"""What `import totalediting` offers, and what the README says is public beside it."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

import totalediting


def test_everything_that_is_named_is_there() -> None:
    for name in totalediting.__all__:
        assert getattr(totalediting, name) and name in dir(totalediting)


def test_bake_is_the_one_of_lightmaps() -> None:
    from totalediting import bake
    from totalediting.light import lightmaps

    assert bake is lightmaps.bake


def test_importing_it_is_light() -> None:
    code = "import sys, totalediting; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert not {"torch", "numpy", "bpy"} & set(loaded.stdout.split())


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'bakes'"):
        _ = totalediting.bakes  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    ("module", "names"),
    [
        ("light.phong", ("reflect", "compose", "shade", "display", "undisplay")),
        ("light.lightmaps", ("bake", "sample", "rotate", "encode", "decode")),
        ("geometry.moving_least_squares", ("mls", "mls_reference")),
        ("geometry.surface_field", ("surface_field",)),
        ("geometry.field", ("Control", "Field", "Table", "tabulate")),
        (
            "geometry.volume",
            ("rays", "triplane", "stratified", "importance", "quadrature", "planar_depth"),
        ),
    ],
)
def test_light_and_motion_are_public(module: str, names: tuple[str, ...]) -> None:
    found = import_module(f"totalediting.{module}")
    assert all(callable(getattr(found, name)) for name in names)
