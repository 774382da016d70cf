"""Best of several runs, which excludes the influence of other work on the machine."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter


def best_ms(run: Callable[[], object], *, repeats: int) -> float:
    """Return the milliseconds of the fastest of `repeats` runs, after one warm-up run."""
    run()
    times = []
    for _ in range(repeats):
        began = perf_counter()
        run()
        times.append(perf_counter() - began)
    return 1e3 * min(times)
