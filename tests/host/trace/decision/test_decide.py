"""The decision: the order of its rules, both sides of each threshold, and which rule is applied when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest

from tests.host.trace.builders import (
    LIBRARY,
    build_channel,
    build_effect,
    build_evidence,
    build_flight_repeat,
    build_parameter,
    build_residual,
    build_space,
)
from trimtab.host.trace.decision.alternatives import Names
from trimtab.host.trace.decision.decide import (
    better_but_inadmissible,
    decide,
    excess_disturbance,
    hidden,
    is_null_probable,
    segment_disagreement,
)
from trimtab.host.trace.decision.findings import DOUBTS, UNEXPLAINED, Code, Finding, Verdict
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.unexplained import SpectralLine, UnexplainedResidual
from trimtab.host.trace.sentences import sentence

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
"""Factors on a threshold for "just below" and "just above"."""
TIE_NATS, OPEN, DETECTABLE = RULES.tie_nats, RULES.alias_probability, RULES.detectable_sigma
FORCE, TORQUE = RULES.excess_force_m_s2, RULES.excess_torque_rad_s2


def codes_of(findings: Sequence[Finding]) -> list[Code]:
    return [finding.code for finding in findings]


def codes(selected: Names = (), **changes: Any) -> list[Code]:
    """Return the codes of everything that `decide` finds."""
    return codes_of(decide(build_evidence(selected, **changes)).findings)


def verdict(selected: Names = (), **changes: Any) -> Verdict:
    return decide(build_evidence(selected, **changes)).verdict


REPEATING = build_residual(force=build_channel(repeat=1.0, z_score=10.0))
RINGING = build_residual(torque=build_channel(line=SpectralLine(ratio=20.0, hz=1.0, chance=0.0, rms=5.0)))
ALONE = build_residual(pairs=0)
"""The residual of flights without twins: nothing is unexplained."""
SHAKEN = (2.0,) * 3 + (0.01,) * 3
"""Standard deviations of a disturbance whose force is far beyond turbulence."""
SHORT = {"tracking_s": RULES.flight_fit_min_s * BELOW}
HOVER = {"extent_m": RULES.hover_extent_m * BELOW}

DOUBTED: dict[str, dict[str, Any]] = {
    "excess": {"residual": ALONE, "disturbance_sigma": SHAKEN},
    "inadmissible": {"by_segments": True, "log_evidence": {(): 0.0, ("drag",): 0.0, ("lag",): 100.0}},
    "segments": {"segment_disagreement_nats": {"drag": 100.0}},
}
DOUBTS_OF_ANY_KIND = pytest.mark.parametrize("doubt", DOUBTED)
SELECTED = pytest.mark.parametrize("selected", [(), ("drag",)], ids=["nothing-selected", "selected"])
NULL = pytest.mark.parametrize("null", [0.0, 0.01, 0.99], ids="null-{}".format)
ALIASES = pytest.mark.parametrize("share", [0.0, 0.3], ids=["no-aliases", "aliases"])


def doubted(doubt: str, residual: UnexplainedResidual | None = None) -> dict[str, Any]:
    """Return the changes that raise a doubt, with `residual` in place of a quiet one."""
    changes = {"log_evidence": {(): 0.0}, **DOUBTED[doubt]}
    if residual is not None:
        changes["residual"] = replace(residual, pairs=0 if doubt == "excess" else residual.pairs)
    return changes


def weights(selected: Names, share: float) -> dict[Names, float]:
    """Return posterior weights of which `share` is of "wind" in place of what was selected."""
    return {selected: 1.0 - share, ("wind",): share}


@pytest.mark.parametrize("residual", [REPEATING, RINGING], ids=["repeats", "rings"])
@pytest.mark.parametrize("doubt", [None, *DOUBTED])
@SELECTED
@NULL
@ALIASES
def test_verdict_on_an_unexplained_residual_is_outside_library_whatever_else(
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
def test_verdict_in_doubt_is_undecided_whatever_was_selected(
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
def test_verdict_of_nothing_selected_depends_on_the_null_probability(
    null: float, expected: Verdict, scale: float
) -> None:
    posterior = {(): scale * null, ("drag",): scale * (1.0 - null)}
    assert verdict((), null_probability=null, posterior_weights=posterior) is expected
    assert is_null_probable(null) == (expected is Verdict.NOTHING_MISSING)


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
def test_verdict_of_selected_effects_depends_on_their_aliases_alone(
    null: float, posterior: dict[Names, float], expected: Verdict
) -> None:
    assert verdict(("drag", "gain"), null_probability=null, posterior_weights=posterior) is expected


def test_decision_on_clear_evidence_has_no_findings() -> None:
    traced = decide(build_evidence(("drag",)))
    assert (traced.verdict, traced.findings, traced.effects_added) == (Verdict.TRACED, (), True)
    assert (traced.aliases, traced.possible, traced.to_separate) == ({"drag": {}}, {}, None)
    nothing = decide(build_evidence())
    assert (nothing.verdict, nothing.findings, nothing.effects_added) == (Verdict.NOTHING_MISSING, (), True)
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
    assert decide(build_evidence(("drag",), **changes)).effects_added == expected


# Excess disturbance.


@pytest.mark.parametrize(
    ("sigma", "changes", "expected"),
    [
        pytest.param({}, {}, None, id="calm"),
        pytest.param({0: FORCE * BELOW}, {}, None, id="lateral-below"),
        pytest.param({0: FORCE}, {}, None, id="lateral-at"),
        pytest.param({0: FORCE * ABOVE}, {}, Code.EXCESS_FORCE, id="lateral-above"),
        pytest.param({1: FORCE * ABOVE}, {}, Code.EXCESS_FORCE, id="other-lateral-above"),
        pytest.param(
            {1: FORCE * ABOVE}, {"thrust_known": False}, Code.EXCESS_FORCE, id="lateral-above-thrust-unknown"
        ),
        pytest.param({2: FORCE * BELOW}, {}, None, id="axial-below"),
        pytest.param({2: FORCE * ABOVE}, {}, Code.EXCESS_FORCE, id="axial-above"),
        pytest.param({2: FORCE * ABOVE}, {"thrust_known": False}, None, id="axial-above-thrust-unknown"),
        pytest.param({3: TORQUE * BELOW}, {}, None, id="angular-below"),
        pytest.param({4: TORQUE}, {}, None, id="angular-at"),
        pytest.param({3: TORQUE * ABOVE}, {}, Code.EXCESS_TORQUE, id="angular-above"),
        pytest.param({5: TORQUE * ABOVE}, {}, Code.EXCESS_TORQUE, id="yaw-above"),
        pytest.param(
            {5: TORQUE * ABOVE}, {"thrust_known": False}, Code.EXCESS_TORQUE, id="yaw-above-thrust-unknown"
        ),
        pytest.param({3: TORQUE * ABOVE}, {"rate_driven": True}, None, id="angular-of-a-gyro"),
        pytest.param(
            {0: FORCE * ABOVE}, {"rate_driven": True}, Code.EXCESS_FORCE, id="lateral-beside-a-gyro"
        ),
        pytest.param({0: 1.0, 3: 10.0}, {}, Code.EXCESS_FORCE, id="force-before-torque"),
    ],
)
def test_excess_disturbance_is_what_is_above_turbulence(
    sigma: Mapping[int, float], changes: dict[str, Any], expected: Code | None
) -> None:
    left = tuple(sigma.get(k, 0.01) for k in range(6))
    evidence = build_evidence(disturbance_sigma=left, residual=ALONE, **changes)
    found = excess_disturbance(evidence, RULES)
    assert codes_of(found) == ([] if expected is None else [expected])
    assert list(decide(evidence).findings) == found


@pytest.mark.parametrize(
    ("sigma", "expected", "mentioned"),
    [
        pytest.param(
            (1.7, 1.7, 0.6, 0.01, 0.01, 0.01), (1.7, FORCE, "m/s^2"), "1.7 m/s^2", id="the-greater-force"
        ),
        pytest.param(
            (0.6, 0.6, 1.7, 0.01, 0.01, 0.01), (1.7, FORCE, "m/s^2"), "1.7 m/s^2", id="axial-the-greater"
        ),
        pytest.param(
            (0.01, 0.01, 0.01, 4.0, 47.0, 5.0), (47.0, TORQUE, "rad/s^2"), "47 rad/s^2", id="angular"
        ),
        pytest.param(
            (1.7, 1.7, 0.01, 47.0, 47.0, 47.0), (1.7, FORCE, "m/s^2"), "1.7 m/s^2", id="force-before-angular"
        ),
    ],
)
def test_excess_disturbance_holds_how_much_is_left(
    sigma: tuple[float, ...], expected: tuple[float, float, str], mentioned: str
) -> None:
    (found,) = excess_disturbance(build_evidence(disturbance_sigma=sigma), RULES)
    assert (found.value, found.bound, found.unit) == expected
    assert mentioned in sentence(found)


@pytest.mark.parametrize("by_segments", [False, True])
@pytest.mark.parametrize(("pairs", "applied"), [(0, True), (1, False), (3, False)])
def test_excess_disturbance_counts_only_without_twins(pairs: int, applied: bool, by_segments: bool) -> None:
    changes: dict[str, Any] = {"disturbance_sigma": SHAKEN, "by_segments": by_segments}
    decision = decide(build_evidence(("drag",), residual=build_residual(pairs=pairs), **changes))
    assert codes_of(decision.findings) == ([Code.EXCESS_FORCE] if applied else [])
    assert decision.verdict is (Verdict.UNDECIDED if applied else Verdict.TRACED)


# Sets that are better but inadmissible.

ADMISSIBLE: dict[Names, float] = {(): 0.0, ("drag",): 5.0}


@pytest.mark.parametrize(
    ("nats", "speaks"),
    [
        pytest.param(-100.0, False, id="worse"),
        pytest.param(5.0 + TIE_NATS * BELOW, False, id="just-below"),
        pytest.param(5.0 + TIE_NATS * ABOVE, True, id="just-above"),
        pytest.param(100.0, True, id="far-better"),
    ],
)
def test_better_but_inadmissible_counts_from_the_best_admissible_set(nats: float, speaks: bool) -> None:
    log_evidence = {**ADMISSIBLE, ("inflow", "lag"): nats}
    found = better_but_inadmissible(log_evidence, dict.fromkeys(ADMISSIBLE, 1.0), RULES)
    assert codes_of(found) == [Code.BETTER_BUT_INADMISSIBLE] * speaks
    for finding in found:
        assert finding.subject == ("inflow", "lag")
        assert (finding.value, finding.bound, finding.unit) == (pytest.approx(nats - 5.0), TIE_NATS, "nats")
        assert "inflow, lag" in sentence(finding)
        assert "drag" not in sentence(finding)


@pytest.mark.parametrize(
    ("others", "expected"),
    [
        pytest.param({("inflow",): 30.0, ("lag",): 40.0}, ("lag",), id="the-better"),
        pytest.param({("lag",): 40.0, ("inflow",): 30.0}, ("lag",), id="in-any-order"),
        pytest.param({("lag",): 40.0, ("inflow",): 40.0}, ("lag",), id="equal-by-name"),
        pytest.param({("inflow",): 40.0, ("lag",): 40.0}, ("lag",), id="equal-by-name-in-any-order"),
        pytest.param({("lag",): -9.0, ("inflow",): 40.0}, ("inflow",), id="the-other-far-behind"),
    ],
)
def test_better_but_inadmissible_is_about_the_best_such_set_alone(
    others: dict[Names, float], expected: Names
) -> None:
    (found,) = better_but_inadmissible({**ADMISSIBLE, **others}, dict.fromkeys(ADMISSIBLE, 1.0), RULES)
    assert found.subject == expected
    assert found.value == 35.0


@pytest.mark.parametrize("weight", [1e-12, 1.0])
def test_better_but_inadmissible_without_an_inadmissible_set_is_nothing(weight: float) -> None:
    log_evidence = {**ADMISSIBLE, ("lag",): 100.0}
    assert better_but_inadmissible(log_evidence, dict.fromkeys(log_evidence, weight), RULES) == []


@pytest.mark.parametrize("pairs", [0, 1])
@pytest.mark.parametrize("by_segments", [False, True])
def test_better_but_inadmissible_counts_only_by_segments(by_segments: bool, pairs: int) -> None:
    decision = decide(
        build_evidence(
            ("drag",),
            log_evidence={("drag",): 0.0, ("lag",): 100.0},
            by_segments=by_segments,
            residual=build_residual(pairs=pairs),
        )
    )
    assert codes_of(decision.findings) == [Code.BETTER_BUT_INADMISSIBLE] * by_segments
    assert decision.verdict is (Verdict.UNDECIDED if by_segments else Verdict.TRACED)


# Segments that disagree.


@pytest.mark.parametrize(
    ("nats", "expected"),
    [
        pytest.param({}, (), id="not-asked"),
        pytest.param({"drag": -50.0}, (), id="needed"),
        pytest.param({"drag": 0.0}, (), id="as-good"),
        pytest.param({"drag": TIE_NATS * BELOW}, (), id="just-below"),
        pytest.param({"drag": TIE_NATS}, (), id="at"),
        pytest.param({"drag": TIE_NATS * ABOVE}, ("drag",), id="just-above"),
        pytest.param({"drag": 9.0, "gain": 7.0, "lag": 0.0}, ("drag", "gain"), id="two-of-three"),
        pytest.param({"lag": -1.0, "gain": 7.0, "drag": 9.0}, ("gain", "drag"), id="in-their-order"),
    ],
)
def test_segment_disagreement_is_about_effects_that_segments_find_absent(
    nats: dict[str, float], expected: Names
) -> None:
    found = segment_disagreement(nats, RULES)
    assert [finding.subject for finding in found] == ([expected] if expected else [])
    for finding in found:
        assert finding.code is Code.SEGMENTS_DISAGREE
        assert (finding.value, finding.bound, finding.unit) == (max(nats.values()), TIE_NATS, "nats")
        told = sentence(finding)
        assert [name in told for name in nats] == [name in expected for name in nats]


@pytest.mark.parametrize("pairs", [0, 1])
@pytest.mark.parametrize("by_segments", [False, True])
def test_segment_disagreement_counts_only_over_the_closed_loop(by_segments: bool, pairs: int) -> None:
    decision = decide(
        build_evidence(
            ("drag",),
            segment_disagreement_nats={"drag": 100.0},
            by_segments=by_segments,
            residual=build_residual(pairs=pairs),
        )
    )
    assert codes_of(decision.findings) == ([] if by_segments else [Code.SEGMENTS_DISAGREE])
    assert decision.verdict is (Verdict.TRACED if by_segments else Verdict.UNDECIDED)


# Shortfalls of tracking.

RELATED = build_space(build_effect("drag", aliases=("lift",)), build_effect("lift"), build_effect("lag"))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        pytest.param(SHORT, Code.TRACKING_TOO_SHORT, id="short"),
        pytest.param(HOVER, Code.HOVER_ONLY, id="hover"),
        pytest.param({**SHORT, **HOVER}, Code.TRACKING_TOO_SHORT, id="short-hover"),
    ],
)
@pytest.mark.parametrize(
    ("selected", "sure"), [((), Verdict.NOTHING_MISSING), (("drag",), Verdict.TRACED)], ids=["null", "drag"]
)
def test_shortfall_alone_does_not_make_the_verdict_undecided(
    changes: dict[str, Any], expected: Code, selected: Names, sure: Verdict
) -> None:
    decision = decide(build_evidence(selected, **changes))
    assert decision.verdict is sure
    assert codes_of(decision.findings) == [expected]


@pytest.mark.parametrize(
    ("changes", "extended"),
    [
        pytest.param({}, False, id="enough"),
        pytest.param({"residual": ALONE}, False, id="enough-without-twins"),
        pytest.param({"by_segments": True}, False, id="enough-by-segments"),
        pytest.param({"tracking_s": RULES.flight_fit_min_s}, False, id="long-enough"),
        pytest.param({"extent_m": RULES.hover_extent_m}, False, id="wide-enough"),
        pytest.param(SHORT, True, id="short"),
        pytest.param(HOVER, True, id="hover"),
        pytest.param({**SHORT, "by_segments": True, "residual": ALONE}, True, id="short-by-segments"),
    ],
)
def test_undetectable_aliases_count_only_where_tracking_falls_short(
    changes: dict[str, Any], extended: bool
) -> None:
    decision = decide(build_evidence(("drag",), space=RELATED, detectability={"lift": 1.0}, **changes))
    assert decision.aliases == {"drag": {"lift": 0.5} if extended else {}}
    assert decision.verdict is (Verdict.UNDECIDED if extended else Verdict.TRACED)
    assert decision.to_separate == (("drag", "lift") if extended else None)
    assert (Code.ALIAS in codes_of(decision.findings)) == extended


def test_aliases_that_would_show_and_effects_that_are_no_aliases_are_left_out_of_short_tracking() -> None:
    shown = build_evidence(("drag",), space=RELATED, detectability={"lift": 9.0, "lag": 1.0}, **SHORT)
    assert decide(shown).aliases == {"drag": {}}


@pytest.mark.parametrize(
    ("changes", "extended"),
    [
        pytest.param({}, False, id="closed-loop-with-twins"),
        pytest.param({"residual": ALONE}, True, id="closed-loop-without-twins"),
        pytest.param({"by_segments": True}, True, id="segments-with-twins"),
        pytest.param({"by_segments": True, "residual": ALONE}, True, id="segments-without-twins"),
        pytest.param(SHORT, False, id="short-with-twins"),
    ],
)
def test_selected_effects_are_aliases_of_each_other_only_by_segments_or_without_twins(
    changes: dict[str, Any], extended: bool
) -> None:
    decision = decide(build_evidence(("drag", "lift"), space=RELATED, **changes))
    assert decision.aliases == (
        {"drag": {"lift": 0.5}, "lift": {"drag": 0.5}} if extended else {"drag": {}, "lift": {}}
    )
    assert decision.verdict is (Verdict.UNDECIDED if extended else Verdict.TRACED)


# Outside the library.


def repeating(size: float) -> UnexplainedResidual:
    """Return a residual whose force repeats by `size` m/s^2."""
    return build_residual(force=build_channel(repeat=size, z_score=10.0))


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
def test_outside_the_library_the_finding_is_about_no_effect_where_that_shows_something(
    residual: UnexplainedResidual, without: UnexplainedResidual, value: float
) -> None:
    decision = decide(build_evidence(("drag",), residual=residual, residual_without=without))
    assert decision.verdict is Verdict.OUTSIDE_LIBRARY
    assert codes_of(decision.findings) == [Code.FORCE_REPEATS]
    assert decision.findings[0].value == value
    assert decision.residual is (without if value == without.force.repeat else residual)


def test_outside_the_library_what_is_about_no_effect_is_held_against_its_own_bounds() -> None:
    """Beside 3 m/s^2 that repeat without any effect, 0.3 may remain; the 3 themselves may be 0.06."""
    decision = decide(build_evidence(("drag",), residual=repeating(0.31), residual_without=repeating(3.0)))
    assert [(finding.value, finding.bound) for finding in decision.findings] == [(3.0, 0.06)]


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        pytest.param(0.3 * BELOW, Verdict.TRACED, id="just-below"),
        pytest.param(0.3 * ABOVE, Verdict.OUTSIDE_LIBRARY, id="just-above"),
    ],
)
def test_selected_effects_may_leave_a_share_of_what_they_explain(size: float, expected: Verdict) -> None:
    decision = decide(build_evidence(("drag",), residual=repeating(size), residual_without=repeating(3.0)))
    assert decision.verdict is expected


def test_a_residual_without_any_effect_is_no_reason_where_the_effects_explain_it() -> None:
    decision = decide(build_evidence(("drag",), residual_without=repeating(3.0)))
    assert (decision.verdict, decision.findings) == (Verdict.TRACED, ())
    assert decision.residual == build_residual()


def test_effects_that_make_whole_flights_worse_are_outside_the_library() -> None:
    one, without = (
        build_residual(flights=build_flight_repeat(share=0.05, z_score=5.0, position_m=position_m))
        for position_m in (0.12, 0.01)
    )
    decision = decide(build_evidence(("drag",), residual=one, residual_without=without))
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
def test_a_selected_effect_with_states_of_its_own_may_leave_some_of_its_swing(
    selected: Names, ratio: float, expected: Verdict
) -> None:
    line = SpectralLine(ratio=ratio, hz=0.7, chance=0.0, rms=9.0)
    residual = build_residual(force=build_channel(line=line))
    assert verdict(selected, space=SWINGING, residual=residual) is expected


@pytest.mark.parametrize("selected", [(), ("drag",)], ids=["nothing-selected", "selected"])
def test_outside_the_library_no_alternatives_are_listed(selected: Names) -> None:
    decision = decide(
        build_evidence(
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
def test_a_selected_effect_is_hidden_only_where_it_is_not_added(
    residual: UnexplainedResidual, expected: list[str]
) -> None:
    decision = decide(build_evidence(("drag",), residual=residual, detectability={"lag": 1.0, "drag": 2.0}))
    assert [f.subject[0] for f in decision.findings if f.code is Code.HIDDEN] == expected


# What the data leaves open.


@pytest.mark.parametrize(
    ("selected", "changes", "expected"),
    [
        pytest.param(("drag",), {"posterior_weights": weights(("drag",), 0.3)}, ("drag", "wind"), id="alias"),
        pytest.param(("drag",), {}, None, id="traced"),
        pytest.param((), {"inclusion_probability": {"lag": 0.4, "sag": 0.3}}, None, id="nothing-missing"),
        pytest.param(
            (),
            {"null_probability": 0.0, "inclusion_probability": {"lag": 0.4, "sag": 0.3}},
            ("lag", "sag"),
            id="something-missing",
        ),
        pytest.param(
            ("drag",),
            {"posterior_weights": weights(("drag",), 0.3), "residual": REPEATING},
            None,
            id="outside-library",
        ),
        pytest.param(("drag",), DOUBTED["segments"], None, id="in-doubt-without-alternatives"),
    ],
)
def test_pair_to_separate_is_given_only_where_the_verdict_is_undecided(
    selected: Names, changes: dict[str, Any], expected: tuple[str, str] | None
) -> None:
    assert decide(build_evidence(selected, **changes)).to_separate == expected


def test_alternatives_are_listed_with_their_probability_and_its_bound() -> None:
    posterior: dict[Names, float] = {("drag",): 0.625, ("wind",): 0.25, ("gain",): 0.125}
    inclusion = {"drag": 0.625, "wind": 0.25, "gain": 0.125, "lag": 0.2, "sag": 0.3}
    decision = decide(build_evidence(("drag",), posterior_weights=posterior, inclusion_probability=inclusion))
    assert decision.possible == {"sag": 0.3, "lag": 0.2}
    assert [(f.code, f.subject, f.value, f.bound) for f in decision.findings] == [
        (Code.ALIAS, ("drag", "wind"), 0.25, OPEN),
        (Code.ALIAS, ("drag", "gain"), 0.125, OPEN),
        (Code.POSSIBLE, ("sag",), 0.3, OPEN),
        (Code.POSSIBLE, ("lag",), 0.2, OPEN),
    ]
    assert sentence(decision.findings[0]) == "drag may be wind (0.25)"
    assert sentence(decision.findings[2]) == "sag is not excluded (0.30)"


def test_an_undetectable_alias_is_not_listed_as_possible_too() -> None:
    decision = decide(
        build_evidence(
            ("drag",),
            space=RELATED,
            detectability={"lift": 1.0},
            inclusion_probability={"lift": 0.2, "lag": 0.1},
            **SHORT,
        )
    )
    assert decision.possible == {"lag": 0.1}


@pytest.mark.parametrize(
    ("selected", "changes", "expected"),
    [
        pytest.param((), {"null_probability": 0.01}, 0.99, id="nothing-selected"),
        pytest.param((), {"null_probability": OPEN}, 1.0 - OPEN, id="null-probability-at"),
        pytest.param((), {"null_probability": OPEN * ABOVE}, None, id="nothing-missing"),
        pytest.param((), {"null_probability": 0.4, **doubted("inadmissible")}, 0.6, id="in-doubt"),
        pytest.param((), {"null_probability": 0.5, **doubted("inadmissible")}, None, id="even-in-doubt"),
        pytest.param(
            (), {"null_probability": 0.6, **doubted("inadmissible")}, None, id="improbable-in-doubt"
        ),
        pytest.param(("drag",), {"posterior_weights": weights(("drag",), 0.3)}, None, id="selected"),
        pytest.param((), {"null_probability": 0.01, "residual": REPEATING}, None, id="outside-library"),
    ],
)
def test_something_is_missing_where_nothing_is_selected_though_nothing_is_improbable(
    selected: Names, changes: dict[str, Any], expected: float | None
) -> None:
    found = [
        finding
        for finding in decide(build_evidence(selected, **changes)).findings
        if finding.code is Code.SOMETHING_MISSING
    ]
    assert [finding.value for finding in found] == ([] if expected is None else [pytest.approx(expected)])
    assert [finding.bound for finding in found] == [0.5] * len(found)
    for finding in found:
        assert f"{expected:.2f}" in sentence(finding)


# What these flights would not show.

WEAK = {"wind": 0.0, "lag": 4.0, "drag": 1.0, "gain": 100.0, "rotor": 2.0}
ROTORS = build_space(
    "drag",
    "gain",
    "lag",
    "wind",
    build_effect("rotor", build_parameter("one"), build_parameter("two"), one_of=True),
)


@pytest.mark.parametrize(
    ("sigma", "expected"),
    [
        pytest.param(0.0, ("lag",), id="invisible"),
        pytest.param(DETECTABLE * BELOW, ("lag",), id="just-below"),
        pytest.param(DETECTABLE, (), id="at"),
        pytest.param(DETECTABLE * ABOVE, (), id="just-above"),
    ],
)
def test_hidden_are_effects_that_would_not_stand_out(sigma: float, expected: Names) -> None:
    found = hidden({"lag": sigma}, (), LIBRARY)
    assert tuple(finding.subject[0] for finding in found) == expected
    for finding in found:
        assert finding == Finding(
            code=Code.HIDDEN, value=sigma, bound=DETECTABLE, unit="sigma", subject=("lag",)
        )
        assert "lag" in sentence(finding)
    assert list(decide(build_evidence(detectability={"lag": sigma})).findings) == found


@pytest.mark.parametrize(
    ("selected", "expected"),
    [
        pytest.param((), ["drag", "lag", "rotor", "wind"], id="nothing-selected"),
        # The candidate is one parameter of several; what is hidden is the effect.
        pytest.param(("drag", "rotor.one"), ["lag", "wind"], id="selected"),
    ],
)
def test_hidden_are_in_alphabetical_order_without_what_was_selected(
    selected: Names, expected: list[str]
) -> None:
    assert [finding.subject[0] for finding in hidden(WEAK, selected, ROTORS)] == expected


def test_hidden_of_nothing_judged_is_empty() -> None:
    assert hidden({}, (), LIBRARY) == []


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
            {"null_probability": 0.01, **doubted("inadmissible")},
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
def test_findings_are_outside_then_shortfall_then_disagreement_then_open_then_hidden(
    selected: Names, changes: dict[str, Any], expected: list[Code]
) -> None:
    both = {"inclusion_probability": {"sag": 0.3}, "detectability": {"lag": 1.0}, **SHORT}
    assert codes(selected, **{**both, **changes}) == expected


def test_reasons_and_doubts_are_different_codes() -> None:
    assert not UNEXPLAINED & DOUBTS


# The rules that are given.


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
            {"segment_disagreement_nats": {"drag": 4.0}},
            {"odds": 1e3},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="segments",
        ),
        pytest.param(
            {"by_segments": True, "log_evidence": {("drag",): 0.0, ("lag",): 4.0}},
            {"odds": 1e3},
            Verdict.UNDECIDED,
            Verdict.TRACED,
            id="inadmissible",
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
            {"form_error_share": 0.3},
            Verdict.OUTSIDE_LIBRARY,
            Verdict.TRACED,
            id="form-error",
        ),
    ],
)
def test_decision_follows_the_rules_that_are_given(
    changes: dict[str, Any], rules: dict[str, float], expected: Verdict, other: Verdict
) -> None:
    evidence = build_evidence(("drag",), **changes)
    assert decide(evidence).verdict is expected
    assert decide(evidence, replace(RULES, **rules)).verdict is other


def test_null_probability_follows_the_rules_that_are_given() -> None:
    evidence = build_evidence(null_probability=0.04)
    assert decide(evidence).verdict is Verdict.UNDECIDED
    assert decide(evidence, replace(RULES, odds=50.0)).verdict is Verdict.NOTHING_MISSING


def test_hidden_effects_follow_the_rules_that_are_given() -> None:
    evidence = build_evidence(detectability={"lag": 2.0})
    assert codes_of(decide(evidence).findings) == [Code.HIDDEN]
    assert decide(evidence, replace(RULES, detectable_sigma=1.0)).findings == ()


def test_decision_changes_nothing_of_its_evidence() -> None:
    changes: dict[str, Any] = {
        "space": RELATED,
        "detectability": {"lift": 2.0},
        "posterior_weights": {("drag",): 0.7, ("lag",): 0.3},
        "residual": ALONE,
        **SHORT,
    }
    evidence, same = (build_evidence(("drag",), **changes) for _ in range(2))
    first = decide(evidence)
    assert evidence == same
    assert decide(evidence) == first
