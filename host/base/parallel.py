"""Work on several cores: threads, since compiled code and numpy's large operations release the interpreter.

Every item is computed alone and the results keep the order of the items, so they do not depend on the number
of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from trimtab.host.base.errors import UsageError

Item = TypeVar("Item")
Result = TypeVar("Result")


def cores() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return (os.cpu_count() or 1) if affinity is None else len(affinity(0))


def check_jobs(jobs: int | None) -> None:
    """Raise UsageError for a value of --jobs that is not None and not at least 1."""
    if jobs is not None and jobs < 1:
        raise UsageError(f"--jobs {jobs}: give 1 or more")


def each(work: Callable[[Item], Result], items: Iterable[Item], jobs: int) -> list[Result]:
    """Return `work` of every item, in order, by up to `jobs` threads.

    An exception of any item, and Ctrl-C, leaves out the items that have not begun.
    """
    items = list(items)
    if min(jobs, len(items)) <= 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(min(jobs, len(items))) as pool:
        return list(pool.map(work, items))


def one_thread_of_algebra() -> None:
    """Keep numpy's linear algebra in one thread, so that its sums do not depend on the machine's cores.

    It has no effect after numpy was imported.
    """
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
