"""Rendering, planning and browsing need neither torch nor Anny; the core, not even scipy."""

from __future__ import annotations

import subprocess
import sys

_CODE = """
import importlib, pkgutil, sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "anny", "warp"):
            raise ModuleNotFoundError(f"{name} is not to be imported", name=name)

sys.meta_path.insert(0, Absent())
import assets_procedural, synthgen

optional, imported = {"bpy", "mathutils", "ray", "starlette", "uvicorn"}, set()
for package in (assets_procedural, synthgen):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        try:
            importlib.import_module(module.name)
            imported.add(module.name)
        except ModuleNotFoundError as error:
            if error.name not in optional:
                raise

import numpy as np
from assets_procedural.assembly import pieces
from assets_procedural.body.head import HeadModel
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.people.person_sampling import sample_person

person = sample_person(np.random.default_rng(0), PeopleSettings())
assert pieces(person, HeadModel.load().identity(person))
print(*imported)
"""


def test_all_that_rendering_takes_works_without_torch_and_anny():
    done = subprocess.run([sys.executable, "-c", _CODE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    imported = set(done.stdout.split())
    assert {"synthgen.cli", "synthgen.farm.worker", "synthgen.planning.plan"} <= imported


_CORE = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("scipy", "torch", "trimesh", "colour", "OpenImageIO"):
            raise ModuleNotFoundError(f"{name} is not to be imported", name=name)

sys.meta_path.insert(0, Absent())
from synthgen import open_dataset
from synthgen.cli import app
from typer.testing import CliRunner

done = CliRunner().invoke(app, ["plan", "demo"])
assert done.exit_code == 0, repr(done.exception)
"""


def test_planning_and_reading_work_with_the_core_dependencies_alone():
    done = subprocess.run([sys.executable, "-c", _CORE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + done.stdout
