"""What keeps hair from being felt: locks, tones, partings, hairlines; and its colours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from assets_procedural.body.hairline import hairline_distance
from assets_procedural.body.head import HeadModel, Identity
from assets_procedural.body.piece import StrandPiece
from assets_procedural.hair.scalp_hair import scalp_hair
from assets_procedural.hair.styles import STYLES
from assets_procedural.person import Hair, Person
from synthgen.stage.hair_colour import strand_colours


@pytest.fixture(scope="module")
def identity() -> Identity:
    return HeadModel.load().identity(Person())


def grow(identity: Identity, style: str, **changes: object) -> StrandPiece:
    person = Person(hair=Hair(style=style, **changes))  # type: ignore[arg-type]
    (piece,) = scalp_hair(person, identity, np.random.default_rng(4))
    return piece


def test_there_are_styles_of_every_kind():
    assert len(STYLES) >= 24
    for shown in ("fade", "fringe", "ties", "rope", "rows", "receding", "thinning", "cut"):
        assert any(getattr(style, shown) for style in STYLES.values()), shown


def test_a_parting_makes_no_heart(identity):
    points = grow(identity, "long_straight", parting=0.0).place(identity.neutral)
    front = points[np.abs(points[..., 1] + 0.06) < 0.02]
    x, z = np.abs(front[:, 0]), front[:, 2]
    middle = np.quantile(z[x < 0.006], 0.98)
    beside = np.quantile(z[(x > 0.02) & (x < 0.035)], 0.98)
    assert beside < middle + 0.003


def test_locks_are_geometry_and_have_tones(identity, monkeypatch):
    def clumping(piece: StrandPiece) -> float:
        """How unevenly strands of 5 mm around a root lie where they have fallen 15 cm."""
        points = piece.place(identity.neutral)
        near: Any
        _, near = KDTree(points[:, 0]).query(points[::20, 0], k=8)
        away = np.linalg.norm(points[near[:, 1:]] - points[near[:, :1]], axis=-1)
        middle = points.shape[1] // 2
        return float(np.median(away[:, :, middle].min(axis=1) / away[:, :, 1].min(axis=1)))

    locked = grow(identity, "long_straight")
    assert 0.3 < np.log(locked.parameters["tone"]).std() < 0.8
    felt = replace(STYLES["long_straight"], lock=(1, 0), wisps=(0, 0, 0))
    monkeypatch.setitem(STYLES, "long_straight", felt)

    assert clumping(locked) < 0.85 * clumping(grow(identity, "long_straight"))


def test_hair_thins_out_towards_the_face(identity):
    piece = grow(identity, "short")
    person = Person(hair=Hair(style="short"))
    roots = piece.place(identity.neutral)[:, 0]
    template = identity.model.template
    skin = identity.model.groups["skin"]
    _, nearest = KDTree(identity.rest[skin]).query(roots)
    inside = hairline_distance(template[skin][nearest], person)
    front = roots[:, 1] < np.quantile(roots[:, 1], 0.3)
    outer, middle, inner = (
        np.mean((inside[front] > low) & (inside[front] <= low + 4)) for low in (-8, -2, 6)
    )
    assert 0 < outer < 0.5 * middle < inner


def test_fewer_strands_are_a_wider_part_of_the_same_hair(identity):
    piece = grow(identity, "bob")
    fewer = piece.thinned(0.25, 2.0)
    points, kept = piece.place(identity.neutral), fewer.place(identity.neutral)
    count = len(points)
    assert len(kept) == len(fewer.radius) == count // 4
    index = np.flatnonzero(np.diff(np.floor(np.arange(count + 1) * 0.25)))
    assert np.allclose(kept, points[index], atol=1e-6)
    assert np.allclose(fewer.radius, 2 * piece.radius[index])
    assert len(fewer.parameters["tone"]) == len(kept)


def test_dye_begins_below_the_regrowth_and_old_hair_does_not_glow(identity):
    red = grow(identity, "bob", melanin=0.9, dye=(0.4, 0.02, 0.02), regrowth_mm=30.0)
    colours = strand_colours(red)[..., :3]
    root, tip = np.median(colours[:, 0], axis=0), np.median(colours[:, -1], axis=0)
    assert tip[0] > 4 * root[0] and tip[0] > 5 * tip[2]
    grey = strand_colours(grow(identity, "bob", grey=0.95))[..., :3].mean(axis=2)
    assert grey.max() < 0.75 and 0.2 < np.median(grey) < 0.5
    # Not one white, and a few strands keep their pigment.
    assert grey[:, 0].std() > 0.04


def test_fair_ends_are_lighter(identity):
    fair = strand_colours(grow(identity, "long_straight", melanin=0.4))[..., :3]
    assert np.median(fair[:, -1]) > 1.15 * np.median(fair[:, 0])


def test_black_hair_is_no_coal_and_its_strands_differ(identity):
    black = strand_colours(grow(identity, "long_straight", melanin=0.97))[:, 0, :3].mean(axis=1)
    assert 0.006 < np.median(black) < 0.03
    assert np.quantile(black, 0.9) > 1.8 * np.quantile(black, 0.1)
