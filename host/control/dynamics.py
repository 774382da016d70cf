"""The prediction model of the host-side controllers: the rigid body behind its rate loop and its motors.

    p' = v,   v' = g e3 - R e3 T/m + d(x) + w,   Theta' = W(Theta) omega     (paper eqs. 1-2)
    omega' = (omega_cmd - omega) / lag,   T' = (T_cmd - T) / motor lag

The state has 13 scalars: p_ned 3, v_ned 3, Theta 3, rate_frd 3 and collective thrust T in N. The inputs are
the command that is streamed: omega_cmd 3 and T_cmd. d is the residual acceleration of a model, w a constant
disturbance. Attitude is in Euler angles, as in `trimtab.host.models`: the networks and effects take them, and
every vehicle file keeps the tilt far from the singularity at a pitch of 90 degrees.

The rate loop of the vehicle answers a command with the torque J (K_p (omega_cmd - omega) - K_d omega'). Its
lag is therefore (1 + K_d) / K_p. The motors' lag does not change the mean delay of its step response.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.base.errors import UsageError
from trimtab.host.codegen import CASADI
from trimtab.host.effects import Effect
from trimtab.host.models.airframe import RATE, THETA, Part, V
from trimtab.host.models.dynamics import rigid_body
from trimtab.host.models.model import Model
from trimtab.host.models.network import Network
from trimtab.host.models.slots import driven_thrusts_n, motor_lag_s, rotor_lags_s
from trimtab.host.vehicle import Vehicle, to_parameters

STATES, INPUTS = 13, 4
COLLECTIVE = STATES - 1
"""Index of the collective thrust in the state."""
NETWORK_STATE = slice(V.start, THETA.stop)
"""v_ned and Theta in the state."""
DISTURBANCE = slice(0, 3)
"""Parameters of the model: the constant disturbance w (m/s^2, NED), then the values of the effects."""


def rate_lag_s(vehicle: Vehicle) -> tuple[float, float, float]:
    """Return the lag of the vehicle's rate loop about each body axis, (1 + K_d) / K_p.

    Raises UsageError for a vehicle whose rate loop has no proportional gain.
    """
    gains = vehicle.gains
    if not min(gains.rate_p) > 0.0:
        raise UsageError(
            f"{vehicle.name}: gains.rate_p is {list(gains.rate_p)}; state rate_lag_s in the controller file"
        )
    x, y, z = ((1.0 + d) / p for p, d in zip(gains.rate_p, gains.rate_d, strict=True))
    return x, y, z


@dataclass(frozen=True, kw_only=True)
class ControlModel:
    """A vehicle, what a model adds to its acceleration, and the lag (s) of its rate loop by body axis."""

    vehicle: Vehicle
    rate_lag_s: tuple[float, float, float]
    parts: tuple[Part, ...] = ()
    network: Network | None = None

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        lag_s: tuple[float, float, float] | None = None,
        model: Model | None = None,
        effects: Mapping[str, Effect] | None = None,
    ) -> ControlModel:
        """Return the nominal vehicle with what `model` adds; `effects` is the library that it names.

        lag_s: of the rate loop; None for that of the vehicle's gains. Raises ValueError for unknown effects,
        and UsageError as `rate_lag_s` does.
        """
        return cls(
            vehicle=vehicle,
            rate_lag_s=rate_lag_s(vehicle) if lag_s is None else lag_s,
            parts=() if model is None else tuple(model.parts(effects or {})),
            network=None if model is None else model.network,
        )

    @property
    def parameters(self) -> Annotated[np.ndarray, "parameters"]:
        """Parameters without disturbance."""
        return np.array([0.0, 0.0, 0.0, *(value for _, values in self.parts for value in values)])

    @property
    def weights(self) -> Annotated[np.ndarray, "weights"]:
        """Weights of the network; empty without one."""
        return np.zeros(0) if self.network is None else np.array(self.network.xi)

    @property
    def weight_n(self) -> float:
        """Weight of the nominal vehicle, N."""
        return self.vehicle.mass_kg * GRAVITY

    def input_bounds(self) -> tuple[Annotated[np.ndarray, "4"], Annotated[np.ndarray, "4"]]:
        """Return the least and the greatest command that the vehicle executes: body rates and thrust."""
        vehicle = self.vehicle
        rate = np.array(vehicle.limits.body_rate_max_rad_s)
        low = to_parameters(vehicle)["THRUST_FLOOR"] * self.weight_n
        return np.append(-rate, low), np.append(rate, 4.0 * vehicle.thrust_max_n)

    def derivative(self, x: ca.SX, u: ca.SX, p: ca.SX, d_ned: ca.SX) -> ca.SX:
        """Return xdot (13,). d_ned: acceleration (3,) of the network; p: parameters."""
        parts = self._parts(p)
        (driven,) = driven_thrusts_n(CASADI, self.vehicle, parts, [0.25 * u[3]])  # each rotor has a quarter
        lag_s = motor_lag_s(CASADI, self.vehicle, parts)
        (lag_s,) = rotor_lags_s(CASADI, parts, lag_s, [driven], [0.25 * x[COLLECTIVE]])
        scalars = ca.vertsplit(x)
        acceleration = ca.vertsplit(d_ned + p[DISTURBANCE])
        body = rigid_body(CASADI, self.vehicle, parts, rigid(scalars), acceleration_ned=acceleration)
        rates = [(u[i] - x[RATE][i]) / self.rate_lag_s[i] for i in range(3)]
        return ca.vertcat(*body[: RATE.start], *rates, (4.0 * driven - x[COLLECTIVE]) / lag_s)

    def residual(self, x: ca.SX, p: ca.SX) -> ca.SX:
        """Return the acceleration (3,), m/s^2 NED, that disturbance and effects add to the vehicle."""
        scalars = rigid(ca.vertsplit(x))
        with_parts = rigid_body(CASADI, self.vehicle, self._parts(p), scalars)[V]
        nominal = rigid_body(CASADI, self.vehicle, (), scalars)[V]
        change = [a - b for a, b in zip(with_parts, nominal, strict=True)]
        return p[DISTURBANCE] + ca.vertcat(*change)

    def _parts(self, p: ca.SX) -> list[Part]:
        """Return the effects with their values from the parameters."""
        parts, start = [], DISTURBANCE.stop
        for effect, values in self.parts:
            parts.append((effect, [p[start + i] for i in range(len(values))]))
            start += len(values)
        return parts


def rigid(x: Sequence[Any]) -> list[Any]:
    """Return the state of `trimtab.host.models` (16) with the collective thrust shared by the rotors."""
    return [*x[: RATE.stop], *[0.25 * x[COLLECTIVE]] * 4]


def network_acceleration(model: ControlModel, xi: ca.MX, x: ca.MX) -> ca.MX:
    """Return the acceleration (3, n), m/s^2 NED, of the network with weights `xi` at states (13, n)."""
    if model.network is None:
        return ca.MX(ca.DM.zeros(3, x.shape[1]))
    return model.network.layout.matrices(xi, x[NETWORK_STATE, :])
