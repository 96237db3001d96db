"""A picture through real networks: needs LiteRT and them in the cache; nothing is downloaded."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from assets_procedural.conventions.files import cache_folder
from totalediting import Editor
from totalediting.pretrained.fetch import NETWORKS

PORTRAIT = Path(__file__).parents[3] / "docs" / "portrait.png"


@pytest.fixture(scope="module")
def editor():
    pytest.importorskip("ai_edge_litert", reason="LiteRT is not installed (extra `edit`)")
    for name in ("face_landmarker", "selfie"):
        network = NETWORKS[name]
        cached = cache_folder() / "networks" / f"{network.sha256[:12]}-{network.file_name}"
        if not cached.exists():
            pytest.skip(f"{name} is not in the cache; `totalediting edit` fetches it")
    return Editor.load()


def test_a_person_is_cut_out_and_moved(editor):
    picture = np.array(Image.open(PORTRAIT).convert("RGB"))
    edited = editor.edit(picture, picture, background="#00ff00", view=(15, 0))
    middle, side = np.array(picture.shape[:2]) // 2, len(picture) // 12
    assert edited.alpha[middle[0] - side : middle[0], middle[1] - side : middle[1]].min() > 250
    assert (edited.picture[2, 2] == (0, 255, 0)).all()
    still = editor.edit(picture)
    assert np.abs(still.picture.astype(int) - picture).max() <= 1


def test_a_picture_in_its_own_motion_stays(editor):
    picture = np.array(Image.open(PORTRAIT).convert("RGB"))
    same = editor.edit(picture, picture).picture
    assert np.abs(same.astype(int) - picture).mean() < 4
