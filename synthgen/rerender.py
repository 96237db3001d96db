"""Rendering one shot again from what the dataset records, and how far it comes out the same."""

from __future__ import annotations

import contextlib
import pickle
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from synthgen import ledger, publish
from synthgen.dataset import open_dataset
from synthgen.farm.process import start
from synthgen.farm.worker import Orders, end_process, load_renderer, reason_of, redirect
from synthgen.plan import SubjectPlan
from synthgen.shards import MEMBER_OF
from synthgen.shot import Shot


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
    out: Path | str,
    key: str,
    subset: str | None = None,
    device: str = "cpu",
    threads: int = 1,
    time_limit: float = 1800.0,
) -> Report:
    """Render the shot `key` again from dataset.json alone and compare it with what is stored.

    Raises `StorageError` if there is no such shot or the renderer fails.
    """
    out = Path(out)
    dataset = open_dataset(out, subset=subset)
    stored = dataset.find(key)
    plan = publish.stored_plan(out)
    subject = plan.subject(stored.meta["subset"], stored.meta["index"])
    shots = tuple(shot for shot in subject.shots if shot.key == stored.key)
    if not shots:
        raise ledger.StorageError(f"{out}: the recorded job has no shot {key}")
    subject = subject.model_copy(update={"shots": shots})
    renderer = ledger.read_dataset_json(out)["renderer"]
    with tempfile.TemporaryDirectory() as folder:
        orders = Orders(plan.job, out, renderer, device, threads, Path(folder) / "log")
        target = Path(folder) / "shot"
        process = start(_render, orders, subject, target)
        process.join(time_limit)
        if process.is_alive():
            process.kill()
            process.join()
        if not target.exists():
            lines = [""]
            with contextlib.suppress(OSError):
                lines = (orders.log.read_text(errors="replace").strip() or " ").splitlines()
            raise ledger.StorageError(f"{key}: rendering it again failed: {lines[-1][:200]}")
        again: Shot = pickle.loads(target.read_bytes())
    return compare(stored, again)


def compare(stored: Shot, again: Shot) -> Report:
    """The difference of two shots, field by field; `inf` where shapes differ."""
    fields: dict[str, Difference] = {}
    for i, (a, b) in enumerate(zip(stored.rgb, again.rgb, strict=False)):
        fields[f"rgb_{i:02d}"] = _difference(a, b)
    if stored.hdr is not None and again.hdr is not None:
        for i, (a, b) in enumerate(zip(stored.hdr, again.hdr, strict=False)):
            fields[f"hdr_{i:02d}"] = _difference(a, b)
    for name in MEMBER_OF:
        if name not in ("geometry", "meta"):
            fields[name] = _difference(getattr(stored, name), getattr(again, name))
    for name in sorted(stored.geometry):
        fields[f"geometry {name}"] = _difference(stored.geometry[name], again.geometry.get(name))
    for name in ("camera", "exposures", "landmarks"):
        fields[f"meta {name}"] = _difference(
            _numbers(stored.meta[name]), _numbers(again.meta[name])
        )
    return Report(f"{stored.meta['subset']}/{stored.key}", fields)


def _difference(a: np.ndarray, b: np.ndarray | None) -> Difference:
    if b is None or a.shape != b.shape:
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


def _render(orders: Orders, subject: SubjectPlan, target: Path) -> None:
    """Runs in its own process."""
    redirect(orders.log)
    try:
        rendered = load_renderer(orders.renderer)(
            subject, orders.job, orders.out / "environments", orders.device, orders.threads
        )
        temporary = target.with_suffix(".tmp")
        temporary.write_bytes(pickle.dumps(rendered.shots[0]))
        temporary.replace(target)
    except Exception as error:
        print(reason_of(error))
        end_process(1)
    end_process(0)
