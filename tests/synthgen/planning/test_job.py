"""Bad input gets one line that names file, field, value and remedy, before anything is rendered."""

from __future__ import annotations

import errno
import importlib.util
import os
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fake_renderer
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from assets_procedural.conventions.panorama_reading import PanoramaError
from synthgen.dataset.folder import DatasetFolder
from synthgen.errors import JobError
from synthgen.farm import preflight
from synthgen.farm.isolated import IsolatedError
from synthgen.farm.local import render_job
from synthgen.planning.job import JobSpec, load_job
from synthgen.planning.plan import subject_key

JOBS = Path(__file__).parents[3] / "render_jobs"
GOOD = """
name = "test"
[subsets.multiview]
kind = "multiview"
subjects = 2
environments = 2
views = 3
[environments]
bundled = []
skies = 3
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "job.toml"
    path.write_text(text, encoding="utf-8")
    return path


def message(path: Path, *overrides: str) -> str:
    """The line that a job gets, less the path of its folder."""
    with pytest.raises(JobError) as caught:
        preflight.make_plan(load_job(path, overrides), path)
    text = str(caught.value)
    assert "\n" not in text
    return text.replace(f"{path.parent}/", "")


def test_good_job_and_defaults(tmp_path: Path) -> None:
    job = load_job(write(tmp_path, GOOD))
    assert job.seed == 0
    assert job.subsets["multiview"].shots == 3
    assert JobSpec.model_validate_json(job.model_dump_json()) == job


@pytest.mark.parametrize("path", sorted(JOBS.glob("*.toml")), ids=lambda p: p.stem)
def test_shipped_jobs_are_valid(path: Path) -> None:
    assert load_job(path).name == path.stem


# --set, and the message that follows "job.toml: " or "--set: "
BAD_VALUES = [
    ("smaples=8", 'smaples = 8: unknown key; did you mean "samples"?'),
    ("camera.zoom=2", "camera.zoom = 2: unknown key; known are focal_mm, yaw, pitch, roll, fill,"),
    ("people.ancestry.asain=1", 'no ancestry is called "asain"; choose from african, east_african'),
    ("subsets.multiview.veiws=3", 'unknown key; did you mean "views"?'),
    ("poses.expresion=1", 'unknown key; did you mean "expression"?'),
    ("subsets.multiview.subjects=-1", "subsets.multiview.subjects = -1: give at least 1"),
    ("subsets.multiview.views=0", "subsets.multiview.views = 0: give at least 1"),
    ("subsets.multiview.environments=101", "environments = 101: give at most 100"),
    ("subsets.multiview.views=2.5", "subsets.multiview.views = 2.5: give a whole number"),
    ('samples="8"', 'samples = "8": give a whole number'),
    ("samples=true", "samples = true: give a whole number"),
    ("samples=1", "samples = 1: give at least 2"),
    ("resolution=16", "resolution = 16: give at least 32"),
    ("resolution=10000", "resolution = 10000: give at most 4096"),
    ("seed=-1", "seed = -1: give at least 0"),
    ("seed=1.5", "seed = 1.5: give a whole number"),
    ("name=a b", 'name = "a b": use letters, digits, - and _, 64 at most'),
    ("shard_megabytes=0", "shard_megabytes = 0: give at least 1"),
    ("subsets.multiview.frames=4", 'kind = "multiview" has no frames; remove it'),
    ("subsets.multiview.kind=vdeo", 'kind = "vdeo": did you mean "video"? choose'),
    ("subsets.multiview=3", "subsets.multiview = 3: give a table of settings"),
    ("subsets.Other={}", "subsets.Other"),
    *(
        (
            f"subsets.{name}={{kind='video', subjects=1, environments=1, frames=1}}",
            f'"{name}" is no subset name: it has another meaning in a dataset',
        )
        for name in ("manifest", "failed", "runs", "logs", "locks")
    ),
    ("subsets={}", "subsets = {}: a job needs at least one subset"),
    ("camera=3", "camera = 3: give a table of settings"),
    ("camera.yaw=[60, -60]", "camera.yaw = [60, -60]: [60, -60] must be [low, high]"),
    ("camera.yaw=[-200, 0]", "must lie within [-180, 180] degrees"),
    ("camera.yaw=[1, 2, 3]", "camera.yaw = [1, 2, 3]: give two numbers, [low, high]"),
    ("camera.yaw=[1]", "camera.yaw = [1]: give two numbers, [low, high]"),
    ("camera.yaw=10", "camera.yaw = 10: give two numbers, [low, high]"),
    ('camera.yaw=["a", 1]', 'camera.yaw.0 = "a": give a number'),
    ("camera.fill=[0, 1]", "camera.fill = [0, 1]: [0, 1] must lie within [0.05, 1.5]"),
    ("people.glasses=1.2", "people.glasses = 1.2: give at most 1"),
    ("people.hat=-0.1", "people.hat = -0.1: give at least 0"),
    ('people.hair_styles=["mohawk"]', 'people.hair_styles.0 = "mohawk": choose'),
    ("people.hair_styles=[]", "at least one style"),
    ("people.age=[40, 20]", "people.age = [40, 20]: [40, 20] must be [low, high]"),
    ("poses.expression=nan", "poses.expression = NaN: give a finite number"),
    ("poses.expression=high", 'poses.expression = "high": give a number'),
    ("image.background=grey", 'image.background = "grey": give "environment", "transparent"'),
    ("image.background=#12", 'image.background = "#12": give "environment", "transparent"'),
    ("image.linear=1", "image.linear = 1: give true or false"),
    ('environments.bundled=["citi"]', 'environments.bundled.0 = "citi": did you mean "city"?'),
    ("environments.bundled=some", 'environments.bundled = "some": choose "all" or a list'),
    ('environments.bundled=["city", "city"]', "names a panorama twice"),
    ("environments.skies=0", "environments: no environment: set bundled, folder, skies or studios"),
    ("environments.folder=3", 'environments.folder = 3: give a text in "quotes"'),
    ("environments.exposure=[-20, 0]", "must lie within [-4, 4] stops"),
    (
        "camera.focal_mm=[10, 50]",
        "camera: focal_mm = 10 with fill = 0.6 puts the camera 0.12 m from the head, not 0.3 to 30;"
        " raise focal_mm or lower fill",
    ),
    (
        "camera={focal_mm=[300, 800], fill=[0.1, 0.5]}",
        "focal_mm = 800 with fill = 0.1 puts the camera 56 m from the head, not 0.3 to 30;"
        " lower focal_mm or raise fill",
    ),
    (
        "camera={focal_mm=[200, 200], fill=[0.5, 1.4]}",
        "camera: fill = 1.4 with shift = 0.03 puts landmarks 0.98 of the frame from its middle,"
        " more than 0.75; lower fill or shift",
    ),
    ("camera.shift=[-0.4, 0]", "camera: fill = 0.6 with shift = 0.4 puts landmarks 0.82"),
    ("people.age=[2, 20]", "[2, 20] must lie within [3, 95] years"),
    ("people.quotas={beard={full=0.9}}", "people.quotas.beard.full = 0.9: at most 0."),
    ("people.quotas={age_group={child=0.1}}", "age_group.child = 0.1: at most 0.00 of these"),
    ("people.quotas={hat={fez=0.1}}", 'hat has no value "fez"; choose from none, worn'),
    ("people.weights={hat={worn=-1}}", "people.weights.hat.worn = -1: give at least 0"),
    ("subsets.multiview.people_of=other", 'people_of = "other" is no other subset with people of'),
    ("subsets.multiview.people_of=multiview", 'people_of = "multiview" is no other subset'),
    (
        "subsets.video={kind='video', subjects=3, environments=1, frames=1, people_of='multiview'}",
        'video.people_of = "multiview" has 2 subjects, fewer than 3; lower video.subjects',
    ),
    ("subsets.multiview.moods=['smile']", 'kind = "multiview" has no moods; remove them'),
    ("splits={validation=0.6, test=0.6}", "splits: validation + test exceed 1; lower one"),
    ("subsets.multiview.environments=5", "environments = 5: the pool has only 3; lower it, or add"),
    ("samples", "--set: samples: write key=value, for example --set samples=8"),
    ("=3", "--set: =3: write key=value"),
    ("samples=" + "[" * 2000, "give a whole number"),
    ("samples=" + "9" * 5000, "give a whole number"),
    ("seed=0x" + "f" * 5000, "--set: a number is too long, or a value is nested too deeply"),
    ("seed.x=3", '--set: seed.x = 3: "seed" is a value, not a table'),
]


@pytest.mark.parametrize(("override", "expected"), BAD_VALUES, ids=[b[0][:60] for b in BAD_VALUES])
def test_bad_values(tmp_path: Path, override: str, expected: str) -> None:
    text = GOOD.replace('name = "test"\n', 'name = "test"\nseed = 1\n')
    assert expected in message(write(tmp_path, text), override)


def test_message_names_where_the_value_was_given(tmp_path: Path) -> None:
    assert message(write(tmp_path, GOOD), "samples=0") == "--set: samples = 0: give at least 2"
    bad = write(tmp_path, "samples = 0\n" + GOOD)
    assert message(bad) == "job.toml: samples = 0: give at least 2"


BAD_FILES = [
    (GOOD.replace('name = "test"\n', ""), "job.toml: name: is missing; add it"),
    (GOOD.replace("subjects = 2\n", ""), "job.toml: subsets.multiview.subjects: is missing; add"),
    (GOOD.replace("views = 3\n", ""), 'subsets.multiview: kind = "multiview" needs views; add it'),
    ('name = "empty"', "job.toml: subsets: is missing; add it"),
    ("name = \n", "job.toml: is not valid TOML: Invalid value (at line 1, column 8)"),
    (GOOD + "[environments]\n", "job.toml: is not valid TOML: Cannot declare ('environments',)"),
    ("a = " + "[" * 2000 + "]" * 2000, "is not valid TOML: brackets are nested too deeply"),
    ("a = " + "{b = " * 2000 + "1" + "}" * 2000, "is not valid TOML: brackets are nested too deep"),
    ("seed = " + "7" * 5000 + GOOD, "job.toml: is not valid TOML: a number is too long"),
    ("seed = 0x" + "7" * 5000 + GOOD, "job.toml: a number is too long, or a value is nested"),
    (
        GOOD.replace("skies = 3", 'folder = "~nosuchuser/x"'),
        'environments.folder = "~nosuchuser/x": there is no such user; give the',
    ),
    (
        GOOD.replace("skies = 3", r'folder = "a\u0000b"'),
        r'environments.folder = "a\u0000b": holds a null byte; give another',
    ),
]


@pytest.mark.parametrize(("text", "expected"), BAD_FILES, ids=[b[1][:40] for b in BAD_FILES])
def test_bad_files(tmp_path: Path, text: str, expected: str) -> None:
    assert expected in message(write(tmp_path, text))


def test_missing_file_suggests_a_near_one(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    assert message(tmp_path / "jbo.toml").startswith("jbo.toml: no such job file: did you mean")


def test_the_mark_of_windows_editors_is_no_fault(tmp_path: Path) -> None:
    assert load_job(write(tmp_path, "\ufeff" + GOOD)).name == "test"


def test_binary_file(tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    path.write_bytes(b"\xff\xfe\x00")
    assert "job.toml: cannot be read as text" in message(path)


# --- panoramas ------------------------------------------------------------------------------


def panorama(path: Path, shape: tuple[int, int] = (8, 16), value: float = 2.0) -> None:
    pixels = np.full((*shape, 3), value, np.float32)
    pixels[0, 0] = 30.0
    if np.isnan(value):
        pixels[1:] = 1.0
        pixels[2, 2] = np.nan
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": pixels}).write(str(path))


def folder_message(tmp_path: Path) -> str:
    """What a job gets whose environments are the folder "hdris" beside it."""
    path = write(tmp_path, GOOD.replace("skies = 3", 'folder = "hdris"'))
    with pytest.raises(JobError) as caught:
        _, specs = preflight.make_plan(load_job(path, ["subsets.multiview.environments=1"]), path)
        for spec in specs:
            preflight.check_panorama(spec, path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f'{path}: environments.folder = "{tmp_path}/hdris')
    return text


def test_folder_is_found_beside_the_job(tmp_path: Path) -> None:
    (tmp_path / "hdris").mkdir()
    panorama(tmp_path / "hdris" / "yard.exr")
    path = write(tmp_path, GOOD.replace("skies = 3", 'folder = "hdris"'))
    job = load_job(path, ["subsets.multiview.environments=1"])
    assert job.environments.folder == tmp_path / "hdris"
    the_plan, specs = preflight.make_plan(job, path)
    assert the_plan.environment_ids == ("user_yard",)
    preflight.check_panorama(specs[0], path)


def test_missing_folder(tmp_path: Path) -> None:
    assert "no such folder" in folder_message(tmp_path)


def test_folder_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "hdris").write_text("")
    assert "no such folder" in folder_message(tmp_path)


def test_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "hdris").mkdir()
    assert "holds no .exr or .hdr panorama" in folder_message(tmp_path)


def test_folder_of_ldr_images(tmp_path: Path) -> None:
    (tmp_path / "hdris").mkdir()
    Image.new("RGB", (16, 8)).save(tmp_path / "hdris" / "photo.jpg")
    assert "photo.jpg is low dynamic range" in folder_message(tmp_path)


def test_ldr_image_renamed_to_exr(tmp_path: Path) -> None:
    (tmp_path / "hdris").mkdir()
    Image.new("RGB", (16, 8)).save(tmp_path / "photo.png")
    shutil.move(tmp_path / "photo.png", tmp_path / "hdris" / "photo.exr")
    assert "photo.exr" in folder_message(tmp_path)


def test_broken_panorama(tmp_path: Path) -> None:
    (tmp_path / "hdris").mkdir()
    path = tmp_path / "hdris" / "cut.exr"
    panorama(path, (64, 128))
    path.write_bytes(path.read_bytes()[:-100])
    assert "cut.exr" in folder_message(tmp_path)


def test_wrongly_shaped_panorama(tmp_path: Path) -> None:
    (tmp_path / "hdris").mkdir()
    panorama(tmp_path / "hdris" / "square.exr", (16, 16))
    assert "is 16 x 16" in folder_message(tmp_path)


def test_panorama_with_nan(tmp_path: Path) -> None:
    (tmp_path / "hdris").mkdir()
    panorama(tmp_path / "hdris" / "hole.exr", value=float("nan"))
    assert "NaN" in folder_message(tmp_path)


# --- output, disk, device, slices -----------------------------------------------------------


def output_message(out: Path) -> str:
    with pytest.raises(JobError) as caught:
        preflight.check_output(out)
    return str(caught.value)


def test_output_may_be_new_or_there(tmp_path: Path) -> None:
    preflight.check_output(tmp_path)
    preflight.check_output(tmp_path / "a" / "b")


def test_output_is_a_file(tmp_path: Path) -> None:
    out = write(tmp_path, "")
    assert output_message(out) == f"--out: {out}: it is a file; give another folder"
    assert f"{out} is a file" in output_message(out / "below")


def test_output_not_writable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Not by chmod: whoever runs the tests as root may write everywhere.
    monkeypatch.setattr(preflight.os, "access", lambda path, mode: False)
    assert f"{tmp_path} is not writable" in output_message(tmp_path / "new")


def test_too_little_disk(tmp_path: Path) -> None:
    job = load_job(write(tmp_path, GOOD))
    preflight.check_disk(tmp_path, job)
    huge = load_job(JOBS / "paper.toml", ["resolution=4096", "subsets.multiview.views=1000"])
    with pytest.raises(JobError, match=r"too little disk: about .* GB needed, .* GB free"):
        preflight.check_disk(tmp_path / "new", huge)


def needed(out: Path, job: JobSpec, **options: Any) -> float:
    """What `check_disk` asks for on a full disk, in GB; 0 if nothing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(preflight.shutil, "disk_usage", lambda path: SimpleNamespace(free=0))
        try:
            preflight.check_disk(out, job, **options)
        except JobError as error:
            return float(re.search(r"about (\S+) GB", str(error))[1])  # type: ignore[index]
    return 0.0


def test_disk_for_a_slice_counts_what_is_missing_of_it(tmp_path: Path) -> None:
    multiview = "subsets.multiview={kind='multiview', subjects=8, environments=2, views=1000}"
    job = load_job(write(tmp_path, GOOD), [multiview, "resolution=4096", "shard_subjects=2"])
    out = tmp_path / "out"
    whole = needed(out, job)
    assert whole > 1000
    assert needed(out, job, slice_=(1, 1)) == whole
    assert needed(out, job, limit=2) == needed(out, job, slice_=(1, 1), limit=2)
    assert needed(out, job, limit=2) == pytest.approx(whole / 4, abs=0.2)
    halves = [needed(out, job, slice_=(i, 2)) for i in (1, 2)]
    assert sum(halves) == pytest.approx(whole, abs=0.2)
    # A subject of the first slice is done: the second slice needs no less for it.
    shards = preflight.make_plan(job, "")[0].shards("multiview")
    key = subject_key(shards[0].subjects[0])
    done = DatasetFolder(out).subject("multiview", key).waiting_rows
    done.parent.mkdir(parents=True)
    done.touch()
    assert needed(out, job, slice_=(1, 2)) == pytest.approx(halves[0] - whole / 8, abs=0.2)
    assert needed(out, job, slice_=(2, 2)) == halves[1]


def refuse(path: object) -> None:
    raise PermissionError(errno.EACCES, "Permission denied", str(path))


def test_output_below_a_folder_that_may_not_be_entered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stat = os.stat
    monkeypatch.setattr(
        preflight.os,
        "stat",
        lambda p, **o: refuse(p) if "shut" in Path(p).parts[:-1] else stat(p, **o),
    )
    monkeypatch.setattr(preflight.os, "access", lambda path, mode: path.name != "shut")
    (tmp_path / "shut").mkdir()
    assert f"{tmp_path / 'shut'} is not writable" in output_message(tmp_path / "shut" / "out")


def test_unreadable_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "hdris").mkdir()
    monkeypatch.setattr(Path, "iterdir", refuse)
    assert "cannot be read (Permission denied); change its rights" in folder_message(tmp_path)


def test_a_device_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    preflight.check_device("cpu")

    def nothing_found(*_: object, **__: object) -> None:
        raise IsolatedError("RuntimeError: no cuda device was found; use --device cpu")

    monkeypatch.setattr(preflight, "isolated", nothing_found)
    with pytest.raises(JobError, match=r"^--device: cuda: no cuda device was found; use --device"):
        preflight.check_device("cuda")


def test_without_blender_a_plan_is_made_and_rendering_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *of: None if name == "bpy" else find(name, *of)
    )
    job = load_job("demo")
    the_plan, _ = preflight.make_plan(job, "demo")
    assert the_plan.environment_ids[:2] == ("city", "courtyard")
    with pytest.raises(ModuleNotFoundError) as missing:
        render_job(job, tmp_path / "out")
    assert missing.value.name == "bpy"
    with pytest.raises(PanoramaError, match=r"pip install 'totalediting\[render\]'"):
        render_job(job, tmp_path / "out", renderer=fake_renderer.RENDERER)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["3", "0/4", "5/4", "1/0", "a/b", "-1/4", "1/4/2"])
def test_bad_slices(text: str) -> None:
    with pytest.raises(JobError, match=r"--shard: .*1/4 to 4/4"):
        preflight.parse_shard(text)


def test_slices_and_durations() -> None:
    assert preflight.parse_shard("2/10") == (2, 10)
    assert [preflight.parse_duration(t) for t in ("90m", "12h", "7d", "2w")] == [1.5, 12, 168, 336]
    for text in ("7", "d", "0d", "-1d", "7y"):
        with pytest.raises(JobError, match=r"--within: .*: write a time such as 12h, 7d or 2w"):
            preflight.parse_duration(text)
