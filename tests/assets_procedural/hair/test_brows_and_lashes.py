"""Brows: families, and where they lie on the face."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.body.head import HeadModel, Identity
from assets_procedural.body.landmarks import landmarks
from assets_procedural.hair import brows_and_lashes
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.person import Brows, Person


def brow_figures(person: Person, identity: Identity) -> tuple[float, float]:
    """(slope, gap) of the left brow: its inner end above its middle, its middle above the lid.

    In distances between the outer corners of the eyes.
    """
    roots = brows_and_lashes.brows(person, identity, np.random.default_rng(0))[0].place(
        identity.neutral
    )
    x, z = roots[:, 0, 0], roots[:, 0, 2]
    low, high = np.quantile(x, [0.02, 0.98])
    along = (x - low) / (high - low)
    middle = z[np.abs(along - 0.5) < 0.08].mean()
    points = landmarks(identity.neutral)
    unit = points[45, 0] - points[36, 0]
    lid = points[43:45, 2].mean()
    return (z[along < 0.12].mean() - middle) / unit, (middle - lid) / unit


def test_brows_are_no_angry_v_and_lie_near_the_eye():
    model, figures = HeadModel.load(), []
    for seed in range(14):
        person = sample_person(np.random.default_rng(seed), PeopleSettings())
        figures.append(brow_figures(person, model.identity(person)))
    slope, gap = np.median(figures, axis=0)
    assert -0.045 < slope < 0.02  # over all hairs; their upper contour is flatter
    assert 0.13 < gap < 0.21  # from the middle of the hairs, a little less than networks see


def test_families_of_brows_differ():
    identity = HeadModel.load().identity(Person())

    def look(style: str) -> tuple[float, float, int]:
        person = Person(brows=Brows(style=style))
        left = brows_and_lashes.brows(person, identity, np.random.default_rng(0))[0]
        roots = left.place(identity.neutral)[:, 0]
        x = (roots[:, 0] - roots[:, 0].min()) / np.ptp(roots[:, 0])
        peak, ends = (roots[m, 2].mean() for m in ((x > 0.5) & (x < 0.7), (x < 0.2) | (x > 0.85)))
        return float(peak - ends), float(np.ptp(roots[:, 2])), len(roots)

    seen = {style: look(style) for style in brows_and_lashes.BROWS}
    assert seen["arched"][0] > seen["natural"][0] > seen["flat"][0]
    assert seen["bushy"][2] > 1.2 * seen["natural"][2] > 2 * seen["sparse"][2]
    assert seen["thin"][2] < seen["natural"][2]
    with pytest.raises(KeyError, match="known: natural"):
        brows_and_lashes.brows(Person(brows=Brows(style="no")), identity, np.random.default_rng(0))
