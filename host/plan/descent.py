"""A smooth function's local minimum within a box, by BFGS with projected steps.

numpy alone: scipy.optimize takes longer to import than a plan of a few waypoints takes to compute.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ARMIJO = 1e-4
"""Share of the predicted decrease that a step must bring."""
_HALVINGS = 30


def minimise_in_box(
    function: Callable[[Array], tuple[float, Array]],
    start: Annotated[np.ndarray, "n"],
    low: Annotated[np.ndarray, "n"],
    high: Annotated[np.ndarray, "n"],
    *,
    iterations: int,
    decrease: float,
    slope: float,
) -> Annotated[np.ndarray, "n"]:
    """Return a local minimum of `function`, which returns value and gradient, between `low` and `high`.

    It ends after this number of iterations, at a relative decrease of the value below `decrease`, or where no
    entry of the gradient that points into the box exceeds `slope`. Source: Bertsekas, SIAM J. Control and
    Optimization 20 (1982): entries at a bound that the gradient pushes against are fixed for the step.
    """
    x = np.clip(start, low, high)
    value, gradient = function(x)
    inverse = np.eye(len(x))  # of the Hessian
    for iteration in range(iterations):
        if np.abs(np.clip(x - gradient, low, high) - x).max() <= slope:
            break
        free = ~(((x <= low) & (gradient > 0.0)) | ((x >= high) & (gradient < 0.0)))
        step = _step(inverse, gradient, free)
        found = _search(function, x, value, gradient, step, low, high)
        if found is None:
            break
        x_next, value_next, gradient_next = found
        done = value - value_next <= decrease * max(abs(value), abs(value_next), 1.0)
        moved, change = x_next - x, gradient_next - gradient
        x, value, gradient = x_next, value_next, gradient_next
        if done:
            break
        curvature = float(moved @ change)
        if curvature > 1e-10 * float(change @ change):
            if iteration == 0:
                inverse *= curvature / float(change @ change)
            mixed = inverse @ change
            inverse += (1.0 + change @ mixed / curvature) * np.outer(moved, moved) / curvature
            inverse -= (np.outer(mixed, moved) + np.outer(moved, mixed)) / curvature
    return x


def _step(inverse: Array, gradient: Array, free: NDArray[np.bool_]) -> Array:
    """Return the quasi-Newton step of the free entries, downhill."""
    step = np.zeros(len(gradient))
    step[free] = -inverse[np.ix_(free, free)] @ gradient[free]
    return step


def _search(
    function: Callable[[Array], tuple[float, Array]],
    x: Array,
    value: float,
    gradient: Array,
    step: Array,
    low: Array,
    high: Array,
) -> tuple[Array, float, Array] | None:
    """Return the first point along the projected step that lowers the value enough, None if none does."""
    share = min(1.0, 1.0 / max(1.0, float(np.abs(step).max())))
    for _ in range(_HALVINGS):
        x_next = np.clip(x + share * step, low, high)
        value_next, gradient_next = function(x_next)
        if value_next <= value + _ARMIJO * float(gradient @ (x_next - x)):
            return x_next, value_next, gradient_next
        share *= 0.5
    return None
