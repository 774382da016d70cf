"""Learning on the condensed loss: L-BFGS over a network's weights, parameters of effects and pose delay."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.optimize import minimize

from trimtab.host.learn.condensed import DELAY_S, Condensed, CondensedSettings
from trimtab.host.models.network import Layout

SLAB = 2.0
"""Prior sigma of a parameter in typical sizes, and of the delay in units of DELAY_S, for all data."""

_MEMORY = 30


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
    """Condensed segments with v_ned and Theta at their nodes."""

    condensed: Condensed
    states: Annotated[np.ndarray, "segments nodes 6"]


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
    basis: Basis, xi: Annotated[np.ndarray, "weights"], states: Annotated[np.ndarray, "segments nodes 6"]
) -> Annotated[np.ndarray, "segments nodes 3"]:
    """Return the network's acceleration, NED, at states."""
    if basis.layout is None:
        return np.zeros((*states.shape[:2], 3))
    flat = basis.layout.arrays(xi, states.reshape(-1, 6).T)
    return flat.T.reshape(*states.shape[:2], 3)


def fit(
    basis: Basis,
    train: Examples,
    validation: Examples,
    start: Annotated[np.ndarray, "values"],
    settings: CondensedSettings,
    *,
    headings: Annotated[np.ndarray, "copies segments"] | None = None,
    on_iteration: Callable[[int, float], None] | None = None,
) -> Fitted:
    """Return the values that fit best, from `start`; stop early where validation does not improve.

    headings, rad: every segment counts once for each of these angles, turned by it.
    """
    problem = _Problem(basis, train, l2=settings.l2, headings=headings)
    checked = _Problem(basis, validation, l2=0.0, headings=None, scale=problem.scale)
    losses, checks = [], [checked.loss(start)]
    best = [start.copy(), 0]

    class Enough(Exception):
        pass

    def after(v: np.ndarray) -> None:
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
        minimize(problem, start, jac=True, method="L-BFGS-B", callback=after, options=options)
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


class _Problem:
    """Loss and slope by the learned values: mean over segments, scaled to a unit mean diagonal."""

    def __init__(
        self,
        basis: Basis,
        examples: Examples,
        *,
        l2: float,
        headings: np.ndarray | None,
        scale: float | None = None,
    ) -> None:
        self.basis, self.condensed, self.l2 = basis, examples.condensed, l2
        count, nodes = examples.states.shape[:2]
        self.headings = np.zeros((1, count)) if headings is None else headings
        diagonal = np.einsum("sii->si", self.condensed.hessian)[:, : 3 * nodes]
        self.scale = 1.0 / float(diagonal.mean()) if scale is None else scale
        self.last = np.inf
        # (copies, S, N + 1, 6) turned, then (6, all)
        c, s = np.cos(self.headings)[..., None], np.sin(self.headings)[..., None]
        turned = np.repeat(examples.states[None], len(self.headings), axis=0)
        north, east = turned[..., 0].copy(), turned[..., 1].copy()
        turned[..., 0], turned[..., 1] = c * north - s * east, s * north + c * east
        turned[..., 5] += self.headings[..., None]
        self._c, self._s = c, s
        self._inputs = np.ascontiguousarray(turned.reshape(-1, 6).T)
        self._shape = (len(self.headings), count, nodes, 3)

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
        layout, (copies, count, nodes, _) = self.basis.layout, self._shape
        u = np.empty_like(self.condensed.at)
        u[:, 3 * nodes :] = [*eta, delay]
        total, gradient = 0.0, np.zeros(len(v))
        share = self.scale / (count * copies)
        pushes = np.zeros(self._shape)
        if layout is not None:
            pushes = layout.arrays(xi, self._inputs).T.reshape(self._shape)
        pull = np.empty(self._shape)
        for copy in range(copies):
            u[:, : 3 * nodes] = self._turned_back(pushes[copy], copy).reshape(count, -1)
            value, by_u = self.condensed.loss(u)
            total += share * value
            if slope:
                pull[copy] = self._turned(share * by_u[:, : 3 * nodes].reshape(count, nodes, 3), copy)
                tail = share * by_u[:, 3 * nodes :].sum(0)
                gradient[len(xi) :] += tail if self.basis.delay else tail[:-1]
        prior = len(v) - len(xi)
        total += self.l2 * float(xi @ xi) + self.scale / count * float((v[len(xi) :] ** 2).sum()) / SLAB**2
        if slope:
            if layout is not None:
                gradient[: len(xi)] = layout.vjp(xi, self._inputs, pull.reshape(-1, 3).T)
            gradient[: len(xi)] += 2.0 * self.l2 * xi
            if prior:
                gradient[len(xi) :] += 2.0 * self.scale / count * v[len(xi) :] / SLAB**2
        return total, gradient

    def _turned(self, vectors: np.ndarray, copy: int) -> np.ndarray:
        c, s, out = self._c[copy], self._s[copy], vectors.copy()
        out[..., 0] = c * vectors[..., 0] - s * vectors[..., 1]
        out[..., 1] = s * vectors[..., 0] + c * vectors[..., 1]
        return out

    def _turned_back(self, vectors: np.ndarray, copy: int) -> np.ndarray:
        c, s, out = self._c[copy], self._s[copy], vectors.copy()
        out[..., 0] = c * vectors[..., 0] + s * vectors[..., 1]
        out[..., 1] = -s * vectors[..., 0] + c * vectors[..., 1]
        return out
