"""How clearly an effect outside the library differs from every model inside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np

from trimtab.host.log import Flight
from trimtab.host.trace import evidence
from trimtab.host.trace.data.logs import repeat_flights_of
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.flight_fit.fit import prior_of
from trimtab.host.trace.flight_fit.loop import ClosedLoop, closed_loop, order_of
from trimtab.host.trace.flight_fit.repeatability import turbulence
from trimtab.host.trace.flight_fit.whitening import Whitening, whitened
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.vehicle import Vehicle
from trimtab.sitl.studies.scoring.effective import deviations_scaled

MOST_EFFECTS = 3
"""Greatest number of effects of an inside model, as in the worlds."""

_ITERATIONS = 3
"""Gauss-Newton iterations for each set of effects."""

_LINE = (1.0, 0.5, 0.25, 0.1)
"""Step lengths of the line search, as shares of the Gauss-Newton step."""

Scaled = Annotated[np.ndarray, "parameters"]


def outside_sigma(
    vehicle: Vehicle,
    space: ParameterSpace,
    deviations: Mapping[str, float],
    still: Sequence[Flight],
    plain: Sequence[Flight],
    flights: Sequence[Flight],
) -> float:
    """Return by how many sigma the effect stands out of the best-fitting model inside the library.

    The rule is that of effects inside the library (lambda^2 = d' (I - P) d), and only its source of the
    effect's trace d differs: flights in still air with perfect sensors with it and without it. P projects on
    up to MOST_EFFECTS effects of the library of any size, chosen by forward selection, and on the build
    within tolerance. Turbulence and noise of the traced flights weigh, and each flight counts as often as it
    was traced.

    Parameters
    ----------
    deviations
        Drawn deviations of the build, by "effect.parameter".
    still, plain
        Each reference flown once in still air with perfect sensors, with and without the effect.
    flights
        The traced flights, with repeat flights.
    """
    centre = space.clipped(deviations_scaled(space, deviations))
    flown, loop, without = (
        closed_loop([FlightData.of(flight) for flight in some], vehicle, space, centre, noise_free=perfect)
        for some, perfect in ((flights, False), (still, True), (plain, True))
    )
    white = turbulence(flown, centre, order_of(flown), repeat_flights_of(flights))
    if white is None:
        raise ValueError("there are no repeat flights, so turbulence cannot be distinguished from physics")
    difference = _Difference(loop, without, white, centre, weight=len(flights) / len(still) / white.temper)
    names: tuple[str, ...] = ()
    theta_scaled, least = centre, np.inf
    while True:
        gram = difference.gram(names, theta_scaled)
        for _ in range(_ITERATIONS):
            theta_scaled = difference.best_along(gram, names, theta_scaled)
            gram = difference.gram(names, theta_scaled)
        least = min(least, difference.minimum(gram, names)[0])
        if len(names) == MOST_EFFECTS:
            return float(np.sqrt(max(least, 0.0)))
        others = [name for name in space.candidates if name not in names]
        names = (*names, min(others, key=lambda name: difference.minimum(gram, (*names, name))[0]))


class _Difference:
    """The difference between flights with and without an effect, as a residual of the model."""

    def __init__(
        self, loop: ClosedLoop, without: ClosedLoop, white: Whitening, centre: Scaled, *, weight: float
    ) -> None:
        self._loop, self._white, self._centre, self._weight = loop, white, centre, weight
        self._offset = [r[0] for r in without.residuals(centre[:, None])]
        self._known = without.known
        self._prior = prior_of(loop.space)
        self._limits = tuple(bound - centre for bound in loop.space.bounds)

    def gram(self, names: Sequence[str], theta_scaled: Scaled) -> Annotated[np.ndarray, "columns columns"]:
        """Return the Gram of the whitened [residual | slopes], linearised at theta_scaled, at the centre."""
        base = [r[0] for r in self._loop.residuals(theta_scaled[:, None])]
        slopes = self._loop.slopes(theta_scaled, names, base)
        total = np.zeros((1 + len(theta_scaled),) * 2)
        for index, (residual, offset) in enumerate(zip(base, self._offset, strict=True)):
            bins = min(len(residual), len(offset))
            S = np.asarray(slopes[index])[:, :bins]
            moved = residual[:bins] - offset[:bins] + np.tensordot(theta_scaled - self._centre, S, 1)
            known = self._loop.known[index][:bins] & self._known[index][:bins]
            columns = whitened(self._white, np.concatenate([moved[None], S]), known)
            total += self._weight * columns @ columns.T
        return total

    def best_along(self, gram: np.ndarray, names: Sequence[str], theta_scaled: Scaled) -> Scaled:
        """Return the best point on the way from theta_scaled to the minimum of `gram`, by full roll-outs.

        A payload on a line, say, may swing through the vehicle if the linearisation is followed too far.
        """
        step = self.minimum(gram, names)[1] - theta_scaled
        points = np.column_stack([theta_scaled + share * step for share in (0.0, *_LINE)])
        precision = self._prior.precision(names)
        cost = (precision[:, None] * (points - self._centre[:, None]) ** 2).sum(0)
        for index, (rolled, offset) in enumerate(
            zip(self._loop.residuals(points), self._offset, strict=True)
        ):
            bins = min(rolled.shape[1], len(offset))
            known = self._loop.known[index][:bins] & self._known[index][:bins]
            columns = whitened(self._white, rolled[:, :bins] - offset[:bins], known)
            cost += self._weight * np.square(columns).sum(1)
        return points[:, np.argmin(np.where(np.isfinite(cost), cost, np.inf))]

    def minimum(self, gram: np.ndarray, names: Sequence[str]) -> tuple[float, Scaled]:
        """Return the least square of residual and prior with `names` free, and the parameters there."""
        precision = self._prior.precision(names)
        lower, upper = self._limits
        step, _ = evidence.bounded_step(gram, np.zeros(len(self._centre)), precision, (lower, upper))
        normal = gram[1:, 1:] + np.diag(precision)
        square = gram[0, 0] - 2.0 * gram[0, 1:] @ step + step @ normal @ step
        return float(square), self._centre + step
