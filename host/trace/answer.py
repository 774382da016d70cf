"""The JSON object of a trace: the numbers of its result, and their sentences."""

from __future__ import annotations

from typing import Any

from trimtab.host.log import settings_json
from trimtab.host.trace import words
from trimtab.host.trace.data.audit import Audit
from trimtab.host.trace.decision.findings import DOUBTS, OUTSIDE_LIBRARY_CODES
from trimtab.host.trace.residual.description import Description
from trimtab.host.trace.residual.unexplained import FlightRepeat
from trimtab.host.trace.result import Baseline, Trace
from trimtab.host.trace.sentences import sentences


def to_json(
    result: Trace,
    *,
    model_path: str | None = None,
    report_path: str | None = None,
    network_path: str | None = None,
) -> dict[str, Any]:
    """Return the JSON object of `trimtab trace`.

    model_path, report_path, network_path: files that were written; None for a file that was not.
    """
    null = {"position_rmse_m": None, "velocity_rmse_m_s": None}
    return {
        "verdict": str(result.verdict),
        "effects": [
            {
                "name": e.name,
                "parameters": {
                    key: {"value": v.value, "sd": v.sd, "unit": v.unit} for key, v in e.parameters.items()
                },
                "probability": e.probability,
                "evidence_nats": result.evidence.get(e.name),
                "aliases": [{"name": n, "probability": p} for n, p in e.aliases.items()],
            }
            for e in result.effects
        ],
        "drive": result.drive,
        "horizon_s": result.horizon_s,
        "before": dict(result.before_score or null),
        "after": dict(result.after_score or null),
        "noise_floor": dict(result.noise_floor),
        "held_out_flights": len(result.before),
        "next_flight": None if result.next_flight is None else result.next_flight.to_json(),
        "baseline": None if result.baseline is None else _baseline(result.baseline),
        "model": model_path,
        "report": report_path,
        "findings": [finding.to_json() for finding in result.all_findings],
        "reasons": sentences(result.findings, OUTSIDE_LIBRARY_CODES),
        "repeats": dict(zip(("after", "before"), map(_repeat, result.diagnosis.repeatability), strict=True)),
        "possible": [{"name": name, "probability": p} for name, p in result.possible.items()],
        "hidden": list(result.hidden),
        "doubts": sentences(result.findings, DOUBTS),
        "description": _description(result.description),
        "unexplained": None if result.unexplained is None else result.unexplained.to_json(network_path),
        "audit": [audit_json(audit) for audit in result.audits],
    }


def _baseline(baseline: Baseline) -> dict[str, Any]:
    """Return the JSON object `baseline`."""
    return {
        "logs": list(baseline.logs),
        "common": {
            owner: {key: {"value": v.value, "sd": v.sd, "unit": v.unit} for key, v in values.items()}
            for owner, values in baseline.common.items()
        },
        "thrust_sd": baseline.thrust_sigma,
        "settings": settings_json(baseline.settings, ("before", "after")),
    }


def _repeat(repeat: FlightRepeat | None) -> dict[str, float] | None:
    """Return an entry of the JSON object `repeats`."""
    if repeat is None:
        return None
    return {"share": repeat.share, "z": repeat.z_score, "position_m": repeat.position_m}


def audit_json(audit: Audit) -> dict[str, Any]:
    """Return the entry of one flight in the JSON list `audit`."""
    return {
        "log": audit.log,
        "used_s": round(audit.used_s, 3),
        "segments": audit.segments,
        "left_out": audit.left_out,
        "largest_gap_s": round(audit.largest_gap_s, 4),
        "rates": [
            {
                "topic": rate.topic,
                "median_hz": round(rate.median_hz, 2),
                "worst_hz": round(rate.worst_hz, 2),
                "sampling": rate.sampling,
            }
            for rate in audit.rates
        ],
        "stretches": [
            {
                "start_s": round(stretch.start_s, 3),
                "end_s": round(stretch.end_s, 3),
                "code": str(stretch.code),
                "reason": words.reason(stretch),
            }
            for stretch in audit.stretches
        ],
        "remarks": words.remarks(audit),
    }


def _description(description: Description | None) -> dict[str, Any] | None:
    """Return the JSON object `description`, including its sentences."""
    if description is None:
        return None
    return {**description.to_json(), "words": words.description(description)}
