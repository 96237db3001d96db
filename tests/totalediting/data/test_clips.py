"""Real clips: frames of videos and folders, what lies beside them, and damage."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from videos import write_video

from totalediting.data.clips import Clips
from totalediting.data.endless import loader
from totalediting.errors import InputError
from totalediting.presets import PRESETS

SMALL = replace(PRESETS["tiny"], image=24)


def equal(a: Any, b: Any) -> bool:
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, tuple):
        return all(equal(x, y) for x, y in zip(a, b, strict=True))
    return a == b


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    folder = tmp_path / "clips"
    frames = folder / "nested" / "frames"
    frames.mkdir(parents=True)
    write_video(folder / "talk.mp4", list(range(20, 220, 10)))
    write_video(folder / "talk.matte.mp4", [255, 0] * 10)
    for k in range(4):
        Image.new("RGB", (40, 30), (k * 50,) * 3).save(frames / f"{k:04d}.png")
        Image.new("L", (40, 30), 255).save(frames / f"{k:04d}.matte.png")
        Image.new("RGB", (40, 30), (128, 128, 255)).save(frames / f"{k:04d}.normal.png")
    return folder


def test_clips_give_frames_with_what_lies_beside_them(clips: Path):
    data = Clips(clips, SMALL)
    assert data.keys == ["nested/frames", "talk.mp4"]
    for number in range(8):
        pair = data[number]
        assert pair.mot_image.shape == (3, 24, 24) and pair.alpha.shape == (1, 24, 24)
        assert not torch.equal(pair.app_image, pair.mot_image) and pair.matted
        if pair.key == "talk.mp4":
            # Which frame it was is known from its level; the matte is that frame's.
            index = round((pair.mot_image.mean().item() * 255 - 20) / 10)
            assert abs(pair.mot_image.mean().item() * 255 - 20 - 10 * index) < 3
            assert pair.alpha.mean().item() == pytest.approx(1 - index % 2, abs=0.05)
            assert not pair.normal.any()
        else:
            assert pair.alpha.min() == 1
            assert torch.allclose(pair.normal[2], torch.ones(24, 24), atol=1e-3)
    assert equal(Clips(clips, SMALL)[5], data[5]) and not data.skipped
    assert next(iter(loader(data, 2))).matted.shape == (2,)


def test_broken_clips_are_skipped_and_counted(clips: Path, caplog):
    whole = (clips / "talk.mp4").read_bytes()
    (clips / "early.mp4").write_bytes(whole[: len(whole) * 2 // 3])
    (clips / "none.mkv").write_bytes(b"not a video")
    write_video(clips / "still.mp4", [100])
    (clips / "nested" / "frames" / "0002.png").write_bytes(b"not a picture")
    data = Clips(clips, SMALL)
    with caplog.at_level(logging.WARNING):
        keys = {data[n].key for n in range(40)}
    assert "talk.mp4" in keys and not keys & {"early.mp4", "none.mkv", "still.mp4"}
    assert set(data.skipped) == {"early.mp4", "none.mkv", "still.mp4", "nested/frames"}
    assert "ends early" in data.skipped["early.mp4"]
    assert "a pair takes 2" in data.skipped["still.mp4"]
    assert len(caplog.records) == 4


def test_folders_without_clips_are_one_line(tmp_path: Path):
    with pytest.raises(InputError, match="no such folder"):
        Clips(tmp_path / "none", SMALL)
    with pytest.raises(InputError, match="no clip in it"):
        Clips(tmp_path, SMALL)
