import numpy as np
import pytest
from known_faces import NOBODY, TINY, TWO, a_portrait, save

import totalediting
from assets_procedural.conventions import panorama_files
from totalediting.editing.editor import Editor
from totalediting.editing.warping import warp
from totalediting.errors import InputError


@pytest.fixture
def sun(tmp_path):
    """A panorama that shines from behind who looks along -Y."""
    pixels = np.full((16, 32, 3), 0.1, np.float32)
    pixels[4:8, 6:10] = 30
    panorama_files.write(tmp_path / "sun.exr", pixels, {})
    return tmp_path / "sun.exr"


def sides(picture, before):
    """Mean gain of the left and of the right half of the face."""
    gain = picture[45:75].astype(float).sum(-1) / before[45:75].astype(float).sum(-1)
    return gain[:, 55:75].mean(), gain[:, 85:105].mean()


def test_a_picture_that_is_not_edited_stays(editor):
    picture = a_portrait()
    edited = editor.edit(picture)
    assert np.abs(edited.picture.astype(int) - picture).max() <= 1
    assert edited.alpha[60, 80] == 255 and edited.alpha[5, 80] == 0


def test_light_falls_on_the_person_alone_and_turns(editor, sun):
    picture = a_portrait()
    found = [editor.edit(picture, lighting=sun, rotate_light=turn).picture for turn in (90, -90)]
    wall = editor.edit(picture).alpha == 0
    for edited in found:
        assert np.abs(edited[wall].astype(int) - picture[wall]).max() <= 1
    one, other = (np.subtract(*sides(edited, picture)) for edited in found)
    assert one > 0.1 and other < -0.1  # from the picture's left, then from its right


def test_turning_the_light_costs_only_shading(editor, sun, monkeypatch):
    picture = a_portrait()
    editor.edit(picture, a_portrait(10), sun)
    looked = editor.tracker.looked
    monkeypatch.setattr(warp, "repose", None)
    turned = editor.edit(picture, a_portrait(10), sun, rotate_light=90)
    assert editor.tracker.looked == looked and turned.picture.shape == picture.shape


def test_a_file_that_has_changed_is_read_again(editor, tmp_path):
    path = save(tmp_path / "a.png", a_portrait())
    before = editor.edit(path, background="teal").picture
    save(path, a_portrait(9, 161))
    assert editor.edit(path, background="teal").picture.shape != before.shape


def test_motion_stays_in_the_square_and_fills_what_it_uncovers(editor):
    picture = a_portrait()
    edited = editor.edit(picture, a_portrait(11))
    moved = edited.picture.astype(int) - picture
    assert np.abs(moved[30:90, 50:110]).max() > 20
    assert not np.abs(moved[:8]).any() and not np.abs(moved[:, :20]).any()
    # Nothing brown is left where the person is not.
    bare = edited.picture[edited.alpha < 8].astype(int)[1:]  # but the first pixel
    assert (bare[:, 0] - bare[:, 2]).max() < 0


@pytest.mark.parametrize("background", ["#102030", "teal"])
def test_a_colour_is_behind_all_that_is_not_the_person(editor, background):
    edited = editor.edit(a_portrait(), background=background)
    wanted = (16, 32, 48) if background[0] == "#" else (0, 128, 128)
    assert (edited.picture[edited.alpha == 0] == wanted).all()
    assert (edited.picture[60, 70] == a_portrait()[60, 70]).all()


def test_pictures_blur_and_light_as_backgrounds(editor, sun):
    picture, green = a_portrait(), np.full((50, 300, 3), (0, 200, 0), np.uint8)
    corner = (slice(0, 6), slice(40, 120))
    assert (editor.edit(picture, background=green).picture[corner] == (0, 200, 0)).all()
    blurred = editor.edit(picture, background="blur").picture[corner].astype(int)
    assert blurred[..., 2].std() < 0.8 * picture[corner][..., 2].std()
    lit = editor.edit(picture, lighting=sun, background="light")
    assert lit.picture[corner].std(axis=(0, 1)).max() < 3  # the dark, even part of the sphere
    other = a_portrait(10)
    other[:, :, 1] = np.where(other[..., 2] > other[..., 0], 220, other[..., 1])
    swapped = editor.edit(picture, lighting=other, background="light").picture
    assert swapped[corner][..., 1].min() > 180
    # Its person is filled in.
    assert editor.subject(other).background[60, 80, 1] > 0.5


def test_a_view_turns_the_person(editor):
    picture = a_portrait()
    left, right = (editor.edit(picture, view=(yaw, 0)).pose.view for yaw in (20, -20))
    assert left.frame[0, 3] > 0.2 and right.frame[0, 3] < -0.2
    assert np.isclose(np.linalg.norm(left.frame[:3, 3]), np.linalg.norm(right.frame[:3, 3]))
    with pytest.raises(InputError, match="view: 90,0: give degrees"):
        editor.edit(picture, view=(90, 0))


def test_bad_pictures_are_said_in_one_line(editor, tmp_path):
    with pytest.raises(InputError, match=r"nobody\.png: no face found"):
        editor.edit(save(tmp_path / "nobody.png", a_portrait(NOBODY)))
    with pytest.raises(InputError, match=r"its head is 12 pixels high"):
        editor.edit(save(tmp_path / "tiny.png", a_portrait(TINY)))
    with pytest.raises(InputError, match=r"not \(60, 80\) float64; convert"):
        editor.edit(np.zeros((60, 80)))
    (tmp_path / "text.png").write_text("hello")
    with pytest.raises(InputError, match=r"text\.png: .*mend it"):
        editor.edit(tmp_path / "text.png")
    (tmp_path / "text.exr").write_text("hello")
    with pytest.raises(ValueError, match=r"text\.exr"):
        editor.edit(a_portrait(), lighting=tmp_path / "text.exr")
    wide = save(tmp_path / "ldr.png", a_portrait(NOBODY, 240, 120))
    with pytest.raises(InputError, match=r"ldr\.png: no face found.*panorama.*\.exr or \.hdr"):
        editor.edit(a_portrait(), lighting=wide)
    with pytest.raises(InputError, match="no light to turn"):
        editor.edit(a_portrait(), rotate_light=10)
    with pytest.raises(InputError, match="--background: grue"):
        editor.edit(a_portrait(), background="grue")


def test_several_faces_and_profiles_are_said(editor):
    assert any("2 faces; the largest" in note for note in editor.edit(a_portrait(TWO)).notes)
    away = editor.tracker.tracking.camera_yaw_pitch_roll
    away[0, 0] = 1.2
    assert any("turned" in note for note in editor.edit(a_portrait(), background="teal").notes)


def test_a_large_picture_keeps_its_pixels(editor, monkeypatch):
    from totalediting.editing import compose

    picture = np.kron(a_portrait(), np.ones((5, 5, 1), np.uint8))
    whole = editor.edit(picture, background="teal").picture
    monkeypatch.setattr(compose, "_BAND", 50_000)
    banded = editor.edit(picture, background="teal")
    assert np.abs(whole.astype(int) - banded.picture).max() <= 2
    assert (whole[300, 350] == picture[300, 350]).all()
    assert np.abs(editor.edit(picture).picture.astype(int) - picture).max() <= 1


def test_turned_photographs_are_upright(editor, tmp_path):
    from PIL import Image

    picture = a_portrait()
    exif = Image.Exif()
    exif[0x0112] = 6
    path = tmp_path / "turned.png"
    Image.fromarray(np.ascontiguousarray(np.rot90(picture))).save(path, exif=exif)
    edited = editor.edit(path)
    assert np.abs(edited.picture.astype(int) - picture).max() <= 1


def test_it_is_exported():
    assert totalediting.Editor is Editor
    with pytest.raises(InputError, match="run: somewhere"):
        Editor.load(run="somewhere")
