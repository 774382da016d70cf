"""The evidence that a verdict is decided by, gathered from the fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.decision.decide import Evidence
from trimtab.host.trace.residual.unexplained import unexplained_residual
from trimtab.host.trace.search import Names, most_probable
from trimtab.host.trace.segment_fit.fit import SegmentFit, disturbance_left, refit, unknowns_only
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import Diagnosis, is_judged


def gather_evidence(
    segment_model: SegmentModel,
    diagnosis: Diagnosis,
    twins: Sequence[tuple[int, int]],
    unknown: frozenset[str],
    tracking_s: float,
    extent_m: float,
) -> Evidence:
    """Return everything that the verdict is decided by."""
    best, nothing = diagnosis.selected, diagnosis.null_fit
    axial = "thrust" not in unknown
    after, before = diagnosis.repeatability
    residual = unexplained_residual(*_remainder(segment_model, diagnosis), twins, axial=axial)
    without = unexplained_residual(
        disturbance_left(nothing, unknowns_only(segment_model.space, nothing)),
        nothing.data,
        twins,
        axial=axial,
    )
    by_segments = diagnosis.method == "segments"
    return Evidence(
        space=segment_model.space,
        selected=best.effects,
        null_probability=diagnosis.null_probability,
        log_evidence=diagnosis.log_evidence,
        posterior_weights=diagnosis.posterior_weights,
        inclusion_probability=diagnosis.inclusion_probability,
        detectability=diagnosis.detectability,
        by_segments=by_segments,
        residual=replace(residual, flights=after),
        residual_without=replace(without, flights=before),
        disturbance_sigma=tuple(best.process.sigma().tolist()),
        thrust_known=axial,
        rate_driven=best.data.rate_driven,
        segment_disagreement_nats=(
            {}
            if by_segments or twins or not best.effects
            else segment_disagreement_nats(segment_model, nothing, best.effects)
        ),
        tracking_s=tracking_s,
        extent_m=extent_m,
    )


def segment_disagreement_nats(
    segment_model: SegmentModel, nothing: SegmentFit, selected: Names
) -> dict[str, float]:
    """Return by how many nats segments prefer the selected set without each of its effects."""
    whole = refit(segment_model, nothing.data, selected, nothing)
    return {
        name: refit(segment_model, nothing.data, tuple(n for n in selected if n != name), whole).log_evidence
        - whole.log_evidence
        for name in selected
    }


def _remainder(segment_model: SegmentModel, diagnosis: Diagnosis) -> tuple[np.ndarray, Segments]:
    """Disturbance (segments, bins, 6) that the library leaves, by which abstention is judged.

    Of the kept set; where none is kept though one is more probable than nothing, of the most probable.
    """
    best = diagnosis.selected
    if is_judged(diagnosis):
        return disturbance_left(best, best.theta_scaled), best.data
    fit = refit(
        segment_model, diagnosis.null_fit.data, most_probable(diagnosis.posterior_weights), diagnosis.null_fit
    )
    return disturbance_left(fit, fit.theta_scaled), fit.data
