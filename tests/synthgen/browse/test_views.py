"""The views of `synthgen browse` in a real browser: passes and values, light, subject, clip.

The canvas of light must show what `totalediting` computes from the same albedo, normals and
lightmaps: that is the promise that makes it worth looking at.
"""

from __future__ import annotations

import base64
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import page_driver
import pytest
import torch

from assets_procedural.conventions import panorama_files
from assets_procedural.conventions.colour import srgb_decode
from synthgen.dataset import open_dataset
from synthgen.dataset.shot import Shot
from totalediting.light import lightmaps, phong
from totalediting.light.environments import environment_lightmaps

pytestmark = pytest.mark.browser
KEY = "multiview/s000000_p00"
K_D, K_S = 1.0, (0.0, 0.02, 0.01, 0.0)
"""The coefficients that the canvas starts with."""


@pytest.fixture
def shot(browse_dataset: Path) -> Shot:
    return open_dataset(browse_dataset)[KEY]


@pytest.fixture
def page(chromium: Any, browse_site: str):
    with page_driver.opened(chromium, f"{browse_site}#shot/{KEY}") as page:
        page.wait_for_selector("canvas.light[data-drawn]")
        yield page


def test_every_pass_is_shown_and_its_values_are_the_stored_ones(page: Any, shot: Shot):
    row, column = (int(i.mean()) for i in np.nonzero(shot.parts == 1))
    truth = {
        "Albedo": srgb_decode(shot.albedo[row, column] / 255.0),
        "Normal": shot.normal[row, column],
        "Depth": shot.depth[row, column],
        "UV": shot.uv[row, column],
        "Canonical": shot.canonical[row, column],
        "Alpha": shot.alpha[row, column],
        "Parts": shot.parts[row, column],
        "Image": shot.rgb[0][row, column],
    }
    shown = []
    for name, expected in truth.items():
        page.get_by_role("radio", name=name, exact=True).click()
        image = page.locator(".plate img").first
        page.wait_for_function(
            "p => { const i = document.querySelector('.plate img');"
            " return i.src.includes(`/${p}?`) && i.complete && i.naturalWidth > 0; }",
            arg=name.lower(),
        )
        shown.append(image.screenshot())
        box, size = image.bounding_box(), shot.parts.shape
        x = box["x"] + (column + 0.5) * box["width"] / size[1]
        page.mouse.move(x, box["y"] + (row + 0.5) * box["height"] / size[0])
        written = page.locator(f".readout dt:text-is('{name.lower()}') + dd")
        written.filter(has_not_text="…").wait_for()
        pixel = page.locator(".readout dt:text-is('pixel') + dd").inner_text()
        assert pixel == f"{column}, {row}"
        numbers = [float(v) for v in re.findall(r"-?\d+(?:\.\d+)?", written.inner_text())]
        assert np.allclose(numbers, np.atleast_1d(expected), atol=6e-5), name
        page_driver.screenshot(page, f"pass-{name.lower()}")
    assert len(set(shown)) == len(shown)
    parts = page.locator(".legend li", has_text="hair")
    page.get_by_role("radio", name="Parts", exact=True).click()
    parts.wait_for()
    page.reload()
    parts.wait_for()


def test_environments_stand_side_by_side_and_one_is_chosen(page: Any, shot: Shot):
    assert page.locator(".figures figure").count() == len(shot.meta["environments"]) == 2
    page.locator(".pick").nth(1).click()
    assert "environment=1" in page.url
    select = page.get_by_label("Environment", exact=True)
    assert select.input_value() == "shot:1"
    page.wait_for_function(
        "() => document.querySelector('.pair img').src.endsWith('image?environment=1')"
    )


@pytest.mark.parametrize("overlay", ["Landmarks", "Mesh"])
def test_overlays_are_drawn_where_the_subject_is(page: Any, shot: Shot, overlay: str):
    assert not page_driver.pixels(page, "canvas.overlay")[..., 3].any()
    page.get_by_role("checkbox", name=overlay).check()
    page.wait_for_function(
        "() => [...document.querySelector('canvas.overlay').getContext('2d')"
        ".getImageData(0, 0, 999, 999).data].some(Boolean)"
    )
    drawn = page_driver.pixels(page, "canvas.overlay")[..., 3] > 0
    visible = np.array(shot.meta["landmarks"]["visible"])
    points = np.array(shot.meta["landmarks"]["points"])[visible]
    scale = drawn.shape[1] / shot.parts.shape[1]
    for x, y in points * scale:
        around = drawn[max(0, int(y) - 4) : int(y) + 5, max(0, int(x) - 4) : int(x) + 5]
        assert around.any(), (x, y)
    page_driver.screenshot(page, f"overlay-{overlay.lower()}")


def expected(folder: Path, shot: Shot, panorama_id: str, angle: float, factor: float) -> np.ndarray:
    """What `totalediting` makes of the shot's pixels, (H, W, 3) linear light."""
    path = folder / "environments" / f"{panorama_id}.exr"
    return shaded(environment_lightmaps(path, 32, 0.0, 1.0), shot, angle, factor)


def shaded(maps: torch.Tensor, shot: Shot, angle: float, factor: float) -> np.ndarray:
    camera = shot.meta["camera"]
    cosine, sine = math.cos(angle), math.sin(angle)
    back = torch.tensor([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    turn = back @ torch.tensor(camera["camera_to_world"])[:3, :3]
    height, width = shot.parts.shape
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    ray = torch.stack([x, y, torch.ones_like(x)], -1)
    ray = ray @ torch.linalg.inv(torch.tensor(camera["intrinsics"])).T
    view = torch.nn.functional.normalize(ray * torch.tensor([-1.0, 1.0, 1.0]), dim=-1)
    light = phong.shade(
        maps,
        (torch.from_numpy(shot.normal.astype(np.float32)) @ turn.T).flatten(0, 1),
        (view @ turn.T).flatten(0, 1),
        torch.from_numpy(srgb_decode(shot.albedo.astype(np.float32) / 255)).flatten(0, 1),
        torch.full((height * width, 1), K_D),
        torch.tensor(K_S).expand(height * width, -1),
    )
    return (light * factor).unflatten(0, (height, width)).numpy()


def compare(page: Any, linear: np.ndarray, shot: Shot) -> float:
    """Largest difference between the canvas and D(linear) on the subject, in [0, 1]."""
    seen = page_driver.pixels(page, "canvas.light")
    there = (shot.parts > 0) & (shot.alpha == 255)
    assert there.sum() > 100
    assert (seen[there][:, 3] == 255).all()
    shown = phong.display(torch.from_numpy(linear)).numpy()
    return float(np.abs(seen[..., :3] / 255.0 - shown)[there].max())


def redrawn(page: Any, change: Any) -> None:
    """Makes a change and waits until the canvas shows it."""
    count = int(page.locator("canvas.light").get_attribute("data-drawn"))
    change()
    page.wait_for_function(
        "n => Number(document.querySelector('canvas.light').dataset.drawn) > n", arg=count
    )


def test_the_canvas_equals_the_models_shading(page: Any, browse_dataset: Path, shot: Shot):
    use, factor = shot.meta["environments"][0], shot.meta["exposures"][0]
    redrawn(page, page.get_by_label("Pixel filter").uncheck)
    linear = expected(browse_dataset, shot, use["id"], use["rotation"], factor)
    assert compare(page, linear, shot) < 0.01
    page_driver.screenshot(page, "light")

    # Linear light under the pointer.
    row, column = (int(i.mean()) for i in np.nonzero(shot.parts == 1))
    canvas = page.locator("canvas.light")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    scale = box["width"] / shot.parts.shape[1]
    page.mouse.move(box["x"] + (column + 0.5) * scale, box["y"] + (row + 0.5) * scale)
    reading = page.locator(".reading").inner_text()
    numbers = [float(v) for v in reading.removeprefix("linear ").split()]
    assert np.allclose(numbers, linear[row, column], rtol=0.01, atol=6e-4)

    # Sliders of exposure and of another environment.
    redrawn(page, lambda: page.get_by_role("slider", name="Exposure").fill("1"))
    assert compare(page, 2 * linear, shot) < 0.01
    other = next(
        i
        for i in ("city", "night", "studio")
        if i not in [e["id"] for e in shot.meta["environments"]]
    )
    redrawn(
        page, lambda: page.get_by_label("Environment", exact=True).select_option(f"other:{other}")
    )
    linear = expected(browse_dataset, shot, other, use["rotation"], 2 * factor)
    assert compare(page, linear, shot) < 0.01


def test_dragging_turns_the_light_as_predicted(page: Any, browse_dataset: Path, shot: Shot):
    use, factor = shot.meta["environments"][0], shot.meta["exposures"][0]
    redrawn(page, page.get_by_label("Pixel filter").uncheck)
    before = page_driver.pixels(page, "canvas.light")
    canvas = page.locator("canvas.light")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    def drag() -> None:
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + box["width"] / 4, middle[1])
        page.mouse.up()

    redrawn(page, drag)
    # A quarter of the width is an eighth of a turn; what is behind follows the pointer.
    assert page.get_by_role("slider", name="Rotation").input_value() == "-45"
    angle = use["rotation"] - math.radians(45)
    linear = expected(browse_dataset, shot, use["id"], angle, factor)
    assert compare(page, linear, shot) < 0.01
    assert np.abs(page_driver.pixels(page, "canvas.light").astype(int) - before).max() > 10

    # Keys turn it, too, and do not leave the shot.
    canvas.focus()
    redrawn(page, lambda: page.keyboard.press("ArrowLeft"))
    assert page.get_by_role("slider", name="Rotation").input_value() == "-40"
    redrawn(page, lambda: page.get_by_role("button", name="Reset").click())
    assert np.array_equal(page_driver.pixels(page, "canvas.light"), before)


def test_a_dropped_panorama_lights_the_shot(page: Any, shot: Shot, tmp_path: Path):
    sun = np.full((32, 64, 3), 0.05, np.float32)
    sun[8:12, 10:14] = (40.0, 20.0, 5.0)
    path = tmp_path / "sun.exr"
    panorama_files.write(path, sun, {})
    redrawn(page, page.get_by_label("Pixel filter").uncheck)
    content = base64.b64encode(path.read_bytes()).decode()
    dragged = page.evaluate_handle(
        "text => { const data = new DataTransfer();"
        " const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));"
        " data.items.add(new File([bytes], 'sun.exr')); return data; }",
        content,
    )
    drop = {"dataTransfer": dragged}
    redrawn(page, lambda: page.locator(".lightpanel").dispatch_event("drop", drop))
    assert page.get_by_label("Environment", exact=True).locator("option:checked").inner_text() == (
        "sun.exr"
    )
    maps = lightmaps.bake(torch.from_numpy(sun), 32)
    factor = 0.5 / float(maps[0].mean())
    assert compare(page, shaded(maps, shot, 0.0, factor), shot) < 0.01
    page_driver.screenshot(page, "light-own")

    (tmp_path / "no.exr").write_bytes(b"nothing of that kind")
    page.get_by_label("Panorama file").set_input_files(tmp_path / "no.exr")
    problem = page.locator(".lightpanel .problem")
    problem.wait_for()
    assert "\n" not in problem.inner_text()


def test_files_are_downloaded_as_they_are_stored(page: Any, browse_dataset: Path):
    with page.expect_download() as waiting:
        page.get_by_role("link", name="meta.json").click()
    stored = open_dataset(browse_dataset)
    members = stored._members(stored.position(KEY), {"meta.json"})
    assert Path(waiting.value.path()).read_bytes() == members["meta.json"]
    assert f"synthgen rerender {browse_dataset} {KEY}" in page.locator(".command").inner_text()


def test_a_subject_is_seen_with_its_cameras(page: Any):
    page.get_by_role("button", name="Subject in 3D").click()
    page.wait_for_selector("canvas.scene[data-cameras='2']")
    page.wait_for_timeout(300)
    before = page_driver.pixels(page, "canvas.scene")
    share = (before[..., 3] > 0).mean()
    assert 0.001 < share < 0.6
    # The camera of the shot that is pointed at is drawn in another colour.
    page.locator(".keys a").first.hover()
    page.wait_for_timeout(300)
    marked = page_driver.pixels(page, "canvas.scene")
    assert (marked != before).any()
    page.locator("canvas.scene").focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_timeout(300)
    assert (page_driver.pixels(page, "canvas.scene") != marked).any()
    # The fake renderer's people have another skin than the head model: that is said.
    page.locator(".sliders .hint, .sliders .slider").first.wait_for()
    page_driver.screenshot(page, "subject")
    page.locator(".keys a").last.click()
    page.get_by_role("heading", name="multiview/s000000_p01").wait_for()


def test_a_clip_plays_in_one_light_or_in_all(chromium: Any, browse_site: str):
    with page_driver.opened(chromium, f"{browse_site}#play/video/s000000?paused=1") as page:
        page.wait_for_selector("#view[data-loaded=yes]")
        view = page.locator("#view")
        assert view.get_attribute("data-frame") == "0"
        still = page.locator(".screens img").first.screenshot()
        page.keyboard.press("ArrowRight")
        page.wait_for_selector("#view[data-frame='1']")
        page.wait_for_timeout(200)
        assert page.locator(".screens img").first.screenshot() != still
        page.get_by_role("button", name="Play").click()
        for frame in ("0", "1", "0"):
            page.wait_for_selector(f"#view[data-frame='{frame}']")
        page.keyboard.press("Escape")
        page.go_back()
        page.get_by_role("radio", name="All lights").click()
        page.wait_for_function("() => document.querySelectorAll('.screens img').length === 3")
        assert "wall=1" in page.url
        page.wait_for_selector("#view[data-loaded=yes]")
        page_driver.screenshot(page, "wall")
