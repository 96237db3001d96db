import numpy as np
import pytest
from PIL import Image
from synthetic_faces import a_tracking, faces_of

from totalediting.editing import track as module
from totalediting.errors import InputError
from totalediting.faces import correspondences, table


class Flawless:
    """Finds the face that the upper left pixel numbers; none for 0, two for 200."""

    read = 0

    def __init__(self):
        self.faces = faces_of(a_tracking(np.random.default_rng(0), 3), correspondences.load(), 64)

    def find(self, picture):
        Flawless.read += 1
        number = int(picture[0, 0, 0])
        return [] if number == 0 else [self.faces[number % 3]] * (2 if number == 200 else 1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "Landmarker", Flawless)
    Flawless.read = 0
    folder = tmp_path / "pictures"
    (folder / "more").mkdir(parents=True)
    for name, number in (("a.png", 1), ("empty.png", 0), ("more/two.png", 200)):
        Image.fromarray(np.full((64, 64, 3), number, np.uint8)).save(folder / name)
    return folder


def test_every_face_has_a_row_and_what_has_none_is_said(folder, tmp_path):
    out = tmp_path / "fits.parquet"
    notes = module.track(folder, out)
    found = table.read(out)
    assert found.source == ["a.png", "more/two.png"] and found.faces.tolist() == [1, 2]
    assert (found.residual < 0.02).all()
    assert any("empty.png" in note for note in notes)
    assert any("several" in note and "two.png" in note for note in notes)
    assert not out.with_name("fits.parquet.parts").exists()


def test_what_is_done_is_not_done_again(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_AT_ONCE", 1)
    out = tmp_path / "fits.parquet"
    (folder / "z.png").write_bytes(b"damaged")
    with pytest.raises(InputError, match=r"z\.png"):
        module.track(folder, out)
    read = Flawless.read
    Image.fromarray(np.full((64, 64, 3), 2, np.uint8)).save(folder / "z.png")
    module.track(folder, out)
    assert Flawless.read == read + 1
    assert len(table.read(out).source) == 3


def test_parts_of_other_work_are_not_taken(folder, tmp_path):
    out = tmp_path / "fits.parquet"
    (folder / "z.png").write_bytes(b"damaged")
    with pytest.raises(InputError):
        module.track(folder, out)
    with pytest.raises(InputError, match="something else"):
        module.track(folder / "a.png", out)


def test_bad_input_is_said_in_one_line(folder, tmp_path):
    out = tmp_path / "fits.parquet"
    with pytest.raises(InputError, match="no face"):
        module.track(folder / "empty.png", out)
    with pytest.raises(InputError, match=r"\.parquet"):
        module.track(folder, tmp_path / "fits.csv")
    with pytest.raises(InputError, match="check the path"):
        module.track(tmp_path / "nowhere", out)
    (tmp_path / "void").mkdir()
    with pytest.raises(InputError, match="no picture or video"):
        module.track(tmp_path / "void", out)
    out.write_bytes(b"")
    with pytest.raises(InputError, match="there already"):
        module.track(folder, out)
