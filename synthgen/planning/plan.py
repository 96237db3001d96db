"""Job to subjects to shots to frames, every seed derived from one. Pure: no head model, no Blender.

`Plan` computes any subject on demand. A subject depends on the job's seed, the subset's name and
its own index alone: never on how many others there are or on the order they are made in. Its person
and split depend on the subset that `people_of` names instead, if it names one.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np

from assets_procedural.conventions.camera import CameraSample, resolve
from assets_procedural.light.key_light import sample_key
from assets_procedural.light.pool import pool
from assets_procedural.motion import recorded
from assets_procedural.motion.poses import Pose, sample_pose
from assets_procedural.motion.tracks import named_moods, sample_track
from assets_procedural.people.person_sampling import sample_person
from assets_procedural.people.quotas import QuotaError, factors, quota_points
from assets_procedural.person import Person
from assets_procedural.settings import Parameters
from synthgen.errors import JobError
from synthgen.planning.camera_sampling import sample_camera
from synthgen.planning.job import HEAD_METRES, JobSpec, SubsetSpec

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")


class Stream(IntEnum):
    """What a random stream is for. The numbers are part of the format: never reuse one."""

    SUBJECT = 0
    PERSON = 1
    POSE = 2
    CAMERA = 3
    ENVIRONMENT = 4
    QUOTAS = 5


class EnvironmentUse(Parameters):
    """How a subject is lit: the panorama `id`, turned by `rotation` radians about +Z, exposed
    `exposure` stops above what is metered on the face. `seed` is for the renderer's noise."""

    id: str
    rotation: float
    exposure: float
    seed: int


class ShotPlan(Parameters):
    """One shot: indices into the subject's `poses` and `cameras`; `seed` for its noise, added to
    the environment's."""

    key: str
    pose: int
    camera: int
    seed: int


class SubjectPlan(Parameters):
    """Everything that is to be rendered of one subject, as plain data."""

    subset: str
    kind: Literal["multiview", "video"]
    index: int
    key: str
    seed: int
    split: Split
    person: Person
    environments: tuple[EnvironmentUse, ...]
    keys: tuple[float | None, ...] = ()
    """Per environment the azimuth that its key is to fall from, radians, 0 in front of the trunk,
    positive towards the subject's left; None: it stays at its `rotation`. See `turning.turned`."""
    poses: tuple[Pose, ...]
    motion: recorded.Motion | None = None
    """Whose motion the poses are, if they are recorded."""
    cameras: tuple[CameraSample, ...]
    shots: tuple[ShotPlan, ...]

    @property
    def frames(self) -> int:
        """Pictures of this subject: shots x environments."""
        return len(self.shots) * len(self.environments)


@dataclass(frozen=True)
class ShardPlan:
    """One tar: `number`-th of its subset and split, holding whole subjects by index."""

    subset: str
    split: Split
    number: int
    subjects: tuple[int, ...]

    @property
    def name(self) -> str:
        """Path in the dataset's `data` folder."""
        return f"{self.subset}/{self.split}-{self.number:06d}.tar"


class Plan:
    """The subjects of a job; see `plan`.

    Raises `JobError` if a subset wants more environments per subject than there are, or if people
    cannot reach a quota.
    """

    def __init__(self, job: JobSpec, environment_ids: Sequence[str]) -> None:
        self.job = job
        self.environment_ids = tuple(environment_ids)
        for name, subset in job.subsets.items():
            if subset.environments > len(self.environment_ids):
                raise JobError(
                    job.name,
                    f"subsets.{name}.environments",
                    str(subset.environments),
                    f"the pool has only {len(self.environment_ids)}; "
                    "lower it, or add to [environments]",
                )
        self.recordings: tuple[recorded.Recording, ...] = ()
        if job.poses.tracks is not None:
            try:
                self.recordings = recorded.read(job.poses.tracks)
            except recorded.RecordingError as error:
                raise JobError(job.name, "poses.tracks", "", str(error)) from None
        try:
            factors(job.people)
        except QuotaError as error:
            raise JobError(job.name, error.field, error.value, error.remedy) from None

    def __len__(self) -> int:
        """Number of subjects."""
        return sum(s.subjects for s in self.job.subsets.values())

    def __iter__(self) -> Iterator[SubjectPlan]:
        for name, subset in self.job.subsets.items():
            for index in range(subset.subjects):
                yield self.subject(name, index)

    @property
    def shots(self) -> int:
        return sum(s.subjects * s.shots for s in self.job.subsets.values())

    @property
    def frames(self) -> int:
        return sum(s.subjects * s.shots * s.environments for s in self.job.subsets.values())

    def seed(self, subset: str, index: int) -> int:
        """A subject's own seed, 63 bits."""
        return _integer(self._sequence(subset, index, Stream.SUBJECT))

    def split(self, subset: str, index: int) -> Split:
        """Where a subject belongs: by a hash of its person's seed, never by order.

        Nobody is in two splits, in whatever subsets.
        """
        seed = self.seed(self.people_of(subset), index)
        position = zlib.crc32(seed.to_bytes(8, "little")) / 2**32
        splits = self.job.splits
        if position < splits.test:
            return "test"
        return "validation" if position < splits.test + splits.validation else "train"

    def people_of(self, subset: str) -> str:
        """The subset that a subset has its people from, mostly itself."""
        return self.job.subsets[subset].people_of or subset

    def person(self, subset: str, index: int) -> Person:
        """Who the `index`-th subject of a subset is."""
        source = self.people_of(subset)
        points = quota_points(self.job.people, index, self._rng(source, 0, Stream.QUOTAS))
        return sample_person(self._rng(source, index, Stream.PERSON), self.job.people, points)

    def subject(self, subset: str, index: int) -> SubjectPlan:
        """The `index`-th subject of a subset, in constant time.

        Raises `KeyError` for an unknown subset and `IndexError` outside 0 … subjects - 1.
        """
        spec = self.job.subsets[subset]
        if not 0 <= index < spec.subjects:
            raise IndexError(f"{subset} has subjects 0 to {spec.subjects - 1}, not {index}")
        key = subject_key(index)
        cameras = self._cameras(subset, index, spec)
        lens = resolve(cameras[0], np.zeros(3), HEAD_METRES, 1).position
        rng, motion = self._rng(subset, index, Stream.POSE), None
        if spec.kind == "multiview":
            poses: tuple[Pose, ...] = (sample_pose(rng, self.job.poses, lens),)
        elif spec.moods:
            poses = named_moods(rng, spec.moods, spec.shots, self.job.poses, lens)
        elif self.recordings:
            poses, motion = recorded.play(rng, self.recordings, spec.shots, self.job.poses)
        else:
            poses = sample_track(rng, spec.shots, self.job.poses, lens)
        environments, keys = self._environments(subset, index, spec)
        return SubjectPlan(
            subset=subset,
            kind=spec.kind,
            index=index,
            key=key,
            seed=self.seed(subset, index),
            split=self.split(subset, index),
            person=self.person(subset, index),
            environments=environments,
            keys=keys,
            poses=poses,
            motion=motion,
            cameras=cameras,
            shots=tuple(
                ShotPlan(
                    key=f"{key}_p{i:02d}",
                    pose=0 if spec.kind == "multiview" else i,
                    camera=i if spec.kind == "multiview" else 0,
                    seed=_integer(self._sequence(subset, index, Stream.SUBJECT, i + 1), 31),
                )
                for i in range(spec.shots)
            ),
        )

    def shards(self, subset: str) -> list[ShardPlan]:
        """How a subset's subjects are packed: by split, in order of index."""
        spec = self.job.subsets[subset]
        size = subjects_per_shard(self.job, spec)
        members: dict[Split, list[int]] = {split: [] for split in SPLITS}
        for index in range(spec.subjects):
            members[self.split(subset, index)].append(index)
        return [
            ShardPlan(subset, split, number, tuple(indices[start : start + size]))
            for split, indices in members.items()
            for number, start in enumerate(range(0, len(indices), size))
        ]

    def _cameras(self, subset: str, index: int, spec: SubsetSpec) -> tuple[CameraSample, ...]:
        # A stream per view, so that more views leave the first ones as they were.
        count = spec.shots if spec.kind == "multiview" else 1
        return tuple(
            sample_camera(self._rng(subset, index, Stream.CAMERA, i), self.job.camera)
            for i in range(count)
        )

    def _environments(
        self, subset: str, index: int, spec: SubsetSpec
    ) -> tuple[tuple[EnvironmentUse, ...], tuple[float | None, ...]]:
        settings = self.job.environments
        rng = self._rng(subset, index, Stream.ENVIRONMENT)
        chosen = rng.permutation(len(self.environment_ids))[: spec.environments]
        uses, keys = [], []
        for i, which in enumerate(chosen):
            rng = self._rng(subset, index, Stream.ENVIRONMENT, i)
            uses.append(
                EnvironmentUse(
                    id=self.environment_ids[which],
                    rotation=math.radians(rng.uniform(*settings.rotation)),
                    exposure=rng.uniform(*settings.exposure),
                    seed=int(rng.integers(2**31)),
                )
            )
            keys.append(sample_key(rng) if rng.random() < settings.key_light else None)
        return tuple(uses), tuple(keys)

    def _sequence(self, subset: str, index: int, *stream: int) -> np.random.SeedSequence:
        key = (zlib.crc32(subset.encode()), index, *(int(s) for s in stream))
        return np.random.SeedSequence(self.job.seed, spawn_key=key)

    def _rng(self, subset: str, index: int, *stream: int) -> np.random.Generator:
        return np.random.Generator(np.random.PCG64(self._sequence(subset, index, *stream)))


def plan(job: JobSpec) -> Plan:
    """The plan of a job; lists the pool of environments, renders nothing.

    Raises `JobError` if a subset wants more environments per subject than the pool has, or if
    people cannot reach a quota.
    """
    return Plan(job, [spec.id for spec in pool(job.environments, job.seed)])


def subject_key(index: int) -> str:
    """ "s000123"."""
    return f"s{index:06d}"


# Bytes per pixel and shot (labels) or frame (the others), and bytes per shot, measured on heads
# rendered at 256 x 256.
_LABEL_BYTES, _PICTURE_BYTES, _LINEAR_BYTES, _GEOMETRY_BYTES = 11.0, 1.2, 1.5, 230_000


def subject_bytes(job: JobSpec, spec: SubsetSpec) -> int:
    """Expected size of one subject's members on disk. A deterministic function of the job."""
    pixels = job.resolution**2
    frame = pixels * (_PICTURE_BYTES + (_LINEAR_BYTES if job.image.linear else 0.0))
    shot = pixels * _LABEL_BYTES + _GEOMETRY_BYTES
    return int(spec.shots * (shot + spec.environments * frame))


def subjects_per_shard(job: JobSpec, spec: SubsetSpec) -> int:
    """How many whole subjects a shard of this subset takes, at least 1."""
    if job.shard_subjects is not None:
        return job.shard_subjects
    return max(1, job.shard_megabytes * 1_000_000 // subject_bytes(job, spec))


def _integer(sequence: np.random.SeedSequence, bits: int = 63) -> int:
    return int(sequence.generate_state(1, np.uint64)[0]) >> (64 - bits)
