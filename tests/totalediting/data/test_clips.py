"""Real clips: frames of videos and folders, what lies beside them, and damage."""

from __future__ import annotations

import errno
import logging
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
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


def test_layers_turn_with_their_picture(tmp_path: Path):
    """A matte and normals made of stored pixels, of a picture that its tag turns by a quarter."""
    person = np.zeros((30, 60, 3), np.uint8)
    person[:, :20] = 200  # left as stored: up as shown, since orientation 6 turns clockwise
    exif = Image.Exif()
    exif[0x0112] = 6
    for k in range(2):
        Image.fromarray(person).save(tmp_path / f"{k}.jpg", exif=exif, quality=95)
        Image.fromarray(np.where(person > 100, 255, 0).astype(np.uint8)).save(
            tmp_path / f"{k}.matte.png"
        )
        to_the_left = np.full_like(person, (0, 128, 128))
        Image.fromarray(to_the_left).save(tmp_path / f"{k}.normal.png")
    pair = Clips(tmp_path, SMALL)[0]
    # The middle square of 60 x 30 shown: its upper sixth is the person.
    assert pair.mot_image[0, :3].mean() > 0.7 and pair.mot_image[0, 6:].mean() < 0.1
    assert pair.alpha[0, :3].mean() > 0.9 and pair.alpha[0, 6:].mean() < 0.1
    assert torch.allclose(pair.normal[:, 12, 12], torch.tensor([0.0, 1.0, 0.0]), atol=0.02)


def test_a_name_with_a_dot_is_a_layer_only_beside_its_picture(tmp_path: Path):
    for name in ("talk.mp4", "talk.matte.mp4", "walk.normal.speed.mp4", "slow.normal.mp4"):
        write_video(tmp_path / name, [20, 40, 60])
    data = Clips(tmp_path, SMALL)
    assert data.keys == ["slow.normal.mp4", "talk.mp4", "walk.normal.speed.mp4"]


def test_linked_folders_are_followed_once_and_litter_is_not(tmp_path: Path):
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "clips"
    (elsewhere / "deep").mkdir(parents=True)
    folder.mkdir()
    write_video(elsewhere / "deep" / "talk.mp4", [20, 40, 60])
    (folder / "linked").symlink_to(elsewhere)
    (elsewhere / "deep" / "around").symlink_to(folder)
    for name in ("._talk.mp4", "Thumbs.db", ".DS_Store"):
        (elsewhere / "deep" / name).write_bytes(b"litter")
    assert Clips(folder, SMALL).keys == ["linked/deep/talk.mp4"]


def test_a_folder_that_cannot_be_read_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    write_video(tmp_path / "talk.mp4", [20, 40, 60])
    (tmp_path / "closed").mkdir()
    scan = os.scandir

    def scandir(path: str) -> Any:
        if str(path).endswith("closed"):  # root may read everything
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", scandir)
    with caplog.at_level(logging.WARNING):
        assert Clips(tmp_path, SMALL).keys == ["talk.mp4"]
    assert "closed: Permission denied" in caplog.text


def test_a_pipe_is_not_waited_for(tmp_path: Path):
    os.mkfifo(tmp_path / "talk.mp4")
    data = Clips(tmp_path, SMALL)
    with pytest.raises(InputError, match="is not a file"):
        data[0]
