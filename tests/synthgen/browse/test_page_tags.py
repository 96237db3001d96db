"""Tags on the page in a real browser: by mouse and keyboard, for one and many, and undone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import page_driver
import pytest

from synthgen.dataset import open_dataset, tags
from synthgen.dataset.records import read_description

pytestmark = pytest.mark.browser


@pytest.fixture
def place(tmp_path: Path) -> Path:
    return tmp_path / "tags"


@pytest.fixture
def page(chromium: Any, browse_dataset: Path, tmp_path: Path, place: Path) -> Iterator[Any]:
    options = ("--tags-in", str(place), "--as", "ann")
    with (
        page_driver.served(browse_dataset, tmp_path / "cache", *options) as site,
        page_driver.opened(chromium, site) as page,
    ):
        page.locator(".writable .cell.loaded").first.wait_for()
        yield page


def starred(out: Path, place: Path, tag: str = "star") -> list[str]:
    found = tags.read(place, read_description(out)).shots(tag)
    keys = open_dataset(out).keys()
    return [key for key in keys if key in found]


def test_keys_tag_one_and_undo_it(page: Any, browse_dataset: Path, place: Path):
    keys = open_dataset(browse_dataset).keys()
    page.locator("#grid").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("s")
    page.locator("#cell-1 .badge.star").wait_for()
    assert starred(browse_dataset, place) == [keys[1]]
    page.keyboard.press("r")
    page.locator("#cell-1.rejected").wait_for()
    page.keyboard.press("u")
    page.locator("#cell-1:not(.rejected)").wait_for()
    page.keyboard.press("s")
    page.locator("#cell-1 .badge.star").wait_for(state="detached")
    assert starred(browse_dataset, place) == []
    # On the page of a shot the same keys are of that shot.
    page.keyboard.press("Enter")
    page.locator(".viewbar h1").wait_for()
    page.get_by_role("button", name="Reject, or no longer").click()
    page.locator(".viewbar .badge.reject").wait_for()
    assert starred(browse_dataset, place, "reject") == [keys[1]]
    page.keyboard.press("u")
    page.locator(".viewbar .badge.reject").wait_for(state="detached")


def test_the_mouse_picks_many_and_a_word_is_given_to_all(
    page: Any, browse_dataset: Path, place: Path
):
    keys = open_dataset(browse_dataset).keys()
    page.locator("#cell-0").hover()
    page.locator("#cell-0 .pickbox").click()
    page.locator("#cell-3").click(modifiers=["Shift"])
    page.get_by_text("4 picked").wait_for()
    page.get_by_role("button", name="Star, or no longer").click()
    page.get_by_text("Starred: 4 shots").wait_for()
    assert starred(browse_dataset, place) == keys[:4]
    page_driver.screenshot(page, "picked")
    page.get_by_role("button", name="Undo the last change").click()
    page.get_by_text("Undone").wait_for()
    assert starred(browse_dataset, place) == []
    page.get_by_role("button", name="Pick no shot").click()
    page.get_by_role("group", name="subset").locator(".value", has_text="video").get_by_role(
        "checkbox"
    ).check()
    page.get_by_text("6 of 16 shots").wait_for()
    page.locator("#grid").focus()
    page.keyboard.press("t")
    page.get_by_label("Tag", exact=True).last.fill("clips")
    page.get_by_label("All 6 shots of the selection").check()
    page.keyboard.press("Enter")
    page.get_by_text("Tagged “clips”: 6 shots").wait_for()
    assert starred(browse_dataset, place, "clips") == [k for k in keys if k.startswith("video")]
    page.get_by_role("button", name="Remove subset: video").click()
    page.get_by_role("button", name="Only shots without clips").click()
    page.get_by_text("10 of 16 shots").wait_for()
    page.reload()
    page.get_by_text("10 of 16 shots").wait_for()
    page.get_by_role("button", name="Remove without clips").click()
    page.get_by_text("16 shots").wait_for()
