"""Whether all environments of a subject are rendered at once, and with how many samples.

Light adds up: one pass that keeps many lights apart serves any number of environments
(`synthgen.stage.light`). Follows from the job alone, so that a shot renders again as it was.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TypeVar

from synthgen.planning.job import JobSpec

# samples * _SHARE * E ** _GROWTH are meant to leave no environment worse than a pass of its own
# does, not only their mean. A sample of the basis costs _SAMPLE of one of a world.
_SHARE, _GROWTH = 1.1, 0.57
_SAMPLE = 1.15
_FEWEST = 8  # environments: among fewer, those that share no light with others lose quality
_MOST = 30  # environments that one pass serves

T = TypeVar("T")


def basis_samples(job: JobSpec, environments: int) -> int | None:
    """Samples of a pass for many environments of a subject; None: each has a pass of its own.

    `light_basis = "auto"` chooses what costs less at the same quality.
    """
    if job.light_basis is False:
        return None
    groups_of = max(len(group) for group in groups(range(environments)))
    samples = max(job.samples, math.ceil(_SHARE * job.samples * groups_of**_GROWTH))
    wins = groups_of >= _FEWEST and samples * _SAMPLE < job.samples * groups_of
    return samples if job.light_basis is True or wins else None


def groups(environments: Sequence[T]) -> list[Sequence[T]]:
    """The environments that one pass serves, in order, about as many each."""
    count = math.ceil(len(environments) / _MOST)
    edges = [round(i * len(environments) / count) for i in range(count + 1)]
    return [environments[a:b] for a, b in itertools.pairwise(edges)]


def passes(job: JobSpec, environments: int) -> float:
    """Passes of `job.samples` each that the lights of a shot cost."""
    samples = basis_samples(job, environments)
    if samples is None:
        return environments
    return len(groups(range(environments))) * samples * _SAMPLE / job.samples
