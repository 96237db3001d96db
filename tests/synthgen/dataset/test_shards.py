"""Shot <-> tar members, determinism, the atomic commit and the gate."""

from __future__ import annotations

import copy
import hashlib
import io
import pickle
import tarfile
from pathlib import Path

import fake_renderer
import numpy as np
import pytest

from assets_procedural.conventions.files import replacing, write_atomically
from synthgen.dataset import passes, shards
from synthgen.dataset.codecs import decode_exr
from synthgen.dataset.gate import inspect
from synthgen.dataset.passes import PASSES
from synthgen.dataset.shot import Shot
from synthgen.planning.plan import plan
from synthgen.publish import card

JOB = fake_renderer.small_job()


@pytest.fixture
def shot() -> Shot:
    # No panorama is read where none is turned.
    subject = plan(JOB).subject("multiview", 0).model_copy(update={"keys": ()})
    return fake_renderer.render_subject(subject, JOB, Path("nowhere/environments"), "cpu", 1).shots[
        0
    ]


def test_round_trip_keeps_every_bit(shot: Shot):
    members = shards.encode(shot)
    again = shards.decode(shot.key, members)
    for name in ("rgb", "hdr", "albedo", "normal", "depth", "uv", "canonical", "alpha", "parts"):
        a, b = getattr(shot, name), getattr(again, name)
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, err_msg=name)
    assert again.geometry.keys() == shot.geometry.keys()
    for name, array in shot.geometry.items():
        np.testing.assert_array_equal(array, again.geometry[name])
    assert again.meta == shot.meta
    assert again.cost == {}


def test_member_names_are_those_of_the_contract(shot: Shot):
    assert list(shards.encode(shot)) == [
        *("rgb_00.png", "rgb_01.png", "hdr_00.exr", "hdr_01.exr", "albedo.png", "aov.exr"),
        *("alpha.png", "parts.png", "geometry.npz", "meta.json"),
    ]
    planes = decode_exr(shards.encode(shot)["aov.exr"])
    assert set(planes) == {channel for p in PASSES for channel in p.channels}
    assert planes["normal.X"].dtype == np.float16
    assert planes["depth.Z"].dtype == np.float32


def test_encoding_is_deterministic(shot: Shot):
    first, second = shards.encode(shot), shards.encode(shot)
    assert first == second


def test_transparent_pictures_and_no_linear(shot: Shot):
    shot.hdr = None
    alpha = np.broadcast_to(shot.alpha[None, ..., None], (*shot.rgb.shape[:3], 1))
    shot.rgb = np.concatenate([shot.rgb, alpha], -1)
    again = shards.decode(shot.key, shards.encode(shot))
    assert again.hdr is None
    np.testing.assert_array_equal(again.rgb, shot.rgb)


def test_one_field_decodes_alone(shot: Shot):
    members = shards.encode(shot)
    fields = shards.decode_fields({"parts.png": members["parts.png"]})
    np.testing.assert_array_equal(fields["parts"], shot.parts)


def test_damaged_and_missing_members_are_named(shot: Shot):
    members = shards.encode(shot)
    with pytest.raises(ValueError, match=r"aov\.exr does not decode"):
        shards.decode(shot.key, members | {"aov.exr": members["aov.exr"][:300]})
    del members["alpha.png"]
    with pytest.raises(KeyError, match=r"alpha\.png"):
        shards.decode(shot.key, members)


def test_concatenated_subjects_are_a_tar(tmp_path: Path):
    for name in "ab":
        entry = shards.tar_entry(f"{name}.txt", name.encode() * 700)
        (tmp_path / name).write_bytes(entry)
    parts = [tmp_path / "a", tmp_path / "b"]
    starts, size, digest, each = shards.concatenate(parts, tmp_path / "c.tar")
    data = (tmp_path / "c.tar").read_bytes()
    assert (len(data), hashlib.sha256(data).hexdigest()) == (size, digest)
    assert starts == [0, 512 + 1024]
    assert each == [hashlib.sha256(part.read_bytes()).hexdigest() for part in parts]
    with pytest.raises(shards.Changed, match="changed since") as error:
        shards.concatenate(parts, tmp_path / "d.tar", [each[0], each[0]])
    assert error.value.place == 1
    assert not (tmp_path / "d.tar").exists()
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        assert archive.getnames() == ["a.txt", "b.txt"]
        assert {m.mtime for m in archive} == {0}
    found = list(shards.read_members(tmp_path / "c.tar", starts[1], 1536))
    assert found == [("b.txt", starts[1] + 512, b"b" * 700)]
    with pytest.raises(ValueError, match="cut short"):
        list(shards.read_members(tmp_path / "c.tar", 0, 1024))


def test_a_failed_write_leaves_nothing(tmp_path: Path):
    target = tmp_path / "file"
    write_atomically(target, b"old")
    with pytest.raises(RuntimeError), replacing(target) as file:
        file.write(b"half")
        raise RuntimeError
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_gate_passes_the_sphere(shot: Shot):
    problems, quality = inspect(shot)
    assert problems == []
    assert quality["landmark_pixels"] < 0.01
    assert 0.99 < quality["normal_length"] < 1.01


def test_strands_in_front_of_skin_are_no_fault(shot: Shot):
    rng = np.random.default_rng(0)
    veiled = rng.random(shot.parts.shape) < 0.7
    # A pixel that shows strands and skin has the mean of their normals: askew, and short.
    shot.normal[veiled] = (rng.normal(0, 0.4, (veiled.sum(), 3)) * 0.8).clip(-0.45, 0.45)
    shot.normal[shot.parts == 0] = 0
    problems, _ = inspect(shot)
    assert problems == []


def _flip(shot: Shot) -> None:
    shot.normal = -shot.normal


def _shrink(shot: Shot) -> None:
    shot.normal = (shot.normal * 0.7).astype(np.float16)


def _move(shot: Shot) -> None:
    shot.geometry["landmarks"] = shot.geometry["landmarks"] + np.float32(0.05)


def _far(shot: Shot) -> None:
    shot.depth[shot.depth > 0] += 0.1


def _mirror(shot: Shot) -> None:
    shot.meta["camera"]["camera_to_world"][0] = [
        -v for v in shot.meta["camera"]["camera_to_world"][0]
    ]


def _out_of_bounds(shot: Shot) -> None:
    shot.meta["landmarks"]["points"][7] = [-500.0, 3.0]


DAMAGE = {
    "depth has 1 NaN": lambda s: s.depth.__setitem__((0, 0), np.nan),
    "hdr has 1 NaN": lambda s: s.hdr.__setitem__((0, 5, 5, 0), np.inf),
    "empty mask": lambda s: s.parts.fill(0),
    "unknown part ids": lambda s: s.parts.__setitem__(s.parts == 1, 77),
    "depth is not positive": lambda s: s.depth.__setitem__((0, 0), 1.0),
    "normal is not 0 in the background": lambda s: s.normal.__setitem__((0, 0), 1.0),
    "normals of skin are": _shrink,
    "longer than alpha": lambda s: s.__setattr__("normal", s.normal * np.float16(1.04)),
    "degrees off the depth": _flip,
    "off their projection": _move,
    "mm off the visible landmarks": _far,
    "not in SO(3)": _mirror,
    "outside the declared bounds": _out_of_bounds,
    "off its linear light": lambda s: s.rgb.__setitem__(1, s.rgb[1] - 2),
    "black image": lambda s: s.rgb.__setitem__(1, 0),
    "white image": lambda s: s.rgb.__setitem__(1, 255),
    "albedo is": lambda s: setattr(s, "albedo", s.albedo[:-1]),
    "geometry has no landmarks_canonical": lambda s: s.geometry.pop("landmarks_canonical"),
    "meta has 1 exposures for 2": lambda s: s.meta["exposures"].pop(),
    "not all finite and positive": lambda s: s.meta["exposures"].__setitem__(1, 0.0),
    "geometry has no control points": lambda s: s.geometry.pop("control_normals"),
    "geometry has joints": lambda s: s.meta["joints"].append("nose"),
    "alpha and parts overlap": lambda s: s.alpha.fill(255),
}


@pytest.mark.parametrize("message", DAMAGE)
def test_gate_names_the_broken_promise(shot: Shot, message: str):
    DAMAGE[message](shot)
    problems, _ = inspect(shot)
    assert any(message in problem for problem in problems), problems


def test_the_table_of_the_docs_is_that_of_the_passes():
    docs = Path(__file__).parents[3] / "docs" / "dataset.md"
    assert "\n".join(passes.table()) in docs.read_text()
    assert card.FIELDS.items() >= passes.contents().items()
    assert list(card.FIELDS)[2:-2] == list(passes.members())


def test_the_gate_names_passes_that_are_missing_or_unknown(shot: Shot):
    del shot.passes["uv"]
    shot.passes["nose"] = shot.alpha
    problems, figures = inspect(shot)
    assert problems == ["other passes than a dataset's (missing: uv; unknown: nose)"]
    assert figures == {}


def test_passes_are_attributes_that_can_be_copied_and_set(shot: Shot):
    other = pickle.loads(pickle.dumps(copy.deepcopy(shot)))
    np.testing.assert_array_equal(other.depth, shot.depth)
    other.depth = shot.depth + 1
    np.testing.assert_array_equal(other.passes["depth"], shot.depth + 1)
    with pytest.raises(AttributeError, match="a shot has no nose"):
        _ = shot.nose
