"""The unlearnt warp on a painted ball: what geometry and light know, it gets right."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import torch
from answer import Answer
from torch import Tensor

from totalediting import cli, metrics
from totalediting.baselines import warp
from totalediting.data.pairs import PortraitPair
from totalediting.geometry.field import Control
from totalediting.geometry.source import Source
from totalediting.light.lightmaps import bake, sample, texel_directions
from totalediting.light.phong import display
from totalediting.presets import PRESETS

SIDE, RADIUS, FAR = 64, 0.1, 1.0


def turn(yaw: float) -> Tensor:
    c, s = torch.tensor(yaw).cos(), torch.tensor(yaw).sin()
    return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def light(direction: tuple[float, float, float]) -> Tensor:
    """Lightmaps (5, 3, 16, 32) of soft light from a direction."""
    shade = (texel_directions(32) @ torch.tensor(direction)).clamp_min(0)[..., None] + 0.4
    return bake(shade.expand(-1, -1, 3).contiguous(), 16)


def shot(yaw: float, maps: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Picture, alpha, depth and normals of the ball turned by `yaw`, from -Y."""
    middle = (torch.arange(SIDE) + 0.5 - SIDE / 2) / (2.5 * SIDE)
    z, x = torch.meshgrid(-middle, middle, indexing="ij")
    ray = torch.stack([x, torch.ones_like(x), z], -1)
    a, b, c = ray.square().sum(-1), -FAR * torch.ones_like(x), FAR**2 - RADIUS**2
    inside = b**2 - a * c
    hit = inside > 0
    depth = torch.where(hit, (-b - inside.clamp_min(0).sqrt()) / a, 0.0)
    place = depth[..., None] * ray + torch.tensor([0.0, -FAR, 0.0])
    normal = torch.where(hit[..., None], place / RADIUS, 0.0)
    painted = normal @ turn(yaw)  # back to canonical
    x, y, z = painted.split(1, -1)
    albedo = (
        0.45 + 0.2 * torch.sin(6 * z) + 0.2 * torch.cos(9 * x) + 0.05 * torch.cat([y, z, y], -1)
    )
    shade = sample(maps[0], normal.flatten(0, 1)).view_as(normal)
    colour = display((albedo * shade).movedim(-1, 0), 0) * hit
    return colour, hit[None].float(), depth[None], normal.movedim(-1, 0)


def pair(yaw: float = 0.4, relit: bool = True) -> PortraitPair:
    golden, k = torch.pi * (3 - 5**0.5), torch.arange(800)
    up = 1 - 2 * (k + 0.5) / 800
    ring = (1 - up.square()).sqrt()
    n = torch.stack([ring * (golden * k).cos(), ring * (golden * k).sin(), up], -1)
    camera = torch.eye(4)
    camera[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    camera[:3, 3] = torch.tensor([0.0, -FAR, 0.0])
    focal = 2.5 * SIDE
    lens = torch.tensor([[focal, 0, SIDE / 2], [0, focal, SIDE / 2], [0, 0, 1]])
    old, new = light((0.6, -0.8, 0.0)), light((-0.6, -0.8, 0.0)) if relit else None
    new = old if new is None else new
    app, alpha, depth, _ = shot(0.0, old)
    mot, mot_alpha, mot_depth, normal = shot(yaw, new)
    code, empty = torch.zeros(54), torch.zeros(3, SIDE, SIDE)
    posed = n @ turn(yaw).T
    source = Source(
        app, alpha, code, Control(RADIUS * n, RADIUS * n, n, n), camera, lens, old, torch.eye(3)
    )
    one = PortraitPair(
        app=source, app_depth=depth, mot_image=mot, foreground=mot,
        background=empty, transparent=torch.tensor(True), albedo=empty, normal=normal,
        alpha=mot_alpha, parts=mot_alpha, depth=mot_depth, canonical=empty,
        points=torch.zeros(5, 2), mot_code=code, camera_to_world=camera, intrinsics=lens,
        control=Control(RADIUS * posed, RADIUS * n, posed, n), lightmaps=new, seen_lightmaps=new,
        relit=None, key="a", app_key="b",
    )  # fmt: skip
    return batched(one)


def batched(value):
    if isinstance(value, Tensor):
        return value[None]
    if isinstance(value, tuple):
        return type(value)(*map(batched, value))
    return value


def test_a_turned_and_relit_ball_comes_out_right() -> None:
    one = pair()
    made = warp.warp(one)
    seen = made.seen.float()
    assert 0.6 < float(seen.sum() / one.alpha.sum()) < 0.95
    assert metrics.psnr_within(made.image, one.foreground, seen) > 32
    assert metrics.psnr_within(one.app.image, one.foreground, seen) < 22
    # The paint is the same on both sides: what is hidden comes from the other one.
    assert metrics.psnr_within(made.image, one.foreground, one.alpha) > 24


def test_light_and_motion_both_count() -> None:
    """Without either, the ball is wrong: neither is left out."""
    one = pair()
    seen = warp.warp(one).seen.float()
    still = one._replace(control=one.app.control)
    dark = one._replace(lightmaps=one.app.lightmaps)
    for wrong in (still, dark):
        assert metrics.psnr_within(warp.warp(wrong).image, one.foreground, seen) < 27


def test_what_something_hides_is_not_taken_from_the_source() -> None:
    one = pair(0.0, relit=False)
    depth = one.app_depth.clone()
    depth[..., : SIDE // 2] -= 0.02 * (depth[..., : SIDE // 2] > 0)
    made = warp.warp(one._replace(app_depth=depth))
    assert not made.seen[..., : SIDE // 2].any() and made.seen[..., SIDE // 2 :].any()


def test_a_dataset_is_measured_without_a_run(
    small_dataset: Path, tmp_path: Path, run_main: Callable[..., Answer]
) -> None:
    preset = dataclasses.replace(PRESETS["tiny"], image=48)
    figures = warp.evaluate(small_dataset, preset, "train")
    assert figures["matte_psnr"] < figures["psnr"] and 0 < figures["seen_share"] <= 1
    assert set(figures) >= {"seen_psnr", "ssim", "source_psnr", "source_matte_psnr"}
    measure = ["evaluate", tmp_path / "none", small_dataset, "--split", "validation"]
    said = run_main(cli.main, *measure, "--baseline", "warp")
    assert said.returncode == 0 and "warp: PSNR of pixels that the source shows: " in said.stdout
    assert "nothing was trained there" in run_main(cli.main, *measure).error
