"""One tick of the simulated vehicle's physics as a symbolic function, written apart from the host's models.

The host's nominal model has Euler angles, thrust that lags by itself and forces on the body as a whole.
Here the attitude is a quaternion, the rotors have speeds, forces act at each rotor hub, the centre of mass
may be off the origin, and feet touch a floor. Every effect of a world enters where it arises, so that the
host's form of it is an approximation, as it is for a real vehicle.

A rotor's speed is a share of its full speed: thrust is `thrust_max_n * speed**2`. Frames: world NED, body
FRD with the origin in the middle of the rotors; the state's p and v are the centre of mass's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

Scalar = Any
Vector = Sequence[Scalar]

TICK_S = 0.001
GRAVITY_M_S2 = 9.81


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
)
"""Memory of a tick, in order. `gust`: three accelerations in NED (m/s^2) and three about FRD (rad/s^2);
`acceleration_ned` and `turning_frd`: the accelerations of the centre of mass in the last tick."""

PARAMETERS = (
    Block("mass_kg", 1),
    Block("inertia", 4),  # xx yy zz xy of the tensor's elements, about the centre of mass; xz and yz are 0
    Block("inertia_inverse", 4),
    Block("com_frd", 2),  # x, y of the centre of mass: in the plane of the origin
    Block("rotors_frd", 12),
    Block("spins", 4),
    Block("thrust_max_n", 1),
    Block("thrust_curve", 2),
    Block("torque_per_thrust_m", 1),
    Block("hover_speed", 1),
    Block(
        "rise_half_tick", 1
    ),  # exp(-half a tick / time constant) of a rotor that speeds up, and of one that slows
    Block("fall_half_tick", 1),
    Block("thrust_gain", 1),
    Block("linear_drag", 3),
    Block("quadratic_drag", 1),
    Block("wind_ned", 2),
    Block("flapping", 1),
    Block("tether", 6),  # stiffness 1/s^2, damping 1/s, slack m, anchor NED
    Block("floor", 2),  # stiffness N/m and damping N s/m of one foot
    Block("sag_exponent", 1),
    Block("battery", 6),  # sag switch 0/1, full V, empty V, resistance ohm, capacity C, hover power W
    Block("gust", 3),  # memory over a tick, added sd of acceleration and of angular acceleration
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

ROTOR_DRAG_SHARE = 0.5  # of the linear drag: goes with rotor speed; the rest is the frame
_PLATE = (0.94, 1.06, 1.2)  # drag area seen along each body axis over the mean of x and y
_WIND_HEIGHT_M = 1.5  # where a world's wind is given; slower below
_WIND_SHEAR = 0.08
_GAIN_REYNOLDS = 0.3  # a propeller's thrust error shrinks as it turns faster
_SAG_LOAD = -0.1  # a loaded motor gives way less than in proportion to voltage
_FRICTION = 0.8
_SLIP_M_S = 0.05
_WIND_FLOOR_M = 0.05


def tick(ops: Any, inputs: Mapping[str, Vector]) -> dict[str, list[Scalar]]:
    """State, pose and sensed quantities after one millisecond with the motor command held.

    `ops` is the arithmetic (`where`, `exp`, ...) of floats, CasADi scalars or numpy lanes; `noise` six
    standard normal numbers. Midpoint rule on the rigid body, with the way to the middle taken from the last
    tick's accelerations: second order for one evaluation of the forces. Rotors and gusts follow exact
    exponentials, the battery is stepped once.
    """
    P = _cut(PARAMETERS, inputs["parameters"])
    x = _cut(STATE, inputs["state"])
    p, v, q, w = x["p_ned"], x["v_ned"], x["q_ned_frd"], x["rate_frd"]
    voltage, charge = _battery(ops, P, x["rotor_speed"], x["charge_used_c"][0])
    speeds, speeds_end = _rotor_speeds(ops, P, x["rotor_speed"], inputs["command"], voltage)
    gust = _gust(P, x["gust"], inputs["noise"])

    half, h = 0.5 * TICK_S, TICK_S
    w_half = _ahead(w, x["turning_frd"], half)
    v_half = _ahead(v, x["acceleration_ned"], half)
    q_half = _unit(ops, _ahead(q, _quaternion_rate(q, w), half))
    R_half = rotation(q_half)
    a, turning = _accelerations(ops, P, _ahead(p, v, half), v_half, R_half, w_half, speeds, gust)
    p, v, w = _ahead(p, v_half, h), _ahead(v, a, h), _ahead(w, turning, h)
    q = _unit(ops, _ahead(q, _quaternion_rate(q_half, w_half), h))

    com = [*P["com_frd"], 0.0]
    carried = _add(_cross(turning, com), _cross(w_half, _cross(w_half, com)))
    force = _into_body(R_half, [a[0], a[1], a[2] - GRAVITY_M_S2])
    force = [f - c for f, c in zip(force, carried, strict=True)]
    state = [*p, *v, *q, *w, *speeds_end, charge, *gust, *a, *turning]
    pose = [*_origin(p, v, rotation(q), w, com), *q]
    return {"state": state, "pose": pose, "sensed": [*w, *force, voltage]}


def _accelerations(
    ops: Any,
    P: Mapping[str, Any],
    p: Vector,
    v: Vector,
    R: Vector,
    w: Vector,
    speeds: Vector,
    gust: Vector,
) -> tuple[list[Scalar], list[Scalar]]:
    """Acceleration of the centre of mass in NED and angular acceleration in FRD."""
    mass, com = P["mass_kg"][0], [*P["com_frd"], 0.0]
    arms = [[P["rotors_frd"][3 * i + k] - com[k] for k in range(3)] for i in range(4)]
    wind = _wind(ops, P, p)
    air = _into_body(R, [v[0] - wind[0], v[1] - wind[1], v[2]])
    force: list[Scalar] = [0.0, 0.0, 0.0]
    torque: list[Scalar] = [0.0, 0.0, 0.0]

    def push(arm: Vector, f: Vector) -> None:
        for k, m in enumerate(_cross(arm, f)):
            force[k] = force[k] + f[k]
            torque[k] = torque[k] + m

    drag = [d * mass for d in P["linear_drag"]]
    for i, arm in enumerate(arms):
        relative = speeds[i] / P["hover_speed"][0]
        gain = 1 + (P["thrust_gain"][0] - 1) / (1 + _GAIN_REYNOLDS * (relative - 1))
        thrust = P["thrust_max_n"][0] * gain * speeds[i] * speeds[i]
        hub = _add(air, _cross(w, arm))
        share = ROTOR_DRAG_SHARE / 4 * relative
        push(arm, [-share * drag[0] * hub[0], -share * drag[1] * hub[1], -share * drag[2] * hub[2] - thrust])
        flap = P["flapping"][0] / 4 * relative
        torque[0] = torque[0] - flap * P["inertia"][0] * hub[1]
        torque[1] = torque[1] + flap * P["inertia"][1] * hub[0]
        torque[2] = torque[2] + P["spins"][i] * P["torque_per_thrust_m"][0] * thrust

    middle = [-c for c in com]
    flow = _add(air, _cross(w, middle))
    speed = ops.sqrt(_dot(flow, flow))
    frame = (1 - ROTOR_DRAG_SHARE, mass * speed)
    plate = [frame[0] * drag[k] + frame[1] * _PLATE[k] * P["quadratic_drag"][0] for k in range(3)]
    push(middle, [-c * u for c, u in zip(plate, flow, strict=True)])

    outside = _tether(ops, P, p, v)
    floor_force, floor_torque = _floor(ops, P, p, v, R, w, arms)
    outside = _add(outside, floor_force)
    torque = _add(torque, floor_torque)
    a = [f / mass + o / mass + g for f, o, g in zip(_into_world(R, force), outside, gust[:3], strict=True)]
    a[2] = a[2] + GRAVITY_M_S2
    momentum = _symmetric(P["inertia"], w)
    turning = [t - c for t, c in zip(torque, _cross(w, momentum), strict=True)]
    return a, _add(_symmetric(P["inertia_inverse"], turning), gust[3:])


def _floor(
    ops: Any, P: Mapping[str, Any], p: Vector, v: Vector, R: Vector, w: Vector, arms: Sequence[Vector]
) -> tuple[list[Scalar], list[Scalar]]:
    """Force in NED and torque in FRD of the floor: a damped spring under each rotor, friction on the body."""
    down = R[6:9]
    sway = _cross(down, w)  # w x arm, seen along the vertical, is arm . (down x w)
    total: Scalar = 0.0
    lever: list[Scalar] = [0.0, 0.0, 0.0]
    for arm in arms:
        depth = p[2] + _dot(arm, down)
        press = ops.maximum(P["floor"][0] * depth + P["floor"][1] * (v[2] + _dot(arm, sway)), 0.0)
        press = ops.where(depth > 0.0, press, 0.0)
        total = total + press
        lever = [old + press * a for old, a in zip(lever, arm, strict=True)]
    grip = _FRICTION * total
    slide = grip / ops.sqrt(v[0] * v[0] + v[1] * v[1] + _SLIP_M_S * _SLIP_M_S)
    reach = ops.sqrt(arms[0][0] * arms[0][0] + arms[0][1] * arms[0][1])
    turn = reach * w[2]
    torque = _cross(down, lever)
    torque[2] = torque[2] - grip * reach * turn / ops.sqrt(turn * turn + _SLIP_M_S * _SLIP_M_S)
    return [-slide * v[0], -slide * v[1], -total], torque


def _tether(ops: Any, P: Mapping[str, Any], p: Vector, v: Vector) -> list[Scalar]:
    """Force in NED of an elastic line from a fixed anchor to the centre of mass; slack below its length."""
    stiffness, damping, slack, *anchor = P["tether"]
    line = [a - b for a, b in zip(p, anchor, strict=True)]
    length = ops.sqrt(_dot(line, line) + 1e-12)
    pull = stiffness * (length - slack) + damping * _dot(line, v) / length
    pull = ops.where(length > slack, ops.maximum(pull, 0.0), 0.0) * P["mass_kg"][0] / length
    return [-pull * c for c in line]


def _wind(ops: Any, P: Mapping[str, Any], p: Vector) -> list[Scalar]:
    """Horizontal velocity of the air in NED: it grows with a low power of height."""
    height = ops.maximum(-p[2], _WIND_FLOOR_M)
    shear = ops.exp(_WIND_SHEAR * ops.log(height / _WIND_HEIGHT_M))
    return [shear * component for component in P["wind_ned"]]


def _rotor_speeds(
    ops: Any, P: Mapping[str, Any], speeds: Vector, command: Vector, voltage: Scalar
) -> tuple[list[Scalar], list[Scalar]]:
    """Rotor speeds in the middle and at the end of the tick: each follows its command, first order."""
    c1, c2 = P["thrust_curve"]
    sag = 0.5 * P["sag_exponent"][0] * ops.log(voltage / P["battery"][1])
    middle: list[Scalar] = []
    end: list[Scalar] = []
    for n, u in zip(speeds, command, strict=True):
        load = 1 + _SAG_LOAD * (n / P["hover_speed"][0] - 1)
        target = ops.sqrt(u * (c1 + c2 * u)) * ops.exp(sag * load)
        keep = ops.where(target > n, P["rise_half_tick"][0], P["fall_half_tick"][0])
        middle.append(target + (n - target) * keep)
        end.append(target + (n - target) * keep * keep)
    return middle, end


def _battery(ops: Any, P: Mapping[str, Any], speeds: Vector, charge: Scalar) -> tuple[Scalar, Scalar]:
    """Voltage under load at the start of the tick, V, and charge used at its end, C.

    The open-circuit voltage falls with depth of discharge like a lithium-polymer cell's; rotor power grows
    with speed cubed. Without sag the voltage is the full one. Load: V^2 - V_oc V + R P = 0.
    """
    sags, full, empty, resistance, capacity, hover_power = P["battery"]
    power: Scalar = 0.0
    for n in speeds:
        relative = n / P["hover_speed"][0]
        power = power + 0.25 * hover_power * relative * relative * relative
    depth = charge / capacity
    knee = depth * depth * depth * depth
    used = 0.15 * (1 - ops.exp(-18 * depth)) + 0.55 * depth + 0.3 * knee * knee
    open_circuit = full - (full - empty) * used
    room = ops.maximum(open_circuit * open_circuit - 4 * resistance * power, 0.0)
    loaded = 0.5 * (open_circuit + ops.sqrt(room))
    voltage = ops.where(sags > 0.5, loaded, full)
    return voltage, charge + sags * TICK_S * power / voltage


def _gust(P: Mapping[str, Any], gust: Vector, noise: Vector) -> list[Scalar]:
    """The next state of the turbulence: six independent Ornstein-Uhlenbeck processes, held over the tick."""
    keep, force, torque = P["gust"]
    added = (force, force, force, torque, torque, torque)
    return [keep * g + s * n for g, s, n in zip(gust, added, noise, strict=True)]


def _origin(p: Vector, v: Vector, R: Vector, w: Vector, com: Vector) -> list[Scalar]:
    """Position and velocity in NED of the body's origin, from those of the centre of mass."""
    place = _into_world(R, com)
    speed = _into_world(R, _cross(w, com))
    return [a - b for a, b in zip([*p, *v], [*place, *speed], strict=True)]


def rotation(q: Vector) -> list[Scalar]:
    """R_ned_frd, row-major, of a unit quaternion, Hamilton and w first."""
    w, x, y, z = q
    xx, yy, zz = 2 * x * x, 2 * y * y, 2 * z * z
    xy, xz, yz = 2 * x * y, 2 * x * z, 2 * y * z
    wx, wy, wz = 2 * w * x, 2 * w * y, 2 * w * z
    return [1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy]


def _quaternion_rate(q: Vector, w: Vector) -> list[Scalar]:
    a, b, c, d = q
    x, y, z = w
    return [
        -0.5 * (b * x + c * y + d * z),
        0.5 * (a * x + c * z - d * y),
        0.5 * (a * y + d * x - b * z),
        0.5 * (a * z + b * y - c * x),
    ]


def _unit(ops: Any, q: Vector) -> list[Scalar]:
    scale = 1 / ops.sqrt(_dot(q, q))
    return [scale * c for c in q]


def _ahead(y: Vector, slope: Vector, h: float) -> list[Scalar]:
    return [a + h * b for a, b in zip(y, slope, strict=True)]


def _into_world(R: Vector, u: Vector) -> list[Scalar]:
    return [R[3 * i] * u[0] + R[3 * i + 1] * u[1] + R[3 * i + 2] * u[2] for i in range(3)]


def _into_body(R: Vector, u: Vector) -> list[Scalar]:
    return [R[i] * u[0] + R[3 + i] * u[1] + R[6 + i] * u[2] for i in range(3)]


def _symmetric(m: Vector, u: Vector) -> list[Scalar]:
    xx, yy, zz, xy = m
    return [xx * u[0] + xy * u[1], xy * u[0] + yy * u[1], zz * u[2]]


def _cross(a: Vector, b: Vector) -> list[Scalar]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _dot(a: Vector, b: Vector) -> Scalar:
    total: Scalar = a[0] * b[0]
    for s, t in zip(a[1:], b[1:], strict=True):
        total = total + s * t
    return total


def _add(a: Vector, b: Vector) -> list[Scalar]:
    return [s + t for s, t in zip(a, b, strict=True)]


def _cut(layout: Sequence[Block], values: Vector) -> dict[str, list[Scalar]]:
    parts, start = {}, 0
    for name, size in layout:
        parts[name] = [values[i] for i in range(start, start + size)]
        start += size
    return parts
