"""Plan arithmetic and seeds: nothing depends on how much else is planned, or in which order."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from synthgen.errors import JobError
from synthgen.planning.job import JobSpec, SubsetSpec, load_job
from synthgen.planning.plan import (
    SPLITS,
    Plan,
    SubjectPlan,
    plan,
    subject_bytes,
    subjects_per_shard,
)

JOBS = Path(__file__).parents[3] / "render_jobs"
POOL = [f"light_{i}" for i in range(12)]


def make(seed: int = 0, pool: list[str] = POOL, **counts: int) -> Plan:
    subsets = {
        "multiview": SubsetSpec(
            kind="multiview",
            subjects=counts.get("subjects", 40),
            environments=counts.get("environments", 2),
            views=counts.get("views", 3),
        ),
        "video": SubsetSpec(
            kind="video",
            subjects=counts.get("videos", 10),
            environments=3,
            frames=counts.get("frames", 4),
        ),
    }
    return Plan(JobSpec(name="test", seed=seed, subsets=subsets), pool)


def test_paper_is_two_million_frames() -> None:
    the_plan = plan(load_job(JOBS / "paper.toml"))
    assert the_plan.frames == 2_000_000
    assert the_plan.shots == 600_000
    assert len(the_plan) == 60_000


def test_demo_is_small_and_mixes_lights() -> None:
    the_plan = plan(load_job(JOBS / "demo.toml"))
    assert the_plan.frames == 6 * 2 * 3 + 2 * 3 * 4
    assert sum(s.frames for s in the_plan) == the_plan.frames
    bundled = {"city", "courtyard", "interior", "sunset"}
    assert bundled < set(the_plan.environment_ids)


def test_any_subject_in_constant_time() -> None:
    the_plan = plan(load_job(JOBS / "paper.toml"))
    the_plan.subject("multiview", 0)
    start = time.process_time()
    last = the_plan.subject("multiview", 49_999)
    assert time.process_time() - start < 0.25
    assert last.key == "s049999"
    with pytest.raises(IndexError, match="multiview has subjects 0 to 49999, not 50000"):
        the_plan.subject("multiview", 50_000)
    with pytest.raises(IndexError):
        the_plan.subject("multiview", -1)
    with pytest.raises(KeyError):
        the_plan.subject("other", 0)


def test_kinds() -> None:
    multiview = make().subject("multiview", 7)
    assert [(s.key, s.pose, s.camera) for s in multiview.shots] == [
        ("s000007_p00", 0, 0),
        ("s000007_p01", 0, 1),
        ("s000007_p02", 0, 2),
    ]
    assert (len(multiview.poses), len(multiview.cameras), multiview.frames) == (1, 3, 6)
    video = make().subject("video", 7)
    assert [(s.pose, s.camera) for s in video.shots] == [(0, 0), (1, 0), (2, 0), (3, 0)]
    assert (len(video.poses), len(video.cameras), video.frames) == (4, 1, 12)


def test_subject_goes_through_json_without_loss() -> None:
    for subset in ("multiview", "video"):
        subject = make().subject(subset, 3)
        assert SubjectPlan.model_validate_json(subject.model_dump_json()) == subject


def test_subject_depends_on_neither_counts_nor_order() -> None:
    reference = make().subject("multiview", 5)
    assert list(make())[5] == reference
    assert make(subjects=1000, videos=1, frames=9).subject("multiview", 5) == reference


def test_more_views_and_lights_leave_the_first_ones() -> None:
    few, many = (
        make().subject("multiview", 5),
        make(views=9, environments=6).subject("multiview", 5),
    )
    assert many.person == few.person
    assert many.poses == few.poses
    assert many.cameras[:3] == few.cameras
    assert many.shots[:3] == few.shots
    assert many.environments[:2] == few.environments


def test_everything_depends_on_the_seed_and_zero_is_one() -> None:
    zero, again, one = (make(seed=s).subject("multiview", 0) for s in (0, 0, 1))
    assert zero == again
    for name in ("seed", "person", "poses", "cameras", "environments"):
        assert getattr(zero, name) != getattr(one, name)
    assert make(seed=2**63 - 1).subject("multiview", 0) != zero


def test_subjects_and_subsets_differ() -> None:
    the_plan = make(subjects=200)
    seeds = {s.seed for s in the_plan}
    assert len(seeds) == len(the_plan)
    assert max(seeds) < 2**63
    first = [the_plan.subject(subset, 0) for subset in ("multiview", "video")]
    assert first[0].person != first[1].person


def test_people_of_another_subset_are_the_same_and_in_the_same_split() -> None:
    job = make(subjects=400, videos=300).job
    shared = job.subsets["video"].model_copy(update={"people_of": "multiview"})
    subsets = {**job.subsets, "video": shared}
    the_plan = Plan(job.model_copy(update={"subsets": subsets}), POOL)
    for index in range(300):
        assert the_plan.split("video", index) == the_plan.split("multiview", index)
    for index in (0, 7, 299):
        ours, other = the_plan.subject("video", index), the_plan.subject("multiview", index)
        assert ours.person == other.person and ours.split == other.split
        assert ours.seed != other.seed and ours.poses[0] != other.poses[0]


def test_named_moods_are_shown_in_turn_by_one_person() -> None:
    job = make(videos=3).job
    spec = job.subsets["video"].model_copy(update={"moods": ("surprised", "smile"), "frames": 4})
    the_plan = Plan(job.model_copy(update={"subsets": {**job.subsets, "video": spec}}), POOL)
    for subject in (the_plan.subject("video", index) for index in range(3)):
        brows = [pose.expression.get("browInnerUp", 0.0) for pose in subject.poses]
        smiles = [pose.expression.get("mouthSmileLeft", 0.0) for pose in subject.poses]
        assert min(brows[0], brows[2]) > 0.5 > max(brows[1], brows[3])
        assert min(smiles[1], smiles[3]) > 0.5 > max(smiles[0], smiles[2])


def test_papers_video_people_are_among_the_multiview_people() -> None:
    the_plan = plan(load_job(JOBS / "paper.toml"))
    assert the_plan.person("video", 9_999) == the_plan.person("multiview", 9_999)


def test_lights_are_different_and_in_range() -> None:
    the_plan = make(environments=12)
    for index in range(20):
        uses = the_plan.subject("multiview", index).environments
        assert sorted(u.id for u in uses) == sorted(POOL)
        assert all(0 <= u.rotation < 2 * np.pi and -0.5 <= u.exposure <= 0.5 for u in uses)
        assert len({u.seed for u in uses}) == len(uses)


def test_pool_must_be_large_enough() -> None:
    with pytest.raises(JobError, match=r"subsets\.video\.environments = 3: the pool has only"):
        make(pool=POOL[:2])


def test_splits_are_by_hash_of_the_seed() -> None:
    the_plan = make(subjects=4000)
    splits = [the_plan.split("multiview", i) for i in range(4000)]
    shares = {s: splits.count(s) / len(splits) for s in SPLITS}
    assert shares["test"] == pytest.approx(0.05, abs=0.015)
    assert shares["validation"] == pytest.approx(0.05, abs=0.015)
    assert [make().split("multiview", i) for i in range(40)] == splits[:40]
    assert the_plan.subject("multiview", 17).split == splits[17]


def test_shards_hold_every_subject_once_and_one_split_each() -> None:
    job = make(subjects=100).job.model_copy(update={"shard_subjects": 8})
    the_plan = Plan(job, POOL)
    shards = the_plan.shards("multiview")
    assert sorted(i for s in shards for i in s.subjects) == list(range(100))
    assert {s.name for s in shards} >= {"multiview/train-000000.tar", "multiview/train-000001.tar"}
    for shard in shards:
        assert len(shard.subjects) <= 8
        assert {the_plan.split("multiview", i) for i in shard.subjects} == {shard.split}


def test_shard_size_follows_megabytes() -> None:
    job = make().job
    spec = job.subsets["multiview"]
    each = subject_bytes(job, spec)
    assert subjects_per_shard(job, spec) == 1_000_000_000 // each
    tiny = job.model_copy(update={"shard_megabytes": 1})
    assert subjects_per_shard(tiny, spec) == 1
