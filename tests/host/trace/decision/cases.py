"""Inputs and parameters that the tests of the decision share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from tests.host.trace.builders import (
    build_channel,
    build_effect,
    build_inputs,
    build_residual,
    build_space,
)
from trimtab.host.trace.decision.alternatives import Names
from trimtab.host.trace.decision.decide import (
    decide,
)
from trimtab.host.trace.decision.findings import Code, Finding, Verdict
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.unexplained import SpectralLine, UnexplainedResidual

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
"""Factors on a threshold for "just below" and "just above"."""
TIE_NATS, OPEN, DETECTABLE = RULES.tie_nats, RULES.alias_probability, RULES.detectable_sigma
FORCE, TORQUE = RULES.excess_force_m_s2, RULES.excess_torque_rad_s2


def codes_of(findings: Sequence[Finding]) -> list[Code]:
    return [finding.code for finding in findings]


def codes(selected: Names = (), **changes: Any) -> list[Code]:
    """Return the codes of all findings of `decide`."""
    return codes_of(decide(build_inputs(selected, **changes)).findings)


def verdict(selected: Names = (), **changes: Any) -> Verdict:
    return decide(build_inputs(selected, **changes)).verdict


REPEATING = build_residual(force=build_channel(repeat=1.0, z_score=10.0))
RINGING = build_residual(torque=build_channel(line=SpectralLine(ratio=20.0, hz=1.0, chance=0.0, rms=5.0)))
ALONE = build_residual(pairs=0)
"""The residual of flights without repeat flights: nothing is unexplained."""
SHAKEN = (2.0,) * 3 + (0.01,) * 3
"""Standard deviations of a disturbance whose force is far beyond turbulence."""
SHORT = {"tracking_s": RULES.flight_fit_min_s * BELOW}
HOVER = {"extent_m": RULES.hover_extent_m * BELOW}
SLOW = {"pose_interval_s": RULES.flight_fit_pose_s * ABOVE}

DOUBTED: dict[str, dict[str, Any]] = {
    "excess": {"residual": ALONE, "disturbance_sigma": SHAKEN},
    "unsupported": {"by_segments": True, "log_evidence": {(): 0.0, ("drag",): 0.0, ("lag",): 100.0}},
    "segments": {"segment_disagreement_nats": {"drag": 100.0}},
}
DOUBTS_OF_ANY_KIND = pytest.mark.parametrize("doubt", DOUBTED)
SELECTED = pytest.mark.parametrize("selected", [(), ("drag",)], ids=["nothing-selected", "selected"])
NULL = pytest.mark.parametrize("null", [0.0, 0.01, 0.99], ids="null-{}".format)
ALIASES = pytest.mark.parametrize("share", [0.0, 0.3], ids=["no-aliases", "aliases"])


def doubted(doubt: str, residual: UnexplainedResidual | None = None) -> dict[str, Any]:
    """Return changes of the inputs that cause a doubt, with `residual` instead of a quiet one."""
    changes = {"log_evidence": {(): 0.0}, **DOUBTED[doubt]}
    if residual is not None:
        changes["residual"] = replace(residual, pairs=0 if doubt == "excess" else residual.pairs)
    return changes


def weights(selected: Names, share: float) -> dict[Names, float]:
    """Return posterior weights with the share `share` for "wind" instead of the selected effect."""
    return {selected: 1.0 - share, ("wind",): share}


RELATED = build_space(build_effect("drag", aliases=("lift",)), build_effect("lift"), build_effect("lag"))


def repeating(size: float) -> UnexplainedResidual:
    """Return a residual whose force repeats by `size` m/s^2."""
    return build_residual(force=build_channel(repeat=size, z_score=10.0))
