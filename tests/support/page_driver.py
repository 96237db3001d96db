"""Driving the page of `synthgen browse` in a real browser: a dataset, its server, Chromium.

Nothing here is collected; the fixtures `browse_dataset`, `browse_site` and `browser_page` of
conftest.py are made of it.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fake_renderer
import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import ConvexHull
from trimesh.visual import ColorVisuals

from synthgen.dataset import open_dataset

ROOT = Path(__file__).parents[2]
SCREENSHOTS = ROOT / "out" / "browser"
"""Where screenshots are kept, to be looked at."""
HOSTILE = "<img src=x onerror=\"document.title='owned'\">"
"""The name of the dataset: whatever the page does, it is text."""
BROKEN = "multiview/s000004_p01"
"""A shot whose shard is cut short."""


def prepare(small: Path, folder: Path) -> Path:
    """A copy of `small_dataset` with meshes, a hostile name and a shard that is cut short."""
    shutil.copytree(small, folder)
    for path in (folder / "subjects").rglob("*.glb"):
        path.write_bytes(_mesh())
    described = json.loads((folder / "dataset.json").read_text())
    (folder / "dataset.json").write_text(json.dumps(described | {"name": HOSTILE}))
    dataset = open_dataset(folder)
    index, place = dataset.index, dataset.position(BROKEN)
    shard = folder / index.shards[index.shard[place]]
    with shard.open("r+b") as file:
        file.truncate(int(index.offset[place]) + 512)
    return folder


def _mesh() -> bytes:
    """A mesh with a vertex for each control point of the fake renderer, as glTF, Y up."""
    points = fake_renderer._landmarks(np.zeros(3))
    mesh = trimesh.Trimesh(points, ConvexHull(points).simplices, process=False)
    mesh.visual = ColorVisuals(mesh, vertex_colors=np.full((70, 4), 190, np.uint8))
    scene = trimesh.Scene()
    scene.add_geometry(mesh, geom_name="skin")
    scene.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    exported = scene.export(file_type="glb")
    assert isinstance(exported, bytes)
    return exported


@contextlib.contextmanager
def served(folder: Path, cache: Path, *options: str) -> Iterator[str]:
    """The address of a server of the dataset; `cache` holds thumbnails, lightmaps and tags."""
    code = "from synthgen.cli import main; main()"
    arguments = ["browse", str(folder), "--port", "0", *options]
    kept = {"SYNTHGEN_CACHE": str(cache), "XDG_DATA_HOME": str(cache / "data")}
    with answering(code, arguments, **kept) as at:
        yield at


@contextlib.contextmanager
def answering(code: str, arguments: list[str], **environment: str) -> Iterator[str]:
    """The address that a process running Python code prints first."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=ROOT,
        env=os.environ | {"PYTHONUNBUFFERED": "1"} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout and process.stderr
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line + process.stderr.read()
        yield found.group()
    finally:
        process.terminate()
        process.communicate(timeout=30)


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """A headless Chromium: the system's, or Playwright's own. Skips where there is neither."""
    try:
        from playwright.sync_api import (  # pyright: ignore[reportMissingImports]
            Error,
            sync_playwright,
        )
    except ModuleNotFoundError:
        pytest.skip("playwright is not installed: make test-browser")
    # A machine without a graphics card draws in software.
    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as driver:
        try:
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        except Error as error:
            pytest.skip(f"no Chromium is installed: {str(error).splitlines()[0]}")
        try:
            yield browser
        finally:
            browser.close()


@contextlib.contextmanager
def opened(browser: Any, address: str, **options: Any) -> Iterator[Any]:
    """A page at an address that must not complain: no errors, nothing against its policy."""
    with browser.new_context(**({"viewport": {"width": 1280, "height": 800}} | options)) as context:
        page = context.new_page()
        page.set_default_timeout(60_000)
        complaints: list[str] = []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
        page.complaints = complaints
        page.goto(address)
        yield page
        # What the server refuses is said on the page; the browser's note of it is no fault.
        faults = [c for c in complaints if "Failed to load resource" not in c]
        assert not faults, faults


def screenshot(page: Any, name: str) -> None:
    """Keep what the page looks like now."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=str(SCREENSHOTS / f"{name}.png"))


def pixels(page: Any, selector: str) -> np.ndarray:
    """What a canvas shows, (H, W, 4) uint8, alpha not premultiplied."""
    url = page.evaluate("s => document.querySelector(s).toDataURL()", selector)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGBA"))
