"""The baseline of a comparison: whether the library explains it, and the values that both sets share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trimtab.host.log import ChangedSetting, Flight
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.decision.findings import OUTSIDE_LIBRARY_CODES, Code, LogsRefused
from trimtab.host.trace.decision.residual_rules import residual_bounds, residual_findings
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.joint import COMMON, JointSpace
from trimtab.host.trace.residual.unexplained import UnexplainedResidual, unexplained_residual
from trimtab.host.trace.result import Baseline, Value
from trimtab.host.trace.segment_fit.fit import SegmentFit, disturbance_left, refit
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.sentences import sentences


def check_baseline(
    segment_model: SegmentModel,
    data: Segments,
    baseline: Sequence[Flight],
    repeat_flights: Sequence[tuple[int, int]],
    *,
    thrust_known: bool,
) -> None:
    """Raise LogsRefused if the baseline alone has a cause outside the library.

    Its flights are fitted with all common columns, in which every effect of the library is free. The rules on
    what this fit leaves unexplained are those of a trace.

    Parameters
    ----------
    segment_model, data
        Model and segments of both sets.
    baseline
        Flights of the baseline, the first flights of `data`.
    repeat_flights
        Pairs of indices of repeat flights.
    thrust_known
        Whether the logs determine the thrust.
    """
    count = len(baseline)
    pairs = [(a, b) for a, b in repeat_flights if b < count]
    alone = replace(data.take(data.flight < count), paths=data.paths[:count])
    fit = refit(segment_model, alone, (), None, iterations=3)
    space = segment_model.space
    of_effects = [column.owner.removeprefix(COMMON) in space.effects for column in space.columns]

    def residual(theta_scaled: np.ndarray) -> UnexplainedResidual:
        return unexplained_residual(disturbance_left(fit, theta_scaled), fit.data, pairs, axial=thrust_known)

    bounds = residual_bounds(
        residual(np.where(of_effects, 0.0, fit.theta_scaled)),
        has_effects=False,
        has_memory=False,
        rules=RULES,
    )
    findings = residual_findings(residual(fit.theta_scaled), bounds, RULES)
    if findings:
        logs = ", ".join(str(flight.path) for flight in baseline)
        raise LogsRefused(
            Code.BASELINE_OUTSIDE_LIBRARY,
            f"{logs}: the baseline itself has a cause outside the library: "
            f"{'; '.join(sentences(findings, OUTSIDE_LIBRARY_CODES))}; trace it alone",
        )


def baseline_of(
    space: JointSpace,
    selected: SegmentFit,
    logs: Sequence[str],
    settings: tuple[ChangedSetting, ...] | None,
) -> Baseline:
    """Return what a comparison says of its baseline.

    selected: joint fit of both sets. logs: names of the logs of the baseline. settings: those that differ.
    """
    values = space.values(selected.theta_scaled)
    sd = np.sqrt(np.diag(selected.covariance)) * space.scale
    common: dict[str, dict[str, Value]] = {}
    for i in np.flatnonzero(space.is_common).tolist():
        column = space.columns[i]
        if space.rolled.columns[space.index[i]].form:
            continue
        entry = common.setdefault(column.owner.removeprefix(COMMON), {})
        entry[column.key] = Value(value=float(values[i]), sd=float(sd[i]), unit=column.unit)
    return Baseline(
        logs=tuple(logs), common=common, thrust_sigma=RULES.session_thrust_sigma, settings=settings
    )
