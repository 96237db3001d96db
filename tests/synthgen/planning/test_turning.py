"""Plans ask for keys; panoramas are turned to them where their pixels are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets_procedural.conventions import panorama_files
from assets_procedural.light.pool import EnvironmentSettings
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import Plan
from synthgen.planning.turning import turned


def plan(**environments: float | tuple[float, float]) -> Plan:
    data = {
        "name": "keys",
        "subsets": {"many": {"kind": "multiview", "subjects": 400, "environments": 2, "views": 1}},
        "environments": environments,
    }
    return Plan(JobSpec.model_validate(data), ["a", "b", "c"])


def test_a_share_of_the_lights_has_a_key() -> None:
    keys = [key for subject in plan(key_light=0.6) for key in subject.keys]
    assert 0.55 < np.mean([key is not None for key in keys]) < 0.65
    assert all(key is None for subject in plan(key_light=0.0) for key in subject.keys)
    # All else is as it was: a key is drawn last.
    with_keys, without = (plan(key_light=share).subject("many", 3) for share in (1.0, 0.0))
    assert with_keys.environments == without.environments


def test_a_job_that_says_how_to_turn_means_it() -> None:
    assert EnvironmentSettings().key_light == 0.75
    old = EnvironmentSettings(rotation=(0.0, 360.0))
    assert old.key_light == 0.0
    assert EnvironmentSettings(rotation=(0.0, 90.0), key_light=0.5).key_light == 0.5
    for settings in (EnvironmentSettings(), old):
        assert EnvironmentSettings.model_validate(settings.model_dump()) == settings


def test_turning_gives_the_rotations_that_are_rendered(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name in "abc":
        light = rng.random((32, 64, 3)).astype(np.float32) ** 8
        panorama_files.write(tmp_path / f"{name}.exr", light, {})
    subject = plan(key_light=1.0).subject("many", 0)
    found = turned(subject, tmp_path)
    assert found == turned(subject, tmp_path) == turned(found, tmp_path)
    assert found.keys == ()
    for use, planned in zip(found.environments, subject.environments, strict=True):
        assert use.rotation != planned.rotation and 0 <= use.rotation <= 2 * np.pi
        assert use.model_copy(update={"rotation": planned.rotation}) == planned
    free = plan(key_light=0.0).subject("many", 0)
    assert turned(free, tmp_path / "nowhere").environments == free.environments
