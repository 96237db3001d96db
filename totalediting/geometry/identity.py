"""A linear space of heads: principal components of random people's neutral busts.

Symbols: K = `IDENTITY` coefficients c, V vertices of the whole bust (`HeadModel`), J joints that
its bones turn about. Space: model space, metres, world axes, the origin at `space.head_centre` of
the neutral head, so that stature does not count. Over the people that it was made of, every
coefficient has mean 0 and variance 1; it was made of as many mirrored people, hence the mean head
is symmetric.
"""

from __future__ import annotations

import contextlib
import zipfile
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from assets_procedural.body.head import HEAD_FILE, HeadModel
from assets_procedural.body.landmarks import skin_weights
from assets_procedural.conventions.files import cache_folder, replacing, sha256
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.person import Person
from totalediting.geometry.space import ORIGIN_LANDMARKS
from totalediting.geometry.tracking import IDENTITY
from totalediting.presets import Preset

PEOPLE, SEED = 300, 20250
"""Of the sample that the components are made of."""
_FORMAT = 1  # of the cached file


@dataclass(frozen=True, eq=False)
class IdentityBasis:
    """`mean` (V + J, 3) and `components` (K, V + J, 3), metres per unit; `mirroring` (K, K)."""

    mean: Tensor
    components: Tensor
    mirroring: Tensor

    def coefficients(self, person: Person) -> Tensor:
        """c (K,): the point of the space nearest to a person's neutral bust."""
        return self.project(torch.from_numpy(neutral_bust(_head(), person)).to(self.mean))

    def project(self, points: Tensor) -> Tensor:
        """c (..., K) of busts (..., V + J, 3) in model space, by least squares."""
        if points.shape[-2:] != self.mean.shape:
            raise ValueError(
                f"points must be (..., {self.mean.shape[0]}, 3), got {tuple(points.shape)}"
            )
        offset = (points - self.mean).flatten(-2)
        basis = self.components.flatten(1)
        return (offset @ basis.mT) / basis.square().sum(1)

    def vertices(self, coefficients: Tensor) -> Tensor:
        """(..., V, 3) neutral vertices at rest in model space, from c (..., K); differentiable."""
        return self._points(coefficients)[..., : -self._joints, :]

    def joints(self, coefficients: Tensor) -> Tensor:
        """(..., J, 3) rest positions of the bones' joints, in the order of `Identity.joints`."""
        return self._points(coefficients)[..., -self._joints :, :]

    def mirrored(self, coefficients: Tensor) -> Tensor:
        """c (..., K) of the same heads seen in a mirror, left for right."""
        return coefficients @ self.mirroring.to(coefficients).mT

    @property
    def _joints(self) -> int:
        return len(_head().arrays["joints"])

    def _points(self, coefficients: Tensor) -> Tensor:
        if coefficients.shape[-1:] != (len(self.components),):
            found = tuple(coefficients.shape)
            raise ValueError(f"coefficients must be (..., {len(self.components)}), got {found}")
        offset = coefficients @ self.components.flatten(1).to(coefficients)
        return self.mean.to(coefficients) + offset.unflatten(-1, self.mean.shape)


@lru_cache(maxsize=1)
def identity_basis() -> IdentityBasis:
    """The basis; made in seconds once per machine, then read from the cache folder."""
    path = cache_folder() / f"identity-{sha256(HEAD_FILE)[:12]}-k{IDENTITY}-v{_FORMAT}.npz"
    broken = (OSError, ValueError, KeyError, zipfile.BadZipFile)
    with contextlib.suppress(*broken), np.load(path) as archive:
        names = ("mean", "components", "mirroring")
        return IdentityBasis(*(torch.from_numpy(archive[name]) for name in names))
    basis = _make(_head())
    arrays = {name: array.numpy() for name, array in vars(basis).items()}
    with contextlib.suppress(OSError), replacing(path) as file:
        np.savez(file, **arrays)  # without a disk for it, it is made again
    return basis


def neutral_bust(model: HeadModel, person: Person) -> np.ndarray:
    """(V + J, 3) vertices and joints of a person's neutral bust in model space, metres."""
    identity = model.identity(person)
    origin = (skin_weights(model)[list(ORIGIN_LANDMARKS)] @ identity.rest).mean(axis=0)
    return np.concatenate([identity.rest, identity.joints]) - origin


def faces_of(preset: Preset) -> Tensor | None:
    """The triangles (F, 3) between control points that a preset's surface field takes, if any."""
    if "surface_field" not in (preset.deformation, preset.rotation):
        return None
    model = _head()
    quads = torch.from_numpy(np.searchsorted(model.groups["skin"], model.faces["skin"]))
    return torch.cat([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _make(model: HeadModel) -> IdentityBasis:
    rng = np.random.default_rng(SEED)
    settings = PeopleSettings()
    busts = [neutral_bust(model, sample_person(rng, settings)) for _ in range(PEOPLE)]
    opposite = _opposite(model)
    shapes = np.stack([*busts, *(bust[opposite] * [-1, 1, 1] for bust in busts)])
    mean = shapes.mean(axis=0)
    offsets = (shapes - mean).reshape(len(shapes), -1)
    # Far fewer people than numbers: the eigenvectors of the small Gram matrix do.
    vectors = np.linalg.eigh(offsets @ offsets.T)[1]
    leading = vectors[:, ::-1][:, :IDENTITY]
    leading *= np.sign(leading[np.abs(leading).argmax(axis=0), np.arange(IDENTITY)])
    components = (leading.T @ offsets).reshape(IDENTITY, *mean.shape) / np.sqrt(len(shapes))
    basis = IdentityBasis(
        torch.from_numpy(mean), torch.from_numpy(components), torch.eye(IDENTITY).double()
    )
    turned = basis.components[:, opposite] * torch.tensor([-1.0, 1.0, 1.0])
    mirroring = basis.project(basis.mean + turned).mT
    return IdentityBasis(
        *(array.float().contiguous() for array in (basis.mean, basis.components, mirroring))
    )


def _opposite(model: HeadModel) -> np.ndarray:
    """(V + J,) each point's counterpart on the other side of the symmetric template."""
    joints = model.arrays["joints"].copy()
    joints[np.abs(joints[:, 0]) < 1e-3, 0] = 0.0  # Anny's neck is a fraction of a millimetre off
    found = []
    for points in (model.template, joints):
        found.append(KDTree(points).query(points * [-1, 1, 1])[1])
    return np.concatenate([found[0], found[1] + len(model.template)])


@lru_cache(maxsize=1)
def _head() -> HeadModel:
    return HeadModel.load()
