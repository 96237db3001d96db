"""Figures of pictures against the truth, gathered by task and system."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from totalediting import metrics
from totalediting.pretrained.fetch import NetworkError
from totalediting.pretrained.lpips import Lpips
from totalediting.pretrained.sface import Recognition, similarity

FIGURES = {
    "psnr": "PSNR, dB",
    "matte_psnr": "PSNR of the matte, dB",
    "ssim": "SSIM",
    "lpips_alex": "LPIPS (AlexNet)",
    "lpips_vgg": "LPIPS (VGG16)",
    "csim": "CSIM (SFace)",
    "flicker": "flicker",
    "normal_error": "normals, mean °",
    "albedo_error": "albedo, L1",
}
"""Name to how it is headed. PSNR, SSIM and LPIPS are of all pixels over black by the true matte;
flicker is the mean absolute error of what changes from one frame to the next, within the matte."""


class Scores:
    """Means of figures, by task and system."""

    def __init__(self, device: torch.device) -> None:
        self.found: dict[str, dict[str, dict[str, list[float]]]] = {}
        self.notes: list[str] = []
        """Networks that could not be had."""
        self.lpips: dict[str, Lpips] = {}
        self.faces: Recognition | None = None
        for kind in ("alex", "vgg"):
            try:
                self.lpips[kind] = Lpips(kind).eval().to(device)
            except NetworkError as error:
                self.notes.append(f"without LPIPS ({kind}): {error}")
        try:
            self.faces = Recognition().eval().to(device)
        except NetworkError as error:
            self.notes.append(f"without CSIM: {error}")

    def add(self, task: str, system: str, **values: Tensor | float) -> None:
        """Figures (B,) of a system's answers."""
        figures = self.found.setdefault(task, {}).setdefault(system, {})
        for name, value in values.items():
            some = value.flatten().tolist() if isinstance(value, Tensor) else [value]
            figures.setdefault(name, []).extend(some)

    def compare(
        self, task: str, system: str, picture: Tensor, truth: Tensor, matte: Tensor
    ) -> None:
        """Pictures (B, 3, S, S) against the truth, both over black by its matte (B, 1, S, S)."""
        values = metrics.picture_figures(picture, truth, matte)
        values |= {f"lpips_{kind}": net(picture, truth) for kind, net in self.lpips.items()}
        self.add(task, system, **values)

    def recognise(
        self, task: str, system: str, pictures: tuple[Tensor, Tensor], points: tuple[Tensor, Tensor]
    ) -> None:
        """How alike two faces (B, 3, S, S) are, by their five points (B, 5, 2)."""
        if self.faces is not None:
            a, b = (self.faces.features(*one) for one in zip(pictures, points, strict=True))
            self.add(task, system, csim=similarity(a, b))

    def means(self) -> dict[str, dict[str, dict[str, float]]]:
        """By task, system and figure; what is not finite (equal pictures) is left out."""
        return {
            task: {
                system: {
                    name: sum(finite) / len(finite)
                    for name, values in figures.items()
                    if (finite := [value for value in values if math.isfinite(value)])
                }
                for system, figures in systems.items()
            }
            for task, systems in self.found.items()
        }
