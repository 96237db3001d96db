"""The wheel by itself: installed into fresh environments and used from outside the repository.

    python tests/packaging/wheel.py

Blender's environment renders a small dataset; environments without Blender, on Python 3.11 with
numpy 1 and 2 and on the newest Python that is at hand by name, read it. Prints what each weighs.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[2]
BLENDER = "python3.11"
NEWER = ("python3.12", "python3.13", "python3.14")
SMALL = {
    "resolution": 64,
    "samples": 2,
    "subsets.multiview.subjects": 1,
    "subsets.video.subjects": 1,
}
"""What of the job demo is made smaller."""
READ = """
import sys
from synthgen import open_dataset

dataset = open_dataset(sys.argv[1])
for shot in dataset:
    assert shot.rgb.shape[1:] == (64, 64, 3), shot.rgb.shape
    assert shot.albedo.shape == shot.normal.shape == (64, 64, 3)
    assert shot.depth.shape == (64, 64)
    for environment in shot.meta["environments"]:
        assert dataset.environment(environment["id"]).ndim == 3
print(len(dataset), "shots")
heavy = {"bpy", "torch", "scipy", "trimesh", "colour", "OpenImageIO"} & set(sys.modules)
assert not heavy, heavy
"""


@dataclass
class Environment:
    """A fresh virtual environment with nothing but the wheel and what it asks for."""

    name: str
    folder: Path
    seconds: float
    """How long it took to make."""

    def run(self, program: str, *arguments: str | Path) -> str:
        """Run a program of the environment outside the repository; its output, or the end."""
        command = [self.folder / "bin" / program, *map(str, arguments)]
        print(
            f"  {self.name}$ {program} {' '.join(map(str, arguments))}".splitlines()[0], flush=True
        )
        return _run(command, cwd=self.folder)

    def version(self, distribution: str) -> str:
        code = f"import importlib.metadata as m; print(m.version({distribution!r}))"
        return self.run("python", "-c", code).strip()

    def megabytes(self) -> float:
        files = (path for path in self.folder.rglob("*") if path.is_file())
        return sum(path.lstat().st_size for path in files) / 1e6


def main() -> None:
    """Build, install, use, weigh."""
    for python in (BLENDER, *NEWER):
        print(f"{python}: {'at hand' if _at_hand(python) else 'not at hand'}")
    made: list[Environment] = []
    with tempfile.TemporaryDirectory(prefix="wheel-") as temporary:
        folder = Path(temporary)
        wheel = build(folder)
        dataset = folder / "demo"

        render = install(folder / "render", BLENDER, f"{wheel}[render]")
        small = [f"--set={key}={value}" for key, value in SMALL.items()]
        render.run("synthgen", "render", "demo", "--out", dataset, *small)
        made.append(render)

        newest = [python for python in NEWER if _at_hand(python)][-1:]
        made.append(install(folder / "core-numpy1", BLENDER, wheel, "numpy<2"))
        made.append(install(folder / "core-numpy2", BLENDER, wheel, "numpy>=2"))
        made += [install(folder / f"core-{python}", python, wheel) for python in newest]
        for environment in made:
            use(environment, dataset)

        browse = install(folder / "browse", BLENDER, f"{wheel}[browse]")
        with served(browse, dataset) as address:
            for path in ("", "assets/main.js", "api/dataset"):
                with urllib.request.urlopen(address + path) as answer:
                    assert answer.status == 200
        made.append(browse)
        report(made)


def build(folder: Path) -> Path:
    """The wheel, made of the source distribution that is made of what git knows."""
    source = folder / "source"
    listed = _run(["git", "ls-files", "-z", "-co", "--exclude-standard"], cwd=ROOT).split("\0")
    for file in filter(None, listed):
        if (ROOT / file).is_file():
            (source / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / file, source / file)
    _run([sys.executable, "-m", "build", "--outdir", folder / "dist", source], cwd=folder)
    (wheel,) = (folder / "dist").glob("*.whl")
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB")
    return wheel


def install(folder: Path, python: str, *requirements: str | Path) -> Environment:
    start = time.monotonic()
    _run([python, "-m", "venv", folder], cwd=folder.parent)
    pip = [folder / "bin" / "pip", "install", "--quiet", "--disable-pip-version-check"]
    _run([*pip, *requirements], cwd=folder)
    return Environment(folder.name, folder, time.monotonic() - start)


def use(environment: Environment, dataset: Path) -> None:
    """What a reader and a planner do."""
    assert environment.run("synthgen", "--version").strip().endswith("0.2.0")
    assert "render" in environment.run("python", "-m", "synthgen", "--help")
    assert "paper" in environment.run("synthgen", "jobs")
    assert "60" in environment.run("synthgen", "plan", "demo")
    environment.run("synthgen", "status", dataset)
    environment.run("synthgen", "verify", dataset)
    query = "SELECT count(*) FROM multiview"
    assert "3" in environment.run("synthgen", "query", dataset, query)
    environment.run("synthgen", "sheet", dataset, "--output", environment.folder / "sheet.png")
    export = environment.folder / "export"
    environment.run("synthgen", "export", dataset, "--format", "nerfstudio", "--output", export)
    environment.run("python", "-c", READ, dataset)


@contextmanager
def served(environment: Environment, dataset: Path) -> Iterator[str]:
    """The address of the page of `synthgen browse`."""
    command = [environment.folder / "bin" / "synthgen", "browse", dataset, "--port", "0"]
    process = subprocess.Popen(
        command, cwd=environment.folder, env=_outside(), stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = re.search(r"http://\S+", line)
        assert address is not None, line
        yield address[0].rstrip("/") + "/"
    finally:
        process.terminate()
        process.wait(timeout=30)


def report(made: list[Environment]) -> None:
    table = Table("environment", "Python", "numpy", "made in", "size")
    for environment in made:
        table.add_row(
            environment.name,
            environment.run("python", "-V").split()[1],
            environment.version("numpy"),
            f"{environment.seconds:.0f} s",
            f"{environment.megabytes():.0f} MB",
        )
    Console().print(table)


def _at_hand(python: str) -> bool:
    try:
        return subprocess.run([python, "-V"], capture_output=True).returncode == 0
    except FileNotFoundError:
        return False


def _outside() -> dict[str, str]:
    names = ("PYTHONPATH", "VIRTUAL_ENV")
    return {key: value for key, value in os.environ.items() if key not in names}


def _run(command: list[str | Path], cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, env=_outside(), capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    main()
