"""What several test files share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import fake_renderer
import page_driver
import pytest
from answer import Answer

from assets_procedural.conventions import console
from synthgen.farm.local import render_job

# Tensors of tests are small: threads cost more than they save. Before torch is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_collection_finish() -> None:
    """Blender runs in processes of its own, which inherit the paths that importing it here adds."""
    if "bpy" in sys.modules:
        raise pytest.UsageError("a test module imports bpy; let it run in a process of its own")


@pytest.fixture
def run_main(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Answer]:
    """Runs a command line's `main` with arguments in this process, sparing a start of Python."""
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    # Where a busy machine takes long, work would say how far it is, beside what a test looks for.
    monkeypatch.setattr(console, "FIRST_LINE", 60.0)

    def run(main: Callable[[], None], *arguments: object) -> Answer:
        monkeypatch.setattr(sys, "argv", ["command", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        captured = capsys.readouterr()
        return Answer(int(end.value.code or 0), captured.out, captured.err)

    return run


@pytest.fixture(scope="module")
def blender():
    """Runs a function in one spawned process with Blender."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        yield lambda function, *arguments: executor.submit(function, *arguments).result(timeout=300)


@pytest.fixture(scope="session")
def small_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`fake_renderer.small_job` rendered by one worker without interruption. Do not change it."""
    out = tmp_path_factory.mktemp("small") / "out"
    job = fake_renderer.small_job()
    assert render_job(job, out, workers=1, renderer=fake_renderer.RENDERER).complete
    return out


@pytest.fixture(scope="session")
def transparent_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same people before nothing, display-referred alone. Do not change it."""
    out = tmp_path_factory.mktemp("transparent") / "out"
    job = fake_renderer.small_job(image={"linear": False, "background": "transparent"})
    assert render_job(job, out, workers=1, renderer=fake_renderer.RENDERER).complete
    return out


@pytest.fixture(scope="session")
def browse_dataset(small_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`small_dataset` with meshes, a hostile name and one shard that is cut short."""
    return page_driver.prepare(small_dataset, tmp_path_factory.mktemp("browse") / "dataset")


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A headless Chromium; skips where there is none."""
    with page_driver.chromium() as browser:
        yield browser


@pytest.fixture(scope="session")
def browse_site(
    chromium: Any, browse_dataset: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[str]:
    """The address of `synthgen browse` over `browse_dataset`."""
    with page_driver.served(browse_dataset, tmp_path_factory.mktemp("cache")) as address:
        yield address


@pytest.fixture
def browser_page(chromium: Any, browse_site: str) -> Iterator[Any]:
    """The page at 1280 x 800, which must not complain until the test ends."""
    with page_driver.opened(chromium, browse_site) as page:
        page.locator(".cell.loaded").first.wait_for()
        yield page
