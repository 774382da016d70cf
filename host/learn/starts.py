"""Free starts of segments: what a start moves along its roll-out, and the start that fits best.

A segment's x0 is known only to its sigma; held at its measured value, its noise would be learned as
residual. So it is free, with weight 1/sigma^2. Its best value for a given network is one least-squares step,
with the sensitivity of the roll-out to the start taken once from the nominal model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from host.models.phi import FLIGHT, INTEGRAL, Phi
from host.models.rollout import roll_out
from host.models.segments import Segments

_THRUST_SIGMA = 0.05
"""N a rotor: the recorded command behind the nominal lag."""
_INTEGRAL_SIGMA = 0.05
"""rad/s^2: logged, and tied to the log; free it would absorb torques."""
_OBSERVER_SIGMA = (0.02, 0.02, 0.02, 2.0 * _THRUST_SIGMA)
"""m/s^2 and N: logged, and what was commanded behind the nominal lag."""
_LANES = 2000


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


def free_starts(phi: Phi, theta: np.ndarray, segments: Segments, weight: np.ndarray) -> Starts:
    """The starts' freedom about the measured ones. `weight` (12,): diagonal L of the loss."""
    size, sigma = phi.size, start_sigma(phi, segments)
    gain = np.empty((segments.count, size, 12 * segments.steps))
    keep = np.empty((segments.count, size, size))
    root = np.sqrt(np.tile(weight, segments.steps))
    block = max(1, _LANES // (2 * size))
    for first in range(0, segments.count, block):
        chosen = np.arange(first, min(first + block, segments.count))
        # (steps * 12, b, size): central differences, one sigma either way
        slope = _sensitivity(phi, theta, segments.take(chosen), sigma[chosen])
        for i, segment in enumerate(chosen):
            G = root[:, None] * slope[:, i]
            normal = G.T @ G + np.eye(size)
            gain[segment] = np.linalg.solve(normal, G.T * root)
            keep[segment] = np.linalg.solve(normal, G.T @ G)
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


def _sensitivity(phi: Phi, theta: np.ndarray, segments: Segments, sigma: np.ndarray) -> np.ndarray:
    """(12 steps, segments, size): change of the stacked states for one sigma of each entry of the start."""
    count, size = segments.count, phi.size
    lanes = count * size * 2
    x0 = np.repeat(segments.x0[:, None, None, :], size, axis=1).repeat(2, axis=2)
    for i in range(size):
        x0[:, i, 0, i] += sigma[:, i]
        x0[:, i, 1, i] -= sigma[:, i]
    states = roll_out(
        phi,
        x0=x0.reshape(lanes, size).T,
        drive=segments.drive.transpose(1, 2, 0),
        flight=segments.constants.reshape(count, len(FLIGHT)).T,
        theta=theta,
        step_s=segments.step_s,
        lane_flight=np.repeat(np.arange(count), 2 * size),
        compiled=True,
    )[1:]
    states = states.reshape(segments.steps * 12, count, size, 2)
    return 0.5 * (states[..., 0] - states[..., 1])
