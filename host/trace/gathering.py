"""Inputs of the decision, gathered from the fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.decision.decide import DecisionInputs
from trimtab.host.trace.flight_fit.loop import Tracking
from trimtab.host.trace.parameters import RollOutDiverged
from trimtab.host.trace.residual.unexplained import unexplained_residual
from trimtab.host.trace.search import Names, most_probable
from trimtab.host.trace.segment_fit.fit import SegmentFit, disturbance_left, refit, theta_without_effects
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import Diagnosis, selected_set_is_judged


def gather_inputs(
    segment_model: SegmentModel,
    diagnosis: Diagnosis,
    repeat_flights: Sequence[tuple[int, int]],
    unknown: frozenset[str],
    tracking: Tracking,
    late_share: Mapping[str, float],
) -> DecisionInputs:
    """Return the numbers that the verdict depends on.

    Parameters
    ----------
    segment_model
        Model of the segments.
    diagnosis
        Selected effects and their probabilities.
    repeat_flights
        Pairs of indices of repeat flights.
    unknown
        What the logs do not determine, as words such as "torque".
    tracking
        How much the flights track.
    late_share
        For each log, the share of its tracking phase in which time ran late.
    """
    selected, null_fit = diagnosis.selected, diagnosis.null_fit
    axial = "thrust" not in unknown
    after, before = diagnosis.repeatability
    residual = unexplained_residual(*_remainder(segment_model, diagnosis), repeat_flights, axial=axial)
    without = unexplained_residual(
        disturbance_left(null_fit, theta_without_effects(segment_model.space, null_fit)),
        null_fit.data,
        repeat_flights,
        axial=axial,
    )
    by_segments = diagnosis.method == "segments"
    return DecisionInputs(
        space=segment_model.space,
        selected=selected.effects,
        null_probability=diagnosis.null_probability,
        log_evidence=diagnosis.log_evidence,
        posterior_weights=diagnosis.posterior_weights,
        inclusion_probability=diagnosis.inclusion_probability,
        detectability=diagnosis.detectability,
        by_segments=by_segments,
        closed_loop=not by_segments or bool(diagnosis.noise_dependent),
        residual=replace(residual, flight_repeat=after),
        residual_without=replace(without, flight_repeat=before),
        disturbance_sigma=tuple(selected.process.sigma().tolist()),
        thrust_known=axial,
        rate_driven=selected.data.rate_driven,
        segment_disagreement_nats=(
            {}
            if by_segments or repeat_flights or not selected.effects
            else segment_disagreement_nats(segment_model, null_fit, selected.effects)
        ),
        **tracking._asdict(),
        late_share=late_share,
        compared=segment_model.space.rolled is not segment_model.space,
    )


def segment_disagreement_nats(
    segment_model: SegmentModel, null_fit: SegmentFit, selected: Names
) -> dict[str, float]:
    """Return, for each selected effect, by how many nats segments prefer the set without it.

    A set whose model diverges is impossible. If the selected set does, segments confirm none of its effects,
    and all values are 0. null_fit: segment fit without effects. selected: the set, fitted here to the same
    segments.
    """
    whole = _fitted(segment_model, null_fit, selected, null_fit)
    if whole is None:
        return dict.fromkeys(selected, 0.0)
    disagreement = {}
    for name in selected:
        rest = _fitted(segment_model, null_fit, tuple(n for n in selected if n != name), whole)
        disagreement[name] = -np.inf if rest is None else rest.log_evidence - whole.log_evidence
    return disagreement


def _remainder(segment_model: SegmentModel, diagnosis: Diagnosis) -> tuple[np.ndarray, Segments]:
    """Return the unexplained disturbance (segments, bins, 6), FRD, and its segments.

    It is that of the selected set. If the empty set is selected although it is improbable
    (`selected_set_is_judged`), it is that of the most probable set, or if its model diverges, of none.
    """
    selected = diagnosis.selected
    if selected_set_is_judged(diagnosis):
        return disturbance_left(selected, selected.theta_scaled), selected.data
    null_fit = diagnosis.null_fit
    probable = most_probable(diagnosis.posterior_weights)
    judged = _fitted(segment_model, null_fit, probable, null_fit) or null_fit
    return disturbance_left(judged, judged.theta_scaled), judged.data


def _fitted(
    segment_model: SegmentModel, null_fit: SegmentFit, effects: Names, start: SegmentFit
) -> SegmentFit | None:
    """Return the fit of a set to the segments of `null_fit`; None if its model diverges."""
    try:
        return refit(segment_model, null_fit.data, effects, start)
    except RollOutDiverged:
        return None
