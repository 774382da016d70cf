"""External forces on the simulated vehicle: floor, air, lines, walls. Forces are in NED.

`P` holds the constants of `plant_model.PARAMETERS`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from trimtab.sitl.vectors import Scalar, Vector, cross, dot

GRAVITY_M_S2 = 9.81
LINE_STRETCH_M = 0.006  # stretch of a payload's line under the payload's weight
_FRICTION = 0.8
_SLIP_M_S = 0.05
_WIND_HEIGHT_M = 1.5  # height of the stated wind; the wind is slower below
_WIND_SHEAR = 0.08
_WIND_FLOOR_M = 0.05
_JET_M_S = 5.0  # air speed at the centre of a fan's jet
_SWEEP_M_S = 5.0  # air speed while a sweeping fan points at the vehicle
_SWEEP_NARROW = 4.0  # half of the push or more for an eighth of a turn
_JET_LENGTH_M = 1.5  # decay length along the jet, in both directions
_WALL_NEAREST_M = 0.6  # distance below which suction stays constant
_LINE_DAMPING = 0.3  # axial damping of the line over critical damping
_PAYLOAD_DRAG = 0.02  # 1/m, over its mass
_PAYLOAD_SINK_M = 0.003  # depth in the floor under its own weight
_PAYLOAD_FLOOR_DAMPING = 60.0  # 1/s
_PAYLOAD_FRICTION = 0.6
_TRAY_M = 0.02  # below the origin
_TRAY_FRICTION = 0.01
_TRAY_SLIP_M_S = 0.005
_TRAY_DAMPING = 1.5  # 1/s
_TRAY_STOP = 4000.0  # 1/s^2: stiffness of the foam at its ends


def wind(ops: Any, P: Mapping[str, Any], p: Vector) -> list[Scalar]:
    """Return the horizontal velocity of the air in NED, which grows with a low power of height."""
    height = ops.maximum(-p[2], _WIND_FLOOR_M)
    shear = ops.exp(_WIND_SHEAR * ops.log(height / _WIND_HEIGHT_M))
    return [shear * component for component in P["wind_ned"]]


def floor(
    ops: Any, P: Mapping[str, Any], p: Vector, v: Vector, R: Vector, w: Vector, arms: Sequence[Vector]
) -> tuple[list[Scalar], list[Scalar]]:
    """Return the floor's force in NED and torque in FRD: a damped spring under each rotor, and friction."""
    down = R[6:9]
    sway = cross(down, w)  # w x arm, seen along the vertical, is arm . (down x w)
    total: Scalar = 0.0
    lever: list[Scalar] = [0.0, 0.0, 0.0]
    for arm in arms:
        depth = p[2] + dot(arm, down)
        press = ops.maximum(P["floor"][0] * depth + P["floor"][1] * (v[2] + dot(arm, sway)), 0.0)
        press = ops.where(depth > 0.0, press, 0.0)
        total = total + press
        lever = [old + press * a for old, a in zip(lever, arm, strict=True)]
    grip = _FRICTION * total
    slide = grip / ops.sqrt(v[0] * v[0] + v[1] * v[1] + _SLIP_M_S * _SLIP_M_S)
    reach = ops.sqrt(arms[0][0] * arms[0][0] + arms[0][1] * arms[0][1])
    turn = reach * w[2]
    torque = cross(down, lever)
    torque[2] = torque[2] - grip * reach * turn / ops.sqrt(turn * turn + _SLIP_M_S * _SLIP_M_S)
    return [-slide * v[0], -slide * v[1], -total], torque


def tether(ops: Any, P: Mapping[str, Any], p: Vector, v: Vector) -> list[Scalar]:
    """Return the force of an elastic line from an anchor to the centre of mass; slack below its length."""
    stiffness, damping, slack, *anchor = P["tether"]
    line = [a - b for a, b in zip(p, anchor, strict=True)]
    length = ops.sqrt(dot(line, line) + 1e-12)
    pull = stiffness * (length - slack) + damping * dot(line, v) / length
    pull = ops.where(length > slack, ops.maximum(pull, 0.0), 0.0) * P["mass_kg"][0] / length
    return [-pull * c for c in line]


def fan(ops: Any, P: Mapping[str, Any], p: Vector, v: Vector) -> list[Scalar]:
    """Return the drag force of a fan's jet, which is as tall as the room and Gaussian across and along."""
    push, width, x, y, north, east = P["fan"]
    along = (p[0] - x) * north + (p[1] - y) * east
    across = (p[1] - y) * north - (p[0] - x) * east
    along, across = along / _JET_LENGTH_M, 2 * across / width
    share = ops.exp(-along * along - across * across)
    flow = [_JET_M_S * share * north - v[0], _JET_M_S * share * east - v[1], -v[2]]
    drag = P["mass_kg"][0] * push / _JET_M_S * share
    return [drag * u for u in flow]


def sweeping_fan(ops: Any, P: Mapping[str, Any], v: Vector, turns: Scalar) -> list[Scalar]:
    """Return the drag force of a fan far away that turns to and fro and blows on the vehicle once a turn."""
    push, _, north, east = P["sweep"]
    share = ops.exp(_SWEEP_NARROW * (ops.cos(2 * math.pi * turns) - 1.0))
    flow = [_SWEEP_M_S * share * north - v[0], _SWEEP_M_S * share * east - v[1], -v[2]]
    drag = P["mass_kg"][0] * push / _SWEEP_M_S * share
    return [drag * u for u in flow]


def wall_suction(ops: Any, P: Mapping[str, Any], p: Vector) -> list[Scalar]:
    """Return the force towards a vertical wall, by the inverse square of the distance."""
    pull, distance, north, east = P["wall"]
    gap = ops.maximum(distance - p[0] * north - p[1] * east, _WALL_NEAREST_M)
    force = P["mass_kg"][0] * pull / (gap * gap)
    return [force * north, force * east, 0.0]


def payload(
    ops: Any, P: Mapping[str, Any], hook: Vector, hook_v: Vector, p: Vector, v: Vector, air: Vector
) -> tuple[list[Scalar], list[Scalar]]:
    """Return the acceleration of a mass on a line, and the line's force on the vehicle.

    The line is a stiff damped spring that is slack below its length. The mass may rest on the floor. `hook`
    and `hook_v` are position and velocity of the attachment, `p` and `v` those of the mass, and `air` is the
    horizontal velocity of the air, all in NED.
    """
    mass, length, taken = P["payload"]
    line = [a - b for a, b in zip(p, hook, strict=True)]
    moving = [a - b for a, b in zip(v, hook_v, strict=True)]
    reach = ops.sqrt(dot(line, line) + 1e-12)
    stiffness = GRAVITY_M_S2 / LINE_STRETCH_M
    damping = 2 * _LINE_DAMPING * stiffness**0.5
    tension = stiffness * (reach - length) + damping * dot(line, moving) / reach
    tension = ops.where(reach > length, ops.maximum(tension, 0.0), 0.0)
    bending = taken / GRAVITY_M_S2 * tension
    pull = [tension / reach * c + bending * u for c, u in zip(line, moving, strict=True)]

    flow = [v[0] - air[0], v[1] - air[1], v[2]]
    drag = _PAYLOAD_DRAG * ops.sqrt(dot(flow, flow))
    stands = GRAVITY_M_S2 / _PAYLOAD_SINK_M * p[2] + _PAYLOAD_FLOOR_DAMPING * v[2]
    press = ops.where(p[2] > 0.0, ops.maximum(stands, 0.0), 0.0)
    slide = _PAYLOAD_FRICTION * press / ops.sqrt(v[0] * v[0] + v[1] * v[1] + _SLIP_M_S * _SLIP_M_S)
    ground = [-slide * v[0], -slide * v[1], GRAVITY_M_S2 - press]
    a = [g - t - drag * u for g, t, u in zip(ground, pull, flow, strict=True)]
    return a, [mass * t for t in pull]


def battery_slide(
    ops: Any, P: Mapping[str, Any], force: Vector, turning: Vector, s: Scalar, rate: Scalar
) -> Scalar:
    """Return the acceleration of a battery along its sloping tray, held by a strap that is slack at hover.

    `force` is the specific force of the body and `turning` its angular acceleration, in FRD. `s` and `rate`
    are displacement and speed of the battery.
    """
    _, stiffness, along, down, end = P["slide"]
    along_tray = (force[0] + turning[1] * _TRAY_M) * along + (force[2] + GRAVITY_M_S2) * down
    rub = _TRAY_FRICTION * GRAVITY_M_S2 * rate / ops.sqrt(rate * rate + _TRAY_SLIP_M_S * _TRAY_SLIP_M_S)
    stop = _TRAY_STOP * (s - ops.minimum(ops.maximum(s, -end), end))
    return -along_tray - stiffness * s - _TRAY_DAMPING * rate - rub - stop
