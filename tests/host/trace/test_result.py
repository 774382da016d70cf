"""The result of a trace: candidates that it does not name, and the findings that it lists."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.host.trace.builders import (
    build_diagnosis,
    build_effect,
    build_named,
    build_parameter,
    build_space,
    build_trace,
)
from trimtab.host.effects import ExactAlias
from trimtab.host.trace.data.audit import Audit
from trimtab.host.trace.decision.exact_aliases import ObservedAlias
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.search import Names

LIBRARY = build_space(
    "drag",
    "gain",
    "lag",
    "wind",
    build_effect("rotor", build_parameter("one"), build_parameter("two"), one_of=True),
)
NEVER = -300.0 * np.log(10.0)


def test_hidden_are_the_subjects_of_findings_of_that_code_in_order() -> None:
    findings = (
        Finding(code=Code.POSSIBLE, value=0.2, subject=("gain",)),
        Finding(code=Code.HIDDEN, value=1.0, subject=("lag",)),
        Finding(code=Code.HIDDEN, value=2.0, subject=("drag",)),
        Finding(code=Code.ALIAS, value=0.2, subject=("wind", "gain")),
    )
    assert build_trace(LIBRARY, build_diagnosis(), findings=findings).hidden == ("lag", "drag")


def test_hidden_without_findings_is_empty_whatever_the_detectability() -> None:
    assert build_trace(LIBRARY, build_diagnosis(detectability={"lag": 0.0})).hidden == ()


def test_all_findings_are_those_of_the_flights_then_exact_aliases_then_those_of_each_log() -> None:
    whole = Finding(code=Code.HOVER_ONLY, value=0.1)
    exact = Finding(code=Code.EXACT_ALIAS, value=0.9, subject=("drag", "mass"), details={"sd": 0.01})
    logged = [Finding(code=code, log=log) for log, code in (("a", Code.NO_REPEAT), ("b", Code.NO_GYRO))]
    audits = tuple(
        Audit(log=each.log or "", rates=(), largest_gap_s=0.0, stretches=(), findings=(each,))
        for each in logged
    )
    observed = ObservedAlias(alias=ExactAlias(effect="mass", remedy="weigh it"), finding=exact)
    effects = (replace(build_named("drag"), exact_aliases={"mass": observed}), build_named("lag"))
    trace = build_trace(LIBRARY, build_diagnosis(), findings=(whole,), effects=effects, audits=audits)
    assert trace.all_findings == (whole, exact, *logged)


def test_inexact_aliases_leave_out_the_exact_one() -> None:
    exact = Finding(code=Code.EXACT_ALIAS, value=0.9, subject=("thrust-gain", "mass"), details={"sd": 0.01})
    named = replace(build_named("thrust-gain"), aliases={"drag": 0.2, "mass": 0.9})
    observed = ObservedAlias(alias=ExactAlias(effect="mass", remedy="weigh it"), finding=exact)
    assert named.inexact_aliases == {"drag": 0.2, "mass": 0.9}
    assert replace(named, exact_aliases={"mass": observed}).inexact_aliases == {"drag": 0.2}


@pytest.mark.parametrize(
    ("effects", "log_weights", "expected"),
    [
        pytest.param((), {(): 0.0}, {}, id="one-set"),
        pytest.param((), {(): 0.0, ("lag",): -2.0}, {"lag": -2.0}, id="not-kept-loses"),
        pytest.param((), {(): -3.0, ("lag",): 0.0}, {"lag": 3.0}, id="not-kept-gains"),
        pytest.param(("lag",), {("lag",): 0.0, (): -7.0}, {"lag": 7.0}, id="kept-is-needed"),
        pytest.param(("lag",), {("lag",): -1.0, (): 0.0}, {"lag": -1.0}, id="kept-costs"),
        pytest.param(
            ("drag", "lag"),
            {("drag", "lag"): -1.0, ("lag",): -5.0, ("drag", "gain", "lag"): 0.0, ("wind",): -0.5},
            {"drag": 4.0, "gain": 1.0},
            id="neighbours-only",
        ),
        pytest.param(
            ("lag", "drag"),
            {("drag", "lag"): 0.0, ("drag",): -5.0},
            {"lag": 5.0},
            id="kept-in-any-order",
        ),
        pytest.param((), {(): 0.0, ("rotor.two",): -4.0}, {"rotor.two": -4.0}, id="one-parameter-of-several"),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 1e-3], ids=["normalised", "relative"])
def test_evidence_is_the_gain_of_each_candidate_over_the_selected_set(
    effects: Names, log_weights: dict[Names, float], expected: dict[str, float], scale: float
) -> None:
    weights = {names: scale * float(np.exp(value)) for names, value in log_weights.items()}
    nats = build_trace(LIBRARY, build_diagnosis(effects, posterior_weights=weights)).evidence
    assert nats == pytest.approx(expected)


def test_evidence_of_a_set_without_weight_is_finite() -> None:
    weights = {("lag",): 1.0, (): 0.0, ("gain", "lag"): 0.0}
    nats = build_trace(LIBRARY, build_diagnosis(("lag",), posterior_weights=weights)).evidence
    assert nats == pytest.approx({"lag": -NEVER, "gain": NEVER})
