"""Figures of validation: their names in files, and how they are printed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A figure as people read it."""

    label: str
    unit: str = ""
    former: str | None = None
    """What it was called in checkpoints before version 0.2."""


FIGURES: dict[str, Figure] = {
    "psnr": Figure("PSNR", "dB", "PSNR"),
    "matte_psnr": Figure("PSNR of the matte's pixels", "dB"),
    "seen_psnr": Figure("PSNR of pixels that the source shows", "dB"),
    "seen_share": Figure("share of the matte that the source shows"),
    "ssim": Figure("SSIM"),
    "lpips": Figure("LPIPS (AlexNet)"),
    "source_lpips": Figure("LPIPS of the source (AlexNet)"),
    "source_psnr": Figure("PSNR of the source", "dB", "PSNR of the source"),
    "source_matte_psnr": Figure("PSNR of the source, the matte's pixels", "dB"),
    "source_seen_psnr": Figure("PSNR of the source, pixels that it shows", "dB"),
    "normal_error": Figure("normals, mean error", "°", "normal, mean °"),
    "albedo_error": Figure("albedo, L1", former="albedo, L1"),
    "relative_light_error": Figure(
        "light error / that of the mean light", former="light / mean light"
    ),
    "dominant_light_error": Figure("dominant light, median error", "°", "dominant light, median °"),
    "expression_error": Figure("expression, mean error", former="expression"),
    "gaze_error": Figure("gaze, mean error", "rad", "gaze"),
    "head_error": Figure("head pose, mean error", "rad", "head"),
    "identity_error": Figure("identity, mean error", former="identity"),
    "camera_yaw_pitch_roll_error": Figure(
        "camera angles, mean error", "rad", "camera_yaw_pitch_roll"
    ),
    "log_focal_error": Figure("log focal length, mean error", former="log_focal"),
    "log_fill_error": Figure("log fill, mean error", former="log_fill"),
    "shift_error": Figure("shift, mean error", "frames", "shift"),
    "face_error": Figure("points of the face, mean error", "frames", "face"),
}
"""By the name in checkpoints, TensorBoard and code; other figures are printed under their name."""

_NAMES = {figure.former: name for name, figure in FIGURES.items() if figure.former is not None}


def with_current_names(figures: dict[str, float]) -> dict[str, float]:
    """Figures of a checkpoint of any version under today's names, in the order of `FIGURES`."""
    named = {_NAMES.get(name, name): value for name, value in figures.items()}
    return {name: named[name] for name in (*FIGURES, *named) if name in named}


def label(name: str) -> str:
    """How a figure is called in print."""
    return FIGURES[name].label if name in FIGURES else name


def shown(name: str, value: float) -> str:
    """A figure's value with its unit."""
    unit = FIGURES[name].unit if name in FIGURES else ""
    space = " " if unit not in ("", "°") else ""
    return f"{value:.4g}{space}{unit}"
