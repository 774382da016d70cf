"""Free starts of segments: what a start moves along its roll-out, and the start that fits best.

A segment's x0 is known only to its sigma; held at its measured value, its noise would be learned as
residual. So it is free, with weight 1/sigma^2. Its best value for a given network is one least-squares step,
with the sensitivity of the roll-out to the start taken once from the nominal model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trimtab.host.learn.adjoint import Rollouts
from trimtab.host.learn.lanes import LaneRollouts
from trimtab.host.learn.linear import linearised
from trimtab.host.models.phi import INTEGRAL, Phi
from trimtab.host.models.segments import Segments

_THRUST_SIGMA = 0.05
"""N a rotor: the recorded command behind the nominal lag."""
_INTEGRAL_SIGMA = 0.05
"""rad/s^2: logged, and tied to the log; free it would absorb torques."""
_OBSERVER_SIGMA = (0.02, 0.02, 0.02, 2.0 * _THRUST_SIGMA)
"""m/s^2 and N: logged, and what was commanded behind the nominal lag."""
_BLOCK = 32
"""Segments at a time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Starts:
    """The freedom of each segment's start, as shifts in sigmas.

    sigma (segments, size): scale of a shift. With G the change of the weighted roll-out by the shifts and
    M = G'G + I: gain (segments, size, 12 steps) is M^-1 G' of a stacked residual, keep (segments, size, size)
    M^-1 G'G.
    """

    sigma: np.ndarray
    gain: np.ndarray
    keep: np.ndarray

    def refine(self, indices: np.ndarray, shift: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Better shifts (b, size) of segments `indices`: the least of |residual - G ds|^2 + |shift + ds|^2.

        residual (b, steps, 12): measured - predicted, of roll-outs from the present shift (b, size).
        """
        flat = residual.reshape(len(indices), -1)
        pulled = np.einsum("bij,bj->bi", self.gain[indices], flat)
        return pulled + np.einsum("bij,bj->bi", self.keep[indices], shift)


def free_starts(
    engine: Rollouts | LaneRollouts, theta: np.ndarray, segments: Segments, weight: np.ndarray
) -> Starts:
    """Return the starts' freedom about the measured ones. `weight` (12,): diagonal L of the loss."""
    size, sigma = engine.phi.size, start_sigma(engine.phi, segments)
    gain = np.empty((segments.count, size, 12 * segments.steps))
    keep = np.empty((segments.count, size, size))
    root = np.sqrt(np.tile(weight, segments.steps))
    for first in range(0, segments.count, _BLOCK):
        block = np.arange(first, min(first + _BLOCK, segments.count))
        part = segments.take(block)
        still = np.zeros((part.count, part.steps + 1, 3))
        _, _, shifted = linearised(engine, part, part.x0, still, theta, (), sigma[block])
        G = root[:, None] * shifted
        turned = G.swapaxes(1, 2)
        normal = turned @ G + np.eye(size)
        gain[block] = np.linalg.solve(normal, turned * root)
        keep[block] = np.linalg.solve(normal, turned @ G)
    return Starts(sigma=sigma, gain=gain, keep=keep)


def start_sigma(phi: Phi, segments: Segments) -> np.ndarray:
    """(segments, size): how well each entry of the starts is known."""
    sigma = np.ones((segments.count, phi.size))
    sigma[:, 0:12] = segments.sigma
    sigma[:, 12:16] = _THRUST_SIGMA
    sigma[:, INTEGRAL] = _INTEGRAL_SIGMA
    if phi.observes:
        sigma[:, phi.observer] = _OBSERVER_SIGMA
    return sigma
