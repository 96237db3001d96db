"""The command `synthgen`. Imports nothing heavy before a command runs: `--help` must be quick."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from assets_procedural.conventions import console
from assets_procedural.conventions.command_line import run
from synthgen.farm import DEFAULT_RENDERER

if TYPE_CHECKING:
    from assets_procedural.light.pool import EnvironmentSpec

app = typer.Typer(
    help="Render portrait datasets of synthetic people, with exact labels, under many lights.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Job = Annotated[Path, typer.Argument(metavar="JOB.toml", help="A job file; see render_jobs/.")]
Dataset = Annotated[Path, typer.Argument(metavar="DIR", help="A dataset's folder.")]
Key = Annotated[str, typer.Argument(metavar="KEY", help="A shot: [multiview/]s000003_p01.")]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the job; repeatable."),
]
Device = Annotated[str, typer.Option(help="cpu, cuda, optix, hip or metal.")]
Threads = Annotated[int, typer.Option(min=1, help="Threads of each worker.")]
Subset = Annotated[
    str | None, typer.Option(help="The subset, where a key occurs in more than one.")
]
Renderer = Annotated[str, typer.Option(hidden=True)]


def main() -> None:
    """Entry point: `app()`, with errors of the user's making as one line and exit code 2."""
    run(app)


@app.command()
def plan(
    job: Job,
    overrides: Overrides = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Measure this machine first (some minutes, kept).")
    ] = False,
    within: Annotated[
        str | None, typer.Option(metavar="TIME", help="Deadline such as 12h, 7d or 2w.")
    ] = None,
    device: Device = "cpu",
    threads: Threads = 1,
    renderer: Renderer = DEFAULT_RENDERER,
) -> None:
    """Say what a job amounts to: subjects, shots, frames, bytes, core-hours, machines."""
    from synthgen.farm import calibration, preflight
    from synthgen.farm.estimate import estimate, report
    from synthgen.planning.job import load_job

    spec = load_job(job, overrides or ())
    hours = None if within is None else preflight.parse_duration(within)
    the_plan, _ = preflight.make_plan(spec, job)
    if calibrate:
        from synthgen.farm.measure import measure

        preflight.check_device(device)
        with console.progress() as progress:
            task = progress.add_task("measuring this machine", total=None)

            def advance(done: int, total: int) -> None:
                progress.update(task, completed=done, total=total)

            calibration.save(measure(the_plan, renderer, device, threads, advance))
    report(estimate(the_plan, device, threads, renderer), hours, console.stdout())


@app.command()
def render(
    job: Job,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where the dataset goes.")],
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Processes; default: cores / threads, or 1 on a GPU."),
    ] = None,
    threads: Threads = 1,
    device: Device = "cpu",
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Render the I-th of N slices, 1/N to N/N.")
    ] = "1/1",
    limit: Annotated[
        int | None, typer.Option(min=1, help="Render at most that many subjects now.")
    ] = None,
    overrides: Overrides = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try subjects again that were given up.")
    ] = False,
    time_limit: Annotated[
        float | None,
        typer.Option(
            min=1.0, metavar="SECONDS", help="A subject's; default: by far more than it needs."
        ),
    ] = None,
    renderer: Renderer = DEFAULT_RENDERER,
) -> None:
    """Render a job. Running the same command again resumes."""
    from synthgen.farm import preflight
    from synthgen.farm.local import render_job
    from synthgen.planning.job import load_job

    slice_ = preflight.parse_shard(shard)
    spec = load_job(job, overrides or ())
    _, environments = preflight.make_plan(spec, job)
    preflight.check_output(out)
    preflight.check_disk(out, spec, slice_, limit)
    preflight.check_device(device)
    _check_panoramas(environments, out, job)
    if workers is None and device != "cpu":
        workers = 1
    summary = render_job(
        spec,
        out,
        workers=workers,
        threads=threads,
        device=device,
        shard=slice_,
        limit=limit,
        renderer=renderer,
        retry_failed=retry_failed,
        time_limit=time_limit,
    )
    screen = console.stdout()
    done = f"{summary.rendered} subjects, {summary.frames} frames"
    took = console.duration(summary.seconds)
    screen.print(f"{done} in {took}" + ("; the dataset is complete" if summary.complete else ""))
    for entry in summary.failed:
        reason = f"{entry.reason} ({entry.log})"
        screen.print(console.escape(f"failed: {entry.subset}/{entry.key}: {reason}"))
    if summary.failed:
        raise typer.Exit(1)


@app.command()
def status(out: Dataset) -> None:
    """Say what is done, running and failed; works while rendering."""
    from rich.table import Table

    from synthgen.dataset import ledger

    state = ledger.status(out)
    screen = console.stdout()
    table = Table(title=f"{state.name} in {out}", title_justify="left")
    table.add_column("subset")
    for column in ("subjects", "done", "given up", "shards", "size"):
        table.add_column(column, justify="right")
    for s in state.subsets:
        counts = [f"{n:,}" for n in (s.subjects, s.done, s.failed, s.shards)]
        table.add_row(s.name, *counts, console.size(s.bytes))
    screen.print(table)
    done, total = state.frames
    line = f"{done:,} of {total:,} frames"
    if state.frames_per_second:
        line += f", {state.frames_per_second * 3600:,.0f} frames per hour"
        line += f" by {state.workers} workers"
    if state.seconds_left is not None:
        line += f", {console.duration(state.seconds_left)} left"
    screen.print(line + ("; complete" if state.complete else ""))
    for entry in state.running:
        screen.print(f"running: {entry.subset}/{entry.key} for {console.duration(entry.seconds)}")
    for entry in state.failures:
        tries = f"{entry.attempts} attempts"
        screen.print(console.escape(f"failed: {entry.subset}/{entry.key}, {tries}: {entry.reason}"))


@app.command()
def verify(out: Dataset) -> None:
    """Check every shard against every promise; exit code 1 and a list if anything is off."""
    from synthgen.publish.verify import verify as check

    problems = check(out)
    screen = console.stdout()
    for problem in problems:
        screen.print(console.escape(problem), soft_wrap=True)
    if problems:
        screen.print(f"{len(problems)} problem{'s' if len(problems) > 1 else ''} in {out}")
        raise typer.Exit(1)
    screen.print(f"{out}: everything is as promised")


@app.command()
def show(
    out: Dataset,
    key: Key,
    subset: Subset = None,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="PNG", help="Default: DIR-KEY.png.")
    ] = None,
) -> None:
    """Draw one shot with all its passes and environments; prints the picture's path."""
    from synthgen.pictures import shot_sheet

    target = output or _beside(out, f"-{key.replace('/', '-')}.png")
    typer.echo(shot_sheet.show(out, key, target, subset=subset))


@app.command()
def sheet(
    out: Dataset,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="FILE", help=".png or .jpg; default DIR.png.")
    ] = None,
    portraits: Annotated[
        bool, typer.Option("--portraits", help="One picture of each of ten people, nothing else.")
    ] = False,
) -> None:
    """Draw a contact sheet of a dataset; prints the picture's path."""
    from synthgen.pictures import sheet as drawing

    draw = drawing.portraits if portraits else drawing.sheet
    typer.echo(draw(out, output or _beside(out, ".png")))


@app.command()
def rerender(
    out: Dataset,
    key: Key,
    subset: Subset = None,
    device: Device = "cpu",
    threads: Threads = 1,
) -> None:
    """Render one shot again from what the dataset records, and report the difference."""
    from synthgen.farm import preflight
    from synthgen.farm.rerender import rerender as again

    preflight.check_device(device)
    with console.stderr().status(f"rendering {key} again"):
        report = again(out, key, subset=subset, device=device, threads=threads)
    typer.echo(report)


@app.command()
def query(
    out: Dataset,
    sql: Annotated[str, typer.Argument(metavar="SQL", help='"SELECT … FROM manifest".')],
) -> None:
    """Ask the manifest in SQL (DuckDB)."""
    from rich.table import Table

    from synthgen.dataset import manifest

    found = manifest.query(out, sql)
    table = Table(*[str(c) for c in found.column_names])
    for row in found.rows:
        table.add_row(*[console.escape(str(value)) for value in row])
    console.stdout().print(table)


@app.command()
def export(
    out: Dataset,
    target: Annotated[
        Path | None, typer.Option("--output", metavar="DIR", help="Default: DIR-nerfstudio.")
    ] = None,
    format_: Annotated[str, typer.Option("--format", help="nerfstudio.")] = "nerfstudio",
) -> None:
    """Write a dataset for another tool: a transforms.json per subject and environment."""
    from synthgen.errors import JobError
    from synthgen.publish.export import nerfstudio

    if format_ != "nerfstudio":
        raise JobError("--format", "", format_, "choose nerfstudio")
    destination = target or _beside(out, "-nerfstudio")
    typer.echo(nerfstudio(out, destination))


@app.command()
def browse(
    out: Dataset,
    host: Annotated[
        str, typer.Option(help="Where to listen; elsewhere than on loopback a token is asked for.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one.")] = 8350,
    cache: Annotated[
        int, typer.Option(min=0, metavar="MB", help="Megabytes that thumbnails may take.")
    ] = 256,
    open_: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in the browser.")
    ] = False,
) -> None:
    """Open a dataset as a web page: search it, look at every pass, move the light."""
    from synthgen.errors import JobError

    try:
        from synthgen.browse.serve import serve
    except ModuleNotFoundError as error:
        remedy = f"needs {error.name}; pip install 'synthgen[browse]'"
        raise JobError("synthgen browse", "", "", remedy) from None

    def ready(address: str) -> None:
        if open_:
            import webbrowser

            webbrowser.open(address)

    serve(out, host, port, cache, typer.echo, ready)


def _beside(out: Path, ending: str) -> Path:
    folder = out if out.name not in ("", "..") else out.resolve()
    return folder.with_name(folder.name + ending)


def _check_panoramas(environments: list[EnvironmentSpec], out: Path, file: Path) -> None:
    """Read the user's own panoramas, those apart that the dataset holds already."""
    from synthgen.dataset.folder import DatasetFolder
    from synthgen.farm import preflight

    folder = DatasetFolder(out)
    unseen = [e for e in environments if e.kind == "file" and not folder.environment(e.id).exists()]
    with console.progress() as progress:
        for environment in progress.track(unseen, description="reading panoramas"):
            preflight.check_panorama(environment, file)
