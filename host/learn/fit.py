"""Learning on the condensed loss: L-BFGS over a network's weights, parameters of effects and pose delay."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.optimize import minimize

from trimtab.host.base import parallel
from trimtab.host.learn.condensed import DELAY_S, Condensed, CondensedSettings
from trimtab.host.models.network import Layout

SLAB = 2.0
"""Prior sigma of a parameter in typical sizes, and of the delay in units of DELAY_S, for all data."""

_MEMORY = 50

_TYPICAL = {"world": (3.0, 3.0, 3.0, 0.6, 0.6, 3.0), "body": (3.0, 3.0, 3.0)}
"""Typical sizes of a network's inputs, by its frame: m/s, rad. The first weights are drawn for inputs divided
by them. Drawn for inputs as they are, they give functions that vary fast with speed and little with tilt.
"""

_UNIT, _LAST_UNIT = 0.5, 0.2
"""Units in which weights are searched, in all layers and in the last one, for inputs in typical sizes. The
last layer's weights change the loss most.
"""

_PART = 64
"""Segments whose loss is computed together."""


@dataclass(frozen=True, kw_only=True)
class Basis:
    """The learned quantities: a network of this layout or None, parameters of effects, the delay of poses."""

    layout: Layout | None
    parameters: int
    delay: bool

    @property
    def weights(self) -> int:
        """Number of weights of the network."""
        return 0 if self.layout is None else self.layout.size

    @property
    def size(self) -> int:
        """Number of learned values: weights, scaled parameters, the scaled delay."""
        return self.weights + self.parameters + int(self.delay)


@dataclass(frozen=True, kw_only=True, eq=False)
class Examples:
    """Condensed segments with v_ned and Theta at their knots."""

    condensed: Condensed
    states: Annotated[np.ndarray, "segments knots 6"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """The values of least validation loss: weights xi, eta in typical sizes, delay_s.

    With them the number of iterations, the best one, and the losses of training and validation after each;
    validation's also before the first.
    """

    xi: Annotated[np.ndarray, "weights"]
    eta: Annotated[np.ndarray, "parameters"]
    delay_s: float
    iterations: int
    best: int
    train_loss: Annotated[np.ndarray, "iterations"]
    validation_loss: Annotated[np.ndarray, "checks"]


def accelerations(
    basis: Basis, xi: Annotated[np.ndarray, "weights"], states: Annotated[np.ndarray, "segments points 6"]
) -> Annotated[np.ndarray, "segments points 3"]:
    """Return the network's acceleration, NED, at states."""
    if basis.layout is None:
        return np.zeros((*states.shape[:2], 3))
    flat = basis.layout.arrays(xi, states.reshape(-1, 6).T)
    return flat.T.reshape(*states.shape[:2], 3)


def initial(layout: Layout, rng: np.random.Generator) -> Annotated[np.ndarray, "weights"]:
    """Return random first weights, those of `layout.initial` for inputs in typical sizes."""
    return layout.initial(rng) * _units(layout, 1.0, last=1.0)


def _units(layout: Layout, unit: float, *, last: float) -> Annotated[np.ndarray, "weights"]:
    """Return a unit for every weight, one for the last layer's; those of inputs over the typical sizes."""
    units, places = np.full(layout.size, unit), list(layout.places())
    units[places[-1].where] = last
    units[places[0].where].reshape(places[0].rows, -1)[:, :-1] /= _TYPICAL[layout.frame]
    return units


def fit(
    basis: Basis,
    train: Examples,
    validation: Examples,
    start: Annotated[np.ndarray, "values"],
    settings: CondensedSettings,
    *,
    headings: Annotated[np.ndarray, "copies segments"] | None = None,
    jobs: int = 1,
    on_iteration: Callable[[int, float], None] | None = None,
) -> Fitted:
    """Return the values that fit best, from `start`; stop early where validation does not improve.

    headings, rad: every segment counts once for each of these angles, turned by it. jobs:
    threads; the result does not depend on them.
    """
    problem = _Problem(basis, train, l2=settings.l2, headings=headings, jobs=jobs)
    checked = _Problem(basis, validation, l2=0.0, headings=None, scale=problem.scale, jobs=jobs)
    losses, checks = [], [checked.loss(start)]
    best = [start.copy(), 0]

    class Enough(Exception):
        pass

    unit = np.ones(basis.size)
    if basis.layout is not None:
        unit[: basis.weights] = _units(basis.layout, _UNIT, last=_LAST_UNIT)

    def scaled(w: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = problem(unit * w)
        return value, unit * slope

    def after(w: np.ndarray) -> None:
        v = unit * w
        losses.append(problem.last)
        checks.append(checked.loss(v))
        if checks[-1] < checks[int(best[1])]:
            best[:] = [v.copy(), len(losses)]
        if on_iteration is not None:
            on_iteration(len(losses), checks[-1])
        if len(losses) - int(best[1]) >= settings.patience:
            raise Enough

    options = {
        "maxiter": settings.iterations,
        "maxfun": 4 * settings.iterations,
        "maxcor": _MEMORY,
        "ftol": 0.0,
        "gtol": 1e-12,
    }
    with suppress(Enough):
        minimize(scaled, start / unit, jac=True, method="L-BFGS-B", callback=after, options=options)
    xi, eta, delay = problem.split(np.asarray(best[0]))
    return Fitted(
        xi=xi.copy(),
        eta=eta.copy(),
        delay_s=DELAY_S * delay,
        iterations=len(losses),
        best=int(best[1]),
        train_loss=np.array(losses),
        validation_loss=np.array(checks),
    )


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Some segments under one set of headings, small enough for a processor's cache.

    inputs: v_ned and Theta of the knots, turned. cos, sin: of the headings.
    """

    segments: slice
    inputs: Annotated[np.ndarray, "6 points"]
    cos: Annotated[np.ndarray, "segments 1"]
    sin: Annotated[np.ndarray, "segments 1"]


class _Problem:
    """Loss and slope by the learned values: mean over segments, scaled to a unit mean diagonal.

    The parts of `_PART` segments are summed in order, so that the result does not depend on `jobs`.
    """

    def __init__(
        self,
        basis: Basis,
        examples: Examples,
        *,
        l2: float,
        headings: np.ndarray | None,
        scale: float | None = None,
        jobs: int = 1,
    ) -> None:
        self.basis, self.condensed, self.l2, self.jobs = basis, examples.condensed, l2, jobs
        count = len(examples.states)
        headings = np.zeros((1, count)) if headings is None else headings
        self.scale = 1.0 / float(self.condensed.curvature.mean()) if scale is None else scale
        self.last = np.inf
        self._share = self.scale / headings.size
        self._parts = [
            _part(examples.states, angles, slice(first, first + _PART))
            for angles in headings
            for first in range(0, count, _PART)
        ]

    def split(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return weights, scaled parameters and scaled delay."""
        m, p = self.basis.weights, self.basis.parameters
        return v[:m], v[m : m + p], float(v[m + p]) if self.basis.delay else 0.0

    def loss(self, v: np.ndarray) -> float:
        """Return the loss alone."""
        return self._value(v, slope=False)[0]

    def __call__(self, v: np.ndarray) -> tuple[float, np.ndarray]:
        """Return loss and slope (size,)."""
        self.last, slope = self._value(v, slope=True)
        return self.last, slope

    def _value(self, v: np.ndarray, *, slope: bool) -> tuple[float, np.ndarray]:
        xi, eta, delay = self.split(v)
        count, others = len(self.condensed.constant), v[len(xi) :]
        values = parallel.each(
            lambda part: self._part_value(part, xi, np.array([*eta, delay]), slope=slope),
            self._parts,
            self.jobs,
        )
        total = self._share * sum(value for value, _ in values)
        total += self.l2 * float(xi @ xi) + self.scale / count * float((others**2).sum()) / SLAB**2
        gradient = self._share * np.sum([part for _, part in values], axis=0)
        gradient[: len(xi)] += 2.0 * self.l2 * xi
        gradient[len(xi) :] += 2.0 * self.scale / count * others / SLAB**2
        return total, gradient

    def _part_value(
        self, part: _Part, xi: np.ndarray, others: np.ndarray, *, slope: bool
    ) -> tuple[float, np.ndarray]:
        """Return the sum of the losses of a part, and its slope, which is 0 unless asked for."""
        layout, condensed = self.basis.layout, self.condensed.take(part.segments)
        count, knots = len(condensed.constant), condensed.knots
        u, vjp = np.zeros_like(condensed.at), None
        if layout is not None:
            acceleration, vjp = layout.with_vjp(xi, part.inputs)
            acceleration = _rotated(acceleration.T.reshape(count, knots, 3), part.cos, -part.sin)
            u[:, : 3 * knots] = acceleration.reshape(count, -1)
        u[:, 3 * knots :] = others
        value, by_u = condensed.loss(u)
        gradient = np.zeros(self.basis.size)
        if slope:
            if vjp is not None:
                costate = _rotated(by_u[:, : 3 * knots].reshape(count, knots, 3), part.cos, part.sin)
                gradient[: len(xi)] = vjp(costate.reshape(-1, 3).T)
            gradient[len(xi) :] = by_u[:, 3 * knots :].sum(0)[: self.basis.size - len(xi)]
        return value, gradient


def _part(states: np.ndarray, headings: np.ndarray, segments: slice) -> _Part:
    """Return a part of the states (segments, knots, 6), turned by the headings (segments,), rad."""
    headings = headings[segments, None]
    cos, sin = np.cos(headings), np.sin(headings)
    turned = states[segments].copy()
    turned[..., :3] = _rotated(turned[..., :3], cos, sin)
    turned[..., 5] += headings
    return _Part(segments=segments, inputs=np.ascontiguousarray(turned.reshape(-1, 6).T), cos=cos, sin=sin)


def _rotated(vectors: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Return vectors (segments, knots, 3), NED, turned about the vertical."""
    out = vectors.copy()
    out[..., 0] = cos * vectors[..., 0] - sin * vectors[..., 1]
    out[..., 1] = sin * vectors[..., 0] + cos * vectors[..., 1]
    return out
