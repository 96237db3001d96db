"""What the figures of realism mean: signs, units, and values that are known beforehand."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest


def test_skin_is_flat_or_as_rough_as_its_noise(realism: ModuleType) -> None:
    flat = np.full((152, 152, 3), 60.0)
    assert max(realism.skin(flat, 38.0).values()) < 1e-9
    rng = np.random.default_rng(0)
    rough = flat + rng.normal(0, 2.0, flat.shape)
    # A Gaussian of one pixel takes away all but 1 / (4 pi) of white noise's variance.
    fine = realism.skin(rough, 38.0)[realism.FINE]
    assert fine == pytest.approx(2.0 * (1 - 2 / (2 * np.pi) + 1 / (4 * np.pi)) ** 0.5, rel=0.15)


def test_a_frown_slopes_down_and_height_is_above_the_lid(realism: ModuleType) -> None:
    mesh = np.zeros((478, 2))
    upper, lower = realism.MEDIAPIPE_70[17:27], realism.MEDIAPIPE_LOWER_BROWS
    mesh[realism.MEDIAPIPE_70[[36, 45]]] = (0, 100), (100, 100)
    mesh[realism.MEDIAPIPE_70[[37, 38, 43, 44]]] = (20, 98), (30, 98), (70, 98), (80, 98)
    mesh[upper[[2, 7]]], mesh[lower[[2, 7]]] = ((20, 76), (80, 76)), ((20, 80), (80, 80))
    mesh[upper[[4, 5]]] = (40, 79), (60, 79)
    angle = np.radians(25)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for seen in (mesh, 3 * mesh @ turn.T + 7):
        assert realism.brow_slope(seen) == pytest.approx(-0.03)
        assert realism.brow_to_lid(seen) == pytest.approx(0.20)


def test_identity_counts_pairs_once(realism: ModuleType) -> None:
    class Dlib:
        def recognise(self, image: np.ndarray, box: np.ndarray) -> np.ndarray:
            return image.mean((0, 1))

    def face(person: str, view: int, light: int, features: list[float]) -> Any:
        image = np.full((4, 4, 3), float(person))
        return realism.Face(person, view, light, image, np.zeros(15), np.array(features))

    different = [face("0", 0, 0, [1, 0]), face("1", 0, 0, [0, 1]), face("2", 0, 0, [0.6, 0.8])]
    same = [face("5", 0, 0, [1, 0]), face("5", 0, 1, [0.8, 0.6]), face("5", 1, 0, [0.6, 0.8])]
    values = realism.measure_identity(different, same, Dlib())
    assert values["SFace, different people: mean"] == pytest.approx((0 + 0.6 + 0.8) / 3)
    assert values["SFace, pairs above 0.363"] == pytest.approx(2 / 3)
    assert values["dlib, pairs below 0.6"] == 0
    assert values["SFace, one person, other light"] == pytest.approx(0.8)
    assert values["SFace, one person, other view"] == pytest.approx(0.6)
    assert 0 < values["SFace, one person against others: AUC"] < 1
