"""The planner's state, and what an interval integrates, costs and bounds, for a vehicle with its model.

The paper's 12 states (eq. 1) and the four rotor thrusts in units of hover thrust; the inputs are the thrusts'
rates. With thrust as a state acceleration is continuous and the jerk finite, which a reference needs; the
paper's effort u'u weighs the thrusts themselves, as there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from firmware_model.law.constants import GRAVITY
from host.codegen import CASADI
from host.effects import Effect
from host.errors import UsageError
from host.models.dynamics import RATE, THETA, THRUST, Part, V, residual_acceleration_ned, rigid_body
from host.models.model import Model
from host.models.network import Network
from host.models.region import Region
from host.plan.stage import Layers, StageModel
from host.route.shapes import Box, Cylinder, Sphere
from host.vehicle import Limits, Vehicle

Array = NDArray[np.float64]
Shape = Box | Cylinder | Sphere

STATES, INPUTS, PARAMETERS = 16, 4, 2
"""The parameters are the heading asked for and a factor on the weight of the thrust rates."""
TILT_ROW, SPEED_ROW, JERK_ROW, FIRST_SHAPE_ROW = 0, 1, 2, 3
"""Rows bounded at every node: cos tilt; squared speed and squared jerk as shares of their squared limits;
distance from each keep-out shape in metres."""


@dataclass(frozen=True, kw_only=True)
class ResidualModel:
    """What is known beyond the nominal vehicle: effects with values, a network on top, where they hold.

    adjusted: those of the effects that only moved within their tolerance. They are part of every prediction,
    but give no plan something to avoid.
    """

    parts: tuple[Part, ...] = ()
    adjusted: frozenset[str] = frozenset()
    network: Network | None = None
    region: Region | None = None
    id: str | None = None

    @classmethod
    def of(cls, model: Model, effects: Mapping[str, Effect]) -> ResidualModel:
        """Effects and adjustments of a model file, and its network.

        Raises ValueError for unknown effects, UsageError for a network that the stage kernels do not know.
        """
        if model.network is not None and model.network.layout.frame != "world":
            raise UsageError(
                f"model {model.id}: its network is in the {model.network.layout.frame}'s frame, plans take "
                "one in the world's; learn it again with --frame world"
            )
        return cls(
            parts=tuple(model.parts(effects)),
            adjusted=frozenset(model.adjustments),
            network=model.network,
            region=model.region,
            id=model.id,
        )

    @property
    def has_residual(self) -> bool:
        """Whether it predicts a residual acceleration worth a plan: a network, or a drag beyond tolerance."""
        forces = {effect.name for effect, _ in self.parts if effect.specific_force_frd}
        return self.network is not None or bool(forces - self.adjusted)


@dataclass(frozen=True, kw_only=True)
class Weights:
    """What the cost holds beside the squared residual, m^2/s^4.

    control: of the squared rotor thrusts in units of hover thrust (the paper's lambda_r = 0.1 per N^2 on its
    0.752 kg vehicle is 0.34). thrust_rate: of their squared rates in 1/s: without it the plan ripples as fast
    as its nodes allow. yaw: of the squared deviation from the heading asked for, in radians; large, because
    the flat reference has no other heading.
    """

    control: float = 0.04
    thrust_rate: float = 0.004
    yaw: float = 1e4

    def scaled(self, factor: float) -> Weights:
        """All weights times the factor."""
        return Weights(
            control=factor * self.control, thrust_rate=factor * self.thrust_rate, yaw=factor * self.yaw
        )

    def __post_init__(self) -> None:
        for name in ("control", "thrust_rate", "yaw"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"weight {name} must be positive, not {value!r}")


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """A vehicle as the planner sees it. augmented: the model is in the dynamics, not only the cost."""

    vehicle: Vehicle
    model: ResidualModel = field(default_factory=ResidualModel)
    augmented: bool = False

    @property
    def hover_n(self) -> float:
        """Thrust of one rotor that carries a quarter of the nominal weight."""
        return self.vehicle.mass_kg * GRAVITY / 4.0

    def newtons(self, x: Sequence[Any]) -> list[Any]:
        """The state in the units of `host.models`: rotor thrusts in N."""
        return [*x[: THRUST.start], *(self.hover_n * thrust for thrust in x[THRUST])]

    def _scalars(self, x: ca.SX) -> list[Any]:
        return self.newtons([x[i] for i in range(STATES)])

    def derivative(self, x: ca.SX, u: ca.SX) -> ca.SX:
        """(16,) continuous dynamics, paper eq. 1, without the network."""
        parts = self.model.parts if self.augmented else ()
        return ca.vertcat(*rigid_body(CASADI, self.vehicle, parts, self._scalars(x)), u)

    def residual(self, x: ca.SX) -> ca.SX:
        """(3,) the residual acceleration d(x), NED, without the network."""
        return ca.vertcat(
            *residual_acceleration_ned(CASADI, self.vehicle, self.model.parts, self._scalars(x))
        )

    def jerk_squared(self, x: ca.SX, u: ca.SX) -> ca.SX:
        """The nominal vehicle's squared jerk: thrust changes along z_frd, and z_frd turns."""
        scale = self.hover_n / self.vehicle.mass_kg
        force, change = scale * ca.sum1(x[THRUST]), scale * ca.sum1(u)
        rate = x[RATE]
        return change**2 + force**2 * (rate[0] ** 2 + rate[1] ** 2)

    def hover(self, yaw: float) -> Array:
        """(16,) the state at rest at the origin in which nothing accelerates, in the planner's units.

        Newton's method on attitude and thrusts; differs from level only where the dynamics are augmented.
        Raises ValueError where the model has no such state.
        """
        unknown = ca.SX.sym("unknown", 6)
        x = ca.vertcat(ca.SX(6, 1), unknown[:2], yaw, ca.SX(3, 1), unknown[2:])
        xdot = self.derivative(x, ca.SX(INPUTS, 1))
        acceleration = xdot[V]
        if self.augmented and self.model.network is not None:
            inputs = [x[i] for i in range(V.start, THETA.stop)]
            network = self.model.network
            acceleration = acceleration + ca.vertcat(
                *network.layout.scalars(CASADI, list(network.xi), inputs)
            )
        equations = ca.vertcat(acceleration, xdot[RATE])
        step = ca.Function("step", [unknown], [equations, ca.jacobian(equations, unknown)])
        value = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
        for _ in range(20):
            error, slope = (np.array(part) for part in step(value))
            if not np.isfinite(slope).all():
                break
            if np.abs(error).max() < 1e-10:
                return np.concatenate([np.zeros(6), value[:2], [yaw], np.zeros(3), value[2:]])
            value = value - np.linalg.lstsq(slope, error, rcond=None)[0].ravel()
        raise ValueError("the model has no state of rest near level flight: its values cannot be right")

    def stage_model(
        self,
        *,
        minimise_residual: bool,
        weights: Weights,
        limits: Limits,
        keep_out: Sequence[Shape],
        weigh_time: bool,
    ) -> StageModel:
        """The interval's model; path rows as TILT_ROW and so on."""

        def effort(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
            thrust = x[THRUST]
            turn = x[THETA.stop - 1] - p[0]
            return (
                weights.control * ca.dot(thrust, thrust)
                + p[1] * weights.thrust_rate * ca.dot(u, u)
                + weights.yaw * turn * turn
            )

        def path(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
            position = [x[i] for i in range(3)]
            return ca.vertcat(
                ca.cos(x[6]) * ca.cos(x[7]),
                ca.dot(x[V], x[V]) / limits.speed_max_m_s**2,
                self.jerk_squared(x, u) / limits.jerk_max_m_s3**2,
                *(shape.signed_distance(CASADI, position) for shape in keep_out),
            )

        network = self.model.network
        return StageModel(
            nx=STATES,
            nu=INPUTS,
            np=PARAMETERS,
            derivative=self.derivative,
            residual=self.residual if minimise_residual else None,
            effort=effort,
            path=path,
            network=None if network is None else layers(network),
            augmented=self.augmented,
            weigh_time=weigh_time,
        )


def layers(network: Network) -> Layers:
    """The network's layers as matrices and biases; in its flat vector each row ends with its bias."""
    out: list[tuple[Array, Array]] = []
    start = 0
    sizes = network.layout.sizes
    for inputs, outputs in pairwise(sizes):
        stop = start + outputs * (inputs + 1)
        rows = network.xi[start:stop].reshape(outputs, inputs + 1)
        out.append((rows[:, :-1].copy(), rows[:, -1].copy()))
        start = stop
    return tuple(out)
