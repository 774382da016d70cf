"""Fitter of the search for sets of effects: a set whose model diverges."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from trimtab.host.trace.flight_fit import fitter as module
from trimtab.host.trace.flight_fit.fit import FlightFit
from trimtab.host.trace.flight_fit.fitter import FlightFitter
from trimtab.host.trace.flight_fit.loop import ClosedLoop
from trimtab.host.trace.flight_fit.whitening import Whitening
from trimtab.host.trace.parameters import RollOutDiverged


def test_set_whose_model_diverges_is_impossible(monkeypatch: pytest.MonkeyPatch) -> None:
    def diverging(*_: Any, **__: Any) -> FlightFit:
        raise RollOutDiverged("the model with drag diverges on these flights")

    monkeypatch.setattr(module, "fit_closed_loop", diverging)
    space = SimpleNamespace(effect=lambda _: SimpleNamespace(starts=()))
    start = FlightFit(
        effects=(),
        theta_scaled=np.zeros(1),
        at=np.zeros(1),
        covariance=np.eye(1),
        log_evidence=5.0,
        whitening=Whitening(coefficients=np.zeros((12, 12)), innovation=np.eye(12)),
        grams=np.zeros((1, 2, 2)),
        error_m=0.01,
    )
    fit = FlightFitter(loop=cast(ClosedLoop, SimpleNamespace(space=space)), order=1).fit(("drag",), start)
    assert (fit.effects, fit.log_evidence) == (("drag",), -np.inf)
