"""Independent calls over several processes. The results do not depend on their number."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Any

from trimtab.host.base.parallel import keep_one_thread_of_algebra


@contextmanager
def workers(jobs: int) -> Iterator[Executor]:
    """Yield an executor of up to `jobs` processes; with one job, calls run in this process when submitted.

    Functions, arguments and results are pickled. On an error, calls that have not begun are cancelled.
    """
    if jobs == 1:
        yield _Here()
        return
    pool = process_pool(jobs, _serve_parent)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


class _Here(Executor):
    """An executor that runs each call at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def process_pool(jobs: int, initializer: Callable[[], None] | None = None) -> ProcessPoolExecutor:
    """Return a pool of new processes that end with this one.

    initializer: what each process calls first, instead of `_work_for_parent`.
    """
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=spawn, initializer=initializer or _work_for_parent)


def _work_for_parent() -> None:
    """End with the parent. Keep linear algebra in one thread: every process works on a core of its own."""
    _end_with_parent()
    keep_one_thread_of_algebra()


def _serve_parent() -> None:
    """Leave Ctrl-C, which the terminal sends to every process of the command, to the parent; end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_parent()


def _end_with_parent() -> None:
    """End this process when the one that started it ends, even if that one is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
