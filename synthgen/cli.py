"""The command `synthgen`. Imports nothing heavy before a command runs: `--help` must be quick."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import synthgen
from assets_procedural.conventions import console
from assets_procedural.conventions.command_line import add_version, run
from synthgen import viewing_commands
from synthgen.command_options import Dataset, Device, Threads
from synthgen.farm import DEFAULT_RENDERER

if TYPE_CHECKING:
    from synthgen.farm.state import Summary
    from synthgen.planning.plan import Plan

app = typer.Typer(
    help="Render portrait datasets of synthetic people, with exact labels, under many lights.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)

Job = Annotated[
    str, typer.Argument(metavar="JOB", help="A job file (.toml), or a name of `synthgen jobs`.")
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the job; repeatable."),
]
Renderer = Annotated[str, typer.Option(hidden=True)]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, with the keys listed above.")]


def main() -> None:
    """Entry point: `app()`, with errors of the user's making as one line and exit code 2."""
    run(app)


add_version(app, f"synthgen {synthgen.__version__}")


@app.command()
def jobs() -> None:
    """List the jobs that come with the package, for `plan` and `render` to take by name."""
    from rich.table import Table

    from synthgen.planning.job import load_job
    from synthgen.planning.shipped_jobs import purpose, shipped_jobs

    table = Table(box=None, pad_edge=False)
    table.add_column("job", no_wrap=True)
    for column in ("people", "frames"):
        table.add_column(column, justify="right")
    table.add_column("what for")
    for name, file in shipped_jobs().items():
        spec = load_job(file)
        frames = sum(s.subjects * s.shots * s.environments for s in spec.subsets.values())
        table.add_row(name, f"{spec.different_people:,}", f"{frames:,}", purpose(file))
    console.stdout().print(table)


@app.command()
def plan(
    job: Job,
    overrides: Overrides = None,
    within: Annotated[
        str | None, typer.Option(metavar="TIME", help="Deadline such as 12h, 7d or 2w.")
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Estimate from what this dataset took to render."),
    ] = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Measure this machine first (takes minutes; kept).")
    ] = False,
    device: Device = "cpu",
    threads: Threads = 1,
    population: Annotated[
        bool, typer.Option("--population", help="Count the people instead: shares of each value.")
    ] = False,
    people: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="With --population: draw so many people.")
    ] = 2000,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="With --population: draw the shares too, .png or .jpg."),
    ] = None,
    as_json: AsJson = False,
    renderer: Renderer = DEFAULT_RENDERER,
) -> None:
    """Estimate a job: subjects, shots, frames, bytes, core-hours, machines.

    Hours come from the dataset given by --like, or else from a calibration of this machine, from
    what was rendered on it before, or from reference figures; the answer says which.

    JSON: name, resolution, samples, environments, device, threads, processes, subsets (name, kind,
    subjects, shots, frames, bytes, process_hours, costs: source, exact, dataset, measured),
    subjects, shots, frames, bytes, process_hours, elapsed_hours, within_hours, machines. source is
    named, calibration, rendered or reference. With --population: subset, people, marginals
    (attribute to drawn and asked: value to share).
    """
    from synthgen.farm import calibration, estimate, preflight
    from synthgen.planning.job import load_job

    spec = load_job(job, overrides or ())
    hours = None if within is None else preflight.parse_duration(within)
    the_plan, _ = preflight.make_plan(spec, job)
    if population or plot is not None:
        _show_population(the_plan, people, plot, as_json)
        return
    if calibrate:
        from synthgen.farm.measure import measure

        preflight.check_device(device)
        with console.progress("measuring this machine") as advance:
            calibration.save(measure(the_plan, renderer, device, threads, advance))
    named = []
    if like is not None:
        from synthgen.farm.recorded import recorded_costs

        named = recorded_costs(like, device, threads)
    result = estimate.estimate(the_plan, device, threads, renderer, named)
    if as_json:
        _print_json(estimate.as_json(result, hours))
    else:
        estimate.report(result, hours, console.stdout())


def _show_population(the_plan: Plan, people: int, plot: Path | None, as_json: bool) -> None:
    from synthgen.pictures import population_plot
    from synthgen.planning.population import as_json as in_json
    from synthgen.planning.population import population

    with console.progress("drawing people"):
        counted = population(the_plan, people)
    if plot is not None:
        console.stderr().print(f"{population_plot.plot(counted, plot)}")
    if as_json:
        _print_json(in_json(counted))
    else:
        population_plot.report(counted, console.stdout())


@app.command()
def render(
    job: Job,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder to fill.")],
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Number of processes; default: cores / threads, 1 on a GPU."),
    ] = None,
    threads: Threads = 1,
    device: Device = "cpu",
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Render slice I of N only, 1/N to N/N.")
    ] = "1/1",
    limit: Annotated[
        int | None, typer.Option(min=1, help="Render at most this many subjects now.")
    ] = None,
    overrides: Overrides = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Retry subjects that were given up.")
    ] = False,
    time_limit: Annotated[
        float | None,
        typer.Option(
            min=1.0, metavar="SECONDS", help="Per subject; default: several times its need."
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
    preflight.check_panoramas(environments, out, job)
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
    _report(summary, out, device, threads)


@app.command()
def extend(
    out: Dataset,
    job: Job,
    workers: Annotated[int | None, typer.Option(min=1, help="As `render` has it.")] = None,
    threads: Threads = 1,
    device: Device = "cpu",
    overrides: Overrides = None,
    renderer: Renderer = DEFAULT_RENDERER,
) -> None:
    """Add to a complete dataset what a larger job has: more subjects, more subsets.

    What is there is not rendered again. Only the version of the code that made it may do this.
    """
    from synthgen.farm import preflight
    from synthgen.farm.local import extend_job
    from synthgen.planning.job import load_job

    spec = load_job(job, overrides or ())
    _, environments = preflight.make_plan(spec, job)
    preflight.check_device(device)
    preflight.check_panoramas(environments, out, job)
    if workers is None and device != "cpu":
        workers = 1
    summary = extend_job(
        spec, out, workers=workers, threads=threads, device=device, renderer=renderer
    )
    _report(summary, out, device, threads)


def _report(summary: Summary, out: Path, device: Device, threads: int) -> None:
    """Say what a run did; exits with 1 if subjects failed."""
    if summary.rendered:
        from synthgen.farm.recorded import remember_costs

        remember_costs(out, device, threads)
    screen = console.stdout()
    done = f"{console.count(summary.rendered, 'subject')}, {console.count(summary.frames, 'frame')}"
    took = console.duration(summary.seconds)
    for line in summary.mended:
        screen.print(line, soft_wrap=True)
    screen.print(f"{done} in {took}" + ("; the dataset is complete" if summary.complete else ""))
    for entry in summary.failed:
        reason = f"{entry.reason} ({entry.log})"
        screen.print(f"failed: {entry.subset}/{entry.key}: {reason}")
    if summary.failed:
        raise typer.Exit(1)


@app.command()
def status(out: Dataset, as_json: AsJson = False) -> None:
    """Show what is done, running and failed; works while rendering.

    JSON: name, complete, frames, frames_done, workers, frames_per_second, seconds_left (both null
    while nothing runs), subsets (name, subjects, done, failed, shards, bytes, frames_per_subject),
    running (subset, key, seconds), failures (subset, key, attempts, reason, log).
    """
    from synthgen.dataset import ledger, status_report

    state = ledger.status(out)
    if as_json:
        _print_json(status_report.as_json(state))
    else:
        status_report.report(state, out, console.stdout())


@app.command()
def verify(
    out: Dataset,
    repair: Annotated[
        bool, typer.Option("--repair", help="Make again what is damaged or missing, then check.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(min=1, help="With --repair: as `render` has it.")
    ] = None,
    threads: Threads = 1,
    device: Device = "cpu",
    renderer: Renderer = DEFAULT_RENDERER,
) -> None:
    """Check every file of a dataset; prints what is wrong and exits with 1 if anything is.

    With --repair, exactly what is damaged or missing is rendered or written again, by the version
    of the code that made the dataset. Files that the dataset does not have are left alone.
    """
    from synthgen.dataset.folder import StorageError
    from synthgen.publish.verify import verify as check

    screen = console.stdout()

    def show(lines: list[str]) -> None:
        for line in lines:
            screen.print(line, soft_wrap=True)

    try:
        problems = check(out)
    except StorageError as error:
        if not repair:
            raise
        problems = [str(error)]
    show(problems)
    if repair and problems:
        from synthgen.farm import preflight
        from synthgen.farm.repair import repair as mend

        preflight.check_device(device)
        summary = mend(out, workers, threads, device, renderer)
        show([f"repaired: {line}" for line in summary.mended])
        screen.print(f"{console.count(summary.rendered, 'subject')} rendered again; checking")
        problems = check(out)
        show(problems)
    if problems:
        screen.print(f"{console.count(len(problems), 'problem')} in {out}")
        raise typer.Exit(1)
    screen.print(f"{out}: all checks passed")


viewing_commands.add_to(app)


def _print_json(answer: dict[str, Any]) -> None:
    import json

    # Escaped in ASCII: a terminal obeys more characters than JSON escapes otherwise.
    typer.echo(json.dumps(answer, indent=1))
