"""The planner's state, and the dynamics, cost and path rows of an interval, for a vehicle with its model.

The state is the paper's 12 states (eq. 1) and the four rotor thrusts in units of hover thrust; the inputs are
the rates of the thrusts. With thrust as a state, acceleration is continuous and jerk finite, as a reference
needs. The paper's effort u'u is that of the thrusts, as in the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.rotations import euler_rates, euler_to_matrix, mat_vec
from trimtab.host.codegen import CASADI, NUMPY
from trimtab.host.models.airframe import RATE, THETA, THRUST, P, Part, V
from trimtab.host.models.dynamics import rigid_body
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.tracking_error import ERROR_RATE, ERROR_STATES, error_cost, error_derivative
from trimtab.host.shooting.stage import StageModel
from trimtab.host.vehicle import Limits, Vehicle

Array = NDArray[np.float64]

Minimised = Literal["residual", "error"]
"""What a plan minimises beside the effort: the residual, or the tracking error that it predicts."""
STATES, INPUTS = 16, 4
YAW, SMOOTHING, CONTROL, THRUST_RATE, YAW_WEIGHT, TIME, SPEED_MAX, JERK_MAX = range(8)
"""An interval's parameters, which may change without a rebuild.

They are the requested heading, a factor on the weight of the thrust rates, the weights and the limits. Then
follow the residual at rest (6), the effects' values, and where a path is tracked its weight and the position
(3) on it.
"""
REST = slice(8, 14)
EFFECTS = REST.stop
_STEP = 1e-6
"""Step of slopes by differences."""
TILT_ROW, SPEED_ROW, JERK_ROW = 0, 1, 2
PATH_ROWS = 3
"""Number of path rows: cos tilt; squared speed and squared jerk as shares of their squared limits.

A free heading adds a row, its rate in rad/s.
"""


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the cost beside the squared residual, m^2/s^4.

    control: of the squared rotor thrusts in units of hover thrust (the paper's lambda_r = 0.1 per N^2 on its
    0.752 kg vehicle is 0.34). thrust_rate: of their squared rates in 1/s; without it the plan ripples as fast
    as its nodes allow. yaw: of the squared deviation from the requested heading, in radians; large, because
    the flat reference has no other heading. time: per second, where the total time is free. tracking: of the
    squared distance in m from the path to track, where there is one.
    """

    control: float = 0.02
    thrust_rate: float = 0.002
    yaw: float = 1e4
    time: float = 0.0
    tracking: float = 100.0

    def scaled(self, factor: float) -> Weights:
        """Return all weights times the factor."""
        return Weights(
            control=factor * self.control,
            thrust_rate=factor * self.thrust_rate,
            yaw=factor * self.yaw,
            time=factor * self.time,
            tracking=factor * self.tracking,
        )

    def __post_init__(self) -> None:
        for name in ("control", "thrust_rate", "yaw", "time", "tracking"):
            value = getattr(self, name)
            if not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and name == "time"))):
                raise ValueError(f"weight {name} must be positive, not {value!r}")


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """A vehicle with its model. augmented: the model is in the dynamics, not only in the cost."""

    vehicle: Vehicle
    model: ResidualModel = field(default_factory=ResidualModel)
    augmented: bool = False
    _steady: dict[tuple[float, ...], Array] = field(
        default_factory=dict[tuple[float, ...], Array], init=False, repr=False, compare=False
    )
    """Steady states found before."""

    @property
    def hover_n(self) -> float:
        """Thrust of one rotor at hover, N."""
        return self.vehicle.mass_kg * GRAVITY / 4.0

    def newtons(self, x: Sequence[Any]) -> list[Any]:
        """Return the state in the units of `trimtab.host.models`: rotor thrusts in N."""
        return [*x[: THRUST.start], *(self.hover_n * thrust for thrust in x[THRUST])]

    def _scalars(self, x: ca.SX) -> list[Any]:
        return self.newtons([x[i] for i in range(STATES)])

    @property
    def theta(self) -> Annotated[np.ndarray, "values"]:
        """The effects' values, one after the other."""
        return np.array([value for _, values in self.model.parts for value in values], dtype=float)

    def _parts(self, p: Any) -> list[Part]:
        """Return the effects with their values from an interval's parameters."""
        parts, start = [], EFFECTS
        for effect, values in self.model.parts:
            parts.append((effect, [p[start + i] for i in range(len(values))]))
            start += len(values)
        return parts

    def derivative(self, x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
        """Return xdot (16,), paper eq. 1, without the network."""
        parts = self._parts(p) if self.augmented else ()
        return ca.vertcat(*rigid_body(CASADI, self.vehicle, parts, self._scalars(x)), u)

    def derivative_with_error(self, x: ca.SX, u: ca.SX, p: ca.SX, *, free_yaw: bool = False) -> ca.SX:
        """Return xdot (22,), with the predicted tracking error and its rate, without the network."""
        d = self.residual(x, p, free_yaw=free_yaw)[:3]
        return ca.vertcat(self.derivative(x, u, p), *error_derivative(self.vehicle, x, d))

    def residual(self, x: ca.SX, p: ca.SX, *, free_yaw: bool = False) -> ca.SX:
        """Return the rows (3 or 6,) of `ResidualModel.rows`, less their values at rest.

        The acceleration at rest is NED. Where the heading is free, it is that at heading 0 and turns with the
        vehicle.
        """
        d = ca.vertcat(*self.model.rows(CASADI, self.vehicle, self._scalars(x), self._parts(p)))
        rest = ca.vertsplit(p[REST])
        if free_yaw:
            turn = euler_to_matrix(CASADI, (0.0, 0.0, x[THETA.stop - 1]))
            rest = [*mat_vec(turn, rest[:3]), *rest[3:]]
        return d - ca.vertcat(*rest[: d.shape[0]])

    def parameters(
        self,
        yaw: Annotated[np.ndarray, "intervals"],
        *,
        smoothing: float = 1.0,
        weights: Weights | None = None,
        limits: Limits | None = None,
        rest: Annotated[np.ndarray, "6"] | None = None,
        tracked_ned: Annotated[np.ndarray, "3 intervals"] | None = None,
    ) -> Annotated[np.ndarray, "parameters intervals"]:
        """Return the parameters of intervals with these headings; values not given are the defaults.

        tracked_ned: position on the path to track at each interval's start; None for no such rows.
        """
        weights, limits = weights or Weights(), limits or self.vehicle.limits
        shared = [smoothing, weights.control, weights.thrust_rate, weights.yaw, weights.time]
        shared += [limits.speed_max_m_s, limits.jerk_max_m_s3, *(np.zeros(6) if rest is None else rest)]
        rows = np.concatenate([[0.0], shared, self.theta])
        out = np.repeat(rows[:, None], len(yaw), axis=1)
        out[YAW] = yaw
        if tracked_ned is None:
            return out
        return np.vstack([out, np.full(len(yaw), weights.tracking), tracked_ned])

    def _steady_error(
        self, unknown: Array, yaw: float, v_ned: Sequence[float], p_ned: Sequence[float]
    ) -> Array:
        """Return the accelerations (6, n) without body rates; unknown: (6, n) roll, pitch and thrusts."""
        zero = np.zeros(unknown.shape[1])
        moving = [zero + value for value in (*p_ned, *v_ned)]
        x = [*moving, unknown[0], unknown[1], zero + yaw, *[zero] * 3, *unknown[2:]]
        parts = self.model.parts if self.augmented else ()
        rows = rigid_body(NUMPY, self.vehicle, parts, self.newtons(x))
        acceleration = np.array([zero + row for row in [*rows[V], *rows[RATE]]])
        if self.augmented and self.model.network is not None:
            acceleration[:3] += self.model.network.acceleration_ned(np.array(x[V]), np.array(x[THETA]))
        return acceleration

    def jerk_squared(self, x: ca.SX, u: ca.SX) -> ca.SX:
        """Return the nominal vehicle's squared jerk: thrust changes along z_frd, and z_frd turns."""
        scale = self.hover_n / self.vehicle.mass_kg
        force, change = scale * ca.sum1(x[THRUST]), scale * ca.sum1(u)
        rate = x[RATE]
        return change**2 + force**2 * (rate[0] ** 2 + rate[1] ** 2)

    def steady(
        self,
        yaw: float,
        v_ned: Sequence[float] = (0.0, 0.0, 0.0),
        p_ned: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> Annotated[np.ndarray, "16"]:
        """Return the state, in the planner's units, of steady flight at p_ned (m) and v_ned (m/s).

        Newton's method on attitude and thrusts, with slopes by differences. The state differs from level
        hover only with augmented dynamics. Raises ValueError where the model has no such state.
        """
        asked = (yaw, *v_ned, *p_ned)
        if asked not in self._steady:
            self._steady[asked] = self._solve_steady(yaw, v_ned, p_ned)
        return self._steady[asked].copy()

    def _solve_steady(
        self, yaw: float, v_ned: Sequence[float], p_ned: Sequence[float]
    ) -> Annotated[np.ndarray, "16"]:
        value = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
        steps = _STEP * np.eye(6)
        for _ in range(20):
            points = value[:, None] + np.hstack([np.zeros((6, 1)), steps, -steps])
            errors = self._steady_error(points, yaw, v_ned, p_ned)
            error, slope = errors[:, 0], (errors[:, 1:7] - errors[:, 7:]) / (2.0 * _STEP)
            if not np.isfinite(slope).all():
                break
            if np.abs(error).max() < 1e-10:
                return np.concatenate([p_ned, v_ned, value[:2], [yaw], np.zeros(3), value[2:]])
            value = value - np.linalg.lstsq(slope, error, rcond=None)[0]
        if any(v_ned):
            raise ValueError(f"the model has no steady flight at {list(v_ned)} m/s near level flight")
        raise ValueError("the model has no state of rest near level flight: its values cannot be right")

    def stage_model(
        self, *, minimise: Minimised | None, free_yaw: bool = False, track_path: bool = False
    ) -> StageModel:
        """Return the interval's model; weights, limits and values of effects are parameters.

        minimise: what the cost has beside the effort. With "error" the state has the predicted tracking error
        and its rate (`trimtab.host.plan.tracking_error`). free_yaw: no heading is requested, and its rate is
        a path row. track_path: the cost has the squared distance from a path, by the last four parameters.
        """
        tracking = EFFECTS + len(self.theta)
        predict_error = minimise == "error"

        def effort(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
            thrust = x[THRUST]
            turn = 0.0 if free_yaw else x[THETA.stop - 1] - p[YAW]
            total = (
                p[CONTROL] * ca.dot(thrust, thrust)
                + p[SMOOTHING] * p[THRUST_RATE] * ca.dot(u, u)
                + p[YAW_WEIGHT] * turn * turn
                + p[TIME]
            )
            if predict_error:
                total += error_cost(self.vehicle, x)
            if track_path:
                total += p[tracking] * ca.sumsqr(x[P] - p[tracking + 1 : tracking + 4])
            return total

        def path(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
            rows = [
                ca.cos(x[6]) * ca.cos(x[7]),
                ca.dot(x[V], x[V]) / p[SPEED_MAX] ** 2,
                self.jerk_squared(x, u) / p[JERK_MAX] ** 2,
            ]
            if free_yaw:
                rows.append(euler_rates(CASADI, ca.vertsplit(x[THETA]), ca.vertsplit(x[RATE]))[2])
            return ca.vertcat(*rows)

        def residual(x: ca.SX, p: ca.SX) -> ca.SX:
            return self.residual(x, p, free_yaw=free_yaw)

        def derivative(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
            if predict_error:
                return self.derivative_with_error(x, u, p, free_yaw=free_yaw)
            return self.derivative(x, u, p)

        network_rows = V if self.augmented else ERROR_RATE if predict_error else None
        return StageModel(
            nx=STATES + (ERROR_STATES if predict_error else 0),
            nu=INPUTS,
            np=tracking + (4 if track_path else 0),
            derivative=derivative,
            residual=residual if minimise == "residual" else None,
            effort=effort,
            path=path,
            network=self.model.network,
            network_rows=network_rows,
        )
