"""All effects of a vehicle together, slot by slot: loads, lags, delays, gravity, inertia and states.

`trimtab.host.effects.effect` explains the slots.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import Any, NamedTuple

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import euler_to_matrix, mat_t_vec
from trimtab.host.effects import Context, Effect
from trimtab.host.models.airframe import RATE, THETA, THRUST, Airframe, P, Part, V

Scalar = Any


class Loads(NamedTuple):
    """Mass (kg), rotor thrusts after all factors and their sum (N), with all effects.

    specific_force_frd, torque_frd: what the effects add (m/s^2, N m); None where no effect adds any.
    """

    mass: Scalar
    thrust: Sequence[Scalar]
    collective: Scalar
    specific_force_frd: Sequence[Scalar] | None
    torque_frd: Sequence[Scalar] | None


def loads(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    R: Sequence[Scalar],
    voltage_ratio: Scalar = 1.0,
    t_s: Scalar = 0.0,
    memory: Sequence[Scalar] = (),
) -> Loads:
    """Return the loads on the body with all effects; arguments as of `rigid_body`.

    CasADi's order of operations here is part of every recorded result.
    """
    if not any(
        e.thrust_factor or e.rotor_factors or e.specific_force_frd or e.torque_frd for e, _ in effects
    ):
        return Loads(mass_kg(ops, vehicle, effects), x[THRUST], _sum(x[THRUST]), None, None)
    ctx = _loaded(ops, vehicle, effects, x, R, voltage_ratio, t_s)
    if not len(memory):
        memory = memory_at_rest(ops, vehicle, effects, x)
    return Loads(ctx.mass_kg, ctx.thrust, ctx.collective_n, *_force_and_torque(ops, effects, ctx, memory))


def _loaded(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    R: Sequence[Scalar],
    voltage_ratio: Scalar,
    t_s: Scalar,
) -> Context:
    """Return the context with the mass, thrusts and wind of all effects."""
    v, wind = x[V], _wind_ned(ops, effects)
    v_air = v if wind is None else (v[0] - wind[0], v[1] - wind[1], v[2] - wind[2])
    ctx = _context(vehicle, x, R, mat_t_vec(R, v_air), mass_kg(ops, vehicle, effects), voltage_ratio, t_s)
    thrust = _effective_thrust(ops, effects, ctx)
    return ctx if thrust is None else ctx._replace(thrust=thrust, collective_n=_sum(thrust))


def mass_kg(ops: Ops, vehicle: Airframe, effects: Sequence[Part]) -> Scalar:
    """Return the mass (kg) with all effects."""
    mass: Scalar = vehicle.mass_kg
    for effect, theta in effects:
        if effect.mass_factor is not None:
            mass = mass * effect.mass_factor(ops, theta)
    return mass


def _wind_ned(ops: Ops, effects: Sequence[Part]) -> Sequence[Scalar] | None:
    """Return the wind of all effects, m/s NED; None without any."""
    wind: Sequence[Scalar] | None = None
    for effect, theta in effects:
        if effect.wind_ned is not None:
            w = effect.wind_ned(ops, theta)
            wind = w if wind is None else add(wind, w)
    return wind


def _effective_thrust(ops: Ops, effects: Sequence[Part], ctx: Context) -> Sequence[Scalar] | None:
    """Return the rotor thrusts (N) times all thrust factors; None where no effect has one."""
    common: Scalar | None = None
    for effect, theta in effects:
        if effect.thrust_factor is not None:
            f = effect.thrust_factor(ops, theta, ctx)
            common = f if common is None else common * f
    each: Sequence[Scalar] | None = None
    for effect, theta in effects:
        if effect.rotor_factors is not None:
            f = effect.rotor_factors(ops, theta, ctx)
            each = f if each is None else [a * b for a, b in zip(each, f, strict=True)]
    if common is None and each is None:
        return None
    thrust = ctx.thrust
    if common is not None:
        thrust = [common * T for T in thrust]
    if each is not None:
        thrust = [f * T for f, T in zip(each, thrust, strict=True)]
    return thrust


def _force_and_torque(
    ops: Ops, effects: Sequence[Part], ctx: Context, memory: Sequence[Scalar]
) -> tuple[Sequence[Scalar] | None, Sequence[Scalar] | None]:
    """Return the effects' specific force and torque (FRD), each None where no effect has one."""
    force: Sequence[Scalar] | None = None
    torque: Sequence[Scalar] | None = None
    start = 0
    for effect, theta in effects:
        ctx = ctx._replace(memory=memory[start : start + effect.memory])
        start += effect.memory
        if effect.specific_force_frd is not None:
            f = effect.specific_force_frd(ops, theta, ctx)
            force = f if force is None else add(force, f)
        if effect.torque_frd is not None:
            t = effect.torque_frd(ops, theta, ctx)
            torque = t if torque is None else add(torque, t)
    return force, torque


def thrust_rate_torque_frd(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    thrust_rates: Sequence[Scalar],
) -> Sequence[Scalar] | None:
    """Return the effects' torque (FRD, N m) from changes of the rotor thrusts; None where no effect has one.

    thrust_rates: derivatives of the rotor thrusts, N/s.
    """
    filled = [(effect.thrust_rate_torque_frd, theta) for effect, theta in effects]
    slots = [(slot, theta) for slot, theta in filled if slot is not None]
    if not slots:
        return None
    ctx = _nominal(ops, vehicle, x)
    return reduce(add, (slot(ops, theta, ctx, thrust_rates) for slot, theta in slots))


def _sum(thrust: Sequence[Scalar]) -> Scalar:
    return thrust[0] + thrust[1] + thrust[2] + thrust[3]


def motor_lag_s(ops: Ops, vehicle: Airframe, effects: Sequence[Part]) -> Scalar:
    """Return the time constant of the rotor thrusts with all effects."""
    lag: Scalar = vehicle.motor_lag_s
    for effect, theta in effects:
        if effect.motor_lag_s is not None:
            lag = effect.motor_lag_s(ops, theta, lag)
    return lag


def driven_thrusts_n(
    ops: Ops, vehicle: Airframe, effects: Sequence[Part], command_n: Sequence[Scalar]
) -> Sequence[Scalar]:
    """Return the thrusts that the commanded thrusts (N) drive the rotors to, with all effects."""
    hover_n = vehicle.mass_kg * GRAVITY / 4.0
    for effect, theta in effects:
        if effect.driven_thrust_n is not None:
            command_n = [effect.driven_thrust_n(ops, theta, command, hover_n) for command in command_n]
    return command_n


def speed_thrusts_n(
    ops: Ops, vehicle: Airframe, effects: Sequence[Part], thrust_n: Sequence[Scalar], voltage_ratio: Scalar
) -> Sequence[Scalar]:
    """Return the thrusts (N) that the speeds of the rotors stand for.

    They are `thrust_n` with the factors of the effects that slow the rotors, and of no others.
    """
    ctx = _context(vehicle, [*(0.0,) * 12, *thrust_n], (), (), vehicle.mass_kg, voltage_ratio, 0.0)
    slowing = [(effect, theta) for effect, theta in effects if effect.slows_rotors]
    slowed = _effective_thrust(ops, slowing, ctx)
    return thrust_n if slowed is None else slowed


def rotor_lags_s(
    ops: Ops, effects: Sequence[Part], lag_s: Scalar, driven_n: Sequence[Scalar], thrust_n: Sequence[Scalar]
) -> list[Scalar]:
    """Return the time constant of each rotor: `lag_s`, common to all, with the factors of all effects."""
    lags = [lag_s] * len(thrust_n)
    for effect, theta in effects:
        if effect.lag_factor is not None:
            factors = [effect.lag_factor(ops, theta, *pair) for pair in zip(driven_n, thrust_n, strict=True)]
            lags = [lag * factor for lag, factor in zip(lags, factors, strict=True)]
    return lags


def mocap_latency_s(ops: Ops, effects: Sequence[Part]) -> Scalar:
    """Return the undeclared age of a pose at its time stamp: the sum over all effects."""
    latency: Scalar = 0.0
    for effect, theta in effects:
        if effect.mocap_latency_s is not None:
            latency = latency + effect.mocap_latency_s(ops, theta)
    return latency


def command_delay_s(ops: Ops, effects: Sequence[Part]) -> Scalar:
    """Return the delay of motor commands: the sum over all effects."""
    delay: Scalar = 0.0
    for effect, theta in effects:
        if effect.command_delay_s is not None:
            delay = delay + effect.command_delay_s(ops, theta)
    return delay


def gravity_ned(ops: Ops, effects: Sequence[Part]) -> Sequence[Scalar] | None:
    """Return what the effects add to gravity in the frame of the measurements, m/s^2, or None."""
    total: Sequence[Scalar] | None = None
    for effect, theta in effects:
        if effect.gravity_ned is not None:
            g = effect.gravity_ned(ops, theta)
            total = g if total is None else add(total, g)
    return total


def inertia(ops: Ops, vehicle: Airframe, effects: Sequence[Part], mass_kg: Scalar) -> Sequence[Scalar]:
    """Return the elements xx, yy, zz and xy of the inertia matrix with all effects; the others are 0.

    They are the moments of the vehicle file times the factors of the effects, plus what the effects add.
    """
    j: Sequence[Scalar] = vehicle.inertia_kg_m2
    for effect, theta in effects:
        if effect.inertia_factors is not None:
            j = [a * f for a, f in zip(j, effect.inertia_factors(ops, theta), strict=True)]
    elements: Sequence[Scalar] = (*j, 0.0)
    for effect, theta in effects:
        if effect.added_inertia_kg_m2 is not None:
            added = effect.added_inertia_kg_m2(ops, theta, mass_kg)
            elements = [a + b for a, b in zip(elements, added, strict=True)]
    return elements


def memory_size(effects: Iterable[Effect]) -> int:
    """Return how many states the effects have."""
    return sum(effect.memory for effect in effects)


def memory_at_rest(ops: Ops, vehicle: Airframe, effects: Sequence[Part], x: Sequence[Scalar]) -> list[Scalar]:
    """Return the effects' states after a long rest in state x, one effect after the other."""
    out: list[Scalar] = []
    if not memory_size(effect for effect, _ in effects):
        return out
    ctx = _nominal(ops, vehicle, x)
    for effect, theta in effects:
        if effect.memory_start is not None:
            out += effect.memory_start(ops, theta, ctx)
    return out


def memory_rates(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    memory: Sequence[Scalar],
    a_ned: Sequence[Scalar],
    voltage_ratio: Scalar = 1.0,
    t_s: Scalar = 0.0,
) -> list[Scalar]:
    """Return the derivatives of the effects' states; arguments as of `rigid_body`.

    a_ned: acceleration of the vehicle, m/s^2, as `rigid_body` returns it.
    """
    out: list[Scalar] = []
    if not len(memory):
        return out
    ctx = _loaded(ops, vehicle, effects, x, euler_to_matrix(ops, x[THETA]), voltage_ratio, t_s)
    ctx = ctx._replace(a_ned=a_ned)
    for effect, theta in effects:
        if effect.memory_rates is not None:
            states = memory[len(out) : len(out) + effect.memory]
            out += effect.memory_rates(ops, theta, ctx._replace(memory=states))
    return out


def _nominal(ops: Ops, vehicle: Airframe, x: Sequence[Scalar]) -> Context:
    """Return the context of the nominal vehicle."""
    R = euler_to_matrix(ops, x[THETA])
    return _context(vehicle, x, R, mat_t_vec(R, x[V]), vehicle.mass_kg, 1.0, 0.0)


def _context(
    vehicle: Airframe,
    x: Sequence[Scalar],
    R: Sequence[Scalar],
    v_air_frd: Sequence[Scalar],
    mass: Scalar,
    voltage_ratio: Scalar,
    t_s: Scalar,
) -> Context:
    thrust = x[THRUST]
    return Context(
        p_ned=x[P],
        v_ned=x[V],
        v_air_frd=v_air_frd,
        R=R,
        rate_frd=x[RATE],
        thrust=thrust,
        collective_n=_sum(thrust),
        mass_kg=mass,
        voltage_ratio=voltage_ratio,
        t_s=t_s,
        rotor_positions=tuple(tuple(rotor.position_m) for rotor in vehicle.rotors),
        spin_signs=tuple(1.0 if rotor.spin == "ccw" else -1.0 for rotor in vehicle.rotors),
        inertia_kg_m2=vehicle.inertia_kg_m2,
        hover_n=vehicle.mass_kg * GRAVITY / 4.0,
        torque_per_thrust_m=vehicle.torque_per_thrust_m,
    )


def add(a: Sequence[Scalar], b: Sequence[Scalar]) -> tuple[Scalar, Scalar, Scalar]:
    """Return the sum of two vectors (3)."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
