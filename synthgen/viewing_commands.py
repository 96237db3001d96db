"""The commands of `synthgen` that use a dataset: draw, render a shot again, query, export, browse.

Imports nothing heavy before one runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from assets_procedural.conventions import console
from assets_procedural.conventions.command_line import limited_memory
from synthgen.command_options import Dataset, Device, Threads

Key = Annotated[str, typer.Argument(metavar="KEY", help="A shot: [multiview/]s000003_p01.")]
Subset = Annotated[str | None, typer.Option(help="The subset, if the key occurs in more than one.")]
_QUERY_BYTES = 4 << 30  # DuckDB's own limit does not count the values of functions
_OR_HERE = ", in the current folder where that cannot be written."


def add_to(app: typer.Typer) -> None:
    """Makes them commands of `app`."""
    for command in (show, sheet, clip, rerender, query, export, subset, tags, browse):
        app.command()(command)


def show(
    out: Dataset,
    key: Key,
    subset: Subset = None,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="PNG", help=f"Default: DIR-KEY.png{_OR_HERE}")
    ] = None,
) -> None:
    """Draw one shot with all its passes and environments; prints the picture's path."""
    from synthgen.beside import beside
    from synthgen.pictures import shot_sheet

    target = output or beside(out, f"-{key.replace('/', '-')}.png")
    console.say(shot_sheet.show(out, key, target, subset=subset))


def sheet(
    out: Dataset,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="FILE", help=f".png or .jpg; default DIR.png{_OR_HERE}"),
    ] = None,
    portraits: Annotated[
        bool,
        typer.Option(
            "--portraits",
            help="Only pictures, edge to edge: one of each person, or all of a single person.",
        ),
    ] = False,
    subset: Annotated[str | None, typer.Option(help="Of --portraits: only this subset.")] = None,
    columns: Annotated[int, typer.Option(help="Of --portraits, in a row.", min=1, max=40)] = 5,
) -> None:
    """Draw a contact sheet of a dataset; prints the picture's path."""
    from synthgen.beside import beside
    from synthgen.pictures import sheet as drawing

    target = output or beside(out, ".png")
    if portraits:
        console.say(drawing.portraits(out, target, subset, columns))
    else:
        console.say(drawing.sheet(out, target))


def clip(
    out: Dataset,
    subject: Annotated[str, typer.Argument(metavar="SUBJECT", help='"video/s000000".')],
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="WEBP", help=f"Default: DIR-SUBJECT.webp{_OR_HERE}"),
    ] = None,
    environment: Annotated[int, typer.Option(help="Which of the subject's, from 0.", min=0)] = 0,
    fps: Annotated[float, typer.Option(help="Frames a second.", min=1, max=60)] = 25.0,
) -> None:
    """Play the frames of one subject as an animated picture; prints its path."""
    from synthgen.beside import beside
    from synthgen.pictures import clip as drawing

    target = output or beside(out, f"-{subject.replace('/', '-')}.webp")
    console.say(drawing.clip(out, subject, target, environment, fps))


def rerender(
    out: Dataset,
    key: Key,
    subset: Subset = None,
    device: Device = "cpu",
    threads: Threads = 1,
    renderer: Annotated[
        str | None,
        typer.Option(help="Run this one, package.module:function; a dataset may name ours alone."),
    ] = None,
) -> None:
    """Render one shot again from what the dataset records, and report any difference."""
    from synthgen.farm import preflight
    from synthgen.farm.rerender import rerender as again

    preflight.check_device(device)
    with console.progress(f"rendering {key} again"):
        report = again(out, key, subset=subset, device=device, threads=threads, renderer=renderer)
    console.say(report)


def query(
    out: Dataset,
    sql: Annotated[str, typer.Argument(metavar="SQL", help='"SELECT … FROM manifest".')],
    format_: Annotated[
        Literal["csv", "json", "parquet", "table"] | None,
        typer.Option(
            "--format",
            show_default="by the ending of --output; a table on a terminal; else csv",
            help="How to write the answer.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="FILE", show_default="stdout", help="File to write."),
    ] = None,
    unlocked: Annotated[
        bool,
        typer.Option("--unlocked", help="Let the query read and write other files and settings."),
    ] = False,
) -> None:
    """Query the manifest in SQL (DuckDB).

    It takes at most 4 GB of memory, unless it is unlocked.
    """
    import contextlib

    from synthgen.dataset import manifest
    from synthgen.publish import answers

    with (
        contextlib.nullcontext() if unlocked else limited_memory(_QUERY_BYTES),
        manifest.answering(out, sql, unlocked) as answer,
    ):
        answers.write(answer, format_, output)


Where = Annotated[
    str | None, typer.Option(metavar="SQL", help='Only shots such as "person_age_years > 60".')
]
OneSubset = Annotated[str | None, typer.Option(help="Only this subset.")]
Split = Annotated[
    Literal["train", "validation", "test"] | None, typer.Option(help="Only this split.")
]

TagList = Annotated[
    str | None,
    typer.Option("--tags", metavar="LIST", help="Only shots with tags, or without: star,-reject."),
]
TagsIn = Annotated[
    Path | None,
    typer.Option("--tags-in", metavar="DIR", help="Where tags are kept; default: your own folder."),
]


def export(
    out: Dataset,
    target: Annotated[
        Path | None, typer.Option("--output", metavar="DIR", help=f"Default: DIR-FORMAT{_OR_HERE}")
    ] = None,
    format_: Annotated[
        Literal["nerfstudio"], typer.Option("--format", help="The format that tool reads.")
    ] = "nerfstudio",
    where: Where = None,
    subset: OneSubset = None,
    split: Split = None,
    tags: TagList = None,
    tags_in: TagsIn = None,
) -> None:
    """Export a dataset to another tool: a transforms.json per subject and environment."""
    from synthgen.beside import beside
    from synthgen.dataset import open_dataset
    from synthgen.publish.export import nerfstudio

    write = {"nerfstudio": nerfstudio}[format_]
    named = [tag for tag in (tags or "").split(",") if tag]
    chosen = open_dataset(out, subset=subset, split=split, where=where, tags=named, tags_in=tags_in)
    console.say(write(chosen, target or beside(out, f"-{format_}")))


def subset(
    out: Dataset,
    target: Annotated[Path, typer.Option("--out", metavar="DIR", help="A new folder.")],
    where: Where = None,
    subset: OneSubset = None,
    split: Split = None,
    tags: TagList = None,
    tags_in: TagsIn = None,
) -> None:
    """Write some shots of a finished dataset as a dataset of its own, which `verify` passes.

    Files that are kept whole are hard links and take no room; of the others whole samples are
    copied. dataset.json records what was asked for.
    """
    from synthgen.dataset import open_dataset
    from synthgen.dataset.records import Selection
    from synthgen.publish.subsetting import take

    named = [tag for tag in (tags or "").split(",") if tag]
    chosen = open_dataset(out, subset=subset, split=split, where=where, tags=named, tags_in=tags_in)
    asked = Selection(
        source="", where=where or "", subset=subset or "", split=split or "", tags=named
    )
    taken = take(chosen, target, asked)
    shots = console.count(taken.shots, "shot")
    subjects = console.count(taken.subjects, "subject")
    console.say(f"{taken.folder}: {shots} of {subjects}, {console.size(taken.copied)} copied")


def tags(
    out: Dataset,
    tags_in: TagsIn = None,
    take: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Take another person's file in; repeatable."),
    ] = None,
) -> None:
    """Show who tagged how many shots of a dataset, and in which files; merge those of others.

    Tags are given on the page of `synthgen browse`, and read by `--tags` and `open_dataset`.
    """
    from synthgen.dataset import tags as marks
    from synthgen.dataset.records import read_description

    info, place = read_description(out), tags_in or marks.tags_folder()
    for path in take or ():
        console.say(f"taken in: {marks.take(path, place, info)}")
    found = marks.read(place, info)
    for name in found.names():
        people = ", ".join(f"{person} {n}" for person, n in found.people(name).items())
        console.say(f"{name}: {console.count(len(found.shots(name)), 'shot')} ({people})")
    for path in marks.files(place, info):
        console.say(path)
    if not found.names():
        console.say(f"{out}: no shot is tagged")


def browse(
    out: Dataset,
    host: Annotated[
        str, typer.Option(help="Address to listen on; other than on loopback, a token is required.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 picks a free one.")] = 8350,
    cache: Annotated[
        int, typer.Option(min=0, metavar="MB", help="Megabytes of thumbnails to keep on disk.")
    ] = 256,
    open_: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in a browser.")
    ] = False,
    run: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="A run of `totalediting train` to show beside the truth."),
    ] = None,
    tags_in: TagsIn = None,
    person: Annotated[
        str | None,
        typer.Option("--as", metavar="NAME", help="Whose tags you give; default: your user name."),
    ] = None,
    read_only: Annotated[
        bool, typer.Option("--read-only", help="Show tags, and let nobody change them.")
    ] = False,
    public: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Read-only, for everybody, behind a proxy of this host."),
    ] = None,
) -> None:
    """Serve a dataset as a web page: search it, tag it, look at every pass, move the light."""
    from synthgen.browse.serve import serve
    from synthgen.dataset.tags import user

    def ready(address: str) -> None:
        if open_:
            import webbrowser

            webbrowser.open(address)

    name = None if read_only else person or user()
    serve(out, host, port, cache, console.say, ready, tags_in, name, public, run)
