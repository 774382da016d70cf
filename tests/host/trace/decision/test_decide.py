"""The rules of the verdict: their order, both sides of each threshold, and what must not matter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import pytest
from trimtab.host.trace.verdict import (
    ALIAS_PROBABILITY,
    RESTLESS,
    RESTLESS_TURN,
    SOMETHING,
    closest_of,
    explained_beyond,
    possible_of,
    restless_of,
    spoken_against,
    substitutes,
    verdict_of,
    with_each_other,
    with_hidden,
)

from tests.host.trace.builders import (
    build_diagnosis,
    build_effect,
    build_fit,
    build_leftover,
    build_space,
    weights_of_nothing,
)
from trimtab.host.trace import verdict as module
from trimtab.host.trace.diagnose import Fit
from trimtab.host.trace.form import Form
from trimtab.host.trace.result import SHOWN
from trimtab.host.trace.search import WITHIN_NATS, Names

QUIET = build_leftover()
REPEATING = build_leftover(force_repeat=1.0, force_z=10.0)
RINGING = build_leftover(torque_line=20.0, torque_line_chance=0.0, torque_line_rms=5.0)

UNSURE = {"drag": {"wind": 0.3}}
SURE: dict[str, dict[str, float]] = {"drag": {}}
BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
"""Factors on a threshold for "just below" and "just above"."""

KEPT_OR_NOT = pytest.mark.parametrize("kept", [(), ("drag",)], ids=["nothing-kept", "kept"])
NOTHING = pytest.mark.parametrize("none", [0.0, 0.01, 0.99], ids="none-{}".format)
ALIASES = pytest.mark.parametrize("aliases", [{}, SURE, UNSURE], ids=["no-entries", "no-aliases", "aliases"])


@pytest.mark.parametrize("rest", [REPEATING, RINGING], ids=["repeats", "rings"])
@pytest.mark.parametrize("doubted", [False, True], ids=["no-doubt", "doubted"])
@KEPT_OR_NOT
@NOTHING
@ALIASES
def test_verdict_of_a_leftover_with_reasons_is_outside_library_whatever_else(
    rest: Any, kept: Names, none: float, aliases: Any, doubted: bool
) -> None:
    diagnosis = build_diagnosis(kept, weights=weights_of_nothing(none, ("drag",)))
    assert verdict_of(diagnosis, rest, aliases, doubted=doubted) == "outside-library"


@KEPT_OR_NOT
@NOTHING
@ALIASES
def test_verdict_of_a_doubted_diagnosis_is_undecided_whatever_was_kept(
    kept: Names, none: float, aliases: Any
) -> None:
    diagnosis = build_diagnosis(kept, weights=weights_of_nothing(none, ("drag",)))
    assert verdict_of(diagnosis, QUIET, aliases, doubted=True) == "undecided"


@pytest.mark.parametrize(
    ("none", "expected"),
    [
        pytest.param(0.0, "undecided", id="impossible"),
        pytest.param(SOMETHING * BELOW, "undecided", id="just-below"),
        pytest.param(SOMETHING, "undecided", id="at"),
        pytest.param(SOMETHING * ABOVE, "nothing-missing", id="just-above"),
        pytest.param(1.0, "nothing-missing", id="certain"),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 2.0**-10], ids=["normalised", "relative"])
def test_verdict_of_nothing_kept_depends_on_the_probability_of_nothing(
    none: float, expected: str, scale: float
) -> None:
    weights = {names: scale * w for names, w in weights_of_nothing(none).items()}
    assert verdict_of(build_diagnosis((), weights=weights), QUIET, {}, doubted=False) == expected


@NOTHING
@pytest.mark.parametrize(
    ("aliases", "expected"),
    [
        pytest.param({}, "traced", id="no-entries"),
        pytest.param({"drag": {}, "gain": {}}, "traced", id="no-aliases"),
        pytest.param({"drag": {}, "gain": {"sag": 0.06}}, "undecided", id="second-has-one"),
        pytest.param({"drag": {"wind": 0.06}, "gain": {}}, "undecided", id="first-has-one"),
    ],
)
def test_verdict_of_kept_effects_depends_on_their_aliases_alone(
    none: float, aliases: Any, expected: str
) -> None:
    diagnosis = build_diagnosis(("drag", "gain"), weights=weights_of_nothing(none, ("drag", "gain")))
    assert verdict_of(diagnosis, QUIET, aliases, doubted=False) == expected


LIBRARY = build_space("drag", "gain", "wind", "lag", "sag")


def shared(share: float, scale: float = 1.0) -> dict[Names, float]:
    """Return weights of which this share is of "wind" in place of "drag"."""
    return {("drag",): scale * (1.0 - share), ("wind",): scale * share}


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        pytest.param(shared(ALIAS_PROBABILITY * BELOW), [], id="just-below"),
        pytest.param({("drag",): 19.0, ("wind",): 1.0}, [], id="a-twentieth"),
        pytest.param(shared(ALIAS_PROBABILITY * ABOVE), ["wind"], id="just-above"),
        pytest.param(shared(0.06, 1e-6), ["wind"], id="relative-weights-above"),
        pytest.param(shared(0.04, 1e6), [], id="relative-weights-below"),
        pytest.param({("drag",): 1.0}, [], id="one-set"),
    ],
)
def test_substitutes_count_from_the_alias_probability_on(
    weights: dict[Names, float], expected: list[str]
) -> None:
    assert list(substitutes(build_diagnosis(("drag",), weights=weights), LIBRARY, "drag")) == expected


def test_substitutes_sum_the_sets_that_have_the_other_and_lack_the_effect() -> None:
    weights = {
        ("drag",): 4.0,
        ("drag", "wind"): 2.0,  # beside it, not in its place
        ("wind",): 1.0,
        ("lag", "wind"): 2.0,
        (): 1.0,
    }
    found = substitutes(build_diagnosis(("drag",), weights=weights), LIBRARY, "drag")
    assert found == pytest.approx({"wind": 0.3, "lag": 0.2})


def test_substitutes_are_ordered_from_the_most_probable_on() -> None:
    weights = {("drag",): 0.4, ("gain",): 0.1, ("wind",): 0.2, ("lag",): 0.3}
    found = substitutes(build_diagnosis(("drag",), weights=weights), LIBRARY, "drag")
    assert list(found) == ["lag", "wind", "gain"]


def test_substitutes_leave_out_what_was_kept_itself() -> None:
    weights = {("drag", "gain"): 0.5, ("gain", "wind"): 0.5}
    diagnosis = build_diagnosis(("drag", "gain"), weights=weights)
    assert substitutes(diagnosis, LIBRARY, "drag") == pytest.approx({"wind": 0.5})
    assert substitutes(diagnosis, LIBRARY, "gain") == {}


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
        pytest.param(SHOWN * BELOW, {"lift": 0.5}, id="just-below"),
        pytest.param(SHOWN, {}, id="at"),
        pytest.param(SHOWN * ABOVE, {}, id="just-above"),
    ],
)
def test_with_hidden_adds_a_known_alias_that_the_flights_would_not_show(
    sigma: float, expected: dict[str, float]
) -> None:
    assert with_hidden({"drag": {}}, HIDING, {"lift": sigma}) == {"drag": expected}


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
def test_with_hidden_takes_known_aliases_only(hidden: str, expected: dict[str, float]) -> None:
    assert with_hidden({"drag": {}}, HIDING, {hidden: 0.0}) == {"drag": expected}


def test_with_hidden_keeps_the_probability_that_the_data_gives() -> None:
    found = with_hidden({"drag": {"lift": 0.2, "lag": 0.1}}, HIDING, {"lift": 0.0, "tilt": 0.0})
    assert found == {"drag": {"tilt": 0.5, "lift": 0.2, "lag": 0.1}}


def test_with_hidden_leaves_out_what_was_named_too() -> None:
    aliases: dict[str, dict[str, float]] = {"drag": {}, "lift": {}}
    assert with_hidden(aliases, HIDING, {"lift": 0.0, "drag": 0.0}) == aliases


def test_with_hidden_of_nothing_is_nothing() -> None:
    assert with_hidden({}, HIDING, {"lift": 0.0}) == {}
    assert with_hidden({"drag": {}}, HIDING, {}) == {"drag": {}}


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
def test_with_each_other_makes_known_aliases_among_the_named_as_probable(
    named: Names, expected: dict[str, dict[str, float]]
) -> None:
    assert with_each_other({name: {} for name in named}, RELATED) == expected


def test_with_each_other_keeps_other_aliases_and_its_input() -> None:
    aliases = {"drag": {"inflow": 0.1, "lift": 0.2}, "lift": {}, "inflow": {}}
    found = with_each_other(aliases, RELATED)
    assert found == {"drag": {"inflow": 0.1, "lift": 0.5}, "lift": {"drag": 0.5}, "inflow": {}}
    assert aliases == {"drag": {"inflow": 0.1, "lift": 0.2}, "lift": {}, "inflow": {}}


@pytest.mark.parametrize(
    ("left", "axial", "restless"),
    [
        pytest.param({}, True, False, id="calm"),
        pytest.param({"lateral": RESTLESS * BELOW}, True, False, id="lateral-below"),
        pytest.param({"lateral": RESTLESS * ABOVE}, True, True, id="lateral-above"),
        pytest.param({"lateral": RESTLESS * ABOVE}, False, True, id="lateral-above-thrust-unknown"),
        pytest.param({"axial": RESTLESS * BELOW}, True, False, id="axial-below"),
        pytest.param({"axial": RESTLESS * ABOVE}, True, True, id="axial-above"),
        pytest.param({"axial": RESTLESS * ABOVE}, False, False, id="axial-above-thrust-unknown"),
        pytest.param({"angular": RESTLESS_TURN * BELOW}, True, False, id="angular-below"),
        pytest.param({"angular": RESTLESS_TURN * ABOVE}, True, True, id="angular-above"),
        pytest.param(
            {"angular": RESTLESS_TURN * ABOVE, "rate_driven": True}, True, False, id="angular-of-a-gyro"
        ),
        pytest.param(
            {"lateral": RESTLESS * ABOVE, "rate_driven": True}, True, True, id="lateral-beside-a-gyro"
        ),
    ],
)
def test_restless_of_a_fit_speaks_above_turbulence(left: dict[str, Any], axial: bool, restless: bool) -> None:
    assert (restless_of(build_fit(**left), axial=axial) is not None) == restless


@pytest.mark.parametrize(
    ("left", "mentioned", "unmentioned"),
    [
        pytest.param({"lateral": 1.7, "axial": 0.6}, "1.7", "0.6", id="the-greater-force"),
        pytest.param({"lateral": 0.6, "axial": 1.7}, "1.7", "0.6", id="axial-the-greater"),
        pytest.param({"angular": 47.0}, "47", "0.0", id="angular"),
        pytest.param({"lateral": 1.7, "angular": 47.0}, "1.7", "47", id="force-before-angular"),
    ],
)
def test_restless_of_a_fit_mentions_how_much_is_left(
    left: dict[str, Any], mentioned: str, unmentioned: str
) -> None:
    said = restless_of(build_fit(**left), axial=True)
    assert said is not None
    assert mentioned in said
    assert unmentioned not in said


KEPT = {(): 0.0, ("drag",): 5.0}


@pytest.mark.parametrize(
    ("evidence", "speaks"),
    [
        pytest.param(-100.0, False, id="worse"),
        pytest.param(5.0 + WITHIN_NATS * BELOW, False, id="just-below"),
        pytest.param(5.0 + WITHIN_NATS * ABOVE, True, id="just-above"),
        pytest.param(100.0, True, id="far-better"),
    ],
)
def test_explained_beyond_counts_from_the_best_set_that_could_be_kept(evidence: float, speaks: bool) -> None:
    found = explained_beyond({**KEPT, ("inflow", "lag"): evidence}, dict.fromkeys(KEPT, 1.0))
    assert (found is not None) == speaks
    if found is not None:
        assert "inflow" in found
        assert "lag" in found
        assert "drag" not in found


def test_explained_beyond_mentions_the_most_probable_set_alone() -> None:
    found = explained_beyond({**KEPT, ("inflow",): 30.0, ("lag",): 40.0}, dict.fromkeys(KEPT, 1.0))
    assert found is not None
    assert "lag" in found
    assert "inflow" not in found


@pytest.mark.parametrize("weight", [1e-12, 1.0])
def test_explained_beyond_without_a_set_that_could_not_be_kept_is_none(weight: float) -> None:
    sets = {**KEPT, ("lag",): 100.0}
    assert explained_beyond(sets, dict.fromkeys(sets, weight)) is None


class KnownRefits:
    """Stand in for `refit` with known evidence; record what was fitted from what."""

    def __init__(self, evidence: Mapping[Names, float]) -> None:
        self.evidence = evidence
        self.calls: list[tuple[Names, Names]] = []

    def __call__(self, form: Form, data: Any, effects: Names, start: Fit) -> Fit:
        self.calls.append((tuple(effects), start.effects))
        return build_fit(tuple(effects), log_evidence=self.evidence[tuple(effects)])


def absent(monkeypatch: pytest.MonkeyPatch, evidence: Mapping[Names, float], kept: Names) -> str | None:
    monkeypatch.setattr(module, "refit", KnownRefits(evidence))
    return spoken_against(cast(Form, None), build_fit(), kept)


@pytest.mark.parametrize(
    ("without", "speaks"),
    [
        pytest.param(-50.0, False, id="needed"),
        pytest.param(10.0, False, id="as-good"),
        pytest.param(10.0 + WITHIN_NATS * BELOW, False, id="just-below"),
        pytest.param(10.0 + WITHIN_NATS * ABOVE, True, id="just-above"),
    ],
)
def test_spoken_against_an_effect_that_segments_do_far_better_without(
    monkeypatch: pytest.MonkeyPatch, without: float, speaks: bool
) -> None:
    evidence = {("drag", "gain"): 10.0, ("gain",): without, ("drag",): -50.0}
    found = absent(monkeypatch, evidence, ("drag", "gain"))
    assert (found is not None) == speaks
    if found is not None:
        assert "drag" in found
        assert "gain" not in found


def test_spoken_against_two_effects_mentions_both(monkeypatch: pytest.MonkeyPatch) -> None:
    evidence = {
        ("drag", "gain", "lag"): 0.0,
        ("gain", "lag"): 9.0,
        ("drag", "lag"): 9.0,
        ("drag", "gain"): 0.0,
    }
    found = absent(monkeypatch, evidence, ("drag", "gain", "lag"))
    assert found is not None
    assert "drag" in found
    assert "gain" in found
    assert "lag" not in found


def test_spoken_against_nothing_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    assert absent(monkeypatch, {(): 0.0}, ()) is None


def test_spoken_against_compares_each_set_without_one_with_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    refits = KnownRefits({("drag", "gain"): 0.0, ("gain",): 0.0, ("drag",): 0.0})
    monkeypatch.setattr(module, "refit", refits)
    assert spoken_against(cast(Form, None), build_fit(), ("drag", "gain")) is None
    assert refits.calls == [
        (("drag", "gain"), ()),
        (("gain",), ("drag", "gain")),
        (("drag",), ("drag", "gain")),
    ]


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
def test_closest_of_aliases_is_the_most_probable_pair(
    aliases: Any, inclusion: dict[str, float], expected: tuple[str, str]
) -> None:
    assert closest_of(aliases, inclusion) == expected


@pytest.mark.parametrize(
    ("inclusion", "expected"),
    [
        pytest.param({}, None, id="none"),
        pytest.param({"drag": 0.9}, None, id="one"),
        pytest.param({"drag": 0.3, "lag": 0.6}, ("lag", "drag"), id="two-the-likelier-first"),
        pytest.param({"drag": 0.3, "lag": 0.6, "gain": 0.4}, ("lag", "gain"), id="three"),
        pytest.param({"drag": 0.9, "lag": ALIAS_PROBABILITY}, None, id="second-at-the-threshold"),
        pytest.param(
            {"drag": 0.9, "lag": ALIAS_PROBABILITY * ABOVE}, ("drag", "lag"), id="second-just-above"
        ),
    ],
)
def test_closest_of_nothing_named_is_the_two_most_probable_candidates(
    inclusion: dict[str, float], expected: tuple[str, str] | None
) -> None:
    assert closest_of({}, inclusion) == expected


def test_closest_of_named_effects_without_aliases_is_none() -> None:
    assert closest_of({"drag": {}, "gain": {}}, {"lag": 0.9, "tilt": 0.8}) is None


@pytest.mark.parametrize(
    ("probability", "possible"),
    [
        pytest.param(ALIAS_PROBABILITY * BELOW, False, id="just-below"),
        pytest.param(ALIAS_PROBABILITY, False, id="at"),
        pytest.param(ALIAS_PROBABILITY * ABOVE, True, id="just-above"),
    ],
)
def test_possible_of_counts_from_the_alias_probability_on(probability: float, possible: bool) -> None:
    found = possible_of(build_diagnosis(inclusion={"lag": probability}), {})
    assert found == ({"lag": probability} if possible else {})


def test_possible_of_leaves_out_kept_effects_and_their_substitutes() -> None:
    inclusion = {"drag": 0.9, "wind": 0.3, "lag": 0.2, "gain": 0.8, "sag": 0.1}
    diagnosis = build_diagnosis(("drag", "gain"), inclusion=inclusion)
    found = possible_of(diagnosis, {"drag": {"wind": 0.3}, "gain": {"sag": 0.1}})
    assert found == {"lag": 0.2}


def test_possible_of_is_ordered_from_the_most_probable_on() -> None:
    diagnosis = build_diagnosis(inclusion={"lag": 0.2, "wind": 0.5, "sag": 0.3})
    assert list(possible_of(diagnosis, {})) == ["wind", "sag", "lag"]


def test_possible_of_nothing_considered_is_empty() -> None:
    assert possible_of(build_diagnosis(), {}) == {}
