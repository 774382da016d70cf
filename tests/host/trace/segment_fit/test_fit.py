"""Sets of effects fitted to segments."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.trace import evidence
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.parameters import space
from trimtab.host.trace.segment_fit.fit import at_parameters, refit
from trimtab.host.trace.segment_fit.model import SegmentModel

DATA = Path(__file__).parents[3] / "data"
LIBRARY = ("thrust-gain", "mass", "com-offset", "ground-effect")


def test_a_fit_is_the_optimum_of_its_linearisation() -> None:
    """A fit that ends a standard deviation early would leave a force that looks like another effect."""
    flight = read_flight(DATA / "c1.mcap")
    effects = load_effects()
    library = space(flight.vehicle, {name: effects[name] for name in LIBRARY})
    data, _ = segments_of([FlightData.of(flight)], rate_driven=False)
    form = SegmentModel.of(flight.vehicle, library, data)
    nothing = refit(form, data, (), None, iterations=2)
    fit = refit(form, data, ("thrust-gain",), nothing, iterations=1)
    white = evidence.marginal_grams(fit.lin, fit.process, library.prior)
    step, covariance = evidence.bounded_step(
        white.gram, fit.lin.theta_scaled, library.prior.precision(fit.effects), library.bounds
    )
    assert (np.abs(step) / np.sqrt(np.diag(covariance))).max() > 1.0
    np.testing.assert_allclose(fit.theta_scaled, fit.lin.theta_scaled + step)

    again = at_parameters(form, nothing, fit.effects, fit.theta_scaled, fit.covariance, 0.0)
    white = evidence.marginal_grams(again.lin, again.process, library.prior)
    moved = evidence.nuisance_step(again.lin, white, library.prior, np.zeros(len(step)))
    np.testing.assert_allclose(again.nuisances, again.lin.nuisances + moved)
