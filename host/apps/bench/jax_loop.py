"""The closed-loop model phi with a network in the world frame, vectorised for JAX: the peers integrate it.

The control law's source is scalar. XLA takes a minute to compile its trace, and the result is sixty times
slower than this module. Only constants are read from phi; users of this module compare the results. Importing
it sets JAX to double precision.
"""

# pyright: reportMissingImports=false
# JAX is of the extra `bench`.

from __future__ import annotations

import math
from itertools import combinations, pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.firmware_model.law import step as law_step
from trimtab.firmware_model.law.allocation import TABLE_SIZE
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.dfbc import FEEDBACK_MAX
from trimtab.host.models.bias import standing_errors
from trimtab.host.models.continuous_law import LIMIT_DECAY
from trimtab.host.models.drive import FF_ACCEL, FF_GAIN, FF_JERK, FlightConstants
from trimtab.host.models.dynamics import rotor_torque
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi

jax.config.update("jax_enable_x64", True)

Weights = list[tuple[Any, Any]]
"""Layer by layer: weights (outputs, inputs) and biases (outputs,)."""

_DOWN = np.array([0.0, 0.0, 1.0])
_TINY = 1e-9


class JaxLoop:
    """Derivative of the state of one segment; use `jax.vmap` for many segments.

    Raises ValueError for a phi or a layout with parts that this module does not implement.
    """

    def __init__(self, phi: Phi, layout: Layout) -> None:
        plain = phi.drive == "reference" and not (phi.estimator or phi.observes)
        if not plain or phi.effects or layout.frame != "world":
            raise ValueError(
                "JAX has the drive `reference` without estimator, rate filter, observer and effects, "
                "and a network in the world's frame"
            )
        vehicle, firmware = phi.vehicle, phi.firmware
        self._layout = layout
        self._mass, self._inertia = vehicle.mass_kg, np.array(vehicle.inertia_kg_m2)
        self._lag = vehicle.motor_lag_s + phi.hold_s
        self._torque = np.array([rotor_torque(vehicle, list(unit)) for unit in np.eye(4)]).T

        body, gains = law_step.body(firmware), law_step.gains(firmware)
        self._model_mass, self._model_inertia = body.mass_kg, np.array(body.inertia)
        self._k_p, self._k_v, self._k_att, self._k_rate, self._k_i, self._k_d = map(np.array, gains[:6])
        self._least = gains.thrust_floor * GRAVITY
        self._limit = np.array(law_step.integral_limit(firmware))
        self._estimator = law_step.estimator_gains(firmware)
        # The sampled filter: its slope is too large by half a tick, and late by its time constant.
        half_tick = 0.5 * law_step.TICK_S * gains.filter_rate
        self._slope = 1.0 + half_tick
        corner = -math.log1p(-2.0 * half_tick / (1.0 + half_tick)) / law_step.TICK_S
        self._late = self._k_d * self._slope / (corner * self._lag)

        named = dict(zip(law_step.PARAMETERS, firmware, strict=True))
        self._t_min, self._t_max = named["THRUST_MIN"], named["THRUST_MAX"]
        table = np.array(firmware[-TABLE_SIZE:])
        self._share, per, self._roll, self._pitch, self._yaw = table[:20].reshape(5, 4)
        self._low, self._high = self._t_min * per, self._t_max * per
        self._pairs = np.zeros((4, 6))
        for k, pair in enumerate(combinations(range(4), 2)):
            self._pairs[list(pair), k] = table[20 + 2 * k : 22 + 2 * k]

    def weights(self, xi: Any) -> Weights:
        """Return the layers of a flat xi (m,)."""
        layers, start = [], 0
        for inputs, outputs in pairwise(self._layout.sizes):
            rows = xi[start : start + outputs * (inputs + 1)].reshape(outputs, inputs + 1)
            layers.append((rows[:, :-1], rows[:, -1]))
            start += rows.size
        return layers

    def derivative(self, x: Any, drive: Any, flight: Any, weights: Weights) -> Any:
        """Return xdot (19,) at x (19,), drive (23,) and constants (15,) of a flight, as `Phi.derivative`."""
        p, v, angles, rate, thrust, stored = jnp.split(x, (3, 6, 9, 12, 16))
        (sr, sp, sy), (cr, cp, cy) = jnp.sin(angles), jnp.cos(angles)
        R = _matrix(
            (cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
            (cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
            (-sp, sr * cp, cr * cp),
        )
        turn = (sr * rate[1] + cr * rate[2]) / cp
        angles_dot = jnp.stack((rate[0] + sp * turn, cr * rate[1] - sr * rate[2], turn))
        residual = _network(weights, jnp.concatenate((v, angles[:2], jnp.arctan2(sy, cy)[None])))
        a = GRAVITY * _DOWN - R[:, 2] * (jnp.sum(thrust) / self._mass) + residual
        torque = self._torque @ thrust
        rate_dot = (torque - jnp.cross(rate, self._inertia * rate)) / self._inertia

        p_seen, v_seen = self._seen(p, v, a, R, flight)
        integral = jnp.clip(stored, -self._limit, self._limit)
        collective, ahead, error = self._lead(p_seen, v_seen, R, drive, flight)
        rate_error = ahead - self._k_att * error - rate
        wanted = self._k_rate * rate_error + integral - self._k_d * self._slope * rate_dot
        wanted = self._model_inertia * wanted + jnp.cross(rate, self._model_inertia * rate)
        wanted = (wanted - self._late * torque) / (1.0 - self._late)
        command = self._allocate(collective / drive[FF_GAIN], wanted / drive[FF_GAIN])

        more = self._k_i * rate_error
        integral_dot = more - LIMIT_DECAY * (stored - integral)
        thrust_dot = (command - thrust) / self._lag
        return jnp.concatenate((v, a, angles_dot, rate_dot, thrust_dot, integral_dot))

    def _seen(self, p: Any, v: Any, a: Any, R: Any, flight: Any) -> tuple[Any, Any]:
        """Return position and velocity as fed back: with the accelerometer's bias, and delayed."""
        constants = FlightConstants(*flight)
        off_p, off_v = standing_errors(self._estimator, constants.mocap_age_s, constants.mocap_interval_s)
        excess, delay = R @ flight[6:9], constants.feedback_delay_s
        v = v + off_v * excess
        return p + off_p * excess - delay * (v - 0.5 * delay * a), v - delay * a

    def _lead(self, p: Any, v: Any, R: Any, drive: Any, flight: Any) -> tuple[Any, Any, Any]:
        """Return collective thrust (N), body rate fed forward (rad/s) and attitude error (3,) of the law."""
        p_r, v_r, a_r, j_r = drive[:12].reshape(4, 3)
        yaw, yaw_rate, ff_accel, ff_jerk = drive[12], drive[13], drive[FF_ACCEL], drive[FF_JERK]
        feedback = self._k_p * (p_r - p) + self._k_v * (v_r - v)
        most = FEEDBACK_MAX**2
        feedback = feedback * jnp.sqrt(most / jnp.maximum(jnp.sum(feedback * feedback), most))
        f = GRAVITY * _DOWN + ff_accel - a_r - feedback
        collective = self._model_mass * jnp.maximum(f @ R[:, 2], self._least)

        c, s = jnp.cos(yaw), jnp.sin(yaw)
        zero = jnp.zeros_like(c)
        to_heading = _matrix((c, s, zero), (-s, c, zero), (zero, zero, zero + 1.0))
        fx, fy, fz = to_heading @ f
        across = fx * fx + fz * fz
        force = jnp.sqrt(jnp.maximum(across + fy * fy, _TINY))
        n = jnp.sqrt(jnp.maximum(across, _TINY)) / force
        zx, zy, zz = fx / force, fy / force, fz / force
        xx, xz = zz / n, -zx / n
        wanted = _matrix((xx, zy * xz, zx), (zero, n, zy), (xz, -zy * xx, zz))
        E = wanted.T @ to_heading @ R
        error = 0.5 * jnp.stack((E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]))
        error = error - jnp.stack((flight[0], flight[1], zero))

        gx, gy, gz = to_heading @ (ff_jerk - j_r)
        rate_y = (gx * zz - gz * zx) / (n * force)
        rate_x = (zy * (gx * zx + gz * zz) / n - n * gy) / force
        rate_z = (yaw_rate * zz / n + rate_y * zy) / n
        return collective, jnp.stack((rate_x, rate_y, rate_z)), error

    def _allocate(self, collective: Any, torque: Any) -> Any:
        """Return rotor thrusts (4,), N, as `trimtab.firmware_model.law.allocation.allocate` does."""
        tilt, turn = self._roll * torque[0] + self._pitch * torque[1], self._yaw * torque[2]
        room = self._high.min() - self._low.max()
        tilt = tilt * jnp.minimum(room / jnp.maximum(jnp.max(tilt) - jnp.min(tilt), _TINY), 1.0)
        # Lowest collective thrust that leaves room below, and above: from the top downwards.
        top = 4.0 * self._t_max
        lines, fall = jnp.stack((self._low - tilt, top - self._high + tilt)), jnp.stack((turn, -turn))
        ends, crossings = jnp.minimum(lines, lines - fall), lines @ self._pairs
        below, above = jnp.maximum(jnp.max(ends, axis=1), jnp.max(crossings, axis=1))
        level = jnp.clip(collective, below, top - above) + tilt
        way = jnp.where(turn > 0.0, self._high - level, level - self._low)
        part = jnp.clip(jnp.min(way / jnp.maximum(jnp.abs(turn), _TINY)), 0.0, 1.0)
        return jnp.clip(self._share * (level + part * turn), self._t_min, self._t_max)


def _network(weights: Weights, values: Any) -> Any:
    for k, (matrix, bias) in enumerate(weights):
        values = matrix @ (jnp.tanh(values) if k else values) + bias
    return values


def _matrix(*rows: tuple[Any, Any, Any]) -> Any:
    return jnp.stack([jnp.stack(row) for row in rows])
