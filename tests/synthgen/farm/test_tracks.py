"""Jobs whose people move as real people do: `poses.tracks`."""

from __future__ import annotations

import shutil
from pathlib import Path

import fake_renderer
import numpy as np
import pytest
from recorded_motions import write_motion

from synthgen.dataset import manifest, open_dataset
from synthgen.dataset.folder import StorageError
from synthgen.errors import JobError
from synthgen.farm import preflight
from synthgen.farm.local import render_job
from synthgen.planning.job import JobSpec, load_job
from synthgen.planning.plan import Plan
from synthgen.publish.publish import stored_plan
from synthgen.publish.verify import verify


def a_job(tracks: Path) -> JobSpec:
    subsets = {
        "multiview": {"kind": "multiview", "subjects": 1, "environments": 1, "views": 1},
        "video": {"kind": "video", "subjects": 2, "environments": 1, "frames": 3},
    }
    poses = {"tracks": str(tracks), "frames_per_second": 5.0}
    return fake_renderer.small_job(subsets=subsets, poses=poses)


@pytest.fixture
def tracks(tmp_path: Path) -> Path:
    (tmp_path / "tracks").mkdir()
    write_motion(tmp_path / "tracks" / "a.parquet")
    return tmp_path / "tracks"


def test_planned_frames_follow_the_track_and_say_so(tracks: Path):
    plan = Plan(a_job(tracks), ["city", "night", "studio"])
    subject = plan.subject("video", 1)
    assert subject.motion is not None and subject == plan.subject("video", 1)
    jaws = [pose.expression["jawOpen"] for pose in subject.poses]
    assert np.allclose(jaws, np.array(subject.motion.seconds) * 25 / 99, atol=0.02)
    assert np.allclose(np.diff(subject.motion.seconds), 0.2)
    assert subject.motion != plan.subject("video", 0).motion
    assert plan.subject("multiview", 0).motion is None


def test_a_dataset_keeps_what_it_takes_of_its_tracks(tracks: Path, tmp_path: Path):
    out, job = tmp_path / "out", a_job(tracks)
    assert render_job(job, out, workers=1, renderer=fake_renderer.RENDERER).complete
    rows = manifest.query(
        out, "SELECT kind, motion_table, motion_source, motion_seconds FROM manifest ORDER BY key"
    )
    moved = [row for row in rows.rows if row[0] == "video"]
    assert {row[1:3] for row in moved} == {("a.parquet", "clip.mp4")} and len(moved) == 6
    assert open_dataset(out, subset="video").read(0, ("meta",))["meta"]["motion"]["seconds"] >= 0
    shutil.rmtree(tracks)
    assert stored_plan(out).subject("video", 0).motion is not None
    assert not verify(out)


def test_other_tracks_than_it_was_begun_with_are_refused(tracks: Path, tmp_path: Path):
    out, job = tmp_path / "out", a_job(tracks)
    render_job(job, out, workers=1, limit=1, renderer=fake_renderer.RENDERER)
    write_motion(tracks / "a.parquet", frames=60)
    with pytest.raises(StorageError, match="not those that the dataset was begun with"):
        render_job(job, out, workers=1, renderer=fake_renderer.RENDERER)


def test_a_folder_is_found_beside_the_job_and_a_bad_one_is_one_line(tracks: Path, tmp_path: Path):
    job = tmp_path / "job.toml"
    job.write_text(
        'name = "a"\n[poses]\ntracks = "tracks"\n[environments]\nbundled = []\nskies = 1\n'
        '[subsets.v]\nkind = "video"\nsubjects = 1\nenvironments = 1\nframes = 2\n'
    )
    assert load_job(job).poses.tracks == tracks
    (tracks / "a.parquet").write_text("hello")
    with pytest.raises(JobError, match="no table of `totalediting track`") as error:
        preflight.make_plan(load_job(job), job)
    assert str(error.value).startswith(f"{job}: poses.tracks") and "\n" not in str(error.value)
