"""Report on the steps of a controller on the host, from the log of its flight."""

from __future__ import annotations

from typing import Any

import numpy as np

from trimtab.host.log.one_flight import Flight
from trimtab.protocol.generated import host_control_pb2
from trimtab.protocol.telemetry import TICK_US

LATE_US = 2 * TICK_US
"""A command that was sent later than this after the declared computing time counts as late."""


def control_report(flight: Flight) -> dict[str, Any] | None:
    """Return the `control` object of `fly` and `log info`; None if no controller on the host flew."""
    steps = flight.host_control
    if steps is None:
        return None
    outcomes = host_control_pb2.HostControl.Outcome.items()
    ages_ms = 1e-3 * steps.estimate_age_us
    return {
        "controller": steps.controller,
        "settings_id": steps.settings_id,
        "model_id": steps.model_id,
        "period_ms": 1e-3 * steps.period_us,
        "computing_ms": 1e-3 * steps.computing_us,
        "steps": len(steps),
        **{name.lower(): int(np.count_nonzero(steps.outcome == number)) for name, number in outcomes},
        "sent": int(np.count_nonzero(steps.commanded)),
        "late": int(np.count_nonzero(steps.late_us > LATE_US)),
        "iterations_max": int(steps.iterations.max()),
        "estimate_age_ms_p50": float(np.median(ages_ms)),
        "estimate_age_ms_p99": float(np.percentile(ages_ms, 99.0)),
        "ahead_ms_p50": float(np.median(1e-3 * (steps.act_us - steps.t_us))),
    }


def to_lines(report: dict[str, Any] | None) -> list[str]:
    """Return the lines of text for the terminal, from the object that `control_report` returns."""
    if report is None:
        return []
    counts = f"{report['steps']} steps, {report['solved']} solved"
    for key, words in (("budget_spent", "out of budget"), ("infeasible", "infeasible"), ("late", "late")):
        if report[key]:
            counts += f", {report[key]} {words}"
    return [
        f"controller {report['controller']} ({report['settings_id']}): {counts}; estimates "
        f"{report['estimate_age_ms_p50']:.0f} ms old, commands {report['ahead_ms_p50']:.0f} ms ahead"
    ]
