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

from host.learn.adjoint import Rollouts
from host.learn.lanes import LaneRollouts
from host.models.phi import Phi
from host.models.segments import Segments

_PUSH = 0.05
"""m/s^2, of central differences by the acceleration."""

_SHARE = 0.02
"""Typical sizes, of those by an effect's parameter; sigmas, of those by the start."""


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
        """The sum over segments for u (S, m), and its slope (S, m)."""
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
) -> Condensed:
    """The segments' loss about residual acceleration (S, N + 1, 3), NED, theta (P,) and a delay of poses, s.

    weight (12,): diagonal L of the loss; start_sigma (S, size): scale of what starts may move; free: which
    entries of theta are learned.
    """
    scale = effect_scales(engine.phi)
    delay = delay_s / DELAY_S
    count, nodes, parameters = segments.count, segments.steps + 1, len(free)
    size = 3 * nodes + parameters + 1
    hessian, slope = np.empty((count, size, size)), np.empty((count, size))
    constant, at = np.empty(count), np.empty((count, size))
    root = np.tile(np.sqrt(weight / segments.steps), segments.steps)
    for k in range(count):
        ahead = DELAY_S * _rates(segments.measured[k], segments.step_s)  # where late poses have gone on to
        x0 = segments.x0[k].copy()
        x0[:12] += delay * ahead[0]
        base, moved, shifted = _sensitivities(
            engine, segments, k, x0, acceleration[k], theta, free, start_sigma[k]
        )
        late = shifted[:, :12] @ (ahead[0] / start_sigma[k, :12]) - ahead[1:].reshape(-1)
        measured = segments.measured[k, 1:].reshape(-1) + delay * ahead[1:].reshape(-1)
        left = root * (measured - base)
        u, s = root[:, None] * np.column_stack([moved, late]), root[:, None] * shifted
        normal = s.T @ s * segments.steps + np.eye(s.shape[1])
        # The start's sigmas are of one measurement, the loss is a mean over steps.
        best = np.linalg.solve(normal, s.T * segments.steps)
        left_over, u_over = left - s @ (best @ left), u - s @ (best @ u)
        hessian[k], slope[k] = u.T @ u_over, -u.T @ left_over
        constant[k] = left @ left_over
        at[k] = [*acceleration[k].reshape(-1), *np.zeros(parameters), delay]
    at[:, 3 * nodes : 3 * nodes + parameters] = ((theta - engine.phi.theta_neutral) / scale)[list(free)]
    return Condensed(hessian=hessian, slope=slope, constant=constant, at=at, nodes=nodes)


def _sensitivities(
    engine: Rollouts | LaneRollouts,
    segments: Segments,
    k: int,
    start: np.ndarray,
    acceleration: np.ndarray,
    theta: np.ndarray,
    free: Sequence[int],
    sigma: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The prediction (12 N,) and what it moves by: by node accelerations and free parameters (12 N,
    3 (N + 1) + P) and by sigmas of the start (12 N, size). Central differences.
    """
    nodes, size = len(acceleration), engine.phi.size
    own_free, scale = np.array(free, dtype=int), effect_scales(engine.phi)
    moves = 3 * nodes + len(free) + size
    lanes = 2 * moves + 1
    push = np.repeat(acceleration[None], lanes, axis=0)
    own, x0 = np.repeat(theta[None], lanes, axis=0), np.repeat(start[None], lanes, axis=0)
    for sign, first in ((1.0, 0), (-1.0, moves)):
        rows = first + np.arange(3 * nodes)
        push.reshape(lanes, -1)[rows, np.arange(3 * nodes)] += sign * _PUSH
        rows = first + 3 * nodes + np.arange(len(free))
        own[rows, own_free] += sign * _SHARE * scale[own_free]
        rows = first + 3 * nodes + len(free) + np.arange(size)
        x0[rows, np.arange(size)] += sign * _SHARE * sigma
    states = engine.sweep(segments, k, x0, own, between(push))
    predicted = states[:, 1:, :12].reshape(lanes, -1)
    step = np.repeat([_PUSH, _SHARE, _SHARE], [3 * nodes, len(free), size])
    moved = ((predicted[:moves] - predicted[moves : 2 * moves]) / (2.0 * step[:, None])).T
    return predicted[-1], moved[:, : 3 * nodes + len(free)], moved[:, 3 * nodes + len(free) :]


def between(nodes: np.ndarray) -> np.ndarray:
    """(..., 2 N + 1, 3): values at nodes (..., N + 1, 3), and half way between them."""
    out = np.empty((*nodes.shape[:-2], 2 * nodes.shape[-2] - 1, nodes.shape[-1]))
    out[..., 0::2, :] = nodes
    out[..., 1::2, :] = 0.5 * (nodes[..., 1:, :] + nodes[..., :-1, :])
    return out


def _rates(measured: np.ndarray, step_s: float) -> np.ndarray:
    """(N + 1, 12): how fast what the cameras see changes, zero for the gyro's body rate."""
    rates = np.gradient(measured, step_s, axis=0)
    rates[:, 9:] = 0.0
    return rates


def effect_scales(phi: Phi) -> np.ndarray:
    """(P,): typical sizes of phi's effects' parameters."""
    return np.array([p.typical for effect in phi.effects for p in effect.parameters])
