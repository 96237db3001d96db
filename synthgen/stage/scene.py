"""Cycles as two cameras over one scene: a beauty render per light, a label render per view.

The label render sees the same geometry through pixel centres (a pixel filter 0.01 wide, one
sample, no bounces, no denoising) with thin clear surfaces hidden, so ids are exact. What is to be a
mean over the pixel, albedo and normals, comes with the beauty render, whose samples are there
anyway; thin clear surfaces write neither. Beauty comes with its noise, which `light` takes out.
Row 0 of all arrays is at the top.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import bpy
import numpy as np

from assets_procedural.conventions.camera import SENSOR_MM, Camera
from synthgen.dataset.passes import PASSES
from synthgen.stage.layers import Weights, render_layers, render_sums
from synthgen.stage.nodes import Graph

Mode = Literal["beauty", "labels"]
_BACKGROUND_DEPTH = 1e9
_DEPTH_LAYER = "Depth"


Labels = dict[str, np.ndarray]
"""Label passes of one view by name, float32 but for `parts`; 0 in the background.

`albedo` (H, W, 3) linear, `normal` (H, W, 3) unit, camera space (OpenGL axes), `canonical`
(H, W, 3) and `depth` (H, W) in metres (planar), `uv` (H, W, 2), `parts` (H, W) uint8. Albedo and
normal are of one point of each pixel; `render.compose_shot` puts `Beauty`'s means in their place.
"""


class Beauty(NamedTuple):
    """A view in light, with its noise, and what light does not change, of the same samples."""

    light: np.ndarray
    """(E, H, W, 3) linear Rec.709, premultiplied; E is 1 under a world."""
    surface: np.ndarray
    """(H, W, 7) albedo, linear, in [0, 1]; normal, camera space (OpenGL axes); both premultiplied
    by coverage, the last."""
    guides: np.ndarray
    """(H, W, 6) albedo and normal as the denoiser wants them: of what mirrors and lenses show."""


def open_stage(resolution: int, samples: int, device: str = "cpu", threads: int = 0) -> None:
    """Reset Blender to an empty scene with a camera, a world and Cycles' settings.

    `threads` 0 lets Cycles take every core. Raises RuntimeError for a device that is not there.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("world")
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)

    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x = render.resolution_y = resolution
    render.resolution_percentage = 100
    render.film_transparent = True
    render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        render.threads = threads
    # Strands are thinner than a pixel; ribbons with many segments keep their curves.
    scene.cycles_curves.shape = "RIBBONS"
    scene.cycles_curves.subdivisions = 2

    cycles = scene.cycles
    cycles.device = choose_device(device)
    cycles.samples = samples
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False  # see `light.denoising`
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    cycles.max_bounces = 6
    cycles.caustics_reflective = cycles.caustics_refractive = False

    layer = bpy.context.view_layer
    layer.use_pass_z = True
    layer.cycles.denoising_store_passes = True
    for each in PASSES:
        if each.layer and each.layer != _DEPTH_LAYER:  # which Blender brings along
            aov = layer.aovs.add()
            aov.name = each.layer
            aov.type = "VALUE" if len(each.components) == 1 else "COLOR"


def choose_device(device: str) -> Literal["CPU", "GPU"]:
    """Point Cycles at a device: cpu, cuda, optix, hip or metal.

    Raises RuntimeError naming what was found where the device is not there.
    """
    if device == "cpu":
        return "CPU"
    preferences = bpy.context.preferences.addons["cycles"].preferences
    found = [d for d in preferences.get_devices_for_type(device.upper()) if d.type != "CPU"]
    if not found:
        raise RuntimeError(f"no {device} device was found; use --device cpu")
    preferences.compute_device_type = device.upper()
    for entry in preferences.devices:
        entry.use = entry.type == device.upper()
    return "GPU"


def set_light(panorama: Path, rotation: float) -> None:
    """Light the stage by an equirectangular file turned by `rotation` radians about +Z."""
    world = bpy.context.scene.world
    # Set before the first render: later changes of the importance map have no effect.
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 512
    graph = Graph(world)
    direction = graph.node("TexCoord").outputs["Generated"]
    turned = graph.node("Mapping", {"Vector": direction}, vector_type="TEXTURE")
    turned.inputs["Rotation"].default_value = (0.0, 0.0, rotation)
    image = bpy.data.images.load(str(panorama), check_existing=True)
    image.colorspace_settings.name = "Linear Rec.709"
    inputs = {"Vector": turned.outputs[0]}
    texture = graph.node("TexEnvironment", inputs, image=image, interpolation="Cubic")
    background = graph.node("Background", {"Color": texture.outputs["Color"]})
    graph.node("OutputWorld", {"Surface": background.outputs[0]})


def set_camera(camera: Camera) -> None:
    """Look through a pinhole camera whose principal point is the image's middle."""
    viewer = bpy.context.scene.camera
    viewer.matrix_world = camera.camera_to_world.T
    viewer.data.sensor_width = SENSOR_MM
    viewer.data.lens = camera.focal_mm
    viewer.data.clip_start, viewer.data.clip_end = 0.01, 1000.0


def set_focus(f_number: float | None, distance: float) -> None:
    """Focus beauty renders at a planar `distance` in metres; None: all is in focus."""
    field = bpy.context.scene.camera.data.dof
    field.use_dof = f_number is not None
    if f_number is not None:
        field.aperture_fstop, field.focus_distance = f_number, distance


def hold_scene() -> None:
    """Let Cycles hold its scene between renders: a change of camera or light then costs little."""
    bpy.context.scene.render.use_persistent_data = True


def release_scene() -> None:
    """Free Cycles' scene.

    Moved geometry is then built anew: updating it in place leaves the last bits of the light to
    chance, and the same job must give the same bytes.
    """
    bpy.context.scene.render.use_persistent_data = False


def set_mode(mode: Mode, samples: int) -> None:
    """Prepare for beauty renders with `samples` per pixel, or for label renders."""
    scene = bpy.context.scene
    labels = mode == "labels"
    scene.cycles.samples = 1 if labels else samples
    scene.cycles.filter_width = 0.01 if labels else 1.5
    scene.cycles.max_bounces = 0 if labels else 6
    if labels:
        scene.camera.data.dof.use_dof = False
    # Hidden from the camera, not taken out: Cycles would build the strands' BVH anew.
    for clear in bpy.data.objects:
        if clear.get("hidden_from_labels"):
            clear.visible_camera = not labels


def set_part(rows: tuple[int, int] | None) -> None:
    """Render only rows of the picture, from `rows[0]` to before `rows[1]`; None: all of it."""
    render = bpy.context.scene.render
    render.use_border = render.use_crop_to_border = rows is not None
    if rows is not None:
        # A quarter of a pixel more: Blender cuts off what is behind the point.
        height = render.resolution_y
        render.border_min_x, render.border_max_x = 0.0, 1.0
        render.border_min_y = (height - rows[1] + 0.25) / height
        render.border_max_y = (height - rows[0] + 0.25) / height


def shoot_beauty(seed: int, camera: Camera, weights: Weights | None = None) -> Beauty:
    """Render the current view, which must be `camera`'s.

    By `weights`, light is added up from layers, see `layers.render_sums`.
    """
    bpy.context.scene.cycles.seed = seed
    layers, sums = render_sums(weights or {})
    albedo = np.clip(layers["albedo"][..., :3], 0, 1)
    normal = layers["normal_world"][..., :3] @ camera.camera_to_world[:3, :3].astype(np.float32)
    coverage = np.clip(layers["Combined"][..., 3:], 0, 1)
    return Beauty(
        sums if weights else layers["Combined"][None, ..., :3],
        np.concatenate([albedo, normal, coverage], axis=-1),
        np.concatenate([layers["Denoising Albedo"], layers["Denoising Normal"]], axis=-1),
    )


def shoot_labels(camera: Camera) -> Labels:
    """Render the label passes of the current view, which must be `camera`'s."""
    bpy.context.scene.cycles.seed = 0
    layers = render_layers()
    labels: Labels = {}
    for each in PASSES:
        if each.layer:
            image = layers[each.layer]
            labels[each.name] = image if image.ndim == 2 else image[..., : len(each.components)]
    labels["parts"] = np.rint(labels["parts"]).astype(np.uint8)
    labels["albedo"] = np.clip(labels["albedo"], 0, 1)
    normal = labels["normal"] @ camera.camera_to_world[:3, :3]
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    labels["normal"] = normal / np.maximum(length, 1e-6)
    seen = (labels["parts"] > 0) & (labels["depth"] < _BACKGROUND_DEPTH)
    return {
        name: np.where(seen[..., None] if image.ndim == 3 else seen, image, 0)
        for name, image in labels.items()
    }
