"""Doubts about a decision: excess disturbance, unsupported sets, disagreement of segments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from tests.host.trace.builders import (
    build_inputs,
    build_residual,
)
from tests.host.trace.decision.cases import (
    ABOVE,
    ALONE,
    BELOW,
    FORCE,
    REPEATING,
    SHAKEN,
    TIE_NATS,
    TORQUE,
    codes_of,
)
from trimtab.host.trace.decision.alternatives import Names
from trimtab.host.trace.decision.decide import (
    better_but_unsupported,
    decide,
    excess_disturbance,
    segment_disagreement,
)
from trimtab.host.trace.decision.findings import Code, Verdict
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.sentences import sentence

# Time that ran late.

ALLOWED = RULES.late_share


@pytest.mark.parametrize("selected", [(), ("drag",)], ids=["null", "drag"])
def test_flight_in_which_time_ran_late_for_long_leaves_undecided_and_names_nothing(selected: Names) -> None:
    decision = decide(build_inputs(selected, late_share={"a.mcap": ALLOWED, "b.mcap": ALLOWED * ABOVE}))
    (finding,) = (each for each in decision.findings if each.code is Code.TIME_RAN_LATE)
    assert decision.verdict is Verdict.UNDECIDED
    assert (finding.log, finding.value, finding.bound) == ("b.mcap", ALLOWED * ABOVE, ALLOWED)
    assert not decision.within_library
    assert decision.possible == {}
    assert decision.to_separate is None
    assert "b.mcap: time ran late in " in sentence(finding)


def test_flight_in_which_time_ran_late_shortly_is_judged_by_the_rest() -> None:
    decision = decide(build_inputs(("drag",), late_share={"a.mcap": ALLOWED}))
    assert (decision.verdict, decision.within_library) == (Verdict.TRACED, True)


@pytest.mark.parametrize(
    ("share", "expected"),
    [(0.0, Verdict.OUTSIDE_LIBRARY), (0.01, Verdict.UNDECIDED), (0.9, Verdict.UNDECIDED)],
)
def test_late_time_never_makes_a_cause_outside_the_library(share: float, expected: Verdict) -> None:
    decision = decide(build_inputs((), residual=REPEATING, late_share={"a.mcap": share}))
    assert decision.verdict is expected
    assert (Code.TIME_RAN_LATE in codes_of(decision.findings)) == (expected is Verdict.UNDECIDED)


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
def test_excess_disturbance_counts_above_turbulence(
    sigma: Mapping[int, float], changes: dict[str, Any], expected: Code | None
) -> None:
    disturbance = tuple(sigma.get(k, 0.01) for k in range(6))
    inputs = build_inputs(disturbance_sigma=disturbance, residual=ALONE, **changes)
    findings = excess_disturbance(inputs, RULES)
    assert codes_of(findings) == ([] if expected is None else [expected])
    assert list(decide(inputs).findings) == findings


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
def test_excess_disturbance_finding_holds_value_bound_and_unit(
    sigma: tuple[float, ...], expected: tuple[float, float, str], mentioned: str
) -> None:
    (finding,) = excess_disturbance(build_inputs(disturbance_sigma=sigma), RULES)
    assert (finding.value, finding.bound, finding.unit) == expected
    assert mentioned in sentence(finding)


@pytest.mark.parametrize("by_segments", [False, True])
@pytest.mark.parametrize(("pairs", "applied"), [(0, True), (1, False), (3, False)])
def test_excess_disturbance_counts_only_without_repeats(pairs: int, applied: bool, by_segments: bool) -> None:
    changes: dict[str, Any] = {"disturbance_sigma": SHAKEN, "by_segments": by_segments}
    decision = decide(build_inputs(("drag",), residual=build_residual(pairs=pairs), **changes))
    assert codes_of(decision.findings) == ([Code.EXCESS_FORCE] if applied else [])
    assert decision.verdict is (Verdict.UNDECIDED if applied else Verdict.TRACED)


# Sets that are better but unsupported.

SUPPORTED: dict[Names, float] = {(): 0.0, ("drag",): 5.0}


@pytest.mark.parametrize(
    ("nats", "speaks"),
    [
        pytest.param(-100.0, False, id="worse"),
        pytest.param(5.0 + TIE_NATS * BELOW, False, id="just-below"),
        pytest.param(5.0 + TIE_NATS * ABOVE, True, id="just-above"),
        pytest.param(100.0, True, id="far-better"),
    ],
)
def test_better_but_unsupported_counts_from_the_best_supported_set(nats: float, speaks: bool) -> None:
    log_evidence = {**SUPPORTED, ("inflow", "lag"): nats}
    findings = better_but_unsupported(log_evidence, dict.fromkeys(SUPPORTED, 1.0), RULES)
    assert codes_of(findings) == [Code.BETTER_BUT_INADMISSIBLE] * speaks
    for finding in findings:
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
def test_better_but_unsupported_names_only_the_best_such_set(
    others: dict[Names, float], expected: Names
) -> None:
    (finding,) = better_but_unsupported({**SUPPORTED, **others}, dict.fromkeys(SUPPORTED, 1.0), RULES)
    assert finding.subject == expected
    assert finding.value == 35.0


@pytest.mark.parametrize("weight", [1e-12, 1.0])
def test_better_but_unsupported_without_an_unsupported_set_is_empty(weight: float) -> None:
    log_evidence = {**SUPPORTED, ("lag",): 100.0}
    assert better_but_unsupported(log_evidence, dict.fromkeys(log_evidence, weight), RULES) == []


@pytest.mark.parametrize("pairs", [0, 1])
@pytest.mark.parametrize("by_segments", [False, True])
def test_better_but_unsupported_counts_only_for_segments(by_segments: bool, pairs: int) -> None:
    decision = decide(
        build_inputs(
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
        pytest.param({"drag": -TIE_NATS * ABOVE}, (), id="just-confirmed"),
        pytest.param({"drag": -TIE_NATS}, (), id="at"),
        pytest.param({"drag": -TIE_NATS * BELOW}, ("drag",), id="just-not-confirmed"),
        pytest.param({"drag": 0.0}, ("drag",), id="as-good"),
        pytest.param({"drag": 9.0}, ("drag",), id="rejected"),
        pytest.param({"drag": 9.0, "gain": 7.0, "lag": -9.0}, ("drag", "gain"), id="two-of-three"),
        pytest.param({"lag": -9.0, "gain": 7.0, "drag": 9.0}, ("gain", "drag"), id="in-their-order"),
    ],
)
def test_segment_disagreement_names_effects_that_segments_do_not_confirm(
    nats: dict[str, float], expected: Names
) -> None:
    findings = segment_disagreement(nats, RULES)
    assert [finding.subject for finding in findings] == ([expected] if expected else [])
    for finding in findings:
        assert finding.code is Code.SEGMENTS_DISAGREE
        assert (finding.value, finding.bound, finding.unit) == (max(nats.values()), -TIE_NATS, "nats")
        text = sentence(finding)
        assert [name in text for name in nats] == [name in expected for name in nats]


@pytest.mark.parametrize("pairs", [0, 1])
@pytest.mark.parametrize("by_segments", [False, True])
def test_segment_disagreement_counts_only_for_whole_flights(by_segments: bool, pairs: int) -> None:
    decision = decide(
        build_inputs(
            ("drag",),
            segment_disagreement_nats={"drag": 100.0},
            by_segments=by_segments,
            residual=build_residual(pairs=pairs),
        )
    )
    assert codes_of(decision.findings) == ([] if by_segments else [Code.SEGMENTS_DISAGREE])
    assert decision.verdict is (Verdict.TRACED if by_segments else Verdict.UNDECIDED)
