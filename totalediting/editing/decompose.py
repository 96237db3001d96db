"""What an edit is made of, as files: each layer of the worked square by itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets_procedural.conventions import panorama_files
from assets_procedural.conventions.colour import display, to_bytes, undisplay
from totalediting.editing.editor import Edited
from totalediting.editing.lights import Panorama, irradiance_map
from totalediting.editing.output import new_folder, png
from totalediting.light.files import write_lightmaps

FILES = ("albedo.png", "normal.png", "diffuse.png", "alpha.png", "depth.exr", "irradiance.exr")
"""What is always written; `lightmaps.exr` as well where the light is a panorama."""
_DARKEST = 0.05  # light below which albedo is not told from it


def write(folder: Path, edited: Edited) -> None:
    """Into a new folder, of the square that is worked on, (S, S):

    albedo.png      what the person's colours would be in even light, displayed; scaled by guess
    normal.png      in the camera's axes, right, up, towards it, as (n + 1) / 2; grey off the bust
    diffuse.png     the light that falls on it, displayed; 0.5 where it is as in the mean
    alpha.png       where the person is
    depth.exr       Z: metres along the viewing axis; infinite off the bust
    irradiance.exr  what falls on what faces each direction of the world
    lightmaps.exr   the five lightmaps of a panorama, turned as it is

    The engine knows no specular light: what shines is in the albedo.
    """
    pictures = layers(edited)
    with new_folder(folder) as made:
        for name, layer in pictures.items():
            (made / f"{name}.png").write_bytes(png(to_bytes(layer)))
        depth = edited.pose.warped.raster.depth.astype(np.float32)
        panorama_files.write_channels(made / "depth.exr", {"Z": depth}, {})
        panorama_files.write(made / "irradiance.exr", irradiance_map(edited.light), {})
        if isinstance(edited.source, Panorama):
            maps = edited.source.lightmaps_turned
            write_lightmaps(made / "lightmaps.exr", maps, edited.source.path, normalised=True)


def layers(edited: Edited) -> dict[str, np.ndarray]:
    """Those of `write` that are pictures, (S, S[, 3]) in [0, 1], by name."""
    pose = edited.pose
    warped, covered = pose.warped, pose.warped.raster.covered
    light = edited.light(warped.normals)
    even = undisplay(warped.person) / pose.was.clip(_DARKEST, None)
    on = covered[..., None]
    normals = warped.normals @ pose.view.frame[:3, :3]
    return {
        "albedo": display(even) * warped.matte[..., None],
        "normal": np.where(on, (normals + 1) / 2, 0.5),
        "diffuse": np.where(on, display(0.2 * light), 0.0),
        "alpha": warped.matte,
    }
