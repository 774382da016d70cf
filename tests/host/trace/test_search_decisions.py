"""Selection among several sets, and the sizes of their effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest

from tests.host.trace.builders import (
    build_closed_fit,
    build_effect,
    build_fit,
    build_parameter,
    build_space,
    weights_of_nothing,
)
from trimtab.host.effects.parameter import form
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.flight_fit.fit import FlightFit
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.search import (
    Fitter,
    Names,
    Score,
    _proposals,
    _score_about,
    _underrated_sets,
    is_supported,
    most_probable,
    null_probability_of,
    search,
    sizes,
    smallest_within,
    without_dispensable,
)

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
TIE_NATS, CARRIER = RULES.tie_nats, RULES.carrier_spikes
BEST = build_closed_fit()


@dataclass(frozen=True)
class PriorOnly:
    """Stand-in for a fitter that has only a space and spike standard deviations (P,)."""

    space: ParameterSpace
    spike: Sequence[float]

    @property
    def prior(self) -> Prior:
        return Prior(groups=self.space.groups, spike=np.array(self.spike), nuisance_sigma=np.ones(1))


def prior_only(space: ParameterSpace, spike: Sequence[float] | None = None) -> Fitter[Any]:
    return cast("Fitter[Any]", PriorOnly(space, spike or [0.1] * len(space.columns)))


@pytest.mark.parametrize(
    ("nats", "expected"),
    [
        pytest.param({(): 0.0}, (), id="only-nothing"),
        pytest.param({("a",): 10.0 - TIE_NATS * BELOW, ("a", "b"): 10.0}, ("a",), id="just-within"),
        pytest.param({("a",): 10.0 - TIE_NATS * ABOVE, ("a", "b"): 10.0}, ("a", "b"), id="just-beyond"),
        pytest.param({("a", "b"): 10.0, ("a",): 9.0, (): 8.0}, (), id="the-smallest-of-three"),
        pytest.param({("a",): 9.0, ("b",): 9.5, ("a", "b"): 10.0}, ("b",), id="same-size-the-likelier"),
        pytest.param({("b",): 9.0, ("a",): 9.0, ("a", "b"): 10.0}, ("a",), id="equal-by-name"),
    ],
)
def test_selected_set_is_the_smallest_that_is_not_far_less_probable(
    nats: dict[Names, float], expected: Names
) -> None:
    assert smallest_within(nats, TIE_NATS) == expected


WORTH = RULES.worth_fitting_nats


@pytest.mark.parametrize(
    ("scores", "current", "expected"),
    [
        pytest.param({(): 0.0}, (), [()], id="nothing-to-add"),
        pytest.param({(): 0.0, ("a",): 1.0, ("b",): 2.0}, (), [("b",), ("b",)], id="best-and-best-with-more"),
        pytest.param(
            {(): 5.0, ("a",): 1.0, ("a", "b"): 2.0}, (), [(), ("a", "b")], id="more-may-be-two-at-once"
        ),
        pytest.param(
            {(): -9.0, ("a",): 9.0, ("b",): 5.0, ("c",): 6.0, ("b", "c"): 8.0, ("a", "b"): 7.0},
            ("a",),
            [("a",), ("a", "b"), ("c",)],
            id="best-more-and-swapped",
        ),
        pytest.param(
            {(): 0.0, ("a", "b"): 20.0, ("a",): 20.0 - WORTH * BELOW, ("b",): 20.0 - WORTH * ABOVE},
            ("a", "b"),
            [("a", "b"), ("a",)],
            id="one-fewer-if-not-too-far-behind",
        ),
        pytest.param(
            {("a", "b"): 20.0, ("a",): 19.0, ("b",): 18.0, (): 19.5, ("c",): 19.9},
            ("a", "b"),
            [("a", "b"), ("a",), ("b",)],
            id="every-one-fewer-not-two-nor-another",
        ),
        pytest.param(
            {(): 0.0, ("a", "b"): 20.0, ("c", "d"): 30.0, ("a", "c"): 16.0},
            ("a", "b"),
            [("c", "d"), ("a", "c")],
            id="one-swapped-not-both",
        ),
        pytest.param(
            {(): 7.0, ("a",): 107.0, ("b",): 107.0 - 100.0 * RULES.swap_share * BELOW},
            ("a",),
            [("a",), ("b",)],
            id="swapped-if-not-too-far-behind",
        ),
        pytest.param(
            {(): 7.0, ("a",): 107.0, ("b",): 107.0 - 100.0 * RULES.swap_share * ABOVE},
            ("a",),
            [("a",)],
            id="not-swapped-farther-behind",
        ),
        pytest.param({(): 0.0, ("b",): 1.0, ("a",): 1.0}, (), [("a",), ("a",)], id="equal-by-name"),
    ],
)
def test_proposals_are_the_best_set_and_the_best_neighbours(
    scores: dict[Names, float], current: Names, expected: list[Names]
) -> None:
    assert _proposals(scores, current) == expected


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        pytest.param({(): 1.0}, (), id="one"),
        pytest.param({(): 0.2, ("a",): 0.5, ("a", "b"): 0.3}, ("a",), id="the-greatest"),
        pytest.param({(): -5.0, ("a",): -9.0}, (), id="log-evidence"),
        pytest.param({("a",): 0.5, ("b",): 0.5}, ("b",), id="equal-by-name"),
        pytest.param({("b",): 0.5, ("a",): 0.5}, ("b",), id="equal-in-any-order"),
    ],
)
def test_most_probable_is_the_set_of_greatest_weight(weights: dict[Names, float], expected: Names) -> None:
    assert most_probable(weights) == expected


@pytest.mark.parametrize(
    ("weights", "probability"),
    [
        pytest.param({("a",): 2.0}, 0.0, id="not-considered"),
        pytest.param({(): 3.0}, 1.0, id="alone"),
        pytest.param({(): 1.0, ("a",): 2.0, ("b",): 1.0}, 0.25, id="a-share"),
        pytest.param(weights_of_nothing(0.3), 0.3, id="normalised"),
    ],
)
def test_null_probability_of_weights_is_the_share_of_the_empty_set(
    weights: dict[Names, float], probability: float
) -> None:
    assert null_probability_of(weights) == pytest.approx(probability)


LINE = build_effect("line", build_parameter("ratio"), build_parameter("length", strength=False))
PAIR = build_effect("pair", build_parameter("x"), build_parameter("y"))
ROTOR = build_effect("rotor", build_parameter("one"), build_parameter("two"), one_of=True)
SIZED = build_space(LINE, PAIR, ROTOR, "lag")
"""Columns: line.ratio, line.length, pair.x, pair.y, rotor.one, rotor.two, lag.size."""
SPIKE = (0.5, 0.01, 0.1, 0.2, 0.1, 0.4, 0.1)


@pytest.mark.parametrize(
    ("effects", "theta_scaled", "expected"),
    [
        pytest.param((), (9,) * 7, {}, id="no-effect"),
        pytest.param(("pair",), (0, 0, 0.3, 0.2, 0, 0, 0), {"pair": 3.0}, id="the-first-strength"),
        pytest.param(("pair",), (0, 0, 0.1, 0.8, 0, 0, 0), {"pair": 4.0}, id="the-second-strength"),
        pytest.param(("pair",), (0, 0, 0.1, -0.8, 0, 0, 0), {"pair": 4.0}, id="either-sign"),
        pytest.param(("line",), (1.0, 50.0, 0, 0, 0, 0, 0), {"line": 2.0}, id="a-length-is-no-strength"),
        pytest.param(("rotor.two",), (0, 0, 0, 0, 9.0, 0.4, 0), {"rotor.two": 1.0}, id="one-of-several"),
        pytest.param(
            ("lag", "line"), (1.0, 0, 9.0, 9.0, 9.0, 9.0, 0.7), {"lag": 7.0, "line": 2.0}, id="each-its-own"
        ),
    ],
)
def test_sizes_count_tolerances_by_the_greatest_strength(
    effects: Names, theta_scaled: Sequence[float], expected: dict[str, float]
) -> None:
    assert sizes(prior_only(SIZED, SPIKE), build_fit(effects, theta_scaled=theta_scaled)) == pytest.approx(
        expected
    )


BORNE = build_space("drag", build_effect("wind", requires_any=("drag", "lift")), "lift")
"""Columns: drag, wind, lift; each with a tolerance of 0.1 and bounds of 100 typical sizes."""


@pytest.mark.parametrize(
    ("effects", "theta_scaled", "expected"),
    [
        pytest.param((), (0, 0, 0), True, id="no-effect"),
        pytest.param(("drag",), (0.1 * BELOW, 0, 0), False, id="within-tolerance"),
        pytest.param(("drag",), (0.1 * ABOVE, 0, 0), True, id="beyond-tolerance"),
        pytest.param(("drag",), (-0.1 * ABOVE, 0, 0), True, id="of-either-sign"),
        pytest.param(("drag",), (100.0, 0, 0), False, id="at-its-upper-bound"),
        pytest.param(("drag",), (-100.0, 0, 0), False, id="at-its-lower-bound"),
        pytest.param(("drag",), (1.0, 0, 100.0), True, id="another-at-its-bound"),
        pytest.param(("drag", "lift"), (1.0, 0, 0.05), False, id="one-of-two-within"),
        pytest.param(("drag", "wind"), (0.1 * CARRIER * BELOW, 1.0, 0), False, id="acts-through-too-little"),
        pytest.param(("drag", "wind"), (0.1 * CARRIER * ABOVE, 1.0, 0), True, id="acts-through-enough"),
        pytest.param(("drag", "lift", "wind"), (0.2, 1.0, 1.0), True, id="acts-through-any"),
        pytest.param(("wind",), (1.0, 1.0, 1.0), False, id="acts-through-what-is-not-there"),
    ],
)
def test_a_setis_supported_if_every_effect_is_present(
    effects: Names, theta_scaled: Sequence[float], expected: bool
) -> None:
    assert is_supported(prior_only(BORNE), build_fit(effects, theta_scaled=theta_scaled)) == expected


OPEN = RULES.alias_probability


@pytest.mark.parametrize(
    ("selected", "weights", "expected"),
    [
        pytest.param((), {(): 1.0}, (), id="nothing-selected"),
        pytest.param(("a",), {("a",): 1.0 - OPEN * BELOW, (): OPEN * BELOW}, ("a",), id="just-needed"),
        pytest.param(("a",), {("a",): 1.0 - OPEN * ABOVE, (): OPEN * ABOVE}, (), id="just-dispensable"),
        pytest.param(("a",), {("a",): 188.0, (): 12.0}, (), id="relative-weights"),
        pytest.param(("a", "b"), {("a", "b"): 0.9, ("a",): 0.1}, ("a",), id="one-of-two"),
        pytest.param(("a", "b"), {("a", "b"): 0.9, (): 0.1}, (), id="neither-is-shown"),
        pytest.param(
            ("a", "b"),
            {("a", "b"): 0.5, ("a",): 0.3, ("b",): 0.2},
            ("a",),
            id="either-the-less-probable-goes",
        ),
        pytest.param(("a", "b"), {("a", "b"): 0.5, ("a", "c"): 0.5}, ("a", "b"), id="an-alias-is-no-subset"),
        pytest.param(("a", "b"), {("a", "b"): 0.9, ("a", "b", "c"): 0.1}, ("a", "b"), id="one-more-effect"),
        pytest.param(
            ("a", "b", "c"),
            {("a", "b", "c"): 0.88, ("a", "c"): 0.06, ("a",): 0.03, (): 0.03},
            ("a",),
            id="subsets-add-up",
        ),
    ],
)
def test_without_dispensable_drops_effects_that_the_rest_can_do_without(
    selected: Names, weights: dict[Names, float], expected: Names
) -> None:
    assert without_dispensable(selected, weights) == expected


FORMED = build_space(
    build_effect(
        "drag", build_parameter("size"), form("share", 0.3, -0.6, 0.6, "a share"), aliases=("wind", "lift")
    ),
    "wind",
    "lift",
    "lag",
    build_effect("gain", aliases=("wind",)),
)
"""Only the drag has a form; the wind, the lift and the drag are aliases, the gain and the wind are, too."""


@dataclass(frozen=True)
class KnownEvidence(PriorOnly):
    """Fitter to which the log evidence of each set is known, in fits and in the linearisation.

    fitted, screened: nats of sets; others are far worse. calls: the sets that were fitted. starts: the same
    sets with the start of each.
    """

    fitted: Mapping[Names, float] = field(default_factory=dict)
    screened: Mapping[Names, float] = field(default_factory=dict)
    calls: list[Names] = field(default_factory=list)
    starts: list[tuple[Names, int]] = field(default_factory=list)

    def fit(self, effects: Sequence[str], start: FlightFit) -> FlightFit:
        names = tuple(sorted(effects))
        self.calls.append(names)
        self.starts.append((names, id(start)))
        theta_scaled = np.zeros(len(self.space.columns))
        theta_scaled[[i for name in names for i in self.space.groups[name]]] = 1.0
        nats = self.fitted.get(names, -1e3)
        return build_closed_fit(names, log_evidence=nats, theta_scaled=theta_scaled.tolist())

    def scorer(self, fit: FlightFit) -> Score:
        return lambda sets: [self.screened.get(tuple(sorted(names)), -1e3) for names in sets]

    def screening_scorers(self, fit: FlightFit) -> list[Score]:
        return [self.scorer(fit)]

    def underrated_extensions(self, fit: FlightFit) -> list[Names]:
        return []


def known(fitted: Mapping[Names, float], screened: Mapping[Names, float]) -> KnownEvidence:
    return KnownEvidence(FORMED, (0.1,) * len(FORMED.columns), fitted, screened)


def underrated(selected: Names, screened: Mapping[Names, float], gained: float) -> list[Names]:
    """Return the sets to fit if the selected one gains so many nats, in a scale shifted by 7 nats."""
    fitter = cast("Fitter[FlightFit]", known({}, screened))
    fit = build_closed_fit(selected, log_evidence=gained + 7.0)
    return _underrated_sets(fitter.space, fit, {(): 7.0}, _score_about(fitter, fit))


SHARE = RULES.form_share


@pytest.mark.parametrize(
    ("gained", "behind", "expected"),
    [
        pytest.param(50.0, WORTH * BELOW, [("drag",)], id="little-gained-just-within"),
        pytest.param(50.0, WORTH * ABOVE, [], id="little-gained-just-beyond"),
        pytest.param(2000.0, 2000.0 * SHARE * BELOW, [("drag",)], id="much-gained-just-within"),
        pytest.param(2000.0, 2000.0 * SHARE * ABOVE, [], id="much-gained-just-beyond"),
    ],
)
def test_an_alias_with_a_form_is_fitted_if_only_its_form_may_decide(
    gained: float, behind: float, expected: list[Names]
) -> None:
    screened = {("wind",): 3.0, ("drag",): 3.0 - behind}
    assert underrated(("wind",), screened, gained) == expected


@pytest.mark.parametrize(("behind", "expected"), [(WORTH * BELOW, [("wind",)]), (WORTH * ABOVE, [])])
def test_an_alias_without_form_is_fitted_if_the_screening_puts_it_near(
    behind: float, expected: list[Names]
) -> None:
    screened = {("drag",): 3.0, ("wind",): 3.0 - behind}
    assert underrated(("drag",), screened, 2000.0) == expected


@pytest.mark.parametrize(
    ("selected", "expected"),
    [
        pytest.param((), [], id="nothing-to-replace"),
        pytest.param(("wind",), [(), ("drag",), ("gain",)], id="in-its-place"),
        pytest.param(
            ("lag", "wind"), [("drag", "lag"), ("gain", "lag"), ("lag",), ("wind",)], id="beside-the-others"
        ),
        pytest.param(("lag",), [()], id="no-alias"),
        pytest.param(("drag",), [(), ("wind",)], id="an-alias-without-form"),
        pytest.param(("drag", "wind"), [("drag",), ("lift", "wind"), ("wind",)], id="selected-itself"),
        pytest.param(
            ("lift", "wind"),
            [("drag",), ("drag", "lift"), ("drag", "wind"), ("wind",)],
            id="of-one-alias-and-of-all",
        ),
    ],
)
def test_an_effect_takes_the_place_of_its_aliases_and_each_effect_is_left_out(
    selected: Names, expected: list[Names]
) -> None:
    every: list[Names] = [
        ("drag",),
        ("wind",),
        ("lag",),
        ("gain",),
        ("drag", "lag"),
        ("drag", "lift"),
        ("drag", "wind"),
    ]
    screened: dict[Names, float] = dict.fromkeys(
        [*every, ("lag", "wind"), ("lift", "wind"), ("gain", "lag"), ()], 0.0
    )
    assert underrated(selected, screened, 100.0) == expected


def searched(fitter: KnownEvidence) -> Any:
    return search(cast("Fitter[FlightFit]", fitter), fitter.fit((), BEST))


@dataclass(frozen=True)
class AnotherMinimum(KnownEvidence):
    """Fitter that finds the greatest evidence of the wind only from a fit with more effects."""

    def fit(self, effects: Sequence[str], start: FlightFit) -> FlightFit:
        fit = super().fit(effects, start)
        far = fit.effects == ("wind",) and len(start.effects) < 2
        return replace(fit, log_evidence=fit.log_evidence - 40.0) if far else fit


class LagAtItsBounds(KnownEvidence):
    """Fitter that finds the lag at its bounds."""

    def fit(self, effects: Sequence[str], start: FlightFit) -> FlightFit:
        fit = super().fit(effects, start)
        bound = np.isin(np.arange(len(self.space.columns)), self.space.groups["lag"]) * 1e6
        return replace(fit, theta_scaled=np.where(fit.theta_scaled > 0.0, fit.theta_scaled + bound, 0.0))


@pytest.mark.parametrize(
    ("best", "expected"),
    [
        pytest.param(99.0, ("wind",), id="as-good-without"),
        pytest.param(80.0, ("lag", "wind"), id="worse-without"),
    ],
)
def test_search_fits_the_selected_set_without_each_effect_again(best: float, expected: Names) -> None:
    """The first fit of the wind ends in another minimum, 40 nats worse."""
    fitted = {(): 0.0, ("wind",): best, ("lag", "wind"): 100.0}
    fitter = AnotherMinimum(FORMED, (0.1,) * len(FORMED.columns), fitted, fitted)
    assert searched(fitter).selected.effects == expected


def test_search_fits_no_set_twice_from_the_same_start() -> None:
    """The best set and its subset are tried at first, and again at the end."""
    fitted = {(): 0.0, ("wind",): 90.0, ("lag",): 40.0, ("lag", "wind"): 100.0}
    fitter = known(fitted, fitted)
    assert searched(fitter).selected.effects == ("lag", "wind")
    assert len(fitter.starts) > len(fitted) - 1
    assert len(set(fitter.starts)) == len(fitter.starts)


def test_search_keeps_an_alias_that_the_linearisation_underrates() -> None:
    """It was fitted only beside a lag at its bounds, so no supported fit held it."""
    fitted = {(): 0.0, ("wind",): 90.0, ("gain", "lag"): 91.0, ("gain",): 89.0}
    screened = {(): 0.0, ("gain", "lag"): 95.0, ("wind",): 90.0, ("gain",): 90.0 - WORTH * BELOW}
    fitter = LagAtItsBounds(FORMED, (0.1,) * len(FORMED.columns), fitted, screened)
    result = searched(fitter)
    assert ("gain", "lag") in fitter.calls
    assert result.selected.effects == ("wind",)
    assert result.inclusion_probability["gain"] == pytest.approx(1.0 / (1.0 + np.e), abs=1e-3)


def test_search_does_not_drop_an_effect_for_another_one_of_its_set() -> None:
    """The lift was fitted only beside a lag at its bounds. Alone, the linearisation puts it near the wind."""
    fitted = {(): 0.0, ("lag", "wind"): 92.0, ("lag", "lift"): 91.0, ("wind",): 90.0}
    screened = {(): 0.0, ("lag", "wind"): 96.0, ("lag", "lift"): 95.0, ("wind",): 90.0, ("lift",): 88.0}
    fitter = LagAtItsBounds(FORMED, (0.1,) * len(FORMED.columns), fitted, screened)
    result = searched(fitter)
    assert ("lag", "lift") in fitter.calls
    assert result.selected.effects == ("wind",)
    assert result.inclusion_probability["lift"] == pytest.approx(1.0 / (1.0 + np.exp(2.0)), abs=1e-3)
    assert result.inclusion_probability["lag"] == 0.0


def test_search_finds_an_effect_that_the_screening_underrates_for_lack_of_its_form() -> None:
    """The best swap of the wind is the lift, so only the form brings the drag in."""
    fitted = {(): 0.0, ("wind",): 90.0, ("lift",): 60.0, ("drag",): 110.0}
    screened = {(): 0.0, ("wind",): 90.0, ("lift",): 89.0}
    within = searched(known(fitted, {**screened, ("drag",): 90.0 - WORTH * BELOW}))
    assert within.selected.effects == ("drag",)
    assert within.inclusion_probability["drag"] > 0.99
    farther = known(fitted, {**screened, ("drag",): 90.0 - WORTH * ABOVE})
    assert searched(farther).selected.effects == ("wind",)
    assert ("drag",) not in farther.calls


@pytest.mark.parametrize(
    ("nothing", "expected"),
    [pytest.param(96.5, ("lag",), id="subsets-add-up"), pytest.param(90.0, ("lag", "wind"), id="needed")],
)
def test_search_selects_no_effect_that_its_subsets_do_without(nothing: float, expected: Names) -> None:
    """Each subset alone is less than a twentieth as probable as the set of two."""
    nats = {("lag", "wind"): 100.0, ("lag",): 99.9 - TIE_NATS, (): nothing}
    assert max(nats[("lag",)], nothing) < 100.0 - TIE_NATS
    result = searched(known(nats, nats))
    assert result.selected.effects == expected
    assert result.log_evidence[("lag", "wind")] == 100.0
