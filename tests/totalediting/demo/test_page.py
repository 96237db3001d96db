"""The page of `totalediting demo` in a real browser."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import page_driver
import pytest
from known_faces import NOBODY, a_portrait, save

from assets_procedural.conventions import panorama_files

pytestmark = pytest.mark.browser

# Faces are known, so that no network is fetched.
_CODE = """
from known_faces import an_editor
from totalediting.demo.serve import serve
serve("127.0.0.1", 0, print, an_editor())
"""


def paths() -> str:
    """Where a process finds `known_faces`."""
    ours = [str(page_driver.ROOT / "tests/support"), str(page_driver.ROOT)]
    return os.pathsep.join([*ours, os.environ.get("PYTHONPATH", "")])


@pytest.fixture(scope="module")
def site():
    pytest.importorskip("gradio", reason="gradio is not installed: make test-browser")
    with page_driver.answering(_CODE, [], PYTHONPATH=paths()) as address:
        yield address


@pytest.fixture
def page(chromium, site):
    """The page, which asks nobody else for anything."""
    with page_driver.opened(chromium, "about:blank") as page:
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(site)
        page.locator("#appearance_examples img").first.wait_for()
        yield page
        others = {url for url in asked if not url.startswith((site, "data:", "blob:"))}
        assert not others, others


def drop(page: Any, zone: str, path: Path) -> None:
    page.locator(f"#{zone}_drop input[type=file]").set_input_files(str(path))


def shown(page: Any) -> str:
    """The address of the edited picture, once there is one."""
    page.locator("#edited img").wait_for()
    return page.locator("#edited img").get_attribute("src")


def changed(page: Any, before: str) -> str:
    """The address of another edited picture, once it is there."""
    page.wait_for_function("s => document.querySelector('#edited img')?.src !== s", arg=before)
    return shown(page)


def slide(page: Any, name: str, value: str) -> None:
    page.locator(f"#{name} input[type=number]").fill(value)
    page.keyboard.press("Enter")


@pytest.fixture
def files(tmp_path):
    pixels = np.full((16, 32, 3), 0.1, np.float32)
    pixels[4:8, 6:10] = 30
    panorama_files.write(tmp_path / "sun.exr", pixels, {})
    save(tmp_path / "a.png", a_portrait())
    save(tmp_path / "nobody.png", a_portrait(NOBODY))
    (tmp_path / "<b>broken.png").write_bytes(b"no picture")
    return tmp_path


def test_a_dropped_picture_is_shown_lit_turned_and_taken_apart(page, files):
    drop(page, "appearance", files / "a.png")
    plain = shown(page)
    drop(page, "lighting", files / "sun.exr")
    lit = changed(page, plain)
    slide(page, "rotate_light", "90")
    turned = changed(page, lit)
    slide(page, "jawOpen", "0.8")
    changed(page, turned)
    page.locator("#take_apart").click()
    page.locator("#layers img").nth(3).wait_for()
    page_driver.screenshot(page, "demo")


@pytest.mark.parametrize(
    ("name", "line"),
    [("nobody.png", "no face found"), ("<b>broken.png", "mend it or leave it out")],
)
def test_a_picture_that_cannot_be_used_is_one_line_in_the_page(page, files, name, line):
    drop(page, "appearance", files / name)
    said = page.locator("#appearance_said [role=alert]")
    said.wait_for()
    assert line in said.inner_text() and "Traceback" not in page.content()
    assert str(files) not in said.inner_text() and not page.locator("#appearance_said b").count()
    drop_again = page.locator("#appearance_drop button[aria-label=Clear]")
    if drop_again.count():
        drop_again.first.click()


def test_an_example_is_chosen_and_a_phone_shows_all_of_the_width(page):
    page.set_viewport_size({"width": 390, "height": 844})
    page.locator("#lighting_examples button").first.click()
    page.locator("#lighting_shown img").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page_driver.screenshot(page, "demo_phone")


def test_another_host_name_is_refused_and_the_policy_is_sent(page, site):
    answer = page.request.get(site)
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert page.request.get(site, headers={"Host": "example.org"}).status == 403


def test_ended_from_outside_it_leaves_no_upload(site, tmp_path):
    with page_driver.answering(_CODE, [], PYTHONPATH=paths(), TMPDIR=str(tmp_path)):
        assert list(tmp_path.glob("totalediting-demo-*"))
    assert not list(tmp_path.glob("totalediting-demo-*"))
