"""Shortfalls of tracking, and causes outside the library."""

from __future__ import annotations

from typing import Any

import pytest

from tests.host.trace.builders import (
    build_channel,
    build_effect,
    build_flight_repeat,
    build_inputs,
    build_residual,
    build_space,
)
from tests.host.trace.decision.cases import (
    ABOVE,
    ALONE,
    BELOW,
    HOVER,
    RELATED,
    REPEATING,
    SHORT,
    SLOW,
    codes_of,
    repeating,
    verdict,
    weights,
)
from trimtab.host.trace.decision.alternatives import Names
from trimtab.host.trace.decision.decide import (
    decide,
)
from trimtab.host.trace.decision.findings import Code, Verdict
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.unexplained import SpectralLine, UnexplainedResidual

# Shortfalls of tracking.


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        pytest.param(SHORT, Code.TRACKING_TOO_SHORT, id="short"),
        pytest.param(HOVER, Code.HOVER_ONLY, id="hover"),
        pytest.param(SLOW, Code.POSES_TOO_SLOW, id="slow-poses"),
        pytest.param({**SHORT, **HOVER}, Code.TRACKING_TOO_SHORT, id="short-hover"),
    ],
)
@pytest.mark.parametrize(
    ("selected", "sure"), [((), Verdict.NOTHING_MISSING), (("drag",), Verdict.TRACED)], ids=["null", "drag"]
)
def test_shortfall_alone_does_not_make_the_verdict_undecided(
    changes: dict[str, Any], expected: Code, selected: Names, sure: Verdict
) -> None:
    decision = decide(build_inputs(selected, **changes))
    assert decision.verdict is sure
    assert codes_of(decision.findings) == [expected]


@pytest.mark.parametrize(
    ("changes", "extended"),
    [
        pytest.param({}, False, id="enough"),
        pytest.param({"residual": ALONE}, False, id="enough-without-repeats"),
        pytest.param({"by_segments": True}, False, id="enough-by-segments"),
        pytest.param({"tracking_s": RULES.flight_fit_min_s}, False, id="long-enough"),
        pytest.param({"extent_m": RULES.hover_extent_m}, False, id="wide-enough"),
        pytest.param(SHORT, True, id="short"),
        pytest.param(HOVER, True, id="hover"),
        pytest.param(SLOW, True, id="slow-poses"),
        pytest.param({**SHORT, "by_segments": True, "residual": ALONE}, True, id="short-by-segments"),
    ],
)
def test_undetectable_aliases_count_only_if_tracking_is_short(
    changes: dict[str, Any], extended: bool
) -> None:
    decision = decide(build_inputs(("drag",), space=RELATED, detectability={"lift": 1.0}, **changes))
    assert decision.aliases == {"drag": {"lift": 0.5} if extended else {}}
    assert decision.verdict is (Verdict.UNDECIDED if extended else Verdict.TRACED)
    assert decision.to_separate == (("drag", "lift") if extended else None)
    assert (Code.ALIAS in codes_of(decision.findings)) == extended


def test_short_tracking_leaves_out_detectable_aliases_and_other_effects() -> None:
    shown = build_inputs(("drag",), space=RELATED, detectability={"lift": 9.0, "lag": 1.0}, **SHORT)
    assert decide(shown).aliases == {"drag": {}}


@pytest.mark.parametrize(
    ("changes", "extended"),
    [
        pytest.param({}, False, id="closed-loop-with-repeats"),
        pytest.param({"residual": ALONE}, True, id="closed-loop-without-repeats"),
        pytest.param({"closed_loop": False}, True, id="segments-with-repeats"),
        pytest.param({"closed_loop": False, "residual": ALONE}, True, id="segments-without-repeats"),
        pytest.param(SHORT, False, id="short-with-repeats"),
    ],
)
def test_selected_effects_are_mutual_aliases_only_without_whole_flights_or_repeats(
    changes: dict[str, Any], extended: bool
) -> None:
    decision = decide(build_inputs(("drag", "lift"), space=RELATED, **changes))
    assert decision.aliases == (
        {"drag": {"lift": 0.5}, "lift": {"drag": 0.5}} if extended else {"drag": {}, "lift": {}}
    )
    assert decision.verdict is (Verdict.UNDECIDED if extended else Verdict.TRACED)


# Outside the library.


@pytest.mark.parametrize(
    ("residual", "without", "value"),
    [
        pytest.param(repeating(3.0), repeating(0.5), 0.5, id="without-any-effect-shows-it"),
        pytest.param(repeating(0.5), repeating(3.0), 3.0, id="without-any-effect-shows-more"),
        pytest.param(repeating(3.0), build_residual(), 3.0, id="only-with-effects"),
        pytest.param(repeating(3.0), repeating(0.06 * BELOW), 3.0, id="without-any-effect-just-too-little"),
        pytest.param(repeating(3.0), repeating(0.06 * ABOVE), 0.06 * ABOVE, id="just-enough"),
    ],
)
def test_outside_library_findings_refer_to_the_model_without_effects_if_it_has_any(
    residual: UnexplainedResidual, without: UnexplainedResidual, value: float
) -> None:
    decision = decide(build_inputs(("drag",), residual=residual, residual_without=without))
    assert decision.verdict is Verdict.OUTSIDE_LIBRARY
    assert codes_of(decision.findings) == [Code.FORCE_REPEATS]
    assert decision.findings[0].value == value
    assert decision.residual is (without if value == without.force.repeat else residual)


def test_outside_library_model_without_effects_has_its_own_bounds() -> None:
    """If 3 m/s^2 repeat without effects, 0.3 may remain with them; the bound on the 3 themselves is 0.06."""
    decision = decide(build_inputs(("drag",), residual=repeating(0.31), residual_without=repeating(3.0)))
    assert [(finding.value, finding.bound) for finding in decision.findings] == [(3.0, 0.06)]


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        pytest.param(0.3 * BELOW, Verdict.TRACED, id="just-below"),
        pytest.param(0.3 * ABOVE, Verdict.OUTSIDE_LIBRARY, id="just-above"),
    ],
)
def test_selected_effects_may_leave_a_share_of_the_residual(size: float, expected: Verdict) -> None:
    decision = decide(build_inputs(("drag",), residual=repeating(size), residual_without=repeating(3.0)))
    assert decision.verdict is expected


def test_residual_without_effects_is_no_reason_if_the_effects_explain_it() -> None:
    decision = decide(build_inputs(("drag",), residual_without=repeating(3.0)))
    assert (decision.verdict, decision.findings) == (Verdict.TRACED, ())
    assert decision.residual == build_residual()


def test_effects_that_increase_the_flight_error_are_outside_the_library() -> None:
    one, without = (
        build_residual(flight_repeat=build_flight_repeat(share=0.05, z_score=5.0, position_m=position_m))
        for position_m in (0.12, 0.01)
    )
    decision = decide(build_inputs(("drag",), residual=one, residual_without=without))
    assert decision.verdict is Verdict.OUTSIDE_LIBRARY
    assert [(f.code, f.value, f.bound) for f in decision.findings] == [
        (Code.FLIGHTS_WORSENED, 0.12, pytest.approx(0.015))
    ]
    assert decision.residual is one


SWINGING = build_space(build_effect("payload", memory=2), "drag")


@pytest.mark.parametrize(
    ("selected", "ratio", "expected"),
    [
        pytest.param(("drag",), RULES.line_ratio * ABOVE, Verdict.OUTSIDE_LIBRARY, id="no-memory"),
        pytest.param(("drag", "payload"), RULES.line_ratio * ABOVE, Verdict.TRACED, id="memory"),
        pytest.param(
            ("drag", "payload"),
            RULES.line_ratio_with_memory * ABOVE,
            Verdict.OUTSIDE_LIBRARY,
            id="memory-and-a-stronger-line",
        ),
        pytest.param((), RULES.line_ratio * ABOVE, Verdict.OUTSIDE_LIBRARY, id="nothing-selected"),
    ],
)
def test_selected_effect_with_states_may_leave_some_of_its_swing(
    selected: Names, ratio: float, expected: Verdict
) -> None:
    line = SpectralLine(ratio=ratio, hz=0.7, chance=0.0, rms=9.0)
    residual = build_residual(force=build_channel(line=line))
    assert verdict(selected, space=SWINGING, residual=residual) is expected


@pytest.mark.parametrize("selected", [(), ("drag",)], ids=["nothing-selected", "selected"])
def test_outside_the_library_no_alternatives_are_listed(selected: Names) -> None:
    decision = decide(
        build_inputs(
            selected,
            residual=REPEATING,
            null_probability=0.01,
            posterior_weights=weights(selected, 0.3),
            inclusion_probability={"lag": 0.4, "sag": 0.3},
        )
    )
    assert codes_of(decision.findings) == [Code.FORCE_REPEATS]
    assert (decision.possible, decision.to_separate) == ({}, None)


@pytest.mark.parametrize(
    ("residual", "expected"),
    [
        pytest.param(build_residual(), ["lag"], id="added"),
        pytest.param(REPEATING, ["drag", "lag"], id="outside-library"),
    ],
)
def test_selected_effect_is_hidden_only_if_it_is_not_added(
    residual: UnexplainedResidual, expected: list[str]
) -> None:
    decision = decide(build_inputs(("drag",), residual=residual, detectability={"lag": 1.0, "drag": 2.0}))
    assert [f.subject[0] for f in decision.findings if f.code is Code.HIDDEN] == expected
