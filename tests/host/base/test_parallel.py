"""Work on several cores: order, errors, interrupts."""

from __future__ import annotations

import threading

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.base.parallel import check_jobs, cores, each


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_results_keep_the_order_of_the_items(jobs: int) -> None:
    assert each(lambda x: x * x, range(20), jobs) == [x * x for x in range(20)]


def test_several_items_are_in_work_at_once() -> None:
    both = threading.Barrier(2, timeout=30.0)
    each(lambda _: both.wait(), range(2), 2)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_error_ends_the_work_and_leaves_out_what_has_not_begun(error: type[BaseException]) -> None:
    begun: list[int] = []
    failed = threading.Event()

    def work(item: int) -> None:
        begun.append(item)
        if item == 0:
            failed.set()
            raise error
        failed.wait(30.0)

    with pytest.raises(error):
        each(work, range(1000), 2)
    assert len(begun) < 1000


def test_jobs_below_one_are_refused_in_one_line() -> None:
    check_jobs(None)
    check_jobs(cores())
    with pytest.raises(UsageError, match="--jobs 0"):
        check_jobs(0)
