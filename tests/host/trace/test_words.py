"""Every code has a sentence, which contains the rounded numbers of its finding."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.host.trace.builders import (
    build_diagnosis,
    build_named,
    build_space,
    build_trace,
)
from trimtab.host.effects import ExactAlias
from trimtab.host.trace import words
from trimtab.host.trace.data.audit import Audit
from trimtab.host.trace.data.stretches import STRETCH_ORDER, UnusedStretch
from trimtab.host.trace.decision.exact_aliases import ObservedAlias
from trimtab.host.trace.decision.findings import DOUBTS, OUTSIDE_LIBRARY_CODES, Code, Finding, Verdict
from trimtab.host.trace.prediction import Errors
from trimtab.host.trace.result import Trace, Value
from trimtab.host.trace.sentences import (
    no_tracking,
    sentence,
    sentences,
    too_few_poses,
    too_few_segments,
    too_few_tracking_poses,
)

EXAMPLES: dict[Code, tuple[Finding, list[str]]] = {
    finding.code: (finding, mentioned)
    for finding, mentioned in [
        (
            Finding(
                code=Code.ADJUSTED_FAR,
                value=2.06,
                bound=2.0,
                unit="tolerances",
                subject=("quadratic-drag", "c", "1/m"),
                details={"value": -0.0206},
            ),
            ["quadratic-drag c -0.0206 1/m", "2.1 tolerances"],
        ),
        (
            Finding(
                code=Code.FLIGHTS_REPEAT,
                value=0.31,
                bound=0.08,
                details={"position_m": 0.0471, "amplitude": 0.62, "z": 12.34},
            ),
            ["47.1 mm", "0.6 times", "z 12.3"],
        ),
        (
            Finding(code=Code.FLIGHTS_WORSENED, value=0.0312, bound=0.0204, unit="m"),
            ["31.2 mm", "20.4 mm"],
        ),
        (
            Finding(code=Code.FORCE_REPEATS, value=1.372, bound=0.06, unit="m/s^2", details={"z": 12.34}),
            ["force of 1.37 m/s^2", "z 12.3"],
        ),
        (
            Finding(code=Code.TORQUE_REPEATS, value=4.561, bound=0.8, unit="rad/s^2", details={"z": 5.67}),
            ["acceleration of 4.56 rad/s^2", "z 5.7"],
        ),
        (
            Finding(code=Code.FORCE_RINGS, value=8.91, bound=3.5, details={"hz": 0.772}),
            ["residual force", "0.77 Hz", "8.9 times"],
        ),
        (
            Finding(code=Code.TORQUE_RINGS, value=8.91, bound=3.5, details={"hz": 2.416}),
            ["residual torque", "2.42 Hz", "8.9 times"],
        ),
        (
            Finding(
                code=Code.FORCE_PULSES,
                value=0.512,
                bound=0.06,
                unit="m/s^2",
                details={"period_s": 3.6, "bearing_deg": 291.4, "ratio": 1.2},
            ),
            ["0.51 m/s^2", "291 degrees", "every 3.6 s"],
        ),
        (Finding(code=Code.TRACKING_TOO_SHORT, value=3.44, bound=9.6, unit="s"), ["3.4 s"]),
        (Finding(code=Code.HOVER_ONLY, value=0.1, bound=0.3, unit="m"), ["hover", "manoeuvres"]),
        (
            Finding(code=Code.POSES_TOO_SLOW, value=0.05, bound=0.04, unit="s"),
            ["50 ms apart, so tracing used segments", "every 40 ms"],
        ),
        (Finding(code=Code.EXCESS_FORCE, value=1.72, bound=0.5, unit="m/s^2"), ["force of 1.7 m/s^2"]),
        (
            Finding(code=Code.EXCESS_TORQUE, value=47.3, bound=3.0, unit="rad/s^2"),
            ["acceleration of 47 rad/s^2"],
        ),
        (
            Finding(
                code=Code.BETTER_BUT_INADMISSIBLE, value=15.0, bound=3.0, unit="nats", subject=("drag", "lag")
            ),
            ["drag, lag"],
        ),
        (
            Finding(code=Code.SEGMENTS_DISAGREE, value=9.0, bound=3.0, unit="nats", subject=("drag", "gain")),
            ["drag, gain", "segments"],
        ),
        (Finding(code=Code.ONLY_HOVER), ["body rate", "weigh"]),
        (
            Finding(code=Code.TIME_RAN_LATE, value=0.4, bound=0.25, log="a.mcap"),
            ["a.mcap", "40", "late"],
        ),
        (
            Finding(code=Code.ALIAS, value=0.256, bound=0.05, subject=("drag", "wind")),
            ["drag may be wind", "0.26"],
        ),
        (
            Finding(
                code=Code.EXACT_ALIAS, value=0.93141, subject=("thrust-gain", "mass"), details={"sd": 0.00251}
            ),
            ["thrust-gain", "mass"],
        ),
        (Finding(code=Code.POSSIBLE, value=0.321, bound=0.05, subject=("sag",)), ["sag", "0.32"]),
        (Finding(code=Code.SOMETHING_MISSING, value=0.987, bound=0.5), ["0.99"]),
        (Finding(code=Code.HIDDEN, value=1.2, bound=4.2, unit="sigma", subject=("lag",)), ["lag"]),
        (Finding(code=Code.NO_REPEAT, log="a"), ["no repeat flight", "reference"]),
        (Finding(code=Code.NO_INPUTS, log="a"), ["no inputs"]),
        (Finding(code=Code.NO_REFERENCE, log="a", subject=("reference",)), ["no reference recorded:"]),
        (Finding(code=Code.NO_GYRO, log="a"), ["no gyro"]),
        (Finding(code=Code.SAMPLED_COMMANDS, log="a"), ["sampled commands"]),
        (
            Finding(
                code=Code.SLOW_COMMANDS,
                value=10.2,
                bound=20.0,
                unit="Hz",
                subject=("/inputs",),
                log="a",
                details={"motor_lag_s": 0.052},
            ),
            ["/inputs at 10 Hz", "52 ms"],
        ),
        (
            Finding(
                code=Code.RATE_DROPS,
                value=12.3,
                bound=50.0,
                unit="Hz",
                subject=("/mocap/pose",),
                log="a",
                details={"median_hz": 99.7},
            ),
            ["/mocap/pose at 100 Hz", "12 Hz"],
        ),
        (
            Finding(
                code=Code.REPEATED_STAMPS, value=7, bound=0, unit="stamps", subject=("/mocap/pose",), log="a"
            ),
            ["/mocap/pose", "7 time stamps"],
        ),
        (Finding(code=Code.CLOCK_DRIFT, value=-0.0043, bound=0.002, unit="s", log="a"), ["-4.3 ms"]),
        (Finding(code=Code.ROTORS_SATURATED, value=0.123, bound=0.01, log="a"), ["12 %"]),
        (
            Finding(
                code=Code.SEGMENTS_LEFT_OUT, value=3, unit="segments", subject=(str(Code.TILTED),), log="a"
            ),
            ["3 segments", "75 deg of tilt"],
        ),
        (Finding(code=Code.SEGMENTS_WITH_GAPS, value=4, unit="segments", log="a"), ["4 segments", "gaps"]),
    ]
}

STRETCHES: dict[Code, str] = {
    Code.CLOCK_JUMP: "clock",
    Code.LATE_POSES: "late",
    Code.MOTOR_AT_LIMIT: "motor",
    Code.PITCH_SINGULAR: "pitch",
    Code.IMPACT: "impact",
    Code.GAP_IN_COMMANDS: "commands",
    Code.GAP_IN_POSES: "poses",
    Code.GROUND_CONTACT: "ground",
    Code.TILTED: "75 deg of tilt",
}

REFUSALS = {
    Code.MIXED_VEHICLES,
    Code.LOG_GIVEN_TWICE,
    Code.HELD_OUT_REFERENCE_USED,
    Code.TOO_FEW_SEGMENTS,
    Code.MIXED_INPUTS,
    Code.TOO_FEW_POSES,
    Code.NO_TRACKING,
    Code.UNDEFINED_UNKNOWN,
    Code.BASELINE_OF_ANOTHER_VEHICLE,
    Code.BASELINE_OUTSIDE_LIBRARY,
    Code.SETS_SHARE_A_FLIGHT,
    Code.SETS_DIFFER_IN_TOPICS,
}


def test_every_code_belongs_to_a_finding_a_stretch_or_an_error() -> None:
    assert sorted(Code) == sorted([*EXAMPLES, *STRETCHES, *REFUSALS])
    assert set(STRETCH_ORDER) == set(STRETCHES)


@pytest.mark.parametrize("code", EXAMPLES)
def test_sentence_of_a_finding_mentions_its_subject_and_numbers(code: Code) -> None:
    finding, mentioned = EXAMPLES[code]
    text = sentence(finding)
    assert [each for each in mentioned if each not in text] == []
    assert not text.endswith(".")
    assert text == text.strip()
    assert "None" not in text


def test_sentences_of_all_findings_are_different() -> None:
    text = [sentence(finding) for finding, _ in EXAMPLES.values()]
    assert len(set(text)) == len(text)


@pytest.mark.parametrize("code", STRETCHES)
def test_reason_of_a_stretch_names_its_cause(code: Code) -> None:
    one = UnusedStretch(start_s=1.234, end_s=5.678, code=code)
    assert STRETCHES[code] in words.reason(one)
    assert words.stretch(one) == f"1.23 to 5.68 s: {words.reason(one)}"
    left_out = Finding(code=Code.SEGMENTS_LEFT_OUT, value=2, unit="segments", subject=(str(code),))
    assert words.reason(one) in sentence(left_out)


def test_sentences_are_those_of_the_codes_in_the_order_of_the_findings() -> None:
    findings = [finding for finding, _ in EXAMPLES.values()]
    for codes in (OUTSIDE_LIBRARY_CODES, DOUBTS, frozenset({Code.SOMETHING_MISSING})):
        expected = [sentence(finding) for finding in findings if finding.code in codes]
        assert len(expected) == len(codes)
        assert sentences(findings, codes) == expected
        assert sentences(findings[::-1], codes) == expected[::-1]
    assert sentences(findings, frozenset()) == []


def audit_of(log: str, *codes: Code, stretches: int = 0, left_out: int = 0) -> Audit:
    return Audit(
        log=log,
        rates=(),
        largest_gap_s=0.01,
        stretches=tuple(
            UnusedStretch(start_s=float(k), end_s=k + 0.5, code=Code.IMPACT) for k in range(stretches)
        ),
        findings=tuple(EXAMPLES[code][0] for code in codes),
        left_out=left_out,
    )


def test_audit_lines_list_stretches_by_log_and_each_remark_once() -> None:
    audits = [
        audit_of("a", Code.NO_REPEAT, stretches=1),
        audit_of("b", Code.NO_REPEAT, Code.NO_GYRO, stretches=7),
        audit_of("c", Code.NO_REPEAT),
    ]
    first, second, no_repeat, gyro = words.audit_lines(audits)
    assert first.startswith("a: not used from 0.00 to 0.50 s: an impact")
    assert "more" not in first
    assert second.startswith("b: ")
    assert second.count("an impact") == 5
    assert second.endswith("and 2 more")
    assert no_repeat == f"a and 2 more: {sentence(EXAMPLES[Code.NO_REPEAT][0])}"
    assert gyro == f"b: {sentence(EXAMPLES[Code.NO_GYRO][0])}"
    assert words.audit_lines([audit_of("c")]) == []


def test_refusals_name_the_log_and_the_reason() -> None:
    path = Path("one.mcap")
    for text, mentioned in [
        (too_few_poses(path), "100 poses"),
        (too_few_tracking_poses(path), "10 poses"),
        (no_tracking(path), "no tracking phase"),
    ]:
        assert text.startswith("one.mcap: ")
        assert mentioned in text
    gaps = Finding(code=Code.SEGMENTS_WITH_GAPS, value=4, unit="segments", log="a")
    text = too_few_segments({"a": [gaps], "b": []}, 2, 0.3 + 0.6)
    assert text.startswith("a, b: only 2 usable segments of 0.9 s")
    assert "(a: 4 segments with gaps" in text


@pytest.mark.parametrize(
    ("decides", "total_time_s", "mentioned"),
    [
        pytest.param(True, None, ["helix", "drag and lag", "6.1 sigma", "now 2.4"], id="decides"),
        pytest.param(True, 12.34, ["(plan it with --time-s 12.3)"], id="with-a-time"),
        pytest.param(
            False, None, ["no known route", "drag from lag", "6.1 sigma", "4.2 sigma are needed"], id="not"
        ),
        pytest.param(False, None, ["; weigh it"], id="another-measurement"),
    ],
)
def test_next_flight_names_the_pair_and_its_separation(
    decides: bool, total_time_s: float | None, mentioned: list[str]
) -> None:
    proposal = SimpleNamespace(
        separates=("drag", "lag"),
        total_time_s=total_time_s,
        decides=decides,
        route="helix",
        expected_sigma=6.12,
        so_far_sigma=2.44,
        measurement="weigh it",
    )
    text = words.next_flight(cast(Any, proposal))
    assert [each for each in mentioned if each not in text] == []


SPACE = build_space("drag", "gain", "lag")


def trace(selected: tuple[str, ...] = (), **changes: Any) -> Trace:
    return build_trace(SPACE, build_diagnosis(selected), **changes)


@pytest.mark.parametrize(
    ("result", "mentioned", "unmentioned"),
    [
        pytest.param(trace(("drag",), named=("drag",)), ["is missing drag"], "may", id="traced"),
        pytest.param(
            trace(("drag",), named=("drag", "gain", "lag")),
            ["is missing drag, gain and lag"],
            "may",
            id="traced-several",
        ),
        pytest.param(
            trace(("drag",), named=("drag",), verdict=Verdict.UNDECIDED),
            ["may be missing drag"],
            "stands out",
            id="undecided",
        ),
        pytest.param(trace(), ["Nothing", "stands out"], "missing", id="nothing-missing"),
        pytest.param(
            trace(verdict=Verdict.OUTSIDE_LIBRARY, findings=(EXAMPLES[Code.FORCE_RINGS][0],)),
            ["library does not hold", sentence(EXAMPLES[Code.FORCE_RINGS][0])],
            "missing",
            id="outside-library",
        ),
    ],
)
def test_verdict_in_words_names_effects_or_reasons(
    result: Trace, mentioned: list[str], unmentioned: str
) -> None:
    text = words.verdict(result)
    assert [each for each in mentioned if each not in text] == []
    assert unmentioned not in text


def build_errors(position_m: float) -> Errors:
    """Return the errors of a flight with a constant position error."""
    off = np.tile([position_m, 0.0, 0.0], (3, 1))
    return Errors(
        flight="a",
        reference_id=None,
        t_s=np.arange(3.0),
        p_error_ned=off,
        v_error_ned=off,
        p_predicted_ned=off,
    )


def test_verdict_with_held_out_flights_ends_with_errors_in_whole_millimetres() -> None:
    before, after = [build_errors(0.0518)] * 2, [build_errors(0.0121)] * 2
    text = words.verdict(trace(("drag",), named=("drag",), before=before, after=after))
    assert text.endswith("On 2 held-out flights the prediction error went from 52 to 12 mm.")
    assert "mm" not in words.verdict(trace(before=before, after=after))


def test_result_lines_hold_the_findings_in_groups() -> None:
    text = [Code.FORCE_RINGS, Code.SOMETHING_MISSING, Code.HOVER_ONLY, Code.HIDDEN, Code.POSSIBLE]
    result = trace(
        verdict=Verdict.UNDECIDED,
        findings=tuple(EXAMPLES[code][0] for code in text),
        possible={"gain": 0.321, "lag": 0.916},
        audits=(audit_of("a", Code.NO_REPEAT),),
    )
    lines = words.result_lines(result)
    assert lines[0] == "verdict: undecided"
    assert lines[1] == "  probable, but not certain enough to name: lag (0.92)"
    lines = lines[1:]
    assert lines[1] == "  not excluded: gain (0.32)"
    assert lines[2] == f"  {sentence(EXAMPLES[Code.SOMETHING_MISSING][0])}"
    assert lines[3] == f"  {sentence(EXAMPLES[Code.HOVER_ONLY][0])}"
    assert lines[4] == "  these flights would not show, at typical size: lag"
    assert lines[5] == f"  {sentence(EXAMPLES[Code.FORCE_RINGS][0])}"
    assert "no flight held out" in lines[6]
    assert lines[7:] == [f"data: a: {sentence(EXAMPLES[Code.NO_REPEAT][0])}"]


def test_verdict_of_an_undecided_trace_without_effects_is_a_sentence() -> None:
    text = words.verdict(trace(verdict=Verdict.UNDECIDED))
    assert "something" in text
    assert " ;" not in text


def test_result_lines_of_an_effect_hold_its_alternatives_and_the_exact_alias_by_itself() -> None:
    exact = EXAMPLES[Code.EXACT_ALIAS][0]
    aliases = {"drag": 0.256, "mass": 0.9}
    alias = ExactAlias(effect="mass", ratio="thrust over mass", remedy="weigh the vehicle")
    observed = ObservedAlias(alias=alias, finding=exact)
    effect = replace(build_named("thrust-gain"), aliases=aliases, exact_aliases={"mass": observed})
    lines = words.result_lines(trace(effects=(effect,)))
    assert "or drag (0.26)" in lines[1]
    assert "or mass" not in lines[1]
    assert lines[2] == f"    {words.exact_alias(observed)}"
    assert "flights show only thrust over mass: 0.9314 +- 0.0050" in lines[2]


def test_card_holds_verdict_effects_reasons_and_what_was_simulated() -> None:
    value = Value(value=0.51234, sd=0.02, unit="1/s")
    effect = replace(build_named("drag<x>"), parameters={"dx": value}, probability=0.875)
    html = words.trace_card(
        trace(
            verdict=Verdict.UNDECIDED,
            findings=(EXAMPLES[Code.HOVER_ONLY][0], EXAMPLES[Code.FORCE_RINGS][0]),
            effects=(effect,),
            possible={"gain": 0.321, "lag": 0.916},
            audits=(audit_of("a"), audit_of("b")),
            simulated_flights=1,
        )
    )
    for text in ("Trace: undecided", "drag&lt;x&gt;", "0.5123", "0.875", "gain (0.32)"):
        assert text in html
    assert "1 of 2 flights simulated" in html
    for code in (Code.HOVER_ONLY, Code.FORCE_RINGS):
        assert escape(sentence(EXAMPLES[code][0])) in html


def test_trace_is_shown_in_one_line() -> None:
    assert repr(trace(named=("drag", "lag"))) == "<Trace traced: drag, lag>"
    assert repr(trace(verdict=Verdict.UNDECIDED)) == "<Trace undecided>"
