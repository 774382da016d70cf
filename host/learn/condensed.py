"""The trajectory loss condensed: quadratic in the residual acceleration along each segment.

Linearised once about a roll-out, a segment's prediction moves with the acceleration at its nodes, with the
effects' parameters, with how much later the poses are than stamped, and with its start. The start is free
within its sigma, so its best value is eliminated (Schur complement). What is left is one small matrix a
segment: after that, learning costs what supervised learning costs, and a basis that is linear in its
parameters is one solve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.learn.adjoint import Rollouts
from trimtab.host.learn.lanes import LaneRollouts
from trimtab.host.learn.linear import effect_scales, linearised
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments
from trimtab.host.models.slots import mocap_latency_s

_BLOCK = 32
"""Segments at a time: a hundred megabytes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Condensed:
    """Per segment: loss = c + 2 g' u + u' H u with u = [d at the nodes (N + 1, 3); eta; delay] less `at`.

    hessian (S, m, m), slope (S, m), constant (S,), at (S, m), m = 3 (N + 1) + P + 1. A segment's loss is the
    mean over its steps, weighted. eta (P,) are the free parameters of effects in typical sizes from neutral,
    the delay is in units of DELAY_S.
    """

    hessian: np.ndarray
    slope: np.ndarray
    constant: np.ndarray
    at: np.ndarray
    nodes: int

    def loss(self, u: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the sum over segments for u (S, m), and its slope (S, m)."""
        away = u - self.at
        pulled = np.matmul(self.hessian, away[:, :, None])[:, :, 0]
        total = float(self.constant.sum() + (away * (pulled + 2.0 * self.slope)).sum())
        return total, 2.0 * (pulled + self.slope)


DELAY_S = 0.01
"""Scale of the poses' delay."""


def condense(
    engine: Rollouts | LaneRollouts,
    segments: Segments,
    *,
    weight: np.ndarray,
    start_sigma: np.ndarray,
    acceleration: np.ndarray,
    theta: np.ndarray,
    free: Sequence[int],
    delay_s: float = 0.0,
    taken_s: float = 0.0,
) -> Condensed:
    """Return the segments' loss about residual acceleration (S, N + 1, 3), NED, theta (P,) and a delay of
    poses, s.

    weight (12,): diagonal L of the loss; start_sigma (S, size): scale of what starts may move; free: which
    entries of theta are learned; taken_s: the latency that the measured states were taken to have. Effects
    that make poses late make the measured states so, beside what they do on board.
    """
    scale = effect_scales(engine.phi)
    now_s, unit = latency_s(engine.phi, theta), np.diag(scale)
    delay = (delay_s + now_s - taken_s) / DELAY_S
    later = [latency_s(engine.phi, theta + unit[i]) - now_s for i in free]
    count, nodes, parameters = segments.count, segments.steps + 1, len(free)
    size = 3 * nodes + parameters + 1
    hessian, slope = np.empty((count, size, size)), np.empty((count, size))
    constant, at = np.empty(count), np.empty((count, size))
    root = np.tile(np.sqrt(weight / segments.steps), segments.steps)
    for first in range(0, count, _BLOCK):
        block = np.arange(first, min(first + _BLOCK, count))
        part, sigma = segments.take(block), start_sigma[block]
        ahead = DELAY_S * _rates(part.measured, part.step_s)  # where late poses have gone on to
        x0 = part.x0.copy()
        x0[:, :12] += delay * ahead[:, 0]
        base, moved, shifted = linearised(engine, part, x0, acceleration[block], theta, free, sigma)
        late = (shifted[:, :, :12] @ (ahead[:, 0] / sigma[:, :12])[:, :, None])[:, :, 0]
        late -= ahead[:, 1:].reshape(len(block), -1)
        for i, by_typical_s in enumerate(later):
            moved[:, :, 3 * nodes + i] += by_typical_s / DELAY_S * late
        measured = (part.measured[:, 1:] + delay * ahead[:, 1:]).reshape(len(block), -1)
        left = (root * (measured - base))[:, :, None]
        u = root[:, None] * np.concatenate([moved, late[:, :, None]], axis=2)
        s = root[:, None] * shifted
        transposed = s.swapaxes(1, 2) * segments.steps
        # The start's sigmas are of one measurement, the loss is a mean over steps.
        best = np.linalg.solve(transposed @ s + np.eye(s.shape[2]), transposed)
        left_over, u_over = left - s @ (best @ left), u - s @ (best @ u)
        hessian[block] = u.swapaxes(1, 2) @ u_over
        slope[block] = -(u.swapaxes(1, 2) @ left_over)[:, :, 0]
        constant[block] = (left * left_over).sum((1, 2))
        at[block, : 3 * nodes] = acceleration[block].reshape(len(block), -1)
    at[:, 3 * nodes : -1] = ((theta - engine.phi.theta_neutral) / scale)[list(free)]
    at[:, -1] = delay_s / DELAY_S
    return Condensed(hessian=hessian, slope=slope, constant=constant, at=at, nodes=nodes)


def _rates(measured: np.ndarray, step_s: float) -> np.ndarray:
    """(..., N + 1, 12): how fast what the cameras see changes, zero for the gyro's body rate."""
    rates = np.gradient(measured, step_s, axis=-2)
    rates[..., 9:] = 0.0
    return rates


def latency_s(phi: Phi, theta: np.ndarray) -> float:
    """Undeclared age of a pose at its time stamp, of phi's effects at theta."""
    return float(mocap_latency_s(FLOAT, phi.parts(theta)))
