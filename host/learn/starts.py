"""Free starts of segments: the sensitivity of a roll-out to its start, and the start that fits best.

A segment's x0 is known only within its sigma. With x0 fixed at its measured value, its noise would be learned
as residual. It is therefore free, with weight 1/sigma^2. Its best value for a given network takes one
least-squares step, with the sensitivity of the roll-out computed once from the nominal model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.learn.adjoint import Rollouts
from trimtab.host.learn.lanes import LaneRollouts
from trimtab.host.learn.linear import linearised
from trimtab.host.models.phi import INTEGRAL, Phi
from trimtab.host.models.segments import Segments

_THRUST_SIGMA = 0.05
"""N per rotor: error of the recorded command, with the nominal lag and where an effect delays it."""
_INTEGRAL_SIGMA = 0.05
"""rad/s^2: the logged integral may hardly move; free, it would absorb torques."""
_OBSERVER_SIGMA = (0.02, 0.02, 0.02, 2.0 * _THRUST_SIGMA)
"""m/s^2 and N: of the logged estimate, and of the commanded thrust with the nominal lag."""
_BLOCK = 32
"""Segments at a time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Starts:
    """The freedom of each segment's start, as shifts in sigmas.

    sigma: scale of a shift. With G the change of the weighted roll-out, 12 rows for each step, by the shifts
    and M = G'G + I: gain is M^-1 G' of a stacked residual, keep M^-1 G'G.
    """

    sigma: Annotated[np.ndarray, "segments size"]
    gain: Annotated[np.ndarray, "segments size rows"]
    keep: Annotated[np.ndarray, "segments size size"]

    def refine(
        self,
        indices: Annotated[np.ndarray, "chosen"],
        shift: Annotated[np.ndarray, "chosen size"],
        residual: Annotated[np.ndarray, "chosen steps 12"],
    ) -> Annotated[np.ndarray, "chosen size"]:
        """Return better shifts of some segments: least |residual - G ds|^2 + |shift + ds|^2.

        residual: measured - predicted, of roll-outs from the present shift.
        """
        flat = residual.reshape(len(indices), -1)
        pulled = np.einsum("bij,bj->bi", self.gain[indices], flat)
        return pulled + np.einsum("bij,bj->bi", self.keep[indices], shift)


def free_starts(
    engine: Rollouts | LaneRollouts,
    theta: Annotated[np.ndarray, "parameters"],
    segments: Segments,
    weight: Annotated[np.ndarray, "12"],
) -> Starts:
    """Return the freedom of the starts about the measured ones. `weight`: diagonal L of the loss."""
    size, sigma = engine.phi.size, start_sigma(engine.phi, segments)
    gain = np.empty((segments.count, size, 12 * segments.steps))
    keep = np.empty((segments.count, size, size))
    root = np.sqrt(np.tile(weight, segments.steps))
    for first in range(0, segments.count, _BLOCK):
        block = np.arange(first, min(first + _BLOCK, segments.count))
        part = segments.take(block)
        still = np.zeros((part.count, part.steps + 1, 3))
        linear = linearised(engine, part, part.x0, still, theta, (), sigma[block])
        shifted = linear.chained(sigma[block, None, :] * np.eye(size))
        G = root[:, None] * shifted.reshape(part.count, -1, size)
        turned = G.swapaxes(1, 2)
        normal = turned @ G + np.eye(size)
        gain[block] = np.linalg.solve(normal, turned * root)
        keep[block] = np.linalg.solve(normal, turned @ G)
    return Starts(sigma=sigma, gain=gain, keep=keep)


def start_sigma(phi: Phi, segments: Segments) -> Annotated[np.ndarray, "segments size"]:
    """Return the standard deviation of each entry of the starts."""
    sigma = np.ones((segments.count, phi.size))
    sigma[:, 0:12] = segments.sigma
    sigma[:, 12:16] = sigma[:, phi.commands] = _THRUST_SIGMA
    sigma[:, INTEGRAL] = _INTEGRAL_SIGMA
    if phi.observes:
        sigma[:, phi.observer] = _OBSERVER_SIGMA
    return sigma
