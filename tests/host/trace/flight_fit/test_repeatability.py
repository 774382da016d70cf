"""Repeatability of whole flights: physics repeats between repeat flights, noise does not."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from trimtab.host.trace.decision.findings import Code
from trimtab.host.trace.decision.residual_rules import no_effect_bounds, residual_bounds, residual_findings
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.loop import CHANNELS, ClosedLoop
from trimtab.host.trace.flight_fit.repeatability import repeatability_of
from trimtab.host.trace.residual.unexplained import (
    NO_LINE,
    ChannelResidual,
    FlightRepeat,
    UnexplainedResidual,
)

BINS = 290
REPEAT_FLIGHTS = [(0, 1), (2, 3), (4, 5), (6, 7)]


class ResidualsOnly:
    """Stand-in for a loop with known residuals: gusts, and physics common to repeat flights."""

    def __init__(self, seed: int, physics: float = 0.0, bins: tuple[int, ...] = (BINS,) * 8) -> None:
        rng = np.random.default_rng(seed)
        shared = np.random.default_rng([seed, 1])
        common = [coloured(shared, BINS) for _ in range(4)]
        self.flight_residuals = [
            coloured(rng, count) + physics * common[i // 2][:count] for i, count in enumerate(bins)
        ]
        self.known = [np.arange(count) > 7 for count in bins]

    def residuals(self, theta_scaled: np.ndarray) -> list[np.ndarray]:
        return [each[None] for each in self.flight_residuals]


def coloured(rng: np.random.Generator, bins: int) -> np.ndarray:
    out = rng.standard_normal((bins + 50, CHANNELS)) * np.repeat([1e-4, 1e-3, 1e-2, 1e-2], 3)
    for k in range(1, len(out)):
        out[k] += 0.9 * out[k - 1]
        out[k, :3] += 0.1 * out[k - 1, 3:6]
    return out[50:]


def repeat_of(loop: ResidualsOnly) -> FlightRepeat:
    result = repeatability_of(cast(ClosedLoop, loop), np.zeros(1), 2, REPEAT_FLIGHTS)
    assert result is not None
    return result


def test_gusts_alone_repeat_by_chance_only():
    each = [repeat_of(ResidualsOnly(seed)) for seed in range(30)]
    assert abs(np.mean([r.z_score for r in each])) < 0.6
    assert 0.5 < np.std([r.z_score for r in each]) < 1.5
    assert max(r.share for r in each) < RULES.flight_repeat_chance


@pytest.mark.parametrize("physics", [0.6, 2.0])
def test_common_physics_repeats_with_its_power(physics: float):
    result = repeat_of(ResidualsOnly(3, physics))
    assert result.z_score > 2 * RULES.repeat_z
    assert result.share == pytest.approx(physics**2, rel=0.3)
    assert result.position_m > 0.0


def test_repeat_flights_of_different_length_are_compared_over_the_common_part():
    assert repeat_of(ResidualsOnly(3, 1.0, (BINS, 200) * 4)).share == pytest.approx(1.0, rel=0.4)


def test_repeatability_of_missing_or_short_repeat_flights_is_none():
    assert repeatability_of(cast(ClosedLoop, ResidualsOnly(0)), np.zeros(1), 2, []) is None
    assert (
        repeatability_of(
            cast(ClosedLoop, ResidualsOnly(0, bins=(70, 70) * 4)), np.zeros(1), 2, REPEAT_FLIGHTS
        )
        is None
    )


def test_whole_flights_overrule_segments_in_both_directions():
    segments = by_segments(force=0.5)
    assert codes(segments) == [Code.FORCE_REPEATS]
    calm, moved = repeat_of(ResidualsOnly(4)), repeat_of(ResidualsOnly(4, 1.0))
    assert codes(replace(segments, flight_repeat=calm)) == []
    assert codes(replace(segments, flight_repeat=moved)) == [Code.FLIGHTS_REPEAT, Code.FORCE_REPEATS]


def test_a_small_part_of_the_explained_residual_may_repeat():
    calm_flights = replace(by_segments(force=0.0), flight_repeat=repeat_of(ResidualsOnly(4, 0.7)))
    missing = replace(by_segments(force=1.0), flight_repeat=repeat_of(ResidualsOnly(4, 7.0)))
    assert codes(calm_flights)
    bounds = residual_bounds(missing, has_effects=True, has_memory=False, rules=RULES)
    assert residual_findings(calm_flights, bounds, RULES) == []


def by_segments(force: float) -> UnexplainedResidual:
    """Return the residual of segments in which a force, m/s^2, repeats."""
    return UnexplainedResidual(
        force=ChannelResidual(repeat=force, z_score=20.0 * force, line=NO_LINE),
        torque=ChannelResidual(repeat=0.0, z_score=0.0, line=NO_LINE),
        pairs=4,
    )


def codes(residual: UnexplainedResidual) -> list[Code]:
    return [finding.code for finding in residual_findings(residual, no_effect_bounds(RULES), RULES)]
