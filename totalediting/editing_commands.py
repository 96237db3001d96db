"""The commands `totalediting track`, `edit` and `demo`. Imports nothing heavy before one runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from assets_procedural.conventions import console
from totalediting.errors import InputError


def add_to(app: typer.Typer) -> None:
    """Makes them commands of `app`."""
    for command in (track, edit, demo):
        app.command()(command)


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
    expression: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=AMOUNT", help="Add to a coefficient: jawOpen=0.6. Repeatable."),
    ] = None,
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
    exposure: Annotated[
        float, typer.Option(metavar="STOPS", help="Light the person brighter, or darker.")
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
        *(_amounts(expression or []), exposure),
    )
    for note in write(job):
        typer.echo(note, err=True)
    console.say(out)


def demo(
    host: Annotated[
        str,
        typer.Option(help="Address to listen on; other than on loopback, a password is required."),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 picks a free one.")] = 8360,
) -> None:
    """Serve a page to edit portraits on: drop pictures, turn the light, move the face."""
    from totalediting.demo.serve import serve

    serve(host, port, console.say)


def _amounts(texts: list[str]) -> dict[str, float]:
    """What is added to coefficients, by name."""
    amounts = {}
    for text in texts:
        name, _, amount = text.partition("=")
        try:
            amounts[name] = float(amount)
        except ValueError:
            raise InputError(
                f"--expression: {text}: give a coefficient and a number, such as jawOpen=0.6"
            ) from None
    return amounts


def _angles(text: str) -> tuple[float, float]:
    """Yaw and pitch in degrees."""
    try:
        yaw, pitch = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(
            f"--view: {text}: give 2 angles in degrees, yaw and pitch, such as 20,-5"
        ) from None
    return yaw, pitch
