"""Alternatives that the data does not exclude: both sides of each threshold, order, and independence."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.host.trace.builders import LIBRARY, build_effect, build_space
from trimtab.host.trace.decision.alternatives import (
    aliases_of,
    pair_to_separate,
    possible_beside,
    with_each_other,
    with_undetectable,
)
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.search import Names

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
"""Factors on a threshold for "just below" and "just above"."""
OPEN, DETECTABLE = RULES.alias_probability, RULES.detectable_sigma


def shared(share: float, scale: float = 1.0) -> dict[Names, float]:
    """Return posterior weights with this share for "wind" instead of "drag"."""
    return {("drag",): scale * (1.0 - share), ("wind",): scale * share}


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        pytest.param(shared(OPEN * BELOW), [], id="just-below"),
        pytest.param({("drag",): 19.0, ("wind",): 1.0}, [], id="a-twentieth"),
        pytest.param(shared(OPEN * ABOVE), ["wind"], id="just-above"),
        pytest.param(shared(0.06, 1e-6), ["wind"], id="relative-weights-above"),
        pytest.param(shared(0.04, 1e6), [], id="relative-weights-below"),
        pytest.param({("drag",): 1.0}, [], id="one-set"),
    ],
)
def test_aliases_of_counts_above_the_alias_probability(
    weights: dict[Names, float], expected: list[str]
) -> None:
    assert list(aliases_of(("drag",), weights, LIBRARY, RULES)["drag"]) == expected


def test_aliases_of_sums_sets_with_the_alias_and_without_the_effect() -> None:
    weights = {
        ("drag",): 4.0,
        ("drag", "wind"): 2.0,  # beside it, not in its place
        ("wind",): 1.0,
        ("lag", "wind"): 2.0,
        (): 1.0,
    }
    alternatives = aliases_of(("drag",), weights, LIBRARY, RULES)
    assert alternatives["drag"] == pytest.approx({"wind": 0.3, "lag": 0.2})


def test_aliases_of_returns_the_most_probable_first() -> None:
    weights = {("drag",): 0.4, ("gain",): 0.1, ("wind",): 0.2, ("lag",): 0.3}
    alternatives = aliases_of(("drag",), weights, LIBRARY, RULES)
    assert list(alternatives["drag"]) == ["lag", "wind", "gain"]


def test_aliases_of_leaves_out_selected_effects() -> None:
    weights = {("drag", "gain"): 0.5, ("gain", "wind"): 0.5}
    alternatives = aliases_of(("drag", "gain"), weights, LIBRARY, RULES)
    assert list(alternatives) == ["drag", "gain"]
    assert alternatives["drag"] == pytest.approx({"wind": 0.5})
    assert alternatives["gain"] == {}


def test_aliases_of_the_empty_set_are_empty() -> None:
    assert aliases_of((), {(): 0.5, ("wind",): 0.5}, LIBRARY, RULES) == {}


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        pytest.param(
            {("drag",): 0.91, ("wind",): 0.04, ("lag",): 0.03, ("gain",): 0.02},
            {"wind": 0.04},
            id="one-more-holds-enough",
        ),
        pytest.param(
            {("drag",): 0.89, ("wind",): 0.04, ("lag",): 0.03, ("gain",): 0.025, ("sag",): 0.015},
            {"wind": 0.04, "lag": 0.03},
            id="two-more-hold-enough",
        ),
        pytest.param(
            {("drag",): 0.93, ("lag", "wind"): 0.04, (): 0.03}, {"wind": 0.04}, id="of-two-in-a-set-one"
        ),
        pytest.param(
            {("drag",): 0.8, ("lag",): 0.1, ("gain",): 0.06, ("wind",): 0.04},
            {"lag": 0.1, "gain": 0.06},
            id="probable-ones-hold-enough",
        ),
        pytest.param(
            {("drag", "sag"): 0.96, ("sag",): 0.02, ("wind",): 0.02},
            {},
            id="the-effect-beside-another-holds-enough",
        ),
        pytest.param({("drag",): 0.9, (): 0.1}, {}, id="nothing-is-no-alias"),
    ],
)
def test_aliases_of_are_listed_until_the_effect_and_they_hold_all_but_the_alias_probability(
    weights: dict[Names, float], expected: dict[str, float]
) -> None:
    """Each alone may be improbable; together they are not."""
    alternatives = aliases_of(("drag",), weights, LIBRARY, RULES)["drag"]
    assert alternatives == pytest.approx(expected)
    assert list(alternatives) == list(expected)


@pytest.mark.parametrize(
    ("rest", "expected"),
    [
        pytest.param(OPEN * BELOW, ["wind"], id="just-held"),
        pytest.param(OPEN * ABOVE, ["wind", "lag"], id="just-not-held"),
    ],
)
def test_aliases_of_stop_at_the_alias_probability(rest: float, expected: list[str]) -> None:
    weights: dict[Names, float] = {
        ("drag",): 0.8 - rest,
        ("wind",): 0.2,
        ("lag",): 0.6 * rest,
        ("sag",): 0.4 * rest,
    }
    assert list(aliases_of(("drag",), weights, LIBRARY, RULES)["drag"]) == expected


HIDING = build_space(
    build_effect("drag", aliases=("lift",)),
    build_effect("lift"),
    build_effect("tilt", aliases=("drag",)),
    build_effect("lag"),
    build_effect("rotor", aliases=("drag",), one_of=True),
)


@pytest.mark.parametrize(
    ("sigma", "expected"),
    [
        pytest.param(0.0, {"lift": 0.5}, id="invisible"),
        pytest.param(DETECTABLE * BELOW, {"lift": 0.5}, id="just-below"),
        pytest.param(DETECTABLE, {}, id="at"),
        pytest.param(DETECTABLE * ABOVE, {}, id="just-above"),
    ],
)
def test_with_undetectable_adds_a_known_undetectable_alias(sigma: float, expected: dict[str, float]) -> None:
    assert with_undetectable({"drag": {}}, HIDING, {"lift": sigma}, RULES) == {"drag": expected}


@pytest.mark.parametrize(
    ("hidden", "expected"),
    [
        pytest.param("lift", {"lift": 0.5}, id="the-effect-names-it"),
        pytest.param("tilt", {"tilt": 0.5}, id="it-names-the-effect"),
        pytest.param("lag", {}, id="neither-names-the-other"),
        pytest.param("rotor", {}, id="one-of-several"),
        pytest.param("drag", {}, id="the-effect-itself"),
    ],
)
def test_with_undetectable_adds_only_known_aliases(hidden: str, expected: dict[str, float]) -> None:
    assert with_undetectable({"drag": {}}, HIDING, {hidden: 0.0}, RULES) == {"drag": expected}


def test_with_undetectable_does_not_overwrite_probabilities() -> None:
    alternatives = with_undetectable(
        {"drag": {"lift": 0.2, "lag": 0.1}}, HIDING, {"lift": 0.0, "tilt": 0.0}, RULES
    )
    assert alternatives == {"drag": {"tilt": 0.5, "lift": 0.2, "lag": 0.1}}


def test_with_undetectable_leaves_out_selected_effects() -> None:
    aliases: dict[str, dict[str, float]] = {"drag": {}, "lift": {}}
    assert with_undetectable(aliases, HIDING, {"lift": 0.0, "drag": 0.0}, RULES) == aliases


def test_with_undetectable_of_no_aliases_is_empty() -> None:
    assert with_undetectable({}, HIDING, {"lift": 0.0}, RULES) == {}
    assert with_undetectable({"drag": {}}, HIDING, {}, RULES) == {"drag": {}}


RELATED = build_space(
    build_effect("drag", aliases=("lift", "wind")),
    build_effect("lift"),
    build_effect("wind", aliases=("drag",), requires_any=("drag",)),
    build_effect("lag", aliases=("delay",), requires_any=("delay",)),
    build_effect("delay"),
    build_effect("inflow"),
    build_effect("rotor", aliases=("lift",), one_of=True),
)


@pytest.mark.parametrize(
    ("named", "expected"),
    [
        pytest.param((), {}, id="none"),
        pytest.param(("drag",), {"drag": {}}, id="one"),
        pytest.param(
            ("drag", "lift"), {"drag": {"lift": 0.5}, "lift": {"drag": 0.5}}, id="one-names-the-other"
        ),
        pytest.param(("lift", "drag"), {"drag": {"lift": 0.5}, "lift": {"drag": 0.5}}, id="in-either-order"),
        pytest.param(("drag", "inflow"), {"drag": {}, "inflow": {}}, id="unrelated"),
        pytest.param(("drag", "wind"), {"drag": {}, "wind": {}}, id="the-second-acts-through-the-first"),
        pytest.param(("lag", "delay"), {"lag": {}, "delay": {}}, id="the-first-acts-through-the-second"),
        pytest.param(
            ("lift", "rotor.size"),
            {"lift": {"rotor.size": 0.5}, "rotor.size": {"lift": 0.5}},
            id="one-parameter-of-several",
        ),
    ],
)
def test_with_each_other_adds_known_aliases_among_selected_effects(
    named: Names, expected: dict[str, dict[str, float]]
) -> None:
    assert with_each_other({name: {} for name in named}, RELATED, RULES) == expected


def test_with_each_other_keeps_other_aliases_and_does_not_change_its_input() -> None:
    aliases = {"drag": {"inflow": 0.1, "lift": 0.2}, "lift": {}, "inflow": {}}
    alternatives = with_each_other(aliases, RELATED, RULES)
    assert alternatives == {"drag": {"inflow": 0.1, "lift": 0.5}, "lift": {"drag": 0.5}, "inflow": {}}
    assert aliases == {"drag": {"inflow": 0.1, "lift": 0.2}, "lift": {}, "inflow": {}}


@pytest.mark.parametrize(
    ("aliases", "expected"),
    [
        pytest.param({"drag": {"wind": 0.1}}, ("drag", "wind"), id="one"),
        pytest.param({"drag": {"wind": 0.1, "lag": 0.4}}, ("drag", "lag"), id="the-more-probable"),
        pytest.param({"drag": {"wind": 0.4}, "gain": {"sag": 0.1}}, ("drag", "wind"), id="the-first-effects"),
        pytest.param({"drag": {"wind": 0.1}, "gain": {"sag": 0.4}}, ("gain", "sag"), id="the-second-effects"),
        pytest.param({"drag": {}, "gain": {"sag": 0.01}}, ("gain", "sag"), id="however-improbable"),
    ],
)
@pytest.mark.parametrize("inclusion", [{}, {"lag": 0.9, "tilt": 0.8}], ids=["alone", "beside-candidates"])
def test_pair_to_separate_of_aliases_is_the_most_probable_pair(
    aliases: Any, inclusion: dict[str, float], expected: tuple[str, str]
) -> None:
    assert pair_to_separate(aliases, inclusion, RULES) == expected


@pytest.mark.parametrize(
    ("inclusion", "expected"),
    [
        pytest.param({}, None, id="none"),
        pytest.param({"drag": 0.9}, None, id="one"),
        pytest.param({"drag": 0.3, "lag": 0.6}, ("lag", "drag"), id="two-the-likelier-first"),
        pytest.param({"drag": 0.3, "lag": 0.6, "gain": 0.4}, ("lag", "gain"), id="three"),
        pytest.param({"drag": 0.9, "lag": OPEN}, None, id="second-at-the-threshold"),
        pytest.param({"drag": 0.9, "lag": OPEN * ABOVE}, ("drag", "lag"), id="second-just-above"),
    ],
)
def test_pair_to_separate_of_the_empty_set_is_the_two_most_probable_candidates(
    inclusion: dict[str, float], expected: tuple[str, str] | None
) -> None:
    assert pair_to_separate({}, inclusion, RULES) == expected


def test_pair_to_separate_of_selected_effects_without_aliases_is_none() -> None:
    assert pair_to_separate({"drag": {}, "gain": {}}, {"lag": 0.9, "tilt": 0.8}, RULES) is None


@pytest.mark.parametrize(
    ("probability", "possible"),
    [
        pytest.param(OPEN * BELOW, False, id="just-below"),
        pytest.param(OPEN, False, id="at"),
        pytest.param(OPEN * ABOVE, True, id="just-above"),
    ],
)
def test_possible_beside_counts_above_the_alias_probability(probability: float, possible: bool) -> None:
    alternatives = possible_beside((), {}, {"lag": probability}, RULES)
    assert alternatives == ({"lag": probability} if possible else {})


def test_possible_beside_leaves_out_selected_effects_and_their_aliases() -> None:
    inclusion = {"drag": 0.9, "wind": 0.3, "lag": 0.2, "gain": 0.8, "sag": 0.1}
    aliases = {"drag": {"wind": 0.3}, "gain": {"sag": 0.1}}
    alternatives = possible_beside(("drag", "gain"), aliases, inclusion, RULES)
    assert alternatives == {"lag": 0.2}


def test_possible_beside_returns_the_most_probable_first() -> None:
    alternatives = possible_beside((), {}, {"lag": 0.2, "wind": 0.5, "sag": 0.3}, RULES)
    assert list(alternatives) == ["wind", "sag", "lag"]


def test_possible_beside_of_no_candidates_is_empty() -> None:
    assert possible_beside((), {}, {}, RULES) == {}


def test_alternatives_use_the_given_rules() -> None:
    surer = replace(RULES, odds=4.0, detectable_sigma=1.0)
    weights: dict[Names, float] = {("drag",): 0.8, ("wind",): 0.2}
    assert aliases_of(("drag",), weights, LIBRARY, RULES) == {"drag": pytest.approx({"wind": 0.2})}
    assert aliases_of(("drag",), weights, LIBRARY, surer) == {"drag": {}}
    assert with_undetectable({"drag": {}}, HIDING, {"lift": 2.0}, RULES) == {"drag": {"lift": 0.5}}
    assert with_undetectable({"drag": {}}, HIDING, {"lift": 2.0}, surer) == {"drag": {}}
    assert possible_beside((), {}, {"lag": 0.2}, RULES) == {"lag": 0.2}
    assert possible_beside((), {}, {"lag": 0.2}, surer) == {}
    assert pair_to_separate({}, {"lag": 0.2, "drag": 0.5}, RULES) == ("drag", "lag")
    assert pair_to_separate({}, {"lag": 0.2, "drag": 0.5}, surer) is None
