"""The page of `synthgen browse` in a real browser: grid, filters, address, views, keys, faults."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import page_driver
import pytest

from synthgen.dataset import open_dataset
from synthgen.dataset.manifest import query

pytestmark = pytest.mark.browser
SHOTS = 16  # of the dataset


def total(page: Any, number: int, of: int | None = SHOTS) -> None:
    """Waits until the bar says how many shots are chosen."""
    text = f"{number:,} of {of:,} shots" if of and number != of else f"{number:,} shots"
    page.locator(".total", has_text=re.compile(f"^{re.escape(text)}$")).wait_for()


def option(page: Any, name: str) -> str:
    """A parameter of the address."""
    return parse_qs(urlsplit(page.url).query).get(name, [""])[0]


def test_the_grid_shows_every_shot_and_a_broken_one_with_its_reason(browser_page: Any):
    page = browser_page
    total(page, SHOTS)
    page.locator(".cell").nth(SHOTS - 1).wait_for()
    broken = page.locator(".cell.broken")
    broken.first.wait_for()
    assert "cut short" in broken.first.inner_text()
    page.wait_for_function(
        "n => document.querySelectorAll('.cell.loaded, .cell.broken').length === n", arg=SHOTS
    )
    assert broken.count() < SHOTS / 2
    page_driver.screenshot(page, "grid")


def test_a_choice_filters_counts_and_stays_in_the_address(browser_page: Any):
    page = browser_page
    video = page.get_by_role("group", name="subset").locator(".value", has_text="video")
    video.get_by_role("checkbox").check()
    total(page, 6)
    assert json.loads(option(page, "facets")) == {"subset": ["video"]}
    # A facet's own counts leave its choice out, those of others do not.
    subset = page.get_by_role("group", name="subset")
    assert "10" in subset.get_by_text("multiview").locator("..").inner_text()
    page.reload()
    total(page, 6)
    assert video.get_by_role("checkbox").is_checked()
    page.go_back()
    total(page, SHOTS)
    page.go_forward()
    total(page, 6)
    page.get_by_role("button", name="Remove subset: video").click()
    total(page, SHOTS)
    assert option(page, "facets") == ""


def test_a_range_is_typed_or_dragged(browser_page: Any, browse_dataset: Path):
    page = browser_page
    low = page.get_by_label("age in years, from")
    low.fill("50")
    low.press("Enter")
    expected = len(open_dataset(browse_dataset, where="person_age_years >= 50"))
    total(page, expected)
    assert json.loads(option(page, "ranges")) == {"person_age_years": [50, None]}
    page.get_by_role("button", name="Remove", exact=False).first.click()
    total(page, SHOTS)
    plot = page.get_by_role("img", name="Histogram of age in years")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.5, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.8, box["y"] + 20, steps=4)
    page.mouse.up()
    page.locator(".chip").wait_for()
    low, high = json.loads(option(page, "ranges"))["person_age_years"]
    found = open_dataset(browse_dataset, where=f"person_age_years BETWEEN {low} AND {high}")
    total(page, len(found))


def test_an_sql_condition_and_a_wrong_one(browser_page: Any, browse_dataset: Path):
    page = browser_page
    page.keyboard.press("/")
    page.keyboard.type("head_yaw < 0")
    page.keyboard.press("Enter")
    total(page, len(open_dataset(browse_dataset, where="head_yaw < 0")))
    assert option(page, "where") == "head_yaw < 0"
    field = page.get_by_label("SQL condition on the manifest")
    field.fill("no_such_column = 1")
    field.press("Enter")
    problem = page.locator("#where-problem")
    problem.wait_for()
    assert "no_such_column" in problem.inner_text()
    assert "Candidate" in problem.inner_text()
    assert "\n" not in problem.inner_text()
    page_driver.screenshot(page, "wrong-condition")
    field.fill("head_yaw > 99")
    field.press("Enter")
    page.get_by_role("heading", name="No shots match").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Remove head_yaw > 99").click()
    total(page, SHOTS)


def test_a_selection_is_taken_along(browser_page: Any, browse_dataset: Path):
    page = browser_page
    page.get_by_role("group", name="subset").locator(".value", has_text="video").get_by_role(
        "checkbox"
    ).check()
    total(page, 6)
    page.locator("#grid").focus()
    page.keyboard.press("e")
    line = page.locator(".ways code").first
    line.wait_for()
    chosen = eval(line.inner_text(), {"open_dataset": open_dataset})
    assert len(chosen) == 6
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Copy the keys of all these shots").click()
    page.get_by_text("Copied").wait_for()
    assert page.evaluate("navigator.clipboard.readText()").split() == chosen.keys()
    with page.expect_download() as download:
        page.get_by_role("link", name="CSV").click()
    assert Path(download.value.path()).read_text().count("\n") == 7
    page_driver.screenshot(page, "export")
    page.keyboard.press("Escape")
    page.locator("#export").wait_for(state="hidden")
    total(page, 6)


def test_sorting_orders_the_grid_both_ways(browser_page: Any, browse_dataset: Path):
    page = browser_page
    page.get_by_label("Sort by").select_option("camera_yaw")
    rows = query(browse_dataset, "SELECT subset || '/' || key, camera_yaw FROM manifest").rows
    leads = "key => document.querySelector('#cell-0')?.getAttribute('aria-label')?.startsWith(key)"
    page.wait_for_function(leads, arg=min(rows, key=lambda row: row[1])[0])
    assert option(page, "sort") == "camera_yaw"
    page.get_by_role("button", name="Ascending").click()
    page.wait_for_function(leads, arg=max(rows, key=lambda row: row[1])[0])
    assert option(page, "descending") == "1"


def test_two_million_shots_scroll_within_a_page_of_bounded_height(chromium: Any, browse_site: str):
    """The rows are made up: what is tested is the page, not the database."""

    def rows(route: Any) -> None:
        asked = parse_qs(urlsplit(route.request.url).query)
        offset, limit = int(asked["offset"][0]), int(asked["limit"][0])
        made = [
            {"key": f"s{i:07d}_p00", "subset": "multiview", "environments": [], "broken": None}
            for i in range(offset, min(offset + limit, 2_000_000))
        ]
        route.fulfill(json={"total": 2_000_000, "rows": made})

    picture = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"/>'
    with page_driver.opened(chromium, "about:blank") as page:
        page.route("**/api/shots?*", rows)
        page.route(
            "**/thumbnail/**", lambda r: r.fulfill(body=picture, content_type="image/svg+xml")
        )
        page.goto(browse_site)
        total(page, 2_000_000)
        page.get_by_text("s0000000_p00").wait_for()
        assert page.evaluate("document.querySelector('.grid').scrollHeight") < 10_000_000
        page.locator("#grid").focus()
        page.keyboard.press("End")
        page.get_by_text("s1999999_p00").wait_for()
        assert page.locator(".cell").count() < 100
        # A wheel's steps move by as many pixels, wherever the list stands.
        before = places(page)
        page.mouse.move(800, 400)
        page.mouse.wheel(0, -120)
        page.wait_for_timeout(600)
        after = places(page)
        common = [k for k in before if k in after]
        assert common
        assert all(abs(after[k] - before[k] - 120) < 3 for k in common)
        # The scrollbar's middle is the list's middle.
        page.evaluate("document.querySelector('.grid').scrollTop = 3_000_000")
        page.locator(".cell", has_text=re.compile("s(0999|1000)...")).first.wait_for()
        page.keyboard.press("Home")
        page.get_by_text("s0000000_p00").wait_for()
        # Arrows reach every row: no gaps where the page is put right.
        tops = list(places(page).values())
        columns = tops.count(tops[0])
        for _ in range(40):
            page.keyboard.press("ArrowDown")
        page.locator(
            f'#cell-{40 * columns}[aria-selected="true"]', has_text=f"s{40 * columns:07d}_p00"
        ).wait_for()


def places(page: Any) -> dict[str, float]:
    """Caption -> height on the screen, of the cells that are there."""
    return page.evaluate(
        "Object.fromEntries([...document.querySelectorAll('.cell')]"
        ".map(c => [c.textContent, c.getBoundingClientRect().top]))"
    )


def test_keys_move_open_step_and_close(browser_page: Any):
    page = browser_page
    keys = page.locator(".cell .caption .words").all_inner_texts()
    page.locator("#grid").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    heading = page.locator(".viewbar h1")
    heading.wait_for()
    assert keys[1] in heading.inner_text()
    page.keyboard.press("ArrowRight")
    page.get_by_role("heading", name=keys[2]).first.wait_for()
    page.keyboard.press("ArrowLeft")
    page.get_by_role("heading", name=keys[1]).first.wait_for()
    page.reload()
    page.get_by_role("heading", name=keys[1]).first.wait_for()
    page.keyboard.press("ArrowRight")
    page.get_by_role("heading", name=keys[2]).first.wait_for()
    page.keyboard.press("Escape")
    page.locator("#grid").wait_for()
    assert "#" not in page.url
    assert page.locator('[aria-selected="true"] .words').inner_text() == keys[2]
    page.keyboard.press("?")
    page.get_by_role("dialog").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="hidden")


def test_a_broken_shot_says_why(browser_page: Any):
    page = browser_page
    page.locator(".cell.broken").first.click()
    page.get_by_role("heading", name="This shot is broken").wait_for()
    assert "cut short" in page.get_by_role("alert").inner_text()
    page_driver.screenshot(page, "broken")
    page.keyboard.press("Escape")
    page.locator(".cell.loaded").first.wait_for()


def test_what_is_not_there_is_said(chromium: Any, browse_site: str):
    with page_driver.opened(chromium, f"{browse_site}#shot/multiview/s999999_p00") as page:
        page.get_by_role("heading", name="This could not be shown").wait_for()
        assert "s999999_p00" in page.get_by_role("alert").inner_text()


def test_a_dataset_that_grows_is_shown_as_it_grows(chromium: Any, browse_site: str):
    state = {"shots": SHOTS - 1, "revision": "1", "complete": False}

    def growing(route: Any) -> None:
        answer = route.fetch().json()
        route.fulfill(json=answer | state)

    with page_driver.opened(chromium, "about:blank") as page:
        page.route("**/api/dataset", growing)
        page.goto(browse_site)
        page.get_by_text("being rendered").wait_for()
        requests: list[str] = []
        page.on("request", lambda r: requests.append(r.url))
        state.update(shots=SHOTS, revision="2", complete=True)
        total(page, SHOTS)
        page.get_by_text("being rendered").wait_for(state="detached", timeout=20_000)
        assert any("/api/shots" in url for url in requests)


def test_a_hostile_dataset_stays_text(browser_page: Any):
    page = browser_page
    assert page.locator(".brand h1").inner_text() == page_driver.HOSTILE
    assert page.locator(".brand img").count() == 0
    assert page.title() != "owned"
    policy = page.request.get(page.url.split("?")[0]).headers["content-security-policy"]
    assert "unsafe" not in policy
    assert page.evaluate("[...document.querySelectorAll('[style]')].every(e => e.style.length)")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_every_width_and_scheme_fits(chromium: Any, browse_site: str, scheme: str, width: int):
    views = {
        "grid": "",
        "shot": "#shot/multiview/s000000_p00",
        "subject": "#subject/video/s000000",
        "play": "#play/video/s000000?wall=1&paused=1",
    }
    viewport = {"width": width, "height": 800}
    for name, view in views.items():
        with page_driver.opened(
            chromium, browse_site + view, viewport=viewport, color_scheme=scheme
        ) as page:
            page.locator(".cell.loaded, .viewbar + div").first.wait_for()
            page.wait_for_load_state("networkidle")
            assert page.evaluate("document.documentElement.scrollWidth") <= width, name
            page_driver.screenshot(page, f"{name}-{width}-{scheme}")
            unnamed = page.evaluate(
                "[...document.querySelectorAll('button, a, input, select, canvas[tabindex],"
                " summary')]"
                ".filter(e => e.offsetParent && !(e.ariaLabel || e.getAttribute('aria-label')"
                " || e.textContent.trim() || e.labels?.length)).map(e => e.outerHTML)"
            )
            assert unnamed == [], name
            back = page.evaluate("getComputedStyle(document.body).backgroundColor")
            light = sum(map(int, re.findall(r"\d+", back)[:3])) > 380
            assert light == (scheme == "light")
