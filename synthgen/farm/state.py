"""What a run has done so far: kept by `run`, shown by `progress`."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from synthgen.dataset.folder import DatasetFolder
from synthgen.dataset.records import Failure
from synthgen.farm.slot import Slot
from synthgen.planning.plan import Plan, ShardPlan


@dataclass
class Summary:
    """What one call of `render_job` did. `complete`: the whole dataset is finished; `mended`: a
    line for each damage that was found in what had been stored."""

    rendered: int = 0
    frames: int = 0
    seconds: float = 0.0
    failed: list[Failure] = field(default_factory=list)
    complete: bool = False
    mended: list[str] = field(default_factory=list)


@dataclass
class RunState:
    """One pass over a slice of the plan, as far as it has come."""

    plan: Plan
    folder: DatasetFolder
    slice: str
    shards: list[ShardPlan]
    slots: dict[int, Slot] = field(default_factory=dict)
    summary: Summary = field(default_factory=Summary)
    streak: list[tuple[str, str]] = field(default_factory=list)
    """Subjects (subset, key) of the failures since the last success."""
    started: float = field(default_factory=time.time)
