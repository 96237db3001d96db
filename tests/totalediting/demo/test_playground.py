"""What the page of `totalediting demo` does, without the page."""

import numpy as np
import pytest
from known_faces import NOBODY, a_portrait, an_editor, save
from PIL import Image
from videos import write_video

from assets_procedural.conventions import panorama_files
from totalediting.demo import playground as module
from totalediting.demo.playground import MOVES, Playground, Wish
from totalediting.editing import edit as edits
from totalediting.editing import subject
from totalediting.errors import InputError


@pytest.fixture
def playground(tmp_path, monkeypatch):
    monkeypatch.setattr(subject, "_SIDES", (96, 96))
    (tmp_path / "made").mkdir()
    return Playground(an_editor(), tmp_path / "made")


def wish(playground, folder, **options):
    """Of a portrait in a light from behind who looks along -Y."""
    pixels = np.full((16, 32, 3), 0.1, np.float32)
    pixels[4:8, 6:10] = 30
    panorama_files.write(folder / "sun.exr", pixels, {})
    kept, _ = playground.appearance(save(folder / "a.png", a_portrait()))
    light, shown = playground.lighting(folder / "sun.exr")
    with Image.open(shown) as image:
        assert image.size == (32, 16)
    return Wish(kept, None, light, **options)


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image).astype(int)


def test_a_slider_opens_the_mouth_turns_the_light_and_brightens(playground, tmp_path):
    plain = wish(playground, tmp_path)
    before = pixels(playground.picture(plain)[0])
    for options in (
        {"rotate_light": 90.0},
        {"exposure": 1.0},
        {"view": (10.0, 0.0)},
        {"expression": {"Open the mouth": 1.0}},
        {"background": "light"},
    ):
        after = pixels(playground.picture(wish(playground, tmp_path, **options))[0])
        assert np.abs(after - before).max() > 20, options
    brighter = pixels(playground.picture(wish(playground, tmp_path, exposure=1.0))[0])
    assert brighter[60, 70].sum() > 1.2 * before[60, 70].sum()


def test_without_a_photograph_there_is_nothing_and_without_a_light_nothing_turns(
    playground, tmp_path
):
    assert playground.picture(Wish()) == (None, [])
    alone = Wish(wish(playground, tmp_path).appearance, rotate_light=90, background="light")
    after = pixels(playground.picture(alone)[0])
    assert np.abs(after - a_portrait()).max() <= 1


def test_the_layers_have_names_and_a_video_plays(playground, tmp_path, monkeypatch):
    monkeypatch.setattr(edits, "_ROUND", 2)
    asked = wish(playground, tmp_path)
    assert [name for _, name in playground.layers(asked)] == [
        "albedo",
        "normal",
        "diffuse",
        "alpha",
    ]
    assert playground.video(asked, MOVES[1]).stat().st_size
    with pytest.raises(InputError, match="there is no clip"):
        playground.video(asked, MOVES[0])


def test_a_clip_drives_at_a_moment_and_is_no_longer_than_allowed(playground, tmp_path, monkeypatch):
    clip = tmp_path / "clip.mp4"
    write_video(clip, [60, 61, 120, 181], (96, 80))
    kept, shown = playground.motion(clip)
    assert kept == clip and pixels(shown).shape == (80, 96, 3)
    asked = wish(playground, tmp_path)
    first, *others = (
        pixels(playground.picture(Wish(asked.appearance, kept, moment=at))[0])
        for at in (0.0, 0.3, 0.7, 1.0)
    )
    assert any((other != first).any() for other in others)
    monkeypatch.setattr(module, "MOST_FRAMES", 3)
    with pytest.raises(InputError, match="has 4 frames; cut it to at most 3"):
        playground.motion(clip)
    monkeypatch.setattr(module, "MOST_FRAME_PIXELS", 100)
    with pytest.raises(InputError, match="96 x 80"):
        playground.motion(clip)


def test_large_photographs_are_made_smaller(playground, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "SIDE", 140)
    kept, _ = playground.appearance(save(tmp_path / "a.png", a_portrait()))
    assert pixels(kept).shape == (105, 140, 3)


@pytest.mark.parametrize(
    ("zone", "name", "line"),
    [
        ("appearance", "a.txt", "not one of"),
        ("appearance", "a.png", "mend it or leave it out"),
        ("appearance", "nobody.png", "no face found"),
        ("motion", "a.mp4", "mend it or leave it out"),
        ("lighting", "a.exr", "a.exr"),
    ],
)
def test_a_bad_file_is_one_line_without_our_folders(playground, tmp_path, zone, name, line):
    path = tmp_path / name
    path.write_bytes(b"no picture")
    if name == "nobody.png":
        save(path, a_portrait(NOBODY))
    with pytest.raises(Exception) as raised:
        getattr(playground, zone)(path)
    shown = playground.said(raised.value, path)
    assert (
        line in shown
        and shown.startswith(name)
        and str(tmp_path) not in shown
        and "\n" not in shown
    )
