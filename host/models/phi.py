"""phi, the closed loop as a model: rigid body, rotor lag and effects under the on-board law (paper IV-A).

xdot = f(x, pi(z, x, x_bar)) + d, with the law and its memory z in continuous form: body-rate integral and
rate filter are states (paper, remark on embedded integration), the estimator's errors too where asked for,
the disturbance observer where it is on.
Drives:

    reference  pi sees the model's own state; the whole flight follows from the reference
    estimate   pi is fed the logged on-board estimate
    inputs     the recorded rotor thrusts drive the body; no law

What the 1 kHz tick adds to continuous time is small and kept: a command held for a tick is late by half of
it (`hold_s`, part of the commands' delay where an effect has one, else added to the rotor lag), and the
sampled rate filter's slope is larger by half a tick times its corner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import casadi
import numpy as np

from trimtab.firmware_model.law import step as law_step
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.dfbc import Reference, control
from trimtab.firmware_model.law.observer import GREATEST, bounded, disturbance_seen
from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import dot, euler_to_matrix, mat_vec
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.ops import CASADI, NUMPY
from trimtab.host.codegen.rk4 import RungeKutta, runge_kutta
from trimtab.host.effects import Effect
from trimtab.host.models import estimator
from trimtab.host.models.bias import standing_errors
from trimtab.host.models.dynamics import (
    RATE,
    STATE_SIZE,
    THETA,
    THRUST,
    Part,
    V,
    command_delay_s,
    gravity_ned,
    memory_at_rest,
    memory_rates,
    memory_size,
    mocap_latency_s,
    motor_lag_s,
    rigid_body,
    rotor_torque,
    thrust_rates,
)
from trimtab.host.models.lanes import LaneProgram, lane_program
from trimtab.host.vehicle import Vehicle, to_parameters
from trimtab.protocol.parameters import DEFAULTS

Scalar = Any
Drive = Literal["reference", "estimate", "inputs"]

_DELAY_FILTER_S = 0.0041
"""Least T of the late commands' filter: 10 ms are then a step that RK4 is stable at."""

INTEGRAL = slice(16, 19)
"""The rate integral in the state. Behind it, where asked for: filtered body rate 3, estimator's errors 12;
where the observer is on: its estimate 3 (m/s^2, NED) and the collective thrust it reckons with (N); where an
effect delays the commands: these behind a short filter 4 (N); last the effects' own states.
"""

DRIVE_ROWS: Mapping[Drive, int] = {"reference": 22, "estimate": 34, "inputs": 6}
"""reference: flat outputs 14, fed-forward acceleration 3 and its derivative 3, voltage ratio, time. estimate:
these and p, v, Theta, body rate as estimated on board. inputs: rotor thrusts commanded 4 (N), voltage ratio,
time."""

FLIGHT = (
    "gain",
    "attitude_offset_roll",
    "attitude_offset_pitch",
    "prediction_time_s",
    "mocap_age_s",
    "mocap_interval_s",
    "feedback_delay_s",
    "accelerometer_x",
    "accelerometer_y",
    "accelerometer_z",
    *(f"accelerometer_{axis}_per_{way}" for axis in "xyz" for way in ("north", "east")),
)
"""Constants of one flight: form (a) of the feed-forward, age of a pose at its use, time between poses,
further delay of the position and velocity fed back, accelerometer bias as it looks from the poses, and by how
much it looks less for gravity towards north and east in their frame (`trimtab.host.models.bias`)."""


def flight_constants(
    block: Sequence[float] | None = None,
    *,
    mocap_age_s: float = 0.0,
    mocap_interval_s: float = 0.0,
    feedback_delay_s: float = 0.0,
    accelerometer_bias: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    bias_per_gravity: np.ndarray | None = None,
) -> np.ndarray:
    """Return the (16,) constants of a flight, for `Phi`; `block` is form (a) of what was fed forward.

    `bias_per_gravity` (3, 2): how much of the bias is gravity's; default: it is all the accelerometer's.
    """
    gain, roll, pitch, prediction = (1.0, 0.0, 0.0, 0.0)
    if block is not None:
        gain, roll, pitch, prediction = block[0], block[10], block[11], block[12]
    late = (mocap_age_s, mocap_interval_s, feedback_delay_s)
    share = np.zeros((3, 2)) if bias_per_gravity is None else bias_per_gravity
    return np.array([gain, roll, pitch, prediction, *late, *accelerometer_bias, *np.ravel(share)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Phi:
    """The closed loop of a vehicle with these effects, whose values are inputs (`theta`).

    `parameters` are the firmware's, by name (default: the vehicle file's). `estimator` adds its 12 error
    states to the drive `reference`: needed with a mocap latency, a prediction time, or poses so late that
    turning them forward shows; without them the errors are those that an accelerometer's bias makes to stand.
    The filter behind the rate derivative adds no states: its lag is kept to first order.
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
        """Where the estimator's errors are in the state; beyond its end without them."""
        return slice(INTEGRAL.stop, INTEGRAL.stop + estimator.SIZE)

    @property
    def observer(self) -> slice:
        """Where the observer's four states are; beyond the state's end without them."""
        start = self.errors.stop if self._has_estimator else self.errors.start
        return slice(start, start + 4)

    @cached_property
    def observes(self) -> bool:
        """Whether the law's disturbance observer is on, and its states are part of x."""
        return self.drive != "inputs" and law_step.observer(self.firmware)[0] > 0.0

    @property
    def commands(self) -> slice:
        """Where the four late rotor commands are: there is one set where an effect delays them."""
        start = self.observer.start + (4 if self.observes else 0)
        late = any(effect.command_delay_s is not None for effect in self.effects)
        return slice(start, start + (4 if late and self.drive != "inputs" else 0))

    @property
    def memory(self) -> slice:
        """Where the effects' own states are."""
        start = STATE_SIZE if self.drive == "inputs" else self.commands.stop
        return slice(start, start + memory_size(self.effects))

    @property
    def vectors(self) -> tuple[int, ...]:
        """Where vectors of NED start in the state."""
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
    def theta_neutral(self) -> np.ndarray:
        """The theta of the nominal vehicle."""
        return np.array([value for effect in self.effects for value in effect.neutral], dtype=float)

    def theta(self, parts: Sequence[Part]) -> np.ndarray:
        """Return theta for these values, neutral elsewhere. Raises ValueError for a missing effect."""
        values = {effect.name: effect.neutral for effect in self.effects}
        for effect, numbers in parts:
            if effect.name not in values:
                raise ValueError(
                    f"this model has no {effect.name}; it has {', '.join(values) or 'no effects'}"
                )
            values[effect.name] = tuple(float(number) for number in numbers)
        return np.array([value for effect in self.effects for value in values[effect.name]], dtype=float)

    def parts(self, theta: Any) -> list[Part]:
        """Every effect with its entries of theta."""
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
        """xdot, `size` scalars; `acceleration_ned` is the residual d of paper equation 2."""
        parts = self.parts(theta)
        rows = DRIVE_ROWS[self.drive]
        voltage, t = (drive[4], drive[5]) if rows == 6 else (drive[20], drive[21])
        own = [x[i] for i in range(self.memory.start, self.memory.stop)]
        body = rigid_body(ops, self.vehicle, parts, x, voltage, t, acceleration_ned, memory=own)
        own_rates = memory_rates(ops, self.vehicle, parts, x, own)
        lag = motor_lag_s(ops, self.vehicle, parts) + self.hold_s
        if self.drive == "inputs":
            return [*body, *thrust_rates(x[THRUST], drive[0:4], lag), *own_rates]
        return [*self._with_law(ops, parts, x, drive, flight, body, lag), *own_rates]

    def _with_law(
        self,
        ops: Ops,
        parts: Sequence[Part],
        x: Sequence[Scalar],
        drive: Sequence[Scalar],
        flight: Sequence[Scalar],
        body: Sequence[Scalar],
        lag: Scalar,
    ) -> list[Scalar]:
        """Return xdot with the law in the loop, from the rigid body's part of it."""
        gain, roll, pitch, prediction, age, interval, delay, *imu = (flight[i] for i in range(len(FLIGHT)))
        imu_bias, per_gravity = imu[:3], imu[3:]
        a, rate_dot = body[V], body[RATE]
        v_dot = a
        error_dot: list[Scalar] = []
        if self.drive == "estimate":
            p, v, rate = drive[22:25], drive[25:28], drive[31:34]
            R = euler_to_matrix(ops, drive[28:31])
        else:
            p, v, rate = x[0:3], x[V], x[RATE]
            R = euler_to_matrix(ops, x[THETA])
            gains = law_step.estimator_gains(self.firmware)
            if self._has_estimator:
                tilted = gravity_ned(ops, parts)
                if tilted is not None:
                    imu_bias = [
                        b + per_gravity[2 * i] * tilted[0] + per_gravity[2 * i + 1] * tilted[1]
                        for i, b in enumerate(imu_bias)
                    ]
                e = estimator.errors_of(x[self.errors], a, rate)
                R_true, R = R, estimator.turn(ops, R, e[6:9])
                error_dot = estimator.error_rates(
                    gains, e, R_true, R, v, a, rate, rate_dot,
                    age, prediction, mocap_latency_s(ops, parts), interval, imu_bias,
                    tilted or (0.0, 0.0, 0.0),
                )  # fmt: skip
                v_dot = [a[i] + error_dot[3 + i] for i in range(3)]
                p = [p[i] + e[i] for i in range(3)]
                v = [v[i] + e[3 + i] for i in range(3)]
                rate = [rate[i] - e[9 + i] for i in range(3)]
            else:  # what stands of the errors
                excess = mat_vec(R, imu_bias)
                off_p, off_v = standing_errors(gains, age, interval)
                p = [p[i] + off_p * excess[i] for i in range(3)]
                v = [v[i] + off_v * excess[i] for i in range(3)]
            p = [p[i] - delay * (v[i] - 0.5 * delay * a[i]) for i in range(3)]
            v = [v[i] - delay * a[i] for i in range(3)]

        k = law_step.gains(self.firmware)
        corner, slope_share = _sampled_filter(k.filter_rate)
        away = [alpha / corner for alpha in rate_dot]  # the filter's lag behind a ramp
        limit = law_step.integral_limit(self.firmware)
        integral = [ops.clip(x[INTEGRAL.start + i], -limit[i], limit[i]) for i in range(3)]
        ff_accel = drive[14:17]
        if self.observes:
            start = self.observer.start
            d_hat = bounded(ops, [x[start + i] for i in range(3)])
            ff_accel = [ff_accel[i] + d_hat[i] for i in range(3)]
        reference = Reference(drive[0:3], drive[3:6], drive[6:9], drive[9:12], drive[12], drive[13])
        collective, torque, _, integral_dot = control(
            ops, k, law_step.body(self.firmware), p, v, R, rate,
            [rate[i] - slope_share * away[i] for i in range(3)], integral, reference,
            ff_accel, ff_jerk=drive[17:20], attitude_offset=(roll, pitch),
        )  # fmt: skip
        share = slope_share * k.filter_rate / (corner * corner)
        torque = _behind(torque, rotor_torque(self.vehicle, x[THRUST]), k.rate_derivative, share, lag)
        _, command, _ = law_step.motors(ops, self.firmware, collective, torque, gain)
        arriving, late_rates = command, []
        if self.commands.stop > self.commands.start:
            # exp(-D s) as 1 - D s / (1 + T s): right to second order in s where D = 2 T.
            delay_s = command_delay_s(ops, parts) + self.hold_s
            lag = lag - self.hold_s  # the hold is a delay like the other, no part of the lag
            filter_s = ops.maximum(0.5 * delay_s, _DELAY_FILTER_S)
            late_rates = [(u - x[self.commands.start + i]) / filter_s for i, u in enumerate(command)]
            arriving = [u - delay_s * rate for u, rate in zip(command, late_rates, strict=True)]
        return [
            *body,
            *thrust_rates(x[THRUST], arriving, lag),
            *(_held(ops, integral[i], integral_dot[i], limit[i]) for i in range(3)),
            *error_dot,
            *(self._observer_rates(ops, x, v_dot, R, gain, command) if self.observes else ()),
            *late_rates,
        ]

    def _observer_rates(
        self,
        ops: Ops,
        x: Sequence[Scalar],
        v_dot: Sequence[Scalar],
        R: Sequence[Scalar],
        gain: Scalar,
        command: Sequence[Scalar],
    ) -> list[Scalar]:
        """Return derivative of the observer's states (`law.observer`); v_dot and R as estimated."""
        *d_hat, thrust = (x[i] for i in range(self.observer.start, self.observer.stop))
        bandwidth, lag = law_step.observer(self.firmware)
        seen = disturbance_seen(v_dot, R, thrust, law_step.body(self.firmware).mass_kg)
        rates = [bandwidth * (s - d) for d, s in zip(d_hat, seen, strict=True)]
        square = dot(d_hat, d_hat)
        growth = ops.maximum(dot(d_hat, rates), 0.0) / ops.maximum(square, GREATEST * GREATEST)
        outward = ops.where(square >= GREATEST * GREATEST, growth, 0.0)  # stands at its bound
        rates = [rate - outward * d for rate, d in zip(rates, d_hat, strict=True)]
        given = gain * (command[0] + command[1] + command[2] + command[3])
        return [*rates, (given - thrust) / (lag + self.hold_s)]

    @cached_property
    def firmware(self) -> tuple[float, ...]:
        """The law's block `parameters`; what the firmware of an old log did not have is at its default."""
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
    def program(self) -> LaneProgram:
        """The derivative over numpy lanes."""
        return lane_program(self.function)

    @cached_property
    def integrator(self) -> RungeKutta | None:
        """Roll-outs of the derivative in C; None where it cannot be compiled."""
        return runge_kutta(self.program.function)

    @cached_property
    def stiffness(self) -> float:
        """Largest eigenvalue of the linearised model at hover, 1/s: what the step size must resolve."""
        x, drive = casadi.SX.sym("x", self.size), casadi.SX.sym("drive", DRIVE_ROWS[self.drive])
        flight, theta = flight_constants(), self.theta_neutral
        xdot = self.function(x, drive, flight, theta, np.zeros(3))
        jacobian = casadi.Function("jacobian", [x, drive], [casadi.jacobian(xdot, x)])
        hover = self.hover((0.0, 0.0, -1.0), 0.0)
        still = np.zeros(DRIVE_ROWS[self.drive])
        still[2 if self.drive != "inputs" else 5] = -1.0 if self.drive != "inputs" else 0.0
        still[4 if self.drive == "inputs" else 20] = 1.0
        matrix = np.array(jacobian(hover, still), dtype=float)
        return float(np.abs(np.linalg.eigvals(matrix)).max())

    def substeps(self, step_s: float) -> int:
        """RK4 steps that one step of `step_s` must be split into: |eigenvalue| times step at most 1.5."""
        return max(1, math.ceil(self.stiffness * step_s / 1.5))

    def at_rest(self, x: np.ndarray) -> np.ndarray:
        """Return the effects' own states where the vehicle has long been at rest in state x, at neutral
        values.
        """
        parts = self.parts(self.theta_neutral)
        return np.array(memory_at_rest(NUMPY, self.vehicle, parts, list(x[:STATE_SIZE])), dtype=float)

    def hover(self, p_ned: Sequence[float], yaw: float) -> np.ndarray:
        """Return the state (size,) of the nominal vehicle at rest at p_ned."""
        x = np.zeros(self.size)
        x[0:3], x[8] = p_ned, yaw
        x[THRUST] = self.vehicle.mass_kg * GRAVITY / 4.0
        x[self.commands] = self.vehicle.mass_kg * GRAVITY / 4.0
        x[self.memory] = self.at_rest(x)
        if self.observes:
            x[self.observer.stop - 1] = self.vehicle.mass_kg * GRAVITY
        return x


def _sampled_filter(corner: float) -> tuple[float, float]:
    """Corner (rad/s) of the sampled rate filter in continuous time, and what the law's slope is too large by.

    The law's filter advances by c = w dt / (1 + w dt/2) a tick. Continuous, it decays at -ln(1 - c)/dt; its
    lag behind a ramp is dt/c, of which the law takes w times as slope.
    """
    dt = law_step.TICK_S
    advance = corner * dt / (1.0 + 0.5 * corner * dt)
    continuous = -math.log1p(-advance) / dt
    return continuous, continuous * dt / advance


def _behind(
    torque: Sequence[Scalar],
    now: Sequence[Scalar],
    rate_derivative: Sequence[Scalar],
    share: float,
    lag: Scalar,
) -> list[Scalar]:
    """Return the torque commanded where the slope lags: `torque` has the slope of this moment in it.

    The filter's slope is late by its time constant, so short of K_d times the change of torque since; that
    change is itself (commanded - now) / lag: one equation an axis, solved.
    """
    commanded = []
    for wanted, present, gain in zip(torque, now, rate_derivative, strict=True):
        c = gain * share / lag
        commanded.append((wanted - c * present) / (1.0 - c))
    return commanded


def _held(ops: Ops, value: Scalar, rate: Scalar, limit: float) -> Scalar:
    """Return the integral's rate, 0 where it stands at its limit and would go on."""
    up = ops.where(value >= limit, ops.maximum(rate, 0.0), 0.0)
    down = ops.where(value <= -limit, ops.minimum(rate, 0.0), 0.0)
    return rate - up - down
