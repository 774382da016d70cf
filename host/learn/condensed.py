"""The trajectory loss condensed: quadratic in the residual acceleration along each segment.

A segment's prediction is linearised once about a roll-out, by the acceleration at its nodes, the effects'
parameters, the delay of the poses against their time stamps, and its start. The acceleration follows a cubic
spline through its values at every third node, since flights are smooth over 60 ms. The start is free within
its sigma, so its best value is eliminated (Schur complement). One small matrix per segment remains. Learning
then costs as much as supervised learning, and a basis that is linear in its parameters takes one solve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.interpolate import CubicSpline

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.base import parallel
from trimtab.host.learn.adjoint import Rollouts
from trimtab.host.learn.lanes import LaneRollouts
from trimtab.host.learn.linear import effect_scales, linearised
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments
from trimtab.host.models.slots import mocap_latency_s

KNOT_STEPS = 3
"""Steps from one knot of the acceleration to the next: 60 ms."""

_BLOCK = 32
"""Segments at a time, which take about a hundred megabytes."""


@dataclass(frozen=True, kw_only=True)
class CondensedSettings:
    """How to learn on the condensed loss.

    layout: of the network, None for effects alone. passes: each condenses about the result of the one before.
    patience: iterations without a better validation loss that end a pass. l2: penalty on the weights, for a
    loss of unit mean diagonal. free_start: segments start where they fit best, not as measured. delay:
    estimate how much later the poses are than stamped.
    """

    layout: Layout | None = field(default_factory=lambda: Layout(hidden=(32, 32)))
    iterations: int = 300
    patience: int = 40
    passes: int = 2
    l2: float = 1e-5
    any_heading: bool = True
    free_start: bool = True
    delay: bool = False

    def __post_init__(self) -> None:
        if min(self.iterations, self.patience, self.passes) < 1 or self.l2 < 0.0:
            raise ValueError(f"iterations, patience and passes must be positive, l2 not negative: {self}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Condensed:
    """The loss of each segment, c + 2 g' u + u' H u, with u = [d at the knots; eta; delay] - `at`.

    The unknowns u are 3 for each knot, eta and 1. eta: free parameters of effects in typical sizes from
    neutral. The delay is in units of DELAY_S. A segment's loss is the weighted mean over its steps.
    curvature: mean of the Hessian's diagonal by the accelerations at single nodes.
    """

    hessian: Annotated[np.ndarray, "segments unknowns unknowns"]
    slope: Annotated[np.ndarray, "segments unknowns"]
    constant: Annotated[np.ndarray, "segments"]
    at: Annotated[np.ndarray, "segments unknowns"]
    curvature: Annotated[np.ndarray, "segments"]
    knots: int

    def take(self, segments: slice) -> Condensed:
        """Return the loss of some of the segments."""
        return Condensed(
            hessian=self.hessian[segments],
            slope=self.slope[segments],
            constant=self.constant[segments],
            at=self.at[segments],
            curvature=self.curvature[segments],
            knots=self.knots,
        )

    def loss(
        self, u: Annotated[np.ndarray, "segments unknowns"]
    ) -> tuple[float, Annotated[np.ndarray, "segments unknowns"]]:
        """Return the sum over segments for u, and its slope."""
        away = u - self.at
        pulled = np.matmul(self.hessian, away[:, :, None])[:, :, 0]
        total = float(self.constant.sum() + (away * (pulled + 2.0 * self.slope)).sum())
        return total, 2.0 * (pulled + self.slope)


DELAY_S = 0.01
"""Scale of the delay of poses."""


def knots(nodes: int) -> Annotated[np.ndarray, "knots"]:
    """Return the nodes of a segment that are knots of the acceleration: the last node is always one."""
    return np.unique([*range(0, nodes, KNOT_STEPS), nodes - 1])


def spline(nodes: int) -> Annotated[np.ndarray, "nodes knots"]:
    """Return the accelerations at the nodes by those at the knots."""
    at = knots(nodes)
    return CubicSpline(at, np.eye(len(at)))(np.arange(nodes))


def condense(  # noqa: PLR0913 (the data of one problem)
    engine: Rollouts | LaneRollouts,
    segments: Segments,
    *,
    start_sigma: Annotated[np.ndarray, "segments size"],
    acceleration: Annotated[np.ndarray, "segments knots 3"],
    theta: Annotated[np.ndarray, "parameters"],
    free: Sequence[int],
    delay_s: float = 0.0,
    taken_s: float = 0.0,
    jobs: int = 1,
) -> Condensed:
    """Return the segments' loss, condensed about a residual acceleration, theta and a delay of poses.

    acceleration: NED, at the `knots`. start_sigma: scale of changes of the starts. free:
    entries of theta that are learned. taken_s: the latency that the measured states were given. An effect
    that makes poses late delays the measured states too, in addition to its effect on board. jobs: threads.
    """
    scale = effect_scales(engine.phi)
    now_s, unit = latency_s(engine.phi, theta), np.diag(scale)
    delay = (delay_s + now_s - taken_s) / DELAY_S
    later = [latency_s(engine.phi, theta + unit[i]) - now_s for i in free]
    count, nodes, parameters = segments.count, segments.steps + 1, len(free)
    between_knots, by_knots = spline(nodes), 3 * acceleration.shape[1]
    size = by_knots + parameters + 1
    hessian, slope = np.empty((count, size, size)), np.empty((count, size))
    constant, at, curvature = np.empty(count), np.empty((count, size)), np.empty(count)
    weight = engine.weight / segments.steps

    def condense_block(first: int) -> None:
        block = np.arange(first, min(first + _BLOCK, count))
        part, sigma = segments.take(block), start_sigma[block]
        ahead = DELAY_S * _rates(part.measured, part.step_s)  # the change by which late poses lag
        x0 = part.x0.copy()
        x0[:, :12] += delay * ahead[:, 0]
        linear = linearised(engine, part, x0, between_knots @ acceleration[block], theta, free, sigma)
        chained = linear.chained(sigma[:, None, :] * np.eye(sigma.shape[1]))
        by_theta, by_start = chained[..., :parameters], chained[..., parameters:]
        late = by_start[..., :12] @ (ahead[:, 0] / sigma[:, :12])[:, None, :, None] - ahead[:, 1:, :, None]
        by_theta += np.array(later) / DELAY_S * late
        residual = part.measured[:, 1:] + delay * ahead[:, 1:] - linear.states[:, 1:, :12]
        both = linear.products(
            weight, np.concatenate([by_theta, late, residual[..., None], by_start], axis=3)
        )
        curvature[block] = np.einsum("sii->si", both)[:, : 3 * nodes].mean(1)
        for _ in ("rows", "columns"):
            both = _rows_by_knots(both, between_knots).swapaxes(1, 2)
        # The start's sigmas belong to one measurement; the loss is a mean over steps.
        normal = both[:, size + 1 :, size + 1 :] + np.eye(sigma.shape[1]) / segments.steps
        shared = both[:, : size + 1, size + 1 :]
        over = both[:, : size + 1, : size + 1] - shared @ np.linalg.solve(normal, shared.swapaxes(1, 2))
        hessian[block], slope[block] = over[:, :size, :size], -over[:, :size, size]
        constant[block] = over[:, size, size]
        at[block, :by_knots] = acceleration[block].reshape(len(block), -1)

    parallel.each(condense_block, range(0, count, _BLOCK), jobs if isinstance(engine, LaneRollouts) else 1)
    at[:, by_knots:-1] = ((theta - engine.phi.theta_neutral) / scale)[list(free)]
    at[:, -1] = delay_s / DELAY_S
    return Condensed(
        hessian=hessian,
        slope=slope,
        constant=constant,
        at=at,
        curvature=curvature,
        knots=acceleration.shape[1],
    )


def _rows_by_knots(products: np.ndarray, between_knots: np.ndarray) -> np.ndarray:
    """Return the products (segments, rows, columns) with 3 first rows for each knot, not each node."""
    (count, _, columns), nodes = products.shape, len(between_knots)
    by_knots = between_knots.T @ products[:, : 3 * nodes].reshape(count, nodes, -1)
    return np.concatenate([by_knots.reshape(count, -1, columns), products[:, 3 * nodes :]], axis=1)


def _rates(measured: np.ndarray, step_s: float) -> np.ndarray:
    """Return the rates (..., N + 1, 12) of what cameras measure, zero for the body rate of the gyro."""
    rates = np.gradient(measured, step_s, axis=-2)
    rates[..., 9:] = 0.0
    return rates


def latency_s(phi: Phi, theta: Annotated[np.ndarray, "parameters"]) -> float:
    """Return the undeclared age of a pose at its time stamp, by phi's effects at theta."""
    return float(mocap_latency_s(FLOAT, phi.parts(theta)))
