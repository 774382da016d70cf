"""Work on several cores: threads, since compiled code and numpy's large operations release the interpreter.

Every item is computed alone and the results keep the order of the items, so they do not depend on the number
of threads. Linear algebra keeps to one thread: for thousands of small matrices more are slower, and its sums
would depend on their number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from trimtab.host.base.errors import UsageError

if TYPE_CHECKING:
    from threadpoolctl import threadpool_limits

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
    from concurrent.futures import ThreadPoolExecutor  # with logging, which no help needs

    with ThreadPoolExecutor(min(jobs, len(items))) as pool:
        return list(pool.map(work, items))


@contextmanager
def one_thread_of_algebra() -> Iterator[None]:
    """Keep linear algebra in one thread. A context, and a decorator of functions.

    It bounds the libraries that are loaded when it begins: numpy's, and those of scipy and CasADi if they
    were imported. A function that imports one itself does its work in a context of its own. The number of
    threads belongs to the process, so another thread that does algebra is bounded too, until the context
    ends.
    """
    with _limited():
        yield


def keep_one_thread_of_algebra() -> None:
    """Keep linear algebra in one thread from now on. For a process that only works for another one."""
    import scipy.linalg  # noqa: F401 (its library is then loaded)

    _limited()


def _limited() -> threadpool_limits:
    """Limit the loaded libraries, until the result is used as a context and that ends."""
    import numpy  # noqa: F401 (its library is then loaded)
    from threadpoolctl import threadpool_limits

    _know_casadi()
    return threadpool_limits(1, user_api="blas")


@cache
def _know_casadi() -> None:
    """Let threadpoolctl know the library that CasADi's solvers bring along, once for each process."""
    from threadpoolctl import OpenBLASController, register

    class _CasadiController(OpenBLASController):
        filename_prefixes = ("libcasadi-tp-openblas",)

    register(_CasadiController)
