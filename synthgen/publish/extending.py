"""A finished dataset takes more subjects or subsets; what is there stays as it is.

A subject depends on the job's seed, its subset and its index alone, so that those which are there
are those of the larger job, too.
"""

from __future__ import annotations

from typing import Any

from synthgen.dataset import ledger
from synthgen.dataset.folder import DatasetFolder, Place, StorageError
from synthgen.dataset.records import read_description
from synthgen.planning.job import JobSpec
from synthgen.planning.plan import Plan
from synthgen.publish import publish


def extend(out: Place, plan: Plan, environments: list[dict[str, Any]], renderer: str) -> None:
    """Let the dataset in `out` be that of a larger job, and so incomplete.

    `render_job` with that job then renders what is new. Arguments as of `publish.check`.

    Raises `StorageError` if there is no complete dataset, another version of the code made it, it
    is being rendered, or the job differs in more than subjects and subsets that come on top.
    """
    folder = DatasetFolder(out)
    with ledger.slice_lock(folder, (1, 1)), ledger.shared_files_lock(folder):
        info = read_description(folder)
        publish.check_whole(folder, info)
        stored = publish.stored_plan(folder)
        if not _grows(stored.job, plan.job):
            publish.check(folder, plan, environments, renderer)
            return
        if not info.complete:
            raise StorageError(
                f"{folder}: is not complete; finish it with `synthgen render` and its own job first"
            )
        publish.check_code(folder, info)
        # All but what is new must be as it was.
        subsets = {}
        for name, before in stored.job.subsets.items():
            if (spec := plan.job.subsets.get(name)) is not None:
                fewer = min(spec.subjects, before.subjects)
                subsets[name] = spec.model_copy(update={"subjects": fewer})
        same = Plan(plan.job.model_copy(update={"subsets": subsets}), plan.environment_ids)
        publish.check(folder, same, environments, renderer)
        # The copy says what is complete, and a repair goes by it.
        folder.description_copy.unlink(missing_ok=True)
        update = {
            "complete": False,
            "job": plan.job.model_dump(mode="json"),
            "plan": publish.planned(plan.job),
        }
        publish.write_description(folder, info.model_copy(update=update))


def _grows(old: JobSpec, new: JobSpec) -> bool:
    return any(
        name not in old.subsets or spec.subjects > old.subsets[name].subjects
        for name, spec in new.subsets.items()
    )
