"""Wrong command lines, jobs, places and datasets: each must end in one clear line.

    python benchmarks/torture_commands.py

Every case must end with exit code 2 and exactly one line on stderr, that is no traceback and names
what it is about, unless it says otherwise. Takes some minutes; renders with the tests' renderer
into a temporary folder and leaves nothing behind. Exits with 1 if a case fails.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import types
import typing
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import report
from pydantic import BaseModel

SUPPORT = Path(__file__).parents[1] / "tests" / "support"
sys.path.insert(0, str(SUPPORT))

import fake_renderer  # noqa: E402

from assets_procedural.conventions import console  # noqa: E402
from synthgen.cli import main as synthgen  # noqa: E402
from synthgen.dataset import open_dataset  # noqa: E402
from synthgen.dataset.folder import DatasetFolder  # noqa: E402
from synthgen.farm.local import render_job  # noqa: E402
from synthgen.planning.job import JobSpec  # noqa: E402
from totalediting.cli import main as totalediting  # noqa: E402

PROGRAMS = {"synthgen": synthgen, "totalediting": totalediting}
JOB = """name = "small"
seed = 3
resolution = 48
[subsets.multiview]
kind = "multiview"
subjects = 2
environments = 2
views = 2
[environments]
bundled = []
skies = 3
"""
FAKE = f"--renderer {fake_renderer.RENDERER}"


@dataclass
class Case:
    """A command line (program first), and what it must end with."""

    kind: str
    words: list[str]
    says: str = ""
    """Part of the line."""
    code: int = 2
    lines: int = 1
    environment: dict[str, str] = field(default_factory=dict)


def case(kind: str, line: str, says: str = "", **expected: Any) -> Case:
    """A case from a line as a shell takes it."""
    return Case(kind, shlex.split(line), says, **expected)


# ---------------------------------------------------------------- jobs


def leaves(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every setting of a job that is no table: its dotted key and its type."""
    for name, info in model.model_fields.items():
        kind = info.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from leaves(kind, f"{prefix}{name}.")
        elif name == "subsets":
            yield from leaves(typing.get_args(kind)[1], f"{prefix}subsets.multiview.")
        else:
            yield f"{prefix}{name}", kind


def wrong_values(kind: Any) -> list[str]:
    """Values that no setting of that type takes, as --set takes them."""
    parts = (
        typing.get_args(kind) if typing.get_origin(kind) in (types.UnionType, typing.Union) else ()
    )
    kinds = {kind, *parts}
    wrong = ["{ a = 1 }"]
    if not kinds & {str, Path}:
        wrong += ['"a text"', "nan", "[[1, 2], [3, 4]]", "1979-05-27"]
    if kinds & {int, float}:
        wrong += ["-1e300", "9" * 5000]
    if kinds & {str, Path}:
        wrong += ["[1, 2]", "12", r'"a\u0000b"']
    return wrong


def fields(place: Path) -> Iterator[Case]:
    """Every setting of a job with values that it does not take."""
    job = place / "job.toml"
    for key, kind in leaves(JobSpec):
        for value in wrong_values(kind):
            yield Case("a setting", ["synthgen", "plan", str(job), "--set", f"{key}={value}"], key)


def files(place: Path) -> Iterator[Case]:
    """Job files that are no jobs."""
    contents = {
        "nested": b"a = " + b"[" * 2000 + b"]" * 2000,
        "tables": b"a = " + b"{b=" * 2000 + b"1" + b"}" * 2000,
        "digits": JOB.replace("seed = 3", "seed = " + "7" * 5000).encode(),
        "hexadecimal": JOB.replace("seed = 3", "seed = 0x" + "7" * 5000).encode(),
        "large": JOB.replace("seed = 3", "seed = " + "7" * 30).encode(),
        "negative": JOB.replace("seed = 3", "seed = -1").encode(),
        "utf16": JOB.encode("utf-16"),
        "latin1": JOB.replace("small", "kl\xe4r").encode("latin-1"),
        "binary": bytes(range(256)) * 20,
        "null": JOB.replace("small", "sm\0all").encode(),
        "cut": JOB[:200].encode() + b"[environments",
        "twice": (JOB + "[environments]\nskies = 2\n").encode(),
        "empty": b"",
        "comment": b"# nothing\n",
        "json": json.dumps({"name": "small"}).encode(),
        "html": b"<!doctype html><html></html>",
        "no_such_user": JOB.replace("bundled", 'folder = "~nosuchuser/x"\nbundled').encode(),
        "no_folder": JOB.replace("bundled", 'folder = "nowhere"\nbundled').encode(),
        "file_as_folder": JOB.replace("bundled", 'folder = "job.toml"\nbundled').encode(),
        "null_folder": JOB.replace("bundled", 'folder = "a\\u0000b"\nbundled').encode(),
        "long_folder": JOB.replace("bundled", f'folder = "{"a" * 5000}"\nbundled').encode(),
        "date": JOB.replace("seed = 3", "seed = 2024-13-45").encode(),
        "no_subset": b'name = "a"\n',
        "empty_subsets": b'name = "a"\n[subsets]\n',
        "bad_subset": JOB.replace("subsets.multiview", 'subsets."../x"').encode(),
        "array_subset": JOB.replace("[subsets.multiview]", "[[subsets.multiview]]").encode(),
        "few_lights": JOB.replace("environments = 2", "environments = 90").encode(),
        "few_pictures": JOB.replace("skies = 3", "skies = 0").encode(),
        "frames": JOB.replace("views = 2", "frames = 2").encode(),
        "escape": JOB.replace('"small"', '"\\u001b[2J"').encode(),
    }
    folder = place / "jobs"
    folder.mkdir()
    for name, content in contents.items():
        path = folder / f"{name}.toml"
        path.write_bytes(content)
        yield Case("a job file", ["synthgen", "plan", str(path)])
    (folder / "folder.toml").mkdir()
    (folder / "circle.toml").symlink_to("circle.toml")
    wrong = ["folder.toml", "circle.toml", "absent.toml", "a" * 300 + ".toml", "nul\0.toml", "demp"]
    for name in [*wrong, "job.toml/x.toml", ".", ""]:
        yield Case("a job file", ["synthgen", "plan", str(folder / name) if "." in name else name])
    # A mark at the beginning is what editors of Windows write, and is no fault.
    (folder / "mark.toml").write_bytes(b"\xef\xbb\xbf" + JOB.encode())
    yield Case("a job file", ["synthgen", "plan", str(folder / "mark.toml")], code=0, lines=0)


def overrides(place: Path) -> Iterator[Case]:
    """What --set does not take."""
    wrong = ["samples", "=8", "a b=8", "samples=8\nseed=2", "seed.x=1", "subsets=", "typo=1"]
    wrong += ["environments.skeis=1", "samples=" + "[" * 2000, "samples=" + "9" * 5000]
    wrong += ["seed=0x" + "f" * 5000, "name=\udcff", "samples=8\0", "..=1", "name=" + "x" * 10_000]
    for text in wrong:
        yield Case("--set", ["synthgen", "plan", str(place / "job.toml"), "--set", text])


# ---------------------------------------------------------------- options and places


def options(place: Path) -> Iterator[Case]:
    """Command lines that are none."""
    job, out, data = place / "job.toml", place / "new", place / "data"
    wrong = [
        *("synthgen dance", "synthgen --loud", "synthgen render", f"synthgen render {job}"),
        f"synthgen render {job} --out",
        f"synthgen render {job} --out {out} extra",
        *(f"synthgen render {job} --out {out} --workers {n}" for n in ("0", "-1", "two", "1.5")),
        *(f"synthgen render {job} --out {out} --threads {n}" for n in ("0", "many")),
        *(f"synthgen render {job} --out {out} --limit {n}" for n in ("0", "none")),
        *(f"synthgen render {job} --out {out} --shard {n}" for n in ("0/0", "5/4", "1", "a/b", "")),
        *(f"synthgen render {job} --out {out} --time-limit {n}" for n in ("0", "nan", "soon")),
        f"synthgen render {job} --out {out} --device gpu",
        f"synthgen render {job} --out {out} --renderer nowhere",
        f"synthgen render {job} --out {out} --renderer nowhere:at_all",
        *(f"synthgen plan {job} --within {t}" for t in ("soon", "0h", "-1d", "1e9999d", "''")),
        f"synthgen plan {job} --like {place}",
        f"synthgen plan {job} --like {job}",
        f"synthgen query {data}",
        f"synthgen query {data} 'SELECT 1' --format xml",
        f"synthgen query {data} 'SELECT 1' --format parquet",
        f"synthgen export {data} --format obj",
        f"synthgen export {data} --split dev",
        f"synthgen export {data} --subset audio",
        f"synthgen export {data} --where nonsense",
        f"synthgen export {data} --where 'age > '",
        f"synthgen export {data} --where false",
        f"synthgen browse {data} --port 65536",
        f"synthgen browse {data} --port -1",
        f"synthgen browse {data} --host nowhere.invalid --port 0",
        f"synthgen browse {place} --port 0",
        "totalediting dance",
        "totalediting bake",
        f"totalediting bake {job} --out maps.exr --size many",
        f"totalediting bake {job} --out maps.exr --size 1",
        f"totalediting bake {job} --out maps.exr --albedo 1,2",
        f"totalediting bake {job} --out maps.exr --albedo nan,0,0",
        f"totalediting bake {job} --out maps.exr --ks 1",
        f"totalediting bake {job} --out maps.exr --kd -1",
        f"totalediting train dance {data} --out {out}",
        f"totalediting train tracker {data} --out {out} --preset huge",
        f"totalediting train tracker {data} --out {out} --steps 0",
        f"totalediting train tracker {data} --out {out} --learning-rate nan",
        f"totalediting train joint {data} --out {out} --real-share 2",
        f"totalediting train tracker {data} --out {out} --set nonsense",
        f"totalediting train tracker {data} --out {out} --set decoder=nonsense",
        f"totalediting train tracker {data} --out {out} --batch 3 --devices 2",
        f"totalediting evaluate {out} {data} --split dev",
    ]
    yield from (case("an option", line) for line in wrong)


def places(place: Path) -> Iterator[Case]:
    """Folders and files that are not what is wanted, or cannot be."""
    job, data, file = place / "job.toml", place / "data", place / "file"
    file.write_text("mine")
    folder = place / "folder"
    (folder / "full").mkdir(parents=True)
    (folder / "circle").symlink_to("circle")
    bytes_ = os.fsdecode(b"\xff\xfe")
    shutil.copytree(data, folder / bytes_)
    commands = {
        "status {}": 1,
        "verify {}": 1,
        "sheet {}": 1,
        "show {} s000000_p00": 1,
        "rerender {} s000000_p00": 1,
        "export {}": 1,
        "browse {} --port 0": 1,
        "query {} 'SELECT 1'": 1,
    }
    wrong: list[str] = ["nowhere", "", "a" * 300, str(file), str(folder), str(folder / "circle")]
    wrong += [str(file / "below"), "nul\0", str(folder / bytes_), "~nosuchuser", "[x]*?"]
    for words, name in itertools.product(commands, wrong):
        filled = [name if w == "{}" else w for w in shlex.split(words)]
        yield Case("no dataset", ["synthgen", *filled])
    picture, many = str(folder / "full"), "a" * 300
    for words in ("sheet {}", "show {} multiview/s000000_p00"):
        start = ["synthgen", *shlex.split(words.format(data))]
        for target in (picture, str(file / "x.png"), f"{many}.png", "/proc/x/y.png", "nul\0.png"):
            yield Case("an output", [*start, "--output", target])
    for target in (str(folder), str(file), str(file / "x"), many, "/proc/x/y", "nul\0"):
        yield Case("an output", ["synthgen", "export", str(data), "--output", target])
        select = ["synthgen", "query", str(data), "SELECT 1", "--output"]
        for ending in (
            (".csv", ".json", ".parquet") if target not in (str(file), str(folder)) else ()
        ):
            yield Case("an output", [*select, target + ending])
        if target not in (str(folder), many, "nul\0"):
            render = f"synthgen render {job} --out {target} --workers 1 {FAKE}"
            yield case("an output", render)
    yield Case("an output", [*select, str(folder)])
    for key in (
        "s9",
        "",
        "../s000000_p00",
        "audio/s000000_p00",
        "x/y/z",
        "multiview/",
        "\0",
        "[x]",
    ):
        for command in ("show", "rerender"):
            yield Case("a key", ["synthgen", command, str(data), key])
    for words in ("evaluate {} {}", "show {} {}"):
        for run, dataset in ((folder, data), (file, data), ("nowhere", data), (folder, file)):
            line = words.format(run, dataset)
            yield case("no run", f"totalediting {line}")
    for name in ("nowhere.exr", str(file), str(folder), f"{many}.exr"):
        yield case("no panorama", f"totalediting bake {name} --out {folder}/maps.exr")
    for target in ("maps.png", str(folder), str(file / "maps.exr"), "/nowhere/maps.exr", many):
        yield case("an output", f"totalediting bake {file} --out {target}")
    for stage in ("tracker", "reconstruct", "lightmaps"):
        for dataset in (file, folder, "nowhere"):
            yield case("no dataset", f"totalediting train {stage} {dataset} --out {folder}/run")


# ---------------------------------------------------------------- datasets, queries


def datasets(place: Path) -> Iterator[Case]:
    """Datasets with a file that is missing or damaged, through every command that reads it."""
    whole = place / "data"
    layout = DatasetFolder(whole)
    shot = open_dataset(whole, subset="multiview")
    # The last of its shard, since damage may be at the end.
    last = [i for i, shard in enumerate(shot.index.shard) if shard == shot.index.shard[0]][-1]
    key = str(shot.index.key[last])
    tar = Path(shot.index.shards[shot.index.shard[last]])
    table = layout.manifest("multiview").relative_to(whole)
    light = layout.environment(shot[last].meta["environments"][0]["id"]).relative_to(whole)
    about = Path("dataset.json")

    def cut(path: Path) -> None:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])

    def noise(path: Path) -> None:
        path.write_bytes(bytes(range(256)) * (path.stat().st_size // 256))

    def empty(path: Path) -> None:
        path.write_bytes(b"")

    def folder(path: Path) -> None:
        path.unlink()
        path.mkdir()

    ways: list[Callable[[Path], None]] = [cut, noise, empty, folder, Path.unlink]
    reading = {
        tar: ("show {} KEY", "rerender {} KEY", "sheet {}", "export {}"),
        table: ("show {} KEY", "sheet {}", "export {}", "query {} 'SELECT * FROM multiview'"),
        light: ("show {} KEY", "sheet {}"),
        about: (
            "show {} KEY",
            "sheet {}",
            "export {}",
            "status {}",
            "verify {}",
            "query {} 'SELECT 1'",
        ),
    }
    for (name, commands), way in itertools.product(reading.items(), ways):
        copy = place / f"damaged-{name.name}-{way.__name__}"
        shutil.copytree(whole, copy)
        way(copy / name)
        if name == table and way is Path.unlink:
            continue  # its parts are read instead
        for words in commands:
            line = words.replace("KEY", f"multiview/{key}").format(copy)
            yield case("a damaged dataset", f"synthgen {line}")


def queries(place: Path) -> Iterator[Case]:
    """What is no query."""
    wrong = [
        "",
        " ",
        "-- nothing",
        "SELECT",
        "SELECT nonsense FROM manifest",
        "DROP TABLE manifest",
    ]
    wrong += ["SELECT * FROM nowhere", "SELECT 1/", "(" * 3000, "SELECT 'x'::INTEGER"]
    wrong += [
        "SELECT * FROM read_parquet('/nowhere')",
        "\udcff",
        "SELECT " + "(" * 500 + "1" + ")" * 499,
    ]
    wrong += ["SELECT 1; SELECT", "SELECT repeat('x', 4000000000)"]
    for sql in wrong:
        yield Case("a query", ["synthgen", "query", str(place / "data"), sql])


# ---------------------------------------------------------------- processes


def processes(place: Path) -> Iterator[tuple[str, bool]]:
    """What only a process of its own can show: (what, whether it held)."""
    data, job = place / "data", place / "job.toml"
    python = f"{shlex.quote(sys.executable)} -c "

    def command(words: str, program: str = "synthgen") -> str:
        code = f"import sys; sys.argv[0] = '{program}'; from {program}.cli import main; main()"
        return f"{python}{shlex.quote(code)} {words}"

    def shell(line: str, **options: Any) -> subprocess.CompletedProcess[bytes]:
        return subprocess.run(
            ["bash", "-c", line], capture_output=True, check=False, timeout=600, **options
        )

    def one_line(done: subprocess.CompletedProcess[bytes]) -> bool:
        return done.returncode == 2 and done.stderr.count(b"\n") == 1 and b"error: " in done.stderr

    everything = shlex.quote("SELECT * FROM manifest, range(200)")
    for words in ("jobs", "--help", f"status {data}", f"query {data} {everything}", f"plan {job}"):
        done = shell(f"set -o pipefail; {command(words)} | head -0; echo ${{PIPESTATUS[0]}}")
        yield f"closed stdout: {words.split()[0]}", not done.stderr
        done = shell(f"{command(words)} >&-")
        yield f"no stdout: {words.split()[0]}", done.returncode == 0 and not done.stderr
        done = shell(f"{command(words)} > /dev/full")
        yield f"full stdout: {words.split()[0]}", one_line(done)
        done = shell(
            f"{command('status /nowhere')} 2>&-; {command(words)} > /dev/null 2> /dev/full"
        )
        yield f"full stderr: {words.split()[0]}", done.returncode == 0

    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))

    everybody = shlex.quote("SELECT * FROM manifest")
    for ending in ("csv", "json", "parquet"):
        words = f"query {data} {everybody} --output {place}/full.{ending}"
        done = shell(command(words), preexec_fn=small_files)
        yield f"full disk: query as {ending}", one_line(done)
    for words in (f"sheet {data}", f"show {data} multiview/s000000_p00", f"export {data}"):
        done = shell(command(f"{words} --output {place}/full"), preexec_fn=small_files)
        yield f"full disk: {words.split()[0]}", one_line(done)
    left = [path.name for path in place.iterdir() if "full" in path.name]
    yield f"full disk: nothing is left ({left})", not left
    endless = "SELECT count(*) FROM range(10000000000) a, range(1000) b WHERE a.range % 7 = b.range"
    for number in (signal.SIGINT, signal.SIGINT):
        started = subprocess.Popen(
            shlex.split(command(f"query {data} {shlex.quote(endless)}")),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        with contextlib.suppress(subprocess.TimeoutExpired):
            started.wait(3)
        started.send_signal(number)
        said = started.communicate(timeout=60)[1]
        yield "Ctrl-C in a query", (started.returncode, said) == (130, b"interrupted\n")
    for name, value in {"LANG": "C", "LC_ALL": "POSIX", "PYTHONIOENCODING": "ascii"}.items():
        done = shell(command("jobs"), env=os.environ | {name: value})
        yield f"{name}={value}", done.returncode == 0 and not done.stderr
    without = {k: v for k, v in os.environ.items() if k not in ("HOME", "SYNTHGEN_CACHE")}
    yield "no HOME", shell(command(f"plan {job}"), env=without).returncode == 0


# ---------------------------------------------------------------- running


def answer(words: list[str]) -> tuple[int | None, str, str]:
    """Exit code (None for a traceback), stdout and stderr of a command run in this process."""
    out, err = io.StringIO(), io.StringIO()
    before = sys.argv
    sys.argv = list(words)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            PROGRAMS[words[0]]()
        code: int | None = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    except BaseException as error:
        code = None
        err.write(f"{type(error).__name__}: {error}")
    finally:
        sys.argv = before
    return code, out.getvalue(), err.getvalue()


def held(tried: Case) -> str:
    """Nothing, or how a case failed."""
    code, _, err = answer(tried.words)
    lines = err.count("\n")
    if (code, lines) != (tried.code, tried.lines) or tried.says not in err:
        return f"exit code {code}, {lines} lines: {err[:300]!r}"
    return ""


@contextlib.contextmanager
def heard() -> Iterator[Callable[[], str]]:
    """What libraries print to file descriptor 2, which Python's redirection does not see."""
    with tempfile.TemporaryFile() as file:
        terminal = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lambda: os.pread(file.fileno(), 300, 0).decode(errors="replace")
        finally:
            os.dup2(terminal, 2)
            os.close(terminal)


def main() -> None:
    """Run all cases and print how many of each kind held."""
    # A shell lets background jobs ignore it, and processes inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.update(NO_COLOR="1", COLUMNS="200")
    console.FIRST_LINE = 600.0  # how far work is would be lines as well
    failures: list[str] = []
    counts: dict[str, list[int]] = {}

    def note(kind: str, what: str, failure: str) -> None:
        counts.setdefault(kind, [0, 0])[0] += 1
        if failure:
            counts[kind][1] += 1
            failures.append(
                f"{kind}: {what[:200]}: {failure}".encode("ascii", "backslashreplace").decode()
            )

    with tempfile.TemporaryDirectory(prefix="synthgen-torture-") as name, contextlib.chdir(name):
        place = Path(name)
        os.environ["SYNTHGEN_CACHE"] = str(place / "cache")
        (place / "job.toml").write_text(JOB)
        render_job(
            fake_renderer.small_job(), place / "data", workers=1, renderer=fake_renderer.RENDERER
        )
        with heard() as chatter:
            for make in (fields, files, overrides, options, places, datasets, queries):
                for tried in make(place):
                    shown = shlex.join(tried.words[:2]) + " …" + tried.words[-1][:80]
                    note(tried.kind, shown, held(tried))
            note("libraries", "what they print in all of these", chatter())
        for what, well in processes(place):
            note("a process", what, "" if well else "did not")
    total = [sum(column) for column in zip(*counts.values(), strict=True)]
    rows = [(kind, tried, failed) for kind, (tried, failed) in counts.items()]
    report.table(("wrong", "cases", "not one clear line"), [*rows, ("all", *total)])
    print("\n".join(failures))
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
