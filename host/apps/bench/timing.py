"""The best of several runs: what a machine can do, not what else it was doing."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter


def best_ms(run: Callable[[], object], *, repeats: int) -> float:
    """Milliseconds of the fastest of `repeats` runs, after one that does not count."""
    run()
    times = []
    for _ in range(repeats):
        began = perf_counter()
        run()
        times.append(perf_counter() - began)
    return 1e3 * min(times)
