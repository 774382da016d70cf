"""The decision: the order of its rules, and the conditions of each rule."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from tests.host.trace.builders import (
    build_inputs,
)
from tests.host.trace.decision.cases import (
    ABOVE,
    ALIASES,
    ALONE,
    BELOW,
    DOUBTED,
    DOUBTS_OF_ANY_KIND,
    HOVER,
    NULL,
    OPEN,
    RELATED,
    REPEATING,
    RINGING,
    SELECTED,
    SHAKEN,
    SHORT,
    codes,
    codes_of,
    doubted,
    repeating,
    verdict,
    weights,
)
from trimtab.host.trace.decision.alternatives import Names
from trimtab.host.trace.decision.decide import (
    decide,
    is_null_open,
)
from trimtab.host.trace.decision.findings import DOUBTS, OUTSIDE_LIBRARY_CODES, Code, Verdict
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.unexplained import UnexplainedResidual


@pytest.mark.parametrize("residual", [REPEATING, RINGING], ids=["repeats", "rings"])
@pytest.mark.parametrize("doubt", [None, *DOUBTED])
@SELECTED
@NULL
@ALIASES
def test_verdict_on_an_unexplained_residual_is_always_outside_library(
    residual: UnexplainedResidual, selected: Names, null: float, share: float, doubt: str | None
) -> None:
    changes = {"residual": residual} if doubt is None else doubted(doubt, residual)
    assert (
        verdict(selected, null_probability=null, **{**changes, "posterior_weights": weights(selected, share)})
        is Verdict.OUTSIDE_LIBRARY
    )


@DOUBTS_OF_ANY_KIND
@SELECTED
@NULL
@ALIASES
def test_verdict_with_a_disagreement_is_undecided_for_any_selection(
    selected: Names, null: float, share: float, doubt: str
) -> None:
    changes = doubted(doubt)
    assert (
        verdict(selected, null_probability=null, **{**changes, "posterior_weights": weights(selected, share)})
        is Verdict.UNDECIDED
    )


@pytest.mark.parametrize(
    ("null", "expected"),
    [
        pytest.param(0.0, Verdict.UNDECIDED, id="impossible"),
        pytest.param(OPEN * BELOW, Verdict.UNDECIDED, id="just-below"),
        pytest.param(OPEN, Verdict.UNDECIDED, id="at"),
        pytest.param(OPEN * ABOVE, Verdict.NOTHING_MISSING, id="just-above"),
        pytest.param(1.0, Verdict.NOTHING_MISSING, id="certain"),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 2.0**-10], ids=["normalised", "relative"])
def test_verdict_of_the_empty_set_depends_on_the_null_probability(
    null: float, expected: Verdict, scale: float
) -> None:
    posterior = {(): scale * null, ("drag",): scale * (1.0 - null)}
    assert verdict((), null_probability=null, posterior_weights=posterior) is expected
    assert is_null_open(null) == (expected is Verdict.NOTHING_MISSING)


@NULL
@pytest.mark.parametrize(
    ("posterior", "expected"),
    [
        pytest.param({("drag", "gain"): 1.0}, Verdict.TRACED, id="one-set"),
        pytest.param({("drag", "gain"): 0.96, ("drag", "sag"): 0.04}, Verdict.TRACED, id="no-aliases"),
        pytest.param({("drag", "gain"): 0.9, ("drag", "sag"): 0.1}, Verdict.UNDECIDED, id="second-has-one"),
        pytest.param({("drag", "gain"): 0.9, ("gain", "wind"): 0.1}, Verdict.UNDECIDED, id="first-has-one"),
        pytest.param({("drag", "gain"): 0.5, ("drag",): 0.5}, Verdict.TRACED, id="one-fewer-is-no-alias"),
        pytest.param(
            {("drag", "gain"): 0.5, ("drag", "gain", "lag"): 0.5}, Verdict.TRACED, id="one-more-is-no-alias"
        ),
    ],
)
def test_verdict_of_selected_effects_depends_only_on_their_aliases(
    null: float, posterior: dict[Names, float], expected: Verdict
) -> None:
    assert verdict(("drag", "gain"), null_probability=null, posterior_weights=posterior) is expected


def test_decision_on_clear_evidence_has_no_findings() -> None:
    traced = decide(build_inputs(("drag",)))
    assert (traced.verdict, traced.findings, traced.within_library) == (Verdict.TRACED, (), True)
    assert (traced.aliases, traced.possible, traced.to_separate) == ({"drag": {}}, {}, None)
    nothing = decide(build_inputs())
    assert (nothing.verdict, nothing.findings, nothing.within_library) == (Verdict.NOTHING_MISSING, (), True)
    assert (nothing.aliases, nothing.possible, nothing.to_separate) == ({}, {}, None)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        pytest.param({}, True, id="traced"),
        pytest.param(DOUBTED["segments"], True, id="undecided"),
        pytest.param({"residual": REPEATING}, False, id="outside-library"),
    ],
)
def test_effects_are_added_unless_the_cause_is_outside_the_library(
    changes: dict[str, Any], expected: bool
) -> None:
    assert decide(build_inputs(("drag",), **changes)).within_library == expected


# Probabilities.


@pytest.mark.parametrize(
    ("by_flights", "nats", "expected"),
    [
        pytest.param(0.999, None, 0.999, id="segments-not-asked"),
        pytest.param(0.999, -math.log(19.0), 0.95, id="segments-less-sure"),
        pytest.param(0.6, -math.log(19.0), 0.6, id="flights-less-sure"),
        pytest.param(0.999, 0.0, 0.5, id="segments-undecided"),
        pytest.param(1.0, math.log(9.0), 0.1, id="segments-against"),
        pytest.param(1.0, -900.0, 1.0, id="both-certain"),
        pytest.param(1.0, 900.0, 0.0, id="segments-certain-against"),
    ],
)
def test_probability_of_an_effect_is_the_smaller_one_of_both_fits(
    by_flights: float, nats: float | None, expected: float
) -> None:
    asked = {} if nats is None else {"drag": nats}
    decision = decide(
        build_inputs(("drag",), inclusion_probability={"drag": by_flights}, segment_disagreement_nats=asked)
    )
    assert decision.probabilities == pytest.approx({"drag": expected})


def test_probabilities_are_those_of_the_selected_effects_each_with_its_own_nats() -> None:
    decision = decide(
        build_inputs(
            ("drag", "gain"),
            inclusion_probability={"drag": 0.98, "gain": 0.97, "lag": 0.3},
            segment_disagreement_nats={"drag": -math.log(3.0), "gain": -50.0},
        )
    )
    assert decision.probabilities == pytest.approx({"drag": 0.75, "gain": 0.97})
    assert decision.possible == {"lag": 0.3}
    assert decide(build_inputs()).probabilities == {}


@pytest.mark.parametrize(
    ("nats", "expected"),
    [
        pytest.param(-RULES.tie_nats * ABOVE, Verdict.TRACED, id="just-confirmed"),
        pytest.param(-RULES.tie_nats * BELOW, Verdict.UNDECIDED, id="just-not-confirmed"),
    ],
)
def test_verdict_needs_each_effect_confirmed_by_segments_that_were_asked(
    nats: float, expected: Verdict
) -> None:
    changes = {"segment_disagreement_nats": {"drag": -50.0, "gain": nats}}
    assert verdict(("drag", "gain"), **changes) is expected


# The order of findings.


@pytest.mark.parametrize(
    ("selected", "changes", "expected"),
    [
        pytest.param(
            ("drag",),
            {"posterior_weights": weights(("drag",), 0.3), "residual": ALONE, "disturbance_sigma": SHAKEN}
            | DOUBTED["segments"],
            [
                Code.TRACKING_TOO_SHORT,
                Code.EXCESS_FORCE,
                Code.SEGMENTS_DISAGREE,
                Code.ALIAS,
                Code.POSSIBLE,
                Code.HIDDEN,
            ],
            id="selected",
        ),
        pytest.param(
            (),
            {"null_probability": 0.01, **doubted("unsupported")},
            [
                Code.TRACKING_TOO_SHORT,
                Code.BETTER_BUT_INADMISSIBLE,
                Code.POSSIBLE,
                Code.SOMETHING_MISSING,
                Code.HIDDEN,
            ],
            id="nothing-selected",
        ),
        pytest.param(
            ("drag",),
            {
                "posterior_weights": weights(("drag",), 0.3),
                "residual": replace(REPEATING, torque=RINGING.torque, pairs=0),
                "disturbance_sigma": SHAKEN,
            }
            | DOUBTED["segments"],
            [
                Code.FORCE_REPEATS,
                Code.TORQUE_RINGS,
                Code.TRACKING_TOO_SHORT,
                Code.EXCESS_FORCE,
                Code.SEGMENTS_DISAGREE,
                Code.HIDDEN,
            ],
            id="outside-library",
        ),
    ],
)
def test_findings_are_ordered_outside_shortfall_disagreement_open_hidden(
    selected: Names, changes: dict[str, Any], expected: list[Code]
) -> None:
    both = {"inclusion_probability": {"sag": 0.3}, "detectability": {"lag": 1.0}, **SHORT}
    assert codes(selected, **{**both, **changes}) == expected


def test_reasons_and_doubts_are_different_codes() -> None:
    assert not OUTSIDE_LIBRARY_CODES & DOUBTS


# Other rules than the default.


@pytest.mark.parametrize(
    ("changes", "rules", "expected", "other"),
    [
        pytest.param(
            {"posterior_weights": weights(("drag",), 0.3)},
            {"odds": 2.0},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="aliases",
        ),
        pytest.param(
            {"segment_disagreement_nats": {"drag": -4.0}},
            {"odds": 1e3},
            Verdict.TRACED,
            Verdict.UNDECIDED,
            id="segments",
        ),
        pytest.param(
            {"by_segments": True, "log_evidence": {("drag",): 0.0, ("lag",): 4.0}},
            {"odds": 1e3},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="unsupported",
        ),
        pytest.param(
            {"residual": ALONE, "disturbance_sigma": SHAKEN},
            {"excess_force_m_s2": 2.1},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="excess-force",
        ),
        pytest.param(
            {"residual": ALONE, "disturbance_sigma": (0.0,) * 5 + (4.0,)},
            {"excess_torque_rad_s2": 4.1},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="excess-torque",
        ),
        pytest.param(
            {"space": RELATED, "detectability": {"lift": 2.0}, **SHORT},
            {"flight_fit_min_s": 1.0},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="tracking-time",
        ),
        pytest.param(
            {"space": RELATED, "detectability": {"lift": 2.0}, **HOVER},
            {"hover_extent_m": 0.1},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="hover",
        ),
        pytest.param(
            {"space": RELATED, "detectability": {"lift": 2.0}, **SHORT},
            {"detectable_sigma": 1.0},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="detectability",
        ),
        pytest.param(
            {"residual": REPEATING},
            {"force_floor_m_s2": 1.1},
            Verdict.OUTSIDE_LIBRARY,
            Verdict.TRACED,
            id="residual",
        ),
        pytest.param(
            {"residual": REPEATING, "residual_without": repeating(5.0)},
            {"equation_error_share": 0.3},
            Verdict.OUTSIDE_LIBRARY,
            Verdict.TRACED,
            id="form-error",
        ),
    ],
)
def test_decision_uses_the_given_rules(
    changes: dict[str, Any], rules: dict[str, float], expected: Verdict, other: Verdict
) -> None:
    inputs = build_inputs(("drag",), **changes)
    assert decide(inputs).verdict is expected
    assert decide(inputs, replace(RULES, **rules)).verdict is other


def test_is_null_probable_uses_the_given_rules() -> None:
    inputs = build_inputs(null_probability=0.04)
    assert decide(inputs).verdict is Verdict.UNDECIDED
    assert decide(inputs, replace(RULES, odds=50.0)).verdict is Verdict.NOTHING_MISSING


def test_hidden_uses_the_given_rules() -> None:
    inputs = build_inputs(detectability={"lag": 2.0})
    assert codes_of(decide(inputs).findings) == [Code.HIDDEN]
    assert decide(inputs, replace(RULES, detectable_sigma=1.0)).findings == ()


def test_decide_does_not_change_its_evidence() -> None:
    changes: dict[str, Any] = {
        "space": RELATED,
        "detectability": {"lift": 2.0},
        "posterior_weights": {("drag",): 0.7, ("lag",): 0.3},
        "residual": ALONE,
        **SHORT,
    }
    inputs, same = (build_inputs(("drag",), **changes) for _ in range(2))
    first = decide(inputs)
    assert inputs == same
    assert decide(inputs) == first
