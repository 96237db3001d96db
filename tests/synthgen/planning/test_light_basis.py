"""When all environments of a shot share a pass."""

from __future__ import annotations

import pytest

from synthgen.errors import JobError
from synthgen.planning.job import JobSpec, parse_job
from synthgen.planning.light_basis import basis_samples, groups, passes

SUBSET = {"kind": "multiview", "subjects": 1, "environments": 1, "views": 1}


def job(light_basis, samples: int = 8) -> JobSpec:
    data = {"name": "test", "samples": samples, "subsets": {"a": SUBSET}}
    return parse_job(data | {"light_basis": light_basis}, "job.toml")


def test_many_environments_share_a_pass_and_few_do_not():
    assert [basis_samples(job("auto"), e) is None for e in (1, 2, 7, 8, 12, 100)] == [
        *(True, True, True),
        *(False, False, False),
    ]


def test_a_job_may_insist():
    assert basis_samples(job(False), 50) is None
    assert basis_samples(job(True), 1) == 9  # never fewer than asked for


def test_sharing_costs_less_where_it_is_chosen():
    for environments in (8, 12, 40):
        assert passes(job("auto"), environments) < passes(job(False), environments)
    assert passes(job("auto"), 2) == 2


def test_no_pass_serves_more_than_cycles_can_tell_apart():
    for count in (1, 30, 31, 100):
        parts = groups(range(count))
        assert [e for part in parts for e in part] == list(range(count))
        assert max(map(len, parts)) <= 30


def test_other_words_are_refused_by_name():
    with pytest.raises(JobError, match="light_basis"):
        job("sometimes")
