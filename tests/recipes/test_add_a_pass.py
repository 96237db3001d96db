"""The recipe "Add a pass" of CONTRIBUTING.md, followed to the letter in a copy of the package."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
HEADING = "Add a pass"

SCRIPT = """
import dataclasses, json, sys
from pathlib import Path

import fake_renderer
import numpy as np
from starlette.testclient import TestClient

from synthgen.browse.app import create
from synthgen.browse.folder import Folder
from synthgen.browse.table.snapshot import Library
from synthgen.browse.shot.thumbnails import Thumbnails
from synthgen.dataset import open_dataset
from synthgen.dataset.gate import inspect
from synthgen.farm.local import render_job
from synthgen.farm.rerender import rerender
from synthgen.pictures.drawing import pictures
from synthgen.pictures.shot_sheet import show
from synthgen.publish.verify import verify


def main():
    out = Path(sys.argv[1])
    job = fake_renderer.small_job()
    summary = render_job(job, out, workers=1, renderer=fake_renderer.RENDERER)
    shot = open_dataset(out)[0]
    position, mask = shot.position, shot.parts > 0
    address = f"{shot.meta['subset']}/{shot.key}"
    ask = TestClient(create(Library(Folder(out)), Thumbnails(out.parent / "cache"), None, 0))
    ask.base_url = "http://localhost"
    values = ask.get(f"/values/{address}/position")
    spoilt = dataclasses.replace(shot, passes=shot.passes | {"position": np.ones_like(position)})
    short = dataclasses.replace(shot, passes=shot.passes | {"position": position[1:]})
    print(json.dumps({
        "complete": summary.complete,
        "format": open_dataset(out).description.format,
        "shape": position.shape,
        "type": position.dtype.name,
        "on the surface": bool((position[mask] == 1).all()),
        "read alone": list(open_dataset(out).read(0, ("position",))),
        "gate": [inspect(each)[0] for each in (shot, spoilt, short)],
        "verify": verify(out),
        "pictures": list(pictures(shot)),
        "shown": show(out, address, out.parent / "shot.png").exists(),
        "identical": rerender(out, address, renderer=fake_renderer.RENDERER).identical,
        "page": [p for p in ask.get("/api/dataset").json()["passes"] if p["name"] == "position"],
        "of the shot": [ask.get(f"/api/shot/{address}").json()[k] for k in ("passes", "values")],
        "picture": ask.get(f"/pass/{address}/position").headers["content-type"],
        "values": values.content == position.tobytes(),
    }))


if __name__ == "__main__":
    main()
"""

BLENDER = """
import json, sys
from pathlib import Path

import fake_renderer
import numpy as np

from synthgen.dataset import open_dataset
from synthgen.dataset.shot import camera_of
from synthgen.farm.local import render_job


def main():
    one = {"kind": "multiview", "subjects": 1, "environments": 1, "views": 1}
    job = fake_renderer.small_job(
        subsets={"multiview": one}, samples=2, resolution=64, environments={"bundled": ["city"]},
        people={"hair_styles": ["buzz"]},  # at 64 pixels long hair has no slope for the gate
    )
    out = Path(sys.argv[1])
    assert render_job(job, out, workers=1).complete
    shot = open_dataset(out)[0]
    camera, mask = camera_of(shot.meta), shot.parts > 0
    truth = camera.unproject(camera.pixel_centres(), shot.depth)
    print(json.dumps(float(np.abs(truth - shot.position)[mask].max())))


if __name__ == "__main__":
    main()
"""


def blocks() -> list[str]:
    """The recipe's code, in order."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    section = text.split(f"## {HEADING}\n")[1].split("\n## ")[0]
    return re.findall(r"^```\w+\n(.*?)^```$", section, re.M | re.S)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of `synthgen` in which the recipe was followed."""
    folder = tmp_path_factory.mktemp("recipe")
    shutil.copytree(ROOT / "synthgen", folder / "synthgen")
    entry, socket, number, _ = blocks()

    path = folder / "synthgen" / "dataset" / "passes.py"
    lines = path.read_text().splitlines(keepends=True)
    (end,) = (
        node.end_lineno
        for node in ast.parse("".join(lines)).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "PASSES"
    )
    assert end is not None and lines[end - 1] == ")\n"
    element = textwrap.indent(entry.rstrip(), " " * 4) + ",\n"
    path.write_text("".join([*lines[: end - 1], element, *lines[end - 1 :]]))

    path = folder / "synthgen" / "stage" / "shading.py"
    text, count = re.subn(
        r'( +)\("texture", .*\n', rf"\g<0>\1{socket.rstrip()},\n", path.read_text()
    )
    assert count == 1
    path.write_text(text)

    path = folder / "synthgen" / "dataset" / "records.py"
    text = path.read_text()
    for line in number.splitlines():
        name = line.split(" = ")[0]
        text, count = re.subn(rf"^{name} = .*$", line, text, flags=re.M)
        assert count == 1
    path.write_text(text)
    return folder


def run(workshop: Path, name: str, script: str) -> Any:
    """What a script prints as JSON, which imports the copy and gets a folder to fill."""
    path = workshop / f"{name}.py"
    path.write_text(script)
    command = [sys.executable, str(path), str(workshop / name / "out")]
    return json.loads(printed(workshop, command).splitlines()[-1])


def printed(workshop: Path, command: list[str]) -> str:
    """What a command prints that imports the copy."""
    paths = [workshop, ROOT, ROOT / "tests" / "support"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))}
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=300, cwd=workshop
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_entry_alone_brings_a_pass_everywhere(workshop: Path):
    found = run(workshop, "everywhere", SCRIPT)
    assert found["complete"] and found["format"] == 3
    assert (found["shape"], found["type"]) == ([48, 48, 3], "float32")
    assert found["on the surface"] and found["read alone"] == ["position"]
    sound, spoilt, short = found["gate"]
    assert sound == [] and spoilt == ["position is not 0 in the background"]
    assert short == ["position is float32 (47, 48, 3), not float32 (48, 48, 3)"]
    assert found["verify"] == []
    assert "position" in found["pictures"] and found["shown"]
    assert found["identical"]
    (entry,) = found["page"]
    assert entry["label"] == "Position" and entry["axes"] == ["x", "y", "z"]
    assert entry["unit"] == "m" and not entry["lit"]
    assert all("position" in names for names in found["of the shot"])
    assert found["picture"] == "image/png" and found["values"]


def test_the_table_of_the_docs_is_printed_with_it(workshop: Path):
    command = blocks()[-1].replace("python", sys.executable, 1)
    rows = printed(workshop, ["sh", "-c", command])
    assert "; `position.X/Y/Z`, float, world space, metres |" in rows


@pytest.mark.blender
def test_blender_renders_it(workshop: Path):
    assert run(workshop, "rendered", BLENDER) < 1e-4
