"""One tick of the simulated physics as a symbolic function, independent of the host's models.

The host's nominal model has Euler angles, a first-order lag of thrust, and forces on the whole body. Here the
attitude is a quaternion, rotors have speeds, forces act at each rotor hub, the centre of mass may be off the
origin, and feet touch a floor. Every effect acts where it arises, so the host's form of it is an
approximation, as for a real vehicle.

A rotor speed is a share of full speed: thrust is `thrust_max_n * speed**2`. Frames: world NED, body FRD with
the origin at the centre of the rotors. p and v of the state belong to the centre of mass.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import Any, NamedTuple

from trimtab.sitl.carried import battery, held_camera, load_kg, slide
from trimtab.sitl.rotors import ground_gain, rotor_speeds, rotor_thrust
from trimtab.sitl.surroundings import (
    GRAVITY_M_S2,
    fan,
    floor,
    payload,
    sweeping_fan,
    tether,
    wall_suction,
    wind,
)
from trimtab.sitl.vectors import (
    Scalar,
    Vector,
    add,
    ahead,
    cross,
    dot,
    into_body,
    into_world,
    quaternion_rate,
    rotation,
    symmetric,
    unit,
)

TICK_S = 0.001
_AIRBORNE_M = 0.2  # height above which a vehicle has lifted off


class Block(NamedTuple):
    """A named vector."""

    name: str
    size: int


STATE = (
    Block("p_ned", 3),
    Block("v_ned", 3),
    Block("q_ned_frd", 4),
    Block("rate_frd", 3),
    Block("rotor_speed", 4),
    Block("charge_used_c", 1),
    Block("gust", 6),
    Block("acceleration_ned", 3),
    Block("turning_frd", 3),
    Block("payload_ned", 6),
    Block("slide", 2),
    Block("clock", 3),
)
"""State of the plant, in order.

`gust`: accelerations of turbulence, NED (m/s^2) and FRD (rad/s^2). `acceleration_ned`, `turning_frd`: of the
last tick. `payload_ned`: position and velocity of the payload. `slide`: displacement and speed of a battery.
`clock`: time since lift-off, s; turns of a sweeping fan; spells of a stuttering motor.
"""

PARAMETERS = (
    Block("mass_kg", 1),
    Block("inertia", 6),  # xx yy zz xy xz yz of the tensor's elements, about the centre of mass
    Block("inertia_inverse", 6),
    Block("com_frd", 3),
    Block("rotors_frd", 12),
    Block("spins", 4),
    Block("thrust_max_n", 1),
    Block("thrust_curve", 2),
    Block("torque_per_thrust_m", 1),
    Block("hover_speed", 1),
    Block("rise_half_tick", 1),  # exp(-half a tick / time constant) of a rotor that speeds up
    Block("fall_half_tick", 1),  # the same of one that slows down
    Block("thrust_gain", 1),
    Block("linear_drag", 3),
    Block("quadratic_drag", 1),
    Block("wind_ned", 2),
    Block("flapping", 1),
    Block("tether", 6),  # stiffness 1/s^2, damping 1/s, slack m, anchor NED
    Block("floor", 2),  # stiffness N/m and damping N s/m of one foot
    Block("sag_exponent", 1),
    Block("battery", 5),  # full V, empty V, resistance ohm, capacity C, hover power W
    Block("gust", 3),  # decay over a tick, added sd of acceleration and of angular acceleration
    Block("hover_inflow", 2),  # induced velocity at hover, m/s, and its fourth power
    Block("translational_lift", 1),  # N of a rotor at hover speed, per m/s less induced velocity
    Block("thrust_inflow", 1),  # N of a rotor at hover speed, per m/s along its axis
    Block("rotor_loss", 4),
    Block("ground_effect", 1),
    Block("gyroscopic", 4),  # angular momentum of each rotor at hover speed, with the sign of its spin, N m s
    Block("torque_bias", 3),  # N m
    Block("hover_thrust_n", 1),  # of all rotors
    Block("cant", 12),  # direction of each rotor's thrust, FRD
    Block("dead_zone", 2),  # centre and half-width, as commands
    Block("fan", 6),  # push m/s^2, width m, place NE, direction NE
    Block("wall", 4),  # pull m/s^2 at a metre, distance from the origin m, direction NE
    Block("payload", 3),  # mass kg, length of the line m, damping of the swing at the attachment 1/s
    Block("slide", 5),  # share of the mass, stiffness 1/s^2, direction of the tray: x, z FRD, its length m
    Block("sweep", 4),  # push m/s^2, turns per second, direction NE
    Block("dropped_load", 2),  # mass kg, time of the loss after lift-off s
    Block("held_camera", 1),  # share of the mass times the distance below the pivot, m
    Block(
        "stutter", 6
    ),  # share of the speed that each rotor loses, spells per second, their share of the time
)
"""The constants of one flight, in order."""

INPUTS = (
    Block("state", sum(size for _, size in STATE)),
    Block("parameters", sum(size for _, size in PARAMETERS)),
    Block("command", 4),
    Block("noise", 6),
)
OUTPUTS = (INPUTS[0], Block("pose", 10), Block("sensed", 7))
"""`pose`: p_ned, v_ned of the origin, q_ned_frd. `sensed`: rate_frd, specific_force_frd at the origin, V."""

PARTS = frozenset(
    {
        "battery-sag",
        "ground-effect",
        "gyroscopic",
        "slung-payload",
        "blade-flapping",
        "elastic-tether",
        "motor-cant",
        "fan",
        "wall-suction",
        "dead-zone",
        "shifting-battery",
        "sweeping-fan",
        "dropped-load",
        "stabilised-camera",
        "stuttering-motor",
    }
)
"""Kinds whose physics the tick omits in worlds without them. Builds do not deviate in these."""

ROTOR_DRAG_SHARE = (
    0.5  # share of the linear drag across the discs that scales with rotor speed; the rest is the frame's
)
_PLATE = (0.94, 1.06, 1.2)  # drag area along each body axis over the mean of x and y
_BIAS_WITH_THRUST = 0.3  # share of a torque bias at hover that grows with thrust, as for a bent arm


def tick(ops: Any, inputs: Mapping[str, Vector], parts: Container[str] = PARTS) -> dict[str, list[Scalar]]:
    """Return state, pose and sensed quantities after one millisecond with a constant motor command.

    `ops` is the arithmetic (`where`, `exp`, ...) of floats, CasADi scalars or NumPy arrays. `noise` holds six
    standard normal numbers. `parts` are the members of `PARTS` in the world. The rigid body is integrated by
    the midpoint rule. The midpoint is extrapolated with the accelerations of the last tick, so one evaluation
    of the forces gives second order. Rotors and gusts follow exact exponentials; battery, payload and tray
    take one step.
    """
    P = cut(PARAMETERS, inputs["parameters"])
    x = cut(STATE, inputs["state"])
    p, v, q, w = x["p_ned"], x["v_ned"], x["q_ned_frd"], x["rate_frd"]
    voltage, charge = P["battery"][0], x["charge_used_c"][0]
    if "battery-sag" in parts:
        voltage, charge = battery(ops, P, x["rotor_speed"], charge, TICK_S)
    airborne_s, fan_turns, spells = x["clock"]
    if "stuttering-motor" in parts:
        spells = spells + TICK_S * P["stutter"][4]
    speeds, speeds_end = rotor_speeds(ops, P, x["rotor_speed"], inputs["command"], voltage, spells, parts)
    gust = next_gust(P, x["gust"], inputs["noise"])

    half, h = 0.5 * TICK_S, TICK_S
    w_half = ahead(w, x["turning_frd"], half)
    v_half = ahead(v, x["acceleration_ned"], half)
    q_half = unit(ops, ahead(q, quaternion_rate(q, w), half))
    p_half, R_half = ahead(p, v, half), rotation(q_half)
    com, com_rate, tray = P["com_frd"], None, x["slide"]
    if "shifting-battery" in parts:
        shift, com_rate, tray = slide(ops, P, tray, x["acceleration_ned"], x["turning_frd"], R_half, h)
        com = add(com, shift)
    if "stabilised-camera" in parts:
        shift, moving = held_camera(ops, P, R_half, w_half)
        com, com_rate = add(com, shift), moving if com_rate is None else add(com_rate, moving)
    mass = P["mass_kg"][0]
    if "dropped-load" in parts:
        airborne_s = airborne_s + ops.where(p[2] < -_AIRBORNE_M, h, 0.0)
        mass = mass + load_kg(ops, P, airborne_s)
    if "sweeping-fan" in parts:
        fan_turns = fan_turns + h * P["sweep"][1]
    body = _Body(p_half, v_half, R_half, w_half, com, mass)
    line, hanging = None, x["payload_ned"]
    if "slung-payload" in parts:
        line, hanging = _hang(ops, P, body, hanging)
    a, turning = _accelerations(ops, P, body, speeds, gust, line, fan_turns, parts)
    p, v, w = ahead(p, v_half, h), ahead(v, a, h), ahead(w, turning, h)
    q = unit(ops, ahead(q, quaternion_rate(q_half, w_half), h))

    carried = add(cross(turning, com), cross(w_half, cross(w_half, com)))
    force = into_body(R_half, [a[0], a[1], a[2] - GRAVITY_M_S2])
    force = [f - c for f, c in zip(force, carried, strict=True)]
    state = [*p, *v, *q, *w, *speeds_end, charge, *gust, *a, *turning, *hanging, *tray]
    state += [airborne_s, fan_turns, spells]
    pose = [*origin(p, v, rotation(q), w, com, com_rate), *q]
    return {"state": state, "pose": pose, "sensed": [*w, *force, voltage]}


class _Body(NamedTuple):
    """The rigid body at the middle of a tick: p and v in NED, R_ned_frd, body rate, centre of mass in FRD.

    mass_kg: with a load that is still there.
    """

    p: Vector
    v: Vector
    R: Vector
    w: Vector
    com: Vector
    mass_kg: Scalar


def _accelerations(  # noqa: C901 - the order of operations determines the bytes of every flight
    ops: Any,
    P: Mapping[str, Any],
    body: _Body,
    speeds: Vector,
    gust: Vector,
    line: Vector | None,
    fan_turns: Scalar,
    parts: Container[str],
) -> tuple[list[Scalar], list[Scalar]]:
    """Return the acceleration of the centre of mass in NED and the angular acceleration in FRD.

    `line` is the force in NED of a slung payload's line at the origin; None without a payload.
    """
    p, v, R, w, com, heavy = body
    mass = P["mass_kg"][0]
    arms = [[P["rotors_frd"][3 * i + k] - com[k] for k in range(3)] for i in range(4)]
    wind_ned = wind(ops, P, p)
    air = into_body(R, [v[0] - wind_ned[0], v[1] - wind_ned[1], v[2]])
    force: list[Scalar] = [0.0, 0.0, 0.0]
    torque: list[Scalar] = [0.0, 0.0, 0.0]

    def apply_force(arm: Vector, f: Vector) -> None:
        for k, m in enumerate(cross(arm, f)):
            force[k] = force[k] + f[k]
            torque[k] = torque[k] + m

    drag = [d * mass for d in P["linear_drag"]]
    total: Scalar = 0.0
    surplus: Scalar = 0.0
    for i, arm in enumerate(arms):
        relative = speeds[i] / P["hover_speed"][0]
        hub = add(air, cross(w, arm))
        thrust, braking = rotor_thrust(ops, P, i, speeds[i], relative, hub)
        if "ground-effect" in parts:
            thrust = thrust * ground_gain(ops, P, -p[2] - dot(R[6:9], arm), R[8])
        total = total + thrust
        share = ROTOR_DRAG_SHARE / 4 * relative
        braking = P["spins"][i] * P["torque_per_thrust_m"][0] * braking
        if "motor-cant" in parts:
            axis = P["cant"][3 * i : 3 * i + 3]
            apply_force(
                arm, [thrust * axis[k] - (share * drag[k] * hub[k] if k < 2 else 0.0) for k in range(3)]
            )
            torque = [t - braking * c for t, c in zip(torque, axis, strict=True)]
        else:
            apply_force(arm, [-share * drag[0] * hub[0], -share * drag[1] * hub[1], -thrust])
            torque[2] = torque[2] + braking
        if "blade-flapping" in parts:
            flap = P["flapping"][0] / 4 * relative
            torque[0] = torque[0] - flap * P["inertia"][0] * hub[1]
            torque[1] = torque[1] + flap * P["inertia"][1] * hub[0]
        if "gyroscopic" in parts:
            surplus = surplus + P["gyroscopic"][i] * relative

    if (
        "gyroscopic" in parts
    ):  # -w x L; the momentum of a rotor that turns counter-clockwise from above points up
        torque = [torque[0] + surplus * w[1], torque[1] - surplus * w[0], torque[2]]
    bent = 1 - _BIAS_WITH_THRUST + _BIAS_WITH_THRUST * total / P["hover_thrust_n"][0]
    torque = [t + bent * b for t, b in zip(torque, P["torque_bias"], strict=True)]

    middle = [-c for c in com]
    flow = add(air, cross(w, middle))
    speed = ops.sqrt(dot(flow, flow))
    linear = [(1 - ROTOR_DRAG_SHARE) * drag[0], (1 - ROTOR_DRAG_SHARE) * drag[1], drag[2]]
    plate = [linear[k] + mass * speed * _PLATE[k] * P["quadratic_drag"][0] for k in range(3)]
    apply_force(middle, [-c * u for c, u in zip(plate, flow, strict=True)])
    if line is not None:
        apply_force(middle, into_body(R, line))

    outside, floor_torque = floor(ops, P, p, v, R, w, arms)
    torque = add(torque, floor_torque)
    if "elastic-tether" in parts:
        outside = add(tether(ops, P, p, v), outside)
    if "fan" in parts:
        outside = add(outside, fan(ops, P, p, v))
    if "wall-suction" in parts:
        outside = add(outside, wall_suction(ops, P, p))
    if "sweeping-fan" in parts:
        outside = add(outside, sweeping_fan(ops, P, v, fan_turns))
    a = [f / heavy + o / heavy + g for f, o, g in zip(into_world(R, force), outside, gust[:3], strict=True)]
    a[2] = a[2] + GRAVITY_M_S2
    momentum = symmetric(P["inertia"], w)
    turning = [t - c for t, c in zip(torque, cross(w, momentum), strict=True)]
    return a, add(symmetric(P["inertia_inverse"], turning), gust[3:])


def _hang(ops: Any, P: Mapping[str, Any], body: _Body, hanging: Vector) -> tuple[list[Scalar], list[Scalar]]:
    """Return the force in NED of a payload's line at the origin, and the payload's state after the tick."""
    hook = origin(body.p, body.v, body.R, body.w, body.com)
    p, v = hanging[:3], hanging[3:]
    place = ahead(p, v, 0.5 * TICK_S)
    a, line = payload(ops, P, hook[:3], hook[3:], place, v, wind(ops, P, place))
    v = ahead(v, a, TICK_S)
    return line, [*ahead(p, v, TICK_S), *v]


def next_gust(P: Mapping[str, Any], gust: Vector, noise: Vector) -> list[Scalar]:
    """Return the next state of the turbulence: six Ornstein-Uhlenbeck processes, constant over the tick."""
    keep, force, torque = P["gust"]
    added = (force, force, force, torque, torque, torque)
    return [keep * g + s * n for g, s, n in zip(gust, added, noise, strict=True)]


def origin(
    p: Vector, v: Vector, R: Vector, w: Vector, com: Vector, com_rate: Vector | None = None
) -> list[Scalar]:
    """Return position and velocity in NED of the body's origin, from those of the centre of mass."""
    place = into_world(R, com)
    moving = cross(w, com)
    if com_rate is not None:
        moving = add(moving, com_rate)
    speed = into_world(R, moving)
    return [a - b for a, b in zip([*p, *v], [*place, *speed], strict=True)]


def cut(layout: Sequence[Block], values: Vector) -> dict[str, list[Scalar]]:
    """Return the vector `values` in the blocks of `layout`, by name."""
    parts, start = {}, 0
    for name, size in layout:
        parts[name] = [values[i] for i in range(start, start + size)]
        start += size
    return parts
