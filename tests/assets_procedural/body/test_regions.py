import numpy as np
import pytest
from scipy.spatial import KDTree

from assets_procedural.body.head import HeadModel
from assets_procedural.body.regions import (
    edge_loop,
    fields,
    lid_loop,
    part_labels,
)
from assets_procedural.conventions.parts import Part

ON_SKIN = {
    Part.SKIN,
    Part.NOSE,
    Part.LEFT_EAR,
    Part.RIGHT_EAR,
    Part.MOUTH_INTERIOR,
    Part.TOP_LIP,
    Part.BOTTOM_LIP,
    Part.NECK,
}


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return HeadModel.load()


@pytest.fixture(scope="module")
def centres(model) -> np.ndarray:
    return model.template[model.faces["skin"]].mean(axis=1)


def test_every_quad_has_one_of_the_skins_parts(model):
    label = part_labels(model)
    assert label.shape == (len(model.faces["skin"]),)
    assert label.dtype == np.uint8
    assert set(label.tolist()) == {int(p) for p in ON_SKIN}


def test_left_is_the_subjects_left(model, centres):
    label = part_labels(model)
    assert (centres[label == Part.LEFT_EAR, 0] > 0.05).all()
    assert (centres[label == Part.RIGHT_EAR, 0] < -0.05).all()
    assert (label == Part.LEFT_EAR).sum() == (label == Part.RIGHT_EAR).sum()


def test_parts_lie_above_one_another_as_in_a_face(model, centres):
    label = part_labels(model)
    height = [
        centres[label == p, 2].mean() for p in (Part.NOSE, Part.TOP_LIP, Part.BOTTOM_LIP, Part.NECK)
    ]
    assert height == sorted(height, reverse=True)
    assert np.abs(centres[label == Part.NOSE, 0]).max() < 0.022
    assert np.abs(centres[label == Part.TOP_LIP, 0]).max() < 0.028


def test_labels_are_mirror_images(model, centres):
    label = part_labels(model).astype(int)
    swap = np.arange(256)
    swap[[Part.LEFT_EAR, Part.RIGHT_EAR]] = Part.RIGHT_EAR, Part.LEFT_EAR
    distance, mirrored = KDTree(centres).query(centres * [-1, 1, 1])
    assert distance.max() < 1e-5
    np.testing.assert_array_equal(swap[label[mirrored]], label)


def test_fields_are_symmetric_weights_on_the_skin(model):
    x = model.template[:, 0]
    off_skin = np.setdiff1d(np.arange(len(x)), model.groups["skin"])
    for name, value in fields(model).items():
        assert value.shape == (len(x),), name
        assert value.min() >= 0 and value.max() <= 1, name
        assert value.max() > 0.9, name
        assert not value[off_skin].any(), name
        left, right = value[x > 1e-4].sum(), value[x < -1e-4].sum()
        assert abs(left - right) < 0.03 * (left + right), name


def test_hair_grows_where_it_does_on_people(model):
    field = fields(model)
    assert not ((field["scalp"] > 0.5) & (field["ears"] > 0.5)).any()
    assert not ((field["beard"] > 0.5) & (field["lips"] > 0.7)).any()
    crown, brow, nape = (0, -0.05, 0.84), (0, -0.15, 0.75), (0, 0.02, 0.60)
    nearest = KDTree(model.template[model.groups["skin"]]).query([crown, brow, nape])[1]
    np.testing.assert_allclose(field["scalp"][model.groups["skin"][nearest]], [1, 0, 0], atol=0.05)


def test_lid_loops_enclose_the_sockets(model):
    for side in ("left", "right"):
        loop = lid_loop(model, side)
        assert len(loop) == 28
        socket = fields(model)["eye_socket"] > 0.5
        assert not socket[loop].any()
        # The pocket lies behind the lids.
        centre = model.template[model.groups[f"eye_{side}"]].mean(axis=0)
        near = np.linalg.norm(model.template - centre, axis=1) < 0.03
        assert model.template[socket & near, 1].mean() > model.template[loop, 1].mean()


def test_unknown_places_are_refused(model):
    with pytest.raises(KeyError, match="has no vertices"):
        model.from_base([13379 + 10**6])
    with pytest.raises(ValueError, match="no closed edge loop"):
        # A loop across the shoulders runs out of the bust.
        vertex = model.faces["skin"][model.template[model.faces["skin"], 2].mean(axis=1).argmin()]
        edge_loop(model, vertex[0], vertex[1])
        edge_loop(model, vertex[1], vertex[2])
