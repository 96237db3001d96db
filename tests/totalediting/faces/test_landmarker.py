"""Needs LiteRT (extra `edit`) and its networks in the cache; nothing is downloaded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from assets_procedural.conventions.files import cache_folder
from totalediting.faces.landmarker import LEFT_EYE, RIGHT_EYE, Landmarker, _searched
from totalediting.pretrained.fetch import NETWORKS, NetworkError

PORTRAIT = Path(__file__).parents[3] / "docs" / "portrait.png"


@pytest.fixture(scope="module")
def landmarker():
    pytest.importorskip("ai_edge_litert", reason="LiteRT is not installed (extra `edit`)")
    network = NETWORKS["face_landmarker"]
    cached = cache_folder() / "networks" / f"{network.sha256[:12]}-{network.file_name}"
    if not cached.exists():
        pytest.skip("the face landmarker is not in the cache; `totalediting track` fetches it")
    return Landmarker()


@pytest.fixture(scope="module")
def portrait():
    return np.array(Image.open(PORTRAIT).convert("RGB"))


def test_a_face_is_found_and_followed(landmarker, portrait):
    (face,) = landmarker.find(portrait)
    assert face.confidence > 0.9 and face.landmarks.shape == (478, 3)
    low, high = face.box
    assert (low >= 0).all() and (high <= portrait.shape[1::-1]).all()
    # The subject's right eye is on the picture's left.
    assert face.landmarks[RIGHT_EYE, 0] < face.landmarks[LEFT_EYE, 0]
    again = landmarker.follow(portrait, face)
    assert again is not None
    off = np.linalg.norm((again.landmarks - face.landmarks)[:, :2], axis=1)
    assert off.mean() < 0.02 * face.size


def test_all_faces_are_found_the_largest_first(landmarker, portrait):
    side = 2 * len(portrait) // 3
    beside = np.full_like(portrait, 128)
    beside[:side, :side] = np.array(Image.fromarray(portrait).resize((side, side)))
    both = landmarker.find(np.concatenate([beside, portrait], 1))
    assert len(both) == 2 and both[0].size > 1.3 * both[1].size


def test_a_small_face_in_a_large_picture_is_found(landmarker, portrait):
    small = np.array(Image.fromarray(portrait).resize((160, 160)))
    wide = np.full((900, 1600, 3), 90, np.uint8)
    wide[500:660, 1200:1360] = small
    (face,) = landmarker.find(wide)
    assert (face.box[0] > [1200, 500]).all() and (face.box[1] < [1360, 660]).all()


def test_no_face_where_there_is_none(landmarker, portrait):
    nothing = np.zeros_like(portrait)
    assert landmarker.find(nothing) == []
    (face,) = landmarker.find(portrait)
    assert landmarker.follow(nothing, replace(face)) is None


def test_another_file_is_refused(landmarker, tmp_path):
    path = tmp_path / "face.task"
    path.write_bytes(b"nothing")
    with pytest.raises(NetworkError, match=r"face\.task"):
        Landmarker(path)


def test_a_picture_of_floats_is_refused(landmarker, portrait):
    with pytest.raises(ValueError, match="uint8"):
        landmarker.find(portrait / 255.0)


def test_squares_cover_the_picture():
    for squares in _searched(1600, 900):
        low = np.min([s.centre - s.side / 2 for s in squares], axis=0)
        high = np.max([s.centre + s.side / 2 for s in squares], axis=0)
        assert (low <= 0).all() and (high >= [1600, 900]).all()
