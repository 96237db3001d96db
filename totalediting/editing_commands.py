"""The commands `totalediting track` and `edit`. Imports nothing heavy before one runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from assets_procedural.conventions import console
from totalediting.errors import InputError


def add_to(app: typer.Typer) -> None:
    """Makes both commands of `app`."""
    app.command()(track)
    app.command()(edit)


def track(
    source: Annotated[
        Path, typer.Argument(metavar="INPUT", help="A picture, folder, video or dataset.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE.parquet", help="Table to write.")],
) -> None:
    """Fit the bust to every face: motion, identity and camera. Run again to resume."""
    from totalediting.editing import track as tracking

    for note in tracking.track(source, out):
        typer.echo(note, err=True)
    console.say(out)


def edit(
    appearance: Annotated[
        Path, typer.Option(metavar="A", help="Photograph of the person to show.")
    ],
    out: Annotated[
        Path,
        typer.Option("--out", metavar="O", help=".png; for a sequence .mp4, or a folder's name."),
    ],
    motion: Annotated[
        Path | None,
        typer.Option(metavar="M", help="Photograph, video or folder whose motion to take."),
    ] = None,
    lighting: Annotated[
        Path | None,
        typer.Option(metavar="L", help="Panorama (.exr, .hdr) or photograph whose light to take."),
    ] = None,
    relative: Annotated[
        bool,
        typer.Option(
            "--relative/--absolute",
            help="Motion off the driver's rest, or expression and gaze as they are.",
        ),
    ] = True,
    background: Annotated[
        str, typer.Option(metavar="B", help="keep, blur, light, a colour or a picture.")
    ] = "keep",
    view: Annotated[
        str,
        typer.Option(
            metavar="YAW,PITCH", help="Degrees that the camera goes to the left of A, and up."
        ),
    ] = "0,0",
    orbit: Annotated[
        bool, typer.Option("--orbit", help="Swing the camera about the head.")
    ] = False,
    rotate_light: Annotated[
        float, typer.Option(metavar="DEG", help="Turn the light about the vertical.")
    ] = 0.0,
    spin: Annotated[bool, typer.Option("--spin", help="Turn the light once around.")] = False,
    decompose: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Also write albedo, normals, shading, depth, alpha, …"),
    ] = None,
    engine: Annotated[Literal["warp"], typer.Option(help="How: warp takes no training.")] = "warp",
) -> None:
    """Show a person in the motion of another, in another light, view or place.

    A, M and L may be shots of a dataset, as DIR:KEY.
    """
    del engine  # one so far
    if not math.isfinite(rotate_light):
        raise InputError(f"--rotate-light: {rotate_light}: give degrees, such as 90")
    from totalediting.editing.edit import Job
    from totalediting.editing.edit import edit as write

    job = Job(
        *(appearance, out, motion, lighting, relative, background),
        *(_angles(view), orbit, rotate_light, spin, decompose),
    )
    for note in write(job):
        typer.echo(note, err=True)
    console.say(out)


def _angles(text: str) -> tuple[float, float]:
    """Yaw and pitch in degrees."""
    try:
        yaw, pitch = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(
            f"--view: {text}: give 2 angles in degrees, yaw and pitch, such as 20,-5"
        ) from None
    return yaw, pitch
