"""Minima of quadratics within bounds, also for parameters that add to each other."""

from __future__ import annotations

from typing import Annotated

import numpy as np

_BLOCK_PIVOTS, _PIVOTS = 8, 60
"""Changes of the set of components at bounds: of all together, and in all."""


def with_added(
    theta_scaled: Annotated[np.ndarray, "... parameters"],
    added: Annotated[np.ndarray, "parameters"],
    sign: float = 1.0,
) -> Annotated[np.ndarray, "... parameters"]:
    """Return each entry plus `sign` times the one with the index `added`; -1 for none."""
    return theta_scaled + sign * np.where(added >= 0, theta_scaled[..., added], 0.0)


def minimise_sums(
    normal: Annotated[np.ndarray, "... parameters parameters"],
    minimum: Annotated[np.ndarray, "... parameters"],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    limits: tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters"]],
    added: Annotated[np.ndarray, "parameters"],
) -> Annotated[np.ndarray, "... parameters"]:
    """Return the steps from theta_scaled that minimise quadratics, with sums between lower and upper limits.

    normal, minimum: Hessian and unconstrained minimum, as a step, of each quadratic. added: for each
    parameter, the one to which it adds; -1 for none.
    """
    centre = with_added(theta_scaled, added)
    inverse = with_added(np.eye(len(added)), added, -1.0)
    sums = exact_minimum(
        inverse @ normal @ inverse.T, with_added(minimum, added), limits[0] - centre, limits[1] - centre
    )
    return with_added(sums, added, -1.0)


def exact_minimum(
    normal: Annotated[np.ndarray, "... parameters parameters"],
    minimum: Annotated[np.ndarray, "... parameters"],
    lower: Annotated[np.ndarray, "parameters"],
    upper: Annotated[np.ndarray, "parameters"],
) -> Annotated[np.ndarray, "... parameters"]:
    """Return the minimisers of quadratics between `lower` and `upper`, by principal pivoting.

    normal, minimum: Hessian and unconstrained minimum of each quadratic. A component that crosses a bound is
    fixed there, and one whose gradient points off its bound is freed: all at once in the first _BLOCK_PIVOTS
    changes, then the last such component alone, which cannot cycle (Judice and Pires 1994). If the pivoting
    does not end, its last point is clipped.
    """
    side, at = np.zeros(minimum.shape, dtype=int), minimum
    for pivot in range(_PIVOTS):
        slope = (normal @ (at - minimum)[..., None])[..., 0]
        target = np.where(side == 0, (at > upper) * 1 - (at < lower) * 1, side * (side * slope <= 0.0))
        wrong = target != side
        if not wrong.any():
            break
        if pivot >= _BLOCK_PIVOTS:
            last = np.arange(1, wrong.shape[-1] + 1) * wrong
            wrong &= last == last.max(-1, keepdims=True)
        side = np.where(wrong, target, side)
        at = _minimum_with_fixed(normal, minimum, side != 0, np.where(side > 0, upper, lower))
    return np.clip(at, lower, upper)


def _minimum_with_fixed(
    normal: Annotated[np.ndarray, "... parameters parameters"],
    minimum: Annotated[np.ndarray, "... parameters"],
    fixed: Annotated[np.ndarray, "... parameters"],
    bound: Annotated[np.ndarray, "... parameters"],
) -> Annotated[np.ndarray, "... parameters"]:
    """Return the minimisers of quadratics in the other components if `fixed` ones are at `bound`."""
    shift = normal @ np.where(fixed, bound - minimum, 0.0)[..., None]
    among_free = np.where(fixed[..., None] | fixed[..., None, :], np.eye(minimum.shape[-1]), normal)
    step = np.linalg.solve(among_free, np.where(fixed[..., None], 0.0, shift))[..., 0]
    return np.where(fixed, bound, minimum - step)
