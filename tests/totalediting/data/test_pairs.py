"""Training pairs: what a sample's numbers mean, resizing, order, damage."""

from __future__ import annotations

import dataclasses
import itertools
import json
import logging
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fake_renderer import CENTRE, RADIUS

from assets_procedural.body.head import HeadModel
from assets_procedural.conventions.colour import srgb_decode
from assets_procedural.conventions.panorama_reading import PanoramaError
from assets_procedural.motion.poses import ARKIT_NAMES, Pose
from assets_procedural.person import Person
from synthgen.dataset import open_dataset
from totalediting.data import backgrounds, shots
from totalediting.data.backgrounds import put_over
from totalediting.data.endless import Stream, loader, to_device
from totalediting.data.misfit import misfitted
from totalediting.data.pairs import MIRRORED, PortraitPairs, mirrored
from totalediting.data.shots import Shots, area, over_surface
from totalediting.errors import InputError
from totalediting.geometry.field import Control, check_control
from totalediting.geometry.space import head_centre
from totalediting.geometry.volume import rays
from totalediting.light import environments, lightmaps
from totalediting.light.lightmaps import texel_directions
from totalediting.light.phong import display, undisplay
from totalediting.presets import PRESETS

STORED = 48  # side of the small dataset's pictures
SMALL = replace(PRESETS["tiny"], image=24)
WHOLE = replace(PRESETS["tiny"], image=STORED)
INDEX = {name: i for i, name in enumerate(ARKIT_NAMES)}


@pytest.fixture(scope="module")
def pairs(small_dataset: Path) -> PortraitPairs:
    return PortraitPairs(small_dataset, SMALL, seed=1, relit=True)


def equal(a: Any, b: Any) -> bool:
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, tuple):
        return all(equal(x, y) for x, y in zip(a, b, strict=True))
    return a == b


def damaged_copy(dataset: Path, out: Path, keys: list[str], member: str) -> Path:
    """The dataset with the first bytes of a member of some shots overwritten."""
    shutil.copytree(dataset, out)
    index = open_dataset(out)
    for key in keys:
        position = index.position(key)
        path = out / index.index.shards[index.index.shard[position]]
        content = bytearray(path.read_bytes())
        name = f"{key.split('/')[1]}.{member}".encode()
        start = content.index(name, int(index.index.offset[position])) + 512
        content[start : start + 64] = b"\xff" * 64
        path.write_bytes(content)
    return out


# ---------------------------------------------------------------- what a sample is


def test_shapes_and_ranges(pairs: PortraitPairs):
    batch = next(iter(loader(pairs, 3)))
    expected = {
        "app_depth": (1, 24, 24),
        "foreground": (3, 24, 24),
        "background": (3, 24, 24),
        "mot_image": (3, 24, 24),
        "albedo": (3, 24, 24),
        "normal": (3, 24, 24),
        "alpha": (1, 24, 24),
        "parts": (1, 24, 24),
        "depth": (1, 24, 24),
        "mot_code": (54,),
        "camera_to_world": (4, 4),
        "intrinsics": (3, 3),
        "lightmaps": (5, 3, 16, 32),
        "seen_lightmaps": (5, 3, 16, 32),
    }
    for name, shape in expected.items():
        assert getattr(batch, name).shape == (3, *shape), name
    assert batch.app.image.shape == (3, 3, 24, 24) and batch.app.alpha.shape == (3, 1, 24, 24)
    assert batch.app.code.shape == (3, 54) and batch.app.lightmaps.shape == (3, 5, 3, 16, 32)
    for name in ("mot_image", "albedo", "alpha"):
        values = getattr(batch, name)
        assert values.dtype == torch.float32
        assert values.min() >= 0 and values.max() <= 1
    assert batch.relit.image.shape == batch.mot_image.shape
    assert batch.relit.lightmaps.shape == batch.lightmaps.shape
    assert batch.parts.dtype == torch.uint8
    check_control(batch.control, (3,))
    assert len(batch.key) == len(batch.app_key) == 3
    moved = to_device(batch, "cpu")
    assert type(moved) is type(batch) and equal(moved, batch)


def test_a_pair_is_two_shots_of_one_subject(pairs: PortraitPairs):
    for number in range(len(pairs)):
        sample = pairs[number]
        assert sample.key != sample.app_key
        assert sample.key.split("_")[0] == sample.app_key.split("_")[0]


def test_static_pairs_have_one_pose(small_dataset: Path):
    static = PortraitPairs(small_dataset, SMALL, static=True)
    for number in range(len(static)):
        sample = static[number]
        assert torch.equal(sample.app.code, sample.mot_code)
        assert (sample.key == sample.app_key) == sample.key.startswith("video")


def test_a_mirrored_sample_is_the_mirrored_scene(pairs: PortraitPairs):
    sample = pairs[2]
    turned = mirrored(sample)
    # What holds of a scene holds of its mirror image: control points, canonical positions and
    # normals lie where the camera sees them.
    for one in (sample, turned):
        side = one.mot_image.shape[-1]
        origin, direction = rays(one.camera_to_world, one.intrinsics, side, side)
        along = one.depth[0] / (direction @ -one.camera_to_world[:3, 2])
        place = (origin + along[..., None] * direction)[one.parts[0] > 0]
        known = one.canonical.movedim(0, -1)[one.parts[0] > 0]
        assert (place - known).norm(dim=-1).median() < 0.004  # the head is at rest
        towards = (
            one.normal.movedim(0, -1)[one.parts[0] > 0] * (one.camera_to_world[:3, 3] - place)
        ).sum(-1)
        assert (towards > 0).float().mean() > 0.95
    assert torch.allclose(
        turned.points[0], torch.tensor([24.0, 0]) + sample.points[1] * torch.tensor([-1.0, 1])
    )
    twice = mirrored(turned)._replace(key=sample.key)
    for name, a, b in zip(sample._fields, sample, twice, strict=True):
        if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
            assert torch.allclose(a.float(), b.float(), atol=1e-6), name
        else:
            assert equal(a, b), name


def test_augmented_pairs_are_mirrored_half_of_the_time(small_dataset: Path):
    augmented = PortraitPairs(small_dataset, SMALL, augment=True)
    keys = [augmented[number].key for number in range(16)]
    turned = [key for key in keys if key.endswith(MIRRORED)]
    assert 2 < len(turned) < 14


def test_points_project_onto_their_pixels(pairs: PortraitPairs):
    sample = pairs[2]
    camera = sample.camera_to_world
    local = (sample.control.posed - camera[:3, 3]) @ camera[:3, :3]
    # OpenGL axes: x over -z to the right, y over -z upwards.
    column = sample.intrinsics[0, 2] + sample.intrinsics[0, 0] * local[:, 0] / -local[:, 2]
    row = sample.intrinsics[1, 2] - sample.intrinsics[1, 1] * local[:, 1] / -local[:, 2]
    meta = pairs.shots.read(pairs.keys.index(sample.key), "meta")["meta"]
    stored = torch.tensor(meta["landmarks"]["points"]) * 24 / STORED
    assert torch.allclose(torch.stack([column, row], -1), stored, atol=1e-3)


@pytest.mark.parametrize(("preset", "tolerance"), [(WHOLE, 1e-5), (SMALL, 0.004)])
def test_depth_and_normals_are_those_of_the_sphere(small_dataset: Path, preset, tolerance):
    pairs = PortraitPairs(small_dataset, preset)
    sample = pairs[0]
    position = pairs.keys.index(sample.key)
    geometry = pairs.shots.read(position, "geometry")["geometry"]
    centre = torch.tensor(CENTRE - head_centre(geometry["landmarks_canonical"])).float()
    side = preset.image
    origin, direction = rays(sample.camera_to_world, sample.intrinsics, side, side)
    along = sample.depth[0] / (direction @ -sample.camera_to_world[:3, 2])
    outward = origin + along[..., None] * direction - centre
    seen = sample.parts[0] > 0
    if preset is SMALL:  # at the rim, the mean over a pixel lies inside
        normal_z = (sample.normal * -direction.movedim(-1, 0)).sum(0)
        seen = seen & (normal_z > 0.4)
    assert seen.sum() > 60
    assert (outward[seen].norm(dim=-1) - RADIUS).abs().max() < tolerance
    normal = sample.normal.movedim(0, -1)[seen]
    assert torch.allclose(normal.norm(dim=-1), torch.ones(len(normal)), atol=1e-5)
    assert (normal * outward[seen] / RADIUS).sum(-1).min() > (0.99 if preset is SMALL else 0.9999)


def test_alpha_parts_depth_and_normals_agree(pairs: PortraitPairs):
    for number in range(4):
        sample = pairs[number]
        matte, labels = sample.alpha > 0.5, sample.parts > 0
        assert (matte & labels).sum() / (matte | labels).sum() > 0.9
        assert torch.equal(sample.depth > 0, labels)
        assert torch.equal(sample.normal.norm(dim=0, keepdim=True) > 0, sample.alpha > 0)


def test_albedo_is_linear(small_dataset: Path):
    pairs = PortraitPairs(small_dataset, WHOLE)
    sample = pairs[0]
    stored = pairs.shots.read(pairs.keys.index(sample.key), "albedo")["albedo"]
    expected = srgb_decode(stored / 255.0).transpose(2, 0, 1)
    assert np.allclose(sample.albedo.numpy(), expected, atol=1e-6)


def test_codes_hold_expression_and_gaze(pairs: PortraitPairs):
    sample = pairs[0]
    meta = pairs.shots.read(pairs.keys.index(sample.key), "meta")["meta"]
    assert sample.mot_code[INDEX["jawOpen"]] == np.float32(meta["expression"]["jawOpen"])
    gaze = [meta["gaze"]["yaw"], meta["gaze"]["pitch"]]
    assert sample.mot_code[52:].tolist() == pytest.approx(gaze)


def test_lightmaps_are_those_of_the_pictures(pairs: PortraitPairs):
    for number in range(6):
        sample = pairs[number]
        position = pairs.keys.index(sample.key)
        meta = pairs.shots.read(position, "meta")["meta"]
        assert sample.relit is not None
        matching = []
        for e in range(pairs.shots.environments(position)):
            rgb = pairs.shots.read(position, f"rgb_{e:02d}")[f"rgb_{e:02d}"]
            image, maps = shots.picture(rgb, 24), pairs.shots.lightmaps(meta, e, 16)
            matching.append(
                (torch.equal(image, sample.mot_image), torch.equal(maps, sample.lightmaps))
            )
            if torch.equal(image, sample.relit.image):
                assert torch.equal(maps, sample.relit.lightmaps)
        assert sorted(matching)[-1] == (True, True)
        assert sum(a != b for a, b in matching) == 0
        assert not torch.equal(sample.relit.image, sample.mot_image)


@pytest.mark.parametrize("in_camera", [False, True])
def test_lightmaps_are_the_integral_in_their_frame(pairs: PortraitPairs, in_camera: bool):
    meta = pairs.shots.read(0, "meta")["meta"]
    use, exposure = meta["environments"][0], meta["exposures"][0]
    environment = torch.from_numpy(pairs.shots.dataset.environment(use["id"])).double()
    frame = torch.tensor(meta["camera"]["camera_to_world"], dtype=torch.float64)[:3, :3]
    frame = frame if in_camera else torch.eye(3, dtype=torch.float64)
    height = 32
    maps = pairs.shots.lightmaps(meta, 0, height, frame if in_camera else None)
    texels = np.random.default_rng(0).choice(2 * height * height, 24, replace=False)
    directions = lightmaps.texel_directions(height, torch.float64).flatten(0, 1)[texels]
    angle = -use["rotation"]
    turn = torch.tensor(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]],
        dtype=torch.float64,
    )
    for lobe, exponent in ((0, 1), (2, 16), (4, 64)):
        truth = lightmaps.brute_force(environment, directions @ (turn @ frame).T, exponent)
        truth = truth * exposure / lightmaps.LOBE_INTEGRALS[lobe]
        found = maps[lobe].flatten(1)[:, texels].T.double()
        assert (found - truth).abs().max() < 0.01 * maps[lobe].max()


def test_a_panorama_is_baked_once_per_machine(small_dataset: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setenv("SYNTHGEN_CACHE", str(tmp_path))
    path = next((small_dataset / "environments").glob("*.exr"))
    environments.baked.cache_clear()
    maps = environments.baked(path)
    (kept,) = (tmp_path / "lightmaps").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(lightmaps, "bake", None)
        environments.baked.cache_clear()
        assert torch.equal(environments.baked(path), maps)
    kept.write_bytes(b"broken")
    environments.baked.cache_clear()
    assert torch.equal(environments.baked(path), maps)
    environments.baked.cache_clear()
    with pytest.raises(PanoramaError, match="no such panorama"):
        environments.baked(tmp_path / "none.exr")


def test_an_estimator_learns_from_as_exact_light_in_every_stage(pairs: PortraitPairs):
    """Maps in the camera's frame come from the panorama's, not from the few rows of the pair."""
    sample = pairs[0]
    position = pairs.keys.index(sample.key)
    meta = pairs.shots.read(position, "meta")["meta"]
    frame = torch.tensor(meta["camera"]["camera_to_world"])[:3, :3]
    exact = [pairs.shots.lightmaps(meta, e, 16, frame) for e in range(2)]
    assert any(torch.equal(sample.seen_lightmaps, maps) for maps in exact)
    turned = lightmaps.rotate(sample.lightmaps, sample.camera_to_world[:3, :3])
    assert not torch.allclose(turned, sample.seen_lightmaps, atol=1e-3)


def test_a_bust_at_rest_can_have_no_expression() -> None:
    """With `expression` "warped", control points lead to the neutral bust of the same person."""
    person, model = Person(), HeadModel.load()
    bust = model.identity(person).pose(Pose(expression={"jawOpen": 0.8}, head=(0.0, 0.0, 0.3)))
    skin, origin = model.groups["skin"], np.array([0.0, -0.06, 0.72])
    arrays = bust.vertices, bust.canonical.vertices, bust.normals, bust.canonical.normals
    posed, open_, *normals = (torch.from_numpy(np.asarray(a)[skin]).float() for a in arrays)
    shift = torch.from_numpy(origin).float()
    control = Control(posed - shift, open_ - shift, *normals)
    still = shots.neutral(control, {"person": person.model_dump()}, origin)
    shut = torch.from_numpy(model.identity(person).pose(Pose()).canonical.vertices[skin]).float()
    torch.testing.assert_close(still.canonical, shut - shift, atol=1e-5, rtol=0)
    assert torch.equal(still.posed, control.posed)
    assert (still.canonical - control.canonical).norm(dim=-1).max() > 0.01
    with pytest.raises(ValueError, match="70 control points, the bust's skin has"):
        shots.neutral(Control(*(a[:70] for a in control)), {"person": person.model_dump()}, origin)


# ---------------------------------------------------------------- backgrounds


def test_transparent_pictures_get_one_random_background(transparent_dataset: Path):
    pairs = PortraitPairs(transparent_dataset, SMALL, seed=1, augment=True)
    one, same = pairs[3], PortraitPairs(transparent_dataset, SMALL, seed=1, augment=True)[3]
    later = pairs[4 + len(pairs)]
    assert one.transparent and equal(one, same)
    assert not torch.allclose(one.background, later.background)
    for picture, alpha in ((one.app.image, one.app.alpha), (one.mot_image, one.alpha)):
        empty = (alpha == 0).expand(3, -1, -1)
        # The source's is bent with it, by a pixel at most.
        assert (picture - one.background)[empty].abs().median() < 0.02
    assert one.foreground[(one.alpha == 0).expand(3, -1, -1)].max() == 0
    still = PortraitPairs(transparent_dataset, SMALL, seed=1)[3]
    assert still.background.max() == 0 and torch.allclose(
        still.mot_image, still.foreground, atol=1e-4
    )


def test_half_of_the_backgrounds_are_the_light_itself() -> None:
    """Seen by the camera, out of focus: a real background tells of the light as well."""
    sun = (texel_directions(32) @ torch.tensor([0.6, 0.0, -0.8])).clamp_min(0)[..., None] ** 8
    maps = lightmaps.bake((2 * sun + 0.1).expand(-1, -1, 3).contiguous(), 32)
    lens = torch.tensor([[40.0, 0, 20], [0, 40.0, 20], [0, 0, 1]])
    seen = backgrounds.environment(maps, lens, 40)
    brightest = divmod(int(seen[0].argmax()), 40)
    # 0.6 / 0.8 to the right of the middle is 30 pixels: at the edge.
    assert brightest[1] == 39 and abs(brightest[0] - 19.5) < 3
    drawn = [
        backgrounds.draw_background(np.random.default_rng(k), maps, lens, 40) for k in range(40)
    ]
    own = sum(torch.equal(picture, seen) for picture in drawn)
    assert 10 < own < 30


def test_light_adds_up_before_it_is_shown():
    """A half covered pixel is D(a c + (1 - a) b), not the mean of what is shown."""
    colour, behind = torch.full((3, 1, 1), 0.9), torch.full((3, 1, 1), 0.1)
    half = display(0.5 * undisplay(colour, 0), 0)
    shown = put_over(half, torch.full((1, 1, 1), 0.5), behind)
    wanted = display(0.5 * undisplay(colour, 0) + 0.5 * undisplay(behind, 0), 0)
    assert torch.allclose(shown, wanted, atol=1e-3)
    assert (shown - 0.5).abs().min() > 0.1


def test_opaque_pictures_keep_their_background(small_dataset: Path):
    sample = PortraitPairs(small_dataset, SMALL, seed=1, augment=True)[0]
    assert not sample.transparent and sample.background.max() == 0
    assert torch.equal(sample.foreground, sample.alpha * sample.mot_image)


def test_sources_of_training_lie_as_those_of_a_fit(transparent_dataset: Path):
    """The picture is bent against its bust by a share of a per cent of the frame, the camera goes
    round the head by degrees."""
    whole = dataclasses.replace(SMALL, image=96)
    source = PortraitPairs(transparent_dataset, whole, seed=1)[0].app
    angles, shifts = [], []
    grid = torch.stack(torch.meshgrid(*2 * [torch.arange(96) / 96], indexing="ij"))
    ramp = source._replace(image=torch.cat([grid, grid[:1]]))
    for seed in range(12):
        bent = misfitted(ramp, np.random.default_rng(seed))
        turn = bent.camera_to_world[:3, :3] @ source.camera_to_world[:3, :3].T
        angles.append(math.degrees(math.acos(min(1, (float(turn.trace()) - 1) / 2))))
        distance = [
            camera[:3, 3].norm() for camera in (bent.camera_to_world, source.camera_to_world)
        ]
        assert distance[0] == pytest.approx(float(distance[1]), abs=1e-5)
        shifts.append((bent.image - ramp.image)[:2, 8:-8, 8:-8].norm(dim=0).mean())
    assert 1 < np.mean(angles) < 4
    assert 0.002 < np.mean(shifts) < 0.012


# ---------------------------------------------------------------- resizing


def test_area_weighs_pixels_by_what_they_share():
    values = np.random.default_rng(0).random((12, 12, 2), dtype=np.float32)
    assert np.allclose(area(values, 4), values.reshape(4, 3, 4, 3, 2).mean((1, 3)), atol=1e-6)
    assert np.allclose(area(values, 5).mean((0, 1)), values.mean((0, 1)), atol=1e-6)
    assert np.array_equal(area(values, 24)[::2, ::2], area(values, 24)[1::2, 1::2])
    ramp = np.broadcast_to(np.arange(3, dtype=np.float32)[None, :, None], (3, 3, 1))
    assert np.allclose(area(ramp, 2)[0, :, 0], [1 / 3, 5 / 3])  # (1 · 0 + ½ · 1) / 1.5


def test_labels_are_means_over_the_surface():
    labels = np.array([[1, 0], [1, 1]], np.uint8).repeat(2, 0).repeat(2, 1)
    depth = np.where(labels > 0, 2.0, 0.0).astype(np.float32)[..., None]
    assert torch.equal(over_surface(depth, labels, 2)[0], torch.tensor([[2.0, 0.0], [2.0, 2.0]]))
    assert over_surface(depth, labels, 1).item() == pytest.approx(2.0)


def test_a_transparent_picture_is_put_on_black():
    stored = np.full((2, 2, 4), 255, np.uint8)
    stored[..., 3] = [[255, 0], [255, 0]]
    shown = shots.picture(stored, 2)
    assert shown[:, :, 0].min() > 0.9999 and shown[:, :, 1].max() == 0


# ---------------------------------------------------------------- order


def test_samples_follow_from_seed_and_number(small_dataset: Path, pairs: PortraitPairs):
    again = PortraitPairs(small_dataset, SMALL, seed=1, relit=True)
    other = PortraitPairs(small_dataset, SMALL, seed=2, relit=True)
    numbers = range(2 * len(pairs))
    assert all(equal(again[n], pairs[n]) for n in reversed(numbers))
    assert [other[n].key for n in numbers] != [pairs[n].key for n in numbers]


def test_an_epoch_visits_every_shot_once(pairs: PortraitPairs):
    size = len(pairs)
    epochs = [[pairs[n].key for n in range(k * size, (k + 1) * size)] for k in range(2)]
    assert sorted(epochs[0]) == sorted(epochs[1]) == sorted(pairs.keys)
    assert epochs[0] != epochs[1]


def test_resuming_gives_the_same_rest(pairs: PortraitPairs):
    whole = list(itertools.islice(loader(pairs, 2), 8))
    rest = list(itertools.islice(loader(pairs, 2, start=2 * 5), 3))
    assert all(equal(a, b) for a, b in zip(whole[5:], rest, strict=True))
    assert len(pairs) < 2 * 8  # it went on into the next epoch


def test_workers_change_nothing(pairs: PortraitPairs):
    alone = list(itertools.islice(loader(pairs, 2), 6))
    shared = list(itertools.islice(loader(pairs, 2, workers=2), 6))
    assert all(equal(a, b) for a, b in zip(alone, shared, strict=True))


def test_ranks_share_the_numbers_without_overlap():
    parts = [list(Stream(5, 29, rank, 3)) for rank in range(3)]
    assert sorted(n for part in parts for n in part) == list(range(5, 29))
    assert {len(part) for part in parts} == {8}
    with pytest.raises(ValueError, match="rank 3"):
        Stream(rank=3, world=3)


def test_splits_share_no_subject(small_dataset: Path):
    seen: list[set[str]] = []
    for split in ("train", "validation", "test"):
        try:
            seen.append(set(Shots(small_dataset, split).subjects))
        except InputError:
            continue
    assert len(seen) > 1 and sum(map(len, seen)) == len(set().union(*seen)) == 8


# ---------------------------------------------------------------- damage, wrong folders


@pytest.mark.parametrize("workers", [0, 2])
def test_a_damaged_shot_is_skipped_counted_and_named(
    small_dataset: Path, tmp_path: Path, pairs: PortraitPairs, workers: int, caplog
):
    key = pairs.keys[1]
    folder = damaged_copy(small_dataset, tmp_path / "out", [key], "parts.png")
    broken = PortraitPairs(folder, SMALL, seed=1)
    with caplog.at_level(logging.WARNING):
        batches = list(loader(broken, 2, workers, stop=3 * len(broken)))
    keys = [k for batch in batches for k in batch.key]
    assert len(keys) == 3 * len(broken) and key not in keys
    assert set(keys) == set(broken.keys) - {key}
    assert list(broken.skipped) == [key]
    assert "parts.png does not decode" in broken.skipped[key]
    if not workers:
        (record,) = caplog.records
        assert record.getMessage().startswith(f"skipped {key}: ")
        assert "parts.png" in record.getMessage()
    # What is not near the damage is as it was.
    before = [pairs[n].key for n in range(len(pairs))]
    assert [(k, b) for k, b in zip(keys, before, strict=False) if k != b and b != key] == []


def test_damage_met_earlier_changes_no_sample(
    small_dataset: Path, tmp_path: Path, pairs: PortraitPairs
):
    folder = damaged_copy(small_dataset, tmp_path / "out", [pairs.keys[1]], "rgb_00.png")
    first, second = (PortraitPairs(folder, SMALL, seed=1) for _ in range(2))
    numbers = range(2 * len(first))
    forwards = [first[n] for n in numbers]
    backwards = [second[n] for n in reversed(numbers)][::-1]
    assert all(equal(a, b) for a, b in zip(forwards, backwards, strict=True))
    assert list(first.skipped) == [pairs.keys[1]]


def test_where_all_is_damaged_it_ends(small_dataset: Path, tmp_path: Path, pairs: PortraitPairs):
    folder = damaged_copy(small_dataset, tmp_path / "out", pairs.keys, "meta.json")
    with pytest.raises(InputError, match=r"none of \d+ samples can be read; .*meta.json"):
        PortraitPairs(folder, SMALL)[0]


def test_wrong_folders_are_one_line(small_dataset: Path, tmp_path: Path):
    with pytest.raises(InputError, match="no dataset here"):
        PortraitPairs(tmp_path, SMALL)
    with pytest.raises(InputError, match="no subset nobody"):
        PortraitPairs(small_dataset, SMALL, subset="nobody")
    with pytest.raises(InputError, match="give one of train, validation, test"):
        PortraitPairs(small_dataset, SMALL, split="trian")
    folder = tmp_path / "out"
    shutil.copytree(small_dataset, folder)
    path = folder / "dataset.json"
    info = json.loads(path.read_bytes())
    path.write_text(json.dumps(info | {"format": 7}))
    with pytest.raises(InputError, match="of format 7, this version reads 1 and 2"):
        PortraitPairs(folder, SMALL)
    splits = ("train", "validation", "test")
    kinds = itertools.product(("multiview", "video"), splits)
    kind, split = next(k for k in kinds if not len(open_dataset(small_dataset, *k)))
    with pytest.raises(InputError, match=f"no shot in the split {split}"):
        PortraitPairs(small_dataset, SMALL, split=split, subset=kind)
