"""A trained run beside a dataset, shot by shot, for the page of `synthgen browse DATA --run RUN`.

Registered as the entry point `totalediting` of the group `synthgen.runs`: the page shows what the
run makes of a shot, and must not import torch itself. A shot is what is to be made: of another
picture of the same person, drawn once and for all, by its motion, camera and light.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from totalediting import metrics
from totalediting.data.endless import Unreadable, collate
from totalediting.data.pairs import PortraitPair, PortraitPairs
from totalediting.errors import InputError
from totalediting.model import Edit
from totalediting.training import showcase
from totalediting.training.reconstruction import edit_of, over_black
from totalediting.training.stages import STAGES

_SEED = 1


class RunBeside:
    """A run's model and the shots that it is given; made by `open_run`."""

    pictures: ClassVar = ("source", "prediction", "truth", "difference")
    """What `picture` shows, in order; the difference is |prediction - truth| times four."""
    figures: ClassVar = {
        "psnr": "PSNR (dB)",
        "matte_psnr": "PSNR of the person (dB)",
        "ssim": "SSIM",
        "normal_error": "error of normals (degrees)",
    }
    """What `measure` gives, and how it is called."""

    def __init__(self, run: Path, data: Path) -> None:
        self.data = data
        self.model = showcase.load_model(run)
        self._pairs: dict[str, PortraitPairs] = {}
        digest = hashlib.sha256()
        for spec in STAGES.values():
            best = spec.folder(run) / "best.json"
            if best.exists():
                seen = best.stat()
                digest.update(f"{best.resolve()} {seen.st_mtime_ns} {seen.st_size}\n".encode())
        self.name = digest.hexdigest()[:16]
        """Another one once the run has been trained further."""
        self._edit = lru_cache(4)(self._edited)

    def measure(self, key: str, split: str) -> dict[str, float]:
        """The figures of a shot ("subset/key"), over black; NaN where nothing counts.

        Raises:
            InputError: the split has no such shot, or it cannot be read.
        """
        batch, edit = self._edit(key, split)
        shown, truth, matte = over_black(batch, edit), batch.foreground, batch.alpha
        size = batch.normal.shape[-2:]
        normal = functional.interpolate(edit.rendering.normal, size, mode="bilinear")
        found = {
            **metrics.picture_figures(shown, truth, matte),
            "normal_error": metrics.normal_error(normal, batch.normal, matte),
        }
        return {name: float(found[name][0]) for name in self.figures}

    def picture(self, key: str, split: str, name: str) -> np.ndarray:
        """One of `pictures`, (S, S, 3) uint8; raises as `measure`."""
        batch, edit = self._edit(key, split)
        shown, truth = over_black(batch, edit), batch.foreground
        found: dict[str, Tensor] = {
            "source": batch.app.image,
            "prediction": shown,
            "truth": truth,
            "difference": 4 * (shown - truth).abs(),
        }
        pixels = (found[name][0].clamp(0, 1) * 255).round().byte()
        return np.ascontiguousarray(pixels.movedim(0, -1).numpy())

    @torch.no_grad()
    def _edited(self, key: str, split: str) -> tuple[PortraitPair, Edit]:
        if split not in self._pairs:
            pairs = PortraitPairs(self.data, self.model.preset, split, seed=_SEED)
            self._pairs[split] = pairs
        pairs = self._pairs[split]
        try:
            item = pairs.keys.index(key)
            batch = collate([pairs.make(item, np.random.default_rng([_SEED, item]))])
        except ValueError:
            raise InputError(f"{key}: is no shot of the split {split}") from None
        except Unreadable as error:
            raise InputError(f"{pairs.keys[error.item]}: cannot be read: {error.reason}") from None
        return batch, edit_of(self.model, batch, None)


def open_run(run: Path, data: Path) -> RunBeside:
    """What a run makes of a dataset.

    Raises:
        InputError: nothing was trained there that makes pictures.
    """
    return RunBeside(run, data)
