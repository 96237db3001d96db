"""Rendering one shot again from what the dataset records, and how far it comes out the same."""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from synthgen.dataset.codecs import encode_json
from synthgen.dataset.folder import Place, StorageError, brief
from synthgen.dataset.reading import open_dataset
from synthgen.dataset.shot import Shot
from synthgen.farm import DEFAULT_RENDERER, preflight
from synthgen.farm.isolated import IsolatedError, isolated
from synthgen.farm.run import time_allowed
from synthgen.farm.worker import load_renderer
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import SubjectPlan
from synthgen.publish import publish

RENDERERS = frozenset({DEFAULT_RENDERER})
"""What a dataset may name as its renderer."""


@dataclass(frozen=True)
class Difference:
    """How one field differs: the largest absolute difference, and the share of other values."""

    largest: float
    share: float


@dataclass(frozen=True)
class Report:
    """Field -> difference, of the shot `key` ("<subset>/<key>"). `str()` is a table for people."""

    key: str
    fields: dict[str, Difference]

    @property
    def identical(self) -> bool:
        return all(d.share == 0 for d in self.fields.values())

    def __str__(self) -> str:
        lines = [f"{self.key}: {'identical' if self.identical else 'differs'}"]
        for name, d in self.fields.items():
            text = "equal" if d.share == 0 else f"{d.share:.2%} differ, at most {d.largest:.3g}"
            lines.append(f"  {name:<26} {text}")
        return "\n".join(lines)


def rerender(
    out: Place,
    key: str,
    subset: str | None = None,
    device: str = "cpu",
    threads: int = 1,
    time_limit: float | None = None,
    renderer: str | None = None,
) -> Report:
    """Render the shot `key` again from dataset.json alone and compare it with what is stored.

    `renderer` ("package.module:function") replaces the recorded one, which must be one of
    `RENDERERS`: a dataset does not choose what is imported.

    Raises `StorageError` if there is no such shot, its renderer is unknown, or it fails.
    """
    dataset = open_dataset(out, subset=subset)
    stored = dataset.find(key)
    plan = publish.stored_plan(dataset.folder)
    name, index = stored.meta["subset"], stored.meta["index"]
    spec = plan.job.subsets.get(name)
    if spec is None or not 0 <= index < spec.subjects:
        raise StorageError(f"{out}: the recorded job has no shot {key}")
    subject = plan.subject(name, index)
    shots = tuple(shot for shot in subject.shots if shot.key == stored.key)
    if not shots:
        raise StorageError(f"{out}: the recorded job has no shot {key}")
    subject = subject.model_copy(update={"shots": shots})
    renderer = renderer or _known(dataset.description.renderer, out)
    preflight.check_renderer(renderer)
    if time_limit is None:
        time_limit = time_allowed(plan.job, subject.frames)
    arguments = (renderer, plan.job, subject, dataset.folder.environments, device, threads)
    try:
        again = isolated(_render, *arguments, time_limit=time_limit)
    except IsolatedError as error:
        raise StorageError(f"{key}: rendering it again failed: {error}") from None
    return compare(stored, again)


def _known(renderer: str, out: Place) -> str:
    if renderer not in RENDERERS:
        raise StorageError(
            f"{out}: names the renderer {brief(renderer)}, which is not ours; if you trust it, "
            "give it as --renderer"
        )
    return renderer


def compare(stored: Shot, again: Shot) -> Report:
    """The difference of two shots, field by field; `inf` where shapes or words differ."""
    fields: dict[str, Difference] = {}
    for name in ("rgb", "hdr"):
        ours, theirs = getattr(stored, name), getattr(again, name)
        pairs = itertools.zip_longest(
            () if ours is None else ours, () if theirs is None else theirs
        )
        for i, (a, b) in enumerate(pairs):
            fields[f"{name}_{i:02d}"] = _difference(a, b)
    for name in stored.passes:
        fields[name] = _difference(stored.passes[name], again.passes.get(name))
    for name in sorted(stored.geometry | again.geometry):
        ours, theirs = stored.geometry.get(name), again.geometry.get(name)
        fields[f"geometry {name}"] = _difference(ours, theirs)
    # As it would be stored: a renderer may give tuples and numbers of NumPy.
    meta = json.loads(encode_json(again.meta))
    for name in sorted(stored.meta | meta):
        fields[f"meta {name}"] = _meta_difference(stored.meta.get(name), meta.get(name))
    return Report(f"{stored.meta['subset']}/{stored.key}", fields)


def _meta_difference(a: Any, b: Any) -> Difference:
    """Of the numbers in two JSON values, if these are not equal; `inf` if the rest differs."""
    if a == b:
        return Difference(0.0, 0.0)
    gap = _difference(_numbers(a), _numbers(b))
    return gap if gap.share else Difference(float("inf"), 1.0)


def _difference(a: np.ndarray | None, b: np.ndarray | None) -> Difference:
    if a is None or b is None or a.shape != b.shape:
        return Difference(float("inf"), 1.0)
    gap = np.abs(a.astype(np.float64) - b.astype(np.float64))
    return Difference(float(gap.max(initial=0)), float((gap > 0).mean()) if gap.size else 0.0)


def _numbers(value: Any) -> np.ndarray:
    """All numbers in a JSON value, in order."""
    if isinstance(value, dict):
        value = [value[name] for name in sorted(value)]
    if isinstance(value, list):
        return np.concatenate([_numbers(v) for v in value]) if value else np.empty(0)
    return np.array([value], float) if isinstance(value, int | float) else np.empty(0)


def _render(
    renderer: str,
    job: JobSpec,
    subject: SubjectPlan,
    environments: Path,
    device: str,
    threads: int,
) -> Shot:
    """The one shot of a subject; runs in its own process."""
    return load_renderer(renderer)(subject, job, environments, device, threads).shots[0]
