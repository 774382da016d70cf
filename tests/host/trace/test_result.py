"""What a trace says of candidates that it does not name."""

from __future__ import annotations

import numpy as np
import pytest

from tests.host.trace.builders import build_diagnosis, build_effect, build_parameter, build_space, build_trace
from trimtab.host.trace.result import SHOWN
from trimtab.host.trace.search import Names

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
LIBRARY = build_space(
    "drag",
    "gain",
    "lag",
    "wind",
    build_effect("rotor", build_parameter("one"), build_parameter("two"), one_of=True),
)
NEVER = -300.0 * np.log(10.0)


@pytest.mark.parametrize(
    ("sigma", "hidden"),
    [
        pytest.param(0.0, ("lag",), id="invisible"),
        pytest.param(SHOWN * BELOW, ("lag",), id="just-below"),
        pytest.param(SHOWN, (), id="at"),
        pytest.param(SHOWN * ABOVE, (), id="just-above"),
    ],
)
def test_hidden_are_effects_that_would_not_stand_out(sigma: float, hidden: Names) -> None:
    assert build_trace(LIBRARY, build_diagnosis(stands_out={"lag": sigma})).hidden == hidden


def test_hidden_are_in_alphabetical_order_without_what_was_named() -> None:
    weak = {"wind": 0.0, "lag": 4.0, "drag": 1.0, "gain": 100.0, "rotor": 2.0}
    diagnosis = build_diagnosis(("drag", "rotor.one"), stands_out=weak)
    # A trace names the effect of which one parameter of several was kept.
    assert build_trace(LIBRARY, diagnosis, named=("drag", "rotor")).hidden == ("lag", "wind")
    assert build_trace(LIBRARY, diagnosis).hidden == ("drag", "lag", "rotor", "wind")


def test_hidden_of_nothing_judged_is_empty() -> None:
    assert build_trace(LIBRARY, build_diagnosis(stands_out={})).hidden == ()


@pytest.mark.parametrize(
    ("kept", "log_weights", "expected"),
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
def test_evidence_is_what_a_candidate_changes_of_the_kept_set(
    kept: Names, log_weights: dict[Names, float], expected: dict[str, float], scale: float
) -> None:
    weights = {names: scale * float(np.exp(value)) for names, value in log_weights.items()}
    found = build_trace(LIBRARY, build_diagnosis(kept, weights=weights)).evidence
    assert found == pytest.approx(expected)


def test_evidence_of_a_set_without_weight_is_finite() -> None:
    weights = {("lag",): 1.0, (): 0.0, ("gain", "lag"): 0.0}
    found = build_trace(LIBRARY, build_diagnosis(("lag",), weights=weights)).evidence
    assert found == pytest.approx({"lag": -NEVER, "gain": NEVER})
