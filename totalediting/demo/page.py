"""The page of `totalediting demo`: drop zones, sliders and what comes of them, in Gradio."""

from __future__ import annotations

import html
from collections.abc import Callable
from pathlib import Path
from typing import Any

# pyright: reportMissingImports=false
import gradio as gr
from gradio.themes import Base, colors

from assets_procedural.conventions.errors import UserError
from totalediting.data.clips import VIDEOS
from totalediting.data.frames import PICTURES
from totalediting.demo.playground import EXPRESSIONS, MOST_FRAMES, MOVES, Playground, Wish
from totalediting.editing.editor import WIDEST_VIEW
from totalediting.editing.sources import PANORAMAS

EXAMPLES = Path(__file__).parent / "examples"
"""Synthetic people, `person_*.jpg` and `motion_*.jpg`, and lights, `light_*.exr`."""
ZONES = {
    "appearance": ("Appearance", "a photograph of the person to show", (*PICTURES,)),
    "motion": (
        "Motion",
        f"a photograph, or a clip of at most {MOST_FRAMES} frames",
        (*PICTURES, *VIDEOS),
    ),
    "lighting": ("Light", "a portrait, or a panorama (.exr, .hdr)", (*PICTURES, *PANORAMAS)),
}
BACKGROUNDS = {
    "the photograph's": "keep",
    "blurred": "blur",
    "the light's": "light",
    "grey": "#808080",
}
THEME = Base(
    primary_hue=colors.amber,
    neutral_hue=colors.stone,
    font=["system-ui", "sans-serif"],
    font_mono=["monospace"],
)
"""Of fonts that every system has: nothing is fetched."""
CSS = """
.said { color: #b91c1c; font-weight: 600; }
.dark .said { color: #fca5a5; }
.zone { gap: 6px !important; }
.examples .grid-wrap { min-height: 0 !important; max-height: none !important; padding: 6px; }
.examples .grid-container {
  grid-template-columns: repeat(auto-fill, minmax(52px, 1fr)) !important;
  grid-template-rows: none !important;
  grid-auto-rows: min-content !important;
  gap: 4px;
}
.examples .grid-wrap, .examples .grid-container { height: auto !important; }
.examples .thumbnail-item { aspect-ratio: 1; height: auto !important; }
#edited { min-height: 320px; }
.examples, .layers { min-height: 0 !important; }
.layers .grid-wrap { min-height: 0 !important; }
footer { display: none !important; }
"""
_ONE_AT_A_TIME: dict[str, Any] = {
    "concurrency_id": "editor",
    "concurrency_limit": 1,
    "api_visibility": "private",
}


def build(playground: Playground) -> gr.Blocks:
    """The page over a playground, which all who open it share."""
    people, motions, lights = (
        sorted(EXAMPLES.glob(name)) for name in ("person_*.jpg", "motion_*.jpg", "light_*.exr")
    )
    examples = {"appearance": people, "motion": motions, "lighting": lights + people[:2]}
    with gr.Blocks(title="totalediting", analytics_enabled=False, delete_cache=(600, 3600)) as page:
        gr.Markdown("# Edit a portrait\nAppearance, motion and light, each from another picture.")
        with gr.Row():
            with gr.Column(scale=3, min_width=300):
                zones = {name: Zone(name, examples[name], playground) for name in ZONES}
            with gr.Column(scale=5, min_width=340):
                result = gr.Image(
                    label="Edited",
                    interactive=False,
                    type="filepath",
                    format="png",
                    buttons=["download", "fullscreen"],
                    elem_id="edited",
                )
                notes = gr.HTML(elem_id="notes")
                with gr.Tabs():
                    with gr.Tab("Layers"):
                        gr.Markdown(
                            "Albedo, normals, the diffuse light and alpha of the picture above."
                        )
                        take_apart = gr.Button("Take it apart", elem_id="take_apart")
                        layers = gr.Gallery(
                            label="Layers",
                            columns=4,
                            interactive=False,
                            height="auto",
                            elem_id="layers",
                            elem_classes="layers",
                        )
                        layers_said = gr.HTML()
                    with gr.Tab("Video"):
                        move = gr.Radio(list(MOVES), value=MOVES[1], label="What moves")
                        play = gr.Button("Make a video", elem_id="play")
                        gr.Markdown("Takes a minute or more: about a second a frame.")
                        video = gr.Video(label="Video", interactive=False, elem_id="video")
                        video_said = gr.HTML()
            with gr.Column(scale=3, min_width=300):
                sliders = _sliders()
        inputs = [*(zone.kept for zone in zones.values()), *sliders]

        def edit(*values: Any) -> tuple[str | None, str]:
            def made() -> tuple[Path | None, str]:
                picture, found = playground.picture(_wish(values))
                return picture, "".join(f"<p>{html.escape(line)}</p>" for line in found)

            return _or_said(playground, made)

        def apart(*values: Any) -> tuple[Any, str]:
            return _or_said(playground, lambda: (playground.layers(_wish(values)), ""))

        def moved(which: str, *values: Any) -> tuple[Any, str]:
            return _or_said(playground, lambda: (playground.video(_wish(values), which), ""))

        gr.on(
            [zone.kept.change for zone in zones.values()] + [one.change for one in sliders],
            edit,
            inputs,
            [result, notes],
            trigger_mode="always_last",
            show_progress="minimal",
            **_ONE_AT_A_TIME,
        )
        take_apart.click(apart, inputs, [layers, layers_said], **_ONE_AT_A_TIME)
        play.click(moved, [move, *inputs], [video, video_said], **_ONE_AT_A_TIME)
    return page


class Zone:
    """A drop zone with its examples; `kept` holds the file that is edited with."""

    def __init__(self, name: str, examples: list[Path], playground: Playground) -> None:
        label, hint, endings = ZONES[name]
        accept: Callable[[Path], tuple[Path, Path]] = getattr(playground, name)
        with gr.Column(elem_classes="zone"):
            gr.Markdown(f"**{label}**: {hint}")
            self.kept = gr.State(None)
            with gr.Row():
                drop = gr.File(
                    show_label=False,
                    file_types=list(endings),
                    height=128,
                    min_width=150,
                    elem_id=f"{name}_drop",
                )
                shown = gr.Image(
                    show_label=False,
                    interactive=False,
                    height=128,
                    min_width=110,
                    visible=False,
                    buttons=[],
                    elem_id=f"{name}_shown",
                )
            message = gr.HTML(elem_id=f"{name}_said")
            gallery = gr.Gallery(
                [str(playground.thumbnail(path)) for path in examples],
                show_label=False,
                height="auto",
                object_fit="cover",
                allow_preview=False,
                interactive=False,
                buttons=[],
                elem_id=f"{name}_examples",
                elem_classes="examples",
            )

        def take(path: str | Path | None) -> tuple[Any, str, Any]:
            if path is None:
                return None, "", gr.Image(visible=False)
            try:
                kept, picture = accept(Path(path))
            except UserError as error:
                return None, _alert(playground.said(error, Path(path))), gr.Image(visible=False)
            return str(kept), "", gr.Image(str(picture), visible=True)

        def choose(event: gr.SelectData) -> tuple[Any, ...]:
            return None, *take(examples[int(event.index) % len(examples)])

        outputs = [self.kept, message, shown]
        gr.on([drop.upload, drop.clear], take, drop, outputs, **_ONE_AT_A_TIME)
        gallery.select(choose, None, [drop, *outputs], **_ONE_AT_A_TIME)


def _sliders() -> list[Any]:
    """Everything but the three files, in the order of `_wish`."""
    with gr.Group():
        degrees = WIDEST_VIEW
        made = [
            gr.Slider(0, 360, 0, step=5, label="Turn the light (°)", elem_id="rotate_light"),
            gr.Slider(-2, 2, 0, step=0.1, label="Exposure (stops)", elem_id="exposure"),
            gr.Slider(-degrees, degrees, 0, step=1, label="Camera: yaw (°)", elem_id="yaw"),
            gr.Slider(-degrees, degrees, 0, step=1, label="Camera: pitch (°)", elem_id="pitch"),
            gr.Dropdown(list(BACKGROUNDS), value="the photograph's", label="Background"),
            gr.Slider(0, 1, 0, step=0.02, label="Moment of the clip", elem_id="moment"),
        ]
    with gr.Accordion("Expression", open=True):
        made += [
            gr.Slider(0, 1, 0, step=0.05, label=label, elem_id=names[0])
            for label, names in EXPRESSIONS.items()
        ]
    return made


def _wish(values: tuple[Any, ...]) -> Wish:
    """Of the kept files and all sliders."""
    files = [None if value is None else Path(value) for value in values[:3]]
    turn, exposure, yaw, pitch, background, moment, *amounts = values[3:]
    return Wish(
        *files,
        moment=float(moment),
        rotate_light=float(turn),
        exposure=float(exposure),
        view=(float(yaw), float(pitch)),
        expression={name: float(a) for name, a in zip(EXPRESSIONS, amounts, strict=True)},
        background=BACKGROUNDS[background],
    )


def _or_said(playground: Playground, make: Callable[[], tuple[Any, str]]) -> tuple[Any, str]:
    """What is made, or nothing and why."""
    try:
        return make()
    except UserError as error:
        return None, _alert(playground.said(error))


def _alert(line: str) -> str:
    return f'<p class="said" role="alert">{html.escape(line)}</p>'
