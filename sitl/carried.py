"""What the simulated vehicle carries: a battery that empties or slides, a camera, a load.

`P` holds the constants of `plant_model.PARAMETERS`. Frames: world NED, body FRD.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trimtab.sitl.surroundings import GRAVITY_M_S2, LINE_STRETCH_M, battery_slide
from trimtab.sitl.vectors import Scalar, Vector, cross, into_body

START_DEPTH = 0.4
"""Greatest depth of discharge at the start of a flight if the battery discharges."""
_LYING_AT_M = (-0.12, 0.05)  # north and east offset of a payload on the floor from the vehicle
_GIMBAL_STOP = 0.6  # greatest turn of a camera's gimbal, as the sine of the vehicle's tilt


def payload_at_rest(p_ned: Sequence[float], line_m: float) -> list[float]:
    """Return the initial position of a payload: under the vehicle, or on the floor beside it."""
    x, y, z = p_ned
    if z + line_m < 0.0:
        return [x, y, z + line_m + LINE_STRETCH_M]
    return [x + _LYING_AT_M[0], y + _LYING_AT_M[1], 0.0]


def battery(
    ops: Any, P: Mapping[str, Any], speeds: Vector, charge: Scalar, tick_s: float
) -> tuple[Scalar, Scalar]:
    """Return the voltage under load at the start of the tick, V, and the charge used at its end, C.

    The open-circuit voltage falls with the depth of discharge as in a lithium-polymer cell. Rotor power grows
    with speed cubed. Voltage under load: V^2 - V_oc V + R P = 0.
    """
    full, empty, resistance, capacity, hover_power = P["battery"]
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
    return loaded, charge + tick_s * power / loaded


def slide(
    ops: Any,
    P: Mapping[str, Any],
    at: Vector,
    acceleration: Vector,
    turning: Vector,
    R: Vector,
    tick_s: float,
) -> tuple[list[Scalar], list[Scalar], list[Scalar]]:
    """Return what a sliding battery adds to centre of mass and its velocity, FRD, and its next state.

    at: displacement and speed of the battery. acceleration: of the body, NED. turning: its angular
    acceleration, FRD.
    """
    share, _, along, down, _ = P["slide"]
    s, rate = at
    force = into_body(R, [acceleration[0], acceleration[1], acceleration[2] - GRAVITY_M_S2])
    rate = rate + tick_s * battery_slide(ops, P, force, turning, s, rate)
    s = s + tick_s * rate
    way = [share * along, 0.0, share * down]
    return [s * u for u in way], [rate * u for u in way], [s, rate]


def held_camera(ops: Any, P: Mapping[str, Any], R: Vector, w: Vector) -> tuple[list[Scalar], list[Scalar]]:
    """Return what a camera adds to centre of mass and its velocity in FRD that a gimbal holds upright.

    The camera is under its pivot, in the direction of gravity as long as the gimbal reaches. In level flight
    it is where the vehicle file has it.
    """
    (lever,) = P["held_camera"]
    down = [R[6], R[7], R[8]]
    reach = ops.sqrt(R[6] * R[6] + R[7] * R[7] + 1e-12)
    free = ops.minimum(1.0, _GIMBAL_STOP / reach)
    add = [lever * free * down[0], lever * free * down[1], lever * (down[2] - 1.0)]
    moving = [lever * c for c in cross(down, w)]  # a direction that is fixed in NED, seen from the body
    return add, [ops.where(reach < _GIMBAL_STOP, c, 0.0) for c in moving]


def load_kg(ops: Any, P: Mapping[str, Any], airborne_s: Scalar) -> Scalar:
    """Return the mass of a load that a clamp under the centre of mass loses some time after lift-off."""
    mass, at_s = P["dropped_load"]
    return ops.where(airborne_s < at_s, mass, 0.0)
