"""Reading a dataset: our own API, SQL, webdataset and Hugging Face datasets."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

import datasets
import datasets.config
import fake_renderer
import numpy as np
import pytest
from PIL import Image
from webdataset import WebDataset  # pyright: ignore[reportAttributeAccessIssue]

from synthgen.dataset import manifest, open_dataset
from synthgen.dataset.folder import StorageError
from synthgen.farm import rerender
from synthgen.pictures import shot_sheet
from synthgen.pictures.sheet import sheet
from synthgen.planning.plan import plan
from synthgen.publish import export

JOB = fake_renderer.small_job()


@pytest.fixture
def out(small_dataset: Path) -> Path:
    return small_dataset


def test_iterate_and_index(out: Path):
    dataset = open_dataset(out)
    assert len(dataset) == 5 * 2 + 3 * 2
    keys = [f"{shot.meta['subset']}/{shot.key}" for shot in dataset]
    assert keys == dataset.keys()
    assert len(set(keys)) == len(keys)
    assert dataset[-1].key == dataset[len(dataset) - 1].key
    with pytest.raises(IndexError):
        dataset[16]


def test_by_key(out: Path):
    dataset = open_dataset(out)
    shot = dataset["video/s000001_p01"]
    assert (shot.meta["subset"], shot.key, shot.rgb.shape) == (
        *("video", "s000001_p01"),
        (3, 48, 48, 3),
    )
    with pytest.raises(KeyError, match="ambiguous: say multiview/s000001_p01 or video/s"):
        dataset["s000001_p01"]
    with pytest.raises(KeyError, match="no shot s999999_p00"):
        dataset["s999999_p00"]
    assert open_dataset(out, subset="video")["s000001_p01"].meta == shot.meta


def test_what_is_read_is_what_was_rendered(out: Path):
    dataset = open_dataset(out, subset="multiview")
    subject = plan(JOB).subject("multiview", 3)
    for rendered in fake_renderer.render_subject(subject, JOB, out / "environments", "", 1).shots:
        stored = dataset[rendered.key]
        np.testing.assert_array_equal(stored.depth, rendered.depth)
        np.testing.assert_array_equal(stored.rgb, rendered.rgb)
        assert stored.meta == json.loads(json.dumps(rendered.meta))


def test_some_fields_only(out: Path):
    fields = open_dataset(out).read(0, ("depth", "parts", "rgb_01", "hdr_00", "meta"))
    assert list(fields) == ["depth", "parts", "rgb_01", "hdr_00", "meta"]
    assert fields["hdr_00"].shape == (48, 48, 4)


def test_subsets_splits_and_conditions(out: Path):
    whole = open_dataset(out)
    parts = [open_dataset(out, split=s) for s in ("train", "validation", "test")]
    assert sum(map(len, parts)) == len(whole)
    assert sorted(k for p in parts for k in p.keys()) == sorted(whole.keys())  # noqa: SIM118
    frontal = open_dataset(out, where="abs(camera_yaw) < radians(20)")
    assert 0 < len(frontal) < len(whole)
    assert all(abs(s.meta["camera"]["sample"]["yaw"]) < np.radians(20) for s in frontal)
    assert len(open_dataset(out, where="'moon' IN environments")) == 0
    for arguments, message in (
        ({"subset": "audio"}, "no subset audio; it has multiview, video"),
        ({"split": "dev"}, "must be train, validation or test"),
        ({"where": "colour = 'blue'"}, "where: Binder Error"),
    ):
        with pytest.raises(StorageError, match=message):
            open_dataset(out, **arguments)


def test_it_travels_to_other_processes(out: Path):
    dataset = pickle.loads(pickle.dumps(open_dataset(out)))
    assert dataset[2].depth.max() > 0


def test_environments(out: Path):
    dataset = open_dataset(out)
    panorama = dataset.environment("night")
    assert panorama.dtype == np.float32
    assert panorama.shape[1:] == (2 * panorama.shape[0], 3)
    with pytest.raises(KeyError):
        dataset.environment("moon")


def test_query(out: Path):
    result = manifest.query(
        out,
        "SELECT subset, count(DISTINCT subject) AS people, avg(person_age_years) AS age, "
        "max(expression_jawOpen) AS jaw, sum(cost_beauty) AS seconds "
        "FROM manifest GROUP BY subset ORDER BY subset",
    )
    assert result.column_names == ["subset", "people", "age", "jaw", "seconds"]
    assert [row["people"] for row in result.to_pylist()] == [5, 3]
    assert manifest.query(out, "SELECT count(*) FROM video").rows == [(6,)]
    lights = "bool_and(len(exposures) = len(environments) AND list_min(exposures) > 0)"
    assert manifest.query(out, f"SELECT {lights} FROM manifest").rows == [(True,)]
    with pytest.raises(StorageError, match=r"query: .*nonsense"):
        manifest.query(out, "SELECT nonsense FROM manifest")


def test_the_manifest_holds_every_attribute_of_a_person(out: Path):
    dataset = open_dataset(out)
    person = dataset.read(0, ("meta",))["meta"]["person"]
    columns = manifest.query(out, "SELECT * FROM manifest").column_names

    def check(prefix: str, value: dict):
        for name, item in value.items():
            if name == "phenotypes":
                assert {f"person_{n}" for n in item} <= set(columns)
            elif isinstance(item, dict) and f"{prefix}_{name}" not in columns:
                check(f"{prefix}_{name}", item)
            elif item is not None:
                assert f"{prefix}_{name}" in columns

    check("person", person)
    named = "person_sex, person_age_group, person_ancestry, person_hair_colour, person_beard_style"
    for row in manifest.query(out, f"SELECT {named} FROM manifest").rows:
        assert all(row)
    assert manifest.query(
        out, "SELECT bool_and(person_ancestry_mix[person_ancestry] >= 0.5) FROM manifest"
    ).rows == [(True,)]


def test_reading_needs_neither_blender_nor_torch(out: Path):
    code = (
        "import sys; from synthgen.dataset import open_dataset; "
        f"open_dataset({str(out)!r})[0]; "
        "bad = {'bpy', 'torch', 'anny'} & set(sys.modules); sys.exit(str(bad) if bad else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def structure(value: Any) -> Any:
    """The types in a JSON value; fails for what has none."""
    assert value is not None
    if isinstance(value, dict):
        return {name: structure(item) for name, item in value.items()}
    if isinstance(value, list):
        kinds = [structure(item) for item in value]
        assert kinds
        assert all(kind == kinds[0] for kind in kinds)
        return [kinds[0]]
    return type(value).__name__


def test_metadata_has_one_type_for_all_samples(out: Path):
    # Readers that infer a schema from the first samples rely on it.
    for subset in JOB.subsets:
        kinds = []
        for path in sorted((out / "data" / subset).glob("*.tar")):
            with tarfile.open(path) as archive:
                for member in archive:
                    if member.name.endswith(".meta.json"):
                        kinds.append(structure(json.load(archive.extractfile(member))))  # type: ignore[arg-type]
        assert all(kind == kinds[0] for kind in kinds)


def test_opens_with_webdataset(out: Path):
    urls = [str(p) for p in sorted((out / "data/multiview").glob("*.tar"))]
    samples = list(WebDataset(urls, shardshuffle=False).decode("rgb8"))
    assert len(samples) == 10
    assert samples[0]["rgb_00.png"].shape == (48, 48, 3)
    assert samples[0]["meta.json"]["key"] == samples[0]["__key__"].split("/")[-1]


def test_opens_with_hugging_face(out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(datasets.config, "HF_DATASETS_OFFLINE", True)
    files = {"train": [str(p) for p in sorted((out / "data/video").glob("train-*.tar"))]}
    loaded = datasets.load_dataset(
        "webdataset", data_files=files, split="train", cache_dir=str(tmp_path)
    )
    ours = open_dataset(out, subset="video", split="train")
    assert [str(key) for key in ours.index.key] == list(loaded["__key__"])
    np.testing.assert_array_equal(np.asarray(loaded[0]["rgb_02.png"]), ours[0].rgb[2])
    np.testing.assert_array_equal(np.asarray(loaded[0]["parts.png"]), ours[0].parts)
    np.testing.assert_allclose(
        loaded[0]["geometry.npz"]["landmarks"], ours[0].geometry["landmarks"]
    )
    assert loaded[0]["meta.json"]["exposures"] == ours[0].meta["exposures"]


def test_the_card_gives_hugging_face_subsets_and_splits(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(datasets.config, "HF_DATASETS_OFFLINE", True)
    for split in ("train", "validation"):
        loaded = datasets.load_dataset(str(out), "multiview", split=split, cache_dir=str(tmp_path))
        assert len(loaded) == len(open_dataset(out, subset="multiview", split=split)) > 0


def test_rerender_comes_out_the_same(out: Path):
    report = rerender.rerender(
        out, "s000002_p01", subset="multiview", renderer=fake_renderer.RENDERER
    )
    assert report.identical, str(report)
    assert str(report).startswith("multiview/s000002_p01: identical")
    with pytest.raises(StorageError, match="no shot"):
        rerender.rerender(out, "s999999_p00")


def test_rerender_says_why_it_failed(out: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TROUBLE", json.dumps({"s000002": "raise"}))
    with pytest.raises(StorageError, match=r"again failed: RuntimeError: no hair left$"):
        rerender.rerender(out, "video/s000002_p01", renderer=fake_renderer.RENDERER)


def test_rerender_reports_a_difference(out: Path):
    shot = open_dataset(out)[0]
    other = open_dataset(out)[0]
    other.depth = other.depth + np.float32(0.5)
    report = rerender.compare(shot, other)
    assert not report.identical
    assert report.fields["depth"].largest == pytest.approx(0.5)
    assert report.fields["normal"].share == 0
    assert "depth                      100.00% differ, at most 0.5" in str(report)


def test_export_to_nerfstudio(out: Path, tmp_path: Path):
    target = export.nerfstudio(out, tmp_path / "nerf")
    files = sorted(target.rglob("transforms.json"))
    assert len(files) == 5 * 2 + 3 * 3
    for path in files:
        transforms = json.loads(path.read_text())
        for frame in transforms["frames"]:
            for name in ("file_path", "mask_path", "depth_file_path"):
                assert (path.parent / frame[name]).exists()
            assert np.shape(frame["transform_matrix"]) == (4, 4)
            assert ("time" in frame) == ("video" in path.parts)
    with pytest.raises(StorageError, match="give a new folder"):
        export.nerfstudio(out, tmp_path / "nerf")


def test_exported_depth_unprojects_as_nerfstudio_reads_it(out: Path, tmp_path: Path):
    target = export.nerfstudio(out, tmp_path / "nerf")
    dataset = open_dataset(out, subset="multiview")
    shot = dataset[0]
    folder = target / "multiview" / shot.key.split("_")[0] / shot.meta["environments"][0]["id"]
    transforms = json.loads((folder / "transforms.json").read_text())
    assert "depth_unit_scale_factor" not in transforms  # its parser reads none
    frame = next(f for f in transforms["frames"] if shot.key in f["file_path"])
    with Image.open(folder / frame["depth_file_path"]) as image:
        assert image.mode.startswith("I;16")
        depth = np.asarray(image).astype(float) * 1e-3  # the default of nerfstudio's parser
    with Image.open(folder / frame["mask_path"]) as image:
        mask = np.asarray(image)
    assert set(np.unique(mask)) == {0, 255}
    # Pixel centres at +0.5, the camera looks along -z: planar depth.
    rows, columns = np.nonzero(mask)
    z = depth[rows, columns]
    x = (columns + 0.5 - frame["cx"]) / frame["fl_x"] * z
    y = -(rows + 0.5 - frame["cy"]) / frame["fl_y"] * z
    to_world = np.array(frame["transform_matrix"])
    points = np.stack([x, y, -z], -1) @ to_world[:3, :3].T + to_world[:3, 3]
    distance = np.linalg.norm(points - fake_renderer.CENTRE, axis=-1)
    assert np.abs(distance - fake_renderer.RADIUS).max() < 1e-3


def test_pictures(out: Path, tmp_path: Path):
    shown = shot_sheet.show(out, "s000001_p01", tmp_path / "show.png", subset="video")
    drawn = sheet(out, tmp_path / "sheet.png")
    for path in (shown, drawn):
        with Image.open(path) as image:
            assert image.width > 1000
            assert np.asarray(image).std() > 10
    with pytest.raises(StorageError, match="ambiguous"):
        shot_sheet.show(out, "s000001_p01", tmp_path / "no.png")
