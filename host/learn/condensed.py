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

from firmware_model.law.ops import FLOAT
from host.learn.adjoint import Rollouts
from host.learn.lanes import LaneRollouts
from host.models.dynamics import mocap_latency_s
from host.models.phi import Phi
from host.models.segments import Segments

_PUSH = 0.05
"""m/s^2, of central differences by the acceleration."""

_SHARE = 0.02
"""Typical sizes, of those by an effect's parameter; sigmas, of those by a state."""

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
    taken_s: float = 0.0,
) -> Condensed:
    """The segments' loss about residual acceleration (S, N + 1, 3), NED, theta (P,) and a delay of poses, s.

    weight (12,): diagonal L of the loss; start_sigma (S, size): scale of what starts may move; free: which
    entries of theta are learned; taken_s: the latency that the measured states were taken to have. Effects
    that make poses late make the measured states so, beside what they do on board.
    """
    scale = effect_scales(engine.phi)
    delay = (delay_s + latency_s(engine.phi, theta) - taken_s) / DELAY_S
    unit = np.diag(scale)
    later = [latency_s(engine.phi, theta + unit[i]) - latency_s(engine.phi, theta) for i in free]
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
        base, moved, shifted = _sensitivities(engine, part, x0, acceleration[block], theta, free, sigma)
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


def _sensitivities(
    engine: Rollouts | LaneRollouts,
    segments: Segments,
    start: np.ndarray,
    acceleration: np.ndarray,
    theta: np.ndarray,
    free: Sequence[int],
    sigma: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The predictions (S, 12 N) and what they move by: by node accelerations and free parameters (S, 12 N,
    3 (N + 1) + P) and by sigmas of the start (S, 12 N, size).

    Every step is linearised on its own by central differences about the roll-out, and the steps are chained.
    """
    count, nodes = acceleration.shape[:2]
    steps, size = nodes - 1, engine.phi.size
    thetas = np.repeat(theta[None], count, axis=0)
    states = engine.pushed(segments)(start, thetas, between(acceleration))
    by_state, by_first, by_second, by_theta = _step_slopes(
        engine, segments, states, acceleration, theta, free, sigma
    )
    moved = np.empty((count, steps, 12, 3 * nodes + len(free)))
    shifted = np.empty((count, steps, 12, size))
    by_u, by_start = np.zeros((count, size, 3 * nodes + len(free))), sigma[:, None, :] * np.eye(size)
    for k in range(steps):
        reached = 3 * (k + 1)
        by_u[:, :, :reached] = by_state[:, k] @ by_u[:, :, :reached]
        by_u[:, :, 3 * nodes :] = by_state[:, k] @ by_u[:, :, 3 * nodes :] + by_theta[:, k]
        by_u[:, :, 3 * k : reached] += by_first[:, k]
        by_u[:, :, reached : reached + 3] += by_second[:, k]
        by_start = by_state[:, k] @ by_start
        moved[:, k], shifted[:, k] = by_u[:, :12], by_start[:, :12]
    base = states[:, 1:, :12].reshape(count, -1)
    return base, moved.reshape(count, 12 * steps, -1), shifted.reshape(count, 12 * steps, -1)


def _step_slopes(
    engine: Rollouts | LaneRollouts,
    segments: Segments,
    states: np.ndarray,
    acceleration: np.ndarray,
    theta: np.ndarray,
    free: Sequence[int],
    sigma: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What one step's end moves by (S, N, size, columns): by its start, by the acceleration at its start and
    at its end, by the free parameters in typical sizes.
    """
    count, steps, size = states.shape[0], states.shape[1] - 1, states.shape[2]
    rows = np.arange(count * steps)
    segment, step = rows // steps, rows % steps
    single = Segments(
        step_s=segments.step_s,
        x0=states[:, :-1].reshape(-1, size),
        measured=np.zeros((len(rows), 2, 12)),
        sigma=segments.sigma[segment],
        drive=segments.drive[segment[:, None], 2 * step[:, None] + np.arange(3)],
        constants=segments.constants[segment],
        flight=segments.flight[segment],
        vectors=segments.vectors,
    )
    roll = engine.pushed(single)
    start, thetas = single.x0.copy(), np.repeat(theta[None], len(rows), axis=0)
    ends = np.stack([acceleration[:, :-1], acceleration[:, 1:]], axis=2).reshape(-1, 2, 3)

    def slope(array: np.ndarray, column: int, reach: np.ndarray | float) -> np.ndarray:
        """(S N, size): by a column of one of the three arrays, a view of what the roll-out takes."""
        kept = array[:, column].copy()
        found = []
        for sign in (1.0, -1.0):
            array[:, column] = kept + sign * reach
            found.append(roll(start, thetas, between(ends))[:, 1])
        array[:, column] = kept
        return (found[0] - found[1]) / (2.0 * np.reshape(reach, (-1, 1)))

    def stacked(columns: list[np.ndarray]) -> np.ndarray:
        """(S, N, size, columns)."""
        if not columns:
            return np.zeros((count, steps, size, 0))
        return np.stack(columns, axis=-1).reshape(count, steps, size, -1)

    flat, spread, scale = ends.reshape(-1, 6), _SHARE * sigma[segment], effect_scales(engine.phi)
    by_push = stacked([slope(flat, i, _PUSH) for i in range(6)])
    return (
        stacked([slope(start, i, spread[:, i]) for i in range(size)]),
        by_push[..., :3],
        by_push[..., 3:],
        stacked([scale[i] * slope(thetas, i, _SHARE * scale[i]) for i in free]),
    )


def between(nodes: np.ndarray) -> np.ndarray:
    """(..., 2 N + 1, 3): values at nodes (..., N + 1, 3), and half way between them."""
    out = np.empty((*nodes.shape[:-2], 2 * nodes.shape[-2] - 1, nodes.shape[-1]))
    out[..., 0::2, :] = nodes
    out[..., 1::2, :] = 0.5 * (nodes[..., 1:, :] + nodes[..., :-1, :])
    return out


def _rates(measured: np.ndarray, step_s: float) -> np.ndarray:
    """(..., N + 1, 12): how fast what the cameras see changes, zero for the gyro's body rate."""
    rates = np.gradient(measured, step_s, axis=-2)
    rates[..., 9:] = 0.0
    return rates


def latency_s(phi: Phi, theta: np.ndarray) -> float:
    """Undeclared age of a pose at its time stamp, of phi's effects at theta."""
    return float(mocap_latency_s(FLOAT, phi.parts(theta)))


def effect_scales(phi: Phi) -> np.ndarray:
    """(P,): typical sizes of phi's effects' parameters."""
    return np.array([p.typical for effect in phi.effects for p in effect.parameters])
