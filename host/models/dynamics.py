"""The rigid-body model f(x, u): paper equation 1, first-order lag on rotor thrust, and the effects' slots.

State x, 16 scalars: p_ned 3, v_ned 3, Theta 3 (roll, pitch, yaw), rate_frd 3, rotor thrust 4 (N, nominal,
before any thrust factor). The same source runs on floats, CasADi scalars and numpy lanes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import euler_rates, euler_to_matrix, mat_t_vec, mat_vec
from trimtab.host.effects import Context, Effect
from trimtab.host.effects.effect import SLOTS

Scalar = Any
Part = tuple[Effect, Sequence[Scalar]]  # an effect and its parameter values

STATE_SIZE = 16
P, V, THETA, RATE, THRUST = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 16)


class Rotor(Protocol):
    """One rotor: where it stands and how it turns seen from above."""

    @property
    def position_m(self) -> Sequence[float]: ...
    @property
    def spin(self) -> str: ...


class Airframe(Protocol):
    """What the model reads of a vehicle file."""

    @property
    def mass_kg(self) -> float: ...
    @property
    def inertia_kg_m2(self) -> Sequence[float]: ...
    @property
    def rotors(self) -> Sequence[Rotor]: ...
    @property
    def thrust_max_n(self) -> float: ...
    @property
    def thrust_curve(self) -> Sequence[float]: ...
    @property
    def torque_per_thrust_m(self) -> float: ...
    @property
    def motor_lag_s(self) -> float: ...


def derivative(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    thrust_command: Sequence[Scalar],
    voltage_ratio: Scalar = 1.0,
    t_s: Scalar = 0.0,
    acceleration_ned: Sequence[Scalar] | None = None,
    rate_dot_frd: Sequence[Scalar] | None = None,
) -> list[Scalar]:
    """xdot, 16 scalars, for commanded rotor thrusts in N; the other arguments as of `rigid_body`."""
    body = rigid_body(ops, vehicle, effects, x, voltage_ratio, t_s, acceleration_ned, rate_dot_frd)
    return [*body, *thrust_rates(x[THRUST], thrust_command, motor_lag_s(ops, vehicle, effects))]


def rigid_body(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    voltage_ratio: Scalar = 1.0,
    t_s: Scalar = 0.0,
    acceleration_ned: Sequence[Scalar] | None = None,
    rate_dot_frd: Sequence[Scalar] | None = None,
    memory: Sequence[Scalar] = (),
) -> list[Scalar]:
    """Return derivative of p, v, Theta and rate, 12 scalars: explicit, since rotor thrusts are states.

    `acceleration_ned` and `rate_dot_frd` are added to the translational and angular acceleration: the learned
    residual d(x) of paper equation 2, or a disturbance being estimated. `memory` holds the effects' own
    states, one after the other; without it they are as at rest. Paper equation 1; the slots' meaning is
    stated in `trimtab.host.effects.effect`.
    """
    v, rate = x[V], x[RATE]
    R = euler_to_matrix(ops, x[THETA])
    mass, thrust, collective, force, torque_extra = _loads(
        ops, vehicle, effects, x, R, x[THRUST], voltage_ratio, t_s, memory
    )
    tau = rotor_torque(vehicle, thrust)
    if torque_extra is not None:
        tau = _add(tau, torque_extra)

    up = collective / mass
    if force is None:
        a = (-R[2] * up, -R[5] * up, GRAVITY - R[8] * up)
    else:
        ax, ay, az = mat_vec(R, (force[0], force[1], force[2] - up))
        a = (ax, ay, az + GRAVITY)
    jx, jy, jz = _inertia(ops, vehicle, effects)
    wx, wy, wz = rate
    alpha = (
        (tau[0] - (jz - jy) * wy * wz) / jx,
        (tau[1] - (jx - jz) * wz * wx) / jy,
        (tau[2] - (jy - jx) * wx * wy) / jz,
    )
    tilted = gravity_ned(ops, effects)
    if tilted is not None:
        a = _add(a, tilted)
    if acceleration_ned is not None:
        a = _add(a, acceleration_ned)
    if rate_dot_frd is not None:
        alpha = _add(alpha, rate_dot_frd)
    return [*v, *a, *euler_rates(ops, x[THETA], rate), *alpha]


def thrust_rates(thrust: Sequence[Scalar], command: Sequence[Scalar], lag_s: Scalar) -> list[Scalar]:
    """Return derivative of the four rotor thrusts: first order towards the command."""
    per_lag = 1.0 / lag_s
    return [(wanted - now) * per_lag for wanted, now in zip(command, thrust, strict=True)]


def residual_acceleration_ned(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    voltage_ratio: Scalar = 1.0,
    t_s: Scalar = 0.0,
) -> Sequence[Scalar]:
    """Return the effects' specific force as acceleration in the world."""
    R = euler_to_matrix(ops, x[6:9])
    force = _loads(ops, vehicle, effects, x, R, x[12:16], voltage_ratio, t_s, ())[3]
    return (0.0, 0.0, 0.0) if force is None else mat_vec(R, force)


_PUSHES = ("mass_factor", "thrust_factor", "rotor_factors", "gravity_ned")
_TURNS = ("thrust_factor", "rotor_factors", "inertia_factors", "torque_frd")


def residual_loads(
    ops: Ops, vehicle: Airframe, effects: Sequence[Part], known: Sequence[Part], x: Sequence[Scalar]
) -> tuple[list[Scalar] | None, list[Scalar] | None]:
    """Return what effects on mass, thrust, gravity, inertia and torque change at x against `known`, some of
    them.

    The acceleration (3), m/s^2 NED, and the moments of inertia of the vehicle file times the angular
    acceleration (3), N m FRD: of `rigid_body` with all the effects less with those known, both without
    specific force, which `residual_acceleration_ned` has. None where no effect beyond those known fills a
    slot that could change it.
    """
    names = {effect.name for effect, _ in known}
    beyond = [effect for effect, _ in effects if effect.name not in names]
    pushes, turns = (
        any(getattr(effect, slot) is not None for effect in beyond for slot in slots)
        for slots in (_PUSHES, _TURNS)
    )
    if not pushes and not turns:
        return None, None
    all_of, part_of = (rigid_body(ops, vehicle, _forceless(parts), x) for parts in (effects, known))
    change = [a - b for a, b in zip(all_of, part_of, strict=True)]
    torque = [j * alpha for j, alpha in zip(vehicle.inertia_kg_m2, change[RATE], strict=True)]
    return change[V] if pushes else None, torque if turns else None


def _forceless(effects: Sequence[Part]) -> list[Part]:
    """Return the effects without their specific force."""
    rest = [
        (effect, theta)
        for effect, theta in effects
        if any(getattr(effect, slot) is not None for slot in SLOTS if slot != "specific_force_frd")
    ]
    return [(dataclasses.replace(effect, specific_force_frd=None), theta) for effect, theta in rest]


def rotor_torque(vehicle: Airframe, thrust: Sequence[Scalar]) -> tuple[Scalar, Scalar, Scalar]:
    """Torque about the body axes from the rotor thrusts: r x (0, 0, -T), and the rotors' reaction about z."""
    tau_x = tau_y = tau_z = 0.0
    for rotor, T in zip(vehicle.rotors, thrust, strict=True):
        spin = 1.0 if rotor.spin == "ccw" else -1.0
        tau_x = tau_x - rotor.position_m[1] * T
        tau_y = tau_y + rotor.position_m[0] * T
        tau_z = tau_z + spin * vehicle.torque_per_thrust_m * T
    return tau_x, tau_y, tau_z


def motor_lag_s(ops: Ops, vehicle: Airframe, effects: Sequence[Part]) -> Scalar:
    """Time constant of the rotor thrusts with all effects."""
    lag: Scalar = vehicle.motor_lag_s
    for effect, theta in effects:
        if effect.motor_lag_s is not None:
            lag = effect.motor_lag_s(ops, theta, lag)
    return lag


def mocap_latency_s(ops: Ops, effects: Sequence[Part]) -> Scalar:
    """Undeclared age of a pose at its time stamp: the sum over all effects, 0 without any."""
    latency: Scalar = 0.0
    for effect, theta in effects:
        if effect.mocap_latency_s is not None:
            latency = latency + effect.mocap_latency_s(ops, theta)
    return latency


def command_delay_s(ops: Ops, effects: Sequence[Part]) -> Scalar:
    """Time by which motor commands arrive late: the sum over all effects, 0 without any."""
    delay: Scalar = 0.0
    for effect, theta in effects:
        if effect.command_delay_s is not None:
            delay = delay + effect.command_delay_s(ops, theta)
    return delay


def gravity_ned(ops: Ops, effects: Sequence[Part]) -> Sequence[Scalar] | None:
    """Return what the effects add to gravity in the frame of the measurements, m/s^2; None: nothing."""
    total: Sequence[Scalar] | None = None
    for effect, theta in effects:
        if effect.gravity_ned is not None:
            g = effect.gravity_ned(ops, theta)
            total = g if total is None else _add(total, g)
    return total


def memory_size(effects: Iterable[Effect]) -> int:
    """Return number of states that the effects have of their own."""
    return sum(effect.memory for effect in effects)


def memory_at_rest(ops: Ops, vehicle: Airframe, effects: Sequence[Part], x: Sequence[Scalar]) -> list[Scalar]:
    """Return the effects' own states where the vehicle has long been at rest in state x."""
    return _memory(ops, vehicle, effects, x, (), rates=False)


def memory_rates(
    ops: Ops, vehicle: Airframe, effects: Sequence[Part], x: Sequence[Scalar], memory: Sequence[Scalar]
) -> list[Scalar]:
    """Return the derivatives of the effects' own states."""
    return _memory(ops, vehicle, effects, x, memory, rates=True)


def _memory(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    memory: Sequence[Scalar],
    *,
    rates: bool,
) -> list[Scalar]:
    out: list[Scalar] = []
    if not memory_size(effect for effect, _ in effects):
        return out
    R = euler_to_matrix(ops, x[THETA])
    ctx = _context(vehicle, x, R, mat_t_vec(R, x[V]), x[THRUST], vehicle.mass_kg, 1.0, 0.0)
    for effect, theta in effects:
        if not effect.memory:
            continue
        if rates:
            assert effect.memory_rates is not None
            own = memory[len(out) : len(out) + effect.memory]
            out += effect.memory_rates(ops, theta, ctx._replace(memory=own))
        else:
            assert effect.memory_start is not None
            out += effect.memory_start(ops, theta, ctx)
    return out


def _inertia(ops: Ops, vehicle: Airframe, effects: Sequence[Part]) -> Sequence[Scalar]:
    """Principal moments of inertia with all effects."""
    j: Sequence[Scalar] = vehicle.inertia_kg_m2
    for effect, theta in effects:
        if effect.inertia_factors is not None:
            j = [a * f for a, f in zip(j, effect.inertia_factors(ops, theta), strict=True)]
    return j


def _context(
    vehicle: Airframe,
    x: Sequence[Scalar],
    R: Sequence[Scalar],
    v_air_frd: Sequence[Scalar],
    thrust: Sequence[Scalar],
    mass: Scalar,
    voltage_ratio: Scalar,
    t_s: Scalar,
) -> Context:
    return Context(
        p_ned=x[0:3],
        v_ned=x[3:6],
        v_air_frd=v_air_frd,
        R=R,
        rate_frd=x[9:12],
        thrust=thrust,
        collective_n=thrust[0] + thrust[1] + thrust[2] + thrust[3],
        mass_kg=mass,
        voltage_ratio=voltage_ratio,
        t_s=t_s,
        rotor_positions=tuple(tuple(rotor.position_m) for rotor in vehicle.rotors),
        spin_signs=tuple(1.0 if rotor.spin == "ccw" else -1.0 for rotor in vehicle.rotors),
        inertia_kg_m2=vehicle.inertia_kg_m2,
        hover_n=vehicle.mass_kg * GRAVITY / 4.0,
    )


def _loads(  # noqa: C901 - one expression; CasADi's order of operations is part of every reference
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    R: Sequence[Scalar],
    thrust: Sequence[Scalar],
    voltage_ratio: Scalar,
    t_s: Scalar,
    memory: Sequence[Scalar],
) -> tuple[Scalar, Sequence[Scalar], Scalar, Sequence[Scalar] | None, Sequence[Scalar] | None]:
    """Mass, rotor thrusts after factors, their sum, the effects' specific force and torque (None: none)."""
    mass: Scalar = vehicle.mass_kg
    wind: Sequence[Scalar] | None = None
    for effect, theta in effects:
        if effect.mass_factor is not None:
            mass = mass * effect.mass_factor(ops, theta)
        if effect.wind_ned is not None:
            w = effect.wind_ned(ops, theta)
            wind = w if wind is None else _add(wind, w)
    collective = thrust[0] + thrust[1] + thrust[2] + thrust[3]
    if not any(
        e.thrust_factor or e.rotor_factors or e.specific_force_frd or e.torque_frd for e, _ in effects
    ):
        return mass, thrust, collective, None, None

    v = x[3:6]
    v_air = v if wind is None else (v[0] - wind[0], v[1] - wind[1], v[2] - wind[2])
    ctx = _context(vehicle, x, R, mat_t_vec(R, v_air), thrust, mass, voltage_ratio, t_s)
    factor: Scalar | None = None
    for effect, theta in effects:
        if effect.thrust_factor is not None:
            f = effect.thrust_factor(ops, theta, ctx)
            factor = f if factor is None else factor * f
    each: Sequence[Scalar] | None = None
    for effect, theta in effects:
        if effect.rotor_factors is not None:
            f = effect.rotor_factors(ops, theta, ctx)
            each = f if each is None else [a * b for a, b in zip(each, f, strict=True)]
    if factor is not None or each is not None:
        if factor is not None:
            thrust = [factor * T for T in thrust]
        if each is not None:
            thrust = [f * T for f, T in zip(each, thrust, strict=True)]
        collective = thrust[0] + thrust[1] + thrust[2] + thrust[3]
        ctx = ctx._replace(thrust=thrust, collective_n=collective)
    force: Sequence[Scalar] | None = None
    torque: Sequence[Scalar] | None = None
    if not len(memory):
        memory = memory_at_rest(ops, vehicle, effects, x)
    start = 0
    for effect, theta in effects:
        ctx = ctx._replace(memory=memory[start : start + effect.memory])
        start += effect.memory
        if effect.specific_force_frd is not None:
            f = effect.specific_force_frd(ops, theta, ctx)
            force = f if force is None else _add(force, f)
        if effect.torque_frd is not None:
            t = effect.torque_frd(ops, theta, ctx)
            torque = t if torque is None else _add(torque, t)
    return mass, thrust, collective, force, torque


def _add(a: Sequence[Scalar], b: Sequence[Scalar]) -> tuple[Scalar, Scalar, Scalar]:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
