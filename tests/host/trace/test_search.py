"""The search over sets, with fits whose evidence is known beforehand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.trace import search as module
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.parameters import ParameterSpace, space
from trimtab.host.trace.search import Names, search
from trimtab.host.vehicle import load_vehicle

DRAG, GAIN = ("quadratic-drag",), ("thrust-gain",)
BOTH = (*DRAG, *GAIN)


@dataclass(frozen=True)
class Known:
    """A fit that any set has, its effects of typical size."""

    effects: Names
    log_evidence: float
    theta_scaled: np.ndarray


@dataclass(frozen=True)
class KnownFitter:
    """Fits of known evidence, and what a linearisation takes it to be."""

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

    def scorers(self, fit: Known) -> list[Callable[[Names], float]]:
        return [lambda names: self.believed[names]]

    def beyond(self, fit: Known) -> list[Names]:
        return [names for names in self.hidden if set(fit.effects) < set(names)]


@pytest.fixture(scope="module")
def library() -> ParameterSpace:
    effects = load_effects()
    return space(load_vehicle("research"), {name: effects[name] for name in BOTH})


def nothing(library: ParameterSpace) -> Known:
    return Known((), 0.0, np.zeros(len(library.columns)))


def test_what_is_far_more_probable_than_the_kept_set_is_fitted_too(library: ParameterSpace) -> None:
    """A linearisation that promises too much of two effects must not hide the one that is there."""
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: 2.0, GAIN: 9.0, BOTH: -5.0},
        believed={(): 0.0, DRAG: 3.0, GAIN: 10.0, BOTH: 40.0},
    )
    found = search(fitter, nothing(library))
    assert found.selected.effects == GAIN
    assert BOTH in found.log_evidence


def test_what_the_linearisation_promises_in_vain_is_not_kept(library: ParameterSpace) -> None:
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: -1.0, GAIN: -4.0, BOTH: -9.0},
        believed={(): 0.0, DRAG: 3.5, GAIN: 10.0, BOTH: 40.0},
    )
    found = search(fitter, nothing(library))
    assert found.selected.effects == ()
    assert found.inclusion_probability["thrust-gain"] < 0.1


def test_sets_that_only_their_bounds_hold_leave_none_however_much_they_promise(monkeypatch) -> None:
    """Thousands of nats for what cannot be kept: what is left of the weights is not nothing over nothing."""
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
    found = search(fitter, nothing(library))
    assert found.selected.effects == ()
    assert found.null_probability == 1.0
    assert set(found.inclusion_probability.values()) == {0.0}


def test_a_kept_set_that_no_beam_visits_has_a_weight(library: ParameterSpace, monkeypatch) -> None:
    monkeypatch.setattr(module, "BEAM", 0)
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: 2.0, GAIN: 3.0, BOTH: 20.0},
        believed={(): 0.0, DRAG: 2.0, GAIN: 3.0, BOTH: 20.0},
        hidden=(BOTH,),
    )
    found = search(fitter, nothing(library))
    assert found.selected.effects == BOTH
    assert found.inclusion_probability["thrust-gain"] > 0.99
