"""The search over sets, with fits whose evidence is known beforehand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from host.effects import load_effects
from host.trace.evidence import Prior
from host.trace.parameters import Space, space
from host.trace.search import Names, search
from host.vehicle import load_vehicle

DRAG, GAIN = ("quadratic-drag",), ("thrust-gain",)
BOTH = (*DRAG, *GAIN)


@dataclass(frozen=True)
class Known:
    """A fit that any set has, its effects of typical size."""

    effects: Names
    log_evidence: float
    z: np.ndarray


@dataclass(frozen=True)
class KnownFitter:
    """Fits of known evidence, and what a linearisation takes it to be."""

    space: Space
    evidence: dict[Names, float]
    believed: dict[Names, float]
    hidden: tuple[Names, ...] = ()

    @property
    def prior(self) -> Prior:
        return self.space.prior

    def fit(self, effects: Names, start: Known) -> Known:
        z = np.zeros(len(self.space.columns))
        for name in effects:
            z[list(self.space.groups[name])] = 1.0
        return Known(effects, self.evidence[effects], z)

    def scorers(self, fit: Known) -> list[Callable[[Names], float]]:
        return [lambda names: self.believed[names]]

    def beyond(self, fit: Known) -> list[Names]:
        return [names for names in self.hidden if set(fit.effects) < set(names)]


@pytest.fixture(scope="module")
def library() -> Space:
    effects = load_effects()
    return space(load_vehicle("research"), {name: effects[name] for name in BOTH})


def nothing(library: Space) -> Known:
    return Known((), 0.0, np.zeros(len(library.columns)))


def test_what_is_far_more_probable_than_the_kept_set_is_fitted_too(library: Space) -> None:
    """A linearisation that promises too much of two effects must not hide the one that is there."""
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: 2.0, GAIN: 9.0, BOTH: -5.0},
        believed={(): 0.0, DRAG: 3.0, GAIN: 10.0, BOTH: 40.0},
    )
    found = search(fitter, nothing(library))
    assert found.best.effects == GAIN
    assert BOTH in found.sets


def test_what_the_linearisation_promises_in_vain_is_not_kept(library: Space) -> None:
    fitter = KnownFitter(
        library,
        evidence={(): 0.0, DRAG: -1.0, GAIN: -4.0, BOTH: -9.0},
        believed={(): 0.0, DRAG: 3.5, GAIN: 10.0, BOTH: 40.0},
    )
    found = search(fitter, nothing(library))
    assert found.best.effects == ()
    assert found.inclusion["thrust-gain"] < 0.1
