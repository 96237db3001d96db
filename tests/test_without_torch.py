"""Rendering, planning, reading and browsing need neither torch nor Anny."""

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
from assets_procedural.people.person_sampling import PeopleSettings, sample_person

person = sample_person(np.random.default_rng(0), PeopleSettings())
assert pieces(person, HeadModel.load().identity(person))
print(*imported)
"""


def test_all_that_rendering_takes_works_without_torch_and_anny():
    done = subprocess.run([sys.executable, "-c", _CODE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    imported = set(done.stdout.split())
    assert {"synthgen.cli", "synthgen.farm.worker", "synthgen.planning.plan"} <= imported
