"""The closed-loop model phi: rigid body, rotor lag and effects under the on-board law (paper IV-A).

xdot = f(x, pi(z, x, x_bar)) + d, with the law and its memory z in continuous time. The rate integral is a
state (paper, remark on embedded integration). So are the estimator's errors where they are asked for, and
the disturbance observer where it is on. Three drives:

    reference  the law sees the model's state; the whole flight follows from the reference
    estimate   the law is fed the logged on-board estimate
    inputs     the recorded rotor thrusts drive the body, without a law

The model includes two small effects of the 1 kHz tick. A command that is held for a tick arrives half a tick
late (`hold_s`): this adds to the delay of commands where an effect has one, and to the rotor lag elsewhere.
The slope of the sampled rate filter is larger by half a tick times its corner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import casadi
import numpy as np

from trimtab.firmware_model.law import step as law_step
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.dfbc import control
from trimtab.firmware_model.law.observer import bounded, measured_disturbance
from trimtab.firmware_model.law.ops import Ops
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.ops import CASADI, NUMPY
from trimtab.host.effects import Effect
from trimtab.host.models import continuous_law, estimator
from trimtab.host.models.airframe import RATE, STATE_SIZE, THRUST, Part, V
from trimtab.host.models.drive import (
    COMMANDED_THRUST,
    DRIVE_ROWS,
    FF_ACCEL,
    FF_GAIN,
    FF_JERK,
    FLIGHT,
    INPUTS_VOLTAGE_AND_TIME,
    VOLTAGE_AND_TIME,
    Drive,
    FlightConstants,
    flat_reference,
    flight_constants,
)
from trimtab.host.models.dynamics import rigid_body, rotor_torque, thrust_rates, with_thrust_rates
from trimtab.host.models.feedback import (
    Feedback,
    estimate_with_error_states,
    estimate_with_standing_errors,
    logged_estimate,
)
from trimtab.host.models.slots import command_delay_s, memory_at_rest, memory_rates, memory_size, motor_lag_s
from trimtab.host.vehicle import Vehicle, to_parameters
from trimtab.protocol.parameters import DEFAULTS

Scalar = Any

INTEGRAL = slice(16, 19)
"""The rate integral in the state.

States that are optional follow it, in this order: the estimator's errors 12; the observer's estimate 3
(m/s^2, NED) and its collective thrust (N); delayed rotor commands 4 (N), where an effect delays them; the
effects' memory.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Phi:
    """The closed loop of a vehicle with these effects, whose values are inputs (`theta`).

    `parameters` are the firmware's, by name (default: the vehicle file's). `estimator` adds 12 error states
    of the estimator to the drive `reference`. They matter with a mocap latency, with a prediction time, and
    with poses so late that predicting them forward makes a difference. Without them, the model has the
    constant errors that the accelerometer's bias causes. The rate filter adds no states: its lag is modelled
    to first order.
    """

    vehicle: Vehicle
    effects: tuple[Effect, ...] = ()
    drive: Drive = "reference"
    estimator: bool = True
    parameters: Mapping[str, float] | None = None
    hold_s: float = 0.5 * law_step.TICK_S

    def __post_init__(self) -> None:
        if self.drive not in DRIVE_ROWS:
            raise ValueError(f"drive must be one of {', '.join(DRIVE_ROWS)}, not {self.drive!r}")
        if not 0.0 <= self.hold_s < 0.1:
            raise ValueError(f"hold_s must be within 0..0.1 s, got {self.hold_s}")

    @property
    def size(self) -> int:
        """Number of states."""
        return self.memory.stop

    @property
    def errors(self) -> slice:
        """Place of the estimator's errors in the state; beyond its end without them."""
        return slice(INTEGRAL.stop, INTEGRAL.stop + estimator.SIZE)

    @property
    def observer(self) -> slice:
        """Place of the observer's four states; beyond the state's end without them."""
        start = self.errors.stop if self._has_estimator else self.errors.start
        return slice(start, start + 4)

    @cached_property
    def observes(self) -> bool:
        """Whether the law's disturbance observer is on, and its states are part of x."""
        return self.drive != "inputs" and law_step.observer(self.firmware)[0] > 0.0

    @property
    def commands(self) -> slice:
        """Place of the four delayed rotor commands; empty where no effect delays them."""
        start = self.observer.start + (4 if self.observes else 0)
        late = any(effect.command_delay_s is not None for effect in self.effects)
        return slice(start, start + (4 if late and self.drive != "inputs" else 0))

    @property
    def memory(self) -> slice:
        """Place of the effects' memory."""
        start = STATE_SIZE if self.drive == "inputs" else self.commands.stop
        return slice(start, start + memory_size(self.effects))

    @property
    def vectors(self) -> tuple[int, ...]:
        """Index at which each NED vector starts in the state."""
        errors = (self.errors.start, self.errors.start + 3) if self._has_estimator else ()
        return (0, 3, *errors, *((self.observer.start,) if self.observes else ()))

    @property
    def _has_estimator(self) -> bool:
        return self.estimator and self.drive == "reference"

    @property
    def theta_names(self) -> tuple[str, ...]:
        """Name every entry of theta as "effect.key"."""
        return tuple(f"{effect.name}.{key}" for effect in self.effects for key in effect.keys)

    @property
    def theta_neutral(self) -> Annotated[np.ndarray, "parameters"]:
        """The theta of the nominal vehicle."""
        return np.array([value for effect in self.effects for value in effect.neutral], dtype=float)

    @property
    def learnable(self) -> tuple[int, ...]:
        """Indices of theta without those of the forms of effects (`Parameter.form`)."""
        parameters = (parameter for effect in self.effects for parameter in effect.parameters)
        return tuple(i for i, parameter in enumerate(parameters) if not parameter.form)

    def theta(self, parts: Sequence[Part]) -> Annotated[np.ndarray, "parameters"]:
        """Return theta for these values, neutral elsewhere. Raises ValueError for a missing effect."""
        values = {effect.name: effect.neutral for effect in self.effects}
        for effect, numbers in parts:
            if effect.name not in values:
                names = ", ".join(values) or "no effects"
                raise ValueError(f"this model has no {effect.name}; it has {names}")
            values[effect.name] = tuple(float(number) for number in numbers)
        return np.array([value for effect in self.effects for value in values[effect.name]], dtype=float)

    def parts(self, theta: Any) -> list[Part]:
        """Return every effect with its entries of theta."""
        parts, start = [], 0
        for effect in self.effects:
            stop = start + len(effect.parameters)
            parts.append((effect, [theta[i] for i in range(start, stop)]))
            start = stop
        return parts

    def derivative(
        self,
        ops: Ops,
        x: Sequence[Scalar],
        drive: Sequence[Scalar],
        flight: Sequence[Scalar],
        theta: Sequence[Scalar],
        acceleration_ned: Sequence[Scalar] | None = None,
    ) -> list[Scalar]:
        """Return xdot, `size` scalars; `acceleration_ned` is the residual d of paper equation 2."""
        parts = self.parts(theta)
        voltage_ratio, t_s = drive[INPUTS_VOLTAGE_AND_TIME if self.drive == "inputs" else VOLTAGE_AND_TIME]
        memory = x[self.memory]
        body = rigid_body(ops, self.vehicle, parts, x, voltage_ratio, t_s, acceleration_ned, memory=memory)
        effect_rates = memory_rates(ops, self.vehicle, parts, x, memory, body[V], voltage_ratio, t_s)
        lag_s = motor_lag_s(ops, self.vehicle, parts) + self.hold_s
        if self.drive == "inputs":
            rates = thrust_rates(ops, self.vehicle, parts, x[THRUST], drive[COMMANDED_THRUST], lag_s)
        else:
            rates = self._loop_rates(ops, parts, x, drive, FlightConstants(*flight), body, lag_s)
        body = with_thrust_rates(ops, self.vehicle, parts, x, body, rates[:4])
        return [*body, *rates, *effect_rates]

    def _loop_rates(
        self,
        ops: Ops,
        parts: Sequence[Part],
        x: Sequence[Scalar],
        drive: Sequence[Scalar],
        constants: FlightConstants,
        body: Sequence[Scalar],
        lag_s: Scalar,
    ) -> list[Scalar]:
        """Return the derivatives of all states between the rigid body's and the effects' memory.

        The law does not feel the torque of changes of the thrusts (`with_thrust_rates`) before it turns the
        vehicle: they follow from its commands.
        """
        feedback = self._feedback(ops, parts, x, drive, constants, body)
        command, integral_rates = self._law(ops, x, drive, constants, feedback, body[RATE], lag_s)
        arriving, delay_rates, observer = command, [], []
        if self.observes:
            thrust = drive[FF_GAIN] * (command[0] + command[1] + command[2] + command[3])
            v_dot, R = feedback.v_dot_ned, feedback.R
            offset = (constants.attitude_offset_roll, constants.attitude_offset_pitch)
            mass_kg = law_step.body(self.firmware).mass_kg
            measured = measured_disturbance(v_dot, R, x[self.observer][3], mass_kg, drive[FF_ACCEL], offset)
            observer = continuous_law.observer_rates(
                ops, self.firmware, x[self.observer], measured, thrust, self.hold_s
            )
        if self.commands.stop > self.commands.start:
            delay_s = command_delay_s(ops, parts) + self.hold_s
            lag_s = lag_s - self.hold_s  # here the hold is part of the delay, not of the lag
            arriving, delay_rates = continuous_law.delayed_command(ops, command, x[self.commands], delay_s)
        thrusts = thrust_rates(ops, self.vehicle, parts, x[THRUST], arriving, lag_s)
        return [*thrusts, *integral_rates, *feedback.error_rates, *observer, *delay_rates]

    def _feedback(
        self,
        ops: Ops,
        parts: Sequence[Part],
        x: Sequence[Scalar],
        drive: Sequence[Scalar],
        constants: FlightConstants,
        body: Sequence[Scalar],
    ) -> Feedback:
        """Return what the law is fed. body: derivative of the rigid body's states."""
        a = body[V]
        if self.drive == "estimate":
            return logged_estimate(ops, drive, a)
        gains = law_step.estimator_gains(self.firmware)
        if self._has_estimator:
            feedback = estimate_with_error_states(
                ops, gains, constants, parts, x, x[self.errors], a, body[RATE]
            )
        else:
            feedback = estimate_with_standing_errors(ops, gains, constants, x, a)
        return feedback.delayed(constants.feedback_delay_s, a)

    def _law(
        self,
        ops: Ops,
        x: Sequence[Scalar],
        drive: Sequence[Scalar],
        constants: FlightConstants,
        feedback: Feedback,
        rate_dot: Sequence[Scalar],
        lag_s: Scalar,
    ) -> tuple[Sequence[Scalar], list[Scalar]]:
        """Return the rotor thrusts (N) that the law commands, and the derivative of its rate integral."""
        gains = law_step.gains(self.firmware)
        corner, slope_factor = continuous_law.sampled_filter(gains.filter_rate)
        rate = feedback.rate_frd
        filter_lag = [alpha / corner for alpha in rate_dot]  # behind a ramp
        limit = law_step.integral_limit(self.firmware)
        integral = [ops.clip(x[INTEGRAL.start + i], -limit[i], limit[i]) for i in range(3)]
        ff_accel = drive[FF_ACCEL]
        if self.observes:
            d_hat = bounded(ops, x[self.observer][:3])
            ff_accel = [ff_accel[i] + d_hat[i] for i in range(3)]
        collective, torque, _, integral_dot = control(
            ops, gains, law_step.body(self.firmware), feedback.p_ned, feedback.v_ned, feedback.R, rate,
            [rate[i] - slope_factor * filter_lag[i] for i in range(3)], integral, flat_reference(drive),
            ff_accel, ff_jerk=drive[FF_JERK],
            attitude_offset=(constants.attitude_offset_roll, constants.attitude_offset_pitch),
        )  # fmt: skip
        share = slope_factor * gains.filter_rate / (corner * corner)
        present = rotor_torque(self.vehicle, x[THRUST])
        torque = continuous_law.torque_with_filter_lag(torque, present, gains.rate_derivative, share, lag_s)
        _, command, _ = law_step.motors(ops, self.firmware, collective, torque, drive[FF_GAIN])
        return command, [
            continuous_law.limited_integral_rate(ops, x[INTEGRAL.start + i], integral_dot[i], limit[i])
            for i in range(3)
        ]

    @cached_property
    def firmware(self) -> tuple[float, ...]:
        """The law's block `parameters`; parameters that an old log lacks have their defaults."""
        table = to_parameters(self.vehicle) if self.parameters is None else self.parameters
        return law_step.parameter_vector({**DEFAULTS, **table})

    @cached_property
    @held_interrupts()
    def function(self) -> casadi.Function:
        """The derivative as an SX function: (x, drive, flight, theta, acceleration) -> xdot."""
        sizes = (self.size, DRIVE_ROWS[self.drive], len(FLIGHT), len(self.theta_names), 3)
        names = ["x", "drive", "flight", "theta", "acceleration"]
        inputs = [casadi.SX.sym(name, size) for name, size in zip(names, sizes, strict=True)]
        scalars = [[column[i] for i in range(column.shape[0])] for column in inputs]
        xdot = self.derivative(CASADI, *scalars)
        (xdot,) = casadi.cse([casadi.densify(casadi.vertcat(*xdot))])
        return casadi.Function("phi", inputs, [xdot], names, ["xdot"])

    @cached_property
    def stiffness(self) -> float:
        """Largest eigenvalue of the linearised model, 1/s, which limits the step size.

        It is that at hover, or that of an integral at its limit.
        """
        x, drive = casadi.SX.sym("x", self.size), casadi.SX.sym("drive", DRIVE_ROWS[self.drive])
        flight, theta = flight_constants(), self.theta_neutral
        xdot = self.function(x, drive, flight, theta, np.zeros(3))
        jacobian = casadi.Function("jacobian", [x, drive], [casadi.jacobian(xdot, x)])
        hover = self.hover((0.0, 0.0, -1.0), 0.0)
        still = np.zeros(DRIVE_ROWS[self.drive])
        if self.drive == "inputs":
            still[INPUTS_VOLTAGE_AND_TIME] = 1.0, 0.0
        else:
            still[2], still[FF_GAIN], still[VOLTAGE_AND_TIME.start] = -1.0, 1.0, 1.0
        matrix = np.array(jacobian(hover, still), dtype=float)
        return max(float(np.abs(np.linalg.eigvals(matrix)).max()), continuous_law.LIMIT_DECAY)

    def substeps(self, step_s: float) -> int:
        """Return how many RK4 steps to split `step_s` into: |eigenvalue| times step is at most 1.5."""
        return max(1, math.ceil(self.stiffness * step_s / 1.5))

    def at_rest(self, x: Annotated[np.ndarray, "size"]) -> Annotated[np.ndarray, "memory"]:
        """Return the effects' memory after a long rest in state x, at neutral values."""
        parts = self.parts(self.theta_neutral)
        return np.array(memory_at_rest(NUMPY, self.vehicle, parts, list(x[:STATE_SIZE])), dtype=float)

    def hover(self, p_ned: Sequence[float], yaw: float) -> Annotated[np.ndarray, "size"]:
        """Return the state of the nominal vehicle hovering at p_ned."""
        x = np.zeros(self.size)
        x[0:3], x[8] = p_ned, yaw
        x[THRUST] = x[self.commands] = self.vehicle.mass_kg * GRAVITY / 4.0
        x[self.memory] = self.at_rest(x)
        if self.observes:
            x[self.observer.stop - 1] = self.vehicle.mass_kg * GRAVITY
        return x
