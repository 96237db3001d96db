"""The command `totalediting`. Imports nothing heavy before a command runs: `--help` is quick."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import totalediting
from assets_procedural.conventions import console
from assets_procedural.conventions.command_line import add_version, run
from totalediting import editing_commands
from totalediting.errors import InputError
from totalediting.presets import PRESETS, preset_with
from totalediting.training.stages import STAGES

if TYPE_CHECKING:
    import torch

    StageName = PresetName = str
else:  # Typer reads the choices off the types
    StageName, PresetName = Literal[(*STAGES, "all")], Literal[tuple(PRESETS)]

Device = Literal["cpu", "cuda"]

app = typer.Typer(
    help="Edit portraits: appearance, motion and light of a head, each by itself.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)

MAP_ROWS = (4, 512)


def main() -> None:
    """Entry point: `app()`, with errors of the user's making as one line and exit code 2."""
    run(app)


add_version(app, f"totalediting {totalediting.__version__}")


@app.command()
def bake(
    environment: Annotated[
        Path, typer.Argument(metavar="ENV.exr", help="An equirectangular .exr or .hdr panorama.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="MAPS.exr", help="File to write.")],
    size: Annotated[int, typer.Option(help="Height of a map in pixels; it is twice as wide.")] = 32,
    unnormalised: Annotated[
        bool,
        typer.Option(
            "--unnormalised", help="Store plain integrals, not divided by each lobe's own."
        ),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Also draw the panorama with its maps.")
    ] = None,
    ball: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Also draw a Phong ball in that light.")
    ] = None,
    albedo: Annotated[
        str, typer.Option(metavar="R,G,B", help="Albedo of the ball, linear Rec.709.")
    ] = "0.5,0.5,0.5",
    kd: Annotated[float, typer.Option(help="The ball's diffuse coefficient.")] = 1.0,
    ks: Annotated[
        str,
        typer.Option(
            metavar="A,B,C,D", help="The ball's specular coefficients, for shininess 1, 16, 32, 64."
        ),
    ] = "0,0,0.2,0",
    missing: Annotated[
        Literal["refuse", "black"],
        typer.Option(help="What becomes of a part of the sphere that the file has no pixels for."),
    ] = "refuse",
    device: Annotated[Device, typer.Option(help="Where to compute.")] = "cpu",
) -> None:
    """Pre-filter a panorama into the five lightmaps that a portrait is lit with."""
    if not MAP_ROWS[0] <= size <= MAP_ROWS[1]:
        low, high = MAP_ROWS
        raise _error("--size", size, f"give {low} to {high} rows, such as 32")
    colour = _numbers("--albedo", albedo, "3 numbers from 0 to 1, such as 0.5,0.5,0.5", 3, 1.0)
    (diffuse,) = _numbers("--kd", str(kd), "a number of at least 0", 1)
    specular = _numbers("--ks", ks, "4 numbers of at least 0, such as 0,0,0.2,0", 4)
    outputs = {"--out": out, "--picture": picture, "--ball": ball}
    written = {name: path for name, path in outputs.items() if path is not None}
    _check_outputs(environment, written)
    with console.progress("baking", len(written)) as advance:
        place = _device(device)

        import torch

        from assets_procedural.conventions import panorama_reading
        from totalediting.light import lightmaps, pictures
        from totalediting.light.files import write_lightmaps

        light = torch.from_numpy(panorama_reading.read(environment, missing=missing)[0]).to(place)
        maps = lightmaps.bake(light, size)
        stored = lightmaps.bake(light, size, normalised=False) if unnormalised else maps
        source, _ = panorama_reading.split(environment)
        write_lightmaps(out, stored, source, normalised=not unnormalised)
        advance(1, len(written))
        if picture is not None:
            pictures.draw_lightmaps(light, maps, environment.name, picture)
            advance(2, len(written))
        if ball is not None:
            pictures.draw_ball(light, maps, colour, diffuse, specular, ball)
    for path in written.values():
        console.say(path)


@app.command()
def train(
    stage: Annotated[
        StageName, typer.Argument(metavar="STAGE", help="Which stage, or all of them.")
    ],
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="A dataset rendered by `synthgen render`.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="RUN", help="Folder of the run.")],
    preset: Annotated[PresetName, typer.Option(help="Size of the model.")] = "tiny",
    steps: Annotated[
        int | None, typer.Option(min=1, show_default="the stage's own", help="Steps in all.")
    ] = None,
    batch: Annotated[
        int | None, typer.Option(min=1, show_default="the stage's own", help="Samples per step.")
    ] = None,
    learning_rate: Annotated[
        float | None, typer.Option(show_default="the stage's own", help="Its peak.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 0,
    workers: Annotated[int, typer.Option(min=0, help="Processes that read data.")] = 1,
    device: Annotated[Device, typer.Option(help="Where to train.")] = "cpu",
    devices: Annotated[int, typer.Option(min=1, help="Number of devices.")] = 1,
    precision: Annotated[
        Literal["32-true", "bf16-mixed", "auto"],
        typer.Option(help="Single precision, bfloat16, or whichever is faster here."),
    ] = "32-true",
    switches: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="SWITCH=VALUE", help="Ablate: decoder=plain, rotation=none …"
        ),
    ] = None,
    clips: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Real videos or frames for the stage joint."),
    ] = None,
    real_share: Annotated[
        float, typer.Option(help="Share of joint's steps on real clips; 1 is real data alone.")
    ] = 0.5,
    real_light: Annotated[
        Literal["random", "same", "consistent"],
        typer.Option(
            help="Frame that a clip's light is estimated from: another one, the target, or the "
            "target, held to what another one shows."
        ),
    ] = "random",
) -> None:
    """Train one stage of the model, or all of them. Run the same command again to resume."""
    preset_with(preset, switches or [])
    if not 0 <= real_share <= 1:
        raise _error("--real-share", real_share, "give a number from 0 to 1, such as 0.5")
    if learning_rate is not None and not 0 < learning_rate < 1:
        raise _error("--learning-rate", learning_rate, "give a number from 0 to 1, such as 4e-4")
    if batch is not None and batch % devices:
        raise _error("--batch", batch, f"give a multiple of the {devices} devices")
    _device(device, devices)

    from totalediting.training import loop, runs
    from totalediting.training.stage import RealVideo

    given = {"steps": steps, "batch": batch, "learning_rate": learning_rate}
    fastest = loop.fastest_precision(device)
    chosen = fastest if precision == "auto" else precision
    if chosen == "bf16-mixed" and fastest == "32-true":
        typer.echo(
            f"--precision: {chosen}: this processor emulates bfloat16, many times slower than "
            "single precision; auto is faster",
            err=True,
        )
    settings = runs.RunSettings(
        data=data,
        run=out,
        preset=preset,
        switches=switches or [],
        schedule={name: value for name, value in given.items() if value is not None},
        seed=seed,
        workers=workers,
        machine=loop.Machine(device, devices, chosen),
        real=None if clips is None else RealVideo(clips, real_share, real_light),
    )
    if stage == "all":
        _print_figures(runs.train_all(settings))
    else:
        _print_figures({stage: runs.train_stage(stage, settings)})


@app.command()
def evaluate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A folder that `train` filled.")],
    data: Annotated[Path, typer.Argument(metavar="DATA", help="A dataset with held-out people.")],
    split: Annotated[
        Literal["train", "validation", "test"], typer.Option(help="People to measure on.")
    ] = "test",
    baseline: Annotated[
        Literal["warp"] | None,
        typer.Option(
            help="Also what needs no training: the source warped by its true bust and relit by its "
            "true light. RUN may then be a folder that does not exist."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Instead, write tables (Markdown, JSON) and a page: novel views, self- and "
            "cross-reenactment, relighting, layers.",
        ),
    ] = None,
    predictions: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="With --out: score another system's pictures, named as its questions.json says; "
            "RUN then only gives the preset.",
        ),
    ] = None,
    device: Annotated[Device, typer.Option(help="Where to compute, with --out.")] = "cpu",
) -> None:
    """Measure every stage of a trained run on a split of a dataset."""
    if out is not None:
        _write_tables(run, data, split, out, predictions, device)
        return
    if predictions is not None:
        raise _error("--predictions", predictions, "is scored into tables; give --out, too")
    with console.progress("measuring stages") as advance:
        from totalediting.training import checkpoints, runs

        found = {}
        trained = runs.trained_in(run)
        if baseline == "warp":
            from totalediting.baselines import warp

            preset = checkpoints.preset_of(trained[0].folder(run)) if trained else PRESETS["tiny"]
            found["warp"] = warp.evaluate(data, preset, split)
        if trained or not found:
            found |= runs.evaluate(run, data, split, advance)
    _print_figures(found)


def _write_tables(
    run: Path, data: Path, split: str, out: Path, predictions: Path | None, device: Device
) -> None:
    """`evaluate --out`."""
    if predictions is not None and not predictions.is_dir():
        raise _error("--predictions", predictions, "is no folder; give one of pictures")
    if out.exists() and not out.is_dir():
        raise _error("--out", out, "is a file; give a folder's name")
    place = _device(device)
    with console.progress("evaluating") as advance:
        from totalediting.evaluation.run import evaluate as write
        from totalediting.training import checkpoints, runs, showcase

        trained = runs.trained_in(run)
        if predictions is None:
            model = showcase.load_model(run).to(place)
            preset = model.preset
        else:
            model = None
            preset = checkpoints.preset_of(trained[0].folder(run)) if trained else PRESETS["tiny"]
        written = write(model, predictions, data, preset, split, out, place, advance)
    for path in written:
        console.say(path)


@app.command()
def show(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A folder that `train` filled.")],
    data: Annotated[Path, typer.Argument(metavar="DATA", help="A dataset with held-out people.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="PICTURE", show_default="RUN.png", help="File to write."),
    ] = None,
) -> None:
    """Draw what a trained run makes of people it has not seen."""
    with console.progress("drawing"):
        from totalediting.training import showcase

        target = showcase.draw(run, data, output or run.with_name(run.name + ".png"))
    console.say(target)


editing_commands.add_to(app)


def _print_figures(found: dict[str, dict[str, float]]) -> None:
    """Figures by stage, one a line."""
    from totalediting.training import figures

    for stage, values in found.items():
        for name, value in values.items():
            console.say(f"{stage}: {figures.label(name)}: {figures.shown(name, value)}")


def _numbers(
    option: str, text: str, wanted: str, count: int, highest: float = math.inf
) -> list[float]:
    """`count` finite numbers from 0 to `highest`, separated by commas; `wanted` is the remedy."""
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(0.0 <= n <= highest and n < math.inf for n in numbers):
        raise _error(option, text, f"give {wanted}")
    return numbers


def _check_outputs(environment: Path, outputs: dict[str, Path]) -> None:
    """Files that can be written, none of which is the input or another output."""
    taken = {environment.resolve(): "the panorama"}
    for option, path in outputs.items():
        suffix = ".exr" if option == "--out" else ".png"
        if path.suffix.lower() != suffix:
            raise _error(option, path, f"is written as {suffix}; give a name with that ending")
        if path.is_dir():
            raise _error(option, path, "is a folder; give a file's name")
        folder = path.absolute().parent
        if not folder.is_dir():
            raise _error(option, path, f"there is no folder {folder}; make it first")
        if not os.access(folder, os.W_OK):
            raise _error(option, path, f"{folder} is not writable; give another folder")
        if path.resolve() in taken:
            raise _error(option, path, f"is also {taken[path.resolve()]}; give another name")
        taken[path.resolve()] = f"the file of {option}"


def _device(name: Device, count: int = 1) -> torch.device:
    import torch

    if name == "cuda" and not torch.cuda.is_available():
        raise _error("--device", name, "PyTorch finds no CUDA device here; use --device cpu")
    if name == "cuda" and count > (here := torch.cuda.device_count()):
        raise _error(
            "--devices", count, f"PyTorch finds {here} CUDA devices here; give at most {here}"
        )
    return torch.device(name)


def _error(option: str, value: object, remedy: str) -> InputError:
    return InputError(f"{option}: {value}: {remedy}")
