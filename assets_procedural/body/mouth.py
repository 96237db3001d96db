"""The inside of the mouth: teeth, gums and tongue, behind the lips and moved by the jaw."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.body.dentition import LOWER, UPPER, Jaw, jaw
from assets_procedural.body.head import Bust, HeadModel, Identity
from assets_procedural.body.piece import MeshPiece, rigid
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.subdivision import Subdivision, catmull_clark
from assets_procedural.mesh.vectors import moved
from assets_procedural.person import Person

# Half of the upper arch (mm): x from the midline, y behind the incisors; the lower one lies inside.
_UPPER_ARCH = np.array(
    [(0, 0), (5, -0.4), (10, -2.2), (15, -5.8), (19, -11.0), (22.2, -17.5), (24.6, -25.0),
     (26.4, -33.0), (27.6, -41.0), (28.0, -47.0)]
)  # fmt: skip
_LOWER_ARCH = _UPPER_ARCH * [0.93, 0.97]
# Vertices of MakeHuman's base mesh on the midline: the wet side of the upper and the lower lip.
_UPPER_WALL, _LOWER_WALL = (554, 571), (557, 574)
# Metres below the seam where the skin is hollow, and how thick it is before the gums.
_HOLLOW, _CHIN_SKIN = (0.009, 0.012, 0.015, 0.018), 7.5e-3
# Where the lips meet.
_SEAM = (474, 493, 520, 523)


def mouth(person: Person, identity: Identity) -> list[MeshPiece]:
    """Upper and lower teeth and gums, and the tongue: materials "teeth", "gums" and "tongue".

    All carry Part.MOUTH_INTERIOR. `parameters["colour"]` is a linear Rec.709 albedo; teeth yellow
    with age, and the vertex input `tone` (V, 3) multiplies their colour.
    """
    rng = np.random.default_rng([person.skin.seed, 7])
    age = np.clip((person.age_years - 18) / 60, 0, 1)
    shade = np.array([0.77, 0.69, 0.575]) * (1 - age * np.array([0.14, 0.19, 0.32]))
    yellow = abs(rng.normal(0, 0.5))
    shade = shade * (1 + rng.normal(0, 0.04)) * (1 - yellow * np.array([0.0, 0.03, 0.1]))
    melanin = person.skin.melanin
    gum = np.array([0.52, 0.19, 0.17]) * (1 - 0.35 * melanin)
    tongue = np.array([0.50, 0.17, 0.15]) * (1 - 0.12 * melanin)
    frame = _Frame(identity)
    pieces = []
    for name, shapes, arch in (("upper", UPPER, _UPPER_ARCH), ("lower", LOWER, _LOWER_ARCH)):
        dentition: Jaw = jaw(shapes, arch, rng)
        for kind, points, faces, colour, vertex in (
            ("teeth", dentition.teeth, dentition.teeth_faces, shade, {"tone": dentition.tones}),
            ("gums", dentition.gums, dentition.gums_faces, gum, {}),
        ):
            if name == "upper":
                place = rigid("head", frame.upper(points))
            else:
                place = _with_jaw(frame.lower(points))
            # The lower jaw is a mirror image, which turns its faces inside out.
            pieces.append(
                MeshPiece(
                    f"{kind}_{name}",
                    Part.MOUTH_INTERIOR,
                    faces if name == "upper" else faces[:, ::-1],
                    kind,
                    place,
                    {"colour": tuple(float(c) for c in np.clip(colour, 0, 0.9))},
                    vertex=vertex,
                )
            )
    subdivision, used = _tongue(identity.model)

    def place_tongue(bust: Bust) -> np.ndarray:
        return moved(subdivision.matrix @ bust.unposed[used], bust.bones["head"])

    pieces.append(
        MeshPiece(
            "tongue",
            Part.MOUTH_INTERIOR,
            subdivision.faces,
            "tongue",
            place_tongue,
            {"colour": tuple(float(c) for c in tongue)},
        )
    )
    return pieces


def jaw_motion(bust: Bust) -> np.ndarray:
    """(4, 4) rigid motion of the lower jaw in the unposed head, from rest.

    The best rigid fit (Kabsch 1976) to the head model's own lower teeth, which its jaw shapes
    deform slightly.
    """
    model, rest = bust.model, bust.identity.rest
    group = model.groups["teeth_lower"]
    before, after = rest[group], bust.unposed[group]
    start, end = before.mean(axis=0), after.mean(axis=0)
    rotation = Rotation.align_vectors(after - end, before - start)[0]
    motion = np.eye(4)
    motion[:3, :3] = rotation.as_matrix()
    motion[:3, 3] = end - motion[:3, :3] @ start
    return motion


class _Frame:
    """Where the dental arches of an identity sit: behind its lips, along its jaws."""

    def __init__(self, identity: Identity):
        model, rest = identity.model, identity.rest
        upper = model.groups["teeth_upper"]
        teeth, reference = rest[upper], model.template[upper]
        # The biting plane has the tilt of the head model's own upper teeth, front to back.
        self.tilt = float(np.arctan(np.polyfit(teeth[:, 1], teeth[:, 2], 1)[0]))
        scale = np.ptp(teeth[:, :2], axis=0) / np.ptp(reference[:, :2], axis=0)
        self.scale = 1e-3 * np.append(scale, scale.mean())
        self.seam = rest[model.from_base(_SEAM)].mean(axis=0)
        self.wall = rest[model.from_base(_UPPER_WALL)][:, 1].max()
        self.lower_wall = rest[model.from_base(_LOWER_WALL)][:, 1].max()
        skin = rest[model.groups["skin"]]
        chin = skin[np.abs(skin[:, 0]) < 0.018]
        below = self.seam[2] - chin[:, 2]
        bands = [chin[np.abs(below - depth) < 4e-3, 1] for depth in _HOLLOW]
        # Where the skin before the lower gums protrudes least.
        self.hollow = max((band.min() for band in bands if len(band)), default=-np.inf)

    def upper(self, points: np.ndarray) -> np.ndarray:
        """Millimetres of the arch → rest space; z runs down from the gums."""
        edge = UPPER[0].height * self.scale[2]
        # Upper incisors end 1.5 mm below the line of the lips, behind the lower lip.
        origin = np.array([0, self.wall + 2.6e-3, self.seam[2] - 1.5e-3 + edge])
        return origin + self._tilted(points * self.scale * [1, -1, -1])

    def lower(self, points: np.ndarray) -> np.ndarray:
        """As `upper`; z runs up from the gums. Lower incisors bite behind the upper ones."""
        edge = LOWER[0].height * self.scale[2]
        front = max(self.wall + 2.6e-3 + 2.6e-3, self.lower_wall + 3.0e-3, self.hollow + _CHIN_SKIN)
        origin = np.array([0, front, self.seam[2] - 0.2e-3 - edge])
        return origin + self._tilted(points * self.scale * [1, -1, 1])

    def _tilted(self, points: np.ndarray) -> np.ndarray:
        return Rotation.from_euler("x", self.tilt).apply(points)


@lru_cache(maxsize=2)
def _tongue(model: HeadModel) -> tuple[Subdivision, np.ndarray]:
    used, local = np.unique(model.faces["tongue"], return_inverse=True)
    return catmull_clark(local.reshape(-1, 4), len(used)), used


def _with_jaw(rest: np.ndarray) -> Callable[[Bust], np.ndarray]:
    def place(bust: Bust) -> np.ndarray:
        return moved(moved(rest, jaw_motion(bust)), bust.bones["head"])

    return place
