"""Detectability and presence of effects, and the probability that no effect is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from tests.host.trace.builders import (
    MASS,
    build_closed_fit,
    build_diagnosis,
    build_effect,
    build_parameter,
    build_search_result,
    build_space,
)
from trimtab.host.effects.parameter import form
from trimtab.host.trace import selection
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.flight_fit.fitter import FlightFitter
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.search import Names
from trimtab.host.trace.segment_fit.fit import SegmentFit, SegmentFitter
from trimtab.host.trace.selection import (
    Method,
    detectability,
    noise_dependent_effects,
    present_effects,
    select_effects,
    without_contradicted,
)

ROTOR = build_effect("rotor", *(build_parameter(f"loss_{k}") for k in (1, 2, 3)), one_of=True)
PAIR = build_effect("pair", build_parameter("x"), build_parameter("y"))


def gram_of(*columns: list[float]) -> np.ndarray:
    """Return the Gram (1 + P, 1 + P) of a residual of ones and these slopes."""
    stacked = np.array([[1.0] * len(columns[0]), *columns])
    return stacked @ stacked.T


def sigma(space: ParameterSpace, gram: np.ndarray, tolerance: float) -> dict[str, float]:
    return detectability(space, gram, np.full(len(space.columns), tolerance**-2.0))


def test_detectability_of_an_effect_alone_is_the_length_of_its_slope() -> None:
    sigmas = sigma(build_space("drag"), gram_of([3.0, 0.0, 4.0]), 0.1)
    assert sigmas == pytest.approx({"drag": 5.0})


def test_detectability_counts_all_parameters_of_an_effect_together() -> None:
    sigmas = sigma(build_space(PAIR), gram_of([3.0, 0.0, 0.0], [0.0, 4.0, 0.0]), 0.1)
    assert sigmas == pytest.approx({"pair": 5.0})
    opposite = sigma(build_space(PAIR), gram_of([3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]), 0.1)
    assert opposite == pytest.approx({"pair": 0.0}, abs=1e-7)


def test_detectability_of_several_candidates_of_an_effect_is_the_greatest() -> None:
    sigmas = sigma(build_space(ROTOR), gram_of([1.0, 0.0, 0.0], [0.0, 7.0, 0.0], [0.0, 0.0, 2.0]), 1e-9)
    assert sigmas == pytest.approx({"rotor": 7.0})


@pytest.mark.parametrize(
    ("tolerance", "expected"),
    [
        pytest.param(1e-6, 5.0, id="known-exactly"),
        pytest.param(1.0, np.sqrt(25.0 - 9.0 * 9.0 / (9.0 + 1.0)), id="within-its-tolerance"),
        pytest.param(1e6, 4.0, id="free"),
    ],
)
def test_detectability_excludes_what_another_parameter_can_explain(tolerance: float, expected: float) -> None:
    space = build_space("drag", MASS)
    sigmas = sigma(space, gram_of([3.0, 4.0], [3.0, 0.0]), tolerance)
    assert sigmas == pytest.approx({"drag": expected}, rel=1e-4)  # the mass is no candidate


def test_detectability_of_many_effects_is_the_least_squares_residual_of_each() -> None:
    rng = np.random.default_rng(1)
    space = build_space("drag", PAIR, MASS, ROTOR, "lag")
    slopes, tolerances = rng.normal(size=(40, 8)), rng.uniform(0.05, 3.0, 8)
    stacked = np.column_stack([rng.normal(size=40), slopes])
    sigmas = detectability(space, stacked.T @ stacked, tolerances**-2.0)
    expected = {}
    for candidate, mine in space.groups.items():
        rest = [i for i in range(8) if i not in mine]
        design = np.concatenate([slopes[:, rest], np.diag(1.0 / tolerances[rest])])
        target = np.concatenate([slopes[:, list(mine)].sum(1), np.zeros(len(rest))])
        residual = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
        name = candidate.partition(".")[0]
        expected[name] = max(expected.get(name, 0.0), float(np.linalg.norm(residual)))
    del expected[MASS]
    assert sigmas == pytest.approx(expected)


def test_detectability_does_not_depend_on_the_residual() -> None:
    space, gram = build_space("drag", "lag"), gram_of([1.0, 2.0, 0.0], [0.0, 1.0, 1.0])
    other = gram.copy()
    other[0], other[:, 0] = 9.0, 9.0
    assert sigma(space, gram, 0.5) == sigma(space, other, 0.5)


def test_detectability_without_candidates_is_empty() -> None:
    assert sigma(build_space(MASS), gram_of([1.0, 2.0]), 0.5) == {}


def test_null_probability_is_the_weight_of_the_empty_set() -> None:
    assert build_diagnosis(posterior_weights={(): 1.0, ("drag",): 3.0}).null_probability == pytest.approx(
        0.25
    )
    assert build_diagnosis(posterior_weights={("drag",): 3.0}).null_probability == 0.0


BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
SIGMA, SPIKE = RULES.present_sigma, 0.1
LINE = build_effect("line", build_parameter("ratio"), build_parameter("length", strength=False))
BORNE = build_space(
    build_effect("drag", build_parameter(), form("share", 0.3, -0.6, 0.6, "a share")),
    build_effect("wind", requires_any=("drag",)),
    LINE,
    PAIR,
)
"""Columns: drag.size, drag.share, wind.size, line.ratio, line.length, pair.x, pair.y."""


def present(effects: Names, theta_scaled: Sequence[float], covariance: np.ndarray) -> Names:
    """Return the present effects if every spike is SPIKE."""
    prior = Prior(groups=BORNE.groups, spike=np.full(len(BORNE.columns), SPIKE), nuisance_sigma=np.ones(1))
    fitter = cast(FlightFitter, SimpleNamespace(space=BORNE, prior=prior))
    return present_effects(fitter, build_closed_fit(effects, theta_scaled=theta_scaled), covariance)


def sd(*values: float) -> np.ndarray:
    """Return the covariance of independent parameters with these standard deviations."""
    return np.diag(np.square(values))


@pytest.mark.parametrize(
    ("effects", "theta_scaled", "sds", "expected"),
    [
        pytest.param((), (0,) * 7, (1,) * 7, (), id="no-effect"),
        pytest.param(("drag",), (SIGMA * ABOVE, 0, 0, 0, 0, 0, 0), (1,) * 7, ("drag",), id="beyond-chance"),
        pytest.param(("drag",), (SIGMA * BELOW, 0, 0, 0, 0, 0, 0), (1,) * 7, (), id="within-chance"),
        pytest.param(("drag",), (-SIGMA * ABOVE, 0, 0, 0, 0, 0, 0), (1,) * 7, ("drag",), id="of-either-sign"),
        pytest.param(("drag",), (SPIKE * BELOW, 0, 0, 0, 0, 0, 0), (1e-3,) * 7, (), id="within-tolerance"),
        pytest.param(("drag",), (SPIKE * ABOVE, 0, 0, 0, 0, 0, 0), (1e-3,) * 7, ("drag",), id="beyond-both"),
        pytest.param(("drag",), (1, 9, 0, 0, 0, 0, 0), (1, 0.1, 1, 1, 1, 1, 1), (), id="a-form-is-no-size"),
        pytest.param(
            ("line",), (0, 0, 0, 1, 9, 0, 0), (1, 1, 1, 1, 0.1, 1, 1), (), id="a-length-is-no-strength"
        ),
        pytest.param(
            ("pair",), (0, 0, 0, 0, 0, 1.5, 1.5), (1,) * 7, ("pair",), id="two-strengths-count-together"
        ),
        pytest.param(("pair",), (0, 0, 0, 0, 0, 1.5, 0.5), (1,) * 7, (), id="two-weak-strengths"),
        pytest.param(
            ("drag", "wind"), (9, 0, 1, 0, 0, 0, 0), (1,) * 7, ("drag",), id="what-it-carries-is-not-there"
        ),
        pytest.param(("drag", "wind"), (9, 0, 9, 0, 0, 0, 0), (1,) * 7, ("drag", "wind"), id="carried"),
        pytest.param(("drag", "wind"), (1, 0, 9, 0, 0, 0, 0), (1,) * 7, (), id="its-carrier-is-not-there"),
        pytest.param(("drag", "pair", "wind"), (1, 0, 9, 0, 0, 9, 0), (1,) * 7, ("pair",), id="others-stay"),
    ],
)
def test_present_effects_exceed_tolerance_and_reported_standard_deviations(
    effects: Names, theta_scaled: Sequence[float], sds: Sequence[float], expected: Names
) -> None:
    assert present(effects, theta_scaled, sd(*sds)) == expected


def test_present_effects_take_the_correlation_of_strengths_into_account() -> None:
    covariance = sd(*(1.0,) * 7)
    theta_scaled = (0, 0, 0, 0, 0, 1.5, 1.5)
    covariance[5, 6] = covariance[6, 5] = 0.9  # theta' C^-1 theta is 4.5 / 1.9
    assert present(("pair",), theta_scaled, covariance) == ()
    covariance[5, 6] = covariance[6, 5] = -0.9
    assert present(("pair",), theta_scaled, covariance) == ("pair",)


OPEN = RULES.open_probability


@pytest.mark.parametrize(
    ("absent", "expected"),
    [
        pytest.param((), {"drag": 0.9, "lag": 0.35, "gain": 0.6}, id="none"),
        pytest.param(("drag",), {"drag": OPEN, "lag": 5 / 12, "gain": 1 / 3}, id="one"),
        pytest.param(("lag",), {"drag": 0.9, "lag": 0.35, "gain": 0.6}, id="improbable-anyway"),
        pytest.param(("gain", "drag"), {"drag": OPEN, "lag": 5 / 12, "gain": 1 / 3}, id="two"),
    ],
)
def test_without_contradicted_caps_the_probability_of_what_the_refit_does_not_find(
    absent: Names, expected: dict[str, float]
) -> None:
    """What takes the place of a contradicted effect becomes more probable, what stands beside it less."""
    outcome = replace(
        build_search_result(build_closed_fit(("drag", "gain"))),
        posterior_weights={("drag", "gain"): 6.0, ("drag", "lag"): 3.0, ("lag",): 0.5, (): 0.5},
        inclusion_probability={"drag": 0.9, "lag": 0.35, "gain": 0.6},
    )
    capped = without_contradicted(outcome, absent)
    assert capped.inclusion_probability == pytest.approx(expected)


def test_what_was_dropped_before_stays_improbable() -> None:
    """Its sets keep their weight if it was dropped as an artefact of a swing."""
    weights = {("drag", "gain", "lag"): 8.0, ("drag", "lag"): 1.0, ("drag",): 1.0}
    outcome = replace(
        build_search_result(build_closed_fit(("drag", "lag"))),
        posterior_weights=weights,
        inclusion_probability={"drag": 1.0, "gain": OPEN, "lag": 0.9},
        absent=frozenset({"gain"}),
    )
    capped = without_contradicted(outcome, ("lag",))
    assert capped.absent == {"gain", "lag"}
    assert capped.inclusion_probability == pytest.approx({"drag": 1.0, "gain": 4 / 9, "lag": OPEN})
    every = {("drag", "gain"): 1.0, ("drag", "gain", "lag"): 1e-3}
    again = without_contradicted(replace(outcome, posterior_weights=every), ("lag",))
    assert again.inclusion_probability["gain"] == OPEN


def test_without_contradicted_caps_the_probability_if_every_set_has_the_effect() -> None:
    weights = {("drag",): 3.0, ("drag", "gain"): 1.0}
    outcome = replace(
        build_search_result(build_closed_fit(("drag", "gain"))),
        posterior_weights=weights,
        inclusion_probability={"drag": 1.0, "gain": 0.25},
    )
    capped = without_contradicted(outcome, ("drag",))
    assert capped.inclusion_probability == {"drag": OPEN, "gain": 0.25}
    assert capped.posterior_weights == weights


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        pytest.param(
            {(): 1.0, ("drag",): 10.0, ("gain",): 10.0, ("drag", "gain"): 80.0},
            {(): 0.5, ("drag",): 0.05, ("gain",): 0.05, ("drag", "gain"): 0.4},
            id="both",
        ),
        pytest.param(
            {(): 1.0, ("lag",): 3.0, ("drag",): 12.0, ("gain", "lag"): 4.0},
            {(): 0.125, ("lag",): 0.375, ("drag",): 0.375, ("gain", "lag"): 0.125},
            id="beside-another",
        ),
    ],
)
def test_sets_with_any_contradicted_effect_share_half(
    weights: dict[Names, float], expected: dict[Names, float]
) -> None:
    outcome = replace(build_search_result(build_closed_fit(("drag",))), posterior_weights=weights)
    found = without_contradicted(outcome, {"drag", "gain"}).posterior_weights
    total = sum(found.values())
    assert {names: weight / total for names, weight in found.items()} == pytest.approx(expected)


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        pytest.param({(): 0.02, ("drag",): 0.98}, {(): 0.5, ("drag",): 0.5}, id="only-effect"),
        pytest.param({(): 0.8, ("drag",): 0.2}, {(): 0.8, ("drag",): 0.2}, id="improbable-already"),
        pytest.param({("drag",): 1.0}, {("drag",): 1.0}, id="no-set-without-it"),
        pytest.param(
            {("gain",): 0.1, ("drag", "gain"): 0.6, ("drag",): 0.3},
            {("gain",): 0.5, ("drag", "gain"): 1.0 / 3.0, ("drag",): 1.0 / 6.0},
            id="sets-with-it-share",
        ),
    ],
)
def test_without_contradicted_leaves_sets_with_the_effect_no_more_than_half(
    weights: dict[Names, float], expected: dict[Names, float]
) -> None:
    outcome = replace(build_search_result(build_closed_fit(("drag",))), posterior_weights=weights)
    found = without_contradicted(outcome, {"drag"}).posterior_weights
    total = sum(found.values())
    assert {names: weight / total for names, weight in found.items()} == pytest.approx(expected)


NOISY = build_space(
    "drag",
    build_effect(
        "zone", build_parameter("width"), build_parameter("centre", strength=False), noise_dependent=True
    ),
)
SHOWN = RULES.noise_dependent_spikes * SPIKE
GAIN = RULES.worth_fitting_nats


def noisy_fitter(gain: float) -> SegmentFitter:
    """Return a fitter of NOISY in which every start value gains that much."""
    prior = Prior(groups=NOISY.groups, spike=np.full(len(NOISY.columns), SPIKE), nuisance_sigma=np.ones(1))
    fitter = SimpleNamespace(space=NOISY, prior=prior, start_gain=lambda name, fit: gain)
    fitter.fit = lambda effects, start: start
    return cast(SegmentFitter, fitter)


@pytest.mark.parametrize(
    ("theta_scaled", "gain", "expected"),
    [
        pytest.param((0, 0, 0), 0.0, (), id="nothing"),
        pytest.param((9, 0, 0), 0.0, (), id="another-effect"),
        pytest.param((0, SHOWN * BELOW, 0), 0.0, (), id="within-tolerance"),
        pytest.param((0, SHOWN * ABOVE, 0), -99.0, ("zone",), id="beyond-tolerance"),
        pytest.param((0, -SHOWN * ABOVE, 0), 0.0, ("zone",), id="of-either-sign"),
        pytest.param((0, 0, 9), 0.0, (), id="a-place-is-no-strength"),
        pytest.param((0, 0, 0), GAIN * BELOW, (), id="a-start-that-gains-little"),
        pytest.param((0, 0, 0), GAIN * ABOVE, ("zone",), id="a-start-that-gains-much"),
    ],
)
def test_segments_show_an_effect_that_depends_on_noise(
    theta_scaled: Sequence[float], gain: float, expected: Names
) -> None:
    null_fit = cast(SegmentFit, SimpleNamespace(theta_scaled=np.array(theta_scaled, dtype=float)))
    assert noise_dependent_effects(noisy_fitter(gain), null_fit) == expected


@pytest.mark.parametrize(
    ("gain", "probability", "flights", "method", "noisy"),
    [
        pytest.param(0.0, 1.0, 8, "closed-loop", (), id="segments-show-nothing"),
        pytest.param(2 * GAIN, 1.0, 8, "segments", ("zone",), id="segments-show-it"),
        pytest.param(2 * GAIN, RULES.alias_probability * ABOVE, 8, "segments", ("zone",), id="possible"),
        pytest.param(2 * GAIN, RULES.alias_probability * BELOW, 8, "closed-loop", (), id="improbable"),
        pytest.param(2 * GAIN, 1.0, 0, "segments", (), id="no-whole-flights"),
    ],
)
def test_whole_flights_are_not_fitted_if_an_effect_depends_on_noise(
    gain: float,
    probability: float,
    flights: int,
    method: Method,
    noisy: Names,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    null_fit = SimpleNamespace(theta_scaled=np.zeros(3))
    found = build_diagnosis(inclusion_probability={"drag": 0.0, "zone": probability})
    monkeypatch.setattr(selection, "refit", lambda *_, **__: null_fit)
    monkeypatch.setattr(selection, "SegmentFitter", lambda segment_model: noisy_fitter(gain))
    monkeypatch.setattr(selection, "_from_segments", lambda *_: replace(found, method="segments"))
    monkeypatch.setattr(selection, "_from_flights", lambda *_: replace(found, method="closed-loop"))
    diagnosis = select_effects(None, None, (None,) * flights, (), lambda _: None)  # type: ignore[arg-type]
    assert (diagnosis.method, diagnosis.noise_dependent) == (method, noisy)
