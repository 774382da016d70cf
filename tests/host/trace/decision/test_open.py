"""Effects that the data does not exclude, and effects that the flights would not show."""

from __future__ import annotations

from typing import Any

import pytest

from tests.host.trace.builders import (
    LIBRARY,
    build_effect,
    build_inputs,
    build_parameter,
    build_space,
)
from tests.host.trace.decision.cases import (
    ABOVE,
    BELOW,
    DETECTABLE,
    DOUBTED,
    OPEN,
    RELATED,
    REPEATING,
    SHORT,
    doubted,
    weights,
)
from trimtab.host.trace.decision.alternatives import Names
from trimtab.host.trace.decision.decide import (
    decide,
    hidden,
)
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.sentences import sentence

# Effects that the data does not exclude.


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
def test_pair_to_separate_is_given_only_if_the_verdict_is_undecided(
    selected: Names, changes: dict[str, Any], expected: tuple[str, str] | None
) -> None:
    assert decide(build_inputs(selected, **changes)).to_separate == expected


def test_alternatives_are_listed_with_their_probability_and_its_bound() -> None:
    posterior: dict[Names, float] = {("drag",): 0.625, ("wind",): 0.25, ("gain",): 0.125}
    inclusion = {"drag": 0.625, "wind": 0.25, "gain": 0.125, "lag": 0.2, "sag": 0.3}
    decision = decide(build_inputs(("drag",), posterior_weights=posterior, inclusion_probability=inclusion))
    assert decision.possible == {"sag": 0.3, "lag": 0.2}
    assert [(f.code, f.subject, f.value, f.bound) for f in decision.findings] == [
        (Code.ALIAS, ("drag", "wind"), 0.25, OPEN),
        (Code.ALIAS, ("drag", "gain"), 0.125, OPEN),
        (Code.POSSIBLE, ("sag",), 0.3, OPEN),
        (Code.POSSIBLE, ("lag",), 0.2, OPEN),
    ]
    assert sentence(decision.findings[0]) == "drag may be wind (0.25)"
    assert sentence(decision.findings[2]) == "sag is not excluded (0.30)"


def test_undetectable_alias_is_not_also_listed_as_possible() -> None:
    decision = decide(
        build_inputs(
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
        pytest.param((), {"null_probability": 0.4, **doubted("unsupported")}, 0.6, id="in-doubt"),
        pytest.param((), {"null_probability": 0.5, **doubted("unsupported")}, None, id="even-in-doubt"),
        pytest.param((), {"null_probability": 0.6, **doubted("unsupported")}, None, id="improbable-in-doubt"),
        pytest.param(("drag",), {"posterior_weights": weights(("drag",), 0.3)}, None, id="selected"),
        pytest.param((), {"null_probability": 0.01, "residual": REPEATING}, None, id="outside-library"),
    ],
)
def test_something_is_missing_if_the_empty_set_is_selected_but_improbable(
    selected: Names, changes: dict[str, Any], expected: float | None
) -> None:
    findings = [
        finding
        for finding in decide(build_inputs(selected, **changes)).findings
        if finding.code is Code.SOMETHING_MISSING
    ]
    assert [finding.value for finding in findings] == ([] if expected is None else [pytest.approx(expected)])
    assert [finding.bound for finding in findings] == [0.5] * len(findings)
    for finding in findings:
        assert f"{expected:.2f}" in sentence(finding)


# Effects that the flights would not show.

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
def test_hidden_returns_undetectable_effects(sigma: float, expected: Names) -> None:
    findings = hidden({"lag": sigma}, (), LIBRARY)
    assert tuple(finding.subject[0] for finding in findings) == expected
    for finding in findings:
        assert finding == Finding(
            code=Code.HIDDEN, value=sigma, bound=DETECTABLE, unit="sigma", subject=("lag",)
        )
        assert "lag" in sentence(finding)
    assert list(decide(build_inputs(detectability={"lag": sigma})).findings) == findings


@pytest.mark.parametrize(
    ("selected", "expected"),
    [
        pytest.param((), ["drag", "lag", "rotor", "wind"], id="nothing-selected"),
        # The candidate is one parameter of the effect; the finding names the effect.
        pytest.param(("drag", "rotor.one"), ["lag", "wind"], id="selected"),
    ],
)
def test_hidden_is_alphabetical_without_selected_effects(selected: Names, expected: list[str]) -> None:
    assert [finding.subject[0] for finding in hidden(WEAK, selected, ROTORS)] == expected


def test_hidden_without_detectabilities_is_empty() -> None:
    assert hidden({}, (), LIBRARY) == []
