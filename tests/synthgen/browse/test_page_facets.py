"""The filters of the page in a real browser: their order and words, maps, completion; and zoom."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import page_driver
import pytest

from synthgen.dataset import open_dataset

pytestmark = pytest.mark.browser


def test_people_come_first_in_words_and_constants_not_at_all(browser_page: Any):
    page = browser_page
    page.get_by_role("group", name="sex").get_by_text("female").wait_for()
    groups = page.locator(".group:not([hidden]) summary").all_inner_texts()
    names = [name.split()[0].lower() for name in groups]
    assert names[:5] == ["people", "light", "camera", "head", "expression"]
    assert names.index("dataset") < names.index("quality") < names.index("cost")
    # Every shot of the dataset is 48 pixels wide.
    assert page.get_by_role("img", name="Histogram of width").count() == 0
    assert page.get_by_role("img", name="Histogram of age in years").count() == 1
    caption = page.locator("#cell-0 .caption").inner_text()
    assert "multiview" in caption


def test_a_rectangle_of_a_map_chooses_both_angles(browser_page: Any, browse_dataset: Path):
    page = browser_page
    page.locator("summary", has_text="camera").first.click()
    canvas = page.get_by_role("img", name="Where it is seen from")
    canvas.scroll_into_view_if_needed()
    page.get_by_text("across,").first.wait_for()
    page_driver.screenshot(page, "coverage")
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.3, box["y"] + box["height"] * 0.2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] - 1, box["y"] + box["height"] * 0.9, steps=4)
    page.mouse.up()
    page.locator(".chip").first.wait_for()
    ranges = json.loads(parse_qs(urlsplit(page.url).query)["ranges"][0])
    assert ranges.keys() == {"camera_yaw", "camera_pitch"}
    ends = [(n, s, e) for n, r in ranges.items() for s, e in zip((">=", "<="), r, strict=True)]
    where = " AND ".join(f"{name} {sign} {end}" for name, sign, end in ends if end is not None)
    page.get_by_text(f"{len(open_dataset(browse_dataset, where=where))} of 16 shots").wait_for()
    canvas.click(position={"x": 20, "y": 20})
    page.locator(".chips").wait_for(state="hidden")


def test_a_condition_is_completed_by_columns_and_values(browser_page: Any, browse_dataset: Path):
    page = browser_page
    page.keyboard.press("/")
    page.keyboard.type("person_se")
    option = page.get_by_role("option", name="person_sex")
    option.wait_for()
    page.keyboard.press("Tab")
    field = page.get_by_label("SQL condition on the manifest")
    assert field.input_value() == "person_sex"
    page.keyboard.type(" = 'fem")
    page.locator("#completion-0", has_text="female").wait_for()
    page_driver.screenshot(page, "completion")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    assert field.input_value() == "person_sex = 'female'"
    page.keyboard.press("Enter")
    count = len(open_dataset(browse_dataset, where="person_sex = 'female'"))
    page.get_by_text(f"{count} of 16 shots").wait_for()
    # What is typed in full is asked for at once, whatever is suggested.
    field.fill("view = 1")
    page.keyboard.press("Enter")
    page.get_by_text("5 of 16 shots").wait_for()


def test_a_run_is_shown_beside_the_truth(chromium: Any, browse_site: str):
    """The run is made up: what is tested is the page, not the model."""
    names = ["source", "prediction", "truth", "difference"]

    def described(route: Any) -> None:
        route.fulfill(json=route.fetch().json() | {"run": names})

    def shot(route: Any) -> None:
        route.fulfill(json=route.fetch().json() | {"errors": {"PSNR (dB)": 21.5}})

    picture = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"/>'
    with page_driver.opened(chromium, "about:blank") as page:
        page.route("**/api/dataset", described)
        page.route("**/api/shot/**", shot)
        page.route("**/run_*", lambda r: r.fulfill(body=picture, content_type="image/svg+xml"))
        page.goto(f"{browse_site}#shot/multiview/s000000_p00")
        page.get_by_role("radio", name="Model").click()
        page.get_by_text("difference ×4").wait_for()
        assert page.locator(".figures figcaption").all_inner_texts()[:3] == names[:3]
        assert "21.5" in page.get_by_label("Errors of the run").inner_text()
        page.keyboard.press("1")
        page.get_by_alt_text("Picture under").first.wait_for()


def test_pictures_are_magnified_together_and_values_follow(chromium: Any, browse_site: str):
    address = f"{browse_site}#shot/multiview/s000000_p00"
    with page_driver.opened(chromium, address) as page:
        page.locator(".plate img").first.wait_for()
        before = page.locator(".plate img").first.bounding_box()
        for _ in range(3):
            page.keyboard.press("+")
        image = page.locator(".plate img").first
        zoomed = image.bounding_box()
        assert zoomed["width"] == pytest.approx(before["width"] * 1.5**3, rel=1e-3)
        plate = page.locator(".plate").first.bounding_box()
        middle = plate["x"] + plate["width"] / 2, plate["y"] + plate["height"] / 2
        page.mouse.move(*middle)
        page.get_by_text("24, 24", exact=True).wait_for()
        page.mouse.down()
        page.mouse.move(middle[0] + 60, middle[1], steps=3)
        page.mouse.up()
        moved = image.bounding_box()
        assert moved["x"] - zoomed["x"] == pytest.approx(60, abs=1)
        other = page.locator(".plate img").nth(1).bounding_box()
        assert other["width"] == pytest.approx(moved["width"], rel=1e-3)
        page.keyboard.press("0")
        assert image.bounding_box() == pytest.approx(before)
