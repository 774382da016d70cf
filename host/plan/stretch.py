"""The minimum-snap plan: judged as it is, or stretched in time by the least factor that keeps the limits."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from trimtab.host.plan.box import OBSTACLES
from trimtab.host.plan.job import Effort, Job
from trimtab.host.plan.judge import Judged
from trimtab.host.plan.result import Plan, PlanRefused

Array = NDArray[np.float64]

_STRETCH_MAX = 8.0
_HALVINGS = 10
_GO_ROUND = "--kind min-control goes round it, or state a smaller --clearance"


def plan_snap(job: Job, *, stretch: bool) -> Plan:
    """Return the plan.

    Raises PlanRefused, with node and reason, for a broken limit that stretching may not or cannot mend.
    """
    started = time.process_time()
    durations = job.durations()
    factor, judged = 1.0, _attempt(job, durations, 1.0)
    if not judged.ok:
        if not stretch:
            in_the_way = judged.verdict.ok and any(judged.margins.get(name, 0.0) < 0.0 for name in OBSTACLES)
            remedy = _GO_ROUND if in_the_way else "give it more time: --time-s, or --stretch"
            raise PlanRefused(f"the min-snap plan is refused: {judged.message}; {remedy}", judged.verdict)
        factor, judged = _stretched(job, durations, judged)
    effort = Effort(status="solved", solve_s=time.process_time() - started, stretch=factor)
    return job.finish(judged, _times_s(durations * factor), effort)


def _attempt(job: Job, durations: Array, factor: float) -> Judged:
    durations = durations * factor
    return job.judge(job.snap(durations), job.yaws(factor), _times_s(durations))


def _times_s(durations: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(durations)])


def _stretched(job: Job, durations: Array, refused: Judged) -> tuple[float, Judged]:
    """Return about the least factor on all times that keeps the limits, by bisection of its logarithm."""
    low, high = 1.0, _STRETCH_MAX
    best = _attempt(job, durations, high)
    if not best.ok:
        raise PlanRefused(
            f"the min-snap plan is refused: {refused.message}; {high:g} times the time does not help: "
            f"{best.message}",
            best.verdict,
        )
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        judged = _attempt(job, durations, middle)
        if judged.ok:
            high, best = middle, judged
        else:
            low = middle
    return high, best
