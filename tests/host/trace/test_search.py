"""The search over sets, with fits of known evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.trace import search as module
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.parameters import ParameterSpace, space
from trimtab.host.trace.search import Names, Score, search
from trimtab.host.vehicle import load_vehicle

DRAG, GAIN = ("quadratic-drag",), ("thrust-gain",)
BOTH = (*DRAG, *GAIN)


@dataclass(frozen=True)
class Known:
    """Stand-in for a fit whose effects have typical size."""

    effects: Names
    log_evidence: float
    theta_scaled: np.ndarray


@dataclass(frozen=True)
class KnownFitter:
    """Stand-in for a fitter with known evidence, in the fit and in the linearisation."""

    space: ParameterSpace
    evidence: dict[Names, float]
    believed: dict[Names, float]
    hidden: tuple[Names, ...] = ()
    size: float = 1.0

    @property
    def prior(self) -> Prior:
        return self.space.prior

    def fit(self, effects: Sequence[str], start: Known) -> Known:
        names = tuple(effects)
        theta_scaled = np.zeros(len(self.space.columns))
        for name in names:
            theta_scaled[list(self.space.groups[name])] = self.size
        return Known(names, self.evidence[names], theta_scaled)

    def scorer(self, fit: Known) -> Score:
        return lambda sets: [self.believed[names] for names in sets]

    def screening_scorers(self, fit: Known) -> list[Score]:
        return [self.scorer(fit)]

    def underrated_extensions(self, fit: Known) -> list[Names]:
        return [names for names in self.hidden if set(fit.effects) < set(names)]


@pytest.fixture(scope="module")
def library() -> ParameterSpace:
    effects = load_effects()
    return space(load_vehicle("research"), {name: effects[name] for name in BOTH})


def nothing(library: ParameterSpace) -> Known:
    return Known((), 0.0, np.zeros(len(library.columns)))


def test_search_fits_a_set_that_scores_far_better_than_the_selected_one(library: ParameterSpace) -> None:
    """A linearisation that overrates two effects must not hide the effect that is present."""
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: 2.0, GAIN: 9.0, BOTH: -5.0},
        believed={(): 0.0, DRAG: 3.0, GAIN: 10.0, BOTH: 40.0},
    )
    result = search(fitter, nothing(library))
    assert result.selected.effects == GAIN
    assert BOTH in result.log_evidence


def test_search_drops_a_set_that_the_linearisation_overrates(library: ParameterSpace) -> None:
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: -1.0, GAIN: -4.0, BOTH: -9.0},
        believed={(): 0.0, DRAG: 3.5, GAIN: 10.0, BOTH: 40.0},
    )
    result = search(fitter, nothing(library))
    assert result.selected.effects == ()
    assert result.inclusion_probability["thrust-gain"] < 0.1


@pytest.mark.parametrize(
    ("guessed", "selected"),
    [pytest.param(8.0, BOTH, id="better-than-nothing"), pytest.param(-1.0, (), id="worse-than-nothing")],
)
def test_search_starts_at_a_guess_that_is_better_than_nothing(
    library: ParameterSpace, guessed: float, selected: Names
) -> None:
    """Neither the linearisation nor a single effect leads to the pair."""
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: -2.0, GAIN: -1.0, BOTH: guessed},
        believed={(): 0.0, DRAG: -2.0, GAIN: -1.0, BOTH: -3.0},
    )
    assert search(fitter, nothing(library)).selected.effects == ()
    guess = fitter.fit(BOTH, nothing(library))
    assert search(fitter, nothing(library), guess=guess).selected.effects == selected


def test_search_selects_no_effect_if_all_sets_are_at_their_bounds(monkeypatch) -> None:
    """Thousands of nats for unsupported sets must not make the posterior weights 0/0."""
    monkeypatch.setattr(module, "RULES", replace(RULES, max_effects=1))
    effects = load_effects()
    third, every = ("motor-lag",), ("motor-lag", *DRAG, *GAIN)
    library = space(load_vehicle("research"), {name: effects[name] for name in every})
    singles: dict[Names, float] = {DRAG: 5000.0, GAIN: 4500.0, third: 4000.0}
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, **singles, every: 6000.0},
        believed={(): 0.0, **singles},
        hidden=(every,),
        size=1e6,
    )
    result = search(fitter, nothing(library))
    assert result.selected.effects == ()
    assert result.null_probability == 1.0
    assert set(result.inclusion_probability.values()) == {0.0}


def test_selected_set_outside_the_beam_has_a_weight(library: ParameterSpace, monkeypatch) -> None:
    monkeypatch.setattr(module, "BEAM", 0)
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: 2.0, GAIN: 3.0, BOTH: 20.0},
        believed={(): 0.0, DRAG: 2.0, GAIN: 3.0, BOTH: 20.0},
        hidden=(BOTH,),
    )
    result = search(fitter, nothing(library))
    assert result.selected.effects == BOTH
    assert result.inclusion_probability["thrust-gain"] > 0.99
