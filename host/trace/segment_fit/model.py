"""The segment model of a vehicle: one step of the dynamics, with the parameters of every effect as inputs.

Each step is a compiled program over lanes. A lane is one roll-out of one segment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any

import casadi
import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.rotations import euler_to_matrix, mat_t_vec
from trimtab.host.codegen.batch import Batch
from trimtab.host.codegen.compiler import compiled
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.ops import CASADI
from trimtab.host.effects.unknowns import THRUST_CURVE
from trimtab.host.models import dynamics, slots
from trimtab.host.models.airframe import Part, V
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.segment_fit.kernel import SegmentKernel
from trimtab.host.vehicle import Vehicle

Scalar = Any

STATES = 12
NUISANCES = 9
"""Nuisances of one flight, three each, FRD: mounting tilt of the markers (rad); a constant angular
acceleration (rad/s^2) or, if the measured body rate drives the attitude, the gyro bias (rad/s);
accelerometer bias (m/s^2). If two sets of flights are compared, the logarithm of the thrust scale follows."""

CHANNELS = 12
"""Predictions of one step, three each: position (m, NED), attitude as a rotation vector from the measured
attitude (rad, FRD), mean body rate (rad/s, FRD) and mean specific force (m/s^2, FRD)."""

_STEP_INPUTS = {
    "body": STATES, "thrust": 4, "z": 0, "memory": 0, "nuisances": NUISANCES, "w": 6, "command": 4,
    "attitude": 9, "rate": 3, "voltage": 1, "t_s": 1, "shift_s": 1,
}  # fmt: skip

_THRUST_ROUNDS = 2
"""Fixed-point iterations for the thrust along a measured path. The error shrinks in each one to about the
payload's share of the mass."""


class SegmentModel:
    """The model of a vehicle over segments, with all parameters of a parameter space as inputs.

    Parameters
    ----------
    vehicle, space
        Vehicle, and parameters of the effects. Roll-outs take those of `space.rolled`.
    dt_s
        Step of the grid.
    in_newton
        Whether commands are rotor thrusts in N, not motor commands.
    rate_driven
        Whether the measured body rate drives the attitude instead of the commanded torque.
    jobs
        Threads that work on flights.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        space: ParameterSpace,
        *,
        dt_s: float,
        in_newton: bool,
        rate_driven: bool,
        jobs: int = 1,
    ) -> None:
        self.vehicle = vehicle
        self.space = space
        self.dt_s = dt_s
        self.in_newton = in_newton
        self.rate_driven = rate_driven
        self.rolled = space.rolled
        self.nuisances = len(space.nuisance_sigma)
        self.memory = slots.memory_size(self.rolled.effects[name] for name in self.rolled.parts)
        self.jobs = jobs

    @classmethod
    def of(cls, vehicle: Vehicle, space: ParameterSpace, data: Segments, *, jobs: int = 1) -> SegmentModel:
        """Return the model that predicts `data`, with `jobs` threads."""
        return cls(
            vehicle,
            space,
            dt_s=data.dt_s,
            in_newton=data.in_newton,
            rate_driven=data.rate_driven,
            jobs=jobs,
        )

    def bind(self, name: str, lanes: int) -> Batch:
        """Return a program with arrays for `lanes` lanes. name: "step", "rotors" or "memory"."""
        return Batch(self._programs[name], lanes)

    @cached_property
    def kernel(self) -> SegmentKernel | None:
        """The programs in C; None for CasADi's virtual machine, which `bind` runs.

        Raises CodegenError where TRIMTAB_ENGINE requests C and that is not possible.
        """
        return compiled(lambda compiler: SegmentKernel(self._programs, compiler))

    def memory_of(self, owner: str) -> int:
        """Return the number of states that the effect `owner` adds; 0 if the owner is not an effect."""
        return self.rolled.effects[owner].memory if owner in self.rolled.effects else 0

    def delay_s(
        self, theta_scaled: Annotated[np.ndarray, "parameters lanes"]
    ) -> Annotated[np.ndarray, "lanes"]:
        """Return the command delay in s at the scaled parameters of each lane."""
        return np.broadcast_to(
            np.asarray(slots.command_delay_s(CASADI, self._parts(theta_scaled))), theta_scaled.shape[1:]
        )

    def _parts(self, theta_scaled: Any) -> list[Part]:
        """Return every effect with its parameter values; theta_scaled: P rows of an array, or P scalars."""
        theta = self.rolled.by_owner(self._values(theta_scaled))
        return [(self.rolled.effects[name], theta[name]) for name in self.rolled.parts]

    def _values(self, theta_scaled: Any) -> list[Any]:
        """Return the P physical values; theta_scaled: P rows of an array, or P scalars."""
        return [c.neutral + c.scale * theta_scaled[i] for i, c in enumerate(self.rolled.columns)]

    def _commanded(self, theta_scaled: Any, command: list) -> list[Scalar]:
        """Return the four rotor thrusts in N that a command drives the rotors to, before the motor lag."""
        log_gain, linear = self.rolled.by_owner(self._values(theta_scaled)).get(THRUST_CURVE, (0.0, 0.0))
        gain = np.exp(log_gain) if isinstance(log_gain, float) else casadi.exp(log_gain)
        thrust_max_n, c1 = self.vehicle.thrust_max_n, self.vehicle.thrust_curve[0] + linear
        if self.in_newton:
            thrust = [gain * u for u in command]
        else:
            thrust = [thrust_max_n * gain * u * (c1 + (1.0 - c1) * u) for u in command]
        return list(slots.driven_thrusts_n(CASADI, self.vehicle, self._parts(theta_scaled), thrust))

    def _lagged(self, theta_scaled: Any, target: list, thrust: list, after_s: float) -> list[Scalar]:
        """Return the four rotor thrusts in N a time `after_s` later, on their way to `target`."""
        parts = self._parts(theta_scaled)
        lag = slots.motor_lag_s(CASADI, self.vehicle, parts)
        lags = slots.rotor_lags_s(CASADI, parts, lag, target, thrust)
        keep = [casadi.exp(-after_s / lag) for lag in lags]
        return [t + (now - t) * share for t, now, share in zip(target, thrust, keep, strict=True)]

    @cached_property
    @held_interrupts()
    def _programs(self) -> dict[str, casadi.Function]:
        return {"step": self._step(), "rotors": self._rotors(), "memory": self._own_states()}

    def _symbols(self, *names: str) -> tuple[dict[str, casadi.SX], list[list[Scalar]]]:
        sizes = _STEP_INPUTS | {
            "z": len(self.rolled.columns),
            "memory": self.memory,
            "nuisances": self.nuisances,
            "acceleration": 3,
        }
        columns = {name: casadi.SX.sym(name, sizes[name]) for name in names}
        return columns, [[c[i] for i in range(c.shape[0])] for c in columns.values()]

    def _rotors(self) -> casadi.Function:
        """Return the program of the rotors: (thrust, z, command) -> (next, settled).

        next: thrusts one step later. settled: thrusts at which the command would hold them.
        """
        columns, (thrust, theta_scaled, command) = self._symbols("thrust", "z", "command")
        target = self._commanded(theta_scaled, command)
        after = self._lagged(theta_scaled, target, thrust, self.dt_s)
        return _function("rotors", columns, {"next": after, "settled": target})

    def _own_states(self) -> casadi.Function:
        """Return the program of the effects' states: (body, z, memory, acceleration) -> (rates, rest).

        rates: derivatives of the states. rest: their values at rest. Along a measured path the rotor thrusts
        are not known, so they follow from the measured `acceleration` (NED, m/s^2).
        """
        columns, (body, theta_scaled, memory, acceleration) = self._symbols(
            "body", "z", "memory", "acceleration"
        )
        parts, vehicle = self._parts(theta_scaled), self.vehicle
        R = euler_to_matrix(CASADI, body[6:9])
        rotor: Scalar = vehicle.mass_kg * GRAVITY / 4.0
        none = (0.0, 0.0, 0.0)
        for _ in range(_THRUST_ROUNDS):
            x = [*body, *(rotor,) * 4]
            out = dynamics.rigid_body(CASADI, vehicle, parts, x, 1.0, 0.0, none, none, memory)
            error = sum(R[3 * i + 2] * (out[3 + i] - acceleration[i]) for i in range(3))
            rotor = rotor + 0.25 * vehicle.mass_kg * error
        x = [*body, *(rotor,) * 4]
        rates = slots.memory_rates(CASADI, vehicle, parts, x, memory, acceleration)
        rest = slots.memory_at_rest(CASADI, vehicle, parts, x)
        return _function("memory", columns, {"rates": rates, "rest": rest})

    def _step(self) -> casadi.Function:
        """Return the program of one step: the state after it, and the predicted measurements.

        The body and the effects' states use the midpoint rule; the rotors are integrated exactly.
        """
        columns, scalars = self._symbols(*_STEP_INPUTS)
        body, thrust, theta_scaled, memory, nuisances, w, command, measured, rate = scalars[:9]
        (voltage,), (t_s,), (shift,) = scalars[9:]
        dt, vehicle, parts = self.dt_s, self.vehicle, self._parts(theta_scaled)
        target = self._commanded(theta_scaled, command)
        middle = self._lagged(theta_scaled, target, thrust, 0.5 * dt)
        after = self._lagged(theta_scaled, target, thrust, dt)
        spinning_up = [(end - start) / dt for end, start in zip(after, thrust, strict=True)]
        force_ned = [
            measured[3 * i] * w[0] + measured[3 * i + 1] * w[1] + measured[3 * i + 2] * w[2] for i in range(3)
        ]
        torque_frd = [nuisances[3 + i] + w[3 + i] for i in range(3)]
        scaled = self.nuisances > NUISANCES
        if self.rate_driven:
            body = [*body[:9], *(rate[i] + torque_frd[i] for i in range(3))]

        def slopes(x: list, rotor: list, states: list) -> tuple[list[Scalar], list[Scalar]]:
            full = [*x, *(casadi.exp(nuisances[NUISANCES]) * t if scaled else t for t in rotor)]
            out = dynamics.rigid_body(
                CASADI, vehicle, parts, full, voltage, t_s, force_ned, torque_frd, states
            )
            out = dynamics.with_thrust_rates(CASADI, vehicle, parts, full, out, spinning_up)
            rates = slots.memory_rates(CASADI, vehicle, parts, full, states, out[V], voltage, t_s)
            return ([*out[:9], 0.0, 0.0, 0.0] if self.rate_driven else out), rates

        k1, m1 = slopes(body, thrust, memory)
        half = [a + 0.5 * dt * b for a, b in zip(body, k1, strict=True)]
        half_memory = [a + 0.5 * dt * b for a, b in zip(memory, m1, strict=True)]
        k2, m2 = slopes(half, middle, half_memory)

        late = shift - slots.mocap_latency_s(CASADI, parts)
        position = [body[i] + late * (body[3 + i] + 0.5 * late * k1[3 + i]) for i in range(3)]
        R = _turned(euler_to_matrix(CASADI, body[6:9]), [nuisances[i] + late * body[9 + i] for i in range(3)])
        predicted = [
            *position,
            *_apart(measured, R),
            *(body[9 + i] + 0.5 * dt * k2[9 + i] for i in range(3)),
            *(f + b for f, b in zip(_specific_force(parts, half, k2), nuisances[6:9], strict=True)),
        ]
        outputs = {
            "body_out": [a + dt * b for a, b in zip(body, k2, strict=True)],
            "thrust_out": after,
            "memory_out": [a + dt * b for a, b in zip(memory, m2, strict=True)],
            "predicted_out": predicted,
        }
        return _function("step", columns, outputs)


def _function(
    name: str, columns: Mapping[str, casadi.SX], outputs: Mapping[str, Sequence[Scalar]]
) -> casadi.Function:
    """Return the function of these symbols to dense columns."""
    results = [
        casadi.densify(casadi.vertcat(*map(casadi.SX, column))) if column else casadi.SX(0, 1)
        for column in outputs.values()
    ]
    return casadi.Function(name, list(columns.values()), results, list(columns), list(outputs), {"cse": True})


def _specific_force(parts: list[Part], body: list, slope: list) -> Sequence[Scalar]:
    """Return the specific force in FRD, m/s^2, of a state and its derivative."""
    tilted_ned = slots.gravity_ned(CASADI, parts) or (0.0, 0.0, 0.0)
    force_ned = [slope[3 + i] - tilted_ned[i] - (GRAVITY if i == 2 else 0.0) for i in range(3)]
    return mat_t_vec(euler_to_matrix(CASADI, body[6:9]), force_ned)


def _turned(R: Any, phi: list) -> list:
    """Return R exp(phi), nine entries, to second order in the small rotation vector phi (rad)."""
    a, b, c = phi
    aa, bb, cc = a * a, b * b, c * c
    E = (
        1 - 0.5 * (bb + cc), 0.5 * a * b - c, 0.5 * a * c + b,
        0.5 * a * b + c, 1 - 0.5 * (aa + cc), 0.5 * b * c - a,
        0.5 * a * c - b, 0.5 * b * c + a, 1 - 0.5 * (aa + bb),
    )  # fmt: skip
    return [
        R[3 * i] * E[j] + R[3 * i + 1] * E[3 + j] + R[3 * i + 2] * E[6 + j]
        for i in range(3)
        for j in range(3)
    ]


def _apart(measured: list, R: list) -> list:
    """Return the rotation vector (rad, FRD) from `measured` to R, row-major attitudes, to first order."""
    error = [[sum(measured[3 * k + i] * R[3 * k + j] for k in range(3)) for j in range(3)] for i in range(3)]
    return [0.5 * (error[i][j] - error[j][i]) for i, j in ((2, 1), (0, 2), (1, 0))]
