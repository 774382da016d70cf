"""Calls in several processes: results in order, and errors as in one process."""

from __future__ import annotations

import os

import pytest

from trimtab.host.base.parallel import cores
from trimtab.host.base.workers import workers


@pytest.mark.parametrize("jobs", [1, 2])
def test_workers_return_results_and_raise_errors_in_order(jobs):
    with workers(jobs) as pool:
        results = [pool.submit(pow, 2, number) for number in range(3)]
        failed = pool.submit(int, "x")
        here = pool.submit(os.getpid)
        assert [future.result() for future in results] == [1, 2, 4]
        with pytest.raises(ValueError, match="'x'"):
            failed.result()
        assert (here.result() == os.getpid()) == (jobs == 1)


def test_cores_are_those_of_this_process():
    assert cores() >= 1
